"""What a diagnosis found: an object with numbers, and the same as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.diagnosis.design import Proposal
from rodnet.diagnosis.findings import LEVEL, Finding, HeldOut, Tried, interval
from rodnet.diagnosis.forces import Placebo
from rodnet.diagnosis.locate import Location
from rodnet.diagnosis.numerics import Numerics
from rodnet.diagnosis.preflight import Preflight
from rodnet.diagnosis.regimes import Regime
from rodnet.diagnosis.remainder import Remainder, test_remainder
from rodnet.diagnosis.removed import Removed, removed
from rodnet.diagnosis.screen import Score
from rodnet.diagnosis.told import tell
from rodnet.diagnosis.workbench import Fitted
from rodnet.errors import RodnetError
from rodnet.inference.case import Case
from rodnet.recordings.noise import NoiseModel
from rodnet.recordings.recording import Recording

if TYPE_CHECKING:
    from rodnet.diagnosis.confirm import Resampled
    from rodnet.diagnosis.law import Draft
    from rodnet.parameters import Parameter
    from rodnet.report.page import Page

FILE, FORMAT, VERSION = "diagnosis.json", "rodnet-diagnosis", 1
NOISE = {False: "as given, or of all trials", True: "that of the training trials"}  # of trials not seen


@dataclass(frozen=True, repr=False)
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
    openings, openings_ever : int
        How often trials not seen were opened, in this run and in all that the ledger knows of; without one the latter
        is None.
    preflight : Preflight or None
        What is odd about markers and drives.
    hurried : bool
        Whether further effects were not looked for, for want of time.
    lost : sequence of str
        Names of the trials held out, if there is none in which every model can be simulated.
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
    openings_ever: int | None = None
    preflight: Preflight | None = None
    lost: Sequence[str] = ()

    def __repr__(self) -> str:
        found = ", ".join(f.id for f in self.findings) or "nothing"
        return (
            f"Diagnosis of '{self.case.name}' from {len(self.training)} trials: {self.verdict}, {found} found"
        )

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

    def described(self) -> dict[str, Parameter]:
        """What explanations are described by, by path."""
        rec = self.case.part(self.recordings[0])
        robot = self.case.robot(rec)
        instruments = self.case.observations(rec, robot)
        found: dict[str, Parameter] = {}
        for score in self.screened:
            try:
                built = score.candidate.build(robot)
                known = {} if built is None else score.candidate.parameters(built, instruments)
            except RodnetError:
                continue
            found |= known
        return found

    def _law(self) -> dict[str, Any]:
        """The law that was drafted, as JSON takes it."""
        assert self.law is not None
        one = self.law.refit
        after = test_remainder(one.fitted, [self.noise])
        return {
            "accepted": self.law.judgement.accepted, "reasons": self.law.judgement.reasons,
            "pieces": [piece.to_dict() for piece in self.law.pieces],
            "parameters": {p: interval(one.fitted, p).to_dict() for p in self.law.candidate.paths},
            "effect_sigma": one.effect_sigma, "gain": one.gain, "cross_gain": one.crossed, "gains": one.gains,
            "remainder_after": {"p": after.p, "excess_sigma": after.excess},
            **({} if self.law.alone_after is None else {"error_after": self.law.alone_after}),
        }  # fmt: skip

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the arrays, as JSON takes it."""
        from rodnet.numbers import plain

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
            "remainder": {"tested": self.remainder.tested, "p": self.remainder.p,
                          "excess_sigma": self.remainder.excess, "ratio": self.remainder.ratio,
                          "where": self.remainder.where,
                          "when": self.remainder.when, "grips_sigma": self.remainder.grips,
                          "records": self.remainder.records,
                          "trials": dict(zip(self.names, self.remainder.trials, strict=True))},
            "isolability": {"ids": [s.candidate.id for s in self.screened], "correlation": self.isolability},
            "minimum_detectable": {s.candidate.id: s.detectable for s in self.screened},
            "minimum_detectable_units": {path: p.unit for path, p in self.described().items()},
            "scores": [{"id": s.candidate.id, "chi2": s.chi2, "p": s.p, "survives": s.survives,
                        "effect_sigma": s.effect_sigma, "shape": s.shape} for s in self.screened],
            "refits": [vars(t) for t in self.tried],
            "numerics": {"change": self._measured(self.numerics.change), "sigma": self._measured(self.numerics.sigma),
                         "kept_sigma": self._measured(self.numerics.kept), "failed": self.numerics.failed,
                         "coarser_sigma": self.numerics.coarser},
            "noise": {**first.to_dict(), "held_out": None if self.held is None else NOISE[self.held.borrowed]},
            "calibrated": _known(self.base), "repaired": _known(self.repaired),
            "law": self.law and self._law(), "level": LEVEL, "bootstrap": [vars(r) for r in self.resampled],
            "heldout_openings": self.openings, "heldout_openings_ever": self.openings_ever,
            "preflight": self.preflight and self.preflight.to_dict(), "trials": self.names,
            "training": [rec.name for rec in self.training], "seconds": self.seconds, "hurried": self.hurried,
        }  # fmt: skip
        return dict(plain(tell(found, self)))

    def save(self, directory: str | Path) -> Path:
        """Write ``diagnosis.json`` into a directory; `write` writes all there is."""
        path = Path(directory) / FILE
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n", encoding="utf-8")
        return path

    def page(self, *, runs: bool = True) -> Page:
        """Return the page: what is missing, where, what it is, what else explains it, and the proof.

        It tells how the repaired robot is run, if there is a file of it that ``runs``.
        """
        from rodnet.report.diagnosis import diagnosis_page

        return diagnosis_page(self, runs)

    def _measured(self, values: Mapping[str, float]) -> dict[str, float | None]:
        """Numerical errors by kind; of one that could not be measured nothing is known."""
        return {kind: None if kind in self.numerics.failed else value for kind, value in values.items()}

    def write(self, directory: str | Path) -> list[Path]:
        """Write what ``rodnet diagnose --out`` does (stages come of ``resume``); what an earlier one has written goes.

        Raises
        ------
        OutputError
            If something cannot be written.
        """
        from rodnet.diagnosis.repaired import ROBOT, write
        from rodnet.report.views import clear, write_views

        folder = Path(directory)
        clear(folder)
        first = [self.save(folder)]  # whatever becomes of the page
        robot = write(self, folder)
        page = self.page() if folder / ROBOT in robot else self.page(runs=False)
        return [*first, page.save(folder / "report.html"), *robot, *write_views(self, folder)]


def _known(model: Fitted) -> dict[str, dict[str, Any]]:
    """Intervals of all common values, as JSON takes them."""
    return {q.path: interval(model, q.path).to_dict() for q in model.quantities if q.trial is None}
