"""Errors of drives' records: where each trial was held, and how it was turned there, a little beside what was recorded.

A motion is told from where its record begins, and that record has noise: for the whole of a trial the robot is held
beside where it is said to be, by about the noise of one sample. It is so from the beginning where the robot is drawn
from the record, and comes there while a spline forgets its first samples where it is drawn from something else. A place
is recorded in space: by what it is off does not turn with the gripper, as what is held elsewhere does. This is the
trial's own, as its initial state is, and about as large as the noise tells (docs, theory: diagnosis).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar

import numpy as np

from rodnet.diagnosis.bank.actuators import replaced
from rodnet.diagnosis.bank.joints import grasp_twist, root_direction
from rodnet.diagnosis.candidate import Candidate
from rodnet.diagnosis.carried import Carried
from rodnet.diagnosis.records import RecordNoise, record_noise
from rodnet.diagnosis.workbench import UNABLE, Fitted, Workbench
from rodnet.errors import ConvergenceError
from rodnet.inference.corrections import Fields
from rodnet.parameters import Parameter
from rodnet.robot import Robot
from rodnet.terms.constraints import PrescribedMotion
from rodnet.terms.imperfect import ImperfectMotion

# standard deviation of an error, in those of the record: a spline may be off by more than a sample where it begins
WIDE = 1.5
FORGOTTEN = 0.1  # [s] in which a spline comes from its first samples to where the others have it, about
PLACE = "record-place"

RecordError = tuple[
    Candidate, str, float
]  # an effect, one of its strengths, and the value of a standard deviation


class MisreadMotion(ImperfectMotion):
    """Prescribed motion beside what was recorded, in space: from the beginning on, and from soon after.

    Parameters
    ----------
    off_x, off_y, off_z : float or Parameter
        By how much from the beginning on [m]: all of the robot is drawn there.
    slip_x, slip_y, slip_z : float or Parameter
        By how much soon after [m]: it begins where it is drawn.
    """

    source = "docs, theory: diagnosis (records of drives)"
    off_x = Parameter(0.0, unit="m", null=0.0, doc="offset along x in space")
    off_y = Parameter(0.0, unit="m", null=0.0, doc="offset along y in space")
    off_z = Parameter(0.0, unit="m", null=0.0, doc="offset along z in space")
    slip_x = Parameter(0.0, unit="m", null=0.0, doc="offset along x in space, after the start")
    slip_y = Parameter(0.0, unit="m", null=0.0, doc="offset along y in space, after the start")
    slip_z = Parameter(0.0, unit="m", null=0.0, doc="offset along z in space, after the start")
    example: ClassVar[dict[str, Any]] = {**ImperfectMotion.example, "off_x": 1e-3, "slip_x": 1e-3}

    def position(self, t: float, x0: np.ndarray, p: Any) -> np.ndarray:
        """Positions of the held nodes [m], shape (n, 3)."""
        return np.asarray(super().position(t, x0, p) + _beside(t, p))

    def many(self, times: np.ndarray, x0: np.ndarray, p: Any) -> tuple[np.ndarray, np.ndarray]:
        """Positions and rotations at many times, shapes (m, n, 3) and (m, 3, 3)."""
        x, R = super().many(times, x0, p)
        return x + _beside(times[:, None], p)[:, None], R


def _beside(t: Any, p: Any) -> np.ndarray:
    """By how much at a time, shape (3,), or at many of shape (m, 1)."""
    off, slip = np.array([p.off_x, p.off_y, p.off_z]), np.array([p.slip_x, p.slip_y, p.slip_z])
    return np.asarray(off + _forgotten(t) * slip)


def _forgotten(t: Any) -> Any:
    """How much of the way is gone."""
    return 1.0 - np.exp(-((np.maximum(t, 0.0) / FORGOTTEN) ** 2))


def _places(robot: Robot) -> Iterator[Candidate]:
    """One for each prescribed motion."""
    for term in robot.terms:
        if type(term) in (PrescribedMotion, ImperfectMotion):
            yield Candidate(
                id=f"{PLACE}@{term.name}", title="what is held is beside its record", group="actuator",
                build=partial(replaced, name=term.name, cls=MisreadMotion),
                strength=tuple(f"{term.name}.{kind}_{axis}" for kind in ("off", "slip") for axis in "xyz"),
                falsifier="the rod is moved alike by it, whatever else it does",
            )  # fmt: skip


def record_errors(bench: Workbench) -> list[RecordError]:
    """What the records of a robot's drives may be off by: the same in all trials, each with values of its own.

    Beside what a case says that its model is off by, that is nothing.
    """
    if bench.case.noise is not None:
        return []
    case = bench.case.observe.case if isinstance(bench.case.observe, Carried) else bench.case
    known = record_noise(case.robot, map(case.part, bench.recordings))
    robot = case.robot(bench.simplest)
    return [
        (one, path, size)
        for family in (_places, root_direction, grasp_twist)
        for one in family(robot)
        for path, size in _sizes(one, known)
    ]


def _sizes(candidate: Candidate, known: dict[str, RecordNoise]) -> Iterator[tuple[str, float]]:
    noise = known.get(candidate.on)
    size = None if noise is None else noise.shift if candidate.family == PLACE else noise.turn
    if size:
        for path in candidate.strength:
            yield path, size


def uncarried(bench: Workbench) -> bool:
    """Whether records of drives may be off by what trials do not carry along: of unknown size, or of a known one."""
    if bench.case.noise is not None:
        return False
    carried = isinstance(bench.case.observe, Carried) and bench.case.observe.count > 0
    noises = record_noise(bench.case.robot, map(bench.case.part, bench.recordings)).values()
    return not all(one.known for one in noises) or (not carried and bool(record_errors(bench)))


def carrying_records(bench: Workbench, fitted: Fitted, found: list[RecordError]) -> Workbench:
    """The trials with errors of their drives' records as what each has of its own.

    What they change is taken to first order, about a model: they are as small as the noise of a record.

    Parameters
    ----------
    bench : Workbench
        The trials.
    fitted : Fitted
        A model of them.
    found : list
        The `record_errors` of the trials that the model is calibrated with.

    Returns
    -------
    Workbench
        ``bench`` itself where there are none, where trials have different first instruments, or where one cannot be
        simulated with an error.
    """
    case = bench.case
    firsts = {case.observations(part, case.robot(part))[0].name for part in map(case.part, bench.recordings)}
    if not found or len(firsts) > 1:
        return bench
    try:
        fields = _fields(bench, fitted, found)
    except UNABLE:
        return bench
    along = case.observe if isinstance(case.observe, Carried) else Carried(case, {})
    paths = [f"{next(iter(firsts))}.records[{j}]" for j in range(len(found))]
    observe = replace(along, records=fields, count=len(found))
    own = [p for p in case.per_trial if p not in paths]
    case = replace(case, observe=observe, per_trial=(*own, *paths))
    return replace(bench, case=case, priors={**bench.priors, **dict.fromkeys(paths, (0.0, WIDE))})


def _fields(bench: Workbench, fitted: Fitted, found: list[RecordError]) -> dict[str, Fields]:
    """What a standard deviation of each error changes of the readings, by recording and instrument.

    Raises
    ------
    ConvergenceError
        If a trial cannot be simulated with one.
    """
    changes: list[list[list[np.ndarray]]] = []  # of each error, trial and instrument
    for candidate, path, size in found:
        values = {**fitted.values, **dict.fromkeys(candidate.strength, 0.0), path: size}
        problem = bench.problem((*fitted.candidates, candidate), values, fitted.own)
        problem.fixed |= {p: v for p, v in fitted.values.items() if "." in p and p not in problem.fixed}
        fits = problem.fits(np.zeros(len(problem.quantities)), slopes=False)
        if fits is None:
            raise ConvergenceError(problem.failures[-1])
        bench.simulated += len(fits)
        changes.append(
            [
                [moved - still for moved, still in zip(one.plain, known.plain, strict=True)]
                for one, known in zip(fits, fitted.fits, strict=True)
            ]
        )
    return {
        rec.name: {name: tuple(one[k][number] for one in changes) for number, (name, _) in enumerate(labels)}
        for k, (rec, labels) in enumerate(zip(bench.recordings, (f.labels for f in fitted.fits), strict=True))
    }
