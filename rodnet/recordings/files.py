"""Reading and writing recordings: ``.npz``, ``.csv``, ``.nc`` and ``.c3d``. Nothing is ever unpickled."""

from __future__ import annotations

import glob
import json
import warnings
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rodnet.errors import OutputError, PlausibilityWarning, RecordingError
from rodnet.recordings.c3d_file import read_c3d
from rodnet.recordings.csv_file import read_csv, write_csv
from rodnet.recordings.netcdf_file import read_nc, write_nc
from rodnet.recordings.npz_file import read_npz, write_npz
from rodnet.recordings.recording import Recording, natural_key
from rodnet.recordings.units import METRES

SLOWEST = 1.0  # [s] frames this far apart may be milliseconds: 33 for 0.033
META = ("meta.json", "case.json")  # what is known of the set in a folder
READERS = {".npz": read_npz, ".csv": read_csv, ".nc": read_nc, ".c3d": read_c3d}
WRITERS = {".npz": write_npz, ".csv": write_csv, ".nc": write_nc}


def read_recording(path: str | Path, units: str | None = None) -> Recording:
    """Read one trial from a file.

    Parameters
    ----------
    path : str or Path
        By its suffix:

        - ``.npz`` with arrays ``t`` (T,) [s] and ``markers`` (T, M, 3), or (T, M, 2) of x and z in a vertical
          plane, optionally ``names``, ``edges``,
          ``prescribed``, ``suspect``, ``group``; every other array of T rows is a channel, the rest are attributes;
        - ``.csv`` with a column ``t`` (or ``time``) and either columns ``NAME.x``, ``NAME.y``, ``NAME.z``
          (wide) or ``marker``, ``x``, ``y``, ``z`` (long: one row for each marker and frame); other columns are
          channels. Units may stand behind a name: ``tip.x [mm]``, ``t [ms]``;
        - ``.nc`` (NetCDF) as `Recording.save` writes it: dimensions ``time``, ``marker``, ``axis``;
        - ``.c3d`` of a motion capture system.

        A ``meta.json`` or ``case.json`` in the same folder becomes `Recording.meta`.
    units : str, optional
        Unit of the positions, "m", "cm", "mm" or "um"; by default what the file says, else metres.

    Raises
    ------
    RecordingError
        If there is no such file, it is broken, holds Python objects, or cannot be what was measured.
    """
    path = Path(path)
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise RecordingError(f"recording '{path}': unknown suffix; rodnet reads {', '.join(READERS)}")
    if not path.is_file():
        raise RecordingError(f"there is no recording '{path}'")
    if units is not None and units not in METRES:
        raise RecordingError(f"units = {units!r} is not one of {', '.join(METRES)}")
    try:
        parts = reader(path)
    except RecordingError:
        raise
    except (
        OSError,
        ValueError,
        KeyError,
        TypeError,
        EOFError,
        MemoryError,
        zipfile.BadZipFile,
        RuntimeError,
    ) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise RecordingError(f"cannot read the recording '{path}': {reason}") from None
    scale = METRES[units] if units is not None else parts.pop("scale", 1.0)
    parts.pop("scale", None)
    parts["markers"] = np.asarray(parts["markers"], dtype=float) * scale
    meta = {**_meta(path), **parts.pop("meta", {})}
    group = str(parts.pop("group", "") or _group(meta, path))
    rec = Recording(**parts, meta=meta, group=group, name=path.stem, path=path)
    if 1.0 / rec.rate >= SLOWEST:
        warnings.warn(
            f"the frames of '{path}' are {1.0 / rec.rate:.3g} s apart; if its times are in milliseconds, divide them "
            "by 1000",
            PlausibilityWarning, stacklevel=2,
        )  # fmt: skip
    return rec


def read_recordings(paths: str | Path | Iterable[str | Path], units: str | None = None) -> list[Recording]:
    """Read several trials: files, folders, and patterns such as ``"day1/*.npz"``, in counting order.

    Raises
    ------
    RecordingError
        If a path matches nothing, or for the first file that cannot be read.
    """
    return [read_recording(path, units) for path in find_recordings(paths)]


def as_recordings(given: Any) -> list[Recording]:
    """Trials as they are given, one or several, or read from paths.

    Raises
    ------
    RecordingError
        As by `read_recordings`.
    """
    if isinstance(given, Recording):
        return [given]
    if not isinstance(given, str | Path):
        given = list(given)
        if all(isinstance(g, Recording) for g in given):
            return given
    return read_recordings(given)


def find_recordings(paths: str | Path | Iterable[str | Path]) -> list[Path]:
    """Files that paths, folders and patterns stand for, each once."""
    found: list[Path] = []
    for given in [paths] if isinstance(paths, str | Path) else list(paths):
        path = Path(given)
        if path.is_dir():
            matches = [p for p in path.iterdir() if p.suffix.lower() in READERS]
        elif path.is_file():
            matches = [path]
        else:
            matches = [Path(p) for p in glob.glob(str(given), recursive=True)]
        if not matches:
            raise RecordingError(f"there is no recording at '{given}' ({', '.join(READERS)})")
        found += sorted(matches, key=lambda p: natural_key(str(p)))
    return list(dict.fromkeys(found))


def write_recording(rec: Recording, path: str | Path) -> Path:
    """Write a recording by the suffix of ``path``: ``.npz``, ``.csv`` or ``.nc``."""
    path = Path(path)
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        raise OutputError(f"cannot write a recording to '{path}': the suffix must be {', '.join(WRITERS)}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        writer(rec, path)
    except OSError as error:
        raise OutputError(f"cannot write '{path}': {error}") from None
    return path


def _meta(path: Path) -> dict[str, Any]:
    for name in META:
        beside = path.parent / name
        if beside.is_file():
            try:
                found = json.loads(beside.read_text(encoding="utf-8-sig"))
            except (OSError, ValueError, RecursionError) as error:
                raise RecordingError(f"cannot read '{beside}': {error}") from None
            if not isinstance(found, dict):
                raise RecordingError(f"'{beside}' must be a JSON object")
            return found
    return {}


def _group(meta: Mapping[str, Any], path: Path) -> str:
    """Group of a file as its set's ``groups`` has it: {group: [names of files]}; else each is its own."""
    groups = meta.get("groups")
    if isinstance(groups, Mapping):
        for group, files in groups.items():
            if isinstance(files, list) and path.name in files:
                return str(group)
    return path.stem
