"""Kinematics of rigid linkages on paper."""

import numpy as np

BARS = 0.04, 0.1, 0.08, 0.09  # crank, coupler, rocker, ground: the crank turns all round


def four_bar(angle, crank, coupler, rocker, ground):
    """Ends of crank and coupler of an open linkage in the plane z = 0, by the intersection of two circles."""
    a = crank * np.array([np.cos(angle), np.sin(angle), 0.0])
    to = np.array([ground, 0.0, 0.0]) - a
    d = np.linalg.norm(to)
    along = (d * d + coupler**2 - rocker**2) / (2 * d)
    return a, a + along * to / d + np.sqrt(coupler**2 - along**2) * np.cross([0.0, 0.0, 1.0], to / d)
