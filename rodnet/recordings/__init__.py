"""Recordings of real robots: trials, files, noise, and what an instrument sees of a trajectory."""
