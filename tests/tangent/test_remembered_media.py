"""A medium that remembers in cells what rods did to its places: derivatives of runs in it."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.solve.model import Model
from rodnet.tangent.memories import followed
from tests.tangent.test_whole_runs import STEPPERS, cable, check


class Worn(rn.DragModel):
    """Drag that grows by work where rods pass, most where they are close and cross, spreads, and is forgotten."""

    memory_size = 2
    memory_frame = "medium"
    cell = 0.02
    default_name = "worn"
    c = rn.Parameter(1.0, unit="Pa s", bounds=(0, None), null=0.0)
    path = rn.Parameter(0.02, unit="m", bounds=(1e-6, None), kind="shape")
    near = rn.Parameter(0.08, unit="m", bounds=(1e-6, None), kind="shape")
    time = rn.Parameter(0.3, unit="s", bounds=(1e-6, None), kind="shape")

    def update(self, site, p, m_old):
        along = rn.dot(site.v, site.tangent) * site.tangent
        m = m_old[:, :1] + np.sqrt(rn.dot(site.v, site.v) + 1e-4) * site.dt / p.path
        crowd = 1.0 + 0.5 * m_old[:, 1:]
        force = -p.c * (1.0 + m) * crowd * (site.v - 0.5 * along) * site.radius[:, None] / 4e-3
        return force, np.concatenate([m, m_old[:, 1:]], axis=1)

    def disturb(self, site, p, m):
        d = site.x[:, None] - site.x
        size = float(np.ravel(p.near)[0])
        count = np.exp(-np.sum(d**2, axis=2) / size**2) @ site.length / size
        return np.stack([np.zeros(len(m)), site.dt * count], axis=1)

    def diffusivity(self, p):
        return 1e-4, 0.0

    def settle(self, cells, p, m):
        return m * np.exp(-cells.dt / p.time)


@pytest.mark.parametrize("stepper", STEPPERS)
def test_a_cable_that_swings_in_it(stepper):
    robot = cable(Worn())
    paths = [
        "worn.c",
        "worn.path",
        "worn.near",
        "worn.time",
        "stem.E",
        "left.radius",
        "stem.length",
        "gravity.g",
    ]
    lift = {"x": np.outer(robot.graph.x0[:, 0] ** 2, [0.0, 0.3, 0.2])}
    # cells are weighed by splines whose second derivatives jump: longer quotients of runs are off by that
    check(robot, 0.1, {p: [p] for p in paths}, 5e-6, {"lift": lift}, 1e-4, dt=0.01, stepper=stepper)


def test_its_memory_is_followed_and_not_differenced():
    robot = cable(Worn())
    model = Model(robot)
    assert all(k in followed(model) for k, b in enumerate(model.bound) if b.memory is not None)
    found = rn.sensitivities(robot, 0.05, parameters=["worn.c", "stem.E"], dt=0.01)
    assert np.all(np.abs(found.x[-1]).max(axis=(0, 1)) > 0.0)


def test_nodes_averaged_over_two_edges():
    """Sites of nodes have a tangent of two edges."""
    robot = cable(Worn(tangent="node"))
    check(robot, 0.1, {p: [p] for p in ("worn.c", "stem.E", "stem.length")}, 5e-6, None, 1e-4, dt=0.01)
