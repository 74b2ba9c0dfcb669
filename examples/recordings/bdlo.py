"""A cable with branches, held in two places and moved: one case for every way of holding it.

    rodnet evaluate examples/recordings/bdlo.py --recordings BDLO1/*.npz

All rods are of one material and radius, and welded where they meet. As for a single cable, motion shows EI per mass
alone; the branches have a modulus of their own, which stands for whatever makes them stiffer or heavier.
"""

import numpy as np
from dlo import build as single
from dlo import noise, observe, options  # noqa: F401  as of a single cable

from rodnet.robots import Cables

free = ["cable.E", "branch*.E", "mass_damping.rate", "damping.bend"]
metric_name = "padded rms (m)"
STIFFNESS = {"cable": 1.3e7, "branch": 5.8e6}  # [Pa]: where a calibration begins


def build(rec):
    """Return the same rods, terms and grasps as of a single cable, with branches of a modulus of their own."""
    robot = single(rec)
    return robot.with_parameters(
        {f"{rod}.E": STIFFNESS[rod.rstrip("0123456789")] for rod in robot.graph.rods}
    )


def metric(rec, predicted):
    """Root of the mean square of coordinates, over branches padded with zeros to the length of the longest.

    A branch repeats the marker where it begins; prescribed markers count as zero; summed over the frames from the
    third on, and divided by the number of all frames, as the set does.
    """
    chains = Cables(rec).chains
    off = np.nan_to_num(predicted[0] - rec.markers)
    off[:, rec.prescribed] = 0.0
    slots = 3 * len(chains) * max(len(chain) for chain in chains)
    square = sum((off[2:, chain] ** 2).sum() for chain in chains) / slots
    return np.sqrt(square / len(rec.t))
