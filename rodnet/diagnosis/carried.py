"""Cases whose predictions may have a share of their numerical error added, and how trials of them are packed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rodnet.inference.case import Case
from rodnet.inference.comparison import Comparison, pack_trial
from rodnet.recordings.observation import Observation
from rodnet.recordings.recording import Recording
from rodnet.robot import Robot

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
    from rodnet.sweeps.job import pack

    fields: Mapping[str, Fields] = {}
    if isinstance(case.observe, Carried):
        fields = case.observe.fields
        case = replace(case, observe=case.observe.case.observe)
    blob = pack(case, "functions of the case")
    return [pack_trial(blob, t.rec, t.noise, modes, corrections=fields.get(t.rec.name, {})) for t in trials]
