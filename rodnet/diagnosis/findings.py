"""What a diagnosis found, and how it is told: objects with numbers, and the same as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import norm

from rodnet.diagnosis.design import Proposal
from rodnet.diagnosis.forces import Placebo
from rodnet.diagnosis.heldout import Opened
from rodnet.diagnosis.locate import Location
from rodnet.diagnosis.numerics import Numerics
from rodnet.diagnosis.refit import Refit
from rodnet.diagnosis.regimes import Regime
from rodnet.diagnosis.remainder import Remainder, test_remainder
from rodnet.diagnosis.removed import Removed, removed
from rodnet.diagnosis.scales import variance_factor
from rodnet.diagnosis.screen import Score
from rodnet.diagnosis.told import tell
from rodnet.diagnosis.verdict import Judgement
from rodnet.diagnosis.workbench import Fitted, Workbench
from rodnet.inference.case import Case
from rodnet.recordings.noise import NoiseModel
from rodnet.recordings.recording import Recording

if TYPE_CHECKING:
    from rodnet.diagnosis.beside import Beside
    from rodnet.diagnosis.chosen import Accepted
    from rodnet.diagnosis.confirm import Resampled
    from rodnet.diagnosis.law import Draft

FILE, FORMAT, VERSION = "diagnosis.json", "rodnet-diagnosis", 1
LEVEL = 0.9  # of all intervals
NOISE = {False: "its own", True: "that of the training trials"}  # of trials not seen


@dataclass(frozen=True)
class Interval:
    """A value with its unit and its 90 % interval.

    Attributes
    ----------
    value, low, high : float
        The value, and the ends of the interval.
    unit : str
        Of all three.
    open : tuple of bool
        Whether what lies beyond an end fits as well, to the bounds: then nothing is known to that side.
    """

    value: float
    low: float
    high: float
    unit: str
    open: tuple[bool, bool] = (False, False)

    def to_dict(self) -> dict[str, Any]:
        """Return it as JSON takes it."""
        return {"value": self.value, "low": self.low, "high": self.high, "unit": self.unit}


def interval(model: Fitted, path: str) -> Interval:
    """Interval of a common value, by the linearised likelihood, widened by what the model leaves."""
    k = model.place(path)
    q = model.quantities[k]
    z = q.coordinate(model.values[path])
    half = float(norm.ppf(0.5 + 0.5 * LEVEL)) * np.sqrt(variance_factor(model) * model.covariance()[k, k])
    ends = sorted((q.value(z - half), q.value(z + half)))
    beyond = (bool(z - half <= q.bounds[0]), bool(z + half >= q.bounds[1]))
    return Interval(model.values[path], ends[0], ends[1], q.unit, beyond)


def _known(model: Fitted) -> dict[str, dict[str, Any]]:
    """Intervals of all common values, as JSON takes them."""
    return {q.path: interval(model, q.path).to_dict() for q in model.quantities if q.trial is None}


@dataclass(frozen=True)
class Finding:
    """An effect that was accepted.

    Attributes
    ----------
    id, title, group, family, on : str
        Of the candidate.
    status : str
        ``"named"``, ``"class"`` or ``"surrogate"``.
    parameters : dict
        `Interval` by path.
    strength : tuple of str
        Which of them are strengths.
    at, when : Interval or None
        Place along the rod, and onset.
    effect_sigma : float
        Rms change of the prediction that it makes, after the nominal parameters were refitted, over sigma.
    explained_fraction : float or None
        Share of the squared error on trials not seen beyond the floor that the model loses with it.
    gain, cross_gain : float
        Of deviance, in training and on trials left out; the latter is None of a single trial.
    gains : list of float
        The latter by trial.
    relief : float
        Share of the rms errors of trials left out that it takes off.
    p : float
        Of the gain by chance, everything that was tried counted.
    equivalents : list of str
        Ids of what explains the data as well.
    falsifier : str
        What would be otherwise if this were so.
    beside : Beside or None
        How it holds beside a remainder, where there is one.
    """

    id: str
    title: str
    group: str
    family: str
    on: str
    status: str
    parameters: dict[str, Interval]
    strength: tuple[str, ...]
    at: Interval | None
    when: Interval | None
    effect_sigma: float
    explained_fraction: float | None
    gain: float
    cross_gain: float | None
    gains: list[float]
    relief: float
    p: float
    equivalents: list[str]
    falsifier: str
    beside: Beside | None = None

    @classmethod
    def of(
        cls, accepted: Accepted, sure: Mapping[str, Interval], model: Fitted, status: str, shown: HeldOut | None,
        floor: float | None, place: int, beside: Beside | None,
    ) -> Finding:  # fmt: skip
        """Describe an accepted effect as it is in the final model.

        ``sure`` are intervals by path, where better ones than linear are known; ``place`` is that of its model in
        the chain of those that were opened.
        """
        refit, c = accepted.refit, accepted.candidate
        parameters = {p: sure[p] if p in sure else interval(model, p) for p in c.paths}
        share = None
        if shown is not None and floor is not None and place < len(shown.chain):
            before, after = (shown.chain[k].error ** 2 for k in (place - 1, place))
            excess = shown.before.error**2 - floor**2
            share = (before - after) / excess if excess > 0.0 else None
        return cls(
            c.id, c.title, c.group, c.family, c.on, status, parameters, c.strength,
            parameters.get(c.place) if c.place else None, parameters.get(c.onset) if c.onset else None,
            refit.effect_sigma, share, refit.gain, refit.crossed, refit.gains.tolist(), refit.relief,
            refit.p, [o.id for o in accepted.equivalents], c.falsifier, beside,
        )  # fmt: skip


@dataclass(frozen=True)
class Tried:
    """A candidate that was refitted, accepted or not."""

    id: str
    round: int
    gain: float
    cross_gain: float | None
    p: float
    effect_sigma: float
    accepted: bool
    reasons: tuple[str, ...]

    @classmethod
    def of(cls, refit: Refit, judgement: Judgement, number: int) -> Tried:
        """Describe a refit."""
        return cls(refit.id, number, refit.gain, refit.crossed, refit.p, refit.effect_sigma,
                   judgement.accepted, judgement.reasons)  # fmt: skip


@dataclass(frozen=True)
class HeldOut:
    """Held-out trials with the model as it is, and with every accepted model after it.

    ``borrowed`` says that their noise is that of the training trials, as they are too short to tell it; ``failed``
    names those that are not here, for not every model could be simulated in them.
    """

    chain: list[Opened]
    bench: Workbench
    borrowed: bool = False
    failed: list[str] = field(default_factory=list)

    @property
    def before(self) -> Opened:
        """With the model as it is."""
        return self.chain[0]

    @property
    def after(self) -> Opened:
        """With the repaired model."""
        return self.chain[-1]

    @property
    def gain(self) -> float:
        """By how much the deviance falls."""
        return self.before.fitted.deviance - self.after.fitted.deviance

    @property
    def last_gain(self) -> float:
        """By how much it falls with the last effect."""
        return self.chain[-2].fitted.deviance - self.after.fitted.deviance


@dataclass(frozen=True)
class Diagnosis:
    """All that a diagnosis found; `to_dict` is what ``diagnosis.json`` holds.

    Attributes
    ----------
    held, tested : HeldOut or None
        Trials that errors before and after are told of: those to confirm with, where there are any, else those
        held out; and the latter.
    model, repaired : Fitted
        With all effects, fitted to the trials that were searched, and to all training trials.
    remainder, left : Remainder
        What the effects that were accepted leave, and what the drafted law leaves then.
    law : Draft or None
        The law that was drafted from what is left, if it gained anything.
    resampled : list of Resampled
        What other trials might have given.
    names : list of str
        Of the trials that were searched.
    training : list of Recording
        All that the repaired model was fitted to.
    hurried : bool
        Whether further effects were not looked for, for want of time.
    """

    verdict: str
    findings: list[Finding]
    plain: Fitted
    base: Fitted
    model: Fitted
    repaired: Fitted
    numerics: Numerics
    screened: list[Score]
    tried: list[Tried]
    proposals: list[Proposal]
    remainder: Remainder
    isolability: np.ndarray
    held: HeldOut | None
    tested: HeldOut | None
    placebo: Placebo | None
    placebo_gains: np.ndarray
    law: Draft | None
    left: Remainder
    resampled: list[Resampled]
    floor: float | None
    noise: dict[str, NoiseModel]
    case: Case
    names: list[str]
    training: list[Recording]
    openings: int
    recordings: list[Recording]
    seconds: float
    location: Location | None = None
    regime: Regime | None = None
    hurried: bool = False

    @property
    def explained_fraction(self) -> float | None:
        """Share of the held-out error beyond the floor that the repaired model removes."""
        if self.held is None or self.floor is None:
            return None
        before, after = self.held.before.error**2, self.held.after.error**2
        excess = before - self.floor**2
        return float((before - after) / excess) if excess > 0.0 else None

    @property
    def floor_sigma(self) -> float | None:
        """The floor in sigma: less than one where sigma is not the noise's, but what the model is off by."""
        if self.floor is None or self.held is None:
            return None
        before = self.held.before
        return 1.0 if self.case.noise is None else before.sigma * self.floor / max(before.error, 1e-300)

    @property
    def removed(self) -> list[Removed]:
        """What the repair takes off the errors on files that were not seen, with intervals over files."""
        return [] if self.held is None else removed(self.held.before.files, self.held.after.files)

    @property
    def placebo_removed(self) -> float | None:
        """Share of the rms error on files not seen that the median placebo removes, to first order."""
        placebo = self.placebo_after()
        if placebo is None or self.held is None:
            return None
        return float(1.0 - placebo[0] / max(self.held.before.error, 1e-300))

    def placebo_after(self) -> tuple[float, float] | None:
        """Held-out error with the median placebo, in the recording's unit and in sigma."""
        if self.held is None or not len(self.placebo_gains):
            return None
        before = self.held.before
        left = max(before.fitted.deviance - float(np.median(self.placebo_gains)), 0.0)
        share = float(np.sqrt(left / max(before.fitted.deviance, 1e-300)))
        return before.error * share, before.sigma * share

    @property
    def unit(self) -> str:
        """Unit of the errors: that of the first instrument."""
        rec = self.case.part(self.recordings[0])
        return self.case.observations(rec, self.case.robot(rec))[0].unit

    @property
    def shown(self) -> str | None:
        """Which trials errors before and after are of."""
        if self.held is None:
            return None
        return "held out" if self.held is self.tested else "to confirm"

    def _law(self) -> dict[str, Any]:
        """The law that was drafted, as JSON takes it."""
        assert self.law is not None
        one = self.law.refit
        after = test_remainder(one.fitted)
        return {
            "accepted": self.law.judgement.accepted, "reasons": self.law.judgement.reasons,
            "pieces": [piece.to_dict() for piece in self.law.pieces],
            "parameters": {p: interval(one.fitted, p).to_dict() for p in self.law.candidate.paths},
            "effect_sigma": one.effect_sigma, "gain": one.gain, "cross_gain": one.crossed, "gains": one.gains,
            "remainder_after": {"p": after.p, "excess_sigma": after.excess},
        }  # fmt: skip

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the arrays, as JSON takes it."""
        from rodnet.runs import plain

        placebo = self.placebo_after()
        terms = [
            {
                "id": f.id, "status": f.status, "class": [f.id, *f.equivalents], "title": f.title, "group": f.group,
                "on": f.on, "at": None if f.at is None else f.at.value,
                "at_interval": None if f.at is None else [f.at.low, f.at.high],
                "parameters": {p: v.to_dict() for p, v in f.parameters.items()}, "when": f.when and f.when.value,
                "effect_sigma": f.effect_sigma, "explained_fraction": f.explained_fraction, "regime": None,
                "beside_remainder": None if f.beside is None else {**vars(f.beside), "holds": f.beside.holds},
                "gain": f.gain, "cross_gain": f.cross_gain, "gains": f.gains, "relief": f.relief, "p": f.p,
            }
            for f in self.findings
        ]  # fmt: skip
        first = next(iter(self.noise.values()))
        found = {
            "format": FORMAT, "version": VERSION, "case": self.case.name, "verdict": self.verdict, "terms": terms,
            "equivalents": {f.id: f.equivalents for f in self.findings if f.equivalents},
            "next_experiment": [p.to_dict() for p in self.proposals] or None,
            "error_before": None if self.held is None else self.held.before.error,
            "error_after": None if self.held is None else self.held.after.error,
            "error_floor": self.floor, "error_unit": self.unit, "errors_of": self.shown,
            "error_before_sigma": None if self.held is None else self.held.before.sigma,
            "error_after_sigma": None if self.held is None else self.held.after.sigma,
            "error_floor_sigma": self.floor_sigma,
            "placebo_after": None if placebo is None else placebo[0],
            "placebo_after_sigma": None if placebo is None else placebo[1],
            "explained_fraction": self.explained_fraction,
            "removed": [vars(one) for one in self.removed], "placebo_removed": self.placebo_removed,
            "files_before": None if self.held is None else self.held.before.files,
            "files_after": None if self.held is None else self.held.after.files,
            "metric_name": self.case.metric_name,
            "remainder": {"p": self.remainder.p, "excess_sigma": self.remainder.excess, "ratio": self.remainder.ratio,
                          "where": {str(k): v for k, v in self.remainder.where.items()},
                          "when": self.remainder.when, "grips_sigma": self.remainder.grips,
                          "trials": dict(zip(self.names, self.remainder.trials, strict=True))},
            "isolability": {"ids": [s.candidate.id for s in self.screened], "correlation": self.isolability},
            "minimum_detectable": {s.candidate.id: s.detectable for s in self.screened},
            "scores": [{"id": s.candidate.id, "chi2": s.chi2, "p": s.p, "survives": s.survives,
                        "effect_sigma": s.effect_sigma, "shape": s.shape} for s in self.screened],
            "refits": [vars(t) for t in self.tried],
            "numerics": {"change": self.numerics.change, "sigma": self.numerics.sigma,
                         "kept_sigma": self.numerics.kept, "failed": self.numerics.failed},
            "noise": {**first.to_dict(), "held_out": None if self.held is None else NOISE[self.held.borrowed]},
            "calibrated": _known(self.base), "repaired": _known(self.repaired),
            "law": self.law and self._law(), "level": LEVEL, "bootstrap": [vars(r) for r in self.resampled],
            "heldout_openings": self.openings, "trials": self.names,
            "training": [rec.name for rec in self.training], "seconds": self.seconds, "hurried": self.hurried,
        }  # fmt: skip
        return dict(plain(tell(found, self)))

    def save(self, directory: str | Path) -> Path:
        """Write ``diagnosis.json`` into a directory."""
        path = Path(directory) / FILE
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n", encoding="utf-8")
        return path
