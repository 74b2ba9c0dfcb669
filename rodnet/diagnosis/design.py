"""The next experiment: which trials out of a menu would tell explanations apart."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from rodnet.diagnosis.chosen import Accepted
from rodnet.diagnosis.powers import powers
from rodnet.diagnosis.refit import Refit
from rodnet.diagnosis.scales import variance_factor
from rodnet.diagnosis.verdict import CROSS
from rodnet.diagnosis.workbench import Fitted, Workbench
from rodnet.errors import CaseError
from rodnet.recordings.recording import Recording

DECISIVE = 25.0  # expected difference of deviance with which a trial decides
# repetitions of a trial that are worth telling of: what neither explanation has in it is the same in each of them
MOST = 4
REPEATING = "repeating "


@dataclass(frozen=True)
class Proposal:
    """A trial that would tell explanations from one another.

    Attributes
    ----------
    between : tuple of str
        The explanations; where no trial tells, the first from each of the others.
    trial : str
        What to do first.
    power : float
        Expected difference of deviance between any two that it tells apart, all other parameters refitted, as far as
        the numerical error cannot be blamed for it; the least of several.
    repeat : float
        The same for the best of the trials that there are, repeated.
    menu : list of (str, float)
        All trials that were considered, best first.
    needed : int, optional
        How many such trials are expected to decide; None if even `MOST` would not.
    further : tuple of (str, int)
        What to do beside it, and how often, where it does not tell all of them apart.
    left : tuple of (str, str)
        Pairs of the explanations that are not told apart by all that either.
    """

    between: tuple[str, ...]
    trial: str
    power: float
    repeat: float
    menu: list[tuple[str, float]]
    needed: int | None
    further: tuple[tuple[str, int], ...] = ()
    left: tuple[tuple[str, str], ...] = ()

    @property
    def sentence(self) -> str:
        """In words."""
        one, *others = self.between
        times = (
            "" if self.repeat <= 0.0 else f", {self.power / self.repeat:.3g} times as much as repeating one"
        )
        if self.needed is None:
            adds = f" within {MOST} trials: the best, {self.trial}, adds {self.power:.2g} to the deviance"
            best = adds if self.power > 0.0 else ""
            return f"no trial that can be simulated tells {one} from {_all_of(others, 'or')}{best}"
        between = f"between {_all_of([one, *others])}{', except as follows' if self.left else ''}"
        if self.further:
            done = [t if n == 1 else f"{n} times {t}" for t, n in [(self.trial, self.needed), *self.further]]
            return f"{_all_of(done)} together would decide {between}; {self.trial} comes first"
        told = (
            "would decide"
            if self.needed == 1
            else f"would tell most, {self.needed} such trials would decide,"
        )
        return f"{self.trial} {told} {between} (expected difference of deviance {self.power:.3g}{times})"

    def to_dict(self) -> dict[str, Any]:
        """As JSON takes it."""
        return {**vars(self), "sentence": self.sentence}


def menu_of(bench: Workbench) -> list[tuple[str, Recording]]:
    """What the case says could be tried, as names and recordings.

    Raises
    ------
    CaseError
        If ``drives(rec)`` returns something else.
    """
    if bench.case.drives is None:
        return []
    found = []
    for entry in bench.case.drives(bench.recordings[0]):
        if isinstance(entry, Recording):
            found.append((entry.name, entry))
        elif isinstance(entry, tuple) and len(entry) == 2 and isinstance(entry[1], Recording):
            found.append((str(entry[0]), entry[1].replace(name=str(entry[0]))))
        else:
            raise CaseError(
                f"case '{bench.case.name}': drives(rec) must list recordings, or pairs (what to do, recording), "
                f"got {entry!r:.80}"
            )
    return found


def propose_all(
    bench: Workbench, accepted: Sequence[Accepted], numerical: float, tell: Callable[[str], None]
) -> list[Proposal]:
    """Trials that would tell each effect and what explains as much in its place from one another.

    Parameters
    ----------
    bench : Workbench
        The trials, with the case whose ``drives`` is the menu.
    accepted : sequence of Accepted
        The effects, with what explains as much.
    numerical : float
        Numerical error of the trials [sigma], rms.
    tell : callable
        Told of the progress.

    Returns
    -------
    list of Proposal
        Of each effect what tells most, if anything does, and then what no trial tells.

    Raises
    ------
    CaseError
        If the menu holds something else than recordings.
    """
    found = []
    for one in accepted:
        models = {one.candidate.id: one.refit.fitted}
        for other in one.equivalents:
            if _beside_the_same(one, other):
                models[other.id] = other.fitted
            else:
                tell(
                    f"{other.id} was not fitted beside all that was found: no trial is looked for that tells it apart"
                )
        if len(models) > 1:
            first, *rest = models
            tell(f"looking for a trial that tells {first} from {', '.join(rest)}")
            found += propose(bench, models, numerical)
    return found


def propose_places(
    bench: Workbench, model: Fitted, places: Mapping[str, Sequence[Fitted]], numerical: float,
    tell: Callable[[str], None],
) -> list[Proposal]:  # fmt: skip
    """Trials that would tell where an effect is, of models with it elsewhere that explain as much, by its id."""
    found = []
    by_id = {candidate.id: candidate for candidate in model.candidates}
    for id, others in places.items():
        path = by_id[id].place or by_id[id].onset or ""
        models = {f"{id} at {fit.values[path]:.2f}": fit for fit in (model, *others)}
        if len(models) > 1:
            tell(f"looking for a trial that tells {len(models)} places of {id} apart")
            found += propose(bench, models, numerical)
    return found


def _beside_the_same(one: Accepted, other: Refit) -> bool:
    """Whether a rival was fitted beside what the effect stands beside; else more than the two is different."""
    mine, its = ({c.id for c in model.candidates} for model in (one.refit.fitted, other.fitted))
    rise = (other.fitted.deviance - one.refit.fitted.deviance) / variance_factor(one.refit.fitted)
    return mine - {one.candidate.id} == its - {other.id} and rise < max(DECISIVE, CROSS * one.refit.gain)


def propose(bench: Workbench, models: Mapping[str, Fitted], numerical: float = 0.0) -> list[Proposal]:
    """Find the trials that tell explanations apart, whichever of them is true.

    Where two explanations differ by no more than the numerical error, a trial tells nothing of them, however often it
    is repeated.

    Parameters
    ----------
    bench : Workbench
        The trials, with the case whose ``drives`` is the menu.
    models : mapping of str to Fitted
        The explanations, two at least.
    numerical : float
        Numerical error of the trials [sigma], rms.
    """
    menu, fits = menu_of(bench), list(models.values())
    names = [*(name for name, _ in menu), *(f"{REPEATING}{rec.name}" for rec in bench.recordings)]
    planned = powers(bench, fits, [rec for _, rec in menu], False, numerical)
    repeated = powers(bench, fits, list(bench.recordings), True, numerical)
    return plan(list(models), names, np.concatenate([planned, repeated])) if names else []


def plan(ids: Sequence[str], trials: Sequence[str], power: np.ndarray) -> list[Proposal]:
    """Trials that between them tell as many pairs of explanations apart as any do, and what none tells.

    The next is always the one that decides most pairs for each time that it is done; of these, the one with the
    largest least difference.

    Parameters
    ----------
    ids : sequence of str
        The explanations.
    trials : sequence of str
        What can be tried.
    power : ndarray, shape (trials, explanations, explanations)
        Expected difference of deviance.
    """
    pairs = list(combinations(range(len(ids)), 2))
    P = np.array([[one[i, j] for i, j in pairs] for one in power])
    told, known = np.zeros(len(pairs), dtype=bool), np.zeros(len(pairs))
    counts: dict[int, int] = {}
    first = told
    while chosen := _next(P, known, told, counts):
        t, n = chosen
        counts[t] = counts.get(t, 0) + n
        known = known + n * P[t]
        told = known >= DECISIVE
        first = first if first.any() else told
    found = []
    if counts:
        (t, n), *others = counts.items()
        of = sorted({i for k in np.flatnonzero(told) for i in pairs[k]})
        left = [pairs[k] for k in np.flatnonzero(~told) if set(pairs[k]) <= set(of)]
        found.append(
            _proposal([ids[i] for i in of], trials, P[:, first].min(axis=1), t, n,
                      tuple((trials[k], count) for k, count in others),
                      tuple((ids[i], ids[j]) for i, j in left))
        )  # fmt: skip
    for i, one in enumerate(ids):
        untold = [k for k in np.flatnonzero(~told) if pairs[k][0] == i]
        if untold:
            most = P[:, untold].max(axis=1)
            found.append(
                _proposal([one, *(ids[pairs[k][1]] for k in untold)], trials, most, int(most.argmax()), None)
            )
    return found


def _next(
    P: np.ndarray, known: np.ndarray, told: np.ndarray, counts: Mapping[int, int]
) -> tuple[int, int] | None:
    """Trial and how often more, that decides most pairs that are not told yet; None if none decides any."""
    best: tuple[float, float] = (0.0, 0.0)
    chosen = None
    for t, power in enumerate(P):
        for n in range(1, MOST + 1 - counts.get(t, 0)):
            now = ~told & (known + n * power >= DECISIVE)
            worth = (now.sum() / n, float(power[now].min(initial=np.inf)))
            if now.any() and worth > best:
                best, chosen = worth, (t, n)
    return chosen


def _proposal(
    between: Sequence[str], trials: Sequence[str], power: np.ndarray, t: int, needed: int | None,
    further: tuple[tuple[str, int], ...] = (), left: tuple[tuple[str, str], ...] = (),
) -> Proposal:  # fmt: skip
    menu = sorted(zip(trials, map(float, power), strict=True), key=lambda entry: -entry[1])
    repeat = max((p for trial, p in menu if trial.startswith(REPEATING)), default=0.0)
    return Proposal(tuple(between), trials[t], float(power[t]), repeat, menu, needed, further, left)


def _all_of(words: Sequence[str], last_by: str = "and") -> str:
    *most, last = words
    return f"{', '.join(most)} {last_by} {last}" if most else last
