"""The results of a sweep as a labelled xarray dataset."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import OutputError
from rodnet.sweeps.job import ContractError
from rodnet.sweeps.journal import FORMAT
from rodnet.sweeps.points import ABOUT, SAMPLE, Points, labels

if TYPE_CHECKING:
    import xarray as xr

ABOUT_UNITS = {"error_time": "s", "seconds": "s"}


def check_metrics(points: Points, metrics: Mapping[str, Any], shapes: dict[str, tuple[int, ...]]) -> None:
    """Check that metrics can be told from parameters, and put into arrays with those of other points.

    Parameters
    ----------
    shapes : dict
        Shapes of the metrics that were seen before; those that were not are added.

    Raises
    ------
    ContractError
        Naming the metric.
    """
    found = {name: np.shape(value) for name, value in metrics.items()}
    for name, shape in found.items():
        if name in ABOUT or name == SAMPLE:
            raise ContractError(
                f"a metric cannot be called '{name}', which the dataset has already; rename it"
            )
        if name in points.names or name.removesuffix("_values") in points.names:
            raise ContractError(
                f"'{name}' is the name of a swept parameter and of a metric; rename the metric"
            )
        if shapes.get(name, shape) != shape:
            raise ContractError(
                f"the metric '{name}' has the shape {shape}, at other points {shapes[name]}; fill it up with nan"
            )
    shapes |= found


def make_dataset(
    points: Points,
    records: Mapping[str, Mapping[str, Any]],
    units: Mapping[str, str],
    attributes: Mapping[str, Any],
) -> xr.Dataset:
    """Put records where they belong.

    Parameters
    ----------
    points : Points
        Parameters of each point, and the dimensions.
    records : mapping
        Records by key (see `rodnet.sweeps.job.run_point`); a point without one is missing.
    units : mapping
        Units of parameters and metrics by name, as far as they are known.
    attributes : mapping
        Global attributes; nested values are stored as JSON.

    Returns
    -------
    xarray.Dataset
        Metrics over the swept parameters (or over ``sample``), NaN where there is none; numbers that
        are whole or truth values everywhere keep their kind where no point is missing. Parameters that are
        no numbers or words have labels; arrays are beside them, ``NAME_values``.
    """
    import xarray as xr

    dims, shape = tuple(points.dims), tuple(points.dims.values())
    rows = [records.get(key, {}) for key in points.keys]
    measured = [r["metrics"] if "metrics" in r else None for r in rows]
    known = {k: v for r in rows for k, v in r.get("units", {}).items()} | dict(units)

    def variable(values: np.ndarray, inner: tuple[str, ...], attrs: dict[str, str]) -> Any:
        return xr.Variable((*dims, *inner), values.reshape((*shape, *values.shape[1:])), attrs)

    def unit(name: str) -> dict[str, str]:
        return {"units": known[name]} if name in known else {}

    data = {}
    for name in dict.fromkeys(n for m in measured if m is not None for n in m):
        values = _stack([None if m is None else m.get(name) for m in measured])
        inner = tuple(f"{name}_{k}" for k in range(values.ndim - 1))
        data[name] = variable(values, inner, unit(name))
    failed = [r.get("error") or {} for r in rows]
    told: dict[str, list[Any]] = {
        "state": ["failed" if e else "done" if r else "missing" for r, e in zip(rows, failed, strict=True)],
        "error": [f"{e['type']}: {e['message']}" if e else "" for e in failed],
        "error_time": [e.get("time", np.nan) for e in failed],
        "seconds": [r.get("seconds", np.nan) for r in rows],
    }
    for name in ("note", "trajectory"):
        if any(name in r for r in rows):
            told[name] = [r.get(name, "") for r in rows]
    for name, said in told.items():
        attrs = {"long_name": ABOUT[name]} | ({"units": ABOUT_UNITS[name]} if name in ABOUT_UNITS else {})
        data[name] = variable(np.array(said, dtype=float if name in ABOUT_UNITS else object), (), attrs)
    coords: dict[str, Any] = {}
    for name, column in {**points.axes, **points.columns}.items():
        along = name if name in points.axes else SAMPLE
        coords[name] = (along,), np.asarray(labels(column)), unit(name)
        arrays = [v for v in column if isinstance(v, np.ndarray) and v.dtype.kind in "biuf"]
        if len(arrays) == len(column) and len({v.shape for v in arrays}) == 1:
            inner = tuple(f"{name}_{k}" for k in range(arrays[0].ndim))
            coords[f"{name}_values"] = (along, *inner), np.stack(arrays), unit(name)
    coords |= {name: ((), labels([value])[0], unit(name)) for name, value in points.fixed.items()}
    if points.columns:
        coords[SAMPLE] = np.arange(len(rows))
    plain = {k: v if isinstance(v, str | int | float) else json.dumps(v) for k, v in attributes.items()}
    return xr.Dataset(data, coords, {"format": FORMAT, **plain})


def _stack(values: list[Any]) -> np.ndarray:
    """Return values of equal shape as one array, NaN (and numbers for truth values) where one is missing."""
    arrays = [None if v is None else np.asarray(v) for v in values]
    present = [a for a in arrays if a is not None]
    gap = np.full(present[0].shape, np.nan)
    return np.stack([gap if a is None else a for a in arrays])


def import_writer() -> None:
    """Import what datasets and writing them take, which is long to import."""
    import xarray as xr

    xr.Dataset().to_netcdf(engine="h5netcdf")


def write(dataset: xr.Dataset, path: Path) -> None:
    """Write a dataset to a NetCDF file; a reader finds the earlier file or this one, never a part.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        dataset.to_netcdf(unfinished, engine="h5netcdf")
        with open(unfinished, "rb+") as file:
            os.fsync(file.fileno())
        os.replace(unfinished, path)
    except OSError as error:
        raise OutputError(f"cannot write '{path}': {error.strerror or error}") from None
    finally:
        unfinished.unlink(missing_ok=True)
