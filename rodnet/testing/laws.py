"""Checks of local laws by themselves: pure functions of sites and parameters, kind by kind."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType, SimpleNamespace
from typing import Any

import numpy as np

from rodnet.terms.actuators import Actuator
from rodnet.terms.base import Term
from rodnet.terms.constraints import Constraint
from rodnet.terms.drag.line import DragModel
from rodnet.terms.energies import EnergyModel
from rodnet.terms.loads import LoadModel, NodeSites
from rodnet.testing.drag_laws import check_drag_law
from rodnet.testing.pure import SITES, check_pure, check_shape, check_sites, frozen, identical, relative
from rodnet.testing.report import Report
from rodnet.testing.states import STEP
from rodnet.testing.taylor import differences


def check_law(
    term: Term,
    report: Report,
    rng: np.random.Generator,
    rtol: float,
    speed: float,
    duration: float,
    sensors: Mapping[str, Any],
) -> None:
    """Check the local law of a term, whatever its kind."""
    if isinstance(term, DragModel):
        check_drag_law(term, report, rng, rtol, speed)
    elif isinstance(term, LoadModel):
        _check_load(term, report, rng, speed)
    elif isinstance(term, EnergyModel):
        _check_energy_law(term, report, rng, rtol)
    elif isinstance(term, Actuator):
        _check_actuator(term, report, rng, sensors)
    elif isinstance(term, Constraint):
        _check_constraint(term, report, duration)


# -- loads ---------------------------------------------------------------------------------
def _check_load(term: LoadModel, report: Report, rng: np.random.Generator, speed: float) -> None:
    def sites() -> NodeSites:
        return NodeSites(
            rng.normal(size=(SITES, 3)),
            speed * rng.normal(size=(SITES, 3)),
            rng.uniform(0.5, 2.0, SITES) * 1e-3,
            rng.uniform(0.5, 2.0, SITES) * 1e-6,
            0.3,
            1e-2,
        )

    site, p = sites(), term.values()
    value = check_pure(report, term, "force", (site, p), (sites(), p))
    f = check_shape(report, "force()", value, (SITES, 3))
    still = replace(site, v=np.zeros((SITES, 3)))
    check_shape(report, "force() at rest", term.force(frozen(still), p), (SITES, 3))
    check_sites(report, lambda s, q: np.asarray(term.force(s, q)), site, p, f)
    if term.dead:
        moved = term.force(
            frozen(replace(site, x=rng.normal(size=(SITES, 3)), v=rng.normal(size=(SITES, 3)))), p
        )
        report.demand(
            "dead load", identical(f, moved), "it declares dead = True, but depends on position or velocity",
            "Drop dead = True, so that the framework differentiates the load.",
        )  # fmt: skip


# -- energies ------------------------------------------------------------------------------
def _check_energy_law(term: EnergyModel, report: Report, rng: np.random.Generator, rtol: float) -> None:
    key, size = {"stretch": ("eps", 0.3), "curvature": ("kappa", 20.0), "twist": ("tau", 20.0)}[term.strain]
    shape = (SITES, 2) if key == "kappa" else (SITES,)

    def sites() -> SimpleNamespace:
        r = rng.uniform(2e-3, 5e-3, SITES)
        stiff = 1e6 * np.pi / 4.0 * r**4
        site = SimpleNamespace(
            EA=1e6 * np.pi * r**2, EI1=stiff, EI2=1.3 * stiff, GJ=0.7 * stiff, length=4.0 * r
        )
        setattr(site, key, np.ascontiguousarray(size * rng.uniform(-1.0, 1.0, shape)))
        return site

    def densities(strain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        value = term.psi(frozen(SimpleNamespace(**{**vars(site), key: strain.reshape(shape)})), p)
        return np.asarray(value[0], dtype=float), np.asarray(value[1], dtype=float)

    site, p = sites(), term.values()
    result = check_pure(report, term, "psi", (site, p), (sites(), p))
    report.demand(
        "shapes", isinstance(result, tuple) and len(result) == 3, "psi() does not return three values",
        "Return the energy density and its first and second derivative by the strain.",
    )  # fmt: skip
    check_shape(report, "psi()[0]", result[0], (SITES,))
    first = check_shape(report, "psi()[1]", result[1], shape)
    second = np.asarray(result[2], dtype=float)
    full = second.ndim == 3
    second = check_shape(report, "psi()[2]", second, (SITES, 2, 2) if full else shape)
    if key == "kappa":
        second = second if full else second[:, :, None] * np.eye(2)
    else:
        second = second[:, None, None]
    rest = term.psi(frozen(SimpleNamespace(**{**vars(site), key: np.zeros(shape)})), p)
    for k, part in enumerate(rest):
        report.demand(
            "finite",
            bool(np.all(np.isfinite(part))),
            f"psi()[{k}] is not finite without strain",
            "Guard roots.",
        )
    flat, steps = getattr(site, key).ravel(), np.full(SITES * second.shape[1], STEP * size)
    slope = np.einsum(
        "iik->ik", differences(lambda y: densities(y)[0], flat, steps).reshape(SITES, SITES, -1)
    )
    report.require(
        "psi: first derivative", relative(first.reshape(SITES, -1), slope), rtol,
        f"psi()[1] is not the derivative of psi()[0] by {key}", "Differentiate psi again.",
    )  # fmt: skip
    k = int(second.shape[1])
    slope = differences(lambda y: densities(y)[1].ravel(), flat, steps).reshape(SITES, k, SITES, k)
    report.require(
        "psi: second derivative", relative(second, np.einsum("iaib->iab", slope)), rtol,
        f"psi()[2] is not the derivative of psi()[1] by {key}", "Differentiate psi again.",
    )  # fmt: skip
    check_sites(report, lambda s, q: np.asarray(term.psi(s, q)[0]), site, p, np.asarray(result[0]))
    check_sites(report, lambda s, q: np.asarray(term.psi(s, q)[1]), site, p, first)


# -- actuators -----------------------------------------------------------------------------
def _check_actuator(
    term: Actuator, report: Report, rng: np.random.Generator, sensors: Mapping[str, Any]
) -> None:
    p, readings = term.values(), dict(sensors)
    if term.drives == "curvature":
        readings["s"] = frozen(np.sort(rng.uniform(0.0, 0.1, SITES)))
    view = MappingProxyType(readings)
    for t in (0.0, 0.37, 12.5):
        try:
            value = check_pure(report, term, "command", (t, view, p), (t + 0.1, view, p))
        except KeyError as missing:
            report.demand(
                "sensors", False, f"command() reads the sensor {missing}",
                f"Tell check_term what it may read there: sensors={{{missing}: 1.0}}.",
            )  # fmt: skip
        shape = np.shape(value)
        allowed = [(2,), (SITES, 2)] if term.drives == "curvature" else [()]
        report.demand(
            "shapes", shape in allowed, f"command() returns the shape {shape} at t = {t:g} s",
            f"drives = {term.drives!r} needs {'curvatures (2,) or (n, 2)' if len(allowed) == 2 else 'one number'}.",
        )  # fmt: skip
        report.demand(
            "finite", bool(np.all(np.isfinite(np.asarray(value, dtype=float)))),
            f"command() is not finite at t = {t:g} s", "Guard divisions and roots.",
        )  # fmt: skip


# -- constraints ---------------------------------------------------------------------------
def _check_constraint(term: Constraint, report: Report, duration: float) -> None:
    p = term.values()
    x0 = np.array([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0]])
    try:
        term.position(0.0, x0, p)
    except ValueError:  # a constraint of a single node
        x0 = x0[:1]
    t = 0.41 * duration
    value = check_pure(report, term, "position", (t, x0, p), (0.5 * t, x0, p))
    check_shape(report, "position()", value, x0.shape, "Return one row for each row of x0.")
    motions = {"position": lambda t: np.asarray(term.position(t, frozen(x0), p), dtype=float)}
    if "orientation" in term.holds:
        check_pure(report, term, "orientation", (t, p), (0.5 * t, p))
        motions["orientation"] = lambda t: np.asarray(term.orientation(t, p), dtype=float)
        for s in np.linspace(0.0, duration, 7):
            R = check_shape(
                report, "orientation()", term.orientation(s, p), (3, 3), "Return a rotation matrix."
            )
            error = float(np.abs(R @ R.T - np.eye(3)).max()) + abs(float(np.linalg.det(R)) - 1.0)
            report.require(
                "rotation", error, 1e-9, f"orientation({s:g}) is no rotation",
                "Return a matrix with R @ R.T = 1 and det R = 1, e.g. rodnet.kinematics.frames.rotation(vector).",
            )  # fmt: skip
    for name, motion in motions.items():
        coarse, fine = (_largest_acceleration(motion, duration, n) for n in (200, 800))
        jumps = fine / coarse if fine * duration**2 > 1e-6 else 1.0
        report.require(
            f"smooth {name}", jumps, 2.5,
            f"the acceleration of {name}() grows without bound as time is resolved more finely: a corner or a jump",
            "Round it off, e.g. with rodnet.smooth_motion; if it is only a fast motion, pass a shorter duration=.",
        )  # fmt: skip


def _largest_acceleration(motion: Callable[[float], np.ndarray], duration: float, count: int) -> float:
    h = duration / count
    x = np.array([motion(k * h) for k in range(count + 1)])
    return max(float(np.abs(x[2:] - 2.0 * x[1:-1] + x[:-2]).max()) / h**2, 1e-300)
