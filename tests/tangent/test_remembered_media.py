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


class Filled(rn.DragModel):
    """Drag that grows, by two memories of which the second knows nothing of the first but through the force."""

    memory_size = 2
    memory_frame = "medium"
    cell = 0.02
    default_name = "filled"
    c = rn.Parameter(1.0, unit="Pa s", bounds=(0, None), null=0.0)
    start = rn.Parameter(0.5, unit="1", bounds=(0, None), kind="shape")
    rate = rn.Parameter(0.0, unit="1", bounds=(None, None), null=0.0)
    scale = 1.0  # of the second memory

    def initial_memory(self, site, p):
        return np.array([1.0, 0.0]) * np.ravel(p.start)[0] + np.zeros((len(site.radius), 2))

    def update(self, site, p, m_old):
        speed = np.sqrt(rn.dot(site.v, site.v) + 1e-4)
        grown = np.array([0.3, 0.0]) + np.array([0.0, 30.0 * self.scale]) * np.ravel(p.rate)[0]
        full = (1.0 + m_old[:, :1]) * (1.0 + m_old[:, 1:] / self.scale)
        return -p.c * full * site.v, m_old + speed * site.dt * grown


class FilledElsewhere(Filled):
    scale = 1e6


@pytest.mark.parametrize("law", [Filled, FilledElsewhere])
def test_memories_of_any_size_of_which_some_are_zero_still(law):
    """What is zero has no size of its own; that of the untouched medium is a parameter's."""
    paths = ["filled.c", "filled.start", "filled.rate", "stem.E"]
    check(cable(law()), 0.1, {p: [p] for p in paths}, 5e-6, dt=0.01)


class OnlyGrowing(Filled):
    """What does not grow is left as it was, to the last digit."""

    def update(self, site, p, m_old):
        speed = np.sqrt(rn.dot(site.v, site.v) + 1e-4)
        grown = np.array([0.0, 30.0]) * np.ravel(p.rate)[0]
        return -p.c * (1.0 + m_old[:, 1:]) * site.v, m_old + speed * site.dt * grown


def test_a_medium_in_which_nothing_has_been_left_yet():
    check(cable(OnlyGrowing()), 0.1, {"filled.rate": ["filled.rate"]}, 5e-6, dt=0.01)


class Breaking(Worn):
    """It begins anew where it has grown to a threshold."""

    limit = np.inf

    def settle(self, cells, p, m):
        m = super().settle(cells, p, m)
        m[m[:, 0] > self.limit, 0] *= 0.5
        return m


@pytest.mark.parametrize("short", [0.5, 3e-5, 1e-7])
def test_a_jump_close_by_is_not_felt(short):
    """The derivative is that of the motion that has it, however near the threshold is."""
    robot, seen = cable(Breaking()), []
    sim = rn.Simulation(robot, dt=0.01)
    law = next(b for b in sim.model.bound if b.memory is not None and len(b.memory[0]) == 7)
    for _ in range(6):
        sim.step()
        seen.append(law.field.values[:, 0].max())
    limit = seen[-1] - short * (seen[-1] - seen[-2])
    broken = type("Broken", (Breaking,), {"limit": limit})

    def derivative(values):
        robot = cable(values())
        return rn.sensitivities(robot, 0.07, parameters=["worn.c", "gravity.g", "stem.E"], dt=0.01)

    found = derivative(broken)
    # the same with a threshold halfway into that step, which no difference meets
    far = derivative(type("Broken", (Breaking,), {"limit": seen[-1] - 0.5 * (seen[-1] - seen[-2])}))
    np.testing.assert_array_equal(found.trajectory.x, far.trajectory.x)
    for k in range(3):
        np.testing.assert_allclose(
            found.x[..., k], far.x[..., k], rtol=0.0, atol=1e-7 * np.abs(far.x[..., k]).max()
        )


def test_a_law_of_ones_own_that_is_bound_otherwise_is_differenced():
    """Only what is bound as laws are by default is known here."""
    from rodnet.tangent.remembered_media import MediumTangent
    from rodnet.terms.drag.medium import BoundMediumLaw

    class Halved(BoundMediumLaw):
        def next_memory(self, ev):
            memory = super().next_memory(ev)
            memory[1:, 3:] *= 0.5
            return memory

    class Other(Worn):
        def bind(self, model):
            bound = super().bind(model)
            bound.__class__ = Halved
            return bound

    assert not any(MediumTangent.knows(b) for b in Model(cable(Other())).bound)
    check(cable(Other()), 0.1, {"worn.c": ["worn.c"], "worn.path": ["worn.path"]}, 5e-6, dt=0.01)
