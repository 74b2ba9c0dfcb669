"""Trials with the noise of their instruments: as given, as recorded, or as estimated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from rodnet.errors import ParameterError, RecordingError
from rodnet.inference.case import Case
from rodnet.inference.comparison import Comparison
from rodnet.names import meant
from rodnet.recordings.estimate import estimate_noise
from rodnet.recordings.noise import NoiseModel
from rodnet.recordings.observation import Markers, Observation
from rodnet.recordings.recording import Recording

Y = 1  # number of the coordinate that recordings in the plane lack


def check_planes(case: Case, recordings: Sequence[Recording]) -> None:
    """Refuse recordings of x and z among recordings in space, where the case compares y, too.

    Raises
    ------
    RecordingError
        For the first of them.
    """
    planar = [rec for rec in recordings if rec.planar]
    spatial = [rec for rec in recordings if not rec.planar]
    for rec in planar if spatial else ():
        part = case.part(rec)
        if any(isinstance(o, Markers) and Y in o.axes for o in case.observations(part, case.robot(part))):
            raise rec.error(
                f"only x and z of its markers were recorded, and all of '{spatial[0].name}': its y would be taken for "
                "measured as zero. Let the case observe Markers(..., plane='xz' if rec.planar else 'xyz'), or leave it "
                "out; if y is known, give it, zero or not"
            )


def make_trials(case: Case, recordings: Sequence[Recording], noise: Any, modes: int) -> list[Comparison]:
    """Build the trials with the noise of their instruments."""
    built, estimate = [], None
    for rec in recordings:
        trial = Comparison(case, rec, {}, modes)
        _check_units(noise, trial)
        for one, measured in zip(trial.instruments, trial.measured, strict=True):
            if not np.isfinite(measured).any():
                raise rec.error(f"nothing of '{one.name}' was recorded")
            own = noise(trial.rec) if callable(noise) else noise
            given = own.get(one.name) if isinstance(own, Mapping) else own
            if given is None and isinstance(one, Markers):
                known = trial.rec.noise  # a case may know the noise of what it cuts out
                if known is None and estimate is None:
                    estimate = estimate_noise([case.part(one) for one in recordings]).model
                model = known or estimate
                assert model is not None
                given = narrowed(model, trial.rec, one)
            if isinstance(given, NoiseModel) and isinstance(one, Markers):
                given = _of_markers(given, trial.rec, one, isinstance(own, Mapping))
            trial.noise[one.name] = _noise(given, one, measured, rec)
        built.append(trial)
    if isinstance(noise, Mapping):
        names = list(dict.fromkeys(one.name for trial in built for one in trial.instruments))
        for name in noise:
            if name not in names:
                raise ParameterError(f"noise: nothing observed is called {name!r}; {meant(name, names)}"
                                     f"there are {', '.join(names)}")  # fmt: skip
    return built


def _check_units(noise: Any, trial: Comparison) -> None:
    """Refuse one number for instruments that read different things."""
    units = {one.name: one.unit for one in trial.instruments}
    if isinstance(noise, int | float) and len(set(units.values())) > 1:
        told = ", ".join(f"{name} [{unit}]" for name, unit in units.items())
        raise ParameterError(
            f"noise = {noise:g} cannot be meant for all of {told}: give a mapping by name, "
            f"noise={{'{next(iter(units))}': {noise:g}, ...}} (--noise NAME=VALUE); what is left out is estimated"
        )


def marker_noise(trial: Comparison) -> dict[str, NoiseModel]:
    """Noise of the markers of a trial, where its recording knows it."""
    model = trial.rec.noise
    markers = [one for one in trial.instruments if isinstance(one, Markers)]
    return {} if model is None else {one.name: narrowed(model, trial.rec, one) for one in markers}


def noise_like(trials: Sequence[Comparison], trial: Comparison) -> dict[str, NoiseModel]:
    """Noise of a trial's instruments as the first of others has it that have them; of markers, these by name."""
    found: dict[str, NoiseModel] = {}
    for other in reversed(trials):
        theirs = {one.name: one for one in other.instruments}
        for one in trial.instruments:
            model, same = other.noise.get(one.name), theirs.get(one.name)
            if model is None:
                continue
            if not isinstance(one, Markers) or not (np.ndim(model.white) or np.ndim(model.slow)):
                found[one.name] = model
            elif isinstance(same, Markers):
                names = [other.rec.names[other.rec.marker(m)] for m in same.markers]
                wanted = [trial.rec.names[trial.rec.marker(m)] for m in one.markers]
                if set(wanted) <= set(names):
                    found[one.name] = _picked(model, [names.index(name) for name in wanted])
    return found


def narrowed(model: NoiseModel, rec: Recording, one: Markers) -> NoiseModel:
    """The noise of the markers that an instrument sees."""
    return _picked(model, [rec.marker(m) for m in one.markers])


def _picked(model: NoiseModel, which: Sequence[int]) -> NoiseModel:
    pick = lambda v: v[which] if np.ndim(v) else v  # noqa: E731
    return replace(model, white=pick(model.white), slow=pick(model.slow))


def _of_markers(given: NoiseModel, rec: Recording, one: Markers, by_name: bool) -> NoiseModel:
    """A noise model that was given: by the instrument's name of its markers, else of the recording's if of so many."""
    counts = {np.size(v) for v in (given.white, given.slow) if np.ndim(v)}
    if not counts or (by_name and counts == {len(one.markers)}):
        return given
    if counts == {len(rec.names)}:
        return narrowed(given, rec, one)
    if counts == {len(one.markers)}:
        return given
    raise ParameterError(
        f"noise: it is of {', '.join(map(str, sorted(counts)))} markers; '{one.name}' sees {len(one.markers)}, and "
        f"recording '{rec.name}' has {len(rec.names)}"
    )


def _noise(given: Any, one: Observation, measured: np.ndarray, rec: Recording) -> NoiseModel:
    if isinstance(given, NoiseModel):
        return given
    if given is not None:
        return one.noise(float(given))
    # white noise alone shows in second differences of a channel
    second = np.diff(measured.reshape(len(measured), -1), 2, axis=0)
    second = second[np.isfinite(second)]
    sigma = float(np.median(np.abs(second))) / 0.6745 / np.sqrt(6.0) if len(second) >= 10 else 0.0
    if not sigma > 0.0:
        raise RecordingError(
            f"recording '{rec.name}': the noise of '{one.name}' cannot be told from it; give "
            f"noise={{'{one.name}': ...}}, a standard deviation [{one.unit}]"
        )
    return one.noise(sigma)
