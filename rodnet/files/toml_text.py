"""Writing TOML so that people like to read it: rows of numbers as rows, floats to the last bit."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

WIDTH = 100


def toml_text(document: Mapping[str, Any], comments: Mapping[str, str] | None = None) -> str:
    """Return a document as TOML: plain values first, then tables, and lists of tables.

    Parameters
    ----------
    document : mapping
        Of text, numbers, truth values, lists and mappings; lists of mappings at the top become ``[[...]]``.
    comments : mapping, optional
        A line to stand above the table of that name.
    """
    notes = comments or {}
    lines = [f"{_key(k)} = {_value(v)}" for k, v in document.items() if not _is_tables(v)]
    for name, value in document.items():
        if not _is_tables(value) or not value:
            continue
        lines += [""] + ([f"# {notes[name]}"] if name in notes else [])
        for n, table in enumerate([value] if isinstance(value, Mapping) else value):
            header = f"[{_key(name)}]" if isinstance(value, Mapping) else f"[[{_key(name)}]]"
            lines += ([""] if n else []) + [header]
            lines += [f"{_key(k)} = {_value(v)}" for k, v in table.items()]
    return "\n".join(lines) + "\n"


def _is_tables(value: Any) -> bool:
    return isinstance(value, Mapping) or (
        isinstance(value, list) and bool(value) and all(isinstance(v, Mapping) for v in value)
    )


def _key(name: str) -> str:
    plain = name and all(c.isascii() and (c.isalnum() or c in "-_") for c in name)
    return name if plain else _text(name)


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value: Any) -> str:
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return repr(value)  # the shortest text of the same bits; inf and nan as in TOML
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items()) + "}"
    if any(isinstance(v, list | Mapping) for v in value):
        return _rows([_value(v) for v in value])
    return _wrapped([_value(v) for v in value])


def _rows(items: list[str]) -> str:
    """A list of lists: in one line if it fits, else one row a line."""
    short = "[" + ", ".join(items) + "]"
    if len(short) <= WIDTH and "\n" not in short:
        return short
    return "[\n" + "".join(f"    {item},\n" for item in items) + "]"


def _wrapped(items: list[str]) -> str:
    """A list of plain values, broken into lines of at most `WIDTH`."""
    short = "[" + ", ".join(items) + "]"
    if len(short) <= WIDTH:
        return short
    lines, line = [], "   "
    for item in items:
        if len(line) + len(item) + 2 > WIDTH:
            lines.append(line)
            line = "   "
        line += f" {item},"
    return "[\n" + "\n".join([*lines, line]) + "\n]"
