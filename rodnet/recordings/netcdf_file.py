"""Recordings in NetCDF."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from rodnet.errors import RecordingError
from rodnet.recordings.noise import NoiseModel
from rodnet.recordings.recording import Recording
from rodnet.recordings.units import METRES, SECONDS, unit_factor


def read_nc(path: Path) -> dict[str, Any]:
    """Read a dataset as `write_nc` writes it."""
    import xarray

    with xarray.open_dataset(path, engine="h5netcdf") as data:
        data.load()
    missing = {"time", "position"} - set(data.variables)
    if missing:
        raise RecordingError(
            f"recording '{path}' lacks {', '.join(sorted(missing))}; it has {', '.join(map(str, data.variables))}"
        )
    scale = unit_factor(path, "position", str(data["position"].attrs.get("units", "")), METRES)
    t = data["time"].to_numpy() * unit_factor(path, "time", str(data["time"].attrs.get("unit", "")), SECONDS)
    known = {"position", "edges", "prescribed", "suspect"}
    parts: dict[str, Any] = {
        "t": t,
        "markers": data["position"].transpose("time", "marker", "axis").to_numpy(),
        "scale": scale,
        "channels": {
            k: v.to_numpy() for k, v in data.data_vars.items() if k not in known and v.dims[:1] == ("time",)
        },
        "attrs": {
            k: v.to_numpy() for k, v in data.data_vars.items() if k not in known and v.dims[:1] != ("time",)
        },
    }
    if "marker" in data.coords:
        parts["names"] = [str(n) for n in data["marker"].to_numpy()]
    for key in ("edges", "prescribed", "suspect"):
        if key in data:
            parts[key] = data[key].to_numpy()
    own = json.loads(data.attrs.get("rodnet", "{}"))
    parts["attrs"].update(own.get("attrs", {}))
    if "noise" in own:
        parts["noise"] = NoiseModel.from_dict(own["noise"])
    return {**parts, "group": own.get("group", ""), "planar": own.get("planar", False)}


def write_nc(rec: Recording, path: Path) -> None:
    """Write an xarray dataset."""
    import xarray

    variables: dict[str, Any] = {
        "position": (("time", "marker", "axis"), rec.markers, {"units": "m"}),
        "suspect": (("time", "marker"), rec.suspect.astype(np.int8)),
    }
    if len(rec.edges):
        variables["edges"] = (("edge", "end"), rec.edges)
    if len(rec.prescribed):
        variables["prescribed"] = (("held",), rec.prescribed)
    for key, channel in rec.channels.items():
        array = np.asarray(channel)
        variables[key] = (("time", *(f"{key}_{k}" for k in range(1, array.ndim))), array)
    plain = {}
    for key, value in rec.attrs.items():
        if isinstance(value, np.ndarray) and value.ndim:
            variables[key] = (tuple(f"{key}_{k}" for k in range(value.ndim)), value)
        else:
            plain[key] = value.item() if isinstance(value, np.ndarray | np.generic) else value
    own = {"group": rec.told_group, "planar": rec.planar, "attrs": plain}
    if rec.noise is not None:
        own["noise"] = rec.noise.to_dict()
    data = xarray.Dataset(
        variables,
        coords={"time": ("time", rec.t, {"unit": "s"}), "marker": list(rec.names), "axis": list("xyz")},
        attrs={"rodnet": json.dumps(own)},
    )
    data.to_netcdf(path, engine="h5netcdf")
