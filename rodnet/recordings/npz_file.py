"""Recordings in NumPy's ``.npz``."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rodnet.errors import OutputError, RecordingError
from rodnet.recordings.noise import NoiseModel
from rodnet.recordings.recording import PLANE, Recording

LARGEST_FILE = 4 << 30  # bytes, unpacked
NOISE = "noise_model"
OWN = ("names", "edges", "prescribed", "suspect", "group", NOISE)
NOT_FREE = {*OWN, "t", "markers", "file", "allow_pickle"}  # the last two are arguments of NumPy's


def read_npz(path: Path) -> dict[str, Any]:
    """Read arrays; those of Python objects are refused."""
    with zipfile.ZipFile(path) as archive:
        size = sum(item.file_size for item in archive.infolist())
    if size > LARGEST_FILE:
        raise RecordingError(f"recording '{path}' unpacks to {size / 2**30:.1f} GB; cut it into trials")
    with np.load(path, allow_pickle=False) as file:
        arrays = {}
        for key in file.files:
            try:
                arrays[key] = file[key]
            except ValueError as error:
                if "pickle" not in str(error).lower():
                    raise
                raise RecordingError(
                    f"recording '{path}': '{key}' holds Python objects, which rodnet never loads; save it as numbers"
                ) from None
    return _sort(path, arrays)


def _sort(path: Path, arrays: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Tell channels from attributes by the number of rows."""
    missing = {"t", "markers"} - set(arrays)
    if missing:
        raise RecordingError(
            f"recording '{path}' lacks {' and '.join(sorted(missing))}; it has {', '.join(arrays) or 'nothing'}"
        )
    parts: dict[str, Any] = {"t": arrays["t"], "markers": arrays["markers"], "channels": {}, "attrs": {}}
    frames = len(arrays["t"]) if np.ndim(arrays["t"]) else 0
    for key, array in arrays.items():
        if key in ("t", "markers"):
            continue
        if key == "names":
            parts[key] = [str(n) for n in np.atleast_1d(array)]
        elif key == NOISE:
            parts["noise"] = NoiseModel.from_dict(json.loads(str(array)))
        elif key == "group":
            parts[key] = str(array)
        elif key in OWN:
            parts[key] = array
        elif array.ndim and len(array) == frames:
            parts["channels"][key] = array
        else:
            parts["attrs"][key] = array.item() if array.ndim == 0 else array
    return parts


def write_npz(rec: Recording, path: Path) -> None:
    """Write arrays, compressed."""
    taken = (NOT_FREE & {*rec.channels, *rec.attrs}) | (set(rec.channels) & set(rec.attrs))
    if taken:
        raise OutputError(f"'{path}': a channel or attribute cannot be named {', '.join(sorted(taken))}")
    attrs: dict[str, Any] = {k: np.asarray(v) for k, v in rec.attrs.items()}
    channels: dict[str, Any] = {k: np.asarray(v) for k, v in rec.channels.items()}
    odd = [k for k, v in attrs.items() if v.dtype == object]
    if odd:
        raise OutputError(f"'{path}': the attribute '{odd[0]}' is no number, word or array of them")
    markers = rec.markers[..., PLANE] if rec.planar else rec.markers
    if rec.noise is not None:
        attrs[NOISE] = np.array(json.dumps(rec.noise.to_dict()))
    np.savez_compressed(
        path, t=rec.t, markers=markers, names=np.array(rec.names), edges=rec.edges, prescribed=rec.prescribed,
        suspect=rec.suspect, group=np.array(rec.told_group), **channels, **attrs,
    )  # fmt: skip
