"""Rods in a viscous medium, held and moved, spun by a motor, or bent by a tendon: a case of the blind benchmark.

Shapes and data sheet come with the recording. Stiffness and viscosity are only roughly known, and in what shape the
rods begin is not.
"""

from pathlib import Path

import numpy as np

import rodnet as rn

EDGES = 20  # of the first rod
TENDON = 4e-3  # beside the axis, along the first director [m]
GRIPPED = 1e-5  # of the first rod's length: so short an edge that bending begins at the gripper

free = ["arm0.E", "drag.viscosity"]
per_trial = ["initial.position"]


def along(points, s):
    """Points at shares of the arc length."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return np.stack([np.interp(s * length[-1], length, points[:, k]) for k in range(3)], axis=1), length[-1]


def arms(rec):
    """Drawn points of the arms."""
    return [rec.attrs[f"drawn{k}"] for k in range(sum(name.startswith("drawn") for name in rec.attrs))]


def first(values):
    """All rods are of one material."""
    return values["arm0.E"]


RODS = 1
tied = {f"arm{k}.E": first for k in range(1, RODS)}


def build(rec):
    """Return the rods as drawn."""
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
    return rn.Robot(
        figure.build(),
        [
            rn.Stretching(),
            rn.Bending(),
            rn.Twisting(),
            rn.ResistiveForce(viscosity=rec.attrs["viscosity"], length=size, name="drag"),
            *driven(rec),
        ],
    )


def driven(rec):
    """What holds and drives the root; the gripper's motion smoothed by no more than its noise."""
    if "rpm" in rec.attrs:
        return [rn.Clamp(at="arm0:0-1"), rn.Motor(at="arm0:1", rpm=rec.attrs["rpm"])]
    if "tension" in rec.attrs:
        frequency = rec.attrs["frequency"]
        tendon = rn.Tendon(
            route=[
                ("arm0:0", (TENDON, 0.0)),
                (f"arm0:2-{EDGES + 1}", (TENDON, 0.0)),
            ],  # an edge so short would fold it
            tension=rec.attrs["tension"],
            schedule=lambda t: np.sin(np.pi * frequency * t) ** 2,
        )
        return [rn.Clamp(at="arm0:0-1"), tendon]
    grip = rn.smooth_motion(rec.t, rec.channels["grip"], rec.attrs["grip_noise"])
    turn = rn.smooth_rotation(rec.t, rec.channels["turn"], rec.attrs["turn_noise"])
    moved = grip - grip(float(rec.t[0]))
    return [rn.PrescribedMotion(at="arm0:0-1", name="grip", position=moved, orientation=turn)]


def drives(rec):
    """What could be tried next: the trials planned in a folder beside this file."""
    files = sorted((Path(__file__).parent / "plans").glob("plan_*.npz"))
    return rn.read_recordings([str(p) for p in files]) if files else []


def observe(rec, robot):
    """Markers, named by where they are."""
    return rn.Markers(robot, list(rec.names))


def options(rec, robot):
    """A step of 10 ms, of second order."""
    return {"dt": 0.01, "stepper": "sdirk2"}
