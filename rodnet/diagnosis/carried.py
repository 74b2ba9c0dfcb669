"""Cases whose predictions may have a share of their numerical error added: their trials, packed and restated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from rodnet.inference.case import Case
from rodnet.inference.comparison import Comparison, Fit
from rodnet.inference.packing import pack_case, pack_trial, unpack_trial
from rodnet.inference.problem import Problem
from rodnet.recordings.observation import Observation
from rodnet.recordings.recording import Recording
from rodnet.robot import Robot

if TYPE_CHECKING:
    from rodnet.diagnosis.workbench import Fitted

Fields = Mapping[str, tuple[np.ndarray, ...]]  # of one trial, by instrument: one of each kind of error


@dataclass(frozen=True)
class Carried:
    """``observe`` of a case that carries what a finer time step and a finer mesh change along.

    Attributes
    ----------
    case : Case
        The case without.
    fields : mapping
        The changes, by name of the recording.
    """

    case: Case
    fields: Mapping[str, Fields]

    def __call__(self, rec: Recording, robot: Robot) -> list[Observation]:
        """Return the instruments of a recording with their corrections."""
        found = self.case.observations(rec, robot)
        for one in found:
            one.corrections = self.fields.get(rec.name, {}).get(one.name, ())
        return found


def pack_trials(case: Case, trials: Sequence[Comparison], modes: int) -> list[bytes]:
    """Pack trials for other processes, each with its own numerical error and not with those of all others."""
    fields: Mapping[str, Fields] = {}
    if isinstance(case.observe, Carried):
        fields = case.observe.fields
        case = replace(case, observe=case.observe.case.observe)
    blob = pack_case(case)
    return [pack_trial(blob, t.rec, t.noise, modes, corrections=fields.get(t.rec.name, {})) for t in trials]


def restated(problem: Problem, z: np.ndarray, known: Fitted) -> list[Fit] | None:
    """Fits of a model that is known beside other numerical errors; None if a problem's values ``z`` are others."""
    mine = problem.quantities
    if [(q.path, q.trial) for q in mine] != [(q.path, q.trial) for q in known.quantities]:
        return None
    there = [(known.values if q.trial is None else known.own[q.trial])[q.path] for q in mine]
    slopes = np.array([q.slope(c) for q, c in zip(mine, z, strict=True)])
    before = np.array([q.slope(q.coordinate(v)) for q, v in zip(known.quantities, there, strict=True)])
    same = [q.value(c) for q, c in zip(mine, z, strict=True)] == there
    if not (same and slopes.all() and before.all()):
        return None
    shares, found = [k for k, q in enumerate(mine) if ".numerics[" in q.path], []
    for k, (packed, fit) in enumerate(zip(problem.packed, known.fits, strict=True)):
        J = known.jacobian_of(k) * (slopes / before)
        one = unpack_trial(packed).corrected(fit, problem.values(z, k), [mine[j].path for j in shares])
        J[:, shares] = one.jacobian * slopes[shares]
        found.append(replace(one, jacobian=J))
    return found
