"""Trials left out by fits of their own, where first order about the fit to all is no guide."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from rodnet.diagnosis.begin import flat_of
from rodnet.diagnosis.crossval import left_out, reduced
from rodnet.diagnosis.equivalence import smooth_variance
from rodnet.diagnosis.patience import ENDLESS, Patience
from rodnet.diagnosis.refit import Refit
from rodnet.diagnosis.verdict import judge
from rodnet.diagnosis.workbench import RANK, Fitted, Workbench
from rodnet.errors import RodnetError

SHAKY = 1.5  # times its deviance in the fit: a trial that is predicted as badly as that is too far for first order
MOST = 2  # refits that are looked at again
SAME = 1e-9  # of a deviance, by which fits that are the same may differ
CONTRADICTED = 0.01  # chance that others are as far from the fit to all, of which a trial's density is told
FLAT = 1e-3  # relative change of the sum of squares at which a fit without a trial ends: it is to tell a gain, no value


def checked(
    bench: Workbench, base: Fitted, refits: Sequence[Refit], numerical: float, tell: Callable[[str], None],
    patience: Patience = ENDLESS,
) -> list[Refit]:  # fmt: skip
    """Fit again without single trials, where a refit fails for nothing but what it gains on trials left out.

    To first order a model of several strengths can be moved far by the one trial that determines one of them, and
    what is predicted there is of no motion at all.

    Parameters
    ----------
    bench : Workbench
        The trials.
    base : Fitted
        The model without any of the effects.
    refits : sequence of Refit
        Best first.
    numerical : float
        Numerical error [sigma].
    tell : callable
        Told of the progress.
    patience : Patience
        What took so long to fit that there is no time for as many fits as trials stays as it is.
    """
    found = sorted(refits, key=lambda one: -one.gain)
    before: np.ndarray | None = None
    for k, one in enumerate(found[:MOST]):
        certain = replace(one, after=np.full(len(one.after), -np.inf))
        if len(one.gains) >= 3 and shaky(one.fitted) and judge(certain, numerical).accepted:
            if not judge(one, numerical).accepted:
                count = len(shaky(one.fitted)) + (len(shaky(base)) if before is None else 0)
                if not patience.allows(one.seconds * count):
                    tell(f"{one.id}: no time to leave out trials in earnest (minutes)")
                    found[k] = replace(one, hurried=True)
                    continue
                after = one.after.copy()
                after[: len(bench.recordings)] = by_fits(bench, one.fitted, one.id, tell)
                if before is None:  # what they are compared with is no better known
                    before = one.before.copy()
                    before[: len(bench.recordings)] = by_fits(bench, base, "what they join", tell)
                found[k] = replace(one, before=before, after=after, earnest=True)
        if judge(found[k], numerical).accepted:
            break  # what explains less is no matter
    if (
        before is not None
    ):  # the same for all, but for trials that judge: what of these counts depends on both models
        some = len(bench.recordings)
        found = [replace(one, before=np.append(before[:some], one.before[some:])) for one in found]
    return sorted(found, key=lambda one: -one.cross_gain)


def in_earnest(bench: Workbench, base: Fitted, new: Refit, old: Refit) -> Refit:
    """A refit made anew; where it was left out in earnest before, so it is now, beside whatever it stands."""
    if not old.earnest:
        return new
    same = {c.id for c in new.fitted.candidates} == {c.id for c in old.fitted.candidates}
    # nor has the fit changed, or the model that it joined: beside another numerical error both have
    pairs = (new.fitted.deviance, old.fitted.deviance), (new.gain * new.factor, old.gain * old.factor)
    same = same and all(np.isclose(a, b, rtol=SAME, atol=SAME * old.fitted.deviance) for a, b in pairs)
    if same and len(new.after) == len(old.after):
        return replace(new, before=old.before, after=old.after, earnest=True)
    before, after, some = new.before.copy(), new.after.copy(), slice(0, len(bench.recordings))
    before[some], after[some] = (by_fits(bench, m, new.id, bench.tell) for m in (base, new.fitted))
    return replace(new, before=before, after=after, earnest=True)


def shaky(fitted: Fitted) -> list[int]:
    """Numbers of the trials whose prediction from the others to first order is no guide."""
    inside = [form.c for form in reduced(fitted)[0]]
    return np.flatnonzero(left_out(fitted) > SHAKY * np.array(inside)).tolist()


def by_fits(bench: Workbench, fitted: Fitted, name: str, tell: Callable[[str], None]) -> np.ndarray:
    """Deviance of each trial predicted from the others, shape (trials,): by a fit where first order is no guide."""
    after = left_out(fitted)
    for k in shaky(fitted):
        tell(f"{name} without {bench.recordings[k].name}")
        try:
            after[k] = predicted(bench, fitted, k)
        except RodnetError as error:
            tell(f"it cannot be predicted from the others: {error}")
    return after


def predicted(bench: Workbench, fitted: Fitted, trial: int) -> float:
    """Deviance of a trial with the common values that a fit to all others gives, what it has of its own fitted.

    The others may leave open what the trial tells: how near a wall is, which it alone comes near. A value that is
    one of many for them may then predict anything, though those of the fit to all are as good for them: where they
    contradict these by no more than chance, the trial counts as their predictive density has it (`_open`).
    """
    others = [k for k in range(len(fitted.fits)) if fitted.group(k) != fitted.group(trial)]
    values, own = fitted.values, [fitted.own[k] for k in others]
    flat = flat_of(bench, fitted)
    if bench.case.noise is not None:
        flat = max(flat, FLAT)
    common = bench.subset(others).fit(fitted.candidates, values, own, flat=flat)
    single = bench.subset([trial]).fit(
        fitted.candidates, common.values, [fitted.own[trial]], common=False, flat=flat
    )
    if single.deviance <= SHAKY * reduced(fitted)[0][trial].c:
        return single.deviance
    left_open = _open(fitted, trial, others, common.deviance)
    return single.deviance if left_open is None else min(single.deviance, left_open)


def _open(fitted: Fitted, trial: int, others: Sequence[int], best: float) -> float | None:
    """Minus twice the log of a trial's predictive density, given others, but for what noise alone makes of it.

    By Laplace's method: the density of all over that of the others, whose least deviance is ``best``; the determinants
    are the price of what they leave open. None where they contradict the values of the fit to all.
    """
    forms, prior = reduced(fitted)
    inside = forms[trial].c
    against = sum(forms[k].c for k in others) + prior.c - best
    strengths = sum(len(c.paths) for c in fitted.candidates)
    if not strengths or against > float(chi2.isf(CONTRADICTED, strengths)) * smooth_variance(fitted):
        return None
    S = np.asarray(sum(forms[k].S for k in others) + prior.S)
    size = np.sqrt(np.maximum(np.diag(S + forms[trial].S), 1e-300))
    scaled = [A / np.outer(size, size) + RANK * np.eye(len(A)) for A in (S, S + forms[trial].S)]
    less, more = (float(np.linalg.slogdet(A)[1]) for A in scaled)
    return inside + max(against, 0.0) + more - less
