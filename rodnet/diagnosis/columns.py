"""Derivatives of the residuals by the strengths of candidates, at every place of their banks."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from rodnet.diagnosis.candidate import Candidate
from rodnet.diagnosis.edited import with_candidates
from rodnet.diagnosis.together import shared_columns
from rodnet.diagnosis.workbench import Fitted, Workbench
from rodnet.errors import CaseError, ConvergenceError, DerivativeError, RodnetError, TermError
from rodnet.inference.case import Case
from rodnet.inference.problem import Problem
from rodnet.inference.quantities import robot_values, with_ties
from rodnet.parameters import Parameter
from rodnet.recordings.recording import Recording
from rodnet.robot import Robot
from rodnet.terms.base import Term

MOST = 48  # places of a bank that are tried
SECANT = 0.02  # of a strength's scale, for differences of runs


@dataclass(frozen=True)
class Place:
    """A candidate at one place of its bank.

    Attributes
    ----------
    shape, nulls, scales : dict
        Values of the shape parameters, and null values and scales of the strengths, by path.
    bounds : dict
        Of the strengths, by path.
    one_sided : ndarray of bool, shape (strengths,)
        Whether a strength can only be larger than its null value.
    columns : ndarray, shape (n, strengths)
        Derivatives of the residuals by the strengths over their scales, at the null value.
    """

    shape: dict[str, float]
    nulls: dict[str, float]
    scales: dict[str, float]
    bounds: dict[str, tuple[float, float]]
    one_sided: np.ndarray
    columns: np.ndarray


def bank_columns(bench: Workbench, fitted: Fitted, candidate: Candidate) -> list[Place]:
    """Derivatives of the residuals by the strengths at their null values, at every place of the bank."""
    return all_columns(bench, fitted, [candidate])[0]


def all_columns(
    bench: Workbench, fitted: Fitted, candidates: Sequence[Candidate],
    progress: Callable[[str], None] = lambda text: None,
) -> list[list[Place]]:  # fmt: skip
    """Like `bank_columns`, of many candidates: at their null values all are one robot, so one run of each trial tells.

    What this run cannot tell, of effects that change more than forces, stiffnesses, masses and natural shapes, takes
    runs of its own.
    """
    robot = _robot(bench, fitted)
    banks: list[_Bank | None] = []
    for candidate in candidates:
        try:
            banks.append(_Bank.of(bench, fitted, candidate, robot))
        except TermError as error:  # beside what the model holds there is no place for it
            bench.tell(f"{candidate.id} cannot be scored: {error}")
            banks.append(None)
    progress(f"columns of {len(candidates)} candidates")
    together = shared_columns(bench, fitted, [bank for bank in banks if bank is not None])
    found: list[list[Place]] = []
    for candidate, bank in zip(candidates, banks, strict=True):
        if bank is None:
            found.append([])
        elif candidate.id in together:
            found.append(bank.placed(together[candidate.id], bank.one_sided))
        else:
            progress(f"columns of {candidate.id}")
            found.append(_by_itself(bench, fitted, bank))
    return found


@dataclass(frozen=True)
class _Bank:
    """A candidate with all its places."""

    candidate: Candidate
    shapes: list[dict[str, float]]
    scales: dict[str, float]
    nulls: dict[str, float]
    bounds: dict[str, tuple[float, float]]
    one_sided: np.ndarray
    additive: bool

    @classmethod
    def of(cls, bench: Workbench, fitted: Fitted, candidate: Candidate, robot: Robot) -> _Bank | None:
        """Of a candidate that can be added to a fitted model, else None.

        Raises
        ------
        TermError
            If nothing in its bank is within its bounds.
        """
        edited = candidate.build(robot)
        if edited is None or set(candidate.strength) & {q.path for q in fitted.quantities}:
            return None
        rec = bench.case.part(bench.recordings[0])
        instruments = bench.case.observations(rec, edited) if candidate.observe else ()
        nulls, known = candidate.nulls(edited, instruments), candidate.parameters(edited, instruments)
        return cls(
            candidate,
            _within(places(candidate, edited, longest(bench)), edited),
            candidate.scales(edited, longest(bench), instruments),
            nulls,
            {p: (float(known[p].bounds[0]), float(known[p].bounds[1])) for p in candidate.strength},
            np.array([float(known[p].bounds[0]) >= nulls[p] for p in candidate.strength]),
            _additive(robot, edited),
        )

    def placed(self, G: np.ndarray, one_sided: np.ndarray, shapes: Any = None) -> list[Place]:
        """Places with their columns, of some of the shapes or all, one after the other."""
        count, found = len(self.candidate.strength), []
        scales = {p: self.scales[p] for p in self.candidate.strength}
        for k, shape in enumerate(self.shapes if shapes is None else shapes):
            part = slice(k * count, (k + 1) * count)
            found.append(Place(shape, self.nulls, scales, self.bounds, one_sided[:count], G[:, part]))
        return found


def _by_itself(bench: Workbench, fitted: Fitted, bank: _Bank) -> list[Place]:
    """Places of a candidate whose columns take runs of its own."""
    candidate, shapes, found = bank.candidate, bank.shapes, []
    for group in [shapes] if bank.additive and len(shapes) > 1 else [[s] for s in shapes]:
        try:
            G, one_sided = _derivatives(bench, fitted, candidate, group, bank.scales)
        except RodnetError as error:
            bench.tell(f"{candidate.id} cannot be scored: {error}")
            continue
        found += bank.placed(G, one_sided, group)
    return found


def longest(bench: Workbench) -> float:
    """Duration of the longest trial [s]: onsets may be anywhere in it."""
    return max(bench.case.part(rec).duration for rec in bench.recordings)


def places(candidate: Candidate, robot: Robot, duration: float) -> list[dict[str, float]]:
    """All combinations of a bank's values, thinned out if they are too many."""
    bank = candidate.values(robot, duration)
    combined = [dict(zip(bank, values, strict=True)) for values in product(*bank.values())]
    if len(combined) > MOST:
        combined = [combined[k] for k in np.unique(np.linspace(0, len(combined) - 1, MOST).astype(int))]
    return combined


def _within(shapes: list[dict[str, float]], robot: Robot) -> list[dict[str, float]]:
    """Places within bounds: these are of the first of all trials, a bank may be of the first of some."""
    bounds = {path: parameter.bounds for path, parameter in robot.parameters.items()}
    free = (-np.inf, np.inf)
    kept = [
        s for s in shapes if all(bounds.get(p, free)[0] <= v <= bounds.get(p, free)[1] for p, v in s.items())
    ]
    if not kept:
        raise TermError("nothing in its bank is within its bounds")
    return kept


def _robot(bench: Workbench, fitted: Fitted) -> Robot:
    """The robot of the first trial with what the model holds."""
    case = with_candidates(bench.case, fitted.candidates, ())
    return case.robot(case.part(bench.recordings[0]))


def _additive(before: Robot, after: Robot) -> bool:
    names = {t.name for t in after.terms}
    return (
        after.graph is before.graph
        and all(t.name in names for t in before.terms)
        and len(after.terms) > len(before.terms)
    )


def _derivatives(
    bench: Workbench, fitted: Fitted, candidate: Candidate, shapes: Sequence[Mapping[str, float]],
    scales: Mapping[str, float],
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Columns of one or several places of a candidate, from one run of each trial, and which are one-sided."""
    base = with_candidates(bench.case, fitted.candidates, ())
    several = len(shapes) > 1
    build = _Stacked(base, candidate, tuple(dict(s) for s in shapes), several)
    tags = [_tag(k) if several else "" for k in range(len(shapes))]
    paths = [_tagged(p, tag) for tag in tags for p in candidate.strength]
    case = replace(bench.case, build=build, free=tuple(paths), per_trial=())
    over = replace(bench, case=case)
    values = {p: v for p, v in fitted.values.items() if p not in paths}
    if candidate.observe:  # parameters of instruments are where the fit has them
        values |= {p: fitted.values[p] for p in paths if p in fitted.values}
        values |= {p: v for p, v in shapes[0].items() if p not in fitted.values}
    problem = over.problem((), values, free=())
    problem.quantities = [
        replace(q, scale=float(scales[_untagged(q.path)]), log=False, prior=None) for q in problem.quantities
    ]
    fixed = dict(problem.fixed)
    fixed |= {p: v for p, v in fitted.values.items() if p not in paths and _of_instruments(fitted, p)}
    held = _Held(
        problem.quantities, problem.packed, problem.names, {}, problem.executor, problem.rejected, fixed
    )
    held.own = [dict(o) for o in fitted.own]
    for own in held.own:
        known = with_ties(bench.case.tied, {**fitted.values, **own})
        own |= {path: known[path] for path in bench.case.tied}
    one_sided = np.array([q.low >= q.start for q in held.quantities])
    try:
        fits = held.at(np.zeros(len(paths)))
    except DerivativeError:  # a law with a corner at its null value
        return _secants(bench, held), one_sided
    if fits is None:
        raise ConvergenceError(held.failures[-1])
    bench.simulated += len(fits)
    return np.concatenate([f.jacobian for f in fits if f.jacobian is not None]), one_sided


def _secants(bench: Workbench, held: _Held) -> np.ndarray:
    """Columns by differences of whole runs, one for each strength: the null value and a part of a scale above it."""
    count = len(held.quantities)
    runs = []
    for z in (np.zeros(count), *(SECANT * np.eye(count))):
        fits = held.fits(z, slopes=False)
        if fits is None:
            raise ConvergenceError(held.failures[-1])
        bench.simulated += len(fits)
        runs.append(np.concatenate([f.residual for f in fits]))
    return np.stack([(run - runs[0]) / SECANT for run in runs[1:]], axis=1)


def _of_instruments(fitted: Fitted, path: str) -> bool:
    """Whether a value is free in the fitted model, so that it must be handed on."""
    return any(q.path == path for q in fitted.quantities)


class _Held(Problem):
    """A problem whose trials have fixed values of their own."""

    own: list[dict[str, float]]

    def values(self, z: np.ndarray, trial: int) -> dict[str, float]:
        return {**super().values(z, trial), **self.own[trial]}


@dataclass(frozen=True)
class _Stacked:
    """Builds robots with an effect at several places."""

    case: Case
    candidate: Candidate
    shapes: tuple[dict[str, float], ...]
    several: bool

    def __call__(self, rec: Recording) -> Robot:
        robot = self.case.robot(rec)
        names = {t.name for t in robot.terms}
        if not self.several:
            built = self._built(robot, rec)
            shape = {p: v for p, v in self.shapes[0].items() if p in built.parameters}
            return built.with_parameters(robot_values(built, shape)) if shape else built
        added: list[Any] = []
        for k, shape in enumerate(self.shapes):
            built = self._built(robot, rec)
            built = built.with_parameters(robot_values(built, shape))
            for term in built.terms:
                if term.name not in names:
                    added.append(_renamed(term, term.name + _tag(k)))
        return Robot(robot.graph, [*robot.terms, *added], robot.sensors)

    def _built(self, robot: Robot, rec: Recording) -> Robot:
        built = self.candidate.build(robot)
        if built is None:
            raise CaseError(f"the robot of '{rec.name}' has no place for it, that of other trials has")
        return built


def _renamed(term: Term, name: str) -> Term:
    """A copy of a term with another name and parameters of its own: those that a candidate gives are all places'."""
    other, own = copy.copy(term), dict[int, Parameter]()
    other.name = name
    for key, parameter in term.parameter_items():  # one that is shared within the term stays so
        setattr(other, key, own.setdefault(id(parameter), copy.copy(parameter)))
    return other


def _tag(k: int) -> str:
    return f"_place{k}"


def _tagged(path: str, tag: str) -> str:
    term, dot, name = path.partition(".")
    return f"{term}{tag}{dot}{name}"


def _untagged(path: str) -> str:
    term, dot, name = path.partition(".")
    return f"{term.partition('_place')[0]}{dot}{name}"
