"""The repaired model: the robot with the fitted effects in it, as files that run and can be evaluated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rodnet.diagnosis.findings import Diagnosis, interval
from rodnet.diagnosis.workbench import with_candidates
from rodnet.errors import RobotFileError
from rodnet.inference.case import Case
from rodnet.inference.fitted import Fitted, FittedValue
from rodnet.inference.quantities import robot_values
from rodnet.recordings.recording import Recording
from rodnet.robot import Robot

PROGRAM = '''"""The case '{name}' with what the diagnosis added: for `rodnet evaluate` and `rodnet calibrate`."""

from pathlib import Path

from rodnet.diagnosis.repaired import repaired_case

case = repaired_case(Path({path!r}), {ids!r})
parts = {{name: value for name, value in vars(case).items() if value is not None}}
globals().update({{name: value for name, value in parts.items() if name not in ("name", "path")}})
'''


def repaired_case(path: Path, ids: list[str]) -> Case:
    """Return a case with candidates in its robots, by their ids.

    Raises
    ------
    CaseError
        If there is no such case or candidate.
    """
    from rodnet.inference.case import load_case

    return with_effects(load_case(path), ids)


def with_effects(case: Case, ids: Sequence[str]) -> Case:
    """Return a case with candidates in its robots, by their ids."""
    return replace(case, build=_Repaired(case, tuple(ids)))


class _Repaired:
    """Builds robots with candidates in them, at their null values."""

    def __init__(self, case: Case, ids: tuple[str, ...]) -> None:
        self.case, self.ids = case, ids

    def __call__(self, rec: Recording) -> Robot:
        from rodnet.diagnosis.candidate import candidates

        robot = self.case.robot(rec)
        instruments = self.case.observations(rec, robot)
        for one in candidates(robot, instruments, list(self.ids)):
            built = one.build(robot)
            robot = robot if built is None else built
        return robot


def repaired_robot(found: Diagnosis) -> Robot:
    """Return the robot of the first trial with the fitted values and effects."""
    case = with_candidates(found.case, found.model.candidates, ())
    robot = case.robot(case.part(found.recordings[0]))
    known = robot.parameters
    values = {p: v for p, v in found.model.values.items() if p.partition("[")[0] in known}
    values |= {p: float(f(found.model.values)) for p, f in case.tied.items()}
    return robot.with_parameters(robot_values(robot, values)) if values else robot


def write(found: Diagnosis, directory: Path) -> list[Path]:
    """Write ``repaired.toml`` (for `rodnet run`), ``repaired.py`` and ``fitted.json`` (for `rodnet evaluate`)."""
    directory.mkdir(parents=True, exist_ok=True)
    paths = []
    try:
        paths.append(repaired_robot(found).save(directory / "repaired.toml"))
    except RobotFileError as error:
        (directory / "repaired.txt").write_text(
            f"The robot could not be written to a file: {error}\n", encoding="utf-8"
        )
        paths.append(directory / "repaired.txt")
    if found.case.path is not None:
        ids = [c.id for c in found.model.candidates]
        text = PROGRAM.format(name=found.case.name, path=str(found.case.path.resolve()), ids=ids)
        (directory / "repaired.py").write_text(text, encoding="utf-8")
        paths.append(directory / "repaired.py")
    model = found.model
    values = {}
    for q in model.quantities:
        if q.trial is None and ".numerics[" not in q.path:
            v = interval(model, q.path)
            values[q.path] = FittedValue(v.value, v.unit, v.low, v.high)
    for path, function in found.case.tied.items():
        values[path] = FittedValue(float(function(model.values)))
    notes = {"effects": [c.id for c in model.candidates]}
    paths.append(Fitted(found.case.name, values, found.names, notes).save(directory))
    return paths
