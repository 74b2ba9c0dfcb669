"""The next experiment: the trial that tells two explanations apart, and starts that differ from what was drawn."""

from dataclasses import replace

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.candidate import candidates
from rodnet.diagnosis.design import Proposal, from_all, propose
from rodnet.diagnosis.scales import change_sigma
from rodnet.diagnosis.workbench import Workbench
from rodnet.errors import DisplacedStartError
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken


def still(rec, frequency, name):
    """A trial that has not been recorded: what is commanded, and markers where they are drawn."""
    attrs = {"amplitude": 0.06, "frequency": frequency, "lift": 0.4}
    points = np.broadcast_to(rec.markers[0], rec.markers.shape)
    return rn.Recording(rec.t, points, names=list(rec.names), name=name, attrs=attrs)


@pytest.mark.parametrize("broken", [False, True])
def test_the_trial_that_differs_most_is_proposed(broken):
    """Inertia and weight: a fast trial tells them apart, a slow one does not; what can't be simulated is left out."""
    rec = shaken.record(0)
    menu = [still(rec, 0.2, "slow"), still(rec, np.nan if broken else 2.5, "fast")]
    heard = []
    case = replace(shaken.CASE, drives=lambda rec: menu)
    bench = Workbench.of(case, [rec], Serial(), shaken.SIGMA, tell=heard.append)
    rec, robot = bench.recordings[0], shaken.build(bench.recordings[0])
    models = []
    for name in ("gravity", "added-mass"):
        one = next(c for c in candidates(robot, [], [name]))
        models.append(bench.fit((one,), {p: 0.3 if name == "gravity" else 300.0 for p in one.paths}))
    found = propose(bench, *models, ("gravity", "added-mass"))
    powers = dict(found.menu)
    assert found.power == max(powers.values()) and found.power >= found.repeat > 0.0
    if broken:
        assert powers["fast"] == 0.0 and found.trial != "fast"
        assert any("fast is left out" in text for text in heard)
    else:
        assert found.trial == "fast" and powers["fast"] > 1.5 * powers["slow"]
        # an error that large may be all there is between them, a smaller one a part
        error = 1.02 * change_sigma(*models, bench.noise)
        assert propose(bench, *models, ("gravity", "added-mass"), error).repeat == 0.0
        some = propose(bench, *models, ("gravity", "added-mass"), 0.3 * error)
        blamed = 0.3 * error * np.sqrt(rec.markers.size)
        assert 0.0 < some.power == pytest.approx((np.sqrt(powers["fast"]) - blamed) ** 2)


def test_what_would_not_decide_is_not_said_to():
    """As many trials as make the expected difference decisive; two names of one thing are told by none."""
    one = Proposal(("a", "b"), "plan_0", 30.0, 3.0, [])
    assert one.needed == 1 and one.sentence.startswith("plan_0 would decide between a and b")
    weak = replace(one, power=6.5)
    assert weak.needed == 4 and "4 such trials would decide" in weak.sentence
    weaker = replace(one, power=5.0)  # five of them, in which what neither has in it is the same
    assert weaker.needed is None
    assert weaker.sentence == (
        "no trial that can be simulated tells a from b within 4 trials: the best, plan_0, adds 5 to the deviance"
    )
    none = replace(one, power=0.0, repeat=0.0)
    assert none.needed is None and none.sentence == "no trial that can be simulated tells a from b"


def test_one_trial_is_proposed_for_a_whole_class():
    """That with the largest least difference; what none tells stays by itself, as all do where none tells all."""
    menu = {"plan_0": (60.0, 3.0), "plan_1": (20.0, 30.0), "repeating trial0": (9.0, 12.0)}
    pairs = []
    for k, other in enumerate("bc"):
        powers = sorted(((trial, both[k]) for trial, both in menu.items()), key=lambda pair: -pair[1])
        pairs.append(Proposal(("a", other), *powers[0], menu["repeating trial0"][k], powers))
    twin = Proposal(("a", "d"), "plan_0", 0.0, 0.0, [(trial, 0.0) for trial in menu])
    joint, alone = from_all([*pairs, twin])
    assert (joint.between, joint.trial, joint.power, joint.repeat) == (("a", "b", "c"), "plan_1", 20.0, 9.0)
    assert joint.needed == 2
    assert joint.sentence.startswith(
        "plan_1 would tell most, 2 such trials would decide, between a, b and c ("
    )
    assert alone is twin
    assert from_all([pairs[0], twin]) == [pairs[0], twin]
    apart = [replace(pairs[0], menu=[("plan_0", 60.0), ("plan_1", 0.0), ("repeating trial0", 0.0)]),
             replace(pairs[1], menu=[("plan_1", 30.0), ("plan_0", 0.0), ("repeating trial0", 0.0)])]  # fmt: skip
    assert from_all(apart) == apart


def gripped(offset: float) -> rn.Robot:
    """A rod in a gripper that holds a short edge and is beside its place at the start."""
    fig = rn.StickFigure()
    nodes = [(0, 0, 0), (5e-4, 0, 0), *((0.05 * k, 0, 0) for k in range(1, 5))]
    fig.rod("rod", nodes, material=rn.Material(E=2e6, rho=1200.0), radius=4e-3)
    held = rn.PrescribedMotion(
        at="rod:0-1", position=lambda t: np.array([0.0, 0.0, offset]), orientation=shaken.upright
    )
    drag = rn.ResistiveForce(eta_t=1.0, eta_n=2.0)
    return rn.Robot(fig.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), drag, held])


@pytest.mark.filterwarnings("ignore::rodnet.errors.PlausibilityWarning")
def test_a_start_beside_the_drawing_is_measured_against_what_it_stretches():
    """An edge that is held as a whole is moved, not stretched; half of a free one is too much."""
    sim = rn.Simulation(gripped(2e-3), dt=0.01)
    np.testing.assert_allclose(sim.state.q[:6].reshape(2, 3)[:, 2], 2e-3)
    assert sim.run(0.2).status == "finished"
    with pytest.raises(DisplacedStartError, match="half an edge beside it"):
        rn.Simulation(gripped(0.03), dt=0.01)
