"""Recordings of motion capture systems (C3D)."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from rodnet.errors import RecordingError
from rodnet.recordings.units import METRES, unit_factor


def read_c3d(path: Path) -> dict[str, Any]:
    """Read the markers of a motion capture file; analogue channels run at another rate and stay there."""
    import c3d

    try:
        with warnings.catch_warnings(), path.open("rb") as file:
            warnings.simplefilter("ignore")  # it remarks on missing analogue channels
            reader = c3d.Reader(file)
            frames = [(points, analog) for _, points, analog in reader.read_frames(copy=True)]
            labels = [str(label).strip() for label in reader.point_labels]
            rate, unit = (
                float(reader.point_rate),
                str(reader.get_string("POINT:UNITS") or "mm").strip().lower(),
            )
    except Exception as error:  # of a broken file the library raises whatever it runs into
        raise RecordingError(f"cannot read the recording '{path}': {type(error).__name__}: {error}") from None
    if not frames or not rate > 0.0:
        raise RecordingError(f"recording '{path}' has no frames, or no frame rate")
    points = np.stack([p for p, _ in frames]).astype(float)
    x = points[..., :3]
    x[points[..., 3] < 0.0] = np.nan  # the format's mark of a lost marker
    seen = np.isfinite(x).all(axis=2).any(axis=0)  # systems write empty tracks
    return {
        "t": np.arange(len(x)) / rate,
        "markers": x[:, seen],
        "names": [label for label, s in zip(labels, seen, strict=False) if s],
        "scale": unit_factor(path, "POINT", unit, METRES),
    }
