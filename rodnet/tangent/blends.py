"""Terms that are linear in what a parameter changes: one evaluation gives the whole change of their forces."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from rodnet.tangent.compare import alike
from rodnet.terms.base import BoundTerm
from rodnet.terms.dissipation import _BoundMassDamping
from rodnet.terms.drag.resistive import _BoundResistiveForce
from rodnet.terms.drag.stokes import _BoundSphere


def blend(near: list[tuple[float, Any]]) -> BoundTerm | None:
    """Bound term whose forces are minus the sum of weights times those of others; None if there is none."""
    kind = type(near[0][1])
    if any(type(b) is not kind for _, b in near) or kind not in _BLENDS:
        return None
    return _BLENDS[kind](near)


def _sum(near: list[tuple[float, Any]], name: str) -> np.ndarray:
    return np.ascontiguousarray(-np.sum([w * getattr(b, name) for w, b in near], axis=0))


def _resistive(near: list[tuple[float, Any]]) -> BoundTerm | None:
    from rodnet.packed import Packed
    from rodnet.terms.drag.kernels import SPUN

    one = near[0][1]
    if not all(alike(one.sites, b.sites) and alike(one.spun, b.spun) for _, b in near):
        return None
    out = copy.copy(one)
    out.packed = out.pack(_sum(near, "eta"))
    if len(one.spun):
        out.packed_spun = Packed(SPUN, _sum(near, "spin_drag"), one.spun, one.spun_dofs, one.slots[1])
    return out


def _sphere(near: list[tuple[float, Any]]) -> BoundTerm:
    from rodnet.packed import Packed
    from rodnet.terms.drag.kernels import NODE, SPUN

    one = near[0][1]
    out = copy.copy(one)
    out.packed = Packed(NODE, _sum(near, "force"), one.dofs, one.slots[0])
    out.packed_spun = Packed(SPUN, _sum(near, "torque"), one.edge, one.spun_dofs, one.slots[1])
    return out


def _mass_damping(near: list[tuple[float, Any]]) -> BoundTerm:
    from rodnet.packed import Packed
    from rodnet.terms.drag.kernels import SPUN

    one = near[0][1]
    out = copy.copy(one)
    out.weight = _sum(near, "weight")
    out.packed = Packed(SPUN, _sum(near, "spin"), one.edges, one.spun, one.slots[1])
    return out


_BLENDS = {_BoundResistiveForce: _resistive, _BoundSphere: _sphere, _BoundMassDamping: _mass_damping}
