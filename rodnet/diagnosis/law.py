"""A drafted law: what a model leaves, as a sparse sum of local laws that runs like any other term.

Sparse regression in the output: the derivatives of the recorded motion by the coefficients of the whole library are
exact columns of the tangent, so no acceleration is taken from noisy tracks, and nothing that was not seen is guessed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rodnet.diagnosis.begin import ROUGHEST, best_fit
from rodnet.diagnosis.candidate import Candidate
from rodnet.diagnosis.chosen import Accepted
from rodnet.diagnosis.crossval import Reduced, cross_gains, reduced
from rodnet.diagnosis.eyes import eyes_of
from rodnet.diagnosis.forces import ForceColumns, body_of, force_columns, library_of, searched_of
from rodnet.diagnosis.library import BODY, OF_THE_SCENE, Piece, law_of
from rodnet.diagnosis.refit import Refit, assess
from rodnet.diagnosis.scales import variance_factor
from rodnet.diagnosis.screen import Basis, Score
from rodnet.diagnosis.verdict import GAIN, Judgement, judge
from rodnet.diagnosis.workbench import Fitted, Workbench

FEATURES = 8  # at most
SHARE = 0.02  # of what a law gains, that each of its parts must: columns are no more exact, and long laws hard to fit
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
    alone_after : float or None
        Rms error on trials held out with it in the place of all effects, which it does not replace.
    """

    refit: Refit
    judgement: Judgement
    pieces: list[Piece]
    alone_after: float | None = None

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
    whole, others = body_of(bench), searched_of(bench)
    eyes = eyes_of(bench) if bench.case.noise is None else []  # of places in the picture
    library = [*library_of(bench), *whole, *eyes]
    forces = forces.beside(force_columns(bench, model, [*whole, *others, *eyes]))
    if bench.case.noise is not None:
        forces = forces.without(OF_THE_SCENE)
    best: Draft | None = None
    chosen: dict[str, float] = {}
    shape: dict[str, float] = {}
    # where sigma is a misfit it stands in for much, and need not grow
    for _ in range(ROUNDS if bench.case.noise is None else 1):
        tell("looking for a law in what is left")
        start = model if best is None else best.refit.fitted
        more, promise = sparse(start, forces, tuple(chosen), _choices(library, others))
        if not more or (best is not None and promise < WORTH * best.refit.cross_gain * best.refit.factor):
            break
        chosen |= more
        used = [_only(piece, chosen) for piece in [*library, *others] if set(piece.paths) & set(chosen)]
        others = [piece for piece in others if set(piece.paths) & set(chosen)] or others
        law = law_of(used, {p: abs(v) or 1.0 for p, v in chosen.items()})
        begin = {p: v for piece in used for p, v in piece.shape.items()} | shape
        score = _score(law, chosen, begin, len(forces.names))
        tell(f"refit with a law of {len(law.strength)} parts")
        # it stands in for something: where its gain stands still is exact enough
        fitted = best_fit(bench, model, score, flat=ROUGHEST if bench.case.noise is None else None)
        if fitted is None or (best is not None and fitted.deviance >= best.refit.fitted.deviance):
            break
        refit = assess(bench, model, fitted, score, score.tried)
        if best is not None and refit.cross_gain < best.refit.cross_gain + GAIN:
            break
        best = Draft(refit, judge(refit, numerical), used)
        chosen, shape = {p: fitted.values[p] for p in law.strength}, {p: fitted.values[p] for p in law.shape}
    return best


def _choices(library: Sequence[Piece], others: Sequence[Piece]) -> list[list[str]]:
    """Coefficients of which a law may have those of one list.

    Steady currents, with one that pulses, or a patch; and forces on parts of the body, or alike on all of it: of both
    together much can be made that is neither.
    """
    steady = [path for piece in library if piece.kind == "flow" for path in piece.paths]
    found = [steady, *([*(steady if piece.kind == "flow" else ()), *piece.paths] for piece in others)]
    parts = [
        path for piece in library if piece.kind == "force" and piece.name != BODY for path in piece.paths
    ]
    body = [path for piece in library if piece.name == BODY for path in piece.paths]
    return [[*one, *forces] for one in found for forces in ([parts, body] if body else [parts])]


def sparse(
    model: Fitted, columns: ForceColumns, known: Sequence[str] = (), apart: Sequence[Sequence[str]] = ()
) -> tuple[dict[str, float], float]:
    """Choose coefficients stepwise by what trials left out gain; return their values, by path, and that gain.

    One is added as long as that gains three nats on trials left out, in units of what would be left, and a share of
    what the others gain; then those are deleted again without which these gain as much. ``known`` are in the model
    already; the columns may be those without them, for a full fit follows. Of one of the lists of names in ``apart``
    some may be chosen; of laws that differ by less than a part must gain the shortest is returned.
    """
    search = _Sparse.of(model, columns)
    place = {name: k for k, name in enumerate(columns.names)}
    some = [[place[name] for name in group if name in place] for group in apart]
    each = {k for group in some for k in group}
    out = search.idle | {place[name] for name in known if name in place}
    found = [
        search.choose([k for k in range(len(place)) if k not in (each - set(group)) | out])
        for group in [[], *some]
    ]
    most = max(found, key=lambda one: one[1])
    alike = [one for one in found if one[1] >= most[1] - _least(most[1], most[2])]
    chosen, gain, _ = min(alike, key=lambda one: (len(one[0]), -one[1]))
    if not chosen:
        return {}, 0.0
    z, _ = search.solved(chosen)
    values = {
        columns.names[k]: float(v / search.size[k] * columns.scales[columns.names[k]])
        for k, v in zip(chosen, z, strict=True)
    }
    return values, gain


@dataclass(frozen=True)
class _Sparse:
    """Columns over their size once the parameters of a model are projected out, and what their sums gain."""

    model: Fitted
    forms: list[Reduced]
    prior: Reduced
    P: np.ndarray
    r: np.ndarray
    size: np.ndarray
    one_sided: np.ndarray

    @classmethod
    def of(cls, model: Fitted, columns: ForceColumns) -> _Sparse:
        basis = Basis.of(model.jacobian)
        size = np.linalg.norm(basis.out(_padded(columns.columns, model)), axis=0)
        size = np.where(size < 1e-6 * np.linalg.norm(columns.columns, axis=0), np.inf, size)
        forms, prior = reduced(model, columns.columns / size)
        P = basis.out(_padded(columns.columns / size, model))
        return cls(model, forms, prior, P, basis.out(model.residual), size, columns.one_sided)

    @property
    def idle(self) -> set[int]:
        """Columns that the model's parameters can do as well."""
        return set(np.flatnonzero(np.isinf(self.size)).tolist())

    def solved(self, chosen: list[int]) -> tuple[np.ndarray, float]:
        """Coefficients that explain most, and the variance factor of what they leave."""
        z = -np.linalg.lstsq(self.P[:, chosen], self.r, rcond=1e-10)[0]
        return z, variance_factor(self.model, self.r + self.P[:, chosen] @ z)

    def choose(self, some: list[int]) -> tuple[list[int], float, float]:
        """Of some columns those that trials left out gain by, what they gain, and the factor of what they leave."""
        count, common = len(some), len(self.prior.b) - self.P.shape[1]
        kept = np.concatenate([np.arange(common), common + np.array(some, dtype=int)])
        forms = [replace(f, S=f.S[np.ix_(kept, kept)], b=f.b[kept]) for f in self.forms]
        prior = replace(self.prior, S=self.prior.S[np.ix_(kept, kept)], b=self.prior.b[kept])
        gains_of = lambda choices: cross_gains(forms, prior, _one_hot(choices, count)).sum(axis=1)  # noqa: E731
        columns = lambda chosen: [some[k] for k in chosen]  # noqa: E731
        chosen: list[int] = []
        out: set[int] = set()
        now, factor = 0.0, 1.0
        while len(chosen) < FEATURES:
            rest = [k for k in range(count) if k not in chosen and k not in out]
            if not rest:
                break
            gains = gains_of([[*chosen, k] for k in rest])
            best = rest[int(np.argmax(gains))]
            z, left = self.solved(columns([*chosen, best]))
            if float(np.max(gains)) < now + _least(now, left):
                break
            if np.any(self.one_sided[columns([*chosen, best])] & (z < 0.0)):  # a damping that drives
                out.add(best)
                continue
            chosen, now, factor = [*chosen, best], float(np.max(gains)), left
        while len(chosen) > 1:  # thresholding: what the others have made needless
            shorter = [[c for c in chosen if c != k] for k in chosen]
            gains = gains_of(shorter)
            if float(np.max(gains)) < now - _least(now, factor):
                break
            chosen, now = shorter[int(np.argmax(gains))], float(np.max(gains))
            factor = self.solved(columns(chosen))[1]
        return columns(chosen), now, factor


def _least(gained: float, factor: float) -> float:
    """What a part of a law must gain beside others."""
    return max(GAIN * factor, SHARE * gained)


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


def _score(law: Candidate, values: dict[str, float], shape: dict[str, float], features: int) -> Score:
    """Where the refit of a law begins."""
    found = {p: values[p] for p in law.strength}
    nulls = dict.fromkeys(law.strength, 0.0)
    scales = {p: abs(v) or 1.0 for p, v in found.items()}
    tried = features ** len(law.strength)  # as many laws of so many parts might have been chosen
    none, anything = np.zeros(0), dict.fromkeys(law.strength, (-np.inf, np.inf))
    return Score(
        law, shape, found, nulls, scales, anything, 0.0, len(found), 1.0, 1.0, 0.0, {}, none, none,
        np.zeros((0, 0)), tried,
    )  # fmt: skip
