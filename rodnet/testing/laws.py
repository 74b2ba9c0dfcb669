"""Checks of local laws by themselves: pure functions of sites and parameters, kind by kind."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from types import MappingProxyType, SimpleNamespace
from typing import Any

import numpy as np

from rodnet.kinematics.frames import unit
from rodnet.parameters import Parameter
from rodnet.terms.actuators import Actuator
from rodnet.terms.base import Term
from rodnet.terms.constraints import Constraint
from rodnet.terms.drag.line import DragModel, LineSites
from rodnet.terms.energies import EnergyModel
from rodnet.terms.loads import LoadModel, NodeSites
from rodnet.testing.report import Report
from rodnet.testing.states import STEP, random_rotation
from rodnet.testing.taylor import differences

SITES = 7


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
        from rodnet.testing.drag_laws import check_drag_law

        check_drag_law(term, report, rng, rtol, speed)
    elif isinstance(term, LoadModel):
        _check_load(term, report, rng, speed)
    elif isinstance(term, EnergyModel):
        _check_energy_law(term, report, rng, rtol)
    elif isinstance(term, Actuator):
        _check_actuator(term, report, rng, sensors)
    elif isinstance(term, Constraint):
        _check_constraint(term, report, duration)


# -- what all laws share -------------------------------------------------------------------
def frozen(value: Any) -> Any:
    """A copy whose arrays are read-only: what a law gets to see."""
    if isinstance(value, np.ndarray):
        value = value.copy()
        value.flags.writeable = False
    elif is_dataclass(value):
        value = replace(value, **{f.name: frozen(getattr(value, f.name)) for f in fields(value)})  # type: ignore[type-var]
    elif isinstance(value, SimpleNamespace):
        value = SimpleNamespace(**{k: frozen(v) for k, v in vars(value).items()})
    return value


def rows(value: Any, index: np.ndarray) -> Any:
    """The sites at ``index`` of a site view or of per-site parameters."""
    if isinstance(value, np.ndarray) and value.ndim:
        return value[index]
    if is_dataclass(value):
        return replace(value, **{f.name: rows(getattr(value, f.name), index) for f in fields(value)})  # type: ignore[type-var]
    if isinstance(value, SimpleNamespace):
        return SimpleNamespace(**{k: rows(v, index) for k, v in vars(value).items()})
    return value


def columns(p: SimpleNamespace, sites: int) -> SimpleNamespace:
    """The same parameters as one value per site, shape (sites, 1)."""
    return SimpleNamespace(
        **{k: v if v is None or np.ndim(v) else np.full((sites, 1), float(v)) for k, v in vars(p).items()}
    )


def relative(a: np.ndarray, b: np.ndarray) -> float:
    """Largest difference relative to the largest entry; infinite for other shapes or values that are no numbers."""
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    if a.shape != b.shape or not (np.all(np.isfinite(a)) and np.all(np.isfinite(b))):
        return np.inf
    return float(np.abs(a - b).max(initial=0.0)) / max(float(np.abs(b).max(initial=0.0)), 1e-300)


def _snapshot(value: Any) -> Any:
    if isinstance(value, Parameter):
        return _snapshot(value.value)
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    if isinstance(value, dict):
        return {k: _snapshot(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_snapshot(v) for v in value]
    return value if isinstance(value, int | float | str | set | None) else id(value)


def check_pure(report: Report, term: Term, method: str, arguments: tuple[Any, ...], others: tuple[Any, ...]) -> Any:
    """Call a law repeatedly with read-only arguments; return its value for ``arguments``.

    It must not write to them, give the same value before and after a call with ``others``, leave
    its term alone, and take parameters from its argument, not from ``self``.
    """
    arguments, others = tuple(map(frozen, arguments)), tuple(map(frozen, others))
    remedy = f"{method}() must be a pure function of its arguments: nothing is stored in self, and arrays are copied to change them."
    before = _snapshot(vars(term))
    try:
        first = getattr(term, method)(*arguments)
        getattr(term, method)(*others)
        again = getattr(term, method)(*arguments)
    except ValueError as error:
        if "read-only" not in str(error):
            raise
        report.demand("purity", False, f"{method}() writes to its arguments", remedy)
    after = _snapshot(vars(term))
    changed = [k for k in after if k not in before or after[k] != before[k]]
    report.demand("purity", not changed, f"{method}() changes self.{', self.'.join(changed)}", remedy)
    report.demand("purity", _identical(first, again), f"{method}() gives another value the second time", remedy)
    other = copy.copy(term)
    for name, p in term.parameter_items():
        setattr(other, name, _elsewhere(p))
    value = getattr(other, method)(*arguments)
    report.demand(
        "purity", _identical(first, value), f"{method}() depends on a parameter of self rather than of its argument p",
        "Read p.name instead of self.name: p is what calibration and inputs change.",
    )  # fmt: skip
    return first


def _elsewhere(p: Parameter) -> Parameter:
    low, high = p.bounds
    for factor, shift in ((1.3, 0.1), (0.7, 0.0), (0.7, -0.1)):
        value = np.asarray(p.value) * factor + shift
        if np.all((value >= low) & (value <= high)):
            return p.with_value(value)
    return p


def _identical(a: Any, b: Any) -> bool:
    if isinstance(a, tuple | list):
        return len(a) == len(b) and all(map(_identical, a, b))
    return np.array_equal(np.asarray(a, dtype=float), np.asarray(b, dtype=float), equal_nan=True)


def check_shape(report: Report, what: str, value: Any, shape: tuple[int, ...], remedy: str = "") -> np.ndarray:
    """Return a value as an array, after checking its shape and that it is finite."""
    value = np.asarray(value)
    report.demand("shapes", value.shape == shape, f"{what} has the shape {value.shape}, not {shape}", remedy or
                  "Parameters may be scalars or of shape (n, 1); radius and length are (n,): site.radius[:, None].")  # fmt: skip
    report.demand(
        "finite", bool(np.all(np.isfinite(value.astype(float)))), f"{what} is not finite", "Guard divisions and roots."
    )
    return value.astype(float)


def check_sites(report: Report, law: Callable[[Any, Any], np.ndarray], site: Any, p: Any, value: np.ndarray) -> None:
    """Sites are independent: in another order, one by one, and with parameters given per site."""
    count = len(value)
    order = np.roll(np.arange(count)[::-1], 2)
    remedy = "Let each row of the result depend on its own row of the site and of p only (no sums or maxima over sites)."
    per_site = columns(p, count)
    error = relative(law(frozen(rows(site, order)), frozen(rows(per_site, order))), value[order])
    report.require("sites: permutation", error, 1e-12, "sites in another order, or p of shape (n, 1), change the result", remedy)
    for k in range(count):
        one = np.array([k])
        error = np.abs(law(frozen(rows(site, one)), p) - value[one]).max() / max(float(np.abs(value).max()), 1e-300)
        report.require("sites: one by one", error, 1e-12, f"site {k} alone gives another result than among others", remedy)


# -- loads ---------------------------------------------------------------------------------
def _check_load(term: LoadModel, report: Report, rng: np.random.Generator, speed: float) -> None:
    def sites() -> NodeSites:
        return NodeSites(
            rng.normal(size=(SITES, 3)), speed * rng.normal(size=(SITES, 3)), rng.uniform(0.5, 2.0, SITES) * 1e-3, 0.3, 1e-2
        )

    site, p = sites(), term.values()
    value = check_pure(report, term, "force", (site, p), (sites(), p))
    f = check_shape(report, "force()", value, (SITES, 3))
    still = replace(site, v=np.zeros((SITES, 3)))
    check_shape(report, "force() at rest", term.force(frozen(still), p), (SITES, 3))
    check_sites(report, lambda s, q: np.asarray(term.force(s, q)), site, p, f)
    if term.dead:
        moved = term.force(frozen(replace(site, x=rng.normal(size=(SITES, 3)), v=rng.normal(size=(SITES, 3)))), p)
        report.demand(
            "dead load", _identical(f, moved), "it declares dead = True, but depends on position or velocity",
            "Drop dead = True, so that the framework differentiates the load.",
        )  # fmt: skip


# -- energies ------------------------------------------------------------------------------
def _check_energy_law(term: EnergyModel, report: Report, rng: np.random.Generator, rtol: float) -> None:
    key, size = {"stretch": ("eps", 0.3), "curvature": ("kappa", 20.0), "twist": ("tau", 20.0)}[term.strain]
    shape = (SITES, 2) if key == "kappa" else (SITES,)

    def sites() -> SimpleNamespace:
        r = rng.uniform(2e-3, 5e-3, SITES)
        stiff = 1e6 * np.pi / 4.0 * r**4
        site = SimpleNamespace(EA=1e6 * np.pi * r**2, EI1=stiff, EI2=1.3 * stiff, GJ=0.7 * stiff, length=4.0 * r)
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
        report.demand("finite", bool(np.all(np.isfinite(part))), f"psi()[{k}] is not finite without strain", "Guard roots.")
    flat, steps = getattr(site, key).ravel(), np.full(SITES * second.shape[1], STEP * size)
    slope = np.einsum("iik->ik", differences(lambda y: densities(y)[0], flat, steps).reshape(SITES, SITES, -1))
    report.require(
        "psi: first derivative", relative(first.reshape(SITES, -1), slope), rtol,
        f"psi()[1] is not the derivative of psi()[0] by {key}", "Differentiate psi again.",
    )  # fmt: skip
    k = second.shape[1]
    slope = differences(lambda y: densities(y)[1].ravel(), flat, steps).reshape(SITES, k, SITES, k)
    report.require(
        "psi: second derivative", relative(second, np.einsum("iaib->iab", slope)), rtol,
        f"psi()[2] is not the derivative of psi()[1] by {key}", "Differentiate psi again.",
    )  # fmt: skip
    for part, value in ((0, result[0]), (1, first)):
        check_sites(report, lambda s, q, part=part: np.asarray(term.psi(s, q)[part]), site, p, np.asarray(value))  # type: ignore[misc]


# -- actuators -----------------------------------------------------------------------------
def _check_actuator(term: Actuator, report: Report, rng: np.random.Generator, sensors: Mapping[str, Any]) -> None:
    p, readings = term.values(), dict(sensors)
    if term.drives == "curvature":
        readings["s"] = frozen(np.sort(rng.uniform(0.0, 0.1, SITES)))
    for t in (0.0, 0.37, 12.5):
        value = check_pure(report, term, "command", (t, MappingProxyType(readings), p), (t + 0.1, MappingProxyType(readings), p))
        shape = np.shape(value)
        allowed = [(2,), (SITES, 2)] if term.drives == "curvature" else [()]
        report.demand(
            "shapes", shape in allowed, f"command() returns the shape {shape} at t = {t:g} s",
            f"For drives = {term.drives!r} return " + ("(2,) or (n, 2) curvatures." if len(allowed) == 2 else "one number."),
        )  # fmt: skip
        report.demand(
            "finite", bool(np.all(np.isfinite(np.asarray(value, dtype=float)))), f"command() is not finite at t = {t:g} s",
            "Guard divisions and roots.",
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
            R = check_shape(report, "orientation()", term.orientation(s, p), (3, 3), "Return a rotation matrix.")
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


def random_line_sites(rng: np.random.Generator, speed: float) -> LineSites:
    """Sites of a drag law in random states."""
    return LineSites(
        v=speed * rng.normal(size=(SITES, 3)),
        x=rng.normal(size=(SITES, 3)),
        tangent=unit(rng.normal(size=(SITES, 3))),
        radius=rng.uniform(1e-3, 5e-3, SITES),
        length=rng.uniform(0.5e-2, 2e-2, SITES),
        t=0.3,
        dt=1e-2,
    )


def turned(site: LineSites, R: np.ndarray, shift: np.ndarray) -> LineSites:
    """Sites that are rotated and shifted as a whole."""
    return replace(site, v=site.v @ R.T, x=site.x @ R.T + shift, tangent=site.tangent @ R.T)


__all__ = ["check_law", "random_line_sites", "random_rotation", "turned"]
