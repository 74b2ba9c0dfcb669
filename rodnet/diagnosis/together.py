"""Columns of many candidates from one run of each trial.

At its null value a candidate is not there, so that all of them are differentiated along the same run: that of the
fitted model. A term that only adds forces is asked for them at the states of this run; what changes stiffnesses,
masses or natural shapes is compared with the model piece by piece; parameters of instruments are read off.
"""

from __future__ import annotations

import pickle
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.diagnosis.carried import pack_trials
from rodnet.diagnosis.edited import with_candidates
from rodnet.errors import RodnetError
from rodnet.inference.comparison import Comparison
from rodnet.inference.packing import unpack_trial
from rodnet.inference.quantities import instrument_path, is_there, robot_values, with_ties
from rodnet.inference.shots import Shots, why
from rodnet.robot import Robot
from rodnet.sweeps.job import pack
from rodnet.tangent.added import Unfit
from rodnet.tangent.columns import by_added, by_edit, by_parameter, by_replaced
from rodnet.tangent.compare import alike
from rodnet.tangent.fast import fits
from rodnet.tangent.memories import followed
from rodnet.tangent.parts import Part
from rodnet.tangent.variation import Variation
from rodnet.terms.drag.change import DragChange

if TYPE_CHECKING:
    from rodnet.diagnosis.columns import _Bank
    from rodnet.diagnosis.workbench import Fitted, Workbench


def shared_columns(bench: Workbench, fitted: Fitted, banks: Sequence[_Bank]) -> dict[str, np.ndarray]:
    """Derivatives of the residuals by the strengths over their scales, at every place, by id of the candidates.

    Shape (n, places times strengths). Candidates that cannot be told from this run are left out.
    """
    case = replace(with_candidates(bench.case, fitted.candidates, ()), free=(), per_trial=())
    edits = pack(tuple(banks), "candidates")
    trials = [
        Comparison(case, rec, noise, bench.modes)
        for rec, noise in zip(bench.recordings, bench.noise, strict=True)
    ]
    jobs = []
    for k, (built, packed) in enumerate(zip(trials, pack_trials(case, trials, bench.modes), strict=True)):
        known = with_ties(bench.case.tied, {**fitted.values, **fitted.own[k]})
        values = {p: v for p, v in known.items() if is_there(built.robot, built.instruments, p)}
        jobs.append(bench.executor.submit(columns_of_trial, packed, {**values, **fitted.own[k]}, edits))
    found = [job.result() for job in jobs]
    told = [t for t in found if not isinstance(t, str)]
    if len(told) < len(found):
        return {}
    bench.simulated += len(found)
    return {
        bank.candidate.id: np.concatenate([t[bank.candidate.id] for t in told])
        for bank in banks
        if all(bank.candidate.id in t for t in told)
    }


def _read(trial: Comparison, path: str) -> bool:
    return instrument_path(trial.instruments, path) is not None


def columns_of_trial(packed: bytes, values: dict[str, float], edits: bytes) -> dict[str, np.ndarray] | str:
    """Columns of one trial by id of the candidates, as far as its run can tell; a text says why there is no run."""
    trial, banks = unpack_trial(packed), pickle.loads(edits)
    try:
        return _columns(trial, values, banks)
    except RodnetError as error:
        return why(error)


def _columns(trial: Comparison, values: dict[str, float], banks: Sequence[_Bank]) -> dict[str, np.ndarray]:
    seen = [
        bank for bank in banks if bank.candidate.observe and not bank.candidate.shape
    ]  # these are read as they are
    scales = {p: float(bank.scales[p]) for bank in seen for p in bank.candidate.strength if _read(trial, p)}
    start = {p: bank.nulls[p] for bank in seen for p in bank.candidate.strength if p in scales}
    shots = Shots(trial, {**start, **values}, scales)
    model, stepper = shots.sim.model, shots.sim.stepper
    known = followed(model) if fits(model) else set()
    if not fits(model) or any(b.memory is not None and k not in known for k, b in enumerate(model.bound)):
        return {}  # of such runs differences tell
    if (
        shots.robot.sensors or stepper.needs_acceleration
    ):  # effects change how they begin, and what actuators do
        return {}
    columns: dict[str, list[Variation]] = {}
    for bank in banks:
        if not bank.candidate.observe:
            found = _variations(shots, trial, bank)
            if found is not None:
                columns[bank.candidate.id] = found
    shots.add([v for some in columns.values() for v in some])
    if not shots.paths:
        return {}
    shot = shots.shoot(0)
    table = trial._whiten(shot.predicted, shot.slopes, slice(None), None)[0][:, 1:]
    place = {path: k for k, path in enumerate(shots.paths)}
    result = {}
    for bank in banks:
        own = bank.candidate
        if own.id in columns:
            names = [v.name for v in columns[own.id]]
        elif bank in seen and all(p in place for p in own.strength) and len(bank.shapes) == 1:
            names = list(own.strength)
        else:
            continue
        size = np.tile([float(bank.scales[p]) for p in own.strength], len(bank.shapes))
        result[own.id] = table[:, [place[name] for name in names]] * size
    return result


def _variations(shots: Shots, trial: Comparison, bank: _Bank) -> list[Variation] | None:
    """What a candidate changes, place by place and strength by strength; None if the run cannot tell."""
    robot, options = shots.robot, trial.robot_at(shots.values)[1]
    found = []
    try:
        built = bank.candidate.build(robot)
        if built is None:
            return None
        for k, shape in enumerate(bank.shapes):
            known = {p: v for p, v in shape.items() if p in built.parameters}
            edited = built._changed(robot_values(built, known)) if known else built
            for path in bank.candidate.strength:
                name, scale = f"{bank.candidate.id}|{k}|{path}", float(bank.scales[path])
                one = _variation(shots, robot, edited, path, scale, options)
                if one is None:
                    return None
                found.append(replace(one, name=name))
    except RodnetError:
        return None
    return found


def _variation(
    shots: Shots, robot: Robot, edited: Robot, path: str, scale: float, options: Mapping[str, Any]
) -> Variation | None:
    """Column of a strength, as simply as it can be had."""
    more = len(edited.terms) > len(robot.terms)  # else the strength is one that the robot has already
    kept = more and edited.graph is robot.graph and edited.terms[: len(robot.terms)] == robot.terms
    model, ev = shots.sim.model, shots.sim.newton.ev
    if kept:
        one = by_added(robot, edited, path, scale)
        with suppress(Unfit):
            Part(model, ev, one)
            return one
    if path not in robot.parameters and not any(isinstance(term, DragChange) for term in robot.terms):
        replaced = by_replaced(robot, edited, path, scale)  # a change of drag would act on the other law
        if replaced is not None:
            with suppress(Unfit):
                Part(model, ev, replaced)
                return replaced
    one = by_edit(robot, edited, path, scale) if kept else by_parameter(edited, path, scale, options)
    memories = [(b.memory, c.memory) for _, sim in one.near for b, c in zip(model.bound, sim.model.bound)]  # noqa: B905
    if kept and not all(alike(*pair) for pair in memories):
        return None  # what the model remembers at the start is changed, too
    with suppress(Unfit):
        return None if Part(model, ev, one).motors else one
    return None
