"""Which explanations are one class, and which of them are no others than the simplest."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from scipy.stats import chi2

import rodnet as rn
from rodnet.diagnosis.equivalence import (
    CONTAINS,
    by_chance,
    distinct,
    livelier,
    rivals,
    simplest,
    smooth_variance,
)
from rodnet.diagnosis.numerics import CARRIED, measure
from rodnet.diagnosis.refit import refit
from rodnet.diagnosis.remainder import test_remainder as remainder_of
from rodnet.diagnosis.screen import screen
from rodnet.diagnosis.verdict import complete
from rodnet.diagnosis.workbench import Workbench
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken


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

    assert smooth_variance(shaken.left_with(base, 0.0)) == 1.0
    loud = shaken.left_with(base, 0.15)
    assert complete(remainder_of(loud)) and 1.2 < smooth_variance(loud) == remainder_of(loud).ratio
    # of which deviance over a variance factor knows already
    ratio = smooth_variance(loud)
    assert (
        livelier(loud, 1.0) == ratio
        and livelier(loud, 0.5 * ratio) == 2.0
        and livelier(loud, 2.0 * ratio) == 1.0
    )


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
    # even with no numerical error each further parameter must gain the logarithm of the number of samples
    least = 2.0 * np.log(whole.samples)
    assert least > 9.3  # as noise alone gains in one case of a hundred
    few = gaining(one, 2000.0, whole)
    for share in (0.9, 1.1):
        many = gaining(spot, 2000.0 + share * least, also)
        assert chosen(few, many, numerical=0.0)[0] is (few if share < 1.0 else many)
    # and what strongly speaks against five of them is no other explanation, though chance gains less
    cost, chance = 5.0 * np.log(whole.samples), float(chi2.isf(0.05, 5))
    assert chance < by_chance(5, whole, 1.0) == cost - 6.0 < cost
    assert by_chance(1, whole, 1.0) == chi2.isf(0.05, 1) > np.log(whole.samples) - 6.0
    # a hundredth of what it gains on trials left out is no difference, for that is told to first order
    slightly, much = (replace(shaped, before=(1.0 + share) * shaped.before) for share in (0.01, 0.05))
    assert chosen(simple, slightly) == (slightly, [slightly, simple])
    assert chosen(simple, much) == (much, [much])


def test_what_contains_the_simplest_is_no_rival_of_it():
    """A natural curvature is explained by a wide kink and by any natural shape as well; it is named, alone."""
    recs = [shaken.record(k, "natural-curvature", {"kappa1": 0.3, "kappa2": 0.2}) for k in range(4)]
    bench = Workbench.of(shaken.CASE, recs, Serial(), shaken.SIGMA)
    families = ["natural-curvature", "kink", "natural-shape", "gravity"]
    bank = rn.candidates(shaken.build(recs[0]), [], families)
    model = bench.fit()
    scores = screen(bench, model, bank)
    shapes = refit(bench, model, [s for s in scores if s.candidate.family != "gravity"], len(bank))
    by_id = {one.score.candidate.family: one for one in shapes}
    assert {"gravity", *by_id} == set(families)
    one, alike = simplest(shapes, shapes, bench.noise, CARRIED * measure(bench, model).worst)
    assert one is by_id["natural-curvature"]
    assert len(alike) == 3 and rivals(one, alike) == []
    # nor are they rivals beside it where something else stands for the class
    light = next(s for s in scores if s.candidate.family == "gravity")
    weight, kink = replace(one, score=light, fitted=model, gain=one.gain - 300.0), by_id["kink"]
    assert rivals(weight, [weight, one, kink]) == [one]
    assert rivals(weight, [weight, kink]) == [kink]
    elsewhere = shaken.leaving(kink.fitted, [-f.residual for f in model.fits])  # by another motion
    better = replace(kink, fitted=elsewhere, gain=one.gain + 20.0, factor=one.factor)
    assert rivals(weight, [weight, one, better]) == [one, better]


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
        model = SimpleNamespace(
            values=paths, samples=9, fits=[SimpleNamespace(residual=rng.standard_normal(9))]
        )
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


def test_what_is_needed_beside_all_effects_stays_beside_its_special_case(two, base, scores):
    """Whatever it gained before the others were found."""
    robot = shaken.build(two.recordings[0])
    some = {
        s.candidate.family: s
        for s in screen(two, base, rn.candidates(robot, [], ["kink", "natural-curvature"]))
    }
    one, other = (refit(two, base, [some[id]], 1)[0] for id in ("natural-curvature", "kink"))
    other = replace(other, gain=one.gain, factor=one.factor, before=one.before, after=one.after)
    assert distinct([one, other]) == [one]
    assert distinct([one, other], lambda more, less: False) == [one, other]
