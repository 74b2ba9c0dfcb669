"""What a calibration looks for: quantities with a path, a unit, bounds, and a coordinate in which they are scaled."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any

import numpy as np
from scipy.stats import norm

from rodnet.errors import ParameterError
from rodnet.names import listed, meant
from rodnet.parameters import Parameter
from rodnet.recordings.observation import Observation
from rodnet.robot import Robot
from rodnet.tangent.columns import find, find_indexed

TWISTED = "initial.twist"
INITIAL = ("offset", "position", "velocity", "twist", "time")
AXES = "xyz"
OFFSET = 0.01  # prior of offsets and amplitudes of the initial shape, of the robot's size
TWIST = 0.5  # [rad] prior of the amplitude of the initial twist
SPEED = 0.05  # prior of amplitudes of the initial velocity, of sqrt(g size)
GRAVITY = 9.81
FAR = 30.0  # exponents beyond it are infinite
LEAST = 1e-6  # of the start: where the search of a logarithm ends that may go to minus infinity
MOST = 1e4  # likewise: where it ends that may go to infinity
GONE = 1e-3  # of the start: what is not above it and may be zero has vanished
NEAR = 1e-6  # [1] distance from bounds at which a start is put


@dataclass(frozen=True)
class Quantity:
    """A number to be found.

    Its coordinate ``z`` is log(value / start) where it is positive by nature, else (value - start) / scale.

    Attributes
    ----------
    path, unit : str
        What it is called, without the trial.
    start : float
        Where the search begins.
    low, high : float
        Bounds.
    scale : float
        A change worth considering.
    log : bool
        Whether its logarithm is what is searched.
    prior : object or None
        A frozen distribution.
    trial : int or None
        The one trial it is about; None if it is the same in all.
    """

    path: str
    unit: str
    start: float
    low: float
    high: float
    scale: float
    log: bool
    prior: Any = None
    trial: int | None = None

    def value(self, z: float) -> float:
        """Value at a coordinate."""
        if self.log:
            return float(np.clip(self.start * np.exp(np.clip(z, -FAR, FAR)), self.low, self.high))
        return float(np.clip(self.start + self.scale * z, self.low, self.high))

    def coordinate(self, value: float) -> float:
        """Coordinate of a value."""
        if self.log:
            return float(np.log(value / self.start)) if value > 0.0 else -np.inf
        return (value - self.start) / self.scale

    def slope(self, z: float) -> float:
        """Derivative of the value by the coordinate."""
        return self.value(z) if self.log else self.scale

    @property
    def bounds(self) -> tuple[float, float]:
        """Bounds of the coordinate."""
        low = np.log(LEAST) if self.log and self.low == 0.0 else self.coordinate(self.low)
        high = np.log(MOST) if self.log and self.high == np.inf else self.coordinate(self.high)
        return float(low), float(high)

    def vanished(self, z: float) -> bool:
        """Whether what may be zero has all but become it."""
        return self.log and self.low == 0.0 and z <= np.log(GONE)

    def grown(self, z: float) -> bool:
        """Whether what may be as large as it likes has all but become infinite."""
        return self.log and self.high == np.inf and z >= -np.log(GONE)

    def prior_residual(self, z: float) -> tuple[float, float]:
        """Residual of the prior in standard deviations, and its derivative by the coordinate."""
        value = self.value(z)
        # from the nearer end: a probability near one has no digits left
        below, above = float(self.prior.cdf(value)), float(self.prior.sf(value))
        u = float(norm.ppf(max(below, 1e-300)) if below < above else norm.isf(max(above, 1e-300)))
        return u, float(self.prior.pdf(value) / norm.pdf(u)) * self.slope(z)


def tie(path: str, function: Callable[[Mapping[str, float]], float], known: Mapping[str, Any]) -> float:
    """Return the value of what follows from others.

    Raises
    ------
    ParameterError
        If it cannot be computed of what is known.
    """
    try:
        return float(function(known))
    except (KeyError, TypeError, ValueError) as error:
        raise ParameterError(
            f"tied '{path}' fails: {type(error).__name__}: {error}; it must be a function of the mapping of "
            f"{', '.join(known)} that returns a number"
        ) from None


def value_of(robot: Robot, instruments: Sequence[Observation], path: str) -> float:
    """Return the present value of a single number, of the robot or an instrument."""
    place, indexed = instrument_path(instruments, path), find_indexed(robot, path)
    if place is not None:
        value, index = getattr(instruments[place[0]], place[1]).value, place[2]
    elif indexed is not None:
        value, index = robot.parameters[indexed[0]].value, indexed[1]
    else:
        value, index = next(iter(find(robot, path).values())).value, None
    return float(value) if index is None else float(np.ravel(value)[index])


def robot_values(robot: Robot, values: Mapping[str, float]) -> dict[str, Any]:
    """Resolve globs and single values of arrays into what `Robot.with_parameters` takes."""
    given: dict[str, Any] = {}
    for path, value in values.items():
        indexed = find_indexed(robot, path)
        if indexed is None:
            given.update(dict.fromkeys(find(robot, path), value))
        else:
            name, index = indexed
            array = np.array(given.get(name, robot.parameters[name].value), dtype=float)
            array.flat[index] = value
            given[name] = array
    return given


def with_ties(
    tied: Mapping[str, Callable[[Mapping[str, float]], float]], known: Mapping[str, float]
) -> dict[str, float]:
    """Return known values and, one after the other, what follows from them; errors are those of `tie`."""
    found = dict(known)
    for path, function in tied.items():
        found[path] = tie(path, function, found)
    return found


def is_there(robot: Robot, instruments: Sequence[Observation], path: str) -> bool:
    """Whether a path, a glob of paths or a path with an index names a parameter of the robot or an instrument."""
    known = robot.parameters
    return (
        instrument_path(instruments, path) is not None
        or find_indexed(robot, path) is not None
        or path in known
        or any(fnmatchcase(name, path) for name in known)
    )


def instrument_path(instruments: Sequence[Observation], path: str) -> tuple[int, str, int | None] | None:
    """Number of the instrument, name of its parameter, and index in an array, of a path; None if it is none's."""
    match = re.fullmatch(r"([^.]+)\.([^.\[]+)(?:\[(\d+)\])?", path)
    for number, one in enumerate(instruments):
        if match and one.name == match[1]:
            if match[2] not in one.declared():
                raise ParameterError(
                    f"the observation '{one.name}' has no parameter '{match[2]}'; "
                    f"{meant(match[2], one.declared())}{listed(one.declared())}"
                )
            value, index = getattr(one, match[2]).value, None if match[3] is None else int(match[3])
            if (index is None) != (np.ndim(value) == 0):
                example = f"'{one.name}.{match[2]}[0]'" if np.ndim(value) else f"'{one.name}.{match[2]}'"
                raise ParameterError(f"'{path}': give {example}, one number")
            if index is not None and index >= np.size(value):
                raise ParameterError(f"'{path}': there are {np.size(value)} values, numbered from 0")
            return number, match[2], index
    return None


def set_instrument(one: Observation, name: str, index: int | None, value: float) -> None:
    """Set a parameter of an instrument."""
    parameter: Parameter = getattr(one, name)
    given: Any = value
    if index is not None:
        given = np.array(parameter.value, dtype=float)
        given.flat[index] = value
    setattr(one, name, parameter.with_value(given))


def expand(path: str, modes: int) -> list[str]:
    """Paths of single numbers: ``"initial.position"`` is one for each mode, ``"initial.offset"`` for each axis."""
    if not path.startswith("initial."):
        return [path]
    name, _, index = path.removeprefix("initial.").partition("[")
    if name not in INITIAL:
        raise ParameterError(
            f"the initial state has no '{path}'; {meant(name, INITIAL)}there are "
            f"{', '.join('initial.' + n for n in INITIAL)}"
        )
    if index or name in ("time", "twist"):
        return [path]
    return [f"{path}[{a}]" for a in AXES] if name == "offset" else [f"{path}[{k}]" for k in range(modes)]


def make_quantity(
    path: str, robot: Robot, instruments: Sequence[Observation], frame: float, prior: Any, start: float | None
) -> Quantity:
    """Describe a quantity of a path.

    Parameters
    ----------
    path : str
        Of a single number.
    robot : Robot
        As built.
    instruments : sequence of Observation
        Of the trial.
    frame : float
        Time between frames [s].
    prior : object
        A standard deviation about the start, a pair of value and standard deviation, or a frozen distribution.
    start : float, optional
        Where to begin, instead of the present value.

    Raises
    ------
    ParameterError
        If there is nothing of this path, or the start is out of bounds.
    """
    size = float(robot.graph.size)
    if path.startswith("initial."):
        name = path.removeprefix("initial.").partition("[")[0]
        unit, scale = {
            "offset": ("m", OFFSET * size),
            "position": ("m", OFFSET * size),
            "velocity": ("m/s", SPEED * np.sqrt(GRAVITY * size)),
            "twist": ("rad", TWIST),
            "time": ("s", frame),
        }[name]
        value, low, high, own = 0.0, -np.inf, np.inf, None if name == "time" else scale
    elif (found := instrument_path(instruments, path)) is not None:
        parameter: Parameter = getattr(instruments[found[0]], found[1])
        array = np.asarray(parameter.value, dtype=float)
        value = float(array if found[2] is None else array.flat[found[2]])
        unit, (low, high), own = parameter.unit, parameter.bounds, parameter.prior
        scale = {"s": frame, "m": OFFSET * size, "rad": 0.05}.get(unit, 0.1 * abs(value) or 1.0)
    else:
        try:
            indexed = find_indexed(robot, path)
            first = robot.parameters[indexed[0]] if indexed else next(iter(find(robot, path).values()))
        except ParameterError as error:
            names = [one.name for one in instruments]
            raise ParameterError(
                f"{error}; observations are {', '.join(names)}, and there is initial.position and the like"
            ) from None
        array = np.asarray(first.value, dtype=float)
        value = float(array.flat[indexed[1]] if indexed else array)
        unit, (low, high), own = first.unit, first.bounds, first.prior
        scale = abs(value) or (0.1 * (high - low) if np.isfinite(high - low) else 1.0)
    value = value if start is None else float(start)
    if not low <= value <= high:
        raise ParameterError(f"'{path}' cannot start at {value:g}, outside [{low:g}, {high:g}]")
    log = low >= 0.0 and value > 0.0 and not path.startswith("initial.")
    distribution = _prior(path, own if prior is None else prior, value)
    if distribution is not None and not log and np.isfinite(distribution.std()):
        scale = float(distribution.std())
    return Quantity(path, unit, value, low, high, scale, log, distribution)


def _prior(path: str, given: Any, value: float) -> Any:
    """Return a frozen distribution, or None."""
    if given is None or (hasattr(given, "cdf") and hasattr(given, "pdf")):
        return given
    try:
        mean, sd = (value, float(given)) if np.ndim(given) == 0 else map(float, given)
    except (TypeError, ValueError):
        mean = sd = np.nan
    if not (np.isfinite(mean) and np.isfinite(sd) and sd > 0.0):
        raise ParameterError(
            f"the prior of '{path}' must be a standard deviation, (value, standard deviation) or a frozen "
            f"distribution of scipy.stats, got {given!r}"
        )
    return norm(mean, sd)
