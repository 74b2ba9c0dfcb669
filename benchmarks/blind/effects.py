"""Effects that a model may leave out: what they are, how strong, where, and by what name they are known.

The list of effects is that of ``rodnet terms --candidates``; their laws are written down anew here and in the engines,
with sharp steps where a diagnosis has smooth ones, and other regularisations.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.blind.robots import Machine

Draw = Callable[[np.random.Generator, Machine], dict[str, Any]]
EVERY = ("shaken", "spatial", "branched")
SINGLE = ("shaken", "spatial")


@dataclass(frozen=True)
class Effect:
    """One kind of effect.

    Parameters
    ----------
    id : str
        Of the engines.
    right : tuple of str
        Ids of the candidates that name it; empty outside the bank.
    strength : str
        The parameter that is scaled until the effect is as large as asked for.
    draw : callable
        ``draw(rng, machine)``: parameters, the strength being a first guess.
    most : float
        Largest admissible strength (absolute value).
    families : tuple of str
        Machines that can have it.
    acts : str
        ``"rods"``, ``"gripper"`` or ``"camera"``: what is changed.
    place : float or None
        How exactly its place must be told, over the rod's length.
    onset : bool
        Whether the time of its beginning must be told.
    regime : str or None
        What the effect depends on: speed, curvature, spacing, depth, time.
    asked : mapping
        Candidates' parameters and what they are called here, whose intervals must cover the truth: those that mean
        the same. ``"u.0"`` is the first component, ``"-g"`` of the other sign; ``"term.name"`` is a term's.
    engine : str
        ``"elastica"`` or ``"finer"``.
    concealable : bool
        Whether it can be seen where it is weak, or the markers are away from it.
    twins : tuple of str
        Ids of candidates by which the same motion comes about: no drive tells them apart, and a class of these alone is
        right.
    alike_on : mapping
        Likewise, by the family of machines on which it is so.
    """

    id: str
    right: tuple[str, ...]
    strength: str
    draw: Draw
    most: float
    families: tuple[str, ...] = EVERY
    acts: str = "rods"
    place: float | None = None
    onset: bool = False
    regime: str | None = None
    asked: Mapping[str, str] = field(default_factory=dict)
    engine: str = "elastica"
    concealable: bool = True
    twins: tuple[str, ...] = ()
    alike_on: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def twins_on(self, family: str) -> tuple[str, ...]:
        """Ids of its twins on a family of machines."""
        return (*self.twins, *self.alike_on.get(family, ()))


def _fixed(**values: Any) -> Draw:
    return lambda rng, machine: dict(values)


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _direction(rng: np.random.Generator, machine: Machine) -> np.ndarray:
    v = rng.normal(size=3)
    if machine.family == "shaken":
        v[1] = 0.0
    return v / np.linalg.norm(v)


def _two(rng: np.random.Generator, machine: Machine) -> list[float]:
    """A direction across a rod; of a machine in the plane, in it."""
    if machine.family == "shaken":
        return [0.0, _sign(rng)]
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return [float(np.cos(angle)), float(np.sin(angle))]


def _across(rng: np.random.Generator, machine: Machine, size: float) -> list[float]:
    """A bending strain, in the plane of a plane machine."""
    if machine.family == "shaken":
        return [size * _sign(rng), 0.0]
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return [size * float(np.cos(angle)), size * float(np.sin(angle))]


BANK = (
    Effect(
        "yield", ("yield", "medium-friction", "grain-yield"), "force", _fixed(force=5e-3), 0.2, regime="speed",
    ),
    Effect(
        "power-law", ("power-law",), "deviation", lambda rng, m: {"deviation": -0.25, "speed": 0.05}, 0.6,
        regime="speed", asked={"exponent": "exponent"},
    ),
    Effect("anisotropy", ("anisotropy",), "along", _fixed(along=0.5), 3.0, asked={"along": "along"}, concealable=False),
    Effect(
        "drag-region", ("drag-region",), "gain",
        lambda rng, m: {"gain": 2.0, "place": float(rng.uniform(0.3, 0.85)), "width": float(rng.uniform(0.06, 0.12))},
        12.0, place=0.05, asked={"place": "place"}, families=SINGLE,
    ),
    Effect("depth", ("depth",), "gradient", lambda rng, m: {"gradient": 2.0 * _sign(rng)}, 8.0, regime="depth"),
    Effect(
        "wall", ("wall",), "reach", lambda rng, m: {"reach": 0.02, "height": float(rng.uniform(0.005, 0.03))}, 2.0,
        regime="depth", asked={"reach": "reach", "position": "-height"},
    ),
    Effect(
        "obstacle", ("obstacle",), "stiffness",
        lambda rng, m: {"stiffness": 2.0, "height": float(rng.uniform(0.2, 0.6))}, 500.0, regime="depth",
        asked={"stiffness": "stiffness", "position": "-height"},
    ),
    Effect(
        "memory", ("viscoelastic-medium",), "modulus", _fixed(modulus=1.0, time=0.5), 40.0,
        asked={"modulus": "modulus", "time": "time"},
    ),
    Effect(
        "jam-onset", ("jam-onset",), "gain",
        lambda rng, m: {"gain": 0.8, "onset": float(rng.uniform(1.2, 2.6))}, 6.0, onset=True, regime="time",
        asked={"onset": "onset", "gain": "gain"},
    ),
    Effect(
        "jam-spacing", ("neighbours",), "gain", lambda rng, m: {"gain": 1.0, "spacing": 0.25 * m.arms[0].length}, 40.0,
        families=("branched",), regime="spacing",
    ),
    Effect(
        "flow", ("flow",), "speed", lambda rng, m: {"speed": 5e-3, "along": _direction(rng, m)}, 0.1,
        asked={"u_x": "u.0", "u_z": "u.2"},
    ),
    Effect("gravity", ("gravity", "buoyancy"), "g", _fixed(g=0.05), 2.0, asked={"weight-z.g": "g"}),
    Effect(
        "tether", ("tether",), "stiffness",
        lambda rng, m: {"stiffness": 0.1, "place": float(rng.uniform(0.5, 0.8)), "to": 0.05 * _direction(rng, m)},
        5.0, place=0.1, asked={"place": "place", "stiffness": "stiffness"}, families=SINGLE,
    ),
    Effect(
        "local-mass", ("local-mass",), "mass", lambda rng, m: {"mass": 3e-3, "place": float(rng.uniform(0.4, 0.95))},
        5e-2, place=0.1, asked={"place": "place", "mass": "mass"}, families=SINGLE,
    ),
    Effect(
        "stiffness-defect", ("stiffness-defect",), "loss",
        lambda rng, m: {"loss": 0.5, "place": float(rng.uniform(0.15, 0.7)), "width": float(rng.uniform(0.03, 0.06))},
        0.9, place=0.1, asked={"place": "place"}, families=SINGLE,
    ),
    Effect(
        "mass-gradient",
        ("mass-gradient",),
        "slope",
        lambda rng, m: {"slope": 0.6 * _sign(rng)},
        1.6,
        asked={"slope": "slope"},
        families=SINGLE,
    ),
    Effect(
        "stiffness-gradient", ("stiffness-gradient",), "slope", lambda rng, m: {"slope": 0.4 * _sign(rng)}, 1.4,
        asked={"slope": "slope"}, families=SINGLE,
    ),
    Effect(
        "natural-curvature", ("natural-curvature",), "size",
        lambda rng, m: {"size": 0.15, "kappa": _across(rng, m, 1.0)}, 6.0, families=SINGLE,
    ),
    Effect(
        "natural-twist", ("natural-twist",), "twist", lambda rng, m: {"twist": 0.5 * _sign(rng)}, 15.0,
        families=("spatial",),
    ),
    Effect(
        "kink", ("kink",), "size",
        lambda rng, m: {
            "size": 0.5, "kappa": _across(rng, m, 1.0), "place": float(rng.uniform(0.2, 0.8)),
            "width": float(rng.uniform(0.02, 0.05)),
        },
        20.0, place=0.1, asked={"place": "place"}, families=SINGLE,
    ),
    Effect(
        "nonlinear-elasticity", ("nonlinear-elasticity",), "hardening", _fixed(hardening=4e-3), 5e-2,
        regime="curvature", asked={"hardening": "hardening"},
    ),
    Effect(
        "root-compliance", ("root-compliance",), "length", _fixed(length=8e-3), 0.08, asked={"length": "length"},
    ),
    Effect(
        "root-direction", ("root-direction",), "angle",
        lambda rng, m: {"angle": 0.03 * _sign(rng), "axis": [0.0, 1.0, 0.0]}, 0.4,
    ),
    # a straight rod that is twisted by nature turns its branches as one that is turned in its grip does
    Effect(
        "grasp-twist", ("grasp-twist",), "angle", lambda rng, m: {"angle": 0.05 * _sign(rng), "axis": [1.0, 0.0, 0.0]},
        1.2, families=("spatial", "branched"), alike_on={"branched": ("natural-twist",)},
    ),
    Effect(
        "grasp-offset", ("grasp-offset",), "size", lambda rng, m: {"size": 4e-3, "along": _direction(rng, m)}, 0.05,
        asked={"shift_x": "shift.0", "shift_z": "shift.2"},
    ),
    Effect("drive-gain", ("drive-gain",), "gain", lambda rng, m: {"gain": 0.03 * _sign(rng)}, 0.4, acts="gripper"),
    # what has no clock but its gripper is as late, whether the gripper or the recorder is
    Effect("drive-lag", ("drive-lag",), "lag", _fixed(lag=0.02), 0.3, acts="gripper", twins=("record-lag",)),
    Effect(
        "record-lag", ("record-lag",), "lag", _fixed(lag=0.02), 0.3, acts="camera", asked={"lag": "lag"},
        twins=("drive-lag",),
    ),
    Effect(
        "camera-scale", ("camera-scale",), "excess", lambda rng, m: {"excess": 0.02 * _sign(rng)}, 0.2, acts="camera",
        asked={"scale": "scale"},
    ),
    Effect(
        "camera-shift", ("camera-shift",), "size", lambda rng, m: {"size": 3e-3, "along": _direction(rng, m)}, 0.05,
        acts="camera",
    ),
    Effect(
        "camera-rotation", ("camera-rotation",), "angle",
        lambda rng, m: {"angle": 0.02, "axis": [0.0, 1.0, 0.0]}, 0.3, acts="camera",
    ),
    Effect(
        "marker-offset", ("marker-offset",), "offset", lambda rng, m: {"offset": 2e-3, "across": _two(rng, m)}, 0.03,
    ),
    Effect("axial-drag", ("axial-drag",), "viscosity", _fixed(viscosity=5.0), 500.0, families=("spatial",)),
    Effect(
        "misplaced-marker", ("marker-place",), "along",
        lambda rng, m: {"along": 3e-3, "marker": int(rng.integers(1, 4))}, 4e-2, acts="camera",
        asked={"misplaced": "along"},
    ),
    Effect(
        "slipping-marker", ("marker-slip",), "speed", lambda rng, m: {"speed": 2e-3, "marker": int(rng.integers(1, 4))},
        3e-2, acts="camera", asked={"drift": "speed"},
    ),
)  # fmt: skip

FINER = (
    Effect(
        "kelvin-voigt", ("kelvin-voigt",), "bend", _fixed(bend=0.05), 2.0, engine="finer", asked={"bend": "bend"},
    ),
    Effect(
        "dry-friction", ("dry-friction",), "moment", _fixed(moment=1e-4, curvature=0.3), 5e-3, engine="finer",
    ),
    Effect(
        "plastic-set", ("plastic-set",), "share", _fixed(share=0.3, time=1.5), 0.9, engine="finer",
        asked={"share": "share", "time": "time"},
    ),
    Effect(
        "added-mass", ("added-mass",), "density", _fixed(density=500.0), 5e3, engine="finer",
        asked={"density": "density"},
    ),
    Effect(
        "joint-compliance", ("joint-compliance",), "length", _fixed(length=8e-3), 0.2, families=("branched",),
        engine="finer", asked={"length": "length"},
    ),
    Effect(
        "neighbours", ("neighbours",), "crowding", lambda rng, m: {"crowding": 0.5, "range": 0.25 * m.arms[0].length},
        3.0, families=("branched",), regime="spacing", engine="finer",
    ),
    Effect(
        "motor-droop", ("motor-droop",), "droop", _fixed(droop=1e4), 1e7, families=("spun",), engine="finer",
    ),
    Effect(
        "motor-lag", ("drive-lag",), "lag", _fixed(lag=0.1), 2.0, families=("spun",), engine="finer",
        asked={"lag": "lag"},
    ),
    Effect(
        "tendon-friction", ("tendon-friction",), "friction", _fixed(friction=0.1), 2.0, families=("tendon",),
        engine="finer", asked={"friction": "friction"},
    ),
)  # fmt: skip

OUTSIDE = (
    Effect(
        "rope", (), "stiffness",
        lambda rng, m: {
            "stiffness": 0.5, "place": float(rng.uniform(0.5, 0.8)), "to": 0.06 * _direction(rng, m), "length": 0.07,
        },
        50.0, families=SINGLE,
    ),
    Effect("shear-flow", (), "rate", _fixed(rate=0.2, pulse=1.5), 5.0),
    Effect(
        "magnet", (), "force",
        lambda rng, m: {"force": 1e-2 * _sign(rng), "at": m.arms[0].length * np.array([0.8, 0.0, 0.35])}, 0.5,
    ),
    Effect("lens", (), "excess", _fixed(excess=0.05), 0.4, acts="camera"),
    Effect(
        "puddle", (), "gain",
        lambda rng, m: {
            "gain": 2.0, "at": m.arms[0].length * np.array([0.75, 0.0, 0.12]), "radius": 0.2 * m.arms[0].length,
        },
        40.0,
    ),
    Effect("flat", (), "excess", _fixed(excess=0.3), 6.0, families=("spatial", "branched")),
    Effect("swirl", (), "rate", lambda rng, m: {"rate": 0.2, "at": m.arms[0].length * np.array([0.6, 0.0, 0.1])}, 6.0),
)  # fmt: skip

EFFECTS = {effect.id: effect for effect in (*BANK, *FINER, *OUTSIDE)}
# of the bank, that of which a refit of the nominal parameters hides a third or more (measured; the others look like no
# such change at all)
ABSORBED = (
    "drag-region", "jam-onset", "yield", "power-law", "wall", "memory", "jam-spacing", "local-mass", "stiffness-defect",
    "mass-gradient", "stiffness-gradient", "nonlinear-elasticity", "root-compliance",
)  # fmt: skip
# of the bank, what another one is easily mistaken for where a rod is only shaken: a weight for a current, ...
MISTAKEN = (
    "gravity", "flow", "yield", "power-law", "natural-curvature", "natural-twist", "grasp-twist", "root-direction",
    "grasp-offset", "camera-shift", "camera-rotation", "camera-scale", "drive-gain", "local-mass", "mass-gradient",
    "stiffness-gradient", "root-compliance",
)  # fmt: skip


def in_engine_terms(id: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters as an engine takes them: directions and sizes multiplied, deviations from null added."""
    values = dict(values)
    if id == "power-law":
        values["exponent"] = 1.0 + values.pop("deviation")
    elif id == "flow":
        values["u"] = values.pop("speed") * np.asarray(values.pop("along"))
    elif id in ("grasp-offset", "camera-shift"):
        values["shift"] = values.pop("size") * np.asarray(values.pop("along"))
    elif id == "camera-scale":
        values["scale"] = 1.0 + values["excess"]
    elif id == "marker-offset":
        values["offset"] = values["offset"] * np.asarray(values.pop("across"))
    elif id in ("natural-curvature", "kink"):
        values["kappa"] = values.pop("size") * np.asarray(values["kappa"])
    return values


def asked(id: str, values: Mapping[str, Any]) -> dict[str, float]:
    """True values of the candidates' parameters that mean the same."""
    there, found = in_engine_terms(id, values), {}
    for theirs, own in EFFECTS[id].asked.items():
        name, _, component = own.removeprefix("-").partition(".")
        value = float(there[name][int(component)] if component else there[name])
        found[theirs] = -value if own.startswith("-") else value
    return found
