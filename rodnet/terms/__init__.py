"""The physics: energies, drag, loads, actuators and constraints, all of them `Term` objects."""
