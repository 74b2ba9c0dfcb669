"""Differences of whole runs, which the tangent must agree with."""

from itertools import pairwise

import numpy as np

import rodnet as rn

ROUND_OFF = rn.Tolerance(residual=1e-13, update=1e-15, iterations=60)


def last(robot, duration, **options):
    """Positions, velocities and twists at the end of a run."""
    sim = rn.Simulation(robot, tolerance=ROUND_OFF, **options)
    *_, view = sim.iterate(duration)
    return np.concatenate([view.x.ravel(), view.v.ravel(), view.theta, view.w])


def at_end(found):
    """The same of a `Sensitivities`, shape (n, k)."""
    k = len(found.names)
    return np.concatenate([a[-1].reshape(-1, k) for a in (found.x, found.v, found.theta, found.w)])


def quotient(run, step):
    """Difference quotient of fourth order of ``run(change)`` at 0."""
    near, far = (run(s * step) - run(-s * step) for s in (1.0, 2.0))
    return (8.0 * near - far) / (12.0 * step)


def by_parameter(robot, paths, duration, relative=1e-3, **options):
    """Difference quotient by parameters that change together."""
    value = float(np.ravel(robot.parameters[paths[0]].value)[0])
    step = relative * (abs(value) or 1.0)

    def run(change):
        return last(robot.with_parameters(dict.fromkeys(paths, value + change)), duration, **options)

    return quotient(run, step)


def error(found, expected, parts):
    """Largest difference against the largest value, each kind of quantity for itself."""
    ends = np.cumsum([0, *parts])
    return max(
        np.abs(found[a:b] - expected[a:b]).max() / np.abs(expected[a:b]).max()
        for a, b in pairwise(ends)
        if np.abs(expected[a:b]).max() > 0.0
    )


def parts(robot):
    """How many positions, velocities, twists and rates there are."""
    n, e = 3 * robot.graph.node_count, robot.graph.edge_count
    return n, n, e, e
