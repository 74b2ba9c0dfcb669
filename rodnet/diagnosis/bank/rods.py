"""Candidates about rods: stiffness, natural shape, losses and mass that differ from what the model has."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from rodnet.diagnosis.bank.making import SHARE, Added, places, soft_rods
from rodnet.diagnosis.candidate import Candidate, Family, add_terms
from rodnet.diagnosis.measures import PART, Measures
from rodnet.graph.rod_graph import Rod
from rodnet.parameters import Parameter
from rodnet.recordings.observation import Observation
from rodnet.robot import Robot
from rodnet.terms.dissipation import KelvinVoigt, MassDamping
from rodnet.terms.drag.resistive import ResistiveForce
from rodnet.terms.friction import DryFriction
from rodnet.terms.local.creep import PlasticSet
from rodnet.terms.local.cubic import CubicBending
from rodnet.terms.local.earlier import BalancedStart, EarlierSet
from rodnet.terms.local.masses import LocalMass, MassGradient
from rodnet.terms.local.natural import NaturalCurvature
from rodnet.terms.local.stiffness import StiffnessDefect, StiffnessGradient, StiffnessProfile

BENDS = 5  # of a natural shape, side by side, at most
HELD = "held-friction"  # id of the friction of strands
STRAINED = 1e-6  # [rad] from edge to edge at the start, beyond which a rod is not as drawn
BEND = 0.6  # half width of each, over their distance


def _where(robot: Robot, duration: float, on: str) -> dict[str, tuple[float, ...]]:
    return {"place": places(robot, duration, on)["place"]}


def _curvature(robot: Robot, duration: float, on: str) -> dict[str, float]:
    size = PART / robot.graph.rods[on].length
    return {"kappa1": size, "kappa2": size}


def _twist(robot: Robot, duration: float, on: str) -> dict[str, float]:
    return {"twist": PART / robot.graph.rods[on].length}


def _kink(robot: Robot, on: str) -> dict[str, float]:
    rod = robot.graph.rods[on]
    edge = float(robot.graph.rest_length[rod.edges].max() / rod.length)
    return {"place": 0.5, "width": min(max(0.03, 0.7 * edge), 1.0)}


def _damped(robot: Robot, on: str) -> bool:
    """Whether the model has no Kelvin-Voigt damping of its own, which one more could not be told from."""
    return not any(isinstance(t, KelvinVoigt) and (t.bend.value or t.twist.value) for t in robot.terms)


def _one_viscosity(robot: Robot, on: str) -> Mapping[str, Any]:
    time = Parameter(
        0.0, unit="s", bounds=(0, None), null=0.0, doc="retardation time, viscosity over modulus"
    )
    return {"stretch": time, "bend": time, "torsion": 1.0}


def _presliding(robot: Robot, on: str) -> dict[str, float]:
    size = 0.3 / Measures.of(robot, 1.0).length
    return {"curvature": size, "twist": size}


def _preslidings(robot: Robot, duration: float, on: str) -> dict[str, tuple[float, ...]]:
    size = 1.0 / Measures.of(robot, duration).length
    return {"curvature": (0.1 * size, size)}


def _times(robot: Robot, duration: float, on: str) -> dict[str, tuple[float, ...]]:
    return {"time": (0.1 * duration, duration)}


def _hardening(robot: Robot, duration: float, on: str) -> dict[str, float]:
    return {"hardening": 0.1 * Measures.of(robot, duration).length ** 2}


stiffness_defect = Added(
    id="stiffness-defect",
    title="a soft (or stiff) spot of a rod",
    group="rod",
    falsifier="the rod bends more sharply at that place, by the same factor in every trial, whatever the load",
    cls=StiffnessDefect,
    strength=("loss",),
    shape=("place", "width", "twist"),
    options={"loss": 0.0},
    known={"twist": SHARE},  # a notch weakens bending more than twisting, a thin place both
    rods=True,
    bank=places,
    place="place",
).family()

stiffness_gradient = Added(
    id="stiffness-gradient",
    title="a stiffness that changes along a rod",
    group="rod",
    falsifier="hung by the other end the rod takes another shape",
    cls=StiffnessGradient,
    strength=("slope",),
    shape=("twist",),
    options={"slope": 0.0},
    known={"twist": SHARE},
    rods=True,
).family()

stiffness_profile = Added(
    id="stiffness-profile",
    title="a stiffness that varies along a rod",
    group="rod",
    falsifier="the rod bends more sharply at the same places in every trial, in proportion to the moment there",
    cls=StiffnessProfile,
    strength=("half", "whole", "three", "twice"),
    rods=True,
).family()

natural_curvature = Added(
    id="natural-curvature",
    title="a natural curvature that was not drawn",
    group="rod",
    falsifier="the rod is bent without any load, and the bend turns with the rod when it is turned about its axis",
    cls=NaturalCurvature,
    strength=("kappa1", "kappa2"),
    rods=True,
    scale=_curvature,
).family()


def _shaped(robot: Robot, instruments: Sequence[Observation]) -> Iterator[Candidate]:
    """Bends side by side: along each rod that is long enough to have several, and along all rods together."""
    rods = soft_rods(robot)
    made = {rod.name: _bends(rod) for rod in rods}
    for name, (parts, owners) in made.items():
        if len(rods) == 1 or len(parts) == BENDS:
            yield _bent(f"natural-shape@{name}", f"{natural_shape.title} ({name})", parts, owners)
    if len(rods) > 1:
        parts = tuple(part for own, _ in made.values() for part in own)
        owners = {term: rod for _, own in made.values() for term, rod in own.items()}
        yield _bent("natural-shape@all", f"{natural_shape.title}, on every rod its own", parts, owners)


Parts = tuple[tuple[type[NaturalCurvature], dict[str, Any]], ...]


def _bends(rod: Rod) -> tuple[Parts, dict[str, str]]:
    """Terms of the bends of a rod, as many as its mesh resolves, and the rod's name by theirs."""
    count = int(np.clip(len(rod.edges) // 2, 2, BENDS))
    names = [f"bend-{k + 1}@{rod.name}" for k in range(count)]
    parts = tuple(
        (NaturalCurvature, {"on": rod.name, "name": name, "place": float(s), "width": BEND / (count - 1)})
        for name, s in zip(names, np.linspace(0.0, 1.0, count), strict=True)
    )
    return parts, dict.fromkeys(names, rod.name)


def _bent(id: str, title: str, parts: Parts, owners: dict[str, str]) -> Candidate:
    return Candidate(
        id=id, title=title, group="rod", build=partial(add_terms, parts=parts),
        strength=tuple(f"{name}.{p}" for name in owners for p in ("kappa1", "kappa2")),
        falsifier=natural_shape.falsifier, scale=_Bends(tuple(owners.items())),
    )  # fmt: skip


@dataclass(frozen=True)
class _Bends:
    """Curvatures worth considering, of each bend; the rods by their names."""

    owners: tuple[tuple[str, str], ...]

    def __call__(self, robot: Robot, duration: float) -> dict[str, float]:
        sizes = {rod: _curvature(robot, duration, rod) for _, rod in self.owners}
        return {f"{name}.{p}": v for name, rod in self.owners for p, v in sizes[rod].items()}


natural_shape = Family(
    "natural-shape",
    "a natural shape: a curvature that varies along a rod",
    "rod",
    "the rod is bent without any load, here more and there less, and the shape turns with the rod",
    _shaped,
    tuple(NaturalCurvature.declared()[p] for p in ("kappa1", "kappa2")),
    (),
    (NaturalCurvature,),
)

natural_twist = Added(
    id="natural-twist",
    title="a natural twist that was not drawn",
    group="rod",
    falsifier="a free end turns about its axis as the rod is laid straight; nothing shows where a rod stays in a plane",
    cls=NaturalCurvature,
    strength=("twist",),
    rods=True,
    scale=_twist,
).family()

kink = Added(
    id="kink",
    title="a kink: a rod that is bent at one place without a load",
    group="rod",
    falsifier="the rod is bent at that place without any load, whichever way it hangs",
    cls=NaturalCurvature,
    strength=("kappa1", "kappa2"),
    shape=("place", "width"),
    rods=True,
    more=_kink,
    bank=places,
    scale=_curvature,
    place="place",
).family()


def _strained(robot: Robot) -> list[str]:
    """Rods that are not as drawn at the start."""
    from rodnet.solve.model import Model

    model = Model(robot)
    sizes = {rod.name: EarlierSet(on=rod.name, share=1.0).bind(model).offset for rod in soft_rods(robot)}
    return [name for name, offset in sizes.items() if np.abs(offset).max(initial=0.0) > STRAINED]


def _earlier(robot: Robot, instruments: Sequence[Observation]) -> Iterator[Candidate]:
    """Each rod that is not as drawn at the start by itself, and all of them, each with a share of its own."""
    rods = _strained(robot)
    for on in [[rod] for rod in rods] + ([rods] if len(rods) > 1 else []):
        where = on[0] if len(on) == 1 else "all"
        names = [f"earlier@{rod}" for rod in on]
        yield Candidate(
            id=f"earlier-set@{where}", title=f"{earlier_set.title} ({where})", group="rod",
            build=partial(add_terms, parts=tuple(
                (EarlierSet, {"on": rod, "name": name}) for rod, name in zip(on, names, strict=True)
            )),
            strength=tuple(f"{name}.share" for name in names), falsifier=earlier_set.falsifier,
        )  # fmt: skip


def _borne(robot: Robot, on: str) -> bool:
    """Whether rods are bent at the start, and loads on them that they could bear."""
    from rodnet.solve.statics import bearing_strains

    return bool(_strained(robot)) and bool(np.abs(bearing_strains(robot)).max(initial=0.0) > STRAINED)


earlier_set = Family(
    "earlier-set",
    "a rod that had taken on the shape in which it begins",
    "rod",
    "begun in another shape it comes back to that one, not to the one that it was drawn with",
    _earlier,
    (EarlierSet.declared()["share"],),
    (),
    (EarlierSet,),
)

balanced_start = Added(
    id="balanced-start",
    title="rods that bear their loads at the start as they would at rest",
    group="rod",
    falsifier="let go of in the shape in which it begins, it stays there",
    cls=BalancedStart,
    strength=("part",),
    fits=_borne,
).family()

nonlinear = Added(
    id="nonlinear-elasticity",
    title="bending that stiffens or softens with the curvature",
    group="rod",
    falsifier="small bends follow the model, large ones are off, in either direction alike and at any speed",
    cls=CubicBending,
    strength=("hardening",),
    options={"hardening": 0.0},
    scale=_hardening,
).family()

kelvin_voigt = Added(
    id="kelvin-voigt",
    title="internal damping of the rods' material",
    group="rod",
    falsifier="fast vibrations decay faster than slow ones, and in a vacuum, too",
    cls=KelvinVoigt,
    strength=("bend",),
    shape=("torsion",),
    known={"torsion": (1.0, 0.5)},  # one viscosity; strands along a rod lose less as they twist
    fits=_damped,
    more=_one_viscosity,
).family()

mass_damping = Added(
    id="mass-damping",
    title="damping in proportion to mass",
    group="medium",
    falsifier="all vibrations decay at one rate, and so does rigid motion",
    cls=MassDamping,
    strength=("rate",),
    options={"rate": 0.0},
    # a drag of its own that is viscous is that, too: more of it along rods than across them
    fits=lambda robot, on: not any(isinstance(term, ResistiveForce) for term in robot.terms),
).family()

plastic_set = Added(
    id="plastic-set",
    title="a rod that takes on the shape it is held in",
    group="rod",
    falsifier="the same pose is answered otherwise after the rod has been held bent for a while",
    cls=PlasticSet,
    strength=("share",),
    shape=("time",),
    options={"share": 0.0},
    bank=_times,
).family()

dry_friction = Added(
    id="dry-friction",
    title="dry friction inside the rods, with pre-sliding",
    group="rod",
    falsifier="the rod comes to rest in other shapes than its natural one, which depend on where it came from",
    cls=DryFriction,
    strength=("moment", "torque"),  # strands that slip as a rod bends need not rub as it twists, nor as much
    shape=("curvature",),
    more=_presliding,
    bank=_preslidings,
).family()


def _pulled(robot: Robot) -> DryFriction | None:
    """The term that says what strands pulled, of a model where they do not rub."""
    told = (t for t in robot.terms if isinstance(t, DryFriction) and t.pull and not t.rubs)
    return next(told, None)


def _with_held(robot: Robot) -> Robot | None:
    """The robot with the friction of these strands: what they pulled is another thing in every trial."""
    told = _pulled(robot)
    if told is None:
        return None
    options = {"name": HELD, "pull": told.pull, "moment": 0.0, **_presliding(robot, "")}
    return add_terms(robot, ((DryFriction, options),))


def _scanned(robot: Robot, duration: float) -> dict[str, tuple[float, ...]]:
    return {f"{HELD}.curvature": tuple(3.0 * v for v in _preslidings(robot, duration, "")["curvature"])}


def _held(robot: Robot, instruments: Sequence[Observation]) -> Iterator[Candidate]:
    if _pulled(robot) is not None:
        yield Candidate(
            id=HELD, title=held_friction.title, group="rod", build=_with_held, strength=(f"{HELD}.moment",),
            shape=(f"{HELD}.curvature",), falsifier=held_friction.falsifier, bank=_scanned,
        )  # fmt: skip


held_friction = Family(
    HELD,
    "dry friction of the strands that held the rods, at its limit when they let go",
    "rod",
    "the rods stop short of their natural shape towards the strands that were tight, however little these bent them",
    _held,
    (DryFriction.declared()["moment"],),
    (DryFriction.declared()["curvature"],),
    (DryFriction,),
)

mass_gradient = Added(
    id="mass-gradient",
    title="a mass per length that changes along a rod",
    group="rod",
    falsifier="the rod balances at another point than its middle",
    cls=MassGradient,
    strength=("slope",),
    options={"slope": 0.0},
    rods=True,
).family()

local_mass = Added(
    id="local-mass",
    title="a mass on a rod that the model lacks",
    group="load",
    falsifier="a heavy part sags more and swings later; its weight on a scale is the rod's and so much more",
    cls=LocalMass,
    strength=("mass",),
    shape=("place",),
    options={"mass": 0.0},
    rods=True,
    bank=_where,
    place="place",
).family()
