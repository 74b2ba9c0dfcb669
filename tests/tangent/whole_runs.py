"""Differences of whole runs, which the tangent must agree with."""

from itertools import pairwise

import numpy as np

import rodnet as rn

ROUND_OFF = rn.Tolerance(residual=1e-13, update=1e-15, iterations=60)


def last(robot, duration, tolerance=ROUND_OFF, **options):
    """Positions, velocities and twists at the end of a run."""
    sim = rn.Simulation(robot, tolerance=tolerance, **options)
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


def by_one(robot, path, run, here, parts, relative=1e-4, limit=1e-5):
    """Difference quotient of second order of ``run(robot)`` by one parameter, and how far from it a derivative may be.

    That is ``limit`` of the largest entry of its kind, and what round-off in the runs amounts to; ``here`` is
    the run with the parameter as it is.
    """
    parameter = robot.parameters[path]
    value, (low, high) = float(parameter.value), parameter.bounds
    step = relative * (abs(value) or 1.0)
    near = lambda change: run(robot.with_parameters({path: value + change}))  # noqa: E731
    if low <= value - step and value + step <= high:
        expected = (near(step) - near(-step)) / (2.0 * step)
    else:
        step = step if value + 2.0 * step <= high else -step
        expected = (-3.0 * here + 4.0 * near(step) - near(2.0 * step)) / (2.0 * step)
    allowed = np.empty_like(expected)
    for a, b in pairwise(np.cumsum([0, *parts])):
        allowed[a:b] = limit * np.abs(expected[a:b]).max() + 1e-12 * np.abs(here[a:b]).max() / abs(step)
    return expected, allowed


def error(found, expected, parts):
    """Largest difference against the largest value, each kind of quantity for itself, but for what is round-off."""
    ends, least = np.cumsum([0, *parts]), 1e-7 * np.abs(expected).max()
    return max(
        np.abs(found[a:b] - expected[a:b]).max() / np.abs(expected[a:b]).max()
        for a, b in pairwise(ends)
        if np.abs(expected[a:b]).max() > least
    )


def parts(robot):
    """How many positions, velocities, twists and rates there are."""
    n, e = 3 * robot.graph.node_count, robot.graph.edge_count
    return n, n, e, e
