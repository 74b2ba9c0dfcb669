"""Beams with a joint, and the kinematics of rigid linkages on paper."""

import numpy as np

import rodnet as rn
from rodnet.kinematics.frames import rotation
from tests.mechanics.beams import MATERIAL, L, R, elastic

ROD = {"material": MATERIAL, "radius": R}

BARS = 0.04, 0.1, 0.08, 0.09  # crank, coupler, rocker, ground: the crank turns all round


def four_bar(angle, crank, coupler, rocker, ground):
    """Ends of crank and coupler of an open linkage in the plane z = 0, by the intersection of two circles."""
    a = crank * np.array([np.cos(angle), np.sin(angle), 0.0])
    to = np.array([ground, 0.0, 0.0]) - a
    d = np.linalg.norm(to)
    along = (d * d + coupler**2 - rocker**2) / (2 * d)
    return a, a + along * to / d + np.sqrt(coupler**2 - along**2) * np.cross([0.0, 0.0, 1.0], to / d)


def beams(n, kind, loads, length=L, **joint):
    """Two beams in line along x, joined in the middle, the first one clamped."""
    figure = rn.StickFigure()
    figure.rod("one", [(0, 0, 0), (length / 2, 0, 0)], edges=n // 2, **ROD)
    figure.rod("two", ["one.end", (length, 0, 0)], edges=n // 2, **ROD)
    if kind:
        figure.joint("one.end", kind=kind, **joint)
    return rn.Robot(figure.build(), [*elastic(), rn.Clamp(at="one.start"), *loads])


def turned(robot, direction, angle):
    """Equilibria on the way, while the first edge of "two" is turned about a direction."""
    motion = rn.PrescribedMotion(at="two:0-1", orientation=lambda t: rotation(angle * t * direction))
    robot, state, found = robot.with_terms(motion), None, []
    for t in np.arange(1, 7) / 6:
        found.append(rn.equilibrium(robot, t=t, start=state, residual=1e-10))
        state = found[-1].state()
    return found
