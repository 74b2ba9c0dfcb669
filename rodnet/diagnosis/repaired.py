"""The repaired model: the robot with the fitted effects in it, as files that run and can be evaluated."""

from __future__ import annotations

import fnmatch
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import norm

from rodnet.diagnosis.candidate import Candidate
from rodnet.diagnosis.edited import with_candidates
from rodnet.diagnosis.findings import LEVEL, interval
from rodnet.diagnosis.frozen import freeze, thaw
from rodnet.diagnosis.law import Draft
from rodnet.diagnosis.library import LAW, Piece, law_of
from rodnet.diagnosis.result import Diagnosis
from rodnet.errors import RobotFileError
from rodnet.inference.case import Case
from rodnet.inference.fitted import Fitted, FittedValue
from rodnet.inference.quantities import instrument_path, is_there, robot_values, set_instrument, with_ties
from rodnet.inference.simpler import stored
from rodnet.recordings.observation import Observation
from rodnet.recordings.recording import Recording
from rodnet.robot import Robot
from rodnet.terms.constraints import PrescribedMotion
from rodnet.terms.imperfect import ImperfectMotion

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

# a candidate's id, the terms that it adds as it was tried, or the pieces of a law
Effect = str | Mapping[str, Any] | Sequence[Mapping[str, Any]]

ROBOT = "repaired.toml"
FITTED = 0.95  # level of the intervals of fitted models
WIDER = float(norm.ppf(0.5 + 0.5 * FITTED) / norm.ppf(0.5 + 0.5 * LEVEL))  # than those of a diagnosis
SAMPLES = 200.0  # of a prescribed motion [1/s]
FEWEST = 400  # of its samples: it is brought to rest in the last ten pieces
FOREVER = 1e9  # that it stays where it was last [s]

PROGRAM = '''"""The case '{name}' with what the diagnosis added, as fitted, for `rodnet evaluate` and `calibrate`."""

from pathlib import Path

from rodnet.diagnosis.repaired import repaired_case

CASE = Path(__file__).parent / {path!r}
VALUES = {values!r}

case = repaired_case(CASE, {effects!r}, VALUES, held={held!r})
parts = {{name: value for name, value in vars(case).items() if value is not None}}
globals().update({{name: value for name, value in parts.items() if name not in ("name", "path")}})
'''


def repaired_case(
    path: Path, effects: Sequence[Effect], values: Mapping[str, float], held: Sequence[str] = ()
) -> Case:
    """Return a case with effects in its robots and fitted values in effect; see `with_effects`.

    What the effects are described by is free in a calibration, too; values that are ``held`` are not.

    Raises
    ------
    CaseError
        If there is no such case or candidate.
    """
    from rodnet.inference.case import load_case

    case = load_case(path)
    added = [p for p in values if p not in case.free and p not in case.tied and p not in held]
    repaired = _Repaired(case, tuple(effects), values)
    return replace(case, build=repaired, observe=_Observed(case, values), free=(*case.free, *added))


def with_effects(case: Case, effects: Sequence[Effect]) -> Case:
    """Return a case with effects in its robots: candidates as `freeze` has them, a law as a list of its pieces."""
    return replace(case, build=_Repaired(case, tuple(effects)))


def effects_of(candidates: Sequence[Candidate], law: Draft | None) -> list[Effect]:
    """Return what `with_effects` takes, of the candidates in a model."""
    return [
        [piece.to_dict() for piece in law.pieces] if law is not None and c.id == LAW else freeze(c)
        for c in candidates
    ]


class _Repaired:
    """Builds robots with effects in them, at their null values or with those that are given."""

    def __init__(
        self, case: Case, effects: tuple[Effect, ...], values: Mapping[str, float] | None = None
    ) -> None:
        self.case, self.effects, self.values = case, effects, values or {}

    def __call__(self, rec: Recording) -> Robot:
        robot = plain = self.case.robot(rec)
        for effect in self.effects:
            if isinstance(effect, Mapping):
                robot = thaw(effect, robot)
                continue
            for one in self._candidates(effect, rec, plain):
                built = one.build(robot)
                robot = robot if built is None else built
        values = {p: v for p, v in self.values.items() if is_there(robot, (), p)}
        return robot.with_parameters(robot_values(robot, values)) if values else robot

    def _candidates(
        self, effect: str | Sequence[Mapping[str, Any]], rec: Recording, robot: Robot
    ) -> Iterator[Candidate]:
        """The case's own are found by their ids, too."""
        from rodnet.diagnosis.candidate import as_family, candidates

        if not isinstance(effect, str):
            yield law_of([Piece.from_dict(piece) for piece in effect])
            return
        instruments = self.case.observations(rec, robot)
        own = {
            one.id: one
            for k, found in enumerate(self.case.candidates)
            for one in as_family(getattr(found, "id", f"case-{k}"), found)(robot, instruments)
        }
        if effect in own:
            yield own[effect]
        else:
            yield from candidates(robot, instruments, [effect])


class _Observed:
    """Instruments with the values that are given."""

    def __init__(self, case: Case, values: Mapping[str, float]) -> None:
        self.case, self.values = case, values

    def __call__(self, rec: Recording, robot: Robot) -> list[Observation]:
        found = self.case.observations(rec, robot)
        for path, value in self.values.items():
            if place := instrument_path(found, path):
                set_instrument(found[place[0]], place[1], place[2], value)
        return found


def repaired_robot(found: Diagnosis) -> Robot:
    """Return the robot of the first trial with the fitted values and effects."""
    case = with_candidates(found.case, found.repaired.candidates, ())
    robot = case.robot(case.part(found.recordings[0]))
    known = list(robot.parameters)
    every = with_ties(case.tied, {**found.repaired.values, **found.repaired.own[0]})
    values = {p: v for p, v in every.items() if p in case.tied or fnmatch.filter(known, p.partition("[")[0])}
    return robot.with_parameters(robot_values(robot, values)) if values else robot


def as_splines(robot: Robot, duration: float) -> Robot:
    """Return a robot whose prescribed motions are splines, which files can hold; after some time [s] they stop.

    What runs late asks for what was prescribed before the beginning, which is sampled, too.
    """
    from scipy.interpolate import make_interp_spline
    from scipy.spatial.transform import Rotation

    terms = []
    for term in robot.terms:
        if isinstance(term, PrescribedMotion) and type(term) in (PrescribedMotion, ImperfectMotion):
            begin = 0.0
            if isinstance(term, ImperfectMotion):
                begin = min(0.0, *(s for _, s in term.followed(0.0, term.values())))
            t = np.linspace(begin, duration, max(int((duration - begin) * SAMPLES), FEWEST) + 1)
            motion: dict[str, BSpline] = {}
            if term.displacement is not None:
                motion["position"] = _stopping(make_interp_spline(t, [term.displacement(s) for s in t], k=5))
            if term.rotation is not None:
                turns = Rotation.from_matrix([term.rotation(s) for s in t]).as_quat()
                # a quaternion and its negative are one rotation: keep to one side
                turns *= np.cumprod(
                    [1.0, *np.where(np.sum(turns[1:] * turns[:-1], axis=1) < 0.0, -1.0, 1.0)]
                )[:, None]
                motion["orientation"] = _stopping(make_interp_spline(t, turns, k=5))
            more: dict[str, Any] = dict(term.parameter_items())
            term = type(term)(at=term.on, name=term.name, **motion, **more)
        terms.append(term)
    return Robot(robot.graph, terms, robot.sensors)


def _stopping(spline: BSpline) -> BSpline:
    """The same but for its last pieces, in which it comes to rest: beyond its end a polynomial goes anywhere."""
    k, count, end = spline.k, len(spline.c), spline.t[-1]
    stops = end + (end - spline.t[count - 1]) * np.arange(k + 1)
    knots = np.concatenate([spline.t[:count], stops, np.full(k + 1, FOREVER)])
    return type(spline)(knots, np.concatenate([spline.c, np.repeat(spline.c[-1:], k + 1, axis=0)]), k)


def write(found: Diagnosis, directory: Path) -> list[Path]:
    """Write ``repaired.toml`` (for `rodnet run`), ``repaired.py`` and ``fitted.json`` (for `rodnet evaluate`)."""
    directory.mkdir(parents=True, exist_ok=True)
    paths = []
    rec, path = found.case.part(found.recordings[0]), directory / ROBOT
    robot = repaired_robot(found)
    try:
        paths.append(robot.save(path))
    except RobotFileError:
        try:
            paths.append(as_splines(robot, 1.1 * rec.duration).save(path))
        except RobotFileError as error:
            path = path.with_suffix(".txt")
            path.write_text(f"The robot could not be written to a file: {error}\n", encoding="utf-8")
            paths.append(path)
    model = found.repaired
    fitted, told = {}, {p: v for one in found.findings for p, v in one.parameters.items()}
    for q in model.quantities:
        if q.trial is None and ".numerics[" not in q.path:
            v = interval(model, q.path, FITTED)
            if q.path in told:  # with ends that are better known; of all training trials the value is another
                one, half = told[q.path], 0.5 * (v.high - v.low)
                low, high = (WIDER * d for d in (one.value - one.low, one.high - one.value))
                low, high = v.value - max(half, low), v.value + max(half, high)
                v = replace(v, low=max(q.low, low), high=min(q.high, high))
            fitted[q.path] = FittedValue(v.value, v.unit, v.low, v.high)
    # values that were given and held, which the case has otherwise
    held = [p for p in model.values if p not in fitted and p not in found.case.tied and ".numerics[" not in p]
    fitted |= {p: FittedValue(float(model.values[p])) for p in held}
    every = with_ties(found.case.tied, {**model.values, **model.own[0]})
    fitted |= {name: FittedValue(every[name]) for name in found.case.tied}
    effects = effects_of(found.repaired.candidates, found.law)
    if found.case.path is not None:
        beside = os.path.relpath(found.case.path.resolve(), directory.resolve())
        values = {p: float(v.value) for p, v in fitted.items()}
        text = PROGRAM.format(name=found.case.name, path=beside, effects=effects, values=values, held=held)
        (directory / "repaired.py").write_text(text, encoding="utf-8")
        paths.append(directory / "repaired.py")
    names = [one.name for one in found.training]
    simpler = stored(found.case.simpler([found.case.part(one) for one in found.training]))
    paths.append(Fitted(found.case.name, fitted, names, {"effects": effects}, simpler).save(directory))
    return paths
