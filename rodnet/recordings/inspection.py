"""What is in a recording: channels, rate, gaps, noise, rest, constancy of edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import RecordingError
from rodnet.recordings.estimate import NoiseEstimate, arc_lengths, estimate_noise
from rodnet.recordings.recording import Recording
from rodnet.recordings.rest import rest_stretches

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rodnet.report.page import Page


@dataclass(frozen=True)
class Inspection:
    """What trials of one kind hold, in numbers.

    Attributes
    ----------
    recordings : tuple of Recording
        The trials.
    files : list of dict
        Of each trial: ``name``, ``group``, ``frames``, ``seconds``, ``rate_hz``, ``steps_missing`` (frames left out of
        an even grid), ``lost`` and ``suspect`` (shares), ``longest_gap_s``, ``starts_at_rest``, ``start_speed`` [m/s],
        ``rest_s``, ``breathing_mm`` (largest standard deviation of an edge), ``channels``.
    noise : NoiseEstimate or None
        None if the trials are too short to tell.
    remarks : list of str
        What needs attention before a model is blamed.
    unknown : str
        Why the noise cannot be told, which is among the remarks; empty if it can.
    """

    recordings: tuple[Recording, ...]
    files: list[dict[str, Any]]
    noise: NoiseEstimate | None
    remarks: list[str]
    unknown: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return everything as JSON takes it."""
        noise = None
        if self.noise is not None:
            noise = {
                **self.noise.model.to_dict(),
                "breathing": self.noise.breathing.tolist(),
                "rest": self.noise.rest,
                "effective_frames": self.noise.effective,
                "notes": list(self.noise.notes),
            }
        return {"files": self.files, "noise": noise, "remarks": self.remarks}

    def page(self) -> Page:
        """Return a page with tables and figures."""
        from rodnet.report.page import Page

        rec = self.recordings[0]
        many = len(self.recordings) > 1
        page = Page(f"Recordings: {rec.path.parent.name if many and rec.path else rec.name}")
        held = ", ".join(rec.names[int(m)] for m in rec.prescribed) or "none"
        page.text(
            f"{len(self.recordings)} trial{'s' * many}, {len(rec.names)} markers ({', '.join(rec.names)}), "
            f"prescribed: {held}; channels: {', '.join(rec.channels) or 'none'}; "
            f"attributes: {', '.join(rec.attrs) or 'none'}."
        )
        if self.remarks:
            page.heading("Look at this first")
            page.items(self.remarks)
        page.heading("Trials")
        keys = [k for k in self.files[0] if k != "channels"]
        page.table([k.replace("_", " ") for k in keys], [[f[k] for k in keys] for f in self.files])
        if self.noise is not None:
            model, count = self.noise.model, len(rec.names)
            page.heading("Noise")
            page.text(
                f"White: {1e3 * np.median(model.white):.3f} mm a coordinate. "
                f"Slow: {1e3 * np.median(model.slow):.2f} mm, correlated over {model.time:.2g} s. "
                f"Common to all: {1e3 * model.common:.2f} mm. "
                f"Of {len(rec.t)} frames, {self.noise.effective:.0f} are worth counting for a constant."
            )
            page.items(self.noise.notes)
            rows = zip(
                rec.names,
                *(np.broadcast_to(1e3 * np.asarray(v), count) for v in (model.white, model.slow)),
                strict=True,
            )
            page.table(["marker", "white (mm)", "slow (mm)"], [[n, float(w), float(s)] for n, w, s in rows])
        page.heading("Pictures")
        for figure, caption in self.figures():
            page.figure(figure, caption)
        return page

    def figures(self, most: int = 4) -> list[tuple[Figure, str]]:
        """Return figures with captions, of the first ``most`` trials."""
        import matplotlib.pyplot as plt

        found = []
        for rec in self.recordings[:most]:
            figure, axes = plt.subplots(2, 2, figsize=(11, 7), layout="constrained")
            _draw(rec, axes)
            figure.suptitle(rec.name)
            found.append((figure, f"{rec.name}: paths, heights, speeds, arc lengths between neighbours"))
        return found

    def save(self, path: str | Path) -> Path:
        """Write the page."""
        return self.page().save(path)


def inspect(recordings: Recording | Sequence[Recording]) -> Inspection:
    """Look at trials of one kind before a model does.

    Parameters
    ----------
    recordings : Recording or sequence of Recording
        As `rodnet.read_recordings` returns them.

    Returns
    -------
    Inspection

    Raises
    ------
    RecordingError
        If there is none.
    """
    trials = [recordings] if isinstance(recordings, Recording) else list(recordings)
    if not trials:
        raise RecordingError("inspect needs at least one recording")
    remarks: list[str] = []
    unknown = ""
    try:
        noise: NoiseEstimate | None = estimate_noise(trials)
    except RecordingError as error:
        noise, unknown = None, str(error)
        remarks.append(unknown)
    files = [_describe(rec, remarks) for rec in trials]
    return Inspection(tuple(trials), files, noise, remarks, unknown)


def _describe(rec: Recording, remarks: list[str]) -> dict[str, Any]:
    """Numbers of one trial, and what is odd about it."""
    seen = np.isfinite(rec.markers[..., 0])
    step = 1.0 / rec.rate
    missing = int(np.sum(np.round(np.diff(rec.t) / step) - 1))
    rest = rest_stretches(rec)
    try:
        speed = float(np.linalg.norm(rec.first_frames()[1], axis=1).max())
    except RecordingError as error:
        speed = float("nan")
        remarks.append(str(error))
    breathing = float("nan")
    if len(rec.edges):
        arcs = arc_lengths(rec)
    if len(rec.edges) and np.isfinite(arcs).any():  # some edge was seen whole
        breathing = float(1e3 * np.nanmax(np.nanstd(arcs, axis=0)))
        mean = np.nanmean(arcs, axis=0)
        worst = int(np.nanargmax(np.nanstd(arcs, axis=0) / mean))
        if np.nanstd(arcs[:, worst]) > 0.05 * mean[worst]:
            i, j = rec.edges[worst]
            remarks.append(
                f"{rec.name}: the distance of markers {rec.names[i]} and {rec.names[j]} varies by "
                f"{100 * np.nanstd(arcs[:, worst]) / mean[worst]:.0f} %: they slip, are swapped, or the rod stretches"
            )
    if rec.suspect[:2].any():
        which = ", ".join(rec.names[int(m)] for m in np.flatnonzero(rec.suspect[:2].any(axis=0)))
        remarks.append(
            f"{rec.name}: the first two frames of marker {which} are suspect; a start from them is spoilt"
        )
    if missing:
        remarks.append(f"{rec.name}: {missing} frames are missing from an even grid of {step:.4g} s")
    starts = bool(rest and rest[0][0] == 0)
    return {
        "name": rec.name,
        "group": rec.group,
        "frames": len(rec.t),
        "seconds": rec.duration,
        "rate_hz": rec.rate,
        "steps_missing": missing,
        "lost": float(1.0 - seen.mean()),
        "suspect": float(rec.suspect.mean()),
        "longest_gap_s": _longest_gap(rec),
        "starts_at_rest": starts,
        "start_speed": speed,
        "rest_s": float(sum(rec.t[b - 1] - rec.t[a] for a, b in rest)),
        "breathing_mm": breathing,
        "channels": {k: list(np.shape(v)) for k, v in rec.channels.items()},
    }


def _longest_gap(rec: Recording) -> float:
    """Longest time without a marker [s]."""
    longest = 0.0
    for m in range(len(rec.names)):
        good = rec.t[np.isfinite(rec.trusted[:, m, 0])]
        ends = np.concatenate([[rec.t[0]], good, [rec.t[-1]]])
        gap = float(np.diff(ends).max())
        longest = max(longest, gap if gap > 1.5 / rec.rate else 0.0)
    return longest


def _draw(rec: Recording, axes: np.ndarray) -> None:
    """Paths from the side, heights, speeds and arc lengths of one trial."""
    x, t = rec.trusted, rec.t
    spread = np.nanmax(x, axis=(0, 1)) - np.nanmin(x, axis=(0, 1))
    side = 0 if spread[0] >= spread[1] else 1
    for k in np.linspace(0, len(t) - 1, 7).astype(int):
        for i, j in rec.edges:
            axes[0, 0].plot(x[k, [i, j], side], x[k, [i, j], 2], color=str(0.85 - 0.75 * k / len(t)), lw=0.8)
        if not len(rec.edges):
            axes[0, 0].plot(x[k, :, side], x[k, :, 2], ".", color=str(0.85 - 0.75 * k / len(t)))
    axes[0, 0].set(
        xlabel="xy"[side] + " (m)", ylabel="z (m)", title="shapes, later ones darker", aspect="equal"
    )
    axes[0, 1].plot(t, x[..., 2], lw=0.8)
    axes[0, 1].set(xlabel="t (s)", ylabel="z (m)", title="height of the markers")
    speed = np.linalg.norm(np.diff(x, axis=0), axis=2) / np.diff(t)[:, None]
    axes[1, 0].plot(t[1:], speed, lw=0.6)
    axes[1, 0].set(xlabel="t (s)", ylabel="m/s", title="speeds")
    if len(rec.edges):
        arcs = arc_lengths(rec)
        axes[1, 1].plot(t, 1e3 * (arcs - np.nanmean(arcs, axis=0)), lw=0.6)
    axes[1, 1].set(xlabel="t (s)", ylabel="mm", title="arc lengths between neighbours, less their means")
