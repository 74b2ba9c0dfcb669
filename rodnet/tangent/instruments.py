"""Instruments among what sensitivities are of and by: readings in time, and their own parameters."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from rodnet.errors import ParameterError
from rodnet.names import listed, meant
from rodnet.observer import Observer
from rodnet.parameters import Parameter
from rodnet.recordings.observation import Observation
from rodnet.recordings.prediction import SLACK, _cubic
from rodnet.tangent.variation import STEP, Variation, stencil

SHIFT = 1e-3  # of a time step: differences in time
Function = Callable[[Observer], Any]


def functions_of(observe: Mapping[str, Any] | Sequence[Observation] | Observation | None) -> dict[str, Any]:
    """What is observed, by name.

    Raises
    ------
    ParameterError
        For what can observe nothing, or one name for two.
    """
    if isinstance(observe, Mapping) or observe is None:
        named = [(name, one) for name, one in (observe or {}).items()]
    else:
        given = [observe] if isinstance(observe, Observation) else list(observe)
        named = [(getattr(one, "name", "?"), one) for one in given]
    found = dict(named)
    if len(found) < len(named):
        names = [name for name, _ in named]
        twice = next(name for name in names if names.count(name) > 1)
        raise ParameterError(f"observe: there are two of the name '{twice}'; give one name='...'")
    for name, one in found.items():
        if not (callable(one) or isinstance(one, Observation)):
            raise ParameterError(f"observe: '{name}' must be a function of a state, got {one!r}")
    return found


class InstrumentColumn:
    """A column that is a parameter of an instrument: it changes nothing but what that reads.

    Parameters
    ----------
    path : str
        ``"markers.scale"``, or ``"markers.shift[0]"`` for one value of an array.
    name : str
        The instrument's.
    one : Observation
        The instrument.
    scale : float, optional
        Change that is worth considering, for parameters that are zero.

    Attributes
    ----------
    variation : Variation
        As a column of the tangent, which it leaves zero.
    near : list of (float, Observation)
        Weights of a difference quotient, and instruments.
    """

    def __init__(self, path: str, name: str, one: Observation, scale: float | None) -> None:
        key, bracket, rest = path.removeprefix(f"{name}.").partition("[")
        known = one.declared()
        if key not in known:
            raise ParameterError(
                f"the observation '{name}' has no parameter '{key}'; {meant(key, known)}{listed(known)}"
            )
        parameter: Parameter = getattr(one, key)
        values, index = np.asarray(parameter.value, dtype=float), rest.removesuffix("]")
        single = index.isdigit() and int(index) < values.size if values.ndim else not bracket
        if not single:
            what = f"one of {values.size} values, '{name}.{key}[0]'" if values.ndim else "one number"
            raise ParameterError(f"'{path}': '{name}.{key}' is {what}")
        at = int(index) if values.ndim else 0
        value = float(values.flat[at])
        self.path, self.name, self.late = path, name, key == "lag"
        self.near = []
        for weight, place in stencil(value, STEP * (abs(value) or scale or 1.0), parameter.bounds):
            changed, given = copy.copy(one), values.copy()
            given.flat[at] = place
            setattr(changed, key, parameter.with_value(given if values.ndim else place))
            self.near.append((weight, changed))
        self.variation = Variation(path, parameter.unit, value, (), acts=False)

    def slope(self, view: Observer) -> np.ndarray:
        """Derivative of what the instrument reads of a state."""
        return np.asarray(sum(w * np.asarray(one.read(view), dtype=float) for w, one in self.near))


def split(
    parameters: Sequence[str] | Mapping[str, float], functions: Mapping[str, Any]
) -> tuple[dict[str, float | None], list[InstrumentColumn]]:
    """Part the paths into those of the robot and those of instruments."""
    paths = [parameters] if isinstance(parameters, str) else list(parameters)
    scales: dict[str, float | None] = dict.fromkeys(paths)
    if isinstance(parameters, Mapping):
        scales = dict(parameters)
    elif len(scales) < len(paths):
        twice = next(p for p in paths if paths.count(p) > 1)
        raise ParameterError(f"the parameter '{twice}' is given twice")
    own, rest = [], {}
    for path, scale in scales.items():
        name = path.partition(".")[0]
        if isinstance(functions.get(name), Observation):
            own.append(InstrumentColumn(path, name, functions[name], scale))
        else:
            rest[path] = scale
    return rest, own


def as_recorded(
    one: Observation, t: np.ndarray, dt: float, read: np.ndarray, slopes: np.ndarray, lag: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """What an instrument reads at times ``t``, as `rodnet.observe` has it, and its derivatives.

    Parameters
    ----------
    one : Observation
        The instrument, whose lag counts.
    t : ndarray, shape (T,)
        Times of the states [s].
    dt : float
        Time step [s].
    read, slopes : ndarray, shapes (T, ...) and (T, ..., k)
        What it reads of the states, and the derivatives of that.
    lag : sequence of int
        Columns that are its lag.
    """
    late = float(one.lag.value)

    def at(values: np.ndarray, shift: float) -> np.ndarray:
        rows = []
        for moment in np.clip(t - late - shift, t[0], t[-1]):
            nodes, weights = _cubic(t, float(moment), SLACK * dt)
            rows.append(np.tensordot(weights, values[nodes], axes=1))
        return np.array(rows)

    found = at(slopes, 0.0)
    h = SHIFT * dt
    for column in lag:
        found[..., column] = (at(read, h) - at(read, -h)) / (2.0 * h)
    return at(read, 0.0), found
