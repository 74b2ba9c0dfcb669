"""Whether two models differ, and where: so that only what differs has to be evaluated."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.packed import Packed
from rodnet.parameters import Parameter
from rodnet.solve.model import Model
from rodnet.terms.base import BoundTerm

if TYPE_CHECKING:
    from rodnet.tangent.parts import Part

Near = list[tuple[float, Any]]  # weights of a difference quotient, and bound terms
# of a bound term: places in the matrix, which are alike where the graphs are, and what is only remembered
_PLACES = {"slots", "stencils", "_turns"}


def alike(a: Any, b: Any, seen: set[tuple[int, int]] | None = None) -> bool:
    """Whether two objects hold the same values; models that they refer to are not looked into."""
    if a is b or isinstance(a, Model):
        return True
    seen = set() if seen is None else seen
    if (id(a), id(b)) in seen:
        return True
    seen.add((id(a), id(b)))
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray):
        if a.dtype == object:
            return a.shape == b.shape and all(alike(x, y, seen) for x, y in zip(a.flat, b.flat, strict=True))
        return a.shape == b.shape and bool(np.array_equal(a, b))
    if isinstance(a, Packed):
        return alike(a._arrays, b._arrays, seen)
    if isinstance(a, Parameter):
        return alike(a.value, b.value, seen)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(alike(x, y, seen) for x, y in zip(a, b, strict=True))
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(alike(a[k], b[k], seen) for k in a if k not in _PLACES)
    if callable(a) and hasattr(a, "__func__"):
        return a.__func__ is b.__func__ and alike(a.__self__, b.__self__, seen)
    if hasattr(a, "__dict__") and (isinstance(a, BoundTerm | SimpleNamespace) or not callable(a)):
        return alike(vars(a), vars(b), seen)
    return bool(a == b)


def that_change(bound: Any, number: int, parts: Sequence[Part | None]) -> list[tuple[int, Any]]:
    """Columns that change the constants of a bound term of that number, with weights and bound terms nearby.

    Others change no more than the memory that it begins with.
    """
    return [
        (c, near)
        for c, part in enumerate(parts)
        for k, near in (part.remembered if part is not None else ())
        if k == number and not all(alike(bound.constants, other.constants) for _, other in near)  # type: ignore[attr-defined]
    ]
