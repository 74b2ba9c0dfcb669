"""A drafted law: what a model leaves, as a sparse sum of local laws that runs like any other term.

Sparse regression in the output: the derivatives of the recorded motion by the coefficients of the whole library are
exact columns of the tangent, so no acceleration is taken from noisy tracks, and nothing that was not seen is guessed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from rodnet.diagnosis.candidate import Candidate
from rodnet.diagnosis.crossval import cross_gains, reduced
from rodnet.diagnosis.forces import ForceColumns, library_of
from rodnet.diagnosis.library import Piece, law_of
from rodnet.diagnosis.refit import Refit, assess, best_fit
from rodnet.diagnosis.scales import variance_factor
from rodnet.diagnosis.screen import Basis, Score
from rodnet.diagnosis.selection import Accepted
from rodnet.diagnosis.verdict import GAIN, Judgement, judge
from rodnet.diagnosis.workbench import Fitted, Workbench

FEATURES = 8  # at most
ROUNDS = 2  # of choosing features, the second by what the law of the first leaves
WORTH = 0.2  # of what the first law gained on trials left out, that a longer one must promise


@dataclass(frozen=True)
class Draft:
    """A law that was drafted.

    Attributes
    ----------
    refit : Refit
        It, fitted with everything else.
    judgement : Judgement
        Whether it is accepted, by the rules for every candidate.
    pieces : list of Piece
        Its terms.
    """

    refit: Refit
    judgement: Judgement
    pieces: list[Piece]

    @property
    def candidate(self) -> Candidate:
        """The law as a candidate."""
        return self.refit.score.candidate

    def accepted(self, parent: Fitted) -> Accepted:
        """As one of the effects in the model."""
        return Accepted(self.refit, parent, [], sure=False)


def draft(
    bench: Workbench, model: Fitted, forces: ForceColumns, numerical: float, tell: Callable[[str], None]
) -> Draft | None:
    """Describe what a model leaves by a law; None if no law gains anything.

    Parameters
    ----------
    bench : Workbench
        The trials.
    model : Fitted
        The model, with whatever was accepted.
    forces : ForceColumns
        Of the whole library, at it.
    numerical : float
        Numerical error [sigma].
    tell : callable
        Told of the progress.
    """
    library = library_of(bench)
    best: Draft | None = None
    chosen: dict[str, float] = {}
    # where sigma is a misfit it stands in for much, and need not grow
    for _ in range(ROUNDS if bench.case.noise is None else 1):
        tell("looking for a law in what is left")
        more, promise = sparse(model if best is None else best.refit.fitted, forces, tuple(chosen))
        if not more or (best is not None and promise < WORTH * best.refit.cross_gain * best.refit.factor):
            break
        chosen |= more
        used = [_only(piece, chosen) for piece in library if set(piece.paths) & set(chosen)]
        law = law_of(used, {p: abs(v) or 1.0 for p, v in chosen.items()})
        score = _score(law, chosen, sum(len(piece.parameters) for piece in library))
        tell(f"refit with a law of {len(law.strength)} parts")
        fitted = best_fit(bench, model, score)
        if fitted is None or (best is not None and fitted.deviance >= best.refit.fitted.deviance):
            break
        refit = assess(bench, model, fitted, score, score.tried)
        if best is not None and refit.cross_gain < best.refit.cross_gain + GAIN:
            break
        best = Draft(refit, judge(refit, numerical), used)
        chosen = {p: fitted.values[p] for p in law.strength}
    return best


def sparse(
    model: Fitted, columns: ForceColumns, known: tuple[str, ...] = ()
) -> tuple[dict[str, float], float]:
    """Choose coefficients stepwise by what trials left out gain; return their values, by path, and that gain.

    One is added as long as that gains three nats on trials left out, in units of what would be left; then those
    are deleted again without which the others gain as much. ``known`` are in the model already; the columns may be
    those without them, for a full fit follows.
    """
    count = columns.columns.shape[1]
    basis = Basis.of(model.jacobian)
    size = np.linalg.norm(basis.out(_padded(columns.columns, model)), axis=0)
    idle = size < 1e-6 * np.linalg.norm(columns.columns, axis=0)
    size = np.where(idle, np.inf, size)
    form, prior = reduced(model, columns.columns / size)
    P, r = basis.out(_padded(columns.columns / size, model)), basis.out(model.residual)

    def gain(chosen: list[int]) -> float:
        return float(cross_gains(form, prior, _one_hot([chosen], count)).sum())

    def solved(chosen: list[int]) -> tuple[np.ndarray, float]:
        z = -np.linalg.lstsq(P[:, chosen], r, rcond=1e-10)[0]
        return z, variance_factor(model, r + P[:, chosen] @ z)

    out = set(np.flatnonzero(idle).tolist()) | {k for k, p in enumerate(columns.names) if p in known}
    chosen: list[int] = []
    now = 0.0
    while len(chosen) < FEATURES:
        rest = [k for k in range(count) if k not in chosen and k not in out]
        if not rest:
            break
        gains = cross_gains(form, prior, _one_hot([[*chosen, k] for k in rest], count)).sum(axis=1)
        best = rest[int(np.argmax(gains))]
        z, factor = solved([*chosen, best])
        if float(np.max(gains)) < now + GAIN * factor:
            break
        if np.any(columns.one_sided[[*chosen, best]] & (z < 0.0)):  # a damping that drives
            out.add(best)
            continue
        chosen, now = [*chosen, best], float(np.max(gains))
    while len(chosen) > 1:  # thresholding: what the others have made needless
        shorter = [[c for c in chosen if c != k] for k in chosen]
        gains = np.array([gain(s) for s in shorter])
        if float(np.max(gains)) < now - GAIN * solved(chosen)[1]:
            break
        chosen = shorter[int(np.argmax(gains))]
        now = float(np.max(gains))
    if not chosen:
        return {}, 0.0
    z, _ = solved(chosen)
    values = {
        columns.names[k]: float(v / size[k] * columns.scales[columns.names[k]])
        for k, v in zip(chosen, z, strict=True)
    }
    return values, now


def _one_hot(choices: list[list[int]], count: int) -> np.ndarray:
    out = np.zeros((len(choices), count, len(choices[0])))
    for n, chosen in enumerate(choices):
        out[n, chosen, range(len(chosen))] = 1.0
    return out


def _padded(columns: np.ndarray, model: Fitted) -> np.ndarray:
    out = np.zeros((len(model.residual), columns.shape[1]))
    out[: len(columns)] = columns
    return out


def _only(piece: Piece, chosen: dict[str, float]) -> Piece:
    """A piece with the chosen parameters alone."""
    return replace(piece, parameters=tuple(p for p in piece.parameters if f"{piece.name}.{p}" in chosen))


def _score(law: Candidate, values: dict[str, float], features: int) -> Score:
    """Where the refit of a law begins."""
    found = {p: values[p] for p in law.strength}
    nulls = dict.fromkeys(law.strength, 0.0)
    scales = {p: abs(v) or 1.0 for p, v in found.items()}
    tried = features ** len(law.strength)  # as many laws of so many parts might have been chosen
    return Score(
        law,
        {},
        found,
        nulls,
        scales,
        0.0,
        len(found),
        1.0,
        1.0,
        0.0,
        {},
        np.zeros(0),
        np.zeros(0),
        np.zeros((0, 0)),
        tried,
    )
