"""Cases whose predictions may have shares of their own errors added: their trials, packed and restated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from rodnet.inference.case import Case
from rodnet.inference.comparison import Comparison, Fit
from rodnet.inference.corrections import Corrections, Fields, is_share
from rodnet.inference.packing import pack_case, pack_trial, unpack_trial
from rodnet.inference.problem import Problem
from rodnet.recordings.observation import Observation
from rodnet.recordings.recording import Recording
from rodnet.robot import Robot

if TYPE_CHECKING:
    from rodnet.diagnosis.workbench import Fitted


@dataclass(frozen=True)
class Carried:
    """``observe`` of a case that carries along what finer runs and errors of the drives' records change.

    Attributes
    ----------
    case : Case
        The case without.
    fields : mapping
        What a finer time step and a finer mesh change, by name of the recording.
    records : mapping
        Likewise, what a standard deviation of each error of its drives' records changes.
    count : int
        Number of these errors.
    """

    case: Case
    fields: Mapping[str, Fields]
    records: Mapping[str, Fields] = field(default_factory=dict)
    count: int = 0

    def of(self, name: str) -> Corrections:
        """What is carried along of a recording; nothing changes in one that was not measured."""
        return Corrections(self.fields.get(name, {}), self.records.get(name, {}), self.count)

    def __call__(self, rec: Recording, robot: Robot) -> list[Observation]:
        """Return the instruments of a recording with their corrections."""
        found = self.case.observations(rec, robot)
        self.of(rec.name).put(found)
        return found


def pack_trials(case: Case, trials: Sequence[Comparison], modes: int) -> list[bytes]:
    """Pack trials for other processes, each with its own corrections and not with those of all others."""
    along = case.observe if isinstance(case.observe, Carried) else None
    blob = pack_case(case if along is None else replace(case, observe=along.case.observe))
    own = [None if along is None else along.of(t.rec.name) for t in trials]
    return [pack_trial(blob, t.rec, t.noise, modes, corrections=c) for t, c in zip(trials, own, strict=True)]


def restated(problem: Problem, z: np.ndarray, known: Fitted) -> list[Fit] | None:
    """Fits of a model that is known beside other corrections; None if a problem's values ``z`` are others."""
    mine = problem.quantities
    if [(q.path, q.trial) for q in mine] != [(q.path, q.trial) for q in known.quantities]:
        return None
    there = [(known.values if q.trial is None else known.own[q.trial])[q.path] for q in mine]
    slopes = np.array([q.slope(c) for q, c in zip(mine, z, strict=True)])
    before = np.array([q.slope(q.coordinate(v)) for q, v in zip(known.quantities, there, strict=True)])
    same = [q.value(c) for q, c in zip(mine, z, strict=True)] == there
    if not (same and slopes.all() and before.all()):
        return None
    found = []
    for k, (packed, fit) in enumerate(zip(problem.packed, known.fits, strict=True)):
        shares = [j for j, q in enumerate(mine) if is_share(q.path) and q.trial in (None, k)]
        J = known.jacobian_of(k) * (slopes / before)
        one = unpack_trial(packed).corrected(fit, problem.values(z, k), [mine[j].path for j in shares])
        J[:, shares] = one.jacobian * slopes[shares]
        found.append(replace(one, jacobian=J))
    return found
