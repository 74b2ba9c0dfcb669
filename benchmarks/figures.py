"""Figures made from the results."""

from __future__ import annotations

from pathlib import Path
from typing import Any

STYLES = {
    "rodnet, implicit Euler": ("C0", "o"),
    "rodnet, SDIRK2": ("C1", "s"),
    "rodnet, SDIRK2, adaptive": ("C3", "D"),
    "PyElastica": ("C2", "^"),
    "PyElastica, usual clamp": ("0.5", "v"),
}


def accuracy(result: dict[str, Any]) -> Any:
    """Error of the tip against time spent, one curve per method."""
    from matplotlib.figure import Figure

    curves = result["data"]["curves"]
    rods = list(dict.fromkeys(c["rod"] for c in curves))
    figure = Figure(figsize=(4.6 * len(rods), 3.8), layout="constrained")
    axes = figure.subplots(1, len(rods), squeeze=False)[0]
    for ax, rod in zip(axes, rods, strict=True):
        for curve in curves:
            if curve["rod"] != rod:
                continue
            color, marker = STYLES.get(curve["name"], ("k", "x"))
            points = [p for p in curve["points"] if p["error"]]
            ax.loglog(
                [p["seconds"] for p in points], [p["error"] for p in points], marker=marker, color=color,
                label=curve["name"], markersize=4, lw=1,
            )  # fmt: skip
        ax.set_title(rod, fontsize=10)
        ax.set_xlabel("processor time [s]")
        ax.grid(True, which="major", lw=0.4)
    axes[0].set_ylabel("rms error of the tip / length")
    axes[0].legend(fontsize=7)
    return figure


def iteration(result: dict[str, Any]) -> Any:
    """Where the time of a Newton iteration goes, as stacked bars."""
    from matplotlib.figure import Figure

    bars = result["data"]["bars"]
    figure = Figure(figsize=(7.0, 0.7 + 0.55 * len(bars)), layout="constrained")
    ax = figure.subplots()
    parts = list(dict.fromkeys(part for bar in bars for part in bar["parts"]))
    for k, bar in enumerate(bars):
        left = 0.0
        for i, part in enumerate(parts):
            width = bar["parts"].get(part, 0.0)
            ax.barh(k, width, left=left, color=f"C{i}", label=part if k == 0 else None)
            left += width
    ax.set_yticks(range(len(bars)), [bar["name"] for bar in bars])
    ax.invert_yaxis()
    ax.set_xlabel("time per Newton iteration [µs]")
    ax.legend(fontsize=7, ncols=4, loc="upper center", bbox_to_anchor=(0.5, -0.25))
    return figure


DRAWN = {"accuracy": accuracy, "iteration": iteration}


def save(results: dict[str, Any], beside: Path) -> list[Path]:
    """Draw what can be drawn, into files beside the JSON file."""
    written = []
    for name, draw in DRAWN.items():
        if results["cases"].get(name, {}).get("data"):
            path = beside.with_name(f"{beside.stem}_{name}.png")
            draw(results["cases"][name]).savefig(path, dpi=130)
            written.append(path)
    return written
