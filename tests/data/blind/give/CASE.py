"""Rods in a viscous medium, the root of the first in a gripper that moves: a case of the blind benchmark.

Shapes and data sheet come with the recording. Stiffness and viscosity are only roughly known, and in what shape the
rods begin is not.
"""

import numpy as np

import rodnet as rn

EDGES = 20  # of the first rod
GRIPPED = 1e-3  # of the first rod's length: a short edge, so that bending begins at the gripper

free = ["arm0.E", "drag.viscosity"]
per_trial = ["initial.position"]


def along(points, s):
    """Points at shares of the arc length."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return np.stack([np.interp(s * length[-1], length, points[:, k]) for k in range(3)], axis=1), length[-1]


def arms(rec):
    """Drawn points of the arms."""
    return [rec.attrs[f"drawn{k}"] for k in range(sum(name.startswith("drawn") for name in rec.attrs))]


def tied_to_first(name):
    """Of one material."""
    return lambda values: values[f"arm0.{name}"]


tied = {}


def build(rec):
    """Return the rods as drawn, the gripper's motion smoothed by no more than its noise."""
    figure = rn.StickFigure()
    material = rn.Material(E=rec.attrs["young"], nu=0.5, rho=rec.attrs["density"])
    drawn = arms(rec)
    _, size = along(drawn[0], np.zeros(1))
    for k, shape in enumerate(drawn):
        _, length = along(shape, np.zeros(1))
        count = max(4, round(EDGES * length / size))
        points = along(shape, np.linspace(0.0, 1.0, count + 1))[0]
        if k == 0:
            held = along(shape, np.array([GRIPPED]))[0]
            nodes = [points[0], held[0], *points[1:]]
        else:
            parent, at = rec.attrs[f"joined{k}"]
            joint = round(EDGES * at) + 1
            nodes = [f"arm{int(parent)}:{joint}", *points[1:]]
        figure.rod(f"arm{k}", nodes, material=material, radius=rec.attrs["radius"])
    grip = rn.smooth_motion(rec.t, rec.channels["grip"], rec.attrs["grip_noise"])
    turn = rn.smooth_rotation(rec.t, rec.channels["turn"], rec.attrs["turn_noise"])
    first = grip(float(rec.t[0]))
    return rn.Robot(
        figure.build(),
        [
            rn.Stretching(),
            rn.Bending(),
            rn.Twisting(),
            rn.ResistiveForce(viscosity=rec.attrs["viscosity"], length=size, name="drag"),
            rn.PrescribedMotion(
                at="arm0:0-1", name="grip", position=lambda t: grip(t) - first, orientation=turn
            ),
        ],
    )


def observe(rec, robot):
    """Markers, named by where they are."""
    return rn.Markers(robot, list(rec.names))


def options(rec, robot):
    """A step of 10 ms, of second order."""
    return {"dt": 0.01, "stepper": "sdirk2"}
