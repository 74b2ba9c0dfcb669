"""Unnamed forces on parts of the body: placebos drawn from them, and a flexible force fitted beside an effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rodnet.diagnosis.columns import bank_columns, longest
from rodnet.diagnosis.crossval import cross_gains, reduced
from rodnet.diagnosis.heldout import common_columns
from rodnet.diagnosis.library import EYE, Piece, body, crowds, law_of, pieces, searched, simple
from rodnet.diagnosis.scales import variance_factor
from rodnet.diagnosis.screen import Basis
from rodnet.diagnosis.verdict import GAIN
from rodnet.diagnosis.workbench import Fitted, Workbench

if TYPE_CHECKING:
    from rodnet.diagnosis.findings import HeldOut

DRAWS = 200
BEATEN = 0.95  # of the placebos that an effect must beat beside a remainder
RANGE = np.logspace(-6.0, 3.0, 46)  # of a flexible force's strength, over that of the residual


@dataclass(frozen=True)
class ForceColumns:
    """Derivatives of the residuals by unnamed forces.

    Attributes
    ----------
    names : list of str
        Paths of their coefficients.
    scales : dict
        Changes of the coefficients that the columns are for.
    columns : ndarray, shape (n, k)
        Nothing projected out.
    one_sided : ndarray of bool, shape (k,)
        Whether a coefficient can only be positive.
    """

    names: list[str]
    scales: dict[str, float]
    columns: np.ndarray
    one_sided: np.ndarray

    def beside(self, more: ForceColumns) -> ForceColumns:
        """Return these and others."""
        columns = np.hstack([self.columns, more.columns])
        return ForceColumns(
            [*self.names, *more.names],
            {**self.scales, **more.scales},
            columns,
            np.append(self.one_sided, more.one_sided),
        )

    def without(self, parameters: Sequence[str]) -> ForceColumns:
        """Return those of other parameters than these."""
        kept = [k for k, name in enumerate(self.names) if name.rpartition(".")[2] not in parameters]
        names = [self.names[k] for k in kept]
        scales = {name: self.scales[name] for name in names}
        return ForceColumns(names, scales, self.columns[:, kept], self.one_sided[kept])


def library_of(bench: Workbench) -> list[Piece]:
    """All terms of the library that the robots of all trials can have together.

    Parameters
    ----------
    bench : Workbench
        The trials.

    Returns
    -------
    list of Piece
        What a law may consist of; `force_columns` and `draft` take them.
    """
    return pieces(bench.case.robot(bench.simplest), longest(bench))


def body_of(bench: Workbench) -> list[Piece]:
    """Terms that act alike on all parts of the body: sums of the library, which a law may have in their place."""
    return body(bench.case.robot(bench.simplest), longest(bench))


def searched_of(bench: Workbench) -> list[Piece]:
    """Terms of which a law has those of one kind at most, and searches their shape: neighbours, currents in patches
    or that pulse; the latter not where sigma is a misfit.
    """
    robot = bench.case.robot(bench.simplest)
    return [*crowds(robot), *(searched(robot, longest(bench)) if bench.case.noise is None else [])]


def force_columns(bench: Workbench, fitted: Fitted, given: Sequence[Piece]) -> ForceColumns:
    """Columns of a library at a fitted model, but those that it has: a run of each trial; neighbours and cameras, too.

    Parameters
    ----------
    bench : Workbench
        The trials.
    fitted : Fitted
        The model, fitted to them.
    given : sequence of Piece
        Terms of the library (`library_of`).

    Returns
    -------
    ForceColumns
        Derivatives of the residuals by their coefficients, shape (samples, m), with names and scales.
    """
    given = [piece for piece in given if not set(piece.paths) & set(fitted.values)]
    kinds = [[p for p in given if p.kind == kind] for kind in ("crowd", EYE)]
    found = _columns(bench, fitted, [p for p in given if all(p not in some for some in kinds)])
    for some in kinds:
        if some:
            found = found.beside(_columns(bench, fitted, some))
    return found


def _columns(bench: Workbench, fitted: Fitted, given: Sequence[Piece]) -> ForceColumns:
    library = law_of(given) if given else None
    places = bank_columns(bench, fitted, library) if library is not None else []
    if library is None or not places:
        return ForceColumns([], {}, np.zeros((fitted.samples, 0)), np.zeros(0, dtype=bool))
    one = places[0]
    seen = np.isfinite(one.columns).all(axis=0) & (np.linalg.norm(one.columns, axis=0) > 0.0)
    names = [path for path, s in zip(library.strength, seen, strict=True) if s]
    return ForceColumns(names, {p: one.scales[p] for p in names}, one.columns[:, seen], one.one_sided[seen])


@dataclass(frozen=True)
class Placebo:
    """What forces without meaning gain when they are chosen and fitted like candidates.

    Attributes
    ----------
    directions : ndarray, shape (draws, k)
        The force of each draw, over scales, its strengths those that fit best.
    train, cross : ndarray, shape (draws,)
        Its gains of deviance in training, and on trials left out.
    """

    directions: np.ndarray
    train: np.ndarray
    cross: np.ndarray

    def beaten(self, cross_gain: float) -> float:
        """Share of the placebos that gain less on trials left out; none where none can be drawn."""
        return float(np.mean(self.cross < cross_gain)) if len(self.cross) else 0.0


def placebo(fitted: Fitted, forces: ForceColumns, candidates: int, parameters: int, seed: int = 0) -> Placebo:
    """Draw random smooth forces, as many as there are candidates, and keep what gains most on trials left out.

    A force is a random combination of the unnamed ones, of equal effect each, with as many free strengths as a
    candidate has parameters; all to first order about the fitted model. That is repeated `DRAWS` times.
    """
    rng = np.random.default_rng(seed)
    count = forces.columns.shape[1]
    if not count:
        return Placebo(np.zeros((0, 0)), np.zeros(0), np.zeros(0))
    size = _sizes(fitted, forces.columns)
    form, prior = reduced(fitted, forces.columns / size)
    basis = Basis.of(fitted.jacobian)
    P = basis.out(_padded(forces.columns / size, len(fitted.residual)))
    A, b = P.T @ P, P.T @ basis.out(fitted.residual)
    chosen, train, cross = np.zeros((DRAWS, count)), np.zeros(DRAWS), np.zeros(DRAWS)
    for draw in range(DRAWS):
        W = rng.standard_normal((max(candidates, 1), count, max(parameters, 1)))
        gains = cross_gains(form, prior, W).sum(axis=1)
        best = W[int(np.argmax(gains))]
        z = -np.linalg.lstsq(best.T @ A @ best, best.T @ b, rcond=1e-10)[0]
        d = best @ z
        chosen[draw], cross[draw] = d / size, float(np.max(gains))
        train[draw] = -(2.0 * d @ b + d @ A @ d)
    return Placebo(chosen, train, cross)


def placebos(
    bench: Workbench, base: Fitted, candidates: int, parameters: int, seed: int, held: HeldOut | None
) -> tuple[Placebo, np.ndarray]:
    """Draw placebos from loads and resistances, and return what they gain on trials not seen, if there are any.

    One that an effect's rule would not accept, or take back, gains nothing.

    Parameters
    ----------
    bench : Workbench
        The trials.
    base : Fitted
        The model that they join.
    candidates, parameters : int
        How many are drawn for each placebo, of which the best on trials left out is kept, and how many strengths each
        has.
    seed : int
        Of the draws.
    held : HeldOut or None
        Trials not seen.

    Returns
    -------
    drawn : Placebo
        The placebos, and what they gain of deviance in training and on trials left out.
    gains : ndarray, shape (draws,) or (0,)
        What they gain on trials not seen; none without such trials.
    """
    some = simple(library_of(bench))
    forces = force_columns(bench, base, some)
    drawn = placebo(base, forces, candidates, parameters, seed)
    if held is None:
        return drawn, np.zeros(0)
    seen = held.before.fitted
    common = common_columns(held.bench, base, held.before)
    gains = held_gains(base, forces, drawn, seen, common, force_columns(held.bench, seen, some))
    # as of an effect without a name: nothing of it stays that is not accepted, or makes trials not seen worse
    return drawn, np.where(drawn.cross > GAIN, np.maximum(gains, 0.0), 0.0)


def held_gains(
    fitted: Fitted, forces: ForceColumns, drawn: Placebo, seen: Fitted, common: np.ndarray,
    there: ForceColumns,
) -> np.ndarray:  # fmt: skip
    """By how much placebos lower the deviance of trials that were not seen, shape (draws,).

    Common parameters move with the force as they do in training; what a trial has of its own is refitted. A force is as
    strong there as in training, whatever its columns are for: scales go with the length of the trials.

    Parameters
    ----------
    fitted, forces, drawn
        The model in training, the unnamed forces there, and the placebos.
    seen : Fitted
        The model on the other trials.
    common : ndarray, shape (n, c)
        Derivatives of its residuals by the common coordinates of the model in training.
    there : ForceColumns
        Unnamed forces there.
    """
    if not len(drawn.directions):
        return np.zeros(0)
    place = {name: k for k, name in enumerate(there.names)}
    theirs = np.zeros((len(seen.residual), len(forces.names)))
    for k, name in enumerate(forces.names):
        if name in place:
            alike = forces.scales[name] / there.scales[name]
            theirs[: len(there.columns), k] = alike * there.columns[:, place[name]]
    J, size = fitted.jacobian, _sizes(fitted, forces.columns)
    follow = -np.linalg.pinv(J, rcond=1e-9) @ _padded(forces.columns / size, len(J))
    both = theirs / size + _padded(common, len(theirs)) @ follow[[q.trial is None for q in fitted.quantities]]
    own = Basis.of(seen.jacobian)
    H, h = own.out(both), own.out(seen.residual)
    d = drawn.directions * np.where(np.isfinite(size), size, 0.0)
    return np.asarray(-(2.0 * d @ (H.T @ h) + np.einsum("ni,ij,nj->n", d, H.T @ H, d)))


def beside_force(model: Fitted, forces: ForceColumns, paths: tuple[str, ...]) -> dict[str, float]:
    """Values of common parameters when a flexible residual force is fitted alongside, to first order.

    The force is the sum of all unnamed ones, of equal effect each, with a prior whose width is what the evidence
    prefers; parameters of the model are free.
    """
    J, r = model.jacobian, model.residual
    found = {p: model.values[p] for p in paths}
    if not forces.columns.shape[1]:
        return found
    F = _padded(forces.columns / _sizes(model, forces.columns), len(r))
    basis = Basis.of(J)
    U, s, Vt = np.linalg.svd(basis.out(F), full_matrices=False)
    c, noise = U.T @ basis.out(r), variance_factor(model)
    spread = noise + np.outer(RANGE * float(r @ r), s**2)
    evidence = -0.5 * np.sum(np.log(spread) + c**2 / spread, axis=1)
    wide = RANGE[int(np.argmax(evidence))] * float(r @ r)
    a = -Vt.T @ (wide * s / (noise + wide * s**2) * c)
    change = -np.linalg.pinv(J, rcond=1e-9) @ (r + F @ a)
    for path in paths:
        k = model.place(path)
        q = model.quantities[k]
        found[path] = q.value(q.coordinate(model.values[path]) + float(change[k]))
    return found


def _sizes(fitted: Fitted, columns: np.ndarray) -> np.ndarray:
    """Norms of columns once the parameters of the model are projected out."""
    size = np.linalg.norm(Basis.of(fitted.jacobian).out(_padded(columns, len(fitted.residual))), axis=0)
    return np.where(size > 1e-9 * np.linalg.norm(columns, axis=0), size, np.inf)


def _padded(columns: np.ndarray, count: int) -> np.ndarray:
    """Columns with no effect on the priors."""
    out = np.zeros((count, columns.shape[1]))
    out[: len(columns)] = columns
    return out
