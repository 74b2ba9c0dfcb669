"""The bootstrap of the whole pipeline: what the repaired model might have given, diagnosed like the recordings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.diagnosis.confirm import Resampled
from rodnet.diagnosis.findings import LEVEL
from rodnet.diagnosis.scales import variance_factor
from rodnet.diagnosis.stage_files import FAILURES
from rodnet.diagnosis.workbench import Fitted
from rodnet.errors import ParameterError
from rodnet.inference.case import Case
from rodnet.inference.readings import by_samples, recorded
from rodnet.recordings.noise import NoiseModel
from rodnet.recordings.observation import Observation
from rodnet.recordings.recording import Recording

if TYPE_CHECKING:
    from rodnet.diagnosis.result import Diagnosis

FAILED = "failed"  # the verdict on a replica that cannot be diagnosed

Told = dict[str, Any]


def check_written(case: Case, recordings: Sequence[Recording]) -> None:
    """Raise unless the readings of all instruments can be written into recordings, and read again."""
    parts = [case.part(rec) for rec in recordings]
    for part, one in ((p, one) for p in parts for one in case.observations(p, case.robot(p))):
        if type(one).written is not Observation.written:
            readings = one.measured(part)
            again = one.measured(one.written(part, readings))
            if np.array_equal(again, readings, equal_nan=True):
                continue
        raise ParameterError(
            f"the bootstrap of the whole pipeline draws new readings, and {type(one).__name__} '{one.name}' of "
            f"'{case.name}' does not say where a recording holds them: give it a method written(rec, readings), what "
            "measured() then returns again, or leave out bootstrap="
        )


def replica(
    case: Case, recordings: Sequence[Recording], model: Fitted, noise: Sequence[Mapping[str, NoiseModel]],
    rng: np.random.Generator,
) -> list[Recording]:  # fmt: skip
    """Recordings that a model might have given.

    Its prediction, and noise as the noise model has it; where the model leaves more than that, what it leaves with
    the sign of each trial drawn anew: that keeps its correlation in time and over the body. What no instrument reads,
    axes that a camera does not see among it, stays as it was recorded.
    """
    whole = variance_factor(model) == 1.0
    found = []
    for rec, fit, own in zip(recordings, model.fits, noise, strict=True):
        part = case.part(rec)
        instruments = case.observations(part, case.robot(part))
        sign = 1.0 if rng.random() < 0.5 else -1.0
        for one, predicted, measured in zip(instruments, fit.predicted, fit.measured, strict=True):
            error = sign * (measured - predicted)
            if whole:
                error = _drawn(own[one.name], part.t, measured, rng)
            drawn = np.where(np.isfinite(measured), predicted + error, np.nan)
            if drawn.ndim == 3:  # what was not recorded stays as it is
                lacking = np.setdiff1d(np.arange(drawn.shape[2]), recorded(one, rec, drawn.shape[2]))
                drawn[..., lacking] = measured[..., lacking]
            part = one.written(part, drawn)
        found.append(part)
    return found


def _drawn(noise: NoiseModel, t: np.ndarray, like: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Errors of readings of a shape; the noise model draws three coordinates of each sample at a time."""
    _, samples, coordinates = by_samples(like).shape
    parts = [noise.sample(t, samples, rng) for _ in range(-(-coordinates // 3))]
    return np.concatenate(parts, axis=2)[:, :, :coordinates].reshape(like.shape)


def bootstrap(
    count: int, draw: Callable[[int], tuple[list[Recording], list[Recording]]],
    diagnose: Callable[[list[Recording], list[Recording]], Diagnosis], stage: Callable[..., Any],
    paths: Sequence[str], ids: Sequence[str], tell: Callable[[str], None],
) -> Resampled:  # fmt: skip
    """Diagnose so many replicas; each is a stage, so that an interrupted bootstrap goes on.

    Those that cannot be diagnosed are counted among the verdicts, and in nothing else.
    """

    def one(number: int) -> Told:
        drawn = draw(number)  # nothing in it may fail: what does is a mistake of ours, not the replica's
        try:
            found = diagnose(*drawn)
        except FAILURES as error:
            return {"verdict": FAILED, "why": str(error), "ids": [], "values": {}, "removed": None}
        values = {p: v.value for f in found.findings for p, v in f.parameters.items()}
        return {
            "verdict": found.verdict, "ids": [f.id for f in found.findings], "values": values,
            "removed": found.explained_fraction,
        }  # fmt: skip

    told: list[Told] = []
    for number in range(count):
        tell(f"bootstrap of the whole pipeline: {number + 1} of {count}")
        told.append(stage(f"bootstrap {number + 1}", one, number))
    whole = [t for t in told if t["verdict"] != FAILED]
    if lost := [t["why"] for t in told if t["verdict"] == FAILED]:
        tell(f"{len(lost)} of {count} replicas could not be diagnosed: {'; '.join(dict.fromkeys(lost))}")
    tails = 50.0 * (1.0 - LEVEL)
    intervals = {}
    for path in paths:
        values = [t["values"][path] for t in whole if path in t["values"]]
        if values:
            low, high = np.percentile(values, [tails, 100.0 - tails])
            intervals[path] = (float(low), float(high))
    removed = [t["removed"] for t in whole if t["removed"] is not None]
    ends = None
    if removed:
        low, high = np.percentile(removed, [tails, 100.0 - tails])
        ends = (float(low), float(high))
    named = {id: float(np.mean([id in t["ids"] for t in whole])) for id in ids} if whole else {}
    verdicts: dict[str, int] = {}
    for t in told:
        verdicts[t["verdict"]] = verdicts.get(t["verdict"], 0) + 1
    return Resampled("pipeline", count, intervals, named, ends, verdicts)
