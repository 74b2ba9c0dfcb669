"""Calibration and diagnosis: what recordings say about a robot."""
