"""A case with effects in its robots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from rodnet.diagnosis.candidate import Candidate
from rodnet.inference.case import Case
from rodnet.recordings.observation import Observation
from rodnet.recordings.recording import Recording
from rodnet.robot import Robot


def with_candidates(case: Case, candidates: Sequence[Candidate], free: Sequence[str]) -> Case:
    """Return the case with effects in its robots, and their parameters free."""
    if not candidates:
        return case
    plain = Case(case.build, _unseen, name=case.name)  # nothing of it is observed
    return replace(case, build=_Edited(plain, tuple(candidates)), free=(*case.free, *free))


def _unseen(rec: Recording, robot: Robot) -> Sequence[Observation]:
    return ()


@dataclass(frozen=True)
class _Edited:
    case: Case
    candidates: tuple[Candidate, ...]

    def __call__(self, rec: Recording) -> Robot:
        robot = self.case.robot(rec)
        for candidate in self.candidates:
            built = candidate.build(robot)
            robot = robot if built is None else built
        return robot
