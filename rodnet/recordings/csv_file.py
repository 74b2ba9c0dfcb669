"""Recordings in tables (CSV), wide or long."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from rodnet.errors import OutputError, RecordingError
from rodnet.recordings.noise import NoiseModel
from rodnet.recordings.recording import Recording
from rodnet.recordings.units import METRES, SECONDS, unit_factor

AXES = (".x", ".y", ".z", "_x", "_y", "_z")  # ends of names of markers' columns
MARK = "# rodnet-recording "


def read_csv(path: Path) -> dict[str, Any]:
    """Read a table with one row for each frame, or for each marker and frame."""
    import pandas

    extra: dict[str, Any] = {}
    with path.open(encoding="utf-8-sig") as file:
        first = file.readline()
    if first.startswith(MARK):
        extra = json.loads(first[len(MARK) :])
    table = pandas.read_csv(path, comment="#", skipinitialspace=True, encoding="utf-8-sig")
    columns: dict[str, tuple[np.ndarray, str]] = {}
    for title in table.columns:
        name, _, unit = str(title).partition("[")
        columns[name.strip()] = (table[title].to_numpy(), unit.rstrip("] ").strip())
    times = next((columns.pop(n) for n in ("t", "time", "Time", "T") if n in columns), None)
    if times is None:
        raise RecordingError(f"recording '{path}' has no column 't'; it has {', '.join(columns)}")
    t = _number(path, "t", times[0]) * unit_factor(path, "t", times[1], SECONDS)
    if {"marker", "x", "y", "z"} <= set(columns):
        parts = _long(path, t, columns)
    else:
        parts = _wide(path, t, columns)
    attrs = {k: np.asarray(v) if isinstance(v, list) else v for k, v in extra.pop("attrs", {}).items()}
    suspect = extra.pop("suspect", None)
    if suspect is not None:
        flags = np.zeros(parts["markers"].shape[:2], dtype=bool)
        flags[tuple(np.array(suspect, dtype=np.int64).reshape(-1, 2).T)] = True
        parts["suspect"] = flags
    if "noise" in extra:
        parts["noise"] = NoiseModel.from_dict(extra["noise"])
    return {
        **parts,
        "attrs": attrs,
        **{k: v for k, v in extra.items() if k in ("edges", "prescribed", "group", "planar")},
    }


def _wide(path: Path, t: np.ndarray, columns: dict[str, tuple[np.ndarray, str]]) -> dict[str, Any]:
    names = list(dict.fromkeys(n[:-2] for n in columns if n[-2:] in AXES))
    markers, scales = [], []
    for name in names:
        found, factors = [], []
        for axis in "xyz":
            key = next((f"{name}{mark}{axis}" for mark in "._" if f"{name}{mark}{axis}" in columns), None)
            if key is None:
                raise RecordingError(f"recording '{path}': marker '{name}' has no column '{name}.{axis}'")
            values, unit = columns.pop(key)
            found.append(_number(path, key, values))
            factors.append(unit_factor(path, key, unit, METRES))
        markers.append(np.stack(found, axis=1))
        scales.append(factors)
    if not markers:
        raise RecordingError(
            f"recording '{path}' has no markers: name columns NAME.x, NAME.y, NAME.z, or marker, x, y, z"
        )
    channels = {k: v for k, (v, _) in columns.items()}
    return {
        "t": t, "markers": np.stack(markers, axis=1), "scale": np.array(scales), "names": names, "channels": channels,
    }  # fmt: skip


def _long(path: Path, t: np.ndarray, columns: dict[str, tuple[np.ndarray, str]]) -> dict[str, Any]:
    labels = [str(v) for v in columns.pop("marker")[0]]
    names = list(dict.fromkeys(labels))
    frames, frame = np.unique(t, return_inverse=True)
    which = np.array([names.index(v) for v in labels])
    markers = np.full((len(frames), len(names), 3), np.nan)
    if len(set(zip(frame.tolist(), which.tolist(), strict=True))) < len(which):
        raise RecordingError(f"recording '{path}' gives a marker twice at one time")
    scale = np.ones(3)
    for k, axis in enumerate("xyz"):
        values, unit = columns.pop(axis)
        markers[frame, which, k] = _number(path, axis, values)
        scale[k] = unit_factor(path, axis, unit, METRES)
    first = np.unique(frame, return_index=True)[1]
    channels = {k: v[first] for k, (v, _) in columns.items()}
    return {"t": frames, "markers": markers, "scale": scale, "names": names, "channels": channels}


def _number(path: Path, name: str, values: np.ndarray) -> np.ndarray:
    try:
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        bad = next(v for v in values if not _is_number(v))
        raise RecordingError(f"recording '{path}': column '{name}' has {bad!r}, which is no number") from None


def _is_number(value: Any) -> bool:
    try:
        float(value)
    except (TypeError, ValueError):
        return False
    return True


def write_csv(rec: Recording, path: Path) -> None:
    """Write one row for each frame; what is no column stands in a first line of JSON."""
    import pandas

    for name in (*rec.names, *rec.channels):
        if set(name) & set("#[") or name != name.strip():
            raise OutputError(
                f"{name!r} cannot be a column's name in a table, where # begins a comment and [ a unit; give it "
                "another name, or write it to .npz or .nc"
            )
    columns: dict[str, np.ndarray] = {"t [s]": rec.t}
    for m, name in enumerate(rec.names):
        for k, axis in enumerate("xyz"):
            columns[f"{name}.{axis} [m]"] = rec.markers[:, m, k]
    for key, channel in rec.channels.items():
        if np.ndim(channel) > 1:
            raise OutputError(f"channel '{key}' has {np.ndim(channel)} dimensions; write it to .npz or .nc")
        if key in columns or key in ("t", "time", "marker", "x", "y", "z") or key[-2:] in AXES:
            raise OutputError(
                f"in a table channel '{key}' would be read as something else (markers are NAME.x or NAME_x); give it "
                "another name, or write it to .npz or .nc"
            )
        columns[key] = np.asarray(channel)
    extra = {
        "edges": rec.edges.tolist(),
        "prescribed": rec.prescribed.tolist(),
        "suspect": np.argwhere(rec.suspect).tolist(),
        "group": rec.told_group,
        "planar": rec.planar,
        "attrs": {
            k: v.tolist() if isinstance(v, np.ndarray | np.generic) else v for k, v in rec.attrs.items()
        },
    }
    if rec.noise is not None:
        extra["noise"] = rec.noise.to_dict()
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(MARK + json.dumps(extra) + "\n")
        pandas.DataFrame(columns).to_csv(file, index=False, float_format="%.17g")
