"""The library of unnamed laws: what a remainder is described by, a placebo drawn from, and a flexible force made of.

Forces per length that depend on velocity, place and time on parts of the body (`rodnet.LocalLaw`) or in one place
(`rodnet.LocalPatch`), currents of a medium that differ from place to place and pulse (`rodnet.UnevenFlow`), moments
that depend on curvature, its direction and its rate on rods, drag that depends on neighbours, and lenses of cameras.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from rodnet.diagnosis.bank.making import soft_rods
from rodnet.diagnosis.bank.neighbours import crowd, crowdable, reaches
from rodnet.diagnosis.candidate import Candidate
from rodnet.diagnosis.measures import PART, Measures
from rodnet.errors import CaseError, RodnetError
from rodnet.parameters import Parametrised
from rodnet.recordings.observation import Markers
from rodnet.robot import Robot
from rodnet.terms.base import Term
from rodnet.terms.dissipation import KelvinVoigt
from rodnet.terms.drag.crowding import CrowdedForce
from rodnet.terms.drag.local_flow import LocalFlow
from rodnet.terms.drag.local_law import LocalLaw
from rodnet.terms.drag.local_patch import LocalPatch
from rodnet.terms.drag.uneven import LATER, STEADY, UnevenFlow
from rodnet.terms.local.cubic import CubicBending
from rodnet.terms.local.natural import NaturalCurvature
from rodnet.terms.local.section import SectionStiffness

LAW = "local-law"  # id of a drafted law
EYE = "eye"  # kind of pieces that are about a camera
BODY = "law-body"  # name of forces that are alike all along
PARTS = 3  # of a single rod
PULSES = 12  # half periods in a trial that a current may have, at most
PATCHES = 8  # in which there may be a current or a force of its own, about that many, along the rods
PATCH = 0.3  # of a rod's length: how wide
CREEP = 0.1  # of the slowest speed that matters: where a force that does not depend on the rate fades
FORCES = tuple(name for name in LocalLaw.declared() if name != "creep")
CLASSES: dict[str, type[Parametrised]] = {
    "force": LocalLaw, "patch": LocalPatch, "flow": UnevenFlow, "eddy": LocalFlow, "damping": KelvinVoigt,
    "hardening": CubicBending, "natural": NaturalCurvature, "section": SectionStiffness, "crowd": CrowdedForce,
    EYE: Markers,
}  # fmt: skip
# of the places and times of the recordings: where a model is far off, no law that other loads and starts would meet
OF_THE_SCENE = tuple(p for p in FORCES if p == "later" or p[0] in "hkm")
IN_A_PATCH = ("linear", "gx", "gy", "gz")  # what holds and what pulls there
SIMPLE = ("linear", "along", "square", "rate_free", "gx", "gy", "gz")  # what placebos are made of
SECTION = tuple(SectionStiffness.declared())
MOMENTS = {
    "damping": ("bend",),
    "hardening": ("hardening",),
    "natural": ("kappa1", "kappa2"),
    "section": SECTION,
}


@dataclass(frozen=True)
class Piece:
    """A term of the library, on a part of the body.

    Or, of kind ``"crowd"``, a law of the robot that gets neighbours; or, of kind ``"eye"``, the lens of a camera.

    Attributes
    ----------
    kind : str
        Of `CLASSES`.
    name : str
        Of the term, of the law, or of the instrument.
    on : tuple of str
        Selectors.
    options : mapping
        What else the term is made with.
    parameters : tuple of str
        Names of those that are its strengths.
    """

    kind: str
    name: str
    on: tuple[str, ...]
    options: Mapping[str, float]
    parameters: tuple[str, ...]

    @property
    def paths(self) -> tuple[str, ...]:
        """Paths of the strengths."""
        return tuple(f"{self.name}.{p}" for p in self.parameters)

    @property
    def shape(self) -> dict[str, float]:
        """Values of what is searched with them, by path: a frequency, a time, where a patch is and how wide."""
        return {f"{self.name}.{p}": v for p, v in self.options.items() if p != "creep"}

    def term(self) -> Term:
        """Make the term, without any effect."""
        made = CLASSES[self.kind](on=list(self.on), name=self.name, **self.options)  # type: ignore[call-arg]
        assert isinstance(made, Term)
        return made

    def on_robot(self, robot: Robot) -> Robot | None:
        """Return a robot with the term, without any effect; None if it cannot have it."""
        if self.kind == EYE:
            return robot
        if self.kind == "crowd":
            return crowd(robot, self.name, self.options["range"])
        if any(term.name == self.name for term in robot.terms):
            return None
        return robot.with_terms(self.term())

    def to_dict(self) -> dict[str, Any]:
        """Return it as JSON takes it."""
        return {
            "kind": self.kind, "name": self.name, "on": list(self.on), "options": dict(self.options),
            "parameters": list(self.parameters),
        }  # fmt: skip

    @classmethod
    def from_dict(cls, given: Mapping[str, Any]) -> Piece:
        """Return the piece that `to_dict` described.

        Raises
        ------
        CaseError
            If it is none.
        """
        try:
            if given["kind"] not in CLASSES:
                raise KeyError(given["kind"])
            return cls(
                given["kind"], str(given["name"]), tuple(given["on"]), dict(given["options"]),
                tuple(given["parameters"]),
            )  # fmt: skip
        except (KeyError, TypeError) as error:
            raise CaseError(f"a fitted model has a law in it that cannot be read: {error}") from None


def parts_of(robot: Robot) -> dict[str, list[str]]:
    """Parts of the body that get forces of their own, as selectors: its rods, or thirds of a single one."""
    rods = soft_rods(robot)
    if len(rods) != 1:
        return {rod.name: [rod.name] for rod in rods}
    rod = rods[0]
    count = rod.names - 1
    ends = np.unique(np.linspace(0, count, min(PARTS, count) + 1).astype(int))
    return {
        f"{rod.name} {a / count:.2g}-{b / count:.2g}": [f"{rod.name}:{k}-{k + 1}" for k in range(a, b)]
        for a, b in pairwise(ends)
    }


def pieces(robot: Robot, duration: float) -> list[Piece]:
    """All terms of the library that a robot can have together."""
    speed = Measures.of(robot, duration).speed
    found = [
        Piece("force", f"law-{k}", tuple(on), {"creep": CREEP * speed}, FORCES)
        for k, on in enumerate(parts_of(robot).values())
    ]
    found.append(Piece("flow", "law-flow", ("*",), {}, STEADY))
    for number, rod in enumerate(soft_rods(robot)):
        found += [
            Piece(kind, f"law-{kind}-{number}", (rod.name,), {}, names) for kind, names in MOMENTS.items()
        ]
    return [piece for piece in found if _fits(robot, piece)]


def body(robot: Robot, duration: float) -> list[Piece]:
    """Forces that follow one law all along the rods: their parts would have it several times over."""
    if len(parts_of(robot)) < 2:
        return []
    options = {"creep": CREEP * Measures.of(robot, duration).speed}
    piece = Piece("force", BODY, tuple(rod.name for rod in soft_rods(robot)), options, FORCES)
    return [piece] if _fits(robot, piece) else []


def crowds(robot: Robot) -> list[Piece]:
    """Laws that get neighbours: no current flows about them, so a law has either."""
    found = []
    for law in crowdable(robot):
        if near := reaches(robot, robot.graph.edge_indices(law.on)):
            found.append(Piece("crowd", law.name, (), {"range": near[len(near) // 2]}, ("crowding",)))
    return [piece for piece in found if _fits(robot, piece)]


def searched(robot: Robot, duration: float) -> list[Piece]:
    """Terms that are nowhere linear in all that describes them, one for each of some values of the rest.

    Currents that pulse, at frequencies that trials of some length can tell apart, and currents and forces in patches
    along the rods. A law has one of them at most.
    """
    found = [
        Piece("flow", f"law-pulse-{k}", ("*",), {"frequency": 0.5 * k / duration}, (*STEADY, *LATER))
        for k in range(1, PULSES + 1)
    ]
    patches: list[Piece] = []
    rods, creep = soft_rods(robot), CREEP * Measures.of(robot, duration).speed
    on = tuple(rod.name for rod in rods)
    for number, rod in enumerate(rods):
        count = max(PATCHES // len(rods), 2)
        x = robot.graph.x0[rod.nodes]
        for k, at in enumerate(np.linspace(0, len(x) - 1, 2 * count + 1)[1::2]):
            middle = dict(zip("xyz", x[round(at)].tolist(), strict=True))
            options = {**middle, "width": PATCH * rod.length}
            found.append(Piece("eddy", f"law-eddy-{number}-{k}", ("*",), options, STEADY))
            options = {**options, "creep": creep}
            patches.append(Piece("patch", f"law-patch-{number}-{k}", on, options, IN_A_PATCH))
    return [*(found if _fits(robot, found[0]) else []), *patches]  # the others act on the medium


def simple(given: Iterable[Piece]) -> list[Piece]:
    """Loads and resistances alone."""
    return [
        replace(piece, parameters=tuple(p for p in piece.parameters if p in SIMPLE))
        for piece in given
        if piece.kind == "force"
    ]


def _fits(robot: Robot, piece: Piece) -> bool:
    from rodnet.solve.model import Model

    try:
        built = piece.on_robot(robot)
        if built is not None:
            Model(built)
    except RodnetError:
        return False
    return built is not None


def law_of(given: Iterable[Piece], scales: Mapping[str, float] | None = None, name: str = LAW) -> Candidate:
    """Return the candidate that adds pieces; their parameters, or with ``scales`` those in it, are its strengths."""
    given = tuple(given)
    if not given:
        raise CaseError("a law needs a term: this robot has no rod that bends")
    paths = tuple(p for piece in given for p in piece.paths)
    strength = paths if scales is None else tuple(p for p in paths if p in scales)
    patches = {
        f"{p.name}.{axis}": p.options["width"] for p in given if p.kind in ("eddy", "patch") for axis in "xyz"
    }
    seen = {path: (value,) for p in given if p.kind == EYE for path, value in p.shape.items()}
    return Candidate(
        id=name, title="a law without a name, drafted from what was left", group="medium",
        build=partial(_with, pieces=given), strength=strength, shape=tuple(p for piece in given for p in piece.shape),
        falsifier="it was fitted to what nothing else explained: it is no cause, and need not hold elsewhere",
        scale=_scale if scales is None else partial(_given, scales={p: scales[p] for p in strength} | patches),
        bank=partial(_middles, middles=seen) if seen else None, observe=bool(seen),
    )  # fmt: skip


def _with(robot: Robot, pieces: Sequence[Piece]) -> Robot | None:
    built: Robot | None = robot
    for piece in pieces:
        built = None if built is None else piece.on_robot(built)
    return built


def _given(robot: Robot, duration: float, scales: Mapping[str, float]) -> dict[str, float]:
    return dict(scales)


def _middles(
    robot: Robot, duration: float, middles: Mapping[str, tuple[float, ...]]
) -> dict[str, tuple[float, ...]]:
    """Where the columns of a lens are told."""
    return dict(middles)


def _scale(robot: Robot, duration: float) -> dict[str, float]:
    """Changes of coefficients that are worth considering: what makes a small part of the force that bends a rod."""
    m = Measures.of(robot, duration)
    line = PART * m.force / m.length  # N/m
    by_unit = {
        "N/m": line, "N/m/s": line / m.time, "N/m^2": line / m.length, "N s/m^2": line / m.speed,
        "N s^2/m^3": line / m.speed**2,
        "N s/m^3": line / m.speed / m.length, "m/s": PART * m.speed, "1/s": PART / m.time, "s": 0.01 * m.time,
        "m^2": 0.1 * m.length**2, "1/m": PART / m.length, "1": PART,
    }  # fmt: skip
    return {
        path: by_unit[p.unit]
        for path, p in robot.parameters.items()
        if (path.startswith("law-") or path.endswith(".crowding")) and p.unit in by_unit
    }
