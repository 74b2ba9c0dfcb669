"""Memory that the medium holds: what stays in its place when rods move on."""

from __future__ import annotations

import pickle

import cloudpickle
import numpy as np
import pytest

import rodnet as rn
from rodnet.terms.drag.medium import Field
from rodnet.testing.check_term import network

LENGTH = 0.02  # of the path that the memory counts in


class Trodden(rn.DragModel):
    """Drag that grows with the path of rods through a place."""

    memory_size = 1
    memory_frame = "medium"
    cell = 0.01
    example_memory = (3.0,)
    default_name = "trodden"
    c = rn.Parameter(2.0, unit="Pa s", bounds=(0, None), null=0.0)
    claims = {"dissipative", "objective"}

    def update(self, site, p, m_old):
        m = m_old + rn.norm(site.v) * site.dt / LENGTH
        return -p.c * (1.0 + m) * site.v, m


class Fading(Trodden):
    """The same, which spreads and is forgotten."""

    def diffusivity(self, p):
        return 2e-5

    def settle(self, cells, p, m):
        return m * np.exp(-cells.dt / 0.3)


class WithDerivatives(Trodden):
    wrong = 1.0

    def jacobian(self, site, p, m_old):
        v, speed = site.v, np.maximum(rn.norm(site.v), 1e-300)
        m = m_old + speed * site.dt / LENGTH
        by_m = -p.c * v[:, :, None]
        by_speed = by_m * (v / speed)[:, None, :] * site.dt / LENGTH
        by_v = by_speed - np.asarray(p.c * (1.0 + m))[:, :, None] * np.eye(3)
        none = np.zeros((len(v), 3, 3))
        return {"v": by_v, "tangent": none, "x": none, "memory": self.wrong * by_m}


def field(size=0.01, columns=1):
    return Field(size, np.zeros(columns), np.zeros(0, np.int64), np.zeros((0, columns)))


# -- the field -----------------------------------------------------------------------------
def test_a_linear_field_is_interpolated_exactly():
    rng = np.random.default_rng(0)
    x = rng.uniform(-0.03, 0.03, (50, 3))
    f = field().deposited(x, np.ones((50, 1)))
    slope = np.array([3.0, -1.0, 2.0])
    f.values[:, 0] = f.indices() * f.size @ slope
    value, gradient = f.gather(x)
    assert value[:, 0] == pytest.approx(x @ slope, abs=1e-15)
    assert gradient[:, 0] == pytest.approx(np.tile(slope, (50, 1)), rel=1e-12)


def test_the_gradient_is_the_derivative_and_continuous_from_cell_to_cell():
    rng = np.random.default_rng(1)
    f = field(columns=2).deposited(rng.uniform(-0.03, 0.03, (40, 3)), rng.normal(size=(40, 2)))
    x, h = rng.uniform(-0.02, 0.02, (20, 3)), 1e-6
    gradient = f.gather(x)[1]
    for a in range(3):
        step = h * np.eye(3)[a]
        slope = (f.gather(x + step)[0] - f.gather(x - step)[0]) / (2.0 * h)
        assert gradient[:, :, a] == pytest.approx(slope, rel=1e-4, abs=1e-5 * np.abs(gradient).max())
    x[:, 0] = 0.005  # between two cells, where the sites' 27 cells change
    before, after = (f.gather(x + sign * np.array([1e-9, 0, 0])) for sign in (-1.0, 1.0))
    for a, b in zip(before, after, strict=True):
        assert a == pytest.approx(b, abs=1e-6 * np.abs(a).max())


def test_what_is_deposited_is_conserved_and_stays_at_its_place():
    rng = np.random.default_rng(2)
    x, amount = rng.uniform(-0.1, 0.1, (30, 3)), rng.uniform(0.0, 2.0, (30, 1))
    f = field().deposited(x[:10], amount[:10]).deposited(x[10:], amount[10:])
    assert f.values.sum() == pytest.approx(amount.sum(), rel=1e-14)
    assert (f.values * f.indices() * f.size).sum(axis=0) == pytest.approx((amount * x).sum(axis=0), rel=1e-12)
    assert np.all(np.diff(f.codes) > 0) and len(f.codes) < 30 * 27


def test_diffusion_conserves_and_spreads_as_it_must():
    """The variance along each axis grows by 2 D t."""
    f, D = field().deposited(np.zeros((1, 3)), np.ones((1, 1))), 3e-5
    spread = lambda f: (f.values * (f.indices() * f.size) ** 2).sum(axis=0)  # noqa: E731
    start = spread(f)
    for _ in range(40):
        f = f.diffused(np.array([D]), 0.1)
    assert f.values.sum() == pytest.approx(1.0, rel=1e-12)
    assert spread(f) - start == pytest.approx(2.0 * D * 4.0, rel=1e-3)


# -- laws ----------------------------------------------------------------------------------
@pytest.mark.parametrize("law", [Trodden, Fading, WithDerivatives])
def test_laws_pass(law):
    report = rn.testing.check_term(law)
    assert {"untouched medium", "disturb: permutation", "Jacobian by position"} <= set(report.errors)


def test_wrong_laws_fail():
    class WrongMemory(WithDerivatives):
        wrong = 1.1

    class Growing(Trodden):
        def settle(self, cells, p, m):
            return m + cells.dt

    class Layered(Trodden):
        def initial_memory(self, site, p):
            return site.x[:, 2:]

    class Ordered(Trodden):
        def disturb(self, site, p, m):
            return np.arange(len(m), dtype=float)[:, None]

    class Thinning(Trodden):
        def diffusivity(self, p):
            return -1.0

    for law, message in (
        (WrongMemory, "'Jacobian by position'"),
        (Growing, r"settle\(\) changes a medium that no rod has touched"),
        (Layered, "must be alike at all sites"),
        (Ordered, "'disturb: permutation'"),
        (Thinning, r"'diffusivity'.*not negative"),
    ):
        with pytest.raises(rn.TermError, match=message):
            rn.testing.check_term(law)


def test_bad_input():
    class NoCell(Trodden):
        cell = None

    class NoMemory(Trodden):
        memory_size = 0

    class Elsewhere(Trodden):
        memory_frame = "air"

    class InBody(Trodden):
        memory_frame = "body"

    for law, options, message in (
        (NoCell, {}, r"NoCell: give cell=, the edge of the medium's cells \[m\]"),
        (NoMemory, {}, "set memory_size"),
        (Elsewhere, {}, "'air' must be 'body' or 'medium'"),
        (InBody, {"cell": 0.01}, "cell= is for laws with memory_frame = 'medium'"),
        (Trodden, {"cell": -1.0}, "cell = -1.0 must be a positive length"),
        (Trodden, {"cell": np.nan}, "cell = nan must be a positive length"),
        (Fading, {"c": np.ones(14)}, "Fading: c must be a single number"),
    ):
        with pytest.raises(rn.TermError, match=message):
            rn.Simulation(rn.Robot(network(), [law(**options)]))


# -- robots --------------------------------------------------------------------------------
def pulled(law, on="*", speed=0.05):
    """A stiff rod that is led sideways, out and back, once a second."""
    figure = rn.StickFigure()
    figure.rod("rod", [(0, 0, 0), (0.04, 0, 0)], edges=2, material=rn.Material(E=1e9), radius=2e-3)

    def lead(t):
        return np.array([0.0, speed * np.sin(np.pi * t) ** 2, 0.0])

    held = rn.PrescribedMotion(at="rod:0-1", position=lead, orientation=lambda t: np.eye(3))
    return rn.Robot(figure.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), law(on=on), held])


def test_a_rod_meets_its_own_track():
    """On the way back it meets the memory of the way out; the medium has counted its path."""
    traj = rn.Simulation(pulled(Trodden), dt=5e-3).run(1.0)
    path = np.abs(np.diff(traj.x[:, :, 1], axis=0)).sum(axis=0) @ [0.01, 0.02, 0.01]
    cells, memory = traj.medium("trodden")
    assert memory.sum() * Trodden.cell**3 == pytest.approx(Trodden.cell**2 * path / LENGTH, rel=1e-9)
    assert cells[:, 1].max() > 0.05 and memory[cells[:, 1] > 0.03].max() > 0.5  # left behind
    drag = np.abs(traj.term_forces("trodden")[:, :, 1].sum(axis=1))
    way_out, way_back = drag[50], drag[150]  # at the same place and speed
    assert traj.x[50, 0, 1] == pytest.approx(traj.x[150, 0, 1], abs=1e-12)
    assert way_back > 1.15 * way_out


def test_a_track_does_not_follow_its_rod():
    """Beside the track the same motion meets the untouched medium: far less than memory of the body's own."""

    class Tired(Trodden):
        memory_frame, cell = "body", None

    far = lambda law: np.abs(  # noqa: E731
        rn.Simulation(pulled(law, speed=0.4), dt=5e-3).run(0.5).term_forces("trodden", -16)[..., 1].sum()
    )
    assert far(Tired) > 3.0 * far(Trodden)


def test_powers_balance_when_a_record_is_evaluated_again():
    figure = rn.StickFigure()
    figure.rod("rod", [(0, 0, 0), (0.1, 0, 0.02)], edges=6, material=rn.Material(E=1e6), radius=2e-3)
    robot = rn.Robot(
        figure.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), Fading(c=0.5)]
    )
    traj = rn.Simulation(robot, dt=5e-3).run(0.3)
    powers = traj.powers
    total = sum(p for name, p in powers.items() if name != "kinetic")
    assert total[1:] == pytest.approx(powers["kinetic"][1:], abs=1e-6 * np.abs(powers["trodden"]).max())
    assert powers["trodden"][-1] < 0.0


@pytest.mark.parametrize("stepper", ["euler", "sdirk2", "alpha"])
def test_a_restart_is_bit_equal(tmp_path, stepper):
    """In a network with joints, from a file whose frames hold more and more cells."""
    robot = rn.Robot(
        network(),
        [
            rn.Stretching(),
            rn.Bending(),
            rn.Twisting(),
            rn.Gravity(),
            rn.ResistiveForce(viscosity=0.5),
            Fading(),
        ],
    )
    start = lambda: rn.Simulation(robot, dt=5e-3, stepper=stepper)  # noqa: E731
    whole = start().run(0.1)
    file = tmp_path / "run.nc"
    start().run(0.05, out=file)
    sim = start()
    sim.restore(rn.Trajectory.load(file, robot).state())
    rest = sim.run(0.05, out=file, append=True)
    again = rn.Trajectory.load(file, robot)
    for k in (1, 10, 15, -1):
        states = whole.state(k), rest.state(k), again.state(k)
        for other in states[1:]:
            assert np.array_equal(states[0].q, other.q)
            assert np.array_equal(states[0].memories[-1], other.memories[-1])
    assert len(whole.state(-1).memories[-1]) > len(whole.state(1).memories[-1]) > 27
    assert np.array_equal(whole.medium("trodden", 15)[1], again.medium("trodden", 15)[1])
    assert whole.save(tmp_path / "whole.nc").exists()
    saved = rn.Trajectory.load(tmp_path / "whole.nc", robot).state(3)
    assert np.array_equal(saved.memories[-1], whole.state(3).memories[-1])


def test_a_rejected_step_leaves_the_medium_as_it_was():
    sim = rn.Simulation(pulled(Trodden), dt=0.01)
    sim.run(0.2)
    before = sim.model.bound[3].memory.copy()
    new, report = sim.newton.step(sim.state, sim.stepper, 3.2, 3.0, sim.observe().sensors, {})
    sim.restore(sim.state)
    sim.step()
    other = rn.Simulation(pulled(Trodden), dt=0.01)
    other.run(0.21)
    assert np.array_equal(other.state.memories[3], sim.state.memories[3])
    assert not np.array_equal(before, sim.state.memories[3])
    assert new is None or report.ok


def test_robots_with_a_medium_can_be_sent_to_other_processes():
    robot = pickle.loads(cloudpickle.dumps(pulled(Fading)))
    one, two = (rn.Simulation(r, dt=0.01).run(0.1) for r in (robot, pulled(Fading)))
    assert np.array_equal(one.medium("trodden")[1], two.medium("trodden")[1])


def test_there_is_no_medium_where_no_law_has_one():
    traj = rn.Simulation(pulled(Trodden), dt=0.01).run(0.02)
    with pytest.raises(rn.OutputError, match="'drag' has no memory that the medium holds; that is 'trodden'"):
        traj.medium("drag")
