"""The next experiment: the trial that tells two explanations apart, and starts that differ from what was drawn."""

from dataclasses import replace

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.candidate import candidates
from rodnet.diagnosis.design import DECISIVE, REPEATING, plan, propose
from rodnet.diagnosis.fineness import FINE
from rodnet.diagnosis.numerics import measure
from rodnet.diagnosis.powers import Powers, powers
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
    models = {}
    for name in ("gravity", "added-mass"):
        one = next(c for c in candidates(robot, [], [name]))
        models[name] = bench.fit((one,), {p: 0.3 if name == "gravity" else 300.0 for p in one.paths})
    (found,) = propose(bench, models)
    powers = dict(found.menu)
    assert found.power == max(powers.values()) and found.power >= found.repeat > 0.0
    if broken:
        assert powers["fast"] == 0.0 and found.trial != "fast"
        assert any("fast is left out" in text for text in heard)
    else:
        assert found.trial == "fast" and powers["fast"] > 1.5 * powers["slow"]
        # an error that large may be all there is between them, a smaller one a part
        error = 1.02 * change_sigma(*models.values(), bench.noise)
        (none,) = propose(bench, models, error)
        assert none.repeat == 0.0
        (some,) = propose(bench, models, 0.3 * error)
        blamed = 0.3 * error * np.sqrt(rec.markers.size)
        assert 0.0 < some.repeat == pytest.approx((np.sqrt(found.repeat) - blamed) ** 2)


def test_the_numerical_error_of_a_planned_trial_is_its_own():
    """It is measured there: what finer runs change in it, and not what they change in those that there are."""
    rec = shaken.record(0)
    menu = [still(rec, 0.05, "slow"), still(rec, 2.5, "fast")]
    bench = Workbench.of(replace(shaken.CASE, drives=lambda rec: menu), [rec], Serial(), shaken.SIGMA)
    robot = shaken.build(bench.recordings[0])
    one = bench.fit(candidates(robot, [], ["gravity"])[:1], {"weight-z.g": 0.3})
    other = replace(one, values={**one.values, "weight-z.g": 3.0})  # far enough to see all that is blamed
    left = {}
    for small in (0.0, 1e-9):
        tried = powers(bench, [one, other], menu, False, small)
        left[small] = np.sqrt([tried.between(0, 1, {t: 1}) for t in range(2)])
    blamed = left[0.0] - left[1e-9]
    for k, trial in enumerate(menu):
        single = bench.with_trials([trial], [bench.noise[0]])
        problem = single.problem(one.candidates, one.values)
        error = measure(single, single.evaluate(problem, np.zeros(len(problem.quantities)), one.candidates))
        # a refit leaves less than there is, and more than one in which all is free
        count = trial.markers.size
        fine = FINE * np.sqrt(2 * count)  # of two trials; beyond it what is diagnosed again is refined
        assert min(np.sqrt(count) * error.worst, fine) <= blamed[k] * (1 + 1e-9)
        assert blamed[k] <= np.sqrt(count) * max(error.sigma.values())
    assert blamed[0] < 0.7 * fine and blamed[1] == pytest.approx(fine)


def test_what_would_not_decide_is_not_said_to():
    """As many trials as make the expected difference decisive; two names of one thing are told by none."""

    def only(power):
        (one,) = plan(["a", "b"], ["plan_0", "repeating trial0"], pairwise([[power], [0.1 * power]], 2))
        return one

    assert only(30.0).needed == 1 and only(30.0).sentence == (
        "plan_0 would decide between a and b (expected difference of deviance 30, 10 times as much as repeating one)"
    )
    assert only(6.5).needed == 4 and "4 times plan_0 would decide" in only(6.5).sentence
    weak = only(5.0)  # five of them, in which what neither has in it is the same
    assert weak.needed is None
    assert weak.sentence == (
        "no trial that can be simulated tells a from b within 4 trials in all: the best, plan_0, adds 5 to the deviance"
    )
    none = only(0.0)
    assert none.needed is None and none.sentence == "no trial that can be simulated tells a from b"


def pairwise(rows, count):
    """Trials that add what is given to the pairs ab, ac, ..., bc, ..., of explanations that have nothing to refit."""
    parts = []
    for row in rows:
        table = np.zeros((count, count))
        table[np.triu_indices(count, 1)] = row
        parts.append(
            {(i, j): np.sqrt([[max(table[i, j], table[j, i])]]) for i in range(count) for j in range(count)}
        )
    return Powers([np.zeros((0, 0))] * count, [1.0] * count, parts, [0.0] * len(rows))


def test_trials_are_proposed_that_tell_a_whole_class_apart():
    """Whichever is true: not only that which stands for it from each of the others."""
    trials = ["plan_0", "plan_1", "repeating trial0"]
    # ab, ac, bc: the one tells a from both, but these from one another no better than the other, which adds to it
    (both,) = plan("abc", trials, pairwise([[60.0, 40.0, 14.0], [3.0, 2.0, 12.0], [9.0, 12.0, 0.0]], 3))
    assert (both.between, both.trial, both.needed, both.further) == (("a", "b", "c"), "plan_0", 2, ())
    (both,) = plan("abc", trials, pairwise([[60.0, 40.0, 14.0], [3.0, 2.0, 24.0], [9.0, 12.0, 0.0]], 3))
    assert (both.trial, both.needed, both.further, both.left) == ("plan_0", 1, (("plan_1", 1),), ())
    assert (both.power, both.repeat) == pytest.approx((40.0, 9.0))
    assert both.sentence == "plan_0 and plan_1 together would decide between a, b and c; plan_0 comes first"
    # one trial for all, done twice, rather than one for each pair
    (joint,) = plan("abc", trials[:2], pairwise([[20.0, 30.0, 13.0], [0.0, 0.0, 20.0]], 3))
    assert (joint.between, joint.trial, joint.needed) == (("a", "b", "c"), "plan_0", 2)
    assert joint.power == pytest.approx(13.0)
    # four times are the most, whatever they are for: a fifth would be needed to tell b from c
    joint, rest = plan("abc", trials[:2], pairwise([[60.0, 60.0, 5.4], [0.0, 0.0, 0.0]], 3))
    assert (joint.needed, joint.further, rest.between, rest.needed) == (1, (), ("b", "c"), None)
    # four in all: what would take three more is left, though it could be had alone
    joint, rest = plan("abc", trials[:2], pairwise([[60.0, 13.0, 0.0], [0.0, 0.0, 9.0]], 3))
    assert (joint.trial, joint.needed, joint.further, joint.left) == ("plan_0", 2, (), (("b", "c"),))
    assert (rest.between, rest.needed, rest.power) == (("b", "c"), None, pytest.approx(9.0))
    # a twin stays, and is said to
    joint, twin = plan("abc", trials[:2], pairwise([[60.0, 0.0, 60.0], [0.0, 1.0, 0.0]], 3))
    assert (joint.between, joint.needed, joint.left) == (("a", "b", "c"), 1, (("a", "c"),))
    assert joint.sentence.startswith("plan_0 would decide between a, b and c, except as follows (")
    assert (twin.between, twin.trial, twin.needed) == (("a", "c"), "plan_1", None)


def of_two(known, *parts, factor=1.0, error=0.0):
    """Two explanations that are known alike, and trials of them."""
    both = [{pair: np.array(part, dtype=float) for pair in ((0, 1), (1, 0))} for part in parts]
    return Powers([np.array(known, dtype=float)] * 2, [1.0, factor], both, [error] * len(parts))


def test_trials_are_expected_to_add_what_a_refit_to_all_of_them_leaves():
    """A parameter that is hardly known takes up what it can do, in repetitions nearly all; another trial pins it."""
    slack = of_two([[0.5]], [[3.0, 2.0], [0.0, 1.0]], [[8.0, 0.0]])  # derivatives beside the difference
    for n in (1, 4):
        change = 6.0 * n / (9.0 * n + 0.25)  # least n (2 - 3 c)^2 + (0.5 c)^2
        least = n * ((2.0 - 3.0 * change) ** 2 + 1.0) + (0.5 * change) ** 2
        assert slack.between(0, 1, {0: n}) == pytest.approx(least)
    assert slack.between(0, 1, {0: 4}) < 4.0 * slack.between(0, 1, {0: 1})
    assert slack.between(0, 1, {1: 1}) == pytest.approx(0.0)
    assert (
        slack.between(0, 1, {0: 1, 1: 1}) > slack.between(0, 1, {0: 1}) + 3.0
    )  # which by itself tells nothing
    # what the trials that there are do not see is free, and not known perfectly
    unseen = of_two([[0.0]], [[3.0, 2.0], [0.0, 1.0]])
    assert unseen.between(0, 1, {0: 1}) == pytest.approx(1.0)
    # where the model leaves more than noise all that counts less, and nothing but for the numerical error
    assert of_two([[0.5]], [[0.0, 6.0]], factor=4.0).between(1, 0, {0: 2}) == pytest.approx(2.0 * 36.0 / 4.0)
    blamed = of_two([[0.5]], [[0.0, 6.0]], [[0.0, 2.0]], error=3.0)
    assert blamed.between(0, 1, {0: 3}) == pytest.approx(3.0 * (6.0 - 3.0) ** 2)
    assert blamed.between(0, 1, {1: 4}) == 0.0


def test_different_trials_decide_together():
    """None does so as often as it is worth it, for it soon has told what it can."""
    once = of_two([[0.3]], [[2.0, 3.0], [0.0, 2.0]], [[-2.0, 3.2], [0.0, 1.5]])
    assert max(once.between(0, 1, {t: 4}) for t in (0, 1)) < DECISIVE
    (both,) = plan(["a", "b"], ["plan_0", "plan_1"], once)
    assert (both.trial, both.needed, both.further) == ("plan_0", 1, (("plan_1", 1),))
    assert both.sentence == "plan_0 and plan_1 together would decide between a and b; plan_0 comes first"


def test_what_is_said_of_trials_that_there_are():
    """Where the case lists no others, none was looked at."""
    (none,) = plan(["a", "b"], [f"{REPEATING}trial0"], pairwise([[2.0]], 2))
    assert none.sentence.startswith(
        "no repetition of a trial tells a from b within 4 trials in all: the best, repeating"
    )


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
