"""Grains that jam: the contract, the mechanisms one by one, and what the paper saw."""

import importlib.metadata
from types import SimpleNamespace

import numpy as np
import pytest

import rodnet as rn

try:
    importlib.metadata.distribution("rodnet-jamming")
except importlib.metadata.PackageNotFoundError:
    pytest.skip(
        "rodnet-jamming is not installed: pip install -e plugins/rodnet-jamming", allow_module_level=True
    )

from rodnet_jamming import Jamming, Yielding, confinement, intermittency, jamming_robot
from rodnet_jamming.law import CONFINED, FLUID, JAM, LOADED, PASSING, POWER
from rodnet_jamming.law import _confinement as count_neighbours

from rodnet.terms.drag.line import LineSites
from rodnet.terms.drag.medium import Cells
from rodnet.terms.drag.resistive import gray_hancock


@pytest.mark.parametrize("law", [Jamming, Yielding])
def test_contract(law):
    rn.testing.check_term(law)
    rn.testing.check_in_robot(law)


def test_rodnet_finds_them():
    records = rn.registry.terms()
    assert records["jamming"].object is Jamming and records["grain-yield"].object is Yielding
    assert rn.registry.robots()["jamming"].object is jamming_robot
    assert {"jamming", "grain-yield"} <= set(rn.registry.candidates())
    for law in (Jamming, Yielding):
        assert all(p.doc and p.unit for p in law.declared().values())


@pytest.mark.parametrize("n_tails", [2, 4])
def test_without_stiffening_and_yield_stress_it_is_resistive_force_theory(n_tails):
    """Bit for bit."""
    null, plain = (
        rn.Simulation(robot).run(0.3)
        for robot in (
            jamming_robot(n_tails, 150.0, edges=8, jam=False),
            rn.robots.flagellated(n_tails, 150.0, edges=8),
        )
    )
    assert np.array_equal(null.x, plain.x) and np.array_equal(null.theta, plain.theta)


def test_bad_input():
    with pytest.raises(rn.TermError, match=r"slenderness = 0\.5 must be above 1"):
        Jamming(slenderness=0.5)
    with pytest.raises(rn.ParameterError, match="Pa"):
        Yielding(yield_stress=-1.0)
    traj = rn.Simulation(jamming_robot(edges=4), 0.05).run(0.2)
    with pytest.raises(rn.ParameterError, match=r"later than start = 0\.1 s; run longer"):
        intermittency(traj, start=0.1)


# -- the mechanisms ------------------------------------------------------------------------
def sites(v, n=1, **options):
    v = np.broadcast_to(np.asarray(v, dtype=float), (n, 3)).copy()
    given = {"x": np.zeros((n, 3)), "tangent": np.tile([1.0, 0, 0], (n, 1)), "radius": np.full(n, 3.2e-3)}
    return LineSites(v=v, length=np.full(n, 4e-3), t=0.0, dt=0.02, **{**given, **options})


def test_work_jams_and_a_jam_stiffens():
    """Dragged across at constant speed, J = 1 - exp(-W/w (C/2 - 1)^2) with the work per volume W."""
    law = Jamming(yield_stress=0.0, work=60.0)
    p, site, m = law.values(), sites((0, 5e-3, 0)), np.array([[0.0, 0.1, 0.1 * 3.0, 0.0, 0.0]])
    C = float(confinement(m)[0, 0])
    eta_n = gray_hancock(p.viscosity, law.slenderness, 1.0)[1]
    dissipated = 0.0
    for _ in range(500):
        resisted = eta_n * (1.0 + p.stiffening * m[0, JAM] ** POWER) * 5e-3
        dissipated += resisted * 5e-3 * site.dt / law.cell**2
        force, m = law.update(site, p, m)
    assert m[0, JAM] == pytest.approx(1.0 - np.exp(-dissipated / 60.0 * (C / 2.0 - 1.0) ** 2), rel=1e-9)
    assert 0.2 < m[0, JAM] < 0.99
    assert force[0] == pytest.approx([0.0, -p.stiffening * m[0, JAM] ** POWER * eta_n * 5e-3, 0.0], rel=1e-12)


def test_grains_that_are_not_confined_do_not_jam():
    law = Jamming()
    m = np.array([[0.0, 0.1, 0.1 * 2.0, 0.0, 0.0]])
    assert law.update(sites((0.1, 0.1, 0)), law.values(), m)[1][0, JAM] == 0.0


def ring(n_tails, radius, edges=20):
    """Straight parallel rods on a circle."""
    s = np.linspace(-0.05, 0.05, edges)
    angle = 2.0 * np.pi * np.arange(n_tails) / n_tails
    x = [(a, radius * np.cos(b), radius * np.sin(b)) for b in angle for a in s]
    length = np.full(edges, s[1] - s[0])
    length[[0, -1]] *= 0.5
    return np.array(x), np.tile(length, n_tails)


@pytest.mark.parametrize("n_tails", [1, 2, 3, 4, 5])
def test_rods_that_confine_are_counted(n_tails):
    """Neighbours at their gap, whatever the mesh; a rod's own sites are none."""
    grain, arch, r = 9.4e-3, 3.0, 3.2e-3
    for edges in (20, 35):
        x, length = ring(n_tails, 0.02, edges)
        rods = np.zeros(len(x))
        tangent = np.tile([1.0, 0.0, 0.0], (len(x), 1))
        count_neighbours(x, tangent, np.full(len(x), r), length, 2 * grain, arch * grain, rods)
        chord = 0.04 * np.sin(np.pi * np.arange(1, n_tails) / n_tails)
        expected = np.sum(1.0 / (1.0 + ((chord - 2 * r) / (arch * grain)) ** 6))
        assert rods[edges // 2] == pytest.approx(expected, rel=0.02)
        assert rods[0] == pytest.approx(0.5 * expected, rel=0.02)
        assert rods.max() <= n_tails - 1


def test_a_jam_yields_as_a_whole_and_heals():
    law = Jamming()
    p, cells = law.values(), Cells(np.zeros((3, 3)), law.cell, 0.0, 0.02)
    m = np.zeros((3, 5))
    m[:, PASSING], m[:2, CONFINED] = 0.1, 0.3
    m[:, LOADED] = 1.0
    m[:, JAM] = 0.30, 0.45, 0.9  # the third is not confined
    assert np.array_equal(law.settle(cells, p, m)[:, JAM], m[:, JAM])
    m[0, JAM] = 0.37
    first = law.settle(cells, p, m)
    assert first[:2, FLUID].tolist() == [1.0, 1.0] and first[2, FLUID] == 0.0
    for _ in range(49):
        m = law.settle(cells, p, m)
    assert m[:2, JAM].max() < 0.02 and m[2, JAM] == 0.9  # what is left behind stays jammed
    assert 0.6 < m[0, FLUID] < 0.8
    assert m[0, FLUID] == pytest.approx(np.exp(-48 * 0.02 / p.healing), rel=1e-12)


@pytest.mark.parametrize("age", [0.0, 5.0, 15.0, 30.0])
@pytest.mark.parametrize("away", [5.0, 3 * Jamming.cell])
def test_a_jam_left_behind_stays(age, away):
    """The one where the rods are yields; one that they have left does not, however lately."""
    law = Jamming()
    p, cells = law.values(), Cells(np.array([[0, 0, 0], [away, 0, 0]]), law.cell, 0.0, 0.01)
    m = np.array([[0.6, 0.5, 1.5, 0.0, 1.0], [0.6, 0.5, 1.5, 0.0, 0.0]])
    m[1, [PASSING, CONFINED]] *= np.exp(-age / p.passing)
    for _ in range(100):
        m = law.settle(cells, p, m)
        m[0, LOADED] = 1.0
    assert m[0, JAM] < 0.01
    assert m[1, JAM] == 0.6 and m[1, FLUID] == 0.0


def test_clusters_yield_on_their_own():
    """A weak one between strong ones does not save them, and they do not take it down."""
    law = Jamming()
    x = np.array([[k * law.cell, y, 0.0] for y in (0.0, 0.1, 0.2) for k in range(0, 6, 2)])
    m = np.tile([0.0, 0.1, 0.3, 0.0, 0.0], (9, 1))
    m[:, LOADED] = np.tile([1.0, 0.0, 1.0], 3)
    m[:, JAM] = 0.7, 0.5, 0.1, 0.5, 0.3, 0.3, 0.0, 0.4, 0.9
    p = law.values()
    order = np.random.default_rng(3).permutation(9)
    for rows in (np.arange(9), order):
        flows = law.settle(Cells(x[rows], law.cell, 0.0, 0.01), p, m[rows])[:, FLUID]
        assert flows.tolist() == np.repeat([1.0, 0.0, 1.0], 3)[rows].tolist()


def test_bundles_far_apart_move_as_each_alone():
    """One is driven hard, the other one gently: neither knows when the other one yields."""

    def moved(*bundles):
        figure = rn.StickFigure()
        loads = []
        for name, y, force in bundles:
            for k in range(3):
                points = [(0, y + 8e-3 * k, 0), (0.05, y + 8e-3 * k, 0)]
                figure.rod(f"{name}{k}", points, edges=4, material=rn.Material(E=5e6), radius=2e-3)
            loads.append(rn.PointForce(at=f"{name}*", force=(force, 0, 0), name=f"pull {name}"))
        law = Jamming(arch=3.0, crowding=0.2, work=0.02, limit=0.4, stiffening=5.0)
        terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), law, rn.ResistiveForce(viscosity=5.0), *loads]
        traj = rn.Simulation(rn.Robot(figure.build(), terms), 0.02).run(2.0, save_every=5)
        cells, memory = traj.medium(law.name)
        found = {}
        for name, y, _ in bundles:
            here = np.abs(cells[:, 1] - y) < 0.5
            found[name] = traj.x[:, traj.rods[f"{name}1"].nodes, 0], memory[here][:, [JAM, FLUID]]
        return found

    fast, slow = ("fast", 0.0, 0.05), ("slow", 1000 * 9.4e-3, 2e-4)
    both = moved(fast, slow)
    for bundle in (fast, slow):
        name = bundle[0]
        for together, alone in zip(both[name], moved(bundle)[name], strict=True):
            assert together == pytest.approx(alone, rel=1e-6, abs=1e-9)
    assert both["fast"][1][:, 1].max() > 0.3  # it has yielded
    assert both["slow"][1][:, 0].max() > 0.1


def test_a_body_creeps_below_the_yield_stress_and_flows_above():
    """A force F on a body of diameter and length d moves it as soon as F > sigma d^2."""
    sigma, d = 0.3, 0.04
    figure = rn.StickFigure()
    figure.rod("body", [(0, 0, 0), (d, 0, 0)], edges=2, material=rn.Material(E=1e6), radius=0.5 * d)
    found = []
    for share in (0.9, 1.1):
        terms = [
            rn.Stretching(), rn.Bending(), rn.Twisting(), Yielding(yield_stress=sigma),
            rn.ResistiveForce(eta_t=50.0, eta_n=50.0),
            *(rn.PointForce(at=f"body:{k}", force=(w * share * sigma * d * d, 0, 0), name=f"f{k}")
              for k, w in enumerate((0.25, 0.5, 0.25))),
        ]  # fmt: skip
        traj = rn.Simulation(rn.Robot(figure.build(), terms), 0.02).run(4.0, save_every=20)
        found.append(float(traj.v[-1, 1, 0]))
    creep, flow = found
    assert creep == pytest.approx(1e-6 * 0.9 / np.sqrt(1.0 - 0.9**2), rel=0.2)
    assert flow == pytest.approx(0.1 * sigma * d / 50.0, rel=0.05)


# -- what the paper saw --------------------------------------------------------------------
def run(n_tails, rpm, duration, **options):
    robot = jamming_robot(n_tails, rpm, edges=12, **options)
    return rn.Simulation(robot, 0.05).run(duration, save_every=4)


def test_four_tails_stop_and_slip():
    """At 208 rpm (Fig. 4c); the jam that they have left is behind them."""
    traj = run(4, 208.0, 30.0)
    found = intermittency(traj, start=8.0)
    assert found.variation > 0.8 and found.stopped > 0.2
    assert 0.2 * 3.7e-4 < found.speed < 3.7e-4  # of resistive force theory
    cells, memory = traj.medium("jam")
    assert memory[:, JAM].max() > 0.2
    behind = traj.x[-1, :, 0].min() - Jamming.cell
    assert cells[memory[:, JAM] > 0.01, 0].min() < behind + 2 * Jamming.cell


def test_two_tails_advance_steadily():
    """At 250 rpm (Fig. 4b)."""
    traj = run(2, 250.0, 20.0)
    found = intermittency(traj, start=12.0)
    assert found.variation < 0.05 and found.stopped == 0.0
    assert found.speed > 3e-4
    assert traj.medium("jam")[1][:, JAM].max() == 0.0


def test_nothing_moves_below_fifty_rpm():
    """But the tails and the head still turn against each other."""
    speeds = {}
    for rpm in (40.0, 80.0):
        moved = [intermittency(run(2, rpm, 10.0, jam=jam), start=6.0) for jam in (True, False)]
        speeds[rpm] = moved[0].speed / moved[1].speed
    assert speeds[40.0] < 0.05
    assert speeds[80.0] > 0.4


def test_a_jamming_robot_restarts_bit_for_bit(tmp_path):
    robot = jamming_robot(4, 208.0, edges=8)
    whole = rn.Simulation(robot, 0.05).run(4.0, save_every=20)
    rn.Simulation(robot, 0.05).run(2.5, save_every=20, out=tmp_path / "run.nc")
    sim = rn.Simulation(robot, 0.05)
    sim.restore(rn.Trajectory.load(tmp_path / "run.nc", robot).state())
    rest = sim.run(1.5, save_every=20)
    assert np.array_equal(rest.x[-1], whole.x[-1])
    for a, b in zip(rest.state().memories, whole.state().memories, strict=True):
        assert (a is None and b is None) or np.array_equal(a, b)


def _mean_jam(traj):
    return {"jam": float(traj.medium("jam")[1][:, JAM].mean()), "x": traj.x[-1, 1, 0]}


def test_a_sweep_in_other_processes():
    """The medium goes with the robot: a worker finds what this process does, and stiffer jams move it otherwise."""
    grid = {"n_tails": 4, "rpm": 208.0, "edges": 8, "jam.stiffening": [50.0, 200.0]}
    found = rn.sweep("jamming", grid, _mean_jam, duration=2.0, dt=0.05, workers=1)
    assert not any(found["error"].values.ravel()), found["error"].values
    here = rn.Simulation(jamming_robot(4, 208.0, edges=8), 0.05).run(2.0, save_every=5)
    assert found["x"].values.ravel()[1] == here.x[-1, 1, 0]
    assert found["jam"].values.ravel()[1] == _mean_jam(here)["jam"] > 0.0
    assert found["x"].values.ravel()[0] != found["x"].values.ravel()[1]


def test_the_yield_stress_is_the_packages_friction_by_another_name():
    """On rods of one radius both are one force of constant size against the motion, and no two explanations."""
    from rodnet.diagnosis.equivalence import contained

    assert "medium-friction" in contained("grain-yield")
    assert {"grain-yield", "medium-friction"} <= set(contained("jamming"))
    radius, speed = 4e-3, 1e-6
    site = SimpleNamespace(v=np.random.default_rng(0).standard_normal((5, 3)), radius=np.full(5, radius))
    pull = Yielding(yield_stress=0.3, speed=speed)
    force = pull.force(site, SimpleNamespace(yield_stress=0.3, speed=speed))
    law = rn.LocalLaw(rate_free=-2.0 * radius * 0.3, creep=speed)
    other = SimpleNamespace(v=site.v, x=0.0 * site.v, tangent=np.eye(3)[[0] * 5], t=0.0)
    p = SimpleNamespace(**{name: parameter.value for name, parameter in law.parameter_items()})
    np.testing.assert_allclose(force, law.force(other, p), rtol=1e-12)
