"""Results as JSON, as tables in the terminal, and as Markdown for the documentation."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).resolve().parent / "results"
FILE = RESULTS / "performance.json"


def save(results: dict[str, Any], path: Path) -> None:
    """Write results as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(_finite(results), indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def load(path: Path = FILE) -> dict[str, Any]:
    """Read results."""
    return json.loads(path.read_text())


def replaced(results: dict[str, Any], again: dict[str, Any]) -> dict[str, Any]:
    """Results with the cases in their place that were measured again, which say so."""
    m = again["machine"]
    note = (
        f"Measured again at commit {m['commit']}, {m['date']}; the wall clock took {again['disturbance']:.3f} times as "
        "long as the processor."
    )
    newer = {name: one | {"notes": [*one["notes"], note]} for name, one in again["cases"].items()}
    return results | {"cases": results["cases"] | newer}


def _finite(value: Any) -> Any:
    """The same data with None for what is not a finite number, and five digits of what is."""
    if isinstance(value, dict):
        return {str(k): _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float):
        return float(f"{value:.5g}") if math.isfinite(value) else None
    return value


def number(value: float) -> str:
    """Three digits, without powers of ten where they can be avoided."""
    if value == 0 or not math.isfinite(value):
        return str(value)
    if float(value).is_integer() and abs(value) < 1e6:
        return f"{value:.0f}"
    if not 1e-3 <= abs(value) < 1e5:
        mantissa, power = f"{value:.1e}".split("e")
        return f"{mantissa}e{int(power)}"
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:.{digits}f}"


def cell(value: Any) -> str:
    """One cell of a table: a spread as its median and, in brackets, its least and largest."""
    if value is None:
        return "–"
    if isinstance(value, dict):
        low, high = number(value["min"]), number(value["max"])
        middle = number(value["median"])
        return middle if low == high == middle else f"{middle} ({low}–{high})"
    return number(value) if isinstance(value, int | float) else str(value)


def heading(results: dict[str, Any]) -> str:
    """What was measured on what, in one sentence."""
    m = results["machine"]
    packages = ", ".join(f"{name} {version}" for name, version in m["versions"].items())
    pinned = "pinned to one core" if results["pinned"] else "not pinned to a core"
    return (
        f"{m['cpu']}, {m['cores']} cores, {m['system']}, Python {m['python']}; {packages}; commit {m['commit']}, "
        f"{m['date']}. One thread, {pinned}. Processor times, median (least–largest) over the rounds; "
        f"the wall clock took {results['disturbance']:.3f} times as long."
    )


def demand_rows(result: dict[str, Any]) -> list[list[str]]:
    """Demand, measured value, verdict."""
    rows = []
    for d in result["demands"]:
        bound = f"{'at least' if d['least'] else 'at most'} {number(d['limit'])} {d['unit']}".strip()
        rows.append([f"{d['what']}: {bound}", cell(d["value"]), "met" if d["met"] else "MISSED"])
    return rows


def show(results: dict[str, Any]) -> None:
    """Print the tables."""
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    # no markup: units are in brackets
    console = Console(highlight=False, markup=False, width=None if sys.stdout.isatty() else 170)
    console.print(heading(results))
    for name, result in results["cases"].items():
        console.rule(f"{result['title']} ({name})", align="left")
        console.print(result["text"])
        tables = [(t["title"], t["columns"], t["rows"]) for t in result["tables"]]
        if result["demands"]:
            tables.append(("Demands", ["demand", "measured", ""], demand_rows(result)))
        for title, columns, rows in tables:
            console.print(f"\n  {title}", style="bold")
            table = Table(box=box.SIMPLE_HEAD)
            for k, column in enumerate(columns):
                table.add_column(Text(column), justify="left" if k == 0 else "right", overflow="fold")
            for row in rows:
                table.add_row(*[Text(cell(value)) for value in row])
            console.print(table)
        for note in result["notes"]:
            console.print(f"- {note}", style="dim")


def markdown(result: dict[str, Any]) -> str:
    """One case as Markdown."""
    parts = [result["text"]]
    tables = [(t["title"], t["columns"], t["rows"]) for t in result["tables"]]
    if result["demands"]:
        tables.append(("Demands", ["demand", "measured", ""], demand_rows(result)))
    for title, columns, rows in tables:
        lines = [f"**{title}**", "", _line(columns), _line(["---"] + ["---:"] * (len(columns) - 1))]
        parts.append("\n".join(lines + [_line(map(cell, row)) for row in rows]))
    parts.append("\n".join(f"- {note}" for note in result["notes"]))
    return "\n\n".join(parts)


def _line(cells: Any) -> str:
    return "| " + " | ".join(str(c).replace("|", "\\|") for c in cells) + " |"
