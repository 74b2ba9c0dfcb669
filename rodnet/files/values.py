"""Arguments of terms as plain values and back: numbers, text, arrays, and functions that are data."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from rodnet import registry
from rodnet.errors import RobotFileError


def _bspline(spline: Any) -> dict[str, Any]:
    return {
        "knots": spline.t,
        "coefficients": spline.c,
        "degree": spline.k,
        "extrapolate": spline.extrapolate,
    }


def _polynomials(p: Any) -> dict[str, Any]:
    return {"coefficients": p.c, "breaks": p.x, "extrapolate": p.extrapolate, "axis": p.axis}


def _make_bspline(knots: Any, coefficients: Any, degree: int, extrapolate: Any = True) -> Any:
    from scipy.interpolate import BSpline

    return BSpline(np.array(knots, dtype=float), np.array(coefficients, dtype=float), degree, extrapolate)


def _make_polynomials(coefficients: Any, breaks: Any, extrapolate: Any = True, axis: int = 0) -> Any:
    from scipy.interpolate import PPoly

    return PPoly(np.array(coefficients, dtype=float), np.array(breaks, dtype=float), extrapolate, axis)


def _make_motion(kind: str) -> Callable[..., Any]:
    def make(knots: Any, coefficients: Any, degree: int, first: float, last: float) -> Any:
        from rodnet.terms import motion

        spline = _make_bspline(knots, coefficients, degree)
        return getattr(motion, kind)(spline, first, last)

    return make


def _motion(motion: Any) -> dict[str, Any]:
    s = motion.spline
    return {"knots": s.t, "coefficients": s.c, "degree": s.k, "first": motion.first, "last": motion.last}


def _data_of(function: Any) -> tuple[str, dict[str, Any]] | None:
    """Kind and data of a function that is data; None for any other."""
    from scipy.interpolate import BSpline, PPoly

    from rodnet.terms.motion import SmoothMotion, SmoothRotation

    for kind, (cls, data) in {
        "smooth-motion": (SmoothMotion, _motion),
        "smooth-rotation": (SmoothRotation, _motion),
        "b-spline": (BSpline, _bspline),
        "piecewise-polynomial": (PPoly, _polynomials),
    }.items():
        if isinstance(function, cls):
            return kind, data(function)
    return None


_MAKE: dict[str, Callable[..., Any]] = {
    "smooth-motion": _make_motion("SmoothMotion"),
    "smooth-rotation": _make_motion("SmoothRotation"),
    "b-spline": _make_bspline,
    "piecewise-polynomial": _make_polynomials,
}


def encode(value: Any, what: str) -> Any:
    """Return a value as TOML knows it.

    Parameters
    ----------
    value : object
        A number, text, truth value, array, list, tuple or mapping of these, or a function that is data.
    what : str
        Whose value it is, for the message.

    Raises
    ------
    RobotFileError
        If it cannot be written; says what could.
    """
    if isinstance(value, bool | str | int | float):
        return value
    if isinstance(value, np.generic | np.ndarray):
        if value.dtype.kind not in "bifU":
            raise RobotFileError(f"{what} holds an array of {value.dtype}, which a file cannot")
        return value.tolist()
    if isinstance(value, list | tuple):
        if any(v is None for v in value):
            raise RobotFileError(f"{what} holds None in a list, which TOML cannot")
        return [encode(v, what) for v in value]
    if isinstance(value, Mapping):
        if not all(isinstance(k, str) for k in value) or "function" in value:
            raise RobotFileError(f"{what} is a mapping whose keys are not all words (other than 'function')")
        return {k: encode(v, what) for k, v in value.items() if v is not None}
    data = _data_of(value)
    if data is not None:
        return {"function": data[0], **{k: encode(v, what) for k, v in data[1].items() if v is not None}}
    if callable(value):
        return {"function": _path(value, what)}
    raise RobotFileError(f"{what} is {value!r}: a file holds numbers, text, arrays and splines")


def decode(value: Any, what: str) -> Any:
    """Return what `encode` wrote."""
    if isinstance(value, list):
        return [decode(v, what) for v in value]
    if not isinstance(value, dict):
        return value
    if "function" not in value:
        return {k: decode(v, what) for k, v in value.items()}
    kind = value["function"]
    data = {k: v for k, v in value.items() if k != "function"}
    if kind in _MAKE:
        try:
            return _MAKE[kind](**data)
        except (TypeError, ValueError) as error:
            raise RobotFileError(f"{what}: this is no {kind}: {error}") from None
    if ":" not in str(kind):
        raise RobotFileError(f"{what}: no function is called {kind!r}; there are {', '.join(_MAKE)}")
    return _find(kind, what)


def _path(function: Any, what: str) -> str:
    """``module:name`` of a function that an installed package provides."""
    module, name = getattr(function, "__module__", None), getattr(function, "__qualname__", "")
    remedy = (
        "write it as data, rodnet.smooth_motion(t, values) or a spline of scipy.interpolate, or put it into an "
        "installed package that announces itself to rodnet (docs, how to write a law)"
    )
    if module is None or "<" in name or module.partition(".")[0] not in registry.providers():
        who = repr(name or function)
        raise RobotFileError(f"{what} is a function of a script, {who}, which a file cannot hold: {remedy}")
    if _find(f"{module}:{name}", what) is not function:
        raise RobotFileError(f"{what}: {module}:{name} is another function than this one: {remedy}")
    return f"{module}:{name}"


def _find(path: str, what: str) -> Any:
    """Return a function by ``module:name``, of rodnet's or a plug-in's."""
    module, _, name = path.partition(":")
    package = module.partition(".")[0]
    if package not in registry.providers():
        raise RobotFileError(
            f"{what}: the function {path} is of the package '{package}', which is no installed plug-in of rodnet; "
            "install it"
        )
    try:
        found: Any = importlib.import_module(module)
        for part in name.split("."):
            found = getattr(found, part)
    except (ImportError, AttributeError) as error:
        raise RobotFileError(
            f"{what}: there is no function {path} ({error}); another version of it?"
        ) from None
    return found
