"""`check_term`: whether a term keeps the contract, and whether what it claims is true."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from rodnet.errors import RodnetError
from rodnet.graph.material import Material, circular, elliptic
from rodnet.graph.rod_graph import RodGraph
from rodnet.graph.stick_figure import StickFigure
from rodnet.parameters import Parameter
from rodnet.robot import Robot
from rodnet.terms.base import Term
from rodnet.testing.bound import check_bound, check_steps
from rodnet.testing.laws import check_law
from rodnet.testing.report import ContractError, Report

CLAIMS = ("dissipative", "objective", "conservative")
KINDS = ("energy", "drag", "load", "actuator", "constraint", "contact", "term")
# where a term is put that says nothing of its own or names rods that the test graphs do not have
PLACES = ("*", "rod:2", "rod:1-2")
HELD = ("rod.start", "rod:0-1")


def check_term(
    term: Term | type[Term],
    *,
    graph: RodGraph | None = None,
    seed: int = 0,
    states: int = 2,
    rtol: float = 1e-6,
    speed: float = 0.1,
    dt: float = 1e-3,
    duration: float = 1.0,
    sensors: Mapping[str, Any] | None = None,
) -> Report:
    """Check a term against the contract of terms, at random states far from rest.

    Whatever the term: parameters have units and sensible bounds and null values, results are finite,
    of the right shape and repeatable, arguments are left alone, nothing is read from ``self`` that
    varies, the assembled Jacobian is the derivative of the forces, and a few steps of a simulation
    converge and can be repeated from a restored state bit for bit. By kind: forces of energies are
    their derivatives; sites are independent of each other; given derivatives and compiled twins
    agree with the law; memory is committed with a step only; commands are finite; constraints are
    smooth in time and their orientations are rotations. By claim: ``"dissipative"``: no power goes
    into the robot; ``"objective"``: forces turn with the robot; ``"conservative"``: the Jacobian is
    symmetric.

    Parameters
    ----------
    term : Term or Term class
        An instance, or a class, which is made with its declared defaults and its class attribute
        ``example``. A class that needs ``at=`` or ``on=`` gets a suitable place, and an instance
        whose selectors name rods that the test graphs lack is moved.
    graph : RodGraph, optional
        Where to check it. By default on a curved rod and on a network with a joint of three edges
        and a stiff part; both have a rod ``"rod"`` of at least 3 edges of about 2 cm that starts at
        the origin along x.
    seed : int
        Seed of the random states.
    states : int
        Random states per graph.
    rtol : float
        Allowed error of derivatives, relative to the largest entry; ten times as much where the
        framework differences the law itself.
    speed : float
        Typical speed at which the term is evaluated [m/s].
    dt, duration : float
        Time step of the simulation, and the time over which constraints are checked [s].
    sensors : mapping, optional
        Readings that an actuator's command finds.

    Returns
    -------
    Report
        The checks with their largest errors; print it.

    Raises
    ------
    ContractError
        If a check fails; it is both a `rodnet.TermError` and an ``AssertionError``, and says which
        check, which argument, the largest error and the remedy.
    """
    cls = term if isinstance(term, type) else type(term)
    if not issubclass(cls, Term):
        raise ContractError(f"check_term needs a rodnet term or a class of terms, got {term!r}")
    report = Report(f"check_term({cls.__name__})")
    check_declarations(cls, report)
    readings = MappingProxyType(dict(sensors or {}))
    graphs = [graph] if graph is not None else [curved_rod(), network()]
    for k, where in enumerate(graphs):
        placed = place(term, where, report)
        rng = np.random.default_rng([seed, k])
        if k == 0:
            check_law(placed, report, rng, rtol, speed, duration, readings)
        for _ in range(states):
            check_bound(placed, where, report, rng, rtol, speed, readings)
        check_steps(placed, where, report, rng, speed, dt, readings)
    return report


def check_declarations(cls: type[Term], report: Report) -> None:
    """Check what a class declares: parameters, claims, kind."""
    for name, p in cls.declared().items():
        culprit = f"parameter '{name}'"
        report.demand(
            "declarations", bool(p.unit) and isinstance(p.unit, str), f"{culprit} has no unit",
            "Give unit=, in SI; \"1\" for a ratio.",
        )  # fmt: skip
        low, high = p.bounds
        report.demand(
            "declarations",
            low < high,
            f"{culprit} has the bounds {p.bounds}",
            "The lower one must be smaller.",
        )
        report.demand(
            "declarations", p.null is None or low <= p.null <= high,
            f"{culprit} has the null value {p.null}, outside its bounds {p.bounds}", "Widen the bounds.",
        )  # fmt: skip
        report.demand(
            "declarations", p.kind in ("strength", "shape"), f"{culprit} has the kind {p.kind!r}",
            "It is \"strength\" or \"shape\".",
        )  # fmt: skip
        hidden = [b for b in cls.__mro__ if name in vars(b) and not isinstance(vars(b)[name], Parameter)]
        taken = bool(hidden) or name in ("name", "on", "at")
        report.demand(
            "declarations", not taken, f"{culprit} hides an attribute of {hidden[0].__name__ if hidden else 'Term'}",
            "Choose another name.",
        )  # fmt: skip
    unknown = sorted(set(cls.claims) - set(CLAIMS))
    report.demand(
        "declarations",
        not unknown,
        f"it claims {', '.join(map(repr, unknown))}",
        f"Claims are {', '.join(CLAIMS)}.",
    )
    report.demand(
        "declarations", cls.kind in KINDS, f"its kind is {cls.kind!r}", f"Kinds are {', '.join(KINDS)}."
    )


def place(term: Term | type[Term], graph: RodGraph, report: Report) -> Term:
    """Return an instance that binds to a graph: as it is, or at the first place that suits it."""
    problems: list[str] = []
    for where in (None, *(HELD if term.kind == "constraint" else PLACES)):
        try:
            instance = _made(term, where) if isinstance(term, type) else _moved(term, where)
            Robot(graph, [instance])
        except (RodnetError, TypeError) as error:
            problems.append(str(error))
        except KeyError as error:
            problems.append(
                f"it needs {error}, but at binding there are no sensor readings: use sensors.get(name, 0.0)"
            )
        else:
            return instance
    name = term.__name__ if isinstance(term, type) else type(term).__name__
    report.demand(
        "placement", False, f"it cannot be made and bound: {' | '.join(dict.fromkeys(problems))}",
        f"For a class with required arguments give the class attribute {name}.example, a dictionary of arguments, "
        "or pass an instance; for one that only suits certain robots pass graph=.",
    )  # fmt: skip
    raise AssertionError


def _made(cls: type[Term], where: str | None) -> Term:
    if where is None:
        return cls(**cls.example)
    # before Python 3.11.3 the signature of a class is that of its __new__
    takes = inspect.signature(cls.__init__).parameters
    return cls(**{**cls.example, "at" if "at" in takes else "on": where})


def _moved(term: Term, where: str | None) -> Term:
    if where is None:
        return term
    other: Any = copy.copy(term)
    other.on = [where]
    for name, value in (("at", where), ("between", None), ("edge", None)):
        if hasattr(other, name):
            setattr(other, name, value)
    return other


def curved_rod() -> RodGraph:
    """A curved elliptic rod of uneven edges whose natural shape is straight."""
    steps = np.array([[20, 0, 0], [17, 6, 2], [21, 11, -3], [13, 15, 5], [18, 16, 9], [10, 20, 3]]) * 1e-3
    points = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    figure = StickFigure()
    figure.rod(
        "rod", list(points), material=Material(E=1e7), section=elliptic(5e-3, 4e-3), natural="straight"
    )
    return figure.build()


def network() -> RodGraph:
    """A joint of a rod, a thinner arm drawn towards it, and a stiff part."""
    figure = StickFigure()
    figure.rod(
        "rod", [(0, 0, 0), (0.02, 0, 0), (0.041, 0.006, 0), (0.058, 0.006, 0.008)],
        material=Material(E=1e7), section=circular(5e-3),
    )  # fmt: skip
    figure.rod(
        "arm",
        [(0.08, 0.05, 0.02), (0.073, 0.027, 0.02), "rod.end"],
        material=Material(E=2e7, nu=0.3),
        radius=3e-3,
    )
    figure.rigid("head", ["rod.end", (0.075, -0.005, 0.03), (0.09, -0.01, 0.05)], mass=0.02)
    return figure.build()
