"""`evaluate`: predict recordings open loop, and say how far off it is, beside predictions without a model."""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, as_completed
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rodnet.errors import CaseError, ParameterError, RodnetError
from rodnet.inference.case import Case, load_case
from rodnet.inference.convergence import convergence, summed
from rodnet.inference.fitted import Fitted
from rodnet.inference.instruments import check_planes
from rodnet.inference.naive import START, held, interpolated, prescribed
from rodnet.inference.readings import recorded
from rodnet.inference.simpler import restored
from rodnet.inference.trial import Trial
from rodnet.progress import meter
from rodnet.recordings.files import as_recordings
from rodnet.recordings.observation import Markers, Observation
from rodnet.recordings.recording import Recording

SPANS = {"mean_mm_5s": 5.0, "mean_mm_1s": 1.0}  # seconds from the first frame
NAIVE = {"last pose held": held, "prescribed motion interpolated": interpolated}


class Trace(NamedTuple):
    """Times of a recording's frames from the first [s]; measured and predicted readings of each instrument."""

    t: np.ndarray
    instruments: list[tuple[str, str]]
    measured: list[np.ndarray]
    predicted: list[np.ndarray]
    prescribed: list[np.ndarray]


@dataclass(frozen=True)
class Evaluation:
    """How well recordings are predicted.

    Attributes
    ----------
    case : str
        Name of the case.
    metric_name : str
        What the case's own measure of error is called.
    files : list of dict
        Of each recording: ``name``, ``path``, ``kind``; ``metric``, ``mean_mm_5s`` and ``mean_mm_1s`` (mean
        distance over free markers [mm], from the third frame on, over the first 5 s and 1 s);
        ``baselines`` {name: the same three}; ``seconds`` that it took; ``convergence``, if it was asked for;
        ``failure``, empty where all went well. Where a simulation fails, its last state is held for the rest
        and scored; what cannot even be built has no score (None) and is left out of the totals.
    traces : list of Trace or None
        Of each recording: what was measured and predicted.
    """

    case: str
    metric_name: str
    files: list[dict[str, Any]] = field(default_factory=list)
    traces: list[Trace | None] = field(default_factory=list)

    def total(self, kind: str | None = None) -> dict[str, Any]:
        """Means over recordings (of one kind): the three measures, ``baselines``, how many, how many failed.

        And of the convergence, if it was asked for, rms and largest values.
        """
        files = [f for f in self.files if kind is None or f["kind"] == kind]
        scored = [f for f in files if f["metric"] is not None]
        names = list(dict.fromkeys(n for f in scored for n in f["baselines"]))
        beside = {n: _means([f["baselines"][n] for f in scored if n in f["baselines"]]) for n in names}
        failed = sum(bool(f["failure"]) for f in files)
        found = {**_means(scored), "baselines": beside, "recordings": len(files), "failed": failed}
        if finer := summed([f["convergence"] for f in scored if "convergence" in f]):
            found["convergence"] = finer
        return found

    @property
    def kinds(self) -> list[str]:
        """Kinds of recordings, in order of appearance."""
        return list(dict.fromkeys(f["kind"] for f in self.files))

    def to_dict(self) -> dict[str, Any]:
        """Everything, for machines."""
        return {
            "case": self.case,
            "metric_name": self.metric_name,
            **self.total(),
            "kinds": {kind: self.total(kind) for kind in self.kinds},
            "files": self.files,
        }


def evaluate(
    case: Case | str | Path,
    recordings: Any,
    model: Fitted | str | Path | Mapping[str, Any] | None = None,
    *,
    train: Any = None,
    executor: Executor | None = None,
    workers: int | None = None,
    converge: bool = False,
    progress: bool = False,
) -> Evaluation:
    """Predict recordings from their first two frames and what was prescribed, and score the predictions.

    Parameters
    ----------
    case : Case or path
        How recordings become robots.
    recordings : path, sequence of paths, or sequence of Recording
        What is predicted.
    model : Fitted, path or mapping, optional
        Fitted parameters, the directory that holds them, or values by path; by default the case's own.
    train : path, sequence of paths, or sequence of Recording, optional
        What the case's own ``baselines`` are fitted to; by default those are taken that the model's file keeps.
    executor : concurrent.futures.Executor, optional
        Where recordings are predicted; left running. By default ``workers`` processes of this machine.
    workers : int, optional
        Number of processes, by default one for each core; 0 computes in this process.
    converge : bool
        Whether to predict once more with half the time step, and to say what the time step takes of the vibrations
        beside the damping of the model.
    progress : bool
        Show progress on standard error.

    Returns
    -------
    Evaluation

    Raises
    ------
    CaseError
        If the case or the model cannot be used.
    RecordingError
        If a recording cannot be read.
    """
    from rodnet.sweeps.collect import Serial
    from rodnet.sweeps.driver import start
    from rodnet.sweeps.job import pack

    case = case if isinstance(case, Case) else load_case(case)
    recs = as_recordings(recordings)
    if not recs:
        raise CaseError("there are no recordings to predict")
    check_planes(case, recs)
    values, case, simpler = _values(case, model)
    if train is not None:
        simpler = case.simpler([case.part(rec) for rec in as_recordings(train)])
    if executor is not None and workers is not None:
        raise ParameterError("an executor has its own workers; give either executor or workers")
    packed = pack(case, "functions of the case") if executor is not None or workers != 0 else None
    pool = executor if executor is not None else start(workers, len(recs))
    files: list[dict[str, Any]] = [{} for _ in recs]
    traces: list[Trace | None] = [None for _ in recs]
    try:
        if isinstance(pool, Serial):
            packed = None
        with meter(progress, "predicting") as show:
            calls = {
                pool.submit(_score, case, rec, values, converge)
                if packed is None
                else pool.submit(_score_packed, packed, rec, values, converge): k
                for k, rec in enumerate(recs)
            }
            for done, future in enumerate(as_completed(calls), 1):
                files[calls[future]], traces[calls[future]] = future.result()
                show(done / len(recs))
    finally:
        if executor is None:
            pool.shutdown(cancel_futures=True)
    for file, rec in zip(files, recs, strict=True):
        if file["metric"] is not None:
            file["baselines"] |= _baselines(case, case.part(rec), simpler)
    return Evaluation(case.name, case.metric_name, files, traces)


@lru_cache(maxsize=4)
def _unpacked(packed: bytes) -> Case:
    case: Case = pickle.loads(packed)
    return case


def _score_packed(
    packed: bytes, rec: Recording, values: Mapping[str, Any], converge: bool
) -> tuple[dict[str, Any], Trace | None]:
    """Score one recording in another process."""
    return _score(_unpacked(packed), rec, values, converge)


def _score(
    case: Case, rec: Recording, values: Mapping[str, Any], converge: bool
) -> tuple[dict[str, Any], Trace | None]:
    """Predict and score one recording; what goes wrong is told, not raised."""
    begun = time.perf_counter()
    file: dict[str, Any] = {
        "name": rec.name,
        "path": None if rec.path is None else str(rec.path),
        "kind": case.kind_of(rec),
        "metric": None,
        **dict.fromkeys(SPANS),
        "baselines": {},
        "failure": "",
    }
    trace = None
    try:
        trial = Trial.of(case, rec, values)
        traj, file["failure"] = trial.run()
        predicted = trial.read(traj)
        file |= measures(case, trial.rec, trial.observations, predicted)
        for name, predict in NAIVE.items():
            simple = [predict(trial.rec, o) for o in trial.observations]
            file["baselines"][name] = measures(case, trial.rec, trial.observations, simple)
        trace = _trace(trial, predicted)
        if converge and not file["failure"]:
            file["convergence"] = convergence(trial, traj, predicted).to_dict()
    except RodnetError as error:
        file["failure"] = f"{type(error).__name__}: {error}"
    file["seconds"] = time.perf_counter() - begun
    return file, trace


def _trace(trial: Trial, predicted: list[np.ndarray]) -> Trace:
    eyes = trial.observations
    return Trace(
        trial.rec.t - trial.rec.t[0],
        [(o.name, o.unit) for o in eyes],
        [np.asarray(o.measured(trial.rec), dtype=float) for o in eyes],
        predicted,
        [prescribed(trial.rec, o) for o in eyes],
    )


def measures(
    case: Case, rec: Recording, observations: Sequence[Observation], predicted: list[np.ndarray]
) -> dict[str, float | None]:
    """Return the case's own ``metric``, and mean distances over free markers [mm], as of `Evaluation.files`."""
    found: dict[str, float | None] = {"metric": _finite(_metric(case, rec, observations, predicted))}
    markers = [(o, p) for o, p in zip(observations, predicted, strict=True) if isinstance(o, Markers)]
    for name, span in SPANS.items():
        within = rec.t[START:] - rec.t[0] <= span + 1e-9
        distances = [np.zeros(0)]
        for o, p in markers:
            free = ~prescribed(rec, o)
            off = np.linalg.norm(_off(o, rec, p), axis=2)[START:][within][:, free]
            distances.append(off[np.isfinite(off)])
        every = np.concatenate(distances)
        found[name] = 1e3 * float(every.mean()) if len(every) else None
    return found


def _metric(
    case: Case, rec: Recording, observations: Sequence[Observation], predicted: list[np.ndarray]
) -> float:
    """Return the case's own measure, or the root mean square of all residuals."""
    if case.metric is not None:
        return float(case.metric(rec, predicted))
    off = [_off(o, rec, p)[START:].ravel() for o, p in zip(observations, predicted, strict=True)]
    every = np.concatenate(off)
    return float(np.sqrt(np.nanmean(every**2)))


def _off(one: Observation, rec: Recording, predicted: np.ndarray) -> np.ndarray:
    """Errors of an instrument, of the coordinates that were recorded."""
    found = np.asarray(predicted - one.measured(rec))
    return found[..., recorded(one, rec, found.shape[-1])] if isinstance(one, Markers) else found


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _means(rows: Sequence[Mapping[str, Any]]) -> dict[str, float | None]:
    """Means over recordings of what they have."""
    found: dict[str, float | None] = {}
    for key in ("metric", *SPANS):
        numbers = [row[key] for row in rows if row[key] is not None]
        found[key] = float(np.mean(numbers)) if numbers else None
    return found


def _values(case: Case, model: Any) -> tuple[dict[str, Any], Case, dict[str, Any]]:
    """Values by path of a model, the case with the effects in it that a diagnosis added, and its simpler models."""
    if model is None:
        return {}, case, {}
    if isinstance(model, Mapping):
        return dict(model), case, {}
    fitted = model if isinstance(model, Fitted) else Fitted.load(model)
    if fitted.case and fitted.case != case.name:
        raise CaseError(f"the model was fitted for the case '{fitted.case}', not for '{case.name}'")
    effects = fitted.notes.get("effects")
    if effects:
        from rodnet.diagnosis.repaired import with_effects

        case = with_effects(case, effects)
    return fitted.values, case, restored(fitted.baselines)


def _baselines(
    case: Case, rec: Recording, simpler: Mapping[str, Callable[[Recording], list[Any]]]
) -> dict[str, dict[str, float | None]]:
    """Scores of the case's simpler models."""
    if not simpler:
        return {}
    observations = case.observations(rec, case.robot(rec))
    found: dict[str, dict[str, float | None]] = {}
    for name, predict in simpler.items():
        try:
            found[name] = measures(case, rec, observations, [np.asarray(p) for p in predict(rec)])
        except (
            RodnetError,
            ValueError,
        ):  # it was made for other markers: the model's own scores stand without it
            found[name] = dict.fromkeys(("metric", *SPANS))
    return found
