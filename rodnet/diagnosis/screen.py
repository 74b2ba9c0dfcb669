"""Score tests: what each candidate effect would explain, to first order, once the nominal parameters are refitted."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np
from scipy.stats import chi2 as chi2_of

from rodnet.diagnosis.candidate import Candidate
from rodnet.diagnosis.workbench import RANK, Fitted, Workbench
from rodnet.errors import ConvergenceError, RodnetError
from rodnet.inference.case import Case
from rodnet.inference.problem import Problem
from rodnet.inference.quantities import robot_values
from rodnet.recordings.recording import Recording
from rodnet.robot import Robot

MOST = 48  # places of a bank that are tried
SEEN = 5.0  # standard deviations at which an effect would have been seen


@dataclass(frozen=True)
class Score:
    """What a candidate would explain, at the best place of its bank.

    Attributes
    ----------
    candidate : Candidate
        The effect.
    shape : dict
        Values of its shape parameters, by path.
    strength, nulls, scales : dict
        Changes of its strengths from their null values that explain most, to first order, those values, and scales.
    chi2 : float
        By how much the deviance would fall.
    dof : int
        Number of its strengths.
    p : float
        Probability of as large a score without any effect, for all places of all banks together.
    survives : float
        Share of the effect's signal that refitting the nominal parameters leaves.
    effect_sigma : float
        Rms change of a whitened sample that it would make, after that refit.
    detectable : dict
        Strengths that would have been seen, by path.
    gains : ndarray, shape (trials,)
        By how much the deviance of each trial would fall.
    columns : ndarray, shape (n, dof)
        Derivatives of the residuals by the strengths, nominal parameters projected out.
    tried : int
        Number of places.
    scanned : dict
        All places with their chi2, by path, for plots.
    """

    candidate: Candidate
    shape: dict[str, float]
    strength: dict[str, float]
    nulls: dict[str, float]
    scales: dict[str, float]
    chi2: float
    dof: int
    p: float
    survives: float
    effect_sigma: float
    detectable: dict[str, float]
    gains: np.ndarray
    columns: np.ndarray
    tried: int
    scanned: list[tuple[dict[str, float], float]] = field(default_factory=list)


@dataclass(frozen=True)
class Basis:
    """Orthonormal directions that the nominal parameters can move the residuals in."""

    U: np.ndarray

    @classmethod
    def of(cls, J: np.ndarray) -> Basis:
        """From the derivatives by the nominal parameters, shape (n, k)."""
        if not J.shape[1]:
            return cls(np.zeros((len(J), 0)))
        size = np.linalg.norm(J, axis=0)
        U, s, _ = np.linalg.svd(J / np.where(size > 0.0, size, 1.0), full_matrices=False)
        return cls(U[:, s > RANK * s[0]])

    def out(self, columns: np.ndarray) -> np.ndarray:
        """What of columns it cannot do."""
        return columns - self.U @ (self.U.T @ columns)


def screen(
    bench: Workbench, fitted: Fitted, candidates: Sequence[Candidate], factor: float = 1.0,
    progress: Callable[[str], None] = lambda text: None,
) -> list[Score]:  # fmt: skip
    """Score candidates at a fitted model, best first.

    Parameters
    ----------
    bench : Workbench
        The trials.
    fitted : Fitted
        The model; what it holds already is projected out with the nominal parameters.
    candidates : sequence of Candidate
        What to try.
    factor : float
        By which variances are larger than the noise's (what the model leaves anyway): scores are divided by it.
    progress : callable
        Told which candidate is next.

    Returns
    -------
    list of Score
    """
    basis = Basis.of(fitted.jacobian)
    r = basis.out(fitted.residual)
    ends = np.cumsum([len(f.residual) for f in fitted.fits])
    found = []
    for candidate in candidates:
        progress(f"score of {candidate.id}")
        columns = bank_columns(bench, fitted, candidate)
        if columns:
            found.append(_score(candidate, columns, basis, r, ends, factor))
    places = sum(s.tried for s in found)
    found = [replace(s, p=min(1.0, s.p * places)) for s in found]
    return sorted(found, key=lambda s: (s.p, -s.chi2))


def _score(
    candidate: Candidate, columns: Sequence[Place], basis: Basis, r: np.ndarray,
    ends: np.ndarray, factor: float,
) -> Score:  # fmt: skip
    """The best place of a bank."""
    best, scanned = None, []
    for place in columns:
        shape, scales, G = place.shape, place.scales, place.columns
        padded = np.zeros((len(r), G.shape[1]))
        padded[: len(G)] = G
        P = basis.out(padded)
        size = np.linalg.norm(P, axis=0)
        raw = np.linalg.norm(padded, axis=0)
        survives = float(np.max(size / np.where(raw > 0.0, raw, 1.0), initial=0.0))
        if not (survives > 1e-6 and np.isfinite(P).all()):
            scanned.append((shape, 0.0))
            continue
        z, *_ = np.linalg.lstsq(P, -r, rcond=1e-8)
        signs = place.one_sided
        z = np.where(signs & (z < 0.0), 0.0, z)
        explained = float(-(2.0 * (P @ z) @ r + (P @ z) @ (P @ z))) / factor
        scanned.append((shape, explained))
        if best is None or explained > best[0]:
            best = (explained, shape, place.nulls, scales, z, P, survives, signs)
    tried = len(columns)
    if best is None:
        zero = np.zeros((len(r), 1))
        return Score(
            candidate,
            columns[0].shape,
            {},
            {},
            {},
            0.0,
            1,
            1.0,
            0.0,
            0.0,
            {},
            np.zeros(len(ends)),
            zero,
            tried,
            scanned,
        )
    explained, shape, nulls, scales, z, P, survives, signs = best
    dof = P.shape[1]
    p = float(chi2_of.sf(max(explained, 0.0), dof)) * (0.5 if signs.all() and dof == 1 else 1.0)
    if explained <= 0.0:
        p = 1.0
    moved = P @ z
    begin = np.concatenate([[0], ends[:-1]])
    gains = np.array(
        [-(2.0 * moved[a:b] @ r[a:b] + moved[a:b] @ moved[a:b]) for a, b in zip(begin, ends, strict=True)]
    )
    strength = {p_: float(c * s) for (p_, s), c in zip(scales.items(), z, strict=True)}
    seen = {
        p_: float(SEEN * np.sqrt(factor) * s / n) if n > 0.0 else np.inf
        for (p_, s), n in zip(scales.items(), np.linalg.norm(P, axis=0), strict=True)
    }
    effect = float(np.sqrt(np.mean(moved[: ends[-1]] ** 2)))
    return Score(
        candidate,
        shape,
        strength,
        nulls,
        scales,
        explained,
        dof,
        p,
        survives,
        effect,
        seen,
        gains,
        P,
        tried,
        scanned,
    )


@dataclass(frozen=True)
class Place:
    """A candidate at one place of its bank.

    Attributes
    ----------
    shape, nulls, scales : dict
        Values of the shape parameters, and null values and scales of the strengths, by path.
    one_sided : ndarray of bool, shape (strengths,)
        Whether a strength can only be larger than its null value.
    columns : ndarray, shape (n, strengths)
        Derivatives of the residuals by the strengths over their scales, at the null value.
    """

    shape: dict[str, float]
    nulls: dict[str, float]
    scales: dict[str, float]
    one_sided: np.ndarray
    columns: np.ndarray


def bank_columns(bench: Workbench, fitted: Fitted, candidate: Candidate) -> list[Place]:
    """Derivatives of the residuals by the strengths at their null values, at every place of the bank."""
    robot = _robot(bench, fitted)
    rec = bench.recordings[0]
    edited = candidate.build(robot)
    if edited is None or set(candidate.strength) & {q.path for q in fitted.quantities}:
        return []
    duration = bench.case.part(rec).duration
    instruments = bench.case.observations(bench.case.part(rec), edited) if candidate.observe else ()
    shapes = places(candidate, edited, duration)
    scales = candidate.scales(edited, duration, instruments)
    nulls = candidate.nulls(edited, instruments)
    found = []
    groups = [shapes] if _additive(robot, edited) and len(shapes) > 1 else [[s] for s in shapes]
    for group in groups:
        try:
            G, one_sided = _derivatives(bench, fitted, candidate, group, scales)
        except RodnetError as error:
            bench.tell(f"{candidate.id} cannot be scored: {error}")
            continue
        count = len(candidate.strength)
        for k, shape in enumerate(group):
            part = slice(k * count, (k + 1) * count)
            mine = {p: scales[p] for p in candidate.strength}
            found.append(Place(shape, nulls, mine, one_sided[part], G[:, part]))
    return found


def places(candidate: Candidate, robot: Robot, duration: float) -> list[dict[str, float]]:
    """All combinations of a bank's values, thinned out if they are too many."""
    bank = candidate.values(robot, duration)
    combined = [dict(zip(bank, values, strict=True)) for values in product(*bank.values())]
    if len(combined) > MOST:
        combined = [combined[k] for k in np.unique(np.linspace(0, len(combined) - 1, MOST).astype(int))]
    return combined


def _robot(bench: Workbench, fitted: Fitted) -> Robot:
    """The robot of the first trial with what the model holds."""
    from rodnet.diagnosis.workbench import with_candidates

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
    from rodnet.diagnosis.workbench import with_candidates

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
    tied = {p: f for p, f in bench.case.tied.items()}
    held.fixed |= {p: float(f(fitted.values)) for p, f in tied.items()}
    fits = held.at(np.zeros(len(paths)))
    if fits is None:
        raise ConvergenceError(held.failures[-1])
    bench.simulated += len(fits)
    one_sided = np.array([q.low >= q.start for q in held.quantities])
    return np.concatenate([f.jacobian for f in fits if f.jacobian is not None]), one_sided


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
            built = self.candidate.build(robot)
            assert built is not None
            shape = {p: v for p, v in self.shapes[0].items() if p in built.parameters}
            return built.with_parameters(robot_values(built, shape)) if shape else built
        added: list[Any] = []
        for k, shape in enumerate(self.shapes):
            built = self.candidate.build(robot)
            assert built is not None
            built = built.with_parameters(robot_values(built, shape))
            for term in built.terms:
                if term.name not in names:
                    term = copy.copy(term)
                    term.name = term.name + _tag(k)
                    added.append(term)
        return Robot(robot.graph, [*robot.terms, *added], robot.sensors)


def _tag(k: int) -> str:
    return f"_place{k}"


def _tagged(path: str, tag: str) -> str:
    term, dot, name = path.partition(".")
    return f"{term}{tag}{dot}{name}"


def _untagged(path: str) -> str:
    term, dot, name = path.partition(".")
    return f"{term.partition('_place')[0]}{dot}{name}"


def isolability(scores: Sequence[Score]) -> np.ndarray:
    """Largest canonical correlations of the projected effects: 1 where two cannot be told apart, shape (c, c)."""
    bases = []
    for score in scores:
        U, s, _ = np.linalg.svd(score.columns, full_matrices=False)
        bases.append(U[:, s > 1e-6 * max(s[0], 1e-300)])
    out = np.eye(len(scores))
    for i, a in enumerate(bases):
        for j, b in enumerate(bases[:i]):
            overlap = np.linalg.svd(a.T @ b, compute_uv=False) if a.size and b.size else np.zeros(1)
            out[i, j] = out[j, i] = float(min(1.0, np.max(overlap, initial=0.0)))
    return out
