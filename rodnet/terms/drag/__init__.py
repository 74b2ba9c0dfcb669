"""Drag laws: local laws along rods, resistive force theory, Stokes heads."""
