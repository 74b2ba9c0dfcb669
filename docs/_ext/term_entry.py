"""The directive ``{term} granular-force``: what the registry knows of a term, so that the docs cannot disagree.

Beneath the label ``(term-granular-force)=`` and a heading it gives the first line of the docstring, a table of the
parameters with units, defaults, bounds and null values, the source and the package.
"""

from __future__ import annotations

from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList

from rodnet import registry


class TermEntry(Directive):
    """Say what the registry says of a term."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the entry's nodes."""
        records, name = registry.terms(), self.arguments[0]
        if name not in records:
            raise self.error(f"no term '{name}' is installed (plug-ins must be, to build these pages)")
        record = records[name]
        lines = [f"*{record.summary}* Id: `{name}`."]
        if not record.distribution.startswith("rodnet "):
            lines[0] += f" Package: `{record.distribution.split()[0]}`."
        if record.parameters:
            lines += [
                "",
                "| parameter | meaning | unit | default | bounds | null |",
                "|---|---|---|---|---|---|",
            ]
            for p in record.parameters:
                null = "" if p.null is None else f"{p.null:g}"
                lines.append(f"| `{p.name}` | {p.doc} | {p.unit} | {_default(p)} | {_bounds(p)} | {null} |")
        lines += ["", f"*Source:* {record.source}."]
        box = nodes.container(classes=["term-entry"])
        self.state.nested_parse(StringList(lines, source=name), self.content_offset, box)
        return [box]


def _default(p: Any) -> str:
    return "required or derived" if p.value is None else f"{float(p.value):.4g}"


def _bounds(p: Any) -> str:
    low, high = p.bounds
    if low == -float("inf") and high == float("inf"):
        return ""
    if high == float("inf"):
        return f"≥ {low:g}"
    return f"≤ {high:g}" if low == -float("inf") else f"{low:g} to {high:g}"


def setup(app: Any) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("term", TermEntry)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
