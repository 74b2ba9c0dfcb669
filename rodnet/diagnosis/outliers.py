"""Samples that stand out of what their instrument read before and after: left out of all trials (swapped markers)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rodnet.diagnosis.workbench import Fitted, Workbench
from rodnet.inference.case import Case
from rodnet.inference.packing import unpack_trial
from rodnet.inference.problem import reject
from rodnet.recordings.observation import Observation
from rodnet.recordings.recording import Recording
from rodnet.robot import Robot

STANDS_OUT = 5.0  # times what is usual of a marker nearby, as in a calibration
ROUNDS = 3  # a fit without some may show others

Masks = Mapping[str, Mapping[str, np.ndarray]]  # by recording and instrument, (frames, samples) of bool


def cleaned(bench: Workbench, fitted: Fitted, common: bool = True) -> tuple[Workbench, Fitted]:
    """The trials without the samples that stand out of what a model leaves, and the model fitted to them.

    Without ``common`` only what each trial has of its own is fitted.

    A model that misfits for a while leaves what is smooth in time, and takes nothing away; see
    `rodnet.inference.problem.reject`.
    """
    for _ in range(ROUNDS):
        found = _outliers(bench, fitted)
        if not any(mask.any() for own in found.values() for mask in own.values()):
            break
        bench = replace(bench, case=_without(bench.case, found))
        fitted = bench.fit(fitted.candidates, values=fitted.values, own=fitted.own, common=common)
    return bench, fitted


def left_out(bench: Workbench) -> dict[str, int]:
    """Number of samples that are left out, by trial."""
    masks = bench.case.observe.masks if isinstance(bench.case.observe, _Without) else {}
    known = {rec.name: masks.get(rec.name, {}) for rec in bench.recordings}
    return {name: sum(int(mask.sum()) for mask in own.values()) for name, own in known.items()}


def with_all(case: Case) -> Case:
    """The case whose instruments leave nothing out: of trials that have not been recorded."""
    return case.observe.case if isinstance(case.observe, _Without) else case


def _outliers(bench: Workbench, fitted: Fitted) -> Masks:
    problem = bench.problem(fitted.candidates, fitted.values, fitted.own)
    found = {}
    for rec, packed, fit in zip(bench.recordings, problem.packed, fitted.fits, strict=True):
        trial = unpack_trial(packed)
        names = [one.name for one in trial.instruments]
        found[rec.name] = dict(zip(names, reject(trial, fit, STANDS_OUT), strict=True))
    return found


def _without(case: Case, masks: Masks) -> Case:
    """The case whose instruments leave these samples out, and those that they leave out already."""
    inner, known = case, {}
    if isinstance(case.observe, _Without):
        inner, known = case.observe.case, {name: dict(own) for name, own in case.observe.masks.items()}
    for name, own in masks.items():
        mine = known.setdefault(name, {})
        for which, mask in own.items():
            mine[which] = mask | mine[which] if which in mine else mask
    return replace(case, observe=_Without(inner, known))


@dataclass(frozen=True)
class _Without:
    case: Case
    masks: Masks

    def __call__(self, rec: Recording, robot: Robot) -> Sequence[Observation]:
        found = self.case.observations(rec, robot)
        for one in found:
            one.left_out = self.masks.get(rec.name, {}).get(one.name)
        return found
