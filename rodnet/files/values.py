"""Arguments of terms as plain values and back: numbers, text, arrays, and functions that are data."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from rodnet import registry
from rodnet.errors import RobotFileError
from rodnet.files.schema import shown


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


def _make_flow(kind: str) -> Callable[..., Any]:
    def make(**data: Any) -> Any:
        from rodnet.terms.drag import flow

        return getattr(flow, kind)(**data)

    return make


def _motion(motion: Any) -> dict[str, Any]:
    s = motion.spline
    return {"knots": s.t, "coefficients": s.c, "degree": s.k, "first": motion.first, "last": motion.last}


def _data_of(function: Any) -> tuple[str, dict[str, Any]] | None:
    """Kind and data of a function that is data; None for any other."""
    from scipy.interpolate import BSpline, PPoly

    from rodnet.terms.drag.flow import ShearFlow, UniformFlow, VortexFlow
    from rodnet.terms.motion import SmoothMotion, SmoothRotation

    kinds: dict[str, tuple[type, Callable[[Any], dict[str, Any]]]] = {
        "smooth-motion": (SmoothMotion, _motion),
        "smooth-rotation": (SmoothRotation, _motion),
        "b-spline": (BSpline, _bspline),
        "piecewise-polynomial": (PPoly, _polynomials),
        "uniform-flow": (UniformFlow, vars),
        "shear-flow": (ShearFlow, vars),
        "vortex-flow": (VortexFlow, vars),
    }
    for kind, (cls, data) in kinds.items():
        if isinstance(function, cls):
            return kind, data(function)
    return None


_MAKE: dict[str, Callable[..., Any]] = {
    "smooth-motion": _make_motion("SmoothMotion"),
    "smooth-rotation": _make_motion("SmoothRotation"),
    "b-spline": _make_bspline,
    "piecewise-polynomial": _make_polynomials,
    "uniform-flow": _make_flow("UniformFlow"),
    "shear-flow": _make_flow("ShearFlow"),
    "vortex-flow": _make_flow("VortexFlow"),
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
    known = isinstance(kind, str) and kind in _MAKE
    if not known and not (isinstance(kind, str) and ":" in kind):
        raise RobotFileError(
            f"{what}: no function is called {shown(kind)}; there are {', '.join(_MAKE)}, and 'package.module:name' of "
            "an installed plug-in"
        )
    if not known:
        if data:
            raise RobotFileError(f"{what}: the function {kind} takes no data; leave out {', '.join(data)}")
        return _find(kind, what)
    try:
        return _MAKE[kind](**data)
    except (TypeError, ValueError, LookupError) as error:
        reason = str(error).partition("() ")[2] or error  # without the name of a function of ours
        raise RobotFileError(
            f"{what}: this is no {kind}: {reason}; docs, robot files, says what it holds"
        ) from None


def _path(function: Any, what: str) -> str:
    """``module:name`` of a function that an installed package provides."""
    module, name = getattr(function, "__module__", None), getattr(function, "__qualname__", "")
    remedy = (
        "write it as data, rodnet.smooth_motion(t, values) or a spline of scipy.interpolate, or put it into an "
        "installed package that announces itself to rodnet (docs, how to write a law)"
    )
    if module is None or "<" in name or not _trusted(module):
        who = repr(name or function)
        raise RobotFileError(f"{what} is a function of a script, {who}, which a file cannot hold: {remedy}")
    if _find(f"{module}:{name}", what) is not function:
        raise RobotFileError(f"{what}: {module}:{name} is another function than this one: {remedy}")
    return f"{module}:{name}"


def _trusted(module: str) -> bool:
    """Whether a file may name functions of this module: of a plug-in, or of rodnet's robots and terms."""
    package, *inner = module.split(".")
    if package == "rodnet":
        return bool(inner) and inner[0] in ("robots", "terms")
    return package in registry.providers() and "__main__" not in inner


def _find(path: str, what: str) -> Any:
    """Return a function by ``module:name`` that a plug-in, or rodnet's robots and terms, define.

    It must be defined where it is named: ``package.module:os.system`` is not a function of that package.
    """
    module, _, name = path.partition(":")
    if not _trusted(module):
        raise RobotFileError(
            f"{what}: the function {shown(path)} is not of an installed plug-in of rodnet, nor of rodnet.robots or "
            f"rodnet.terms, so it is not called; install the package '{module.partition('.')[0]}' if it is one"
        )
    found: Any = None
    try:
        found = importlib.import_module(module)
        for part in name.split("."):
            found = getattr(found, part)
            if inspect.ismodule(found) or getattr(found, "__module__", None) != module:
                raise AttributeError(f"'{part}' is not defined in {module}")
    except (ImportError, AttributeError) as error:
        raise RobotFileError(
            f"{what}: there is no function {shown(path)} ({error}); another version of it?"
        ) from None
    if not callable(found) or isinstance(found, type):
        raise RobotFileError(f"{what}: {path} is not a function")
    return found
