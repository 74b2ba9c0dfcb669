"""Figures of trajectories (matplotlib, without global state)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.storage import check_writable

if TYPE_CHECKING:
    from rodnet.trajectory import Trajectory

_MEASURED, _PREDICTED = "#0072b2", "#d55e00"  # told apart by colour-blind readers, too


def _figure(width: float, height: float) -> Any:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _views(x: np.ndarray) -> list[tuple[int, int]]:
    """The two coordinate planes that show most: the longest axis against each of the others."""
    spread = np.ptp(x.reshape(-1, 3), axis=0)
    main = int(np.argmax(spread))
    return [(main, k) for k in range(3) if k != main]


def plot_shapes(traj: Trajectory, path: str | Path, times: Any = None) -> Path:
    """Draw the shape at some instants in two views, and the position against time.

    Parameters
    ----------
    traj : Trajectory
        What to draw.
    path : path
        The PNG (or PDF, SVG) to write.
    times : array_like, optional
        Instants [s]; by default six, evenly spread.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    import matplotlib as mpl

    path = check_writable(path)
    times = np.linspace(traj.t[0], traj.t[-1], 6) if times is None else np.asarray(times, dtype=float)
    figure = _figure(8.0, 6.4)
    axes = figure.subplots(3, 1, height_ratios=[1.3, 1.3, 1.0])
    colors = mpl.colormaps["viridis"]
    scale = mpl.colors.Normalize(float(times.min()), float(max(times.max(), times.min() + 1e-9)))
    frames = [int(np.argmin(np.abs(traj.t - t))) for t in times]
    for ax, (i, j) in zip(axes[:2], _views(traj.x[frames]), strict=True):
        for k in frames:
            for rod in traj.rods.values():
                line = traj.x[k, rod.nodes] * 1e3
                width = 3.0 if rod.kind == "rigid" else 1.5
                ax.plot(
                    line[:, i], line[:, j], color=colors(scale(traj.t[k])), lw=width, solid_capstyle="round"
                )
        ax.set_xlabel(f"{'xyz'[i]} [mm]")
        ax.set_ylabel(f"{'xyz'[j]} [mm]")
        ax.set_aspect("equal", adjustable="datalim")
        ax.grid(alpha=0.25)
    figure.colorbar(mpl.cm.ScalarMappable(scale, colors), ax=axes[:2].tolist(), label="time [s]", pad=0.01)
    _position_axes(axes[2], traj)
    figure.savefig(path, dpi=150)
    return path


def _position_axes(ax: Any, traj: Trajectory) -> None:
    rod = next(iter(traj.rods.values()))
    centre = traj.x[:, rod.nodes].mean(axis=1)
    moved = centre - centre[0]
    direction = moved[-1] / max(float(np.linalg.norm(moved[-1])), 1e-300)
    along = moved @ direction * 1e3
    ax.plot(traj.t, along, color=_MEASURED, label=f"middle of '{rod.name}'")
    half = traj.t >= 0.5 * (traj.t[0] + traj.t[-1])
    if half.sum() > 2 and abs(along[-1]) > 0:
        slope, offset = np.polyfit(traj.t[half], along[half], 1)
        ax.plot(traj.t, slope * traj.t + offset, "--", color=_PREDICTED, lw=1, label=f"{slope:.4g} mm/s")
    ax.set_xlabel("time [s]")
    ax.set_ylabel("position [mm]")
    ax.legend(frameon=False)
    ax.grid(alpha=0.25)


def plot_position(traj: Trajectory, path: str | Path) -> Path:
    """Draw the distance that the robot's first part travels, against time, with its speed.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    path = check_writable(path)
    figure = _figure(7.0, 3.2)
    _position_axes(figure.subplots(), traj)
    figure.savefig(path, dpi=150)
    return path


def plot_comparison(
    path: str | Path,
    t: np.ndarray,
    measured: np.ndarray,
    predicted: np.ndarray,
    marker_edges: np.ndarray,
    title: str = "",
) -> Path:
    """Draw measured and predicted shapes together, and the distance of every marker over time.

    Parameters
    ----------
    path : path
        The PNG to write.
    t : ndarray, shape (T,)
        Times [s].
    measured, predicted : ndarray, shape (T, M, 3)
        Marker positions [m]; NaN where a marker was lost.
    marker_edges : ndarray, shape (E, 2)
        Pairs of markers that are joined.
    title : str
        Title of the figure.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    path = check_writable(path)
    figure = _figure(10.0, 7.2)
    grid = figure.add_gridspec(3, 3, height_ratios=[1, 1, 0.9])
    frames = np.linspace(0, len(t) - 1, 6).round().astype(int)
    i, j = (0, 2) if np.nanstd(measured[..., 0]) >= np.nanstd(measured[..., 1]) else (1, 2)
    everything = np.concatenate([measured.reshape(-1, 3), predicted.reshape(-1, 3)])
    low, high = np.nanmin(everything, axis=0) * 1e3 - 30.0, np.nanmax(everything, axis=0) * 1e3 + 30.0
    for n, k in enumerate(frames):
        ax = figure.add_subplot(grid[n // 3, n % 3])
        for values, color, name in ((measured, _MEASURED, "measured"), (predicted, _PREDICTED, "simulated")):
            for e, (a, b) in enumerate(marker_edges):
                line = values[k, [a, b]] * 1e3
                label = None if e else name
                ax.plot(line[:, i], line[:, j], "-o", color=color, ms=3, lw=1.6, label=label)
        ax.set_title(f"t = {t[k]:.2f} s", fontsize=10)
        ax.set_xlim(low[i], high[i])
        ax.set_ylim(low[j], high[j])
        ax.set_aspect("equal")
        ax.grid(alpha=0.25)
        ax.set_xlabel(f"{'xyz'[i]} [mm]")
        ax.set_ylabel(f"{'xyz'[j]} [mm]")
        if n == 0:
            ax.legend(frameon=False, fontsize=9)
    ax = figure.add_subplot(grid[2, :])
    distance = np.linalg.norm(predicted - measured, axis=2) * 1e3
    for m in range(distance.shape[1]):
        ax.plot(t, distance[:, m], lw=0.8, color="0.7")
    moving = distance[:, np.nanmax(distance, axis=0) > 1.0]
    if moving.size:
        ax.plot(t, np.nanmean(moving, axis=1), color="k", lw=2, label="mean over free markers")
        ax.legend(frameon=False)
    ax.set_xlabel("time [s]")
    ax.set_ylabel("distance per marker [mm]")
    ax.set_xlim(t[0], t[-1])
    ax.set_ylim(bottom=0)
    ax.grid(alpha=0.25)
    if title:
        figure.suptitle(title, fontsize=11)
    figure.savefig(path, dpi=130)
    return path
