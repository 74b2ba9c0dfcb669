"""Figures of trajectories (matplotlib, without its global state or a display)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.storage import check_writable
from rodnet.viz.comparison import check_comparison

if TYPE_CHECKING:
    from rodnet.trajectory import Trajectory

# told apart by colour-blind readers, too (Okabe and Ito 2008)
MEASURED, PREDICTED, THIRD = "#0072b2", "#d55e00", "#009e73"
FLAT = 0.01  # a view in which the robot is flatter than this share of its length shows nothing
FAR = 3.0  # a way of so many lengths of the robot would leave its shapes too small to see


def _figure(width: float, height: float) -> Any:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _unit(length: float) -> tuple[str, float]:
    """Unit of lengths up to ``length`` [m], and how many of them are a metre."""
    return ("m", 1.0) if length > 3.0 else ("mm", 1e3)


def _nearest(t: np.ndarray, times: Any) -> list[int]:
    """Indices of the entries of ``t`` nearest to ``times``, each once."""
    wanted = np.atleast_1d(np.asarray(times, dtype=float))
    return list(dict.fromkeys(int(np.argmin(np.abs(t - time))) for time in wanted))


def _views(x: np.ndarray) -> list[tuple[int, int]]:
    """Axes (horizontal, vertical) of the views that show something, z upright; shape (..., 3)."""
    spread = np.ptp(x.reshape(-1, 3), axis=0)
    main = int(np.argmax(spread))
    pairs = [(k, 2) for k in (0, 1)] if main == 2 else [(main, k) for k in range(3) if k != main]
    other = [i + j - main for i, j in pairs]
    good = [pair for pair, k in zip(pairs, other, strict=True) if spread[k] > FLAT * spread[main]]
    return good or pairs[:1]


def _tidy(ax: Any) -> None:
    ax.grid(alpha=0.25, lw=0.6)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


# -- the shape over time --------------------------------------------------------------------
def plot_shapes(traj: Trajectory, path: str | Path, times: Any = None) -> Path:
    """Draw the shape at some instants, and the position against time.

    Two views along the axes (one, if the motion is plane), stiff parts thicker. Of a robot that
    travels far the shapes are drawn from its centre; the way is in the last panel.

    Parameters
    ----------
    traj : Trajectory
        What to draw.
    path : path
        The PNG (or PDF, SVG) to write.
    times : array_like, optional
        Instants [s]; by default six, evenly spread. The nearest recorded states are shown.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    import matplotlib as mpl

    path = check_writable(path)
    frames = _nearest(traj.t, np.linspace(traj.t[0], traj.t[-1], 6) if times is None else times)
    x = traj.x[frames]
    size = float(np.linalg.norm(np.ptp(x[0], axis=0)))
    far = np.linalg.norm(np.ptp(x.reshape(-1, 3), axis=0)) > FAR * size
    if far:
        x = x - x.mean(axis=1, keepdims=True)
    unit, scale = _unit(float(np.abs(x).max()))
    views = _views(x)
    spread = np.ptp(x.reshape(-1, 3), axis=0)
    wide = all(spread[j] < 0.6 * spread[i] for i, j in views)
    # flat views below each other, tall ones side by side
    tall = max(spread[j] / max(spread[i], 0.01 * spread[j]) for i, j in views)
    heights = [2.3] * len(views) if wide else [min(6.2 / len(views) * tall, 4.2) + 0.6]
    figure = _figure(8.0, sum(heights) + 2.3)
    grid = figure.add_gridspec(len(heights) + 1, 1 if wide else len(views), height_ratios=[*heights, 2.3])
    # the light end of the colour map would be lost on white
    colors = mpl.colors.ListedColormap(mpl.colormaps["viridis"](np.linspace(0.0, 0.9, 256)))
    last = max(float(traj.t[frames].max()), float(traj.t[frames].min()) + 1e-9)
    norm = mpl.colors.Normalize(float(traj.t[frames].min()), last)
    axes = [figure.add_subplot(grid[k, 0] if wide else grid[0, k]) for k in range(len(views))]
    for ax, (i, j) in zip(axes, views, strict=True):
        for k, shape in zip(frames, x * scale, strict=True):
            for rod in traj.rods.values():
                width = 3.6 if rod.kind == "rigid" else 1.5
                style = {"color": colors(norm(traj.t[k])), "lw": width, "solid_capstyle": "round"}
                ax.plot(shape[rod.nodes, i], shape[rod.nodes, j], **style)
        where = " from centre" if far else ""
        ax.set_xlabel(f"{'xyz'[i]}{where} [{unit}]")
        ax.set_ylabel(f"{'xyz'[j]}{where} [{unit}]")
        if not wide:  # a view that shows little is flat, but not a line
            middle = x.reshape(-1, 3).min(axis=0) + 0.5 * spread
            ax.set_xlim(*scale * (middle[i] + max(0.55 * spread[i], 0.2 * spread[j]) * np.array([-1.0, 1.0])))
            ax.set_ylim(*scale * (middle[j] + max(0.55 * spread[j], 0.2 * spread[i]) * np.array([-1.0, 1.0])))
        ax.set_aspect("equal", adjustable="datalim" if wide else "box")
        _tidy(ax)
    kinds = {rod.kind for rod in traj.rods.values()}
    if kinds >= {"rod", "rigid"}:
        handles = [
            mpl.lines.Line2D([], [], color="0.3", lw=w, label=label)
            for w, label in ((3.6, "stiff parts"), (1.5, "soft rods"))
        ]
        axes[0].legend(handles=handles, loc="upper right", fontsize=9)
    bar = figure.colorbar(mpl.cm.ScalarMappable(norm, colors), ax=axes, label="time [s]", pad=0.01)
    for k in frames:
        bar.ax.axhline(traj.t[k], color="w", lw=1.2)
    _position_axes(figure.add_subplot(grid[-1, :]), traj)
    figure.savefig(path, dpi=150)
    return path


# -- the position over time -----------------------------------------------------------------
def plot_position(traj: Trajectory, path: str | Path) -> Path:
    """Draw where the robot is against time.

    The middle of the first stiff part, or of the whole robot if it has none: along its way with the
    fitted speed if the robot travels, else all three coordinates.

    Parameters
    ----------
    traj : Trajectory
        What to draw.
    path : path
        The PNG (or PDF, SVG) to write.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    path = check_writable(path)
    figure = _figure(7.0, 3.4)
    _position_axes(figure.subplots(), traj)
    figure.savefig(path, dpi=150)
    return path


def _position_axes(ax: Any, traj: Trajectory) -> None:
    rod = next((r for r in traj.rods.values() if r.kind == "rigid"), None)
    centre = traj.x.mean(axis=1) if rod is None else traj.x[:, rod.nodes].mean(axis=1)
    what = "middle of the robot" if rod is None else f"middle of {rod.name}"
    moved = centre - centre[0]
    unit, scale = _unit(float(np.linalg.norm(np.ptp(centre, axis=0))))
    half = traj.t >= 0.5 * (traj.t[0] + traj.t[-1])
    ax.set_ylabel(f"displacement [{unit}]")
    if _travels(traj.t, moved):
        along = moved @ (moved[-1] / np.linalg.norm(moved[-1])) * scale
        ax.plot(traj.t, along, color=MEASURED, lw=2.0, label=f"{what}, along its way")
        slope, offset = np.polyfit(traj.t[half], along[half], 1)
        fit = f"{slope:.4g} {unit}/s (fit to the second half)"
        ax.plot(traj.t, slope * traj.t + offset, "--", color=PREDICTED, lw=1.2, label=fit)
        ax.set_ylim(*_limits(along))
    else:
        for k, color in enumerate((MEASURED, PREDICTED, THIRD)):
            ax.plot(
                traj.t,
                moved[:, k] * scale,
                color=color,
                lw=1.5,
                label=f"{'xyz'[k]} of the {what}" if k == 0 else "xyz"[k],
            )
        ax.set_ylim(*_limits(moved * scale))
    ax.set_xlabel("time [s]")
    if len(traj) > 1:
        ax.set_xlim(traj.t[0], traj.t[-1])
    ax.legend(frameon=False, fontsize=9, ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0), borderpad=0.0)
    _tidy(ax)


def _travels(t: np.ndarray, moved: np.ndarray) -> bool:
    """Whether the way is mostly a straight line in time, rather than a swing; shape (T, 3)."""
    way = float(np.linalg.norm(moved[-1]))
    if len(t) < 8 or not way > 0.0:
        return False
    along = moved @ (moved[-1] / way)
    slope, offset = np.polyfit(t, along, 1)
    away = float(np.std(along - slope * t - offset))
    return away < 0.15 * abs(slope) * (t[-1] - t[0])


def _limits(values: np.ndarray) -> tuple[float, float]:
    """Limits with a margin; what does not move at all stays a flat line in the middle."""
    low, high = float(values.min()), float(values.max())
    margin = 0.06 * (high - low) or 1e-3
    return low - margin, high + margin


# -- measured and simulated -----------------------------------------------------------------
def plot_comparison(
    path: str | Path,
    t: np.ndarray,
    measured: np.ndarray,
    predicted: np.ndarray,
    marker_edges: np.ndarray,
    title: str = "",
    *,
    free: Any = None,
) -> Path:
    """Draw measured and predicted shapes together, and the distance of every marker over time.

    Parameters
    ----------
    path : path
        The PNG (or PDF, SVG) to write.
    t : ndarray, shape (T,)
        Times [s].
    measured, predicted : ndarray, shape (T, M, 3)
        Marker positions [m]; NaN where a marker was lost.
    marker_edges : ndarray, shape (E, 2)
        Pairs of markers that are joined.
    title : str
        Title of the figure.
    free : array_like of int, optional
        The markers whose motion is predicted rather than given, for the mean; by default all.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    OutputError
        If the file cannot be written.
    ParameterError
        If the shapes do not fit together.
    """
    path = check_writable(path)
    t, measured, predicted, pairs = check_comparison(t, measured, predicted, marker_edges)
    figure = _figure(10.0, 7.4)
    grid = figure.add_gridspec(3, 3, height_ratios=[1, 1, 0.9])
    frames = _nearest(t, np.linspace(t[0], t[-1], 6))
    everything = np.concatenate([measured.reshape(-1, 3), predicted.reshape(-1, 3)])
    low, high = np.nanmin(everything, axis=0), np.nanmax(everything, axis=0)
    # from the side, where gravity shows, unless everything lies in a horizontal plane
    spread = high - low
    i, j = (int(np.argmax(spread[:2])), 2) if spread[2] > 0.2 * spread.max() else (0, 1)
    unit, scale = _unit(float(spread.max()))
    margin = 0.06 * float(spread.max())
    first = None
    for n, k in enumerate(frames):
        ax = figure.add_subplot(grid[n // 3, n % 3], sharex=first, sharey=first)
        first = first or ax
        styles = ((measured, MEASURED, 3.4, "measured"), (predicted, PREDICTED, 1.5, "simulated"))
        for values, color, width, label in styles:
            points = values[k][:, [i, j]] * scale
            # one broken line for all pairs
            lines = np.insert(points[pairs], 2, np.nan, axis=1).reshape(-1, 2)
            ax.plot(*lines.T, color=color, lw=width, alpha=0.75, solid_capstyle="round")
            ax.plot(*points.T, "o", color=color, ms=width + 1.6, label=label)
        ax.set_title(f"t = {t[k]:.2f} s", fontsize=10)
        ax.set_aspect("equal", adjustable="box")
        ax.set_xlim((low[i] - margin) * scale, (high[i] + margin) * scale)
        ax.set_ylim((low[j] - margin) * scale, (high[j] + margin) * scale)
        ax.set_xlabel(f"{'xyz'[i]} [{unit}]")
        if n % 3 == 0:
            ax.set_ylabel(f"{'xyz'[j]} [{unit}]")
        else:
            ax.tick_params(labelleft=False)
        _tidy(ax)
        if n == 0:
            ax.legend(frameon=False, fontsize=9, loc="best")
    _distance_axes(figure.add_subplot(grid[2, :]), t, measured, predicted, free)
    if title:
        figure.suptitle(title, fontsize=12)
    figure.savefig(path, dpi=130)
    return path


def _distance_axes(ax: Any, t: np.ndarray, measured: np.ndarray, predicted: np.ndarray, free: Any) -> None:
    distance = np.linalg.norm(predicted - measured, axis=2) * 1e3
    markers = np.arange(distance.shape[1]) if free is None else np.unique(np.asarray(free, dtype=int))
    ax.plot(t, distance[:, markers], lw=0.8, color="0.72")
    shown = np.ma.masked_invalid(distance[:, markers])
    which = f"all {len(markers)} markers" if free is None else f"{len(markers)} free markers"
    label = f"mean over {which}: {float(shown.mean()):.3g} mm"
    ax.plot(t, shown.mean(axis=1), color="k", lw=2.2, label=label)
    ax.plot([], [], color="0.72", label="each marker")
    ax.legend(frameon=False, fontsize=9, loc="upper right")
    ax.set_xlabel("time [s]")
    ax.set_ylabel("distance [mm]")
    if len(t) > 1:
        ax.set_xlim(t[0], t[-1])
    ax.set_ylim(0.0, 1.15 * max(float(shown.max()), 1e-6))
    _tidy(ax)
