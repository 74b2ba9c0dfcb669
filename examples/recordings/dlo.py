"""A cable held at both ends by robots and moved: one case for every set of this format.

    rodnet evaluate examples/recordings/dlo.py --recordings DLO3/*.npz
    rodnet calibrate examples/recordings/dlo.py --recordings DLO3/*.npz --out fit

What the recording says: markers along the cable, and which of them the grippers hold. What nobody wrote
down is its mass, diameter and stiffness; of these, motion shows EI per mass alone, so radius and density are
fixed here and E is free. Where it begins, and how fast, is measured to 0.03 mm and 4 mm/s in the first two frames:
nothing of that is fitted, for it would bend to whatever else the model lacks.
"""

import numpy as np

import rodnet as rn
from rodnet.robots import Cables

RADIUS, DENSITY = 4e-3, 1100.0  # [m], [kg/m^3]: conventions, see above
EDGES_PER_METRE, DT = 25.0, 1e-2  # [1/m], [s]
# near those of two such cables; a calibration begins here
STIFFNESS, RATE, RETARDATION = 1.8e7, 0.3, 0.12  # [Pa], [1/s], [s]

free = ["cable.E", "mass_damping.rate", "damping.bend"]
noise = 0.01  # [m] straight isotropic rods are off by some cm: plain least squares of positions, as errors are scored
metric_name = "L1 (m)"


def build(rec):
    """Return a straight isotropic cable in gravity, held and moved as recorded."""
    cables = Cables(rec, EDGES_PER_METRE)
    material = rn.Material(E=STIFFNESS, nu=0.4, rho=DENSITY)
    retardation = rn.Parameter(RETARDATION, unit="s", bounds=(0.0, 10.0), null=0.0)
    return rn.Robot(
        cables.figure(material, RADIUS).build(),
        [
            rn.Stretching(),
            rn.Bending(),
            rn.Twisting(),
            rn.Gravity(g=9.81),
            rn.MassDamping(rate=RATE),
            rn.KelvinVoigt(bend=retardation, twist=retardation),
            *cables.held(twist="no-spin"),
        ],
    )


def observe(rec, robot):
    """Every marker is a node."""
    return rn.Markers(robot, Cables(rec, EDGES_PER_METRE).points)


def options(rec, robot):
    """It moves from the first frame on; a second-order stepper, for it swings."""
    return {"dt": DT, "stepper": "sdirk2", "velocity": Cables(rec, EDGES_PER_METRE).velocity}


def metric(rec, predicted):
    """Mean of |prediction - measurement| over all markers and coordinates, the prescribed ones included as zero.

    Summed over the frames from the third on, and divided by the number of all frames, as the set does.
    """
    off = np.abs(predicted[0] - rec.markers)
    off[:, rec.prescribed] = 0.0
    return np.nanmean(off[2:], axis=(1, 2)).sum() / len(rec.t)
