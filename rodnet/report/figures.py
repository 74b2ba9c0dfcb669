"""Figures of a diagnosis: where and when a force is missing, and trials before and after."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rodnet.diagnosis.screen import isolability as correlation
from rodnet.storage import check_writable
from rodnet.viz.file_names import file_names

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rodnet.diagnosis.locate import Location, TrialLocation
    from rodnet.diagnosis.result import Diagnosis
    from rodnet.diagnosis.screen import Score

SIZE = (4.2, 3.1)  # of a panel [inch]: as wide as a phone, two or three beside each other elsewhere
FULL = 6.0  # [sd] where the colours of a map end at the earliest
BEFORE, AFTER, PLACEBO, FLOOR = "#d55e00", "#0072b2", "#cc79a7", "#555555"
SHOWN = 6  # trials
CELL = 0.13  # of a matrix [inch]: a line of small print


def force_maps(location: Location) -> Iterator[tuple[str, Figure]]:
    """One map for each trial, all of one scale of colours: the force over its standard deviation."""
    top = max(FULL, max(float(one.score.max()) for one in location.trials))
    for one in location.trials:
        yield one.name, force_map(location, one, top)


def force_map(location: Location, one: TrialLocation, top: float) -> Figure:
    """The force in one trial, in standard deviations, over the body (up) and time."""
    import matplotlib.pyplot as plt

    figure, ax = plt.subplots(figsize=SIZE, layout="constrained")
    times = _edges(np.array(one.hats.times))
    drawn = None
    begin = 0.0
    for rod, length in location.rods.items():
        rows = [k for k, name in enumerate(one.hats.rods) if name == rod]
        if not rows:
            continue
        knots = np.array([one.hats.places[k] for k in rows])
        places = begin + length * (_edges(knots) if len(rows) > 1 else np.array([0.0, 1.0]))
        drawn = ax.pcolormesh(times, places, one.score[rows], vmin=0.0, vmax=top, cmap="magma_r")
        for row, k in enumerate(rows):
            for column in np.flatnonzero(one.blind[k]):
                low, high = places[row : row + 2]
                a, b = times[column : column + 2]
                ax.fill([a, b, b, a], [low, low, high, high], fill=False, hatch="////", lw=0, ec="#9999aa")
        begin += length
        if len(location.rods) > 1:
            ax.axhline(begin, color="k", lw=0.8)
            ax.text(
                times[-1], begin - 0.5 * length, f" {literally(rod)}", va="center", fontsize=7, rotation=90
            )
    at = [location.along(rod, place) for rod, place in location.markers]
    ax.plot(np.full(len(at), times[0]), at, ">", color=AFTER, ms=7, clip_on=False, zorder=5)
    ax.set(xlabel="time [s]", ylabel="along the body [m]", title=literally(one.name))
    if drawn is not None:
        figure.colorbar(drawn, ax=ax, label="standard deviations")
    return figure


def literally(name: str) -> str:
    """A name in a figure, in which dollars would begin a formula."""
    return name.replace("$", r"\$")


def measure(found: Diagnosis) -> tuple[str, float]:
    """Unit that errors are told in, and how many of them the recordings' unit is."""
    return ("mm", 1e3) if found.unit == "m" else (found.unit, 1.0)


def isolability(scores: Sequence[Score]) -> Figure:
    """How much alike the effects of scores look on the recordings."""
    import matplotlib.pyplot as plt

    ids = [s.candidate.id for s in scores]
    size = max(3.0, 1.5 + CELL * len(ids))
    figure, ax = plt.subplots(figsize=(size + 1.0, size), layout="constrained")
    drawn = ax.imshow(correlation(scores), vmin=0.0, vmax=1.0, cmap="Blues")
    ax.set_xticks(range(len(ids)), ids, rotation=90, fontsize=7)
    ax.set_yticks(range(len(ids)), ids, fontsize=7)
    figure.colorbar(drawn, ax=ax, shrink=0.8, label="correlation")
    return figure


def save_figures(found: Diagnosis, directory: str | Path) -> list[Path]:
    """Write the figures as PNG files into a directory, and close them.

    Raises
    ------
    OutputError
        If one cannot be written.
    """
    import matplotlib.pyplot as plt

    figures = [("isolability", isolability(found.screened))] if found.screened else []
    if found.location is not None:
        figures += [(f"force-{name}", figure) for name, figure in force_maps(found.location)]
    if found.held is not None:
        figures += [(f"held-out-{name}", figure) for name, figure in before_after(found)]
    written = []
    for name, (_, figure) in zip(file_names(name for name, _ in figures), figures, strict=True):
        path = Path(directory) / f"{name}.png"
        figure.savefig(check_writable(path), dpi=160)
        plt.close(figure)
        written.append(path)
    return written


def _edges(knots: np.ndarray) -> np.ndarray:
    """Ends of cells around knots."""
    middle = 0.5 * (knots[1:] + knots[:-1])
    return np.concatenate([knots[:1], middle, knots[-1:]])


def before_after(found: Diagnosis) -> Iterator[tuple[str, Figure]]:
    """Held-out trials over time: rms distance of the model as it is and of the repaired, beside noise and placebo."""
    import matplotlib.pyplot as plt

    unit, factor = measure(found)
    held = found.held
    assert held is not None
    placebo = found.placebo_after()
    shown = list(zip(held.before.fitted.fits, held.after.fitted.fits, held.bench.recordings, strict=True))[
        :SHOWN
    ]
    for before, after, rec in shown:
        figure, ax = plt.subplots(figsize=SIZE, layout="constrained")
        t = found.case.part(rec).t
        drawn = [(before, "as it is", BEFORE), (after, "repaired", AFTER)]
        for fit, label, color in drawn if found.findings else drawn[:1]:
            square = (fit.samples(0, fit.measured[0] - fit.predicted[0]) ** 2).sum(axis=2)
            seen = np.isfinite(square)
            mean = np.where(seen, square, 0.0).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
            ax.plot(t, factor * np.where(seen.any(axis=1), np.sqrt(mean), np.nan), color=color, label=label)
        for value, label, color, dash in (
            (None if placebo is None else placebo[0], "placebo, on average", PLACEBO, ":"),
            (found.floor, "noise alone", FLOOR, "--"),
        ):
            if value is not None:
                ax.axhline(factor * value, color=color, ls=dash, label=label)
        ax.set(xlabel="time [s]", ylabel=f"rms error [{unit}]", title=literally(rec.name), ylim=(0.0, None))
        ax.legend(fontsize=8, loc="upper left")
        yield rec.name, figure
