"""Friction of tendons: Coulomb's limits, pre-sliding, and no energy from it, whatever the tension does meanwhile."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.terms.tendon_friction import chain, drop
from tests.mechanics.beams import elastic

MU, REACH = 0.4, 1e-4


def run(tensions, turns, slips, substeps=1):
    """Drops and work at one eyelet along a history; slips are increments, each taken in some steps."""
    f, k, out = 0.0, 0.0, np.empty(10)
    drops, works, stored = [], [], []
    work = 0.0
    for T, turn, s in zip(tensions, turns, slips, strict=True):
        for _ in range(substeps):
            drop(T, turn, MU, f, k, s / substeps, REACH, out)
            f, k = out[0], out[6]
            work += f * s / substeps
        drops.append(f)
        works.append(work)
        stored.append(0.0 if k == 0.0 else f**2 / (2.0 * k))
    return np.array(drops), np.array(works), np.array(stored)


def test_it_slides_at_the_limits_of_euler_and_eytelwein():
    drops, *_ = run([3.0, 3.0], [0.7, 0.7], [1.0, -1.0])
    assert 3.0 - drops[0] == pytest.approx(3.0 * np.exp(-MU * 0.7), rel=1e-12)
    assert 3.0 - drops[1] == pytest.approx(3.0 * np.exp(MU * 0.7), rel=1e-12)


def test_a_reversal_takes_the_reach():
    """Dahl: from one limit the drop goes to the other as exp(-s / reach), at first by C (1 + C-/C+) / reach."""
    ahead, back = 3.0 * (1 - np.exp(-MU * 0.7)), 3.0 * (np.exp(MU * 0.7) - 1)
    for way in (0.1, 1.0, 3.0):
        drops, *_ = run([3.0, 3.0], [0.7, 0.7], [1.0, -way * REACH])
        assert drops[1] == pytest.approx((ahead + back) * np.exp(-way * ahead / back) - back, rel=1e-12)
    in_steps, *_ = run([3.0, 3.0], [0.7, 0.7], [1.0, -REACH], substeps=50)
    assert in_steps[1] == pytest.approx((ahead + back) * np.exp(-ahead / back) - back, rel=1e-12)


def test_tightening_between_a_slip_and_its_reversal_gives_nothing_back():
    """The cycle that an unchanging share of the limit turns into a motor: about reach times the rise of the limit."""
    n = 50
    tensions, slips = np.tile([1.0, 10.0], n), np.tile([0.3 * REACH, -0.3 * REACH], n)
    _, works, stored = run(tensions, np.full(2 * n, 0.5), slips, substeps=200)
    assert np.all(works >= stored - 1e-9 * REACH)
    assert works[-1] > works[1] > 0.0


def test_over_any_history_the_work_done_against_friction_is_at_least_what_is_stored():
    rng = np.random.default_rng(3)
    for trial in range(40):
        n = 300
        tensions = 10.0 ** rng.uniform(-3, 1, n) * (rng.random(n) > 0.1)
        turns = rng.uniform(0.0, 2.0, n) * (rng.random(n) > 0.1)
        slips = REACH * rng.normal(size=n) * 10.0 ** rng.uniform(-3, 1, n) * (rng.random(n) > 0.1)
        drops, works, stored = run(tensions, turns, slips)
        assert np.all(np.diff(works, prepend=0.0) >= np.diff(stored, prepend=0.0) - 1e-12 * works[-1]), trial
        assert np.all(drops <= tensions * (1 - np.exp(-MU * turns)) * (1 + 1e-12) + 1e-15)
        assert np.all(drops >= -tensions * (np.exp(MU * turns) - 1) * (1 + 1e-12) - 1e-15)


def test_closed_cycles_of_a_whole_tendon_cost_energy():
    """Eyelets in a row feel each other's drops; the tension at the drive and the shape go round at random."""
    rng, n = np.random.default_rng(4), 6
    phase = np.linspace(0.0, 2 * np.pi, 400)
    for _ in range(5):
        a, b = rng.normal(size=(2, 3, n))
        path = lambda k, p=a, q=b: p[k][:, None] * np.cos(phase) + q[k][:, None] * np.sin(phase)  # noqa: E731
        lengths, turns = 0.1 + 2 * REACH * path(0), np.abs(path(1))[: n - 1]
        base = np.abs(path(2))[0]
        old, stiff = np.zeros((2, n - 1))
        before, cycles = lengths[:, 0], []
        for _ in range(3):
            work = 0.0
            for k in range(len(phase)):
                slips = np.cumsum((before - lengths[:, k])[::-1])[::-1][1:]
                tension, force, new = np.empty(n), np.empty(n - 1), np.empty(n - 1)
                chain(
                    base[k],
                    turns[:, k],
                    MU,
                    old,
                    stiff,
                    slips,
                    REACH,
                    tension,
                    force,
                    new,
                    False,
                    np.empty((n, 2 * n)),
                )
                # the drive pays for what the tendon's segments do not give to the robot
                work += (base[k] - tension) @ (before - lengths[:, k])
                assert tension.min() >= 0.0
                old, stiff, before = force, new, lengths[:, k]
            cycles.append(work)
        assert cycles[1] > 0.0
        assert cycles[2] == pytest.approx(cycles[1], rel=0.02)  # it goes round in nearly the same loop


@pytest.mark.parametrize("drive", ["tension", "pull"])
def test_an_arm_that_is_shaken_while_its_tendon_is_tightened_and_let_go_never_gains(drive):
    """Small reversals within the reach, the tendon's tension changing by the same clock."""
    L, R, h = 0.2, 2e-3, 0.01
    EI = 1e9 * np.pi / 4 * R**4
    figure = rn.StickFigure()
    figure.rod(
        "arm", [(0, 0, 0), (L, 0, 0)], edges=6, material=rn.Material(E=1e9), radius=R, director=(0, 0, 1.0)
    )
    size = {"tension": 0.5 * EI / L / h} if drive == "tension" else {"pull": 0.004, "stiffness": 1e3}
    tendon = rn.Tendon(route=[("arm", (h, 0.0))], friction=MU, reach=5e-4, **size,
                       schedule=lambda t: 1.0 + 0.4 * np.sin(2 * np.pi * t))  # fmt: skip
    shake = rn.PointForce(at="arm.end", force=lambda t: (0, 0, 0.1 * EI / L**2 * np.cos(2 * np.pi * t)))
    terms = [*elastic(), rn.Clamp(at="arm.start"), rn.KelvinVoigt(bend=0.05), tendon, shake]
    traj = rn.Simulation(rn.Robot(figure.build(), terms), 0.02).run(4.0)
    tensions, n = tendon.tensions(traj), 6
    memory = np.array([traj.state(k).memories[5] for k in range(len(traj))])
    lengths = memory[:, 1 + 2 * (n - 1) : 1 + 2 * (n - 1) + n]
    loss = np.sum((tensions[1:, :1] - tensions[1:]) * -np.diff(lengths, axis=0), axis=1)
    drops, stiffness = memory[:, 1:n], memory[:, n : 2 * n - 1]
    stored = np.sum(drops**2 / (2 * np.maximum(stiffness, 1e-12)), axis=1)  # none in a straight tendon
    assert np.all(np.cumsum(loss) >= np.diff(stored).cumsum() - 1e-12)
    cycle = round(1.0 / 0.02)
    assert loss[-cycle:].sum() > 0.0
