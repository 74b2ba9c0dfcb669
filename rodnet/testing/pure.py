"""What the checks of all local laws share: purity, shapes, independent sites."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from rodnet.parameters import Parameter
from rodnet.terms.base import Term
from rodnet.testing.report import Report

SITES = 7  # at which a law is evaluated at once


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


def check_pure(
    report: Report, term: Term, method: str, arguments: tuple[Any, ...], others: tuple[Any, ...]
) -> Any:
    """Call a law repeatedly with read-only arguments; return its value for ``arguments``.

    It must not write to them, give the same value before and after a call with ``others``, leave
    its term alone, and take parameters from its argument, not from ``self``.
    """
    arguments, others = tuple(map(frozen, arguments)), tuple(map(frozen, others))
    remedy = (
        f"{method}() must be a pure function of its arguments: nothing is stored in self, and arrays are "
        "copied to change them."
    )
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
    report.demand(
        "purity", identical(first, again), f"{method}() gives another value the second time", remedy
    )
    other = copy.copy(term)
    for name, p in term.parameter_items():
        setattr(other, name, _elsewhere(p))
    value = getattr(other, method)(*arguments)
    report.demand(
        "purity", identical(first, value), f"{method}() depends on a parameter of self rather than of its argument p",
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


def identical(a: Any, b: Any) -> bool:
    """Whether two values of a law are equal bit for bit."""
    if isinstance(a, tuple | list):
        return len(a) == len(b) and all(map(identical, a, b))
    return np.array_equal(np.asarray(a, dtype=float), np.asarray(b, dtype=float), equal_nan=True)


def check_shape(
    report: Report, what: str, value: Any, shape: tuple[int, ...], remedy: str = ""
) -> np.ndarray:
    """Return a value as an array, after checking its shape and that it is finite."""
    value = np.asarray(value)
    usual = "Parameters may be scalars or of shape (n, 1); radius and length are (n,): site.radius[:, None]."
    report.demand(
        "shapes", value.shape == shape, f"{what} has the shape {value.shape}, not {shape}", remedy or usual
    )
    report.demand(
        "finite",
        bool(np.all(np.isfinite(value.astype(float)))),
        f"{what} is not finite",
        "Guard divisions and roots.",
    )
    return value.astype(float)


def check_sites(
    report: Report, law: Callable[[Any, Any], np.ndarray], site: Any, p: Any, value: np.ndarray
) -> None:
    """Sites are independent: in another order, one by one, and with parameters given per site."""
    count = len(value)
    order = np.roll(np.arange(count)[::-1], 2)
    remedy = "Let each row of the result depend on its own row of the site and of p only: no sums over sites."
    per_site = columns(p, count)
    problem = "sites in another order, or p of shape (n, 1), change the result"
    try:
        shuffled = law(frozen(rows(site, order)), frozen(rows(per_site, order)))
    except (ValueError, IndexError) as failure:
        shuffled, problem = np.array(np.nan), f"{problem}: {failure}"
    report.require("sites: permutation", relative(shuffled, value[order]), 1e-12, problem, remedy)
    for k in range(count):
        one = np.array([k])
        error = np.abs(law(frozen(rows(site, one)), p) - value[one]).max() / max(
            float(np.abs(value).max()), 1e-300
        )
        report.require(
            "sites: one by one",
            error,
            1e-12,
            f"site {k} alone gives another result than among others",
            remedy,
        )
