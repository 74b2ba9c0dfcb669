"""Which explanations are one class: what explains the data as well, and is not the same by another description."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.stats import chi2

from rodnet.diagnosis.candidate import Candidate
from rodnet.diagnosis.numerics import CARRIED
from rodnet.diagnosis.refit import MANY, Refit
from rodnet.diagnosis.remainder import test_remainder
from rodnet.diagnosis.scales import ALPHA, CLASS, TRIFLE, Noise, variance_factor
from rodnet.diagnosis.verdict import CROSS, complete
from rodnet.diagnosis.workbench import Fitted

# chance that more parameters gain so much where there is nothing for them to explain: less, and they may be needed
IDLE = 0.05
RARE = 0.01  # the same, of parameters that must gain to be the only explanation
STRONG = 6.0  # of deviance: evidence of 20 to 1 (Kass and Raftery, J. Am. Stat. Assoc. 90, 1995, 773)
FOLLOWED = 0.1  # [sigma] errors of a mesh and of another code that many parameters follow
# [rad] a direction of a plane is as near to a given one by chance in so many cases
COINCIDENCE = 0.5 * np.pi * IDLE
# what a family contains as special cases: these are no other explanations than it
CONTAINS = {
    "stiffness-profile": ("stiffness-defect", "stiffness-gradient", "root-compliance"),
    "natural-shape": ("natural-curvature", "kink"),
    "kink": ("natural-curvature",),  # a wide one
}


def equivalents(best: Refit, others: list[Refit], noise: Noise, numerical: float) -> list[Refit]:
    """Refits that explain the data as well as the best, or would if the numerical error were against them."""
    return [
        o
        for o in others
        if o is not best
        and (
            best.gain - o.gain * o.factor / best.factor < CLASS * livelier(o.fitted, best.factor)
            or _ahead(best, o) < _unsure(best, o)
            or numerically_alike(best.fitted, o.fitted, numerical)
            or (_ahead(best, o) < _trifle(best, o, noise, numerical) and _leaves_no_more(o, best, noise))
        )
    ]


def numerically_alike(one: Fitted, other: Fitted, numerical: float) -> bool:
    """Whether the numerical error [sigma] may be why one explanation fits better than another.

    If the other is true, and e is what the code lacks, the sum of squares falls by 2 e.d - d.d where predictions are
    changed by d, and noise adds some 2 |d| times its standard deviations (of what the one leaves, for the other may be
    wrong): at most what an error does that is all along d. Some trials that tell two explanations apart do so whatever
    the others do: those come first in which the two differ most for the error that there is.
    """
    left = [(a.residual, b.residual) for a, b in zip(one.fits, other.fits, strict=True)]
    half = np.array([b @ (b - a) for a, b in left])  # of what one is ahead by, and d.d
    size, error = np.array([np.sum((b - a) ** 2) for a, b in left]), errors_of_trials(one, numerical) ** 2
    noise = np.sqrt(CLASS * max(variance_factor(one), smooth_variance(one)))
    order = np.argsort(-size / np.maximum(error, 1e-300))
    half, size, error = (np.cumsum(some[order]) for some in (half, size, error))
    return bool(np.all(half <= np.sqrt(size) * (np.sqrt(error) + noise)))


def errors_of_trials(model: Fitted, numerical: float) -> np.ndarray:
    """Norm of each trial's numerical error [sigma], of so much rms of all: as much larger as finer runs change it more.

    As the derivatives by shares of the numerical error tell; alike in all trials where there are none.
    """
    count = np.array([len(f.residual) for f in model.fits], dtype=float)
    shares = [k for k, q in enumerate(model.quantities) if ".numerics[" in q.path]
    power = np.array([np.sum(model.jacobian_of(k)[:, shares] ** 2) for k in range(len(count))])
    if not power.sum() > 0.0:
        power = count
    return np.asarray(numerical * np.sqrt(count.sum() * power / power.sum()))


def simplest(
    good: list[Refit], refits: list[Refit], noise: Noise, numerical: float
) -> tuple[Refit, list[Refit]]:  # fmt: skip
    """What stands for all that explain the data as well, and all these; it must be acceptable by itself.

    From the best to the simplest that is as good, and on from that one: what is nearer than the numerical error may
    be a little farther from the best of several with more parameters.
    """
    best, names = max(good, key=lambda one: one.cross_gain), {one.id for one in good}
    while True:
        alike = [best, *equivalents(best, refits, noise, numerical)]
        one = min([o for o in alike if o.id in names], key=lambda o: o.score.candidate.size)
        if one.score.candidate.size == best.score.candidate.size:
            special = contained(best.score.candidate.family)
            same = [o for o in alike if o.id in names and o.score.candidate.family in special]
            return (max(same, key=lambda o: o.cross_gain) if same else best), alike
        best = one


def contained(family: str) -> tuple[str, ...]:
    """Families that are special cases of one, or the same by another name."""
    from rodnet import registry

    record = registry.terms().get(family)
    told = getattr(record.object, "contains", ()) if record is not None else ()
    return (*CONTAINS.get(family, ()), *told)


def rivals(one: Refit, alike: list[Refit], whole: bool = True) -> list[Refit]:
    """What else explains as much: a description that contains this one as a special case is no other explanation.

    Nor is one that takes more parameters to explain no more than these explain by chance; but where the model is not
    yet ``whole``, chance seems to explain much, and what takes more parameters is asked again when it is.
    """
    family = one.score.candidate.family
    others = [
        o
        for o in alike
        if o is not one
        and family not in contained(o.score.candidate.family)
        and not (family == "root-compliance" and _at_an_end(o))
        and not (whole and _needless(o, one))
    ]
    return distinct(others) if whole else others


def distinct(alike: list[Refit], needless: Callable[[Refit, Refit], bool] | None = None) -> list[Refit]:
    """The same without those that contain another of them as a special case, and no need for more than that.

    ``needless(other, one)`` tells whether the one explains as much as the other.
    """
    needless = needless or _needless
    return [
        o
        for o in alike
        if not any(
            s.score.candidate.family in contained(o.score.candidate.family) and needless(o, s)
            for s in alike
            if s is not o
        )
    ]


def _needless(other: Refit, one: Refit) -> bool:
    """Whether its further parameters gain no more than by chance, in the fit and on trials left out.

    Nor more than a trifle, if they are many: these follow the errors of a mesh and of another code, too. Few that gain
    it give no name, but who knows whether it is the truth's. Strengths that have nothing to do do not count, of
    neither: a current of three components, of which one explains what a weight does, is no more complicated than a
    weight, and another cause; but a tether that pulls that way is. Nor is an explanation that could make many motions
    and makes the very one that the simpler must make: a rod whose bends are turned as the grip would turn them.
    """
    more = further_needed(other, one)
    little = _trifle(other, one) if more >= MANY else 0.0  # whatever the numerical error
    return more > 0 and (_ahead(other, one) < max(_idle(other, one), little) or _same_motion(other, one))


def _same_motion(other: Refit, one: Refit) -> bool:
    """Whether what could make other motions makes the simpler one's, as nearly as it rarely would by chance."""
    pairs = zip(one.fitted.fits, other.fitted.fits, strict=True)
    apart = sum(float(np.sum((b.residual - a.residual) ** 2)) for a, b in pairs)
    return apart < (COINCIDENCE * _variety(other)) ** 2 * one.gain * one.factor


def _variety(one: Refit) -> float:
    """How far motions of an explanation typically are from the one that it makes, over the size of that.

    By its strengths, any combination of which is plausible. The least of all ways in which they differ counts: a
    current along a rod does little beside one across, so it is no wonder if this alone explains nearly all.
    """
    score, values = one.score, one.fitted.values
    strength = score.candidate.strength
    if len(strength) < 2 or set(score.scales) != set(strength):  # a pair as one explanation
        return 0.0
    size = [(values[p] - score.nulls[p]) / score.scales[p] for p in strength]
    motion = score.columns @ size
    if not np.any(motion):
        return 0.0
    motion /= np.linalg.norm(motion)
    along = motion @ score.columns
    across = np.linalg.svd(score.columns - np.outer(motion, along), compute_uv=False)
    return float(across[-2] / np.linalg.norm(along))


def further_needed(other: Refit, one: Refit) -> int:
    """Number of parameters that it needs more, of those that it has more: none if it has as many."""
    more = other.score.candidate.size - one.score.candidate.size
    return max(min(more, needed_size(other) - needed_size(one)), 0)


def needed_size(one: Refit) -> int:
    """Number of parameters without the strengths that have nothing to do."""
    candidate = one.score.candidate
    return candidate.size - len(candidate.strength) + min(one.score.lean, len(candidate.strength))


def _ahead(one: Refit, other: Refit) -> float:
    """By how much one lowers the deviance more than another, in the fit or on trials left out, whichever is more.

    The latter is told to first order: a fiftieth of a gain is no difference there.
    """
    scale = one.factor / other.factor
    crossed = one.cross_gain * scale - other.cross_gain - CROSS * other.gain
    return max(one.gain * scale - other.gain, crossed)


def _idle(other: Refit, one: Refit) -> float:
    """Deviance that the further parameters of one explanation gain where there is nothing for them."""
    more = further_needed(other, one)
    return max(by_chance(more, one.fitted, one.factor), unnamed(more, one.fitted, one.factor))


def by_chance(more: int, model: Fitted, factor: float) -> float:
    """Deviance that many further parameters gain of noise, or that strongly speaks against them.

    The latter is what they cost (`evidence`) less `STRONG`.
    """
    if more <= 0:
        return 0.0
    lively = livelier(model, factor)
    return max(float(chi2.isf(IDLE, more)) * lively, evidence(more, model, factor) - STRONG * lively)


def _unsure(best: Refit, other: Refit) -> float:
    """Deviance that the further parameters of the best must gain before one with fewer is out of the question."""
    more = best.score.candidate.size - other.score.candidate.size
    return max(evidence(more, other.fitted, other.factor), unnamed(more, other.fitted, other.factor))


def evidence(more: int, model: Fitted, factor: float) -> float:
    """Deviance that many further parameters must gain to be more than a choice among what they could explain.

    The logarithm of the number of samples each (Schwarz, Ann. Stat. 6, 1978, 461): chance alone gains that rarely, but
    what drives' records and meshes are off by is no chance, and further parameters find something in it. And not less
    than what chance gains in one case of a hundred.
    """
    if more <= 0:
        return 0.0
    cost = more * float(np.log(max(model.samples / factor, 1.0)))
    return max(cost, float(chi2.isf(RARE, more))) * livelier(model, factor)


def unnamed(more: int, model: Fitted, factor: float) -> float:
    """Deviance that many further parameters may gain by following errors of a mesh and of another code; few cannot."""
    return FOLLOWED**2 * model.samples / factor if more >= MANY else 0.0


def livelier(model: Fitted, factor: float) -> float:
    """How many times more deviance over a variance factor parameters gain by chance than where noise alone is left."""
    return max(smooth_variance(model) / factor, 1.0)


def smooth_variance(model: Fitted) -> float:
    """Variance over the noise's of what is smooth in what a model leaves, where that is too little to name.

    All that parameters change is smooth, so they gain so many times more by chance than of noise.
    """
    left = test_remainder(model)
    return max(left.ratio, 1.0) if left.p < ALPHA and complete(left) else 1.0


def _trifle(other: Refit, one: Refit, noise: Noise = (), numerical: float = np.inf) -> float:
    """Deviance that the further parameters of one explanation may gain and be no better."""
    if not plainer(one.score.candidate, other.score.candidate):
        return 0.0
    more = other.score.candidate.size - one.score.candidate.size
    return trifle(
        other.at_stake * other.factor / one.factor, more, other.fitted, one.factor, noise, numerical
    )


def trifle(
    stake: float, more: int, model: Fitted, factor: float, noise: Noise, numerical: float
) -> float:  # fmt: skip
    """Deviance that further parameters may gain and be no better: so much no model is good to.

    They take up what a model's mesh, or its idea of a gripper, is off by; those of which something is known beforehand,
    too: a drive's lags that are spread a little smooth the noise of its record. A few that are not known gain no more
    than what a finer mesh or time step would change, or than the model leaves that is no noise.

    Parameters
    ----------
    stake : float
        Deviance that the whole explanation gains, over the variance factor.
    more : int
        Number of further parameters, those not counted of which something is known beforehand.
    model : Fitted
        The model with them.
    factor : float
        Variance factor.
    noise : sequence of dict
        Of the instruments, by trial.
    numerical : float
        Numerical error that carrying leaves [sigma], rms.
    """
    most = TRIFLE * stake
    if not 0 < more < MANY:
        return most
    left = test_remainder(model, noise)
    off = max((numerical / CARRIED) ** 2, left.excess**2 if left.p < ALPHA else 0.0)
    return min(most, off * model.samples / factor)


def plainer(one: Candidate, other: Candidate) -> bool:
    """Whether an explanation has fewer parameters than another, those of which something is known counted, too."""
    return len(one.paths) < len(other.paths)


def _leaves_no_more(one: Refit, other: Refit, noise: Noise) -> bool:
    """Whether one explanation leaves nothing, or the other something, too."""
    return complete(test_remainder(one.fitted, noise)) or not complete(test_remainder(other.fitted, noise))


def _at_an_end(one: Refit) -> bool:
    """Whether it is a soft spot that reaches an end of its rod: a root that gives is one, too, without any width."""
    candidate, values = one.score.candidate, one.fitted.values
    if candidate.family != "stiffness-defect" or candidate.place is None:
        return False
    place, (width,) = values[candidate.place], (values[p] for p in candidate.shape if p.endswith(".width"))
    return min(place, 1.0 - place) <= width
