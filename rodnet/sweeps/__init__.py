"""Many robots: the points of a sweep, the work at each of them, their journal and their dataset."""
