"""What may be claimed, and when: verdicts, effects beside a remainder, placebos, the draws of a bootstrap."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.chosen import Accepted
from rodnet.diagnosis.design import propose_all
from rodnet.diagnosis.equivalence import CONTAINS, rivals, simplest, smooth_variance
from rodnet.diagnosis.findings import Interval, interval
from rodnet.diagnosis.forces import ForceColumns, Placebo, beside_force, placebo
from rodnet.diagnosis.numerics import CARRIED, measure
from rodnet.diagnosis.pairs import hidden
from rodnet.diagnosis.refit import refit
from rodnet.diagnosis.remainder import test_remainder as remainder_of
from rodnet.diagnosis.replicas import replica
from rodnet.diagnosis.screen import screen, strongest
from rodnet.diagnosis.verdict import (
    CROSS,
    LIKELY,
    Evidence,
    beats_trials,
    blind,
    complete,
    outweighs,
    status,
    word,
)  # fmt: skip
from rodnet.diagnosis.workbench import Workbench
from rodnet.report.sentences import told
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken

CLEAR = Evidence(
    classes=(False,), trials=6, training=5, whole=True, holds=(), sure=(True,), resolved=True, alarmed=True,
    blind=False, improved=True,
)  # fmt: skip


@pytest.mark.parametrize(
    ("gains", "gain", "sure"),
    [
        ([390.0, 39.0, 5.2, -0.9], 525.0, True),  # met in two trials, and nothing in the others
        ([390.0, 3.0, 2.0, -0.9], 525.0, False),  # in one alone
        ([390.0, 39.0, 5.2, -20.0], 525.0, False),
        ([30.0, 8.0, -3.0, 2.0], 40.0, False),
        ([20.0, 30.0, 25.0, -1.0], 80.0, True),  # alike in most
    ],
)
def test_trials_gain_alike_or_some_of_them_for_sure(gains, gain, sure):
    assert beats_trials(np.array(gains), LIKELY, CROSS * gain) == sure


@pytest.mark.parametrize(
    ("change", "verdict", "called"),
    [
        ({}, "named", "named"),
        ({"trials": 4}, "class", "class"),
        ({"training": 2}, "class", "class"),
        ({"classes": (True,)}, "class", "class"),
        ({"whole": False, "holds": (True,)}, "partial", "named"),
        ({"whole": False, "holds": (False,)}, "surrogate", "surrogate"),
        ({"whole": False, "holds": (True,), "trials": 4}, "class", "class"),
        ({"many": True}, "partial", "named"),
        ({"improved": False}, "surrogate", "surrogate"),
        ({"sure": (False,)}, "surrogate", "surrogate"),
        ({"whole": False, "holds": (True,), "sure": (False,)}, "surrogate", "surrogate"),
        ({"resolved": False}, "unresolved-numerics", "surrogate"),
        ({"blind": True}, "unidentifiable", "class"),
    ],
)
def test_the_verdict(change, verdict, called):
    evidence = replace(CLEAR, **change)
    assert word(evidence) == verdict
    assert status(0, evidence, verdict) == called
    assert status(1, evidence, verdict) == "surrogate"  # a drafted law is no name


def test_the_verdict_without_an_effect():
    quiet = replace(CLEAR, sure=(), classes=(), alarmed=False)
    assert word(quiet) == "none"
    assert word(replace(quiet, blind=True)) == "unidentifiable"
    assert word(replace(quiet, near=True)) == "unresolved-numerics"
    assert word(replace(quiet, alarmed=True, whole=False)) == "surrogate"


@pytest.mark.parametrize(
    ("beyond", "words"),
    [
        ((False, False), "2 (1 to 3) Pa"),
        ((True, False), "at most 3 Pa"),
        ((False, True), "at least 1 Pa"),
        ((True, True), "any value fits"),
    ],
)
def test_an_interval_says_which_side_is_open(beyond, words):
    assert told(Interval(2.0, 1.0, 3.0, "Pa", beyond)) == words


@pytest.fixture(scope="module")
def two():
    """A rod with a soft spot in a medium that weighs it down."""
    recs = []
    for k in range(3):
        robot = shaken.robot(shaken.drive(k))
        robot = shaken.with_effect(robot, "stiffness-defect", {"loss": 0.6, "place": 0.37, "width": 0.06})
        robot = robot.with_terms(rn.Gravity(g=0.15))
        traj = rn.Simulation(robot, dt=shaken.DT, stepper="sdirk2").run(shaken.DURATION)
        t = np.arange(0.0, shaken.DURATION, 1.0 / shaken.RATE)
        seen = rn.observe([rn.Markers(robot, shaken.POINTS)], traj, t)[0]
        seen = seen + shaken.SIGMA * np.random.default_rng(k).standard_normal(seen.shape)
        recs.append(rn.Recording(t, seen, names=list("abcd"), name=f"trial{k}", attrs=shaken.drive(k)))
    return Workbench.of(shaken.CASE, recs, Serial(), shaken.SIGMA)


@pytest.fixture(scope="module")
def base(two):
    return two.fit()


@pytest.fixture(scope="module")
def scores(two, base):
    robot = shaken.build(two.recordings[0])
    return screen(two, base, rn.candidates(robot, [], ["stiffness-defect", "gravity", "kelvin-voigt"]))


def test_a_pair_is_found_together(two, base, scores):
    pair = hidden(two, base, scores, [], 0.0, lambda text: None)
    assert {one.candidate.family for one in pair} == {"stiffness-defect", "gravity"}
    assert pair[1].parent is pair[0].refit.fitted


def left_with(base, size):
    """The same model, with more samples, of unit noise and a slow wave of some size."""
    rng, fits, more = np.random.default_rng(1), [], 12
    for f in base.fits:
        shape = more * len(f.whitened[0]), *f.whitened[0].shape[1:]
        white = rng.standard_normal(shape) + size * np.sin(np.linspace(0.0, 6.0, shape[0]))[:, None, None]
        long = replace(f, whitened=[white], seen=[np.ones(shape[:2], bool)], residual=white.ravel())
        fits.append(replace(long, jacobian=np.tile(f.jacobian, (more, 1))))
    return replace(base, fits=fits)


def test_an_effect_that_explains_less_than_is_left_may_be_a_part_of_that(two, base, scores):
    """Beside noise it is one all the same."""
    (one,) = refit(two, base, [next(s for s in scores if s.candidate.id == "gravity")], 1)
    wave = left_with(base, 0.2)
    power = 0.2**2 * np.mean(np.sin(np.linspace(0.0, 6.0, 400)) ** 2) * wave.samples
    for fitted, gain, more in ((wave, 0.8, False), (wave, 1.6, True), (left_with(base, 0.0), 0.01, True)):
        effect = replace(one, fitted=fitted, gain=gain * power, factor=1.0)
        assert outweighs(effect, remainder_of(fitted)) is more


def test_what_makes_the_same_motion_with_more_parameters_is_no_rival(two, base, scores):
    """It could make any other; but a current that hardly acts along the rod makes that of one across it anyway."""
    (one,) = refit(two, base, [next(s for s in scores if s.candidate.id == "gravity")], 1)
    robot = shaken.build(two.recordings[0])
    more = screen(two, base, rn.candidates(robot, [], ["natural-curvature", "flow"]))
    bent, current = (
        next(s for s in more if s.candidate.family == id) for id in ("natural-curvature", "flow")
    )
    motion = [b.residual - a.residual for a, b in zip(one.fitted.fits, base.fits, strict=True)]
    one = replace(one, gain=sum(float(m @ m) for m in motion), factor=1.0)
    for score, share, alike in ((bent, 0.03, False), (bent, 0.15, True), (current, 0.03, True)):
        (other,) = refit(two, base, [score], 1)
        close = [a.residual - share * m for a, m in zip(one.fitted.fits, motion, strict=True)]
        other = replace(other, fitted=shaken.leaving(other.fitted, close), gain=one.gain + 50.0, factor=1.0)
        other = replace(other, score=replace(score, lean=len(score.candidate.strength)))
        assert (other in rivals(one, [one, other])) is alike, (score.candidate.id, share)


def test_further_parameters_gain_more_by_chance_where_something_smooth_is_left(two, base):
    """Of a smooth remainder too small to name they take up as much more than of noise as it varies more."""
    assert smooth_variance(base) == 1.0  # what a soft spot leaves is no trifle

    assert smooth_variance(left_with(base, 0.0)) == 1.0
    loud = left_with(base, 0.15)
    assert complete(remainder_of(loud)) and 1.2 < smooth_variance(loud) == remainder_of(loud).ratio


def test_no_trial_is_looked_for_where_more_than_two_explanations_differ(two, base, scores):
    """A rival that was fitted before what was found later lacks that, which any trial would show."""
    weight, spot = (
        next(s for s in scores if s.candidate.id == id) for id in ("gravity", "stiffness-defect@rod")
    )
    (first,) = refit(two, base, [weight], 1)
    both = two.fit((weight.candidate, spot.candidate), first.fitted.values)
    heard = []
    assert propose_all(two, [Accepted(first, base, [replace(first, fitted=both)])], 0.0, heard.append) == []
    assert "gravity was not fitted beside all that was found" in heard[0]
    (same,) = propose_all(two, [Accepted(first, base, [replace(first)])], 0.0, heard.append)
    assert same.needed is None  # nothing tells a thing from itself


def test_what_takes_more_parameters_to_explain_no_more_is_no_rival(two, base, scores):
    """By chance two further parameters gain six in one case of twenty: a rival gains more, in the fit or left out.

    Place and width of a spot are parameters like others, however many places were tried.
    """
    by_id = {s.candidate.family: s for s in scores}
    (one,) = refit(two, base, [by_id["kelvin-voigt"]], 1)
    (spot,) = refit(two, base, [by_id["stiffness-defect"]], 1)
    assert (one.score.candidate.size, spot.score.candidate.size) == (1, 3)

    def as_good(gain, crossed):
        """The spot with other gains than the simple one."""
        shift = (one.cross_gain + crossed) / len(one.gains)
        before = np.full(len(one.gains), shift) * one.factor
        return replace(spot, gain=one.gain + gain, factor=one.factor, before=before, after=0.0 * before)

    assert spot.score.tried > 5 and one.score.tried == 1
    for gain, crossed, alike in ((3.6, -6.0, False), (5.4, 3.0, False), (6.6, -6.0, True), (3.6, 6.6, True)):
        other = as_good(gain, crossed)
        assert (other in rivals(one, [one, other])) is alike, (gain, crossed)


def test_strengths_that_have_nothing_to_do_make_no_rival_more_complicated():
    """A current upwards explains what a weight does: another cause, of one strength, whatever two more could do."""
    recs = [
        shaken.record(k, change=lambda robot: shaken.with_effect(robot, "flow", {"u_z": 0.02}))
        for k in range(3)
    ]
    bench = Workbench.of(shaken.CASE, recs, Serial(), shaken.SIGMA)
    base = bench.fit()
    some = rn.candidates(shaken.build(recs[0]), [], ["gravity", "flow", "tether"])
    scores = {s.candidate.family: s for s in screen(bench, base, some)}
    assert (scores["flow"].lean, scores["gravity"].lean) == (1, 1)
    (weight,), (current,) = (refit(bench, base, [scores[id]], 1) for id in ("gravity", "flow"))
    assert current.score.candidate.size == 3
    alike = replace(
        current, gain=weight.gain + 1.0, before=weight.before, after=weight.after, factor=weight.factor
    )
    assert rivals(weight, [weight, alike]) == [alike]
    busy = replace(alike, score=replace(current.score, lean=3))
    assert rivals(weight, [weight, busy]) == []
    # nor is one of three strengths more complicated than another of three, however many of them have nothing to do
    assert rivals(alike, [alike, replace(busy, gain=weight.gain)]) == [replace(busy, gain=weight.gain)]
    # nor does the current with its two idle components make a thread, which needs a place, too, as simple as it is
    (thread,) = refit(bench, base, [scores["tether"]], 1)
    assert thread.score.candidate.size - len(thread.score.candidate.strength) + thread.score.lean == 2
    tied = replace(
        thread, gain=current.gain - 1.0, before=current.before, after=current.after, factor=current.factor
    )
    assert rivals(current, [current, tied]) == []


def test_further_parameters_that_gain_a_trifle_are_not_believed(two, base, scores):
    """However surely noise does not do it: what a model is off by itself does. Unless the simpler leaves something.

    It is not what stands for the class, but who knows that it is not the truth: it stays in it.
    """
    by_id = {s.candidate.family: s for s in scores}
    (one,) = refit(two, base, [by_id["kelvin-voigt"]], 1)
    (spot,) = refit(two, base, [by_id["stiffness-defect"]], 1)

    def gaining(one, gain, model):
        before = np.full(len(one.gains), gain / len(one.gains))
        return replace(one, fitted=model, factor=1.0, gain=gain, before=before, after=0.0 * before)

    def chosen(*good, numerical=0.2):
        return simplest(list(good), list(good), two.noise, numerical)

    rng = np.random.default_rng(0)
    whole, also = (
        shaken.leaving(base, [rng.standard_normal(len(f.residual)) for f in base.fits]) for _ in range(2)
    )
    assert complete(remainder_of(whole, two.noise)) and not complete(remainder_of(base, two.noise))
    simple, more = gaining(one, 20000.0, whole), gaining(spot, 20300.0, also)
    assert chosen(simple, more) == (simple, [simple, more])
    assert rivals(simple, [simple, more]) == [more]
    much = gaining(spot, 20600.0, also)
    assert chosen(simple, much) == (much, [much])
    # nor does a mesh explain more than all that finer ones would change
    assert chosen(simple, more, numerical=0.1) == (more, [more])
    # of two effects as one explanation, one may be right: a trifle is a fiftieth of what the other gains beside it
    second = replace(more, least=5000.0)
    assert chosen(simple, second) == (second, [second])
    leaves = gaining(one, 20000.0, base)
    assert chosen(leaves, more) == (more, [more])
    other = replace(more, score=one.score)  # nor is it a trifle that what is as simple gains
    assert chosen(simple, other) == (other, [other])
    # what is known beforehand makes an explanation no less simple, but what it takes up is as little: one class
    shape = {p: (0.5, 0.4) for p in spot.score.candidate.shape}
    shaped = replace(more, score=replace(spot.score, candidate=replace(spot.score.candidate, priors=shape)))
    assert shaped.score.candidate.size == one.score.candidate.size
    assert chosen(simple, shaped) == (shaped, [shaped, simple])
    assert rivals(shaped, [shaped, simple]) == [simple]
    assert chosen(leaves, shaped) == (shaped, [shaped])
    # a hundredth of what it gains on trials left out is no difference, for that is told to first order
    slightly, much = (replace(shaped, before=(1.0 + share) * shaped.before) for share in (0.01, 0.05))
    assert chosen(simple, slightly) == (slightly, [slightly, simple])
    assert chosen(simple, much) == (much, [much])


def test_blind_if_nothing_could_have_been_seen(scores):
    assert not blind(scores)
    weak = [replace(s, p=1.0, visible={p: 1e9 * v for p, v in s.visible.items()}) for s in scores]
    assert blind(weak)
    same = [replace(scores[0], candidate=s.candidate) for s in scores]  # three that explain as much
    assert blind(same)


def test_placebos_of_noise_gain_little_and_those_of_a_signal_much(base):
    rng = np.random.default_rng(0)
    own = rng.standard_normal((base.samples, 6))
    names = [f"f{k}" for k in range(6)]
    forces = ForceColumns(names, dict.fromkeys(names, 1.0), own, np.zeros(6, dtype=bool))
    drawn = placebo(base, forces, 10, 2)
    assert drawn.beaten(50.0) == 1.0  # no force made of noise is worth that on trials left out
    residual = np.concatenate([f.residual for f in base.fits])
    told = ForceColumns(names, forces.scales, own + residual[:, None], forces.one_sided)
    assert placebo(base, told, 10, 2).cross.mean() > 10.0 * max(drawn.cross.mean(), 1.0)
    assert Placebo(np.zeros((2, 1)), np.zeros(2), np.array([1.0, 3.0])).beaten(2.0) == 0.5


def test_a_flexible_force_takes_away_what_it_explains(base):
    """A value stays where it is beside forces that explain nothing, and moves where they share its explanation."""
    rng = np.random.default_rng(1)
    J = np.concatenate([base.jacobian_of(k) for k in range(len(base.fits))])[:, 0]
    names = ["f"]
    idle = ForceColumns(names, {"f": 1.0}, rng.standard_normal((len(J), 1)), np.zeros(1, dtype=bool))
    assert beside_force(base, idle, ("rod.E",))["rod.E"] == pytest.approx(base.values["rod.E"], rel=0.01)
    residual = np.concatenate([f.residual for f in base.fits])
    mixed = residual[:, None] + 3.0 * np.linalg.norm(residual) / np.linalg.norm(J) * J[:, None]
    moved = beside_force(base, replace(idle, columns=mixed), ("rod.E",))["rod.E"]
    assert abs(np.log(moved / base.values["rod.E"])) > 5.0 * base.sd("rod.E") / base.values["rod.E"]


def test_replicas_are_the_model_and_noise(two, base):
    """Beside a remainder a replica is off its prediction by what the model leaves, up to a sign for each trial."""
    made = replica(shaken.CASE, two.recordings, base, two.noise, np.random.default_rng(0))
    for rec, old, fit in zip(made, two.recordings, base.fits, strict=True):
        np.testing.assert_allclose(
            np.abs(rec.markers - fit.predicted[0]), np.abs(old.markers - fit.predicted[0]), atol=1e-12
        )
    assert made[0].digest != two.recordings[0].digest or made[1].digest != two.recordings[1].digest


def test_what_contains_the_simplest_is_no_rival_of_it():
    """A natural curvature is explained by a wide kink and by any natural shape as well; it is named, alone."""
    recs = [shaken.record(k, "natural-curvature", {"kappa1": 0.3, "kappa2": 0.2}) for k in range(4)]
    bench = Workbench.of(shaken.CASE, recs, Serial(), shaken.SIGMA)
    families = ["natural-curvature", "kink", "natural-shape"]
    bank = rn.candidates(shaken.build(recs[0]), [], families)
    model = bench.fit()
    found = refit(bench, model, screen(bench, model, bank), len(bank))
    assert {one.score.candidate.family for one in found} == set(families)
    one, alike = simplest(found, found, bench.noise, CARRIED * measure(bench, model).worst)
    assert one.score.candidate.family == "natural-curvature"
    assert len(alike) == 3 and rivals(one, alike) == []


def test_of_one_law_by_two_names_the_special_one_is_named(two, base, scores, monkeypatch):
    """Whichever predicts a little better: neither is another explanation than the other."""
    by_id = {s.candidate.family: s for s in scores}
    (one,) = refit(two, base, [by_id["kelvin-voigt"]], 1)
    candidate = replace(one.score.candidate, id="same-as-that", family="same-as-that")
    other = replace(one, score=replace(one.score, candidate=candidate), after=0.99 * one.after)
    both = [one, other]
    assert simplest(both, both, two.noise, 0.0)[0] is other
    assert rivals(other, both) == [one]
    monkeypatch.setitem(CONTAINS, "same-as-that", ("kelvin-voigt",))
    assert simplest(both, both, two.noise, 0.0)[0] is one
    assert rivals(one, both) == []


def test_a_soft_spot_at_its_root_is_no_rival_of_a_root_that_gives(monkeypatch):
    """It is one elsewhere on the rod, and so is anything of another kind."""
    monkeypatch.setattr("rodnet.diagnosis.equivalence.smooth_variance", lambda model: 1.0)  # all leave noise
    rng = np.random.default_rng(0)

    def fitted(id, **values):
        robot = shaken.build(shaken.record(0))
        candidate = rn.candidates(robot, [], [id])[0]
        paths = {f"{candidate.id}.{name}": v for name, v in values.items()}
        model = SimpleNamespace(values=paths, fits=[SimpleNamespace(residual=rng.standard_normal(9))])
        return SimpleNamespace(
            score=SimpleNamespace(candidate=candidate, lean=1, tried=1, scales={}), fitted=model,
            factor=1.0, gain=4.0 * candidate.size, cross_gain=1.0,
        )  # fmt: skip

    root = fitted("root-compliance", length=0.01)
    near, far = (
        fitted("stiffness-defect", place=0.02, width=0.03),
        fitted("stiffness-defect", place=0.4, width=0.03),
    )
    profile, load = fitted("stiffness-profile"), fitted("gravity")
    assert rivals(root, [root, near, far, profile, load]) == [far, load]
    worse = SimpleNamespace(**{**vars(load), "gain": load.gain - 1.0, "cross_gain": 0.0})
    assert rivals(root, [root, worse]) == [worse]  # as simple, and a little behind
    assert rivals(far, [root, far]) == [root]


def test_strengths_of_one_side_are_the_best_there_are():
    """Of two columns nearly alike one strength is below zero at the free optimum: without it the other takes less."""
    rng = np.random.default_rng(3)
    a, b = rng.standard_normal((2, 400))
    P = np.stack([a, a + 0.1 * b], axis=1)
    r = -(2.0 * P[:, 0] - 0.8 * P[:, 1]) + 0.01 * rng.standard_normal(400)
    free, sides = np.array([False, False]), np.array([True, True])
    assert strongest(P, r, free) == pytest.approx([2.0, -0.8], abs=0.05)
    z = strongest(P, r, sides)
    alone = -(P[:, 0] @ r) / (P[:, 0] @ P[:, 0])
    assert z == pytest.approx([alone, 0.0]) and z[0] < 1.3


def test_what_trials_do_not_depend_on_may_be_anything():
    """A rod that stays in a plane tells nothing of the friction that it has in twist."""
    recs = [shaken.record(k).cut(0.0, 0.3) for k in range(2)]
    flat = [replace(rec, attrs={**rec.attrs, "lift": 0.0}) for rec in recs]
    bench = Workbench.of(shaken.CASE, flat, Serial(), shaken.SIGMA)
    (friction,) = rn.candidates(shaken.build(flat[0]), [], ["dry-friction"])
    torque = "dry-friction.torque"
    values = {"rod.E": 2e6, "dry-friction.moment": 1e-4, torque: 1e-4, "dry-friction.curvature": 1.0}
    problem = bench.problem([friction], values)
    model = bench.evaluate(problem, np.zeros(len(problem.quantities)), [friction])
    told = interval(model, torque)
    assert told.low < 1e-3 * told.value and told.high > 1e3 * told.value and told.open == (True, True)
    assert 0.0 < interval(model, "rod.E").low < interval(model, "rod.E").high < np.inf
