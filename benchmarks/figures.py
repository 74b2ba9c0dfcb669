"""Figures made from the results."""

from __future__ import annotations

from pathlib import Path
from typing import Any

STYLES = {
    "rodnet, implicit Euler": ("C0", "o"),
    "rodnet, SDIRK2": ("C1", "s"),
    "rodnet, SDIRK2, residual 1e-4": ("C1", "v"),
    "rodnet, SDIRK2, adaptive": ("C3", "D"),
    "PyElastica": ("C2", "^"),
    "PyElastica, usual clamp": ("0.5", "v"),
}


def accuracy(result: dict[str, Any]) -> Any:
    """Error of the tip against time spent, one curve per method."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

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
        apart = result["data"]["apart"].get(rod)
        if apart:
            ax.axhline(apart, color="0.6", lw=0.8, ls="--", label="the two models differ by")
        ax.set_title(rod, fontsize=10)
        ax.set_xlabel("processor time [s]")
        ax.grid(True, which="major", lw=0.4)
        ax.xaxis.set_minor_formatter(NullFormatter())
    axes[0].set_ylabel("rms error of the tip / length")
    axes[0].legend(fontsize=7)
    return figure


def iteration(result: dict[str, Any]) -> Any:
    """Where the time of a Newton iteration goes, as stacked bars."""
    from matplotlib.figure import Figure

    bars = result["data"]["bars"]
    figure = Figure(figsize=(8.0, 1.4 + 0.5 * len(bars)), layout="constrained")
    ax = figure.subplots()
    interpreter = {"handing arguments": "0.6", "Python and NumPy": "0.8"}
    names = dict.fromkeys(part for bar in bars for part in bar["parts"] if part not in interpreter)
    large = [n for n in names if max(bar["parts"].get(n, 0.0) for bar in bars) > 2.0]  # us
    colors = {n: f"C{i}" for i, n in enumerate(large)} | {"other kernels": "0.35"} | interpreter
    for k, bar in enumerate(bars):
        widths = {part: bar["parts"].get(part, 0.0) for part in colors}
        widths["other kernels"] = sum(w for part, w in bar["parts"].items() if part not in colors)
        left = 0.0
        for part, width in widths.items():
            ax.barh(k, width, left=left, height=0.6, color=colors[part], label=part if k == 0 else None)
            left += width
        ax.plot([bar["least"]] * 2, [k - 0.4, k + 0.4], color="k", label="least" if k == 0 else None)
    ax.set_yticks(range(len(bars)), [bar["name"] for bar in bars])
    ax.invert_yaxis()
    ax.set_xlabel("time per Newton iteration [µs]")
    figure.legend(fontsize=7, ncols=6, loc="outside lower center")
    return figure


def svg(figure: Any) -> str:
    """The figure as SVG, for a notebook."""
    from io import StringIO

    buffer = StringIO()
    figure.savefig(buffer, format="svg")
    return buffer.getvalue()


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
