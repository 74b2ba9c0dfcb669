"""The parts of a drafted law in words: what each number multiplies, and where on the body."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rodnet.diagnosis.library import CLASSES, EYE

if TYPE_CHECKING:
    from rodnet.diagnosis.library import Piece

SIGN = (
    "The law is the sum of these parts. Of a force along the velocity a negative value resists the motion, a positive "
    "one drives it; x, y and z are places in metres."
)


def parts_in_words(pieces: Sequence[Piece]) -> dict[str, str]:
    """Say what the numbers of a law are, by path."""
    found = {}
    for piece in pieces:
        declared = CLASSES[piece.kind].declared()
        for path in (*piece.paths, *piece.shape):
            name, _, axis = path.rpartition(".")[2].partition("[")
            along = f", along {'xyz'[int(axis[:-1])]}" if axis else ""
            where = f" (of {piece.name})" if piece.kind == EYE else _where(piece.on)
            found[path] = f"{declared[name].doc}{along}{where}"
    return found


def _where(on: Sequence[str]) -> str:
    """The part of the body that selectors name: edges one after the other are told by the nodes at their ends."""
    if not on or on[0] == "*":
        return ""
    rod, _, first = on[0].partition(":")
    if not first:
        return f" (on {', '.join(on)})"
    return f" (on {rod} from node {first.partition('-')[0]} to {on[-1].rpartition('-')[2]})"
