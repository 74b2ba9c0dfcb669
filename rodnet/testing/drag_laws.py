"""Checks of drag laws by themselves, with and without memory."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from rodnet.kinematics.frames import unit
from rodnet.terms.drag.line import DragModel, LineSites
from rodnet.testing.medium import check_medium
from rodnet.testing.pure import SITES, check_pure, check_shape, check_sites, frozen, relative
from rodnet.testing.report import Report
from rodnet.testing.states import STEP, random_rotation
from rodnet.testing.taylor import differences

PATH = 200  # steps of the histories that laws with memory are driven through


def check_drag_law(
    term: DragModel, report: Report, rng: np.random.Generator, rtol: float, speed: float
) -> None:
    """Check a drag law: purity, shapes, independent sites, given derivatives, claims."""
    if term.memory_size:
        _check_memory_law(term, report, rng, speed)
        return
    site, p = random_line_sites(rng, speed), term.values()

    def law(s: LineSites, q: Any) -> np.ndarray:
        return np.asarray(term.force(s, q), dtype=float)

    value = check_pure(report, term, "force", (site, p), (random_line_sites(rng, speed), p))
    f = check_shape(report, "force()", value, (SITES, 3))
    still = replace(site, v=np.zeros((SITES, 3)))
    start = "Every simulation starts there: divide by rn.norm(v) + a small speed, or use np.maximum."
    report.demand(
        "finite at rest",
        bool(np.all(np.isfinite(law(frozen(still), p)))),
        "force() is not finite at v = 0",
        start,
    )
    check_sites(report, law, site, p, f)
    slopes = {key: _differences(term, site, p, key, speed) for key in ("v", "tangent", "x")}
    given = term.jacobian(frozen(site), p)
    at_rest = term.jacobian(frozen(still), p)
    report.demand(
        "shapes", set(given) <= set(slopes), f"jacobian() returns {sorted(given)}",
        "Its keys are \"v\", \"tangent\" and \"x\"; leave out what is not known.",
    )  # fmt: skip
    for key, matrix in given.items():
        matrix = check_shape(
            report,
            f"jacobian()['{key}']",
            matrix,
            (SITES, 3, 3),
            "Return (n, 3, 3): d force_i / d argument_j.",
        )
        _check_derivative(
            report, f"jacobian by {key}", f"jacobian()['{key}']", matrix, slopes[key], f, site, key, rtol
        )
        report.demand(
            "finite at rest",
            bool(np.all(np.isfinite(at_rest[key]))),
            f"jacobian()['{key}'] is not finite at v = 0",
            start,
        )
    found_at_binding = any(value is None for value in vars(p).values())
    if type(term).kernel is not None and not found_at_binding:
        _check_kernel(term, report, site, still, p, f, slopes, rtol)
    _check_claims(term, report, rng, site, p, f, speed)


def _differences(term: DragModel, site: LineSites, p: Any, key: str, speed: float) -> np.ndarray:
    """Derivative of each site's force by its own argument, shape (n, 3, 3)."""
    value = getattr(site, key)
    scale = np.linalg.norm(value, axis=1).min() if key == "v" else 1.0

    def law(step: np.ndarray) -> np.ndarray:
        moved = replace(site, **{key: value + step})
        return np.asarray(term.force(frozen(moved), p), dtype=float).ravel()

    return differences(law, np.zeros(3), np.full(3, STEP * scale)).reshape(SITES, 3, 3)


def _check_derivative(report, check, what, matrix, slope, f, site, key, rtol) -> None:
    """Compare a derivative with differences, relative to its largest entry, and name the worst site."""
    if key == "tangent":  # unit vectors change across themselves only
        across = np.eye(3) - site.tangent[:, :, None] * site.tangent[:, None, :]
        matrix, slope = matrix @ across, slope @ across
    floor = 1e-9 * float(np.abs(f).max()) / (float(np.abs(getattr(site, key)).max()) or 1.0)
    error = np.abs(matrix - slope).max(axis=(1, 2)) / max(float(np.abs(slope).max()), floor, 1e-300)
    report.require(
        check, error.max(), rtol,
        f"{what} is not the derivative of force() by '{key}' (worst at site {int(np.argmax(error))})",
        "Differentiate force() again, entry (i, j) being d f_i / d argument_j; or leave it out: what is missing "
        "is differenced.",
    )  # fmt: skip


def _check_kernel(term, report, site, still, p, f, slopes, rtol) -> None:
    """The compiled twin gives the law's force and derivatives, site by site."""
    from rodnet.terms.drag.site_loop import is_placed

    vector = np.array([float(np.ravel(v)[0]) for v in vars(p).values()])
    filled = 4 if is_placed(type(term).kernel) else 3

    def run(s: LineSites) -> list[np.ndarray]:
        out = [np.zeros((SITES, 3)), *np.zeros((filled - 1, SITES, 3, 3))]
        for k in range(SITES):
            args = s.v[k], s.x[k], s.tangent[k], float(s.radius[k]), float(s.t), vector
            type(term).kernel(*args, *(part[k] for part in out))
        return out

    force, *derivatives = run(site)
    report.require(
        "kernel: force", relative(force, f), 1e-12, "the compiled twin gives other forces than force()",
        "It gets (v, x, tangent, radius, t, p, f, dfdv, dfdtangent) of one site, p in order of declaration, and "
        "fills the last three.",
    )  # fmt: skip
    for key, matrix in zip(("v", "tangent", "x"), derivatives, strict=False):
        _check_derivative(
            report, f"kernel: by {key}", f"the kernel's dfd{key}", matrix, slopes[key], f, site, key, rtol
        )
    depends = float(np.abs(slopes["x"]).max()) > 1e-9 * float(np.abs(f).max())
    report.demand(
        "kernel: position", filled == 4 or not depends, "the law depends on x, but its kernel has no dfdx",
        "Add a tenth argument dfdx to the kernel and fill it, entry (i, j) being d f_i / d x_j.",
    )  # fmt: skip
    finite = all(bool(np.all(np.isfinite(part))) for part in run(still))
    report.demand(
        "finite at rest", finite, "the kernel is not finite at v = 0", "Every simulation starts there."
    )


def _check_claims(term, report, rng, site, p, f, speed) -> None:
    if "dissipative" in term.claims:
        power = np.sum(f * site.v, axis=1) / max(float((np.abs(f) * np.abs(site.v)).max()), 1e-300)
        report.require(
            "dissipative: law", max(float(power.max()), 0.0), 1e-12,
            f"force() . v is positive at site {int(np.argmax(power))}: drag in a still medium must oppose motion",
            "Check the sign of the force, or drop the claim \"dissipative\".",
        )  # fmt: skip
    if "objective" in term.claims:
        R, shift = random_rotation(rng), rng.normal(size=3)
        error = relative(term.force(frozen(turned(site, R, shift)), p), f @ R.T)
        report.require(
            "objective: law", error, 1e-9, "force() does not turn with v, x and tangent, or depends on the place",
            "Use directions and places only as v, tangent and differences give them, or drop the claim \"objective\".",
        )  # fmt: skip


# -- laws with memory ----------------------------------------------------------------------
def _check_memory_law(term: DragModel, report: Report, rng: np.random.Generator, speed: float) -> None:
    site, p = random_line_sites(rng, speed), term.values()
    size = (SITES, term.memory_size)
    report.demand(
        "kernel: memory",
        type(term).kernel is None,
        "kernels of laws with memory are not used",
        "Leave the kernel out.",
    )
    memory = check_shape(
        report, "initial_memory()", check_pure(report, term, "initial_memory", (site, p), (site, p)), size
    )
    for _ in range(3):
        other = random_line_sites(rng, speed)
        result = check_pure(report, term, "update", (site, p, memory), (other, p, memory))
        report.demand(
            "shapes", isinstance(result, tuple) and len(result) == 2, "update() does not return two values",
            "Return the force and the new memory.",
        )  # fmt: skip
        f = check_shape(report, "update()[0]", result[0], (SITES, 3))
        new = check_shape(
            report, "update()[1]", result[1], size, "Return one row of memory_size values per site."
        )
        both = np.concatenate([f, new], axis=1)

        def law(s: Any, q: Any) -> np.ndarray:
            return np.concatenate(term.update(s.site, q, s.memory), axis=1)

        check_sites(report, law, SimpleNamespace(site=site, memory=memory), p, both)
        still = replace(site, v=np.zeros((SITES, 3)))
        at_rest = all(
            bool(np.all(np.isfinite(part))) for part in term.update(frozen(still), p, frozen(memory))
        )
        report.demand(
            "finite at rest", at_rest, "update() is not finite at v = 0", "Every simulation starts there."
        )
        memory, site = new, replace(other, radius=site.radius, length=site.length)
    if term.memory_frame == "medium":
        check_medium(term, report, rng, random_line_sites(rng, speed), p)
    path = _path(rng, speed)
    forces = _drive(term, path, p)
    if "dissipative" in term.claims:
        work = np.cumsum([np.sum(f * s.v, axis=1) * s.dt for f, s in zip(forces, path, strict=True)], axis=0)
        spent = np.cumsum(
            [np.abs(f * s.v).sum(axis=1) * s.dt for f, s in zip(forces, path, strict=True)], axis=0
        )
        gained = float((work / np.maximum(spent, 1e-300)).max())
        report.require(
            "dissipative: law", max(gained, 0.0), 1e-9, "along a path from the initial memory the medium gave out work",
            "A medium with memory may return what it stored, no more: check signs and the order of updates.",
        )  # fmt: skip
    if "objective" in term.claims:
        R, shift = random_rotation(rng), rng.normal(size=3)
        elsewhere = _drive(term, [turned(s, R, shift) for s in path], p)
        report.require(
            "objective: law", relative(np.array(elsewhere), np.array(forces) @ R.T), 1e-8,
            "along a path that is moved as a whole, forces do not turn with it", "Drop the claim \"objective\".",
        )  # fmt: skip


def _path(rng: np.random.Generator, speed: float) -> list[LineSites]:
    """A history of sites that move to and fro."""
    site = random_line_sites(rng, speed)
    amplitude, rate, phase = (rng.uniform(a, b, (SITES, 3)) for a, b in ((0.2, 2.0), (5.0, 30.0), (0.0, 6.0)))
    path, x, dt = [], site.x, 5e-3
    for k in range(PATH):
        v = speed * amplitude * np.sin(rate * k * dt + phase)
        x = x + dt * v
        path.append(replace(site, v=v, x=x, t=k * dt, dt=dt))
    return path


def _drive(term: DragModel, path: list[LineSites], p: Any) -> list[np.ndarray]:
    memory, forces = term.initial_memory(replace(path[0], v=np.zeros((SITES, 3))), p), []
    for site in path:
        f, memory = term.update(frozen(site), p, frozen(np.asarray(memory, dtype=float)))
        forces.append(np.asarray(f, dtype=float))
    return forces


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
