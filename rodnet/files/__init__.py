"""Robots as text: one TOML file that people can read, and write."""
