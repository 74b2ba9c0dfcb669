"""Score tests: what each candidate effect would explain, to first order, once the nominal parameters are refitted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import lsq_linear
from scipy.stats import chi2 as chi2_of

from rodnet.diagnosis.candidate import Candidate
from rodnet.diagnosis.columns import Place, all_columns
from rodnet.diagnosis.crossval import cross_gains, reduced
from rodnet.diagnosis.scales import ALPHA, CLASS, LEAST, TIMES, variance_factor
from rodnet.diagnosis.workbench import RANK, Fitted, Workbench
from rodnet.inference.corrections import is_record

NOTHING = 0.005  # of what several strengths explain, that one of them must, or it has nothing to do
MISSED = 1.28  # standard deviations beyond the threshold at which nine of ten effects would have been seen


@dataclass(frozen=True)
class Scanned:
    """A place of a candidate's bank.

    Attributes
    ----------
    shape, strength : dict
        The place, and changes of strengths that explain most there, to first order, by path.
    chi2 : float
        By how much the deviance would fall.
    follow : ndarray, shape (k, dof), or None
        As of a score.
    """

    shape: dict[str, float]
    strength: dict[str, float]
    chi2: float
    follow: np.ndarray | None


@dataclass(frozen=True)
class Score:
    """What a candidate would explain, at the best place of its bank.

    Attributes
    ----------
    candidate : Candidate
        The effect.
    shape : dict
        Values of its shape parameters, by path.
    bounds : dict
        Of its strengths, by path.
    strength, nulls, scales : dict
        Changes of its strengths from their null values that explain most, to first order (0 of what does nothing to
        first order), those values, and scales.
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
        Strengths that would have been seen with a probability of 0.9, and named, at the median place of the bank, the
        other strengths unknown; by path. Infinite where none within bounds would.
    gains : ndarray, shape (trials,)
        By how much the deviance of each trial would fall.
    promise : ndarray, shape (trials,)
        By how much it would when the trial is predicted from the others, over ``factor``.
    columns : ndarray, shape (n, dof)
        Derivatives of the residuals by the strengths, nominal parameters projected out.
    tried : int
        Number of places.
    scanned : list of Scanned
        All places, what explains most at each, and how much that is.
    factor : float
        By which the variance that is left is larger than the noise's: ``p`` and ``detectable`` count with it.
    follow : ndarray, shape (k, dof), or None
        By how much the coordinates of the fitted model's quantities follow each strength, to first order.
    one_sided : ndarray of bool, shape (dof,)
        Which strengths cannot be below their null values.
    lean : int
        How many of them explain as much as all do.
    begin : Fitted or None
        The model that a refit begins with, if not the one at which it is scored.
    visible : dict
        As ``detectable``, if there were no numerical error.
    ran : bool
        Whether its strengths are those of full runs, of which one with smaller strengths left more.
    """

    candidate: Candidate
    shape: dict[str, float]
    strength: dict[str, float]
    nulls: dict[str, float]
    scales: dict[str, float]
    bounds: dict[str, tuple[float, float]]
    chi2: float
    dof: int
    p: float
    survives: float
    effect_sigma: float
    detectable: dict[str, float]
    gains: np.ndarray
    promise: np.ndarray
    columns: np.ndarray
    tried: int
    scanned: list[Scanned] = field(default_factory=list)
    factor: float = 1.0
    follow: np.ndarray | None = None
    one_sided: np.ndarray = field(default_factory=lambda: np.zeros(1, dtype=bool))
    lean: int = 1
    begin: Fitted | None = None
    visible: dict[str, float] = field(default_factory=dict)
    ran: bool = False

    def unprojected(self, jacobian: np.ndarray) -> np.ndarray:
        """Columns with what the nominal parameters can do put back, shape (n, dof).

        ``jacobian`` is that of the fitted model, shape (n, k); ``follow`` must be known.
        """
        assert self.follow is not None
        scales = np.array([self.scales[p] for p in self.candidate.strength])
        return np.asarray(self.columns - jacobian @ (self.follow * scales))


@dataclass(frozen=True)
class Basis:
    """Orthonormal directions that the nominal parameters can move the residuals in.

    Attributes
    ----------
    U : ndarray, shape (n, m)
        The directions.
    back : ndarray, shape (k, m)
        The smallest changes of the parameters that move the residuals in each.
    """

    U: np.ndarray
    back: np.ndarray

    @classmethod
    def of(cls, J: np.ndarray) -> Basis:
        """From the derivatives by the nominal parameters, shape (n, k)."""
        if not J.shape[1]:
            return cls(np.zeros((len(J), 0)), np.zeros((0, 0)))
        size = np.linalg.norm(J, axis=0)
        size = np.where(size > 0.0, size, 1.0)
        U, s, Vt = np.linalg.svd(J / size, full_matrices=False)
        kept = s > RANK * s[0]
        return cls(U[:, kept], (Vt[kept] / s[kept, None]).T / size[:, None])

    def follow(self, columns: np.ndarray) -> np.ndarray:
        """Changes of the parameters that take away what they can of columns, shape (k, columns)."""
        return -self.back @ (self.U.T @ columns)

    def out(self, columns: np.ndarray) -> np.ndarray:
        """What of columns it cannot do."""
        return columns - self.U @ (self.U.T @ columns)


def screen(
    bench: Workbench, fitted: Fitted, candidates: Sequence[Candidate],
    progress: Callable[[str], None] = lambda text: None, numerical: float = 0.0,
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
    progress : callable
        Told which candidate is next.
    numerical : float
        Numerical error [sigma]: what is not so many times as large is not named.

    Returns
    -------
    list of Score
    """
    basis = Basis.of(fitted.jacobian)
    records = [is_record(q.path) for q in fitted.quantities]
    aside = Basis.of(fitted.jacobian[:, ~np.array(records)]) if any(records) else basis
    r = basis.out(fitted.residual)
    ends = np.cumsum([len(f.residual) for f in fitted.fits])
    found = []
    banks = all_columns(bench, fitted, candidates, progress)
    for candidate, columns in zip(candidates, banks, strict=True):
        if columns:
            found.append(_score(candidate, columns, fitted, (basis, aside), r, ends))
    places = sum(s.tried for s in found)
    least = (LEAST, max(LEAST, TIMES * numerical))
    found = [_among(s, places, np.sqrt(fitted.samples) * np.array(least)) for s in found]
    return sorted(found, key=lambda s: (s.p, -s.chi2))


def worst(fitted: Fitted) -> list[int]:
    """Numbers of the trials, those that a model fits worst first."""
    rest = [float(f.residual @ f.residual) / max(len(f.residual), 1) for f in fitted.fits]
    return [int(k) for k in np.argsort(rest)[::-1]]


def _among(score: Score, places: int, least: np.ndarray) -> Score:
    """The same, as one of so many places that were tried.

    What moves all residuals together by less than ``least`` is not named, beside noise alone and beside the numerical
    error, too. A strength that is beyond its bounds before it shows would not. So far ``detectable`` is the standard
    deviation of each strength, and ``visible`` that without errors of drives' records.
    """
    beyond = (float(np.sqrt(chi2_of.isf(ALPHA / places, score.dof))) + MISSED) * float(np.sqrt(score.factor))

    def shown(p: str, enough: float) -> float:
        null, (low, high) = score.nulls[p], score.bounds[p]
        reach = max(beyond * score.detectable[p], enough * score.visible[p])
        return reach if low <= null - reach or null + reach <= high else np.inf

    visible, detectable = ({p: shown(p, float(enough)) for p in score.detectable} for enough in least)
    return replace(score, p=min(1.0, score.p * places), detectable=detectable, visible=visible)


def _score(
    candidate: Candidate, columns: Sequence[Place], fitted: Fitted, bases: tuple[Basis, Basis], r: np.ndarray,
    ends: np.ndarray,
) -> Score:  # fmt: skip
    """The best place of a bank.

    Of ``bases`` the second is without errors of drives' records. They are an explanation that costs, no freedom of the
    model: how likely a strength is counts with them, how large its effect is without.
    """
    basis, aside = bases
    best, scanned, sds = None, [], []
    for place in columns:
        shape, scales, G = place.shape, place.scales, place.columns
        padded = np.zeros((len(r), G.shape[1]))
        padded[: len(G)] = G
        P = basis.out(padded)
        alone = P if aside is basis else aside.out(padded)
        size = np.linalg.norm(alone, axis=0)
        raw = np.linalg.norm(padded, axis=0)
        survives = float(np.max(size / np.where(raw > 0.0, raw, 1.0), initial=0.0))
        if not (survives > 1e-6 and np.isfinite(P).all()):
            scanned.append(Scanned(shape, {}, 0.0, None))
            continue
        signs = place.one_sided
        z = strongest(P, r, signs)
        sds.append([_sd(P), _sd(alone)])
        explained = float(-(2.0 * (P @ z) @ r + (P @ z) @ (P @ z)))
        follow = basis.follow(padded) / np.array([scales[p] for p in candidate.strength])
        strength = {p: float(c * scales[p]) for p, c in zip(candidate.strength, z, strict=True)}
        scanned.append(Scanned(shape, strength, explained, follow))
        if best is None or explained > best[0]:
            best = (explained, shape, place, scales, z, P, alone, survives, signs, follow)
    tried = len(columns)
    if best is None:
        none, count = np.zeros(len(ends)), len(candidate.strength)
        one, nothing = columns[0], dict.fromkeys(candidate.strength, 0.0)
        return Score(
            candidate, one.shape, nothing, one.nulls, one.scales, one.bounds, 0.0, count, 1.0, 0.0, 0.0,
            dict.fromkeys(candidate.strength, np.inf), none, none, np.zeros((len(r), count)), tried, scanned,
            one_sided=one.one_sided, visible=dict.fromkeys(candidate.strength, np.inf),
        )  # fmt: skip
    explained, shape, place, scales, z, P, alone, survives, signs, follow = best
    dof = P.shape[1]
    factor = variance_factor(fitted, r + P @ z)
    p = float(chi2_of.sf(max(explained, 0.0) / factor, dof)) * (0.5 if signs.all() and dof == 1 else 1.0)
    if explained <= 0.0:
        p = 1.0
    moved = P @ z
    begin = np.concatenate([[0], ends[:-1]])
    gains = np.array(
        [-(2.0 * moved[a:b] @ r[a:b] + moved[a:b] @ moved[a:b]) for a, b in zip(begin, ends, strict=True)]
    )
    strength = {p_: float(c * s) for (p_, s), c in zip(scales.items(), z, strict=True)}
    # over the places: the best of them is where noise fits best, if nothing is there
    seen, visible = (
        {p_: float(s * d) if d > 0.0 else np.inf for (p_, s), d in zip(scales.items(), sd, strict=True)}
        for sd in np.median(sds, axis=0)
    )
    effect = float(np.sqrt(np.mean((alone @ z)[: ends[-1]] ** 2)))
    return Score(
        candidate,
        shape,
        strength,
        place.nulls,
        scales,
        place.bounds,
        explained,
        dof,
        p,
        survives,
        effect,
        seen,
        gains,
        promised(fitted, place.columns[:, z != 0.0]) / factor,
        P,
        tried,
        scanned,
        factor,
        follow,
        signs,
        _lean(P, r, signs, explained - max(CLASS * factor, NOTHING * explained)),
        visible=visible,
    )


def _sd(P: np.ndarray) -> np.ndarray:
    """Standard deviations of strengths from the columns that they move residuals by, shape (dof,)."""
    return np.asarray(np.sqrt(np.diag(np.linalg.pinv(P.T @ P, rcond=1e-12, hermitian=True))))


def _lean(P: np.ndarray, r: np.ndarray, one_sided: np.ndarray, enough: float) -> int:
    """How many strengths explain so much of a residual, the best first."""
    chosen: list[int] = []
    rest = list(range(P.shape[1]))
    while len(rest) > 1:
        gains = []
        for k in rest:
            some = [*chosen, k]
            moved = P[:, some] @ strongest(P[:, some], r, one_sided[some])
            gains.append(float(-(2.0 * moved @ r + moved @ moved)))
        chosen.append(rest.pop(int(np.argmax(gains))))
        if max(gains) >= enough:
            return len(chosen)
    return P.shape[1]


def strongest(P: np.ndarray, r: np.ndarray, one_sided: np.ndarray) -> np.ndarray:
    """Strengths that explain most of a residual, none of those with a side beyond its null value."""
    z, *_ = np.linalg.lstsq(P, -r, rcond=1e-8)
    if not np.any(one_sided & (z < 0.0)):
        return np.asarray(z)
    Q, R = np.linalg.qr(P)
    return np.asarray(lsq_linear(R, -Q.T @ r, (np.where(one_sided, 0.0, -np.inf), np.inf), method="bvls").x)


def promised(fitted: Fitted, columns: np.ndarray) -> np.ndarray:
    """By how much the deviance of each trial falls, predicted from the others, with more that is common to all.

    Parameters
    ----------
    fitted : Fitted
        The model.
    columns : ndarray, shape (n, m)
        Derivatives of its residuals by what is to be added.

    Returns
    -------
    ndarray, shape (trials,)
    """
    size = np.linalg.norm(columns, axis=0)
    forms, prior = reduced(fitted, columns[: fitted.samples] / np.where(size > 0.0, size, 1.0))
    return cross_gains(forms, prior, np.eye(columns.shape[1])[None])[0]


def isolability(scores: Sequence[Score]) -> np.ndarray:
    """Largest canonical correlations of the projected effects: 1 where two cannot be told apart.

    Parameters
    ----------
    scores : sequence of Score
        Of `screen`, c of them.

    Returns
    -------
    ndarray, shape (c, c)
        To first order, once the nominal parameters are refitted.
    """
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
