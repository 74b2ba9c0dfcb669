"""What is installed: built-in terms and robots, and those of plug-ins (entry points).

A plug-in is a package that names its classes in ``pyproject.toml``::

    [project.entry-points."rodnet.terms"]
    quadratic = "rodnet_quadratic:Quadratic"

Groups: ``rodnet.terms`` (`Term` classes), ``rodnet.candidates`` (further explanations that a diagnosis
may try), ``rodnet.robots`` (functions that return a `Robot`; a function's attribute ``metrics``, if it has
one, evaluates a trajectory). Nothing is imported before it is asked for, and a plug-in that cannot be
loaded is reported by a `RuntimeWarning` and left out.
"""

from __future__ import annotations

import difflib
import importlib
import inspect
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from types import MappingProxyType
from typing import Any

from rodnet.errors import RodnetError
from rodnet.parameters import Parameter, Parametrised

KINDS = ("energy", "drag", "load", "contact", "actuator", "constraint")

# id -> module and class; the ids that reports use
_TERMS = {
    "stretching": "rodnet.terms.energies:Stretching",
    "bending": "rodnet.terms.energies:Bending",
    "midframe-bending": "rodnet.terms.midframe:MidframeBending",
    "twisting": "rodnet.terms.energies:Twisting",
    "joint-elasticity": "rodnet.terms.joints:JointElasticity",
    "stiffness-defect": "rodnet.terms.local.stiffness:StiffnessDefect",
    "stiffness-gradient": "rodnet.terms.local.stiffness:StiffnessGradient",
    "stiffness-profile": "rodnet.terms.local.stiffness:StiffnessProfile",
    "section-stiffness": "rodnet.terms.local.section:SectionStiffness",
    "natural-curvature": "rodnet.terms.local.natural:NaturalCurvature",
    "earlier-set": "rodnet.terms.local.earlier:EarlierSet",
    "balanced-start": "rodnet.terms.local.earlier:BalancedStart",
    "natural-angle": "rodnet.terms.local.natural:NaturalAngle",
    "joint-compliance": "rodnet.terms.local.joints:JointCompliance",
    "cubic-bending": "rodnet.terms.local.cubic:CubicBending",
    "resistive-force": "rodnet.terms.drag.resistive:ResistiveForce",
    "granular-force": "rodnet.terms.drag.granular:GranularForce",
    "power-law-force": "rodnet.terms.drag.nonlinear:PowerLawForce",
    "bingham-force": "rodnet.terms.drag.nonlinear:BinghamForce",
    "plane-wall-force": "rodnet.terms.drag.walls:PlaneWallForce",
    "tube-force": "rodnet.terms.drag.walls:TubeForce",
    "crowded-force": "rodnet.terms.drag.crowding:CrowdedForce",
    "local-law": "rodnet.terms.drag.local_law:LocalLaw",
    "local-patch": "rodnet.terms.drag.local_patch:LocalPatch",
    "power-law-change": "rodnet.terms.drag.changes:PowerLawChange",
    "drag-region": "rodnet.terms.drag.changes:DragRegion",
    "drag-gradient": "rodnet.terms.drag.changes:DragGradient",
    "wall-drag": "rodnet.terms.drag.changes:WallDrag",
    "switched-drag": "rodnet.terms.drag.changes:SwitchedDrag",
    "drag-anisotropy": "rodnet.terms.drag.changes:DragAnisotropy",
    "background-flow": "rodnet.terms.drag.changes:BackgroundFlow",
    "uneven-flow": "rodnet.terms.drag.uneven:UnevenFlow",
    "local-flow": "rodnet.terms.drag.local_flow:LocalFlow",
    "spin-drag": "rodnet.terms.drag.spin:SpinDrag",
    "maxwell-medium": "rodnet.terms.drag.maxwell:MaxwellMedium",
    "stokes-head": "rodnet.terms.drag.stokes:StokesHead",
    "kelvin-voigt": "rodnet.terms.dissipation:KelvinVoigt",
    "mass-damping": "rodnet.terms.dissipation:MassDamping",
    "dry-friction": "rodnet.terms.friction:DryFriction",
    "plastic-set": "rodnet.terms.local.creep:PlasticSet",
    "gravity": "rodnet.terms.loads:Gravity",
    "point-force": "rodnet.terms.loads:PointForce",
    "point-torque": "rodnet.terms.loads:PointTorque",
    "tether": "rodnet.terms.tether:Tether",
    "added-mass": "rodnet.terms.added_mass:AddedMass",
    "mass-gradient": "rodnet.terms.local.masses:MassGradient",
    "local-mass": "rodnet.terms.local.masses:LocalMass",
    "consistent-mass": "rodnet.terms.consistent_mass:ConsistentMass",
    "plane-contact": "rodnet.terms.contact.walls:PlaneContact",
    "tube-contact": "rodnet.terms.contact.walls:TubeContact",
    "rod-contact": "rodnet.terms.contact.rods:RodContact",
    "elastic-wall": "rodnet.terms.contact.elastic_wall:ElasticWall",
    "follower-force": "rodnet.terms.follower:FollowerForce",
    "motor": "rodnet.terms.actuators:Motor",
    "dc-motor": "rodnet.terms.drives:DCMotor",
    "slow-curvature": "rodnet.terms.drives:SlowCurvature",
    "tendon": "rodnet.terms.tendons:Tendon",
    "curvature-wave": "rodnet.terms.actuators:CurvatureWave",
    "clamp": "rodnet.terms.constraints:Clamp",
    "hinge": "rodnet.terms.constraints:Hinge",
    "prescribed-motion": "rodnet.terms.constraints:PrescribedMotion",
    "grasp": "rodnet.terms.constraints:Grasp",
    "imperfect-motion": "rodnet.terms.imperfect:ImperfectMotion",
    "imperfect-grasp": "rodnet.terms.imperfect:ImperfectGrasp",
    "slider": "rodnet.terms.slider:Slider",
}
_ROBOTS = {"flagellated": "rodnet.robots.flagellated:flagellated"}
_CANDIDATES = {
    "yield": "rodnet.diagnosis.bank.media:yield_stress",
    "medium-friction": "rodnet.diagnosis.bank.media:friction",
    "power-law": "rodnet.diagnosis.bank.media:power_law",
    "anisotropy": "rodnet.diagnosis.bank.media:anisotropy",
    "drag-region": "rodnet.diagnosis.bank.media:drag_region",
    "depth": "rodnet.diagnosis.bank.media:depth",
    "wall": "rodnet.diagnosis.bank.media:wall",
    "obstacle": "rodnet.diagnosis.bank.media:obstacle",
    "viscoelastic-medium": "rodnet.diagnosis.bank.media:viscoelastic",
    "neighbours": "rodnet.diagnosis.bank.neighbours:neighbours",
    "jam-onset": "rodnet.diagnosis.bank.media:jam_onset",
    "flow": "rodnet.diagnosis.bank.media:flow",
    "axial-drag": "rodnet.diagnosis.bank.media:axial_drag",
    "viscous-drag": "rodnet.diagnosis.bank.media:viscous_drag",
    "gravity": "rodnet.diagnosis.bank.loads:gravity",
    "buoyancy": "rodnet.diagnosis.bank.loads:buoyancy",
    "added-mass": "rodnet.diagnosis.bank.loads:added_mass",
    "tether": "rodnet.diagnosis.bank.loads:tether",
    "local-mass": "rodnet.diagnosis.bank.rods:local_mass",
    "mass-damping": "rodnet.diagnosis.bank.rods:mass_damping",
    "stiffness-defect": "rodnet.diagnosis.bank.rods:stiffness_defect",
    "stiffness-gradient": "rodnet.diagnosis.bank.rods:stiffness_gradient",
    "stiffness-profile": "rodnet.diagnosis.bank.rods:stiffness_profile",
    "natural-curvature": "rodnet.diagnosis.bank.rods:natural_curvature",
    "natural-shape": "rodnet.diagnosis.bank.rods:natural_shape",
    "natural-twist": "rodnet.diagnosis.bank.rods:natural_twist",
    "kink": "rodnet.diagnosis.bank.rods:kink",
    "earlier-set": "rodnet.diagnosis.bank.rods:earlier_set",
    "balanced-start": "rodnet.diagnosis.bank.rods:balanced_start",
    "nonlinear-elasticity": "rodnet.diagnosis.bank.rods:nonlinear",
    "kelvin-voigt": "rodnet.diagnosis.bank.rods:kelvin_voigt",
    "plastic-set": "rodnet.diagnosis.bank.rods:plastic_set",
    "dry-friction": "rodnet.diagnosis.bank.rods:dry_friction",
    "held-friction": "rodnet.diagnosis.bank.rods:held_friction",
    "mass-gradient": "rodnet.diagnosis.bank.rods:mass_gradient",
    "joint-compliance": "rodnet.diagnosis.bank.joints:joint_compliance",
    "root-compliance": "rodnet.diagnosis.bank.joints:root_compliance",
    "root-direction": "rodnet.diagnosis.bank.joints:root_direction",
    "grasp-twist": "rodnet.diagnosis.bank.joints:grasp_twist",
    "drive-gain": "rodnet.diagnosis.bank.actuators:gain",
    "drive-lag": "rodnet.diagnosis.bank.actuators:lag",
    "motor-droop": "rodnet.diagnosis.bank.actuators:droop",
    "tendon-friction": "rodnet.diagnosis.bank.actuators:tendon_friction",
    "grasp-offset": "rodnet.diagnosis.bank.actuators:grasp_offset",
    "marker-offset": "rodnet.diagnosis.bank.instruments:marker_offset",
    "marker-place": "rodnet.diagnosis.bank.instruments:marker_place",
    "marker-slip": "rodnet.diagnosis.bank.instruments:marker_slip",
    "camera-scale": "rodnet.diagnosis.bank.instruments:camera_scale",
    "camera-rotation": "rodnet.diagnosis.bank.instruments:camera_rotation",
    "camera-shift": "rodnet.diagnosis.bank.instruments:camera_shift",
    "record-lag": "rodnet.diagnosis.bank.instruments:record_lag",
}
_UNNAMED = (
    "local-law",
    "section-stiffness",
    "local-patch",
    "uneven-flow",
    "local-flow",
)  # parts of placebos and drafted laws, no candidates
_NUMERICAL = {"consistent-mass"}  # terms that vanish, but explain nothing
_BUILT_IN = {"rodnet.terms": _TERMS, "rodnet.robots": _ROBOTS, "rodnet.candidates": _CANDIDATES}
_NOUNS = {"rodnet.terms": "term", "rodnet.robots": "robot", "rodnet.candidates": "candidate"}


class RegistryError(RodnetError, LookupError):
    """Nothing of that name is installed."""


@dataclass(frozen=True)
class Record:
    """Something that is installed.

    Attributes
    ----------
    id : str
        Its fixed name, e.g. ``"resistive-force"``.
    object : type or callable
        The class of a term or candidate; the function that makes a robot.
    kind : str
        ``"energy"``, ``"drag"``, ``"load"``, ``"contact"``, ``"actuator"``, ``"constraint"``, ``"candidate"`` or
        ``"robot"``.
    parameters : tuple of Parameter
        What it declares: name, unit, default value, bounds, null value, doc.
    source : str
        Where the law comes from (paper, equation).
    distribution : str
        The package that it comes from, with its version.
    summary : str
        First line of its docstring.
    """

    id: str
    object: Any
    kind: str
    parameters: tuple[Parameter, ...]
    source: str
    distribution: str
    summary: str

    @property
    def name(self) -> str:
        """What a term is called if nobody names it: the first part of its parameters' paths."""
        return getattr(self.object, "default_name", "") or getattr(self.object, "__name__", self.id).lower()

    @property
    def arguments(self) -> list[str]:
        """What its constructor takes besides parameters and a name."""
        if not (isinstance(self.object, type) and issubclass(self.object, Parametrised)):
            return []
        return [k for k in self.object.arguments() if k != "name" and k not in self.object.declared()]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON; an open bound is None."""
        finite = lambda bound: bound if abs(bound) != float("inf") else None  # noqa: E731
        owner = self.object if hasattr(self.object, "__qualname__") else type(self.object)
        told = {k: getattr(self.object, k) for k in ("group", "falsifier") if self.kind == "candidate"}
        return {
            "id": self.id,
            "class": f"{owner.__module__}.{owner.__qualname__}",
            "kind": self.kind,
            "name": self.name,
            "arguments": self.arguments,
            "summary": self.summary,
            "source": self.source,
            "distribution": self.distribution,
            **told,
            "parameters": [
                {
                    "name": p.name,
                    "unit": p.unit,
                    "default": p.value if p.value is None or isinstance(p.value, float) else p.value.tolist(),
                    "bounds": [finite(b) for b in p.bounds],
                    "null": p.null,
                    "kind": p.kind,
                    "doc": p.doc,
                }
                for p in self.parameters
            ],
        }


def terms() -> Mapping[str, Record]:
    """Every energy, drag law, load, contact, actuator and constraint that is installed, by id."""
    return _all("rodnet.terms")


def robots() -> Mapping[str, Record]:
    """Every robot that is installed, by id."""
    return _all("rodnet.robots")


def candidates() -> Mapping[str, Record]:
    """What a diagnosis can try, by id: candidates, and terms that vanish at a null value and belong to none of them."""
    found = _all("rodnet.candidates")
    covered = {cls for r in found.values() for cls in getattr(r.object, "terms", ())}
    vanishing = {
        k: r
        for k, r in terms().items()
        if r.object not in covered
        and k not in found
        and k not in (*_NUMERICAL, *_UNNAMED)
        and _vanishes(r.object)
    }
    return MappingProxyType({**found, **vanishing})


def _vanishes(cls: type) -> bool:
    """Whether a term can be added everywhere, needing nothing but the null values of its strengths."""
    nulls = {k: p.null for k, p in cls.declared().items() if p.null is not None and p.kind == "strength"}  # type: ignore[attr-defined]
    try:
        cls(**nulls)
    except (RodnetError, TypeError):
        return False
    return bool(nulls) and all(cls.declared()[k].value is not None for k in nulls)  # type: ignore[attr-defined]


def term(name: str) -> type:
    """Return the class of a term by its id, e.g. ``rn.term("resistive-force")``.

    Raises
    ------
    RegistryError
        If there is none of that name; lists what there is, close matches first.
    """
    return _find("rodnet.terms", name).object


def robot(name: str) -> Callable[..., Any]:
    """Return the function that makes a robot, by its id, e.g. ``"flagellated"``.

    Raises
    ------
    RegistryError
        If there is none of that name; lists what there is, close matches first.
    """
    return _find("rodnet.robots", name).object


def providers() -> set[str]:
    """Top-level modules of what is installed: rodnet's own, and those of plug-ins."""
    points = (p for group in _BUILT_IN for p in _entry_points(group).values())
    return {"rodnet", *(p.module.partition(".")[0] for p in points)}


def id_of(cls: type) -> Record | None:
    """Return the record of a class of terms; None if it is not registered."""
    return next((record for record in terms().values() if record.object is cls), None)


# -- finding and loading ------------------------------------------------------------------
@cache
def _entry_points(group: str) -> Mapping[str, EntryPoint]:
    """Entry points of a group by name, not loaded; the built-ins and then the first package keep a name."""
    found: dict[str, EntryPoint] = {}
    taken = {name: "rodnet" for name in _BUILT_IN[group]}
    for point in sorted(entry_points(group=group), key=lambda p: (p.name, _package(p), p.value)):
        if point.name in found and found[point.name].value == point.value:
            continue  # one package, found twice on the path
        if point.name in taken:
            _warn(
                f"the {_NOUNS[group]} '{point.name}' of {_package(point)} is left out: "
                f"{taken[point.name]} has one of that name"
            )
            continue
        found[point.name], taken[point.name] = point, _package(point)
    return MappingProxyType(found)


@cache
def _load(group: str, name: str) -> Record | None:
    """Load one record; None, with a warning, if it is a plug-in that cannot be loaded."""
    built_in = _BUILT_IN[group].get(name)
    if built_in is not None:
        module, _, attribute = built_in.partition(":")
        import rodnet

        return _record(
            group, name, getattr(importlib.import_module(module), attribute), f"rodnet {rodnet.__version__}"
        )
    point = _entry_points(group)[name]
    try:
        return _record(group, name, _checked(group, name, point.load()), _package(point))
    except (Exception, SystemExit) as error:  # whatever a stranger's module does when it is imported
        _warn(
            f"the {_NOUNS[group]} '{name}' of {_package(point)} is left out, {point.value} cannot be loaded: "
            f"{type(error).__name__}: {error}"
        )
        return None


@cache
def _all(group: str) -> Mapping[str, Record]:
    records = [_load(group, name) for name in (*_BUILT_IN[group], *_entry_points(group))]
    return MappingProxyType({r.id: r for r in records if r is not None})


def _find(group: str, name: str) -> Record:
    known = (*_BUILT_IN[group], *_entry_points(group))
    record = _load(group, name) if name in known else None
    if record is not None:
        return record
    noun, there = _NOUNS[group], list(_all(group))
    close = difflib.get_close_matches(str(name).lower().replace("_", "-"), there, n=3)
    hint = f"did you mean {' or '.join(map(repr, close))}? " if close else ""
    raise RegistryError(f"no {noun} is called {name!r}; {hint}Installed are {', '.join(there)}.")


def _checked(group: str, name: str, found: Any) -> Any:
    if group == "rodnet.terms":
        from rodnet.terms.base import Term

        if not (isinstance(found, type) and issubclass(found, Term)):
            raise TypeError(f"{found!r} is not a subclass of rodnet.Term")
        if found.kind not in KINDS:
            raise TypeError(f"its kind is {found.kind!r}; kinds are {', '.join(KINDS)}")
    elif group == "rodnet.candidates":
        from rodnet.diagnosis.candidate import as_family

        return as_family(name, found)
    elif not callable(found):
        raise TypeError(f"{found!r} cannot be called")
    return found


def _record(group: str, name: str, found: Any, distribution: str) -> Record:
    if group == "rodnet.candidates":
        parameters = *found.strength, *found.shape
        return Record(name, found, "candidate", parameters, "", distribution, found.title)
    declared = found.declared() if isinstance(found, type) and issubclass(found, Parametrised) else {}
    kind = found.kind if group == "rodnet.terms" else _NOUNS[group]
    summary = (inspect.getdoc(found) or "").partition("\n")[0]
    source = getattr(found, "source", "")
    return Record(name, found, kind, tuple(declared.values()), source, distribution, summary)


def _package(point: EntryPoint) -> str:
    return f"{point.dist.name} {point.dist.version}" if point.dist is not None else "an unknown package"


def _warn(message: str) -> None:
    warnings.warn(message, RuntimeWarning, stacklevel=2)
