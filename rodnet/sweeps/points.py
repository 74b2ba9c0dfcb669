"""The points of a sweep: a grid (every combination of some values) or samples (one row per robot)."""

from __future__ import annotations

import functools
import hashlib
import inspect
import itertools
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rodnet.errors import ParameterError
from rodnet.names import meant
from rodnet.sweeps.fingerprint import fingerprint

SAMPLE = "sample"  # the dimension of samples
# what a dataset tells of each point besides its metrics
ABOUT = {
    "state": "done, failed or missing",
    "error": "what ended the simulation; empty where nothing did",
    "error_time": "simulated time that was reached when it failed",
    "seconds": "time that the point took",
    "note": "what the metrics say of themselves, why one is NaN for instance",
    "trajectory": "file that holds the trajectory",
}


@dataclass(frozen=True)
class Points:
    """What is to be computed.

    Attributes
    ----------
    axes : dict
        Values by name of what a grid varies, in the order of its dimensions; empty for samples.
    columns : dict
        Values by name, one per row, of what samples vary; empty for a grid.
    fixed : dict
        Values that are the same everywhere.
    rows : list of dict
        Arguments of each robot; of a grid in C order, the last axis fastest.
    """

    axes: Mapping[str, list[Any]]
    columns: Mapping[str, list[Any]]
    fixed: Mapping[str, Any]
    rows: Sequence[Mapping[str, Any]] = field(repr=False)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters."""
        return (*self.axes, *self.columns, *self.fixed)

    @property
    def dims(self) -> dict[str, int]:
        """Sizes of the dimensions of the results, by name."""
        return {SAMPLE: len(self.rows)} if self.columns else {k: len(v) for k, v in self.axes.items()}

    def told(self, row: Mapping[str, Any]) -> dict[str, Any]:
        """Return a row as plain values, for people."""
        return {name: labels([value])[0] for name, value in row.items()}

    @functools.cached_property
    def keys(self) -> list[str]:
        """A name for each row that depends on its values only."""
        return [key(row) for row in self.rows]


def key(row: Mapping[str, Any]) -> str:
    """Return 16 hexadecimal digits that stand for the values; 100 and 100.0 are the same."""
    plain = {
        name: float(value)
        if isinstance(value, int | float) and not isinstance(value, bool)
        else value
        if is_plain(value)
        else [fingerprint(value)]
        for name, value in row.items()
    }
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()[:16]


def is_plain(value: Any) -> bool:
    """Whether a value is its own label: a number, a word or a truth value."""
    return isinstance(value, bool | int | float | str)


def labels(values: Sequence[Any]) -> list[Any]:
    """Return the values if they are plain and of one kind, otherwise a word for each; none for two of them."""
    kinds = {"number" if type(v) in (int, float) else type(v) for v in values if is_plain(v)}
    if len(kinds) == 1 and all(is_plain(v) for v in values):
        return list(values)
    words = [
        str(v)
        if v is None or is_plain(v)
        else "array"
        if isinstance(v, np.ndarray)
        else getattr(v, "__name__", type(v).__name__)
        for v in values
    ]
    return [f"{word} {k}" if words.count(word) > 1 else word for k, word in enumerate(words)]


def make_points(grid: Any, samples: Any = None) -> Points:
    """Return the points of a grid or of samples, checked.

    Parameters
    ----------
    grid : mapping, or sequence of mappings, or a table
        Values by name, a single value being the same everywhere; every combination is a point. A
        sequence of mappings or a table is taken for samples.
    samples : sequence of mappings, mapping of columns, or a table with ``to_dict``
        One point per row.

    Raises
    ------
    ParameterError
        If there are no points, or a value is NaN or given twice.
    """
    if samples is None and grid is not None and not isinstance(grid, Mapping):
        grid, samples = None, grid
    if (grid is None) == (samples is None):
        raise ParameterError(
            "a sweep takes a grid, {'rpm': [50, 100]}, or samples, [{'rpm': 50}, {'rpm': 100}]: one of the two"
        )
    return _grid(grid) if samples is None else _samples(samples)


def _grid(grid: Mapping[str, Any]) -> Points:
    if not grid:
        raise ParameterError("the grid is empty; give values by name, e.g. {'rpm': [50, 100, 150]}")
    axes: dict[str, list[Any]] = {}
    fixed: dict[str, Any] = {}
    for name, values in grid.items():
        _check_name(name)
        single = isinstance(values, str | Mapping) or not isinstance(values, Iterable)
        if single or getattr(values, "ndim", 1) == 0:
            fixed[name] = _value(name, values)
            continue
        axes[name] = _column(name, values)
        if not axes[name]:
            raise ParameterError(f"the grid has no values of {name}; give at least one")
        seen = [key({name: value}) for value in axes[name]]
        twice = [v for k, v in enumerate(axes[name]) if seen[k] in seen[:k]]
        if twice:
            raise ParameterError(f"the grid has {name} = {twice[0]!r:.60} twice")
    rows = [fixed | dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())]
    return Points(axes, {}, fixed, rows)


def _samples(samples: Any) -> Points:
    if hasattr(samples, "to_dict") and hasattr(samples, "columns"):  # pandas, polars
        samples = {name: list(samples[name]) for name in samples.columns}
    if isinstance(samples, Mapping):
        lengths = {name: len(values) if hasattr(values, "__len__") else 0 for name, values in samples.items()}
        if any(isinstance(values, str) or not hasattr(values, "__len__") for values in samples.values()):
            raise ParameterError(
                "columns of samples must be sequences; repeat a value that is the same everywhere"
            )
        if len(set(lengths.values())) > 1:
            told = ", ".join(f"{name} {n}" for name, n in lengths.items())
            raise ParameterError(f"the columns of the samples are not equally long: {told}")
        columns = {name: _column(name, values) for name, values in samples.items()}
    else:
        rows = list(samples) if isinstance(samples, Iterable) and not isinstance(samples, str) else [samples]
        for k, row in enumerate(rows):
            if not isinstance(row, Mapping):
                raise ParameterError(f"sample {k} is {row!r}; it must give values by name, {{'rpm': 50}}")
            if set(row) != set(rows[0]):
                odd = sorted(map(str, set(row) ^ set(rows[0])))
                raise ParameterError(f"sample {k} and sample 0 differ in their names: {', '.join(odd)}")
        columns = {name: _column(name, [row[name] for row in rows]) for name in (rows[0] if rows else ())}
    count = len(next(iter(columns.values()), []))
    if not count:
        raise ParameterError("there are no samples; give at least one")
    for name in columns:
        _check_name(name)
    return Points({}, columns, {}, [{n: v[k] for n, v in columns.items()} for k in range(count)])


def _check_name(name: Any) -> None:
    if not isinstance(name, str) or not name or "/" in name:
        raise ParameterError(f"{name!r} is no name of a parameter; names are words without a slash")
    if name in ABOUT or name == SAMPLE:
        raise ParameterError(
            f"a parameter cannot be called '{name}', which the results have already; rename it"
        )


def _column(name: str, values: Iterable[Any]) -> list[Any]:
    return [_value(name, v) for v in values]


def _value(name: str, value: Any) -> Any:
    if isinstance(value, np.generic) or getattr(value, "ndim", None) == 0:
        value = value.item()
    if isinstance(value, float) and value != value:
        raise ParameterError(f"{name} = nan cannot label a result; leave it out")
    return value


def check_arguments(build: Callable[..., Any], names: Iterable[str]) -> None:
    """Check that a building function takes these names; those with a dot are paths of the robot's parameters.

    Raises
    ------
    ParameterError
        Naming the parameter that it does not take, or that it needs and is not given.
    """
    try:
        taken = inspect.signature(build).parameters
    except (TypeError, ValueError):  # a compiled function does not say
        return
    given = {name for name in names if "." not in name}
    label = getattr(build, "__name__", type(build).__name__)
    by_name = {n: p for n, p in taken.items() if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)}
    if not any(p.kind is p.VAR_KEYWORD for p in taken.values()):
        unknown = sorted(given - set(by_name))
        if unknown:
            raise ParameterError(
                f"{label} takes no {', '.join(map(repr, unknown))}; {meant(unknown[0], by_name)}it takes "
                f"{', '.join(by_name) or 'nothing'} "
                "(a path of the robot's parameters, which has a dot in it, can be swept too)"
            )
    needed = [n for n, p in by_name.items() if p.default is p.empty and n not in given]
    if needed:
        raise ParameterError(f"{label} needs {', '.join(needed)}; give a value, or values to sweep over")
