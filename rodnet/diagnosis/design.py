"""The next experiment: which trials out of a menu would tell explanations apart."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from rodnet.diagnosis.chosen import Accepted
from rodnet.diagnosis.powers import Powers, powers
from rodnet.diagnosis.workbench import Fitted, Workbench

DECISIVE = 25.0  # expected difference of deviance with which trials decide
MOST = (
    4  # trials in all that are worth asking for: what no explanation has in it is the same in those of a kind
)
REPEATING = "repeating "
Pair = tuple[int, int]  # of explanations, by number


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
        Expected difference of deviance between any two that it tells apart, if done once, over the variance factor: all
        other parameters refitted, as far as the numerical error cannot be blamed for it; the least of several.
    repeat : float
        The same for the best of the trials that there are, repeated.
    menu : list of (str, float)
        All trials that were considered, best first.
    needed : int, optional
        How many such trials are expected to decide, with the ``further``; None if none do, `MOST` together.
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
        if self.needed is None:
            planned = any(not trial.startswith(REPEATING) for trial, _ in self.menu)
            none = "no trial that can be simulated" if planned else "no repetition of a trial"
            best = (
                f" within {MOST} trials in all: the best, {self.trial}, adds {self.power:.2g} to the deviance"
            )
            return f"{none} tells {one} from {_all_of(others, 'or')}{best if self.power > 0.0 else ''}"
        between = f"between {_all_of([one, *others])}{', except as follows' if self.left else ''}"
        done = [t if n == 1 else f"{n} times {t}" for t, n in [(self.trial, self.needed), *self.further]]
        if self.further:
            return f"{_all_of(done)} together would decide {between}; {self.trial} comes first"
        times = (
            "" if self.repeat <= 0.0 else f", {self.power / self.repeat:.3g} times as much as repeating one"
        )
        each = "" if self.needed == 1 else " of the first"
        return f"{done[0]} would decide {between} (expected difference of deviance{each} {self.power:.3g}{times})"

    def to_dict(self) -> dict[str, Any]:
        """As JSON takes it."""
        return {**vars(self), "sentence": self.sentence}


def propose_all(
    bench: Workbench,
    accepted: Sequence[Accepted],
    model: Fitted,
    numerical: float,
    tell: Callable[[str], None],
) -> list[Proposal]:
    """Trials that would tell each effect and what explains as much in its place from one another.

    Parameters
    ----------
    bench : Workbench
        The trials, with the case whose ``drives`` is the menu.
    accepted : sequence of Accepted
        The effects, with what explains as much.
    model : Fitted
        With all of them.
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
        beside = {c.id for c in model.candidates} - {one.candidate.id}
        models = {one.candidate.id: model}
        for other in one.equivalents:
            whole = other.whole or other.fitted
            if {c.id for c in whole.candidates} == {*beside, other.id}:
                models[other.id] = whole
            else:  # more than the two would be different
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
        fits = [model, *others]
        names: list[str] = []
        for digits in (2, 3, 4, 6):  # as many as tell them apart
            names = [f"{id} at {fit.values[path]:.{digits}f}" for fit in fits]
            if len(set(names)) == len(fits):
                break
        models = dict(zip(names, fits, strict=True))
        if len(models) > 1:
            tell(f"looking for a trial that tells {len(models)} places of {id} apart")
            found += propose(bench, models, numerical)
    return found


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
    menu, fits = bench.case.menu(bench.recordings[0]), list(models.values())
    names = [*(name for name, _ in menu), *(f"{REPEATING}{rec.name}" for rec in bench.recordings)]
    planned = powers(bench, fits, [rec for _, rec in menu], False, numerical)
    repeated = powers(bench, fits, list(bench.recordings), True, numerical)
    return plan(list(models), names, planned.beside(repeated))


def plan(ids: Sequence[str], trials: Sequence[str], known: Powers) -> list[Proposal]:
    """Trials that between them tell as many pairs of explanations apart as any do, and what none tells.

    The next are always those that decide most pairs for each time that a trial is done; of these, those with the
    largest least difference.

    Parameters
    ----------
    ids : sequence of str
        The explanations.
    trials : sequence of str
        What can be tried.
    known : Powers
        What that adds to the deviance.
    """
    pairs = list(combinations(range(len(ids)), 2))
    once = np.array([[known.between(*pair, {t: 1}) for pair in pairs] for t in range(len(trials))])
    counts: dict[int, int] = {}
    untold, found = pairs, []
    while untold and (more := _next(known, len(trials), untold, counts)):
        counts = _sum(counts, more)
        untold = [pair for pair in untold if known.between(*pair, counts) < DECISIVE]
    if counts:
        (t, n), *others = counts.items()
        told = [k for k, pair in enumerate(pairs) if pair not in untold]
        of = sorted({i for k in told for i in pairs[k]})
        by_first = [k for k in told if known.between(*pairs[k], {t: n}) >= DECISIVE] or told
        found.append(
            _proposal([ids[i] for i in of], trials, once[:, by_first].min(axis=1), t, n,
                      tuple((trials[k], count) for k, count in others),
                      tuple((ids[i], ids[j]) for i, j in untold if {i, j} <= set(of)))
        )  # fmt: skip
    for i, one in enumerate(ids):
        some = [k for k, pair in enumerate(pairs) if pair in untold and pair[0] == i]
        if some:
            most = once[:, some].max(axis=1)
            found.append(
                _proposal([one, *(ids[pairs[k][1]] for k in some)], trials, most, int(most.argmax()), None)
            )
    return found


def _next(
    known: Powers, trials: int, untold: Sequence[Pair], counts: Mapping[int, int]
) -> dict[int, int] | None:
    """What to do further, that decides most pairs that are not told yet; None if nothing decides any."""
    best: tuple[float, float] = (0.0, 0.0)
    chosen = None
    for more in _ways(known, trials, untold, counts):
        done = _sum(counts, more)
        now = [power for pair in untold if (power := known.between(*pair, done)) >= DECISIVE]
        worth = (len(now) / sum(more.values()), min(now, default=0.0))
        if now and worth > best:
            best, chosen = worth, more
    return chosen


def _ways(
    known: Powers, trials: int, untold: Sequence[Pair], counts: Mapping[int, int]
) -> Iterator[dict[int, int]]:
    """One trial, as often as is left; and for each pair trials of any kind, as long as it takes."""
    left = MOST - sum(counts.values())
    for t in range(trials):
        for n in range(1, left + 1):
            yield {t: n}
    for pair in untold:
        more: dict[int, int] = {}
        while sum(more.values()) < left and known.between(*pair, _sum(counts, more)) < DECISIVE:
            ways = [_sum(more, {t: 1}) for t in range(trials)]
            more = max(ways, key=lambda way: known.between(*pair, _sum(counts, way)))
        if more:
            yield more


def _sum(one: Mapping[int, int], other: Mapping[int, int]) -> dict[int, int]:
    """How often each trial is done."""
    return {t: one.get(t, 0) + other.get(t, 0) for t in [*one, *(t for t in other if t not in one)]}


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
