"""The selector grammar: which rods, nodes, edges or stations a string names.

========================  ==============================================
``tail*``                 a glob over rod names and group names
``tail0:3``               node 3 of the rod, counted from its start
``tail0:3-4``             the edge between nodes 3 and 4
``tail0.start``, ``.end``  the end nodes
``tail0@50%``, ``@0.05m``  a station by fraction or by arc length
========================  ==============================================
"""

from __future__ import annotations

import difflib
import fnmatch
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

from rodnet.errors import GraphError

_FORBIDDEN = set("[]{}().:@,*?!/\\ \t\n\"'")
_PATTERN = re.compile(
    r"^(?P<glob>[^:@.\[\]]+)"
    r"(?::(?P<node>\d+)(?:-(?P<node2>\d+))?|@(?P<station>[0-9.eE+-]+)(?P<unit>%|m)|\.(?P<end>start|end))?$"
)


class Selector(NamedTuple):
    """A parsed selector: a glob and what it asks for of each rod that matches."""

    text: str
    glob: str
    node: int | None
    node2: int | None
    station: float | None
    relative: bool
    end: str | None


def check_name(name: str) -> str:
    """Return ``name`` if it may name a rod or group, else raise `GraphError`."""
    if not name or not isinstance(name, str) or _FORBIDDEN & set(name):
        raise GraphError(
            f"{name!r} is not a valid name: use letters, digits, '_' and '-' (no blanks, dots, colons, brackets, '*')"
        )
    return name


@lru_cache(maxsize=1024)
def parse(text: str) -> Selector:
    """Parse one selector.

    Raises
    ------
    GraphError
        If the text is not of the grammar above.
    """
    match = _PATTERN.match(text) if isinstance(text, str) else None
    if match is None:
        raise GraphError(
            f"{text!r} is not a selector; write 'rod*', 'rod:3', 'rod:3-4', 'rod.start', 'rod.end', "
            "'rod@50%' or 'rod@0.05m'"
        )
    part = match.groupdict()
    station = None
    if part["station"] is not None:
        try:
            station = float(part["station"]) / (100.0 if part["unit"] == "%" else 1.0)
        except ValueError:
            raise GraphError(f"selector {text!r}: {part['station']!r} is not a number") from None
    as_int = {k: None if part[k] is None else int(part[k]) for k in ("node", "node2")}
    return Selector(
        text, part["glob"], as_int["node"], as_int["node2"], station, part["unit"] == "%", part["end"]
    )


def as_list(selectors: str | Iterable[str]) -> list[str]:
    """Return a list of selectors for one or several."""
    if isinstance(selectors, str):
        return [selectors]
    if not isinstance(selectors, Iterable):
        raise GraphError(
            f"{selectors!r} names no part of a robot; write 'arm', 'arm*', 'arm.end' or 'arm:3', or several"
        )
    return list(selectors)


def match_names(selector: Selector, names: Sequence[str], groups: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the rod names that the selector's glob matches, in the order of ``names``.

    Raises
    ------
    GraphError
        If nothing matches; the message lists close or known names.
    """
    hits = set(fnmatch.filter(names, selector.glob))
    for group in fnmatch.filter(list(groups), selector.glob):
        hits.update(groups[group])
    if not hits:
        known = [*names, *groups]
        close = difflib.get_close_matches(selector.glob, known, n=3)
        hint = (
            f"did you mean {' or '.join(map(repr, close))}?"
            if close
            else f"known are: {', '.join(known[:12]) or 'none'}"
        )
        raise GraphError(f"selector {selector.text!r}: no rod or group is named {selector.glob!r}; {hint}")
    return [name for name in names if name in hits]
