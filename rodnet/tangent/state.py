"""Tangents of states: how an accepted state changes with each of some parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from rodnet.kinematics.frames import cross, rotation, transport, unit

if TYPE_CHECKING:
    from rodnet.solve.model import Model
    from rodnet.solve.steppers import State

CELL = 3  # leading columns of a medium's memory: the place of a cell


@dataclass(frozen=True)
class StateTangent:
    """Derivatives of an accepted state by k parameters, the columns.

    Attributes
    ----------
    q, v, a, acc : ndarray, shape (dof_count, k)
        Of the arrays of the state of the same names, full turns included.
    spin : ndarray, shape (edge_count, k)
        Rotation of each edge's reference directors about its tangent, beyond the parallel transport that a
        change of the tangent implies [rad].
    memories : tuple of (ndarray or None)
        Of the terms' memories, each of its shape and k; None where there is none.
    """

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    acc: np.ndarray
    spin: np.ndarray
    memories: tuple[np.ndarray | None, ...]

    @property
    def count(self) -> int:
        """Number of columns."""
        return self.q.shape[1]


def zero(model: Model, state: State, count: int) -> StateTangent:
    """Tangent of a state that depends on none of ``count`` parameters."""
    q, v, a, acc = np.zeros((4, model.dof_count, count))
    memories = tuple(None if m is None else np.zeros((*np.shape(m), count)) for m in state.memories)
    return StateTangent(q, v, a, acc, np.zeros((model.edge_count, count)), memories)


def first(tangent: StateTangent, count: int) -> StateTangent:
    """The first columns of a tangent."""
    t, k = tangent, slice(count)
    memories = tuple(None if m is None else m[..., k] for m in t.memories)
    return StateTangent(t.q[:, k], t.v[:, k], t.a[:, k], t.acc[:, k], t.spin[:, k], memories)


def joined(parts: list[StateTangent]) -> StateTangent:
    """One tangent with the columns of all parts."""
    q, v, a, acc, spin = (
        np.concatenate([getattr(p, name) for p in parts], axis=-1) for name in ("q", "v", "a", "acc", "spin")
    )
    memories = tuple(
        None if all(m is None for m in column) else np.concatenate(column, axis=-1)
        for column in zip(*(p.memories for p in parts), strict=True)
    )
    return StateTangent(q, v, a, acc, spin, memories)


def moved(model: Model, state: State, tangent: StateTangent, column: int, step: float) -> State:
    """Return the state after a change of one parameter by ``step``."""
    q, v, a, acc = (
        getattr(state, name) + step * getattr(tangent, name)[:, column] for name in ("q", "v", "a", "acc")
    )
    x = q[: model.twist0].reshape(-1, 3)
    tangents = unit(x[model.edges[:, 1]] - x[model.edges[:, 0]])
    directors = transport(state.directors, state.tangents, tangents)
    spins = step * tangent.spin[:, column]
    turned = np.flatnonzero(spins)
    if len(turned):
        turns = rotation(spins[turned, None] * tangents[turned])
        directors[turned] = np.einsum("nij,nj->ni", turns, directors[turned])
    memories = tuple(
        memory if d is None or memory is None else memory + step * d[..., column]
        for memory, d in zip(state.memories, tangent.memories, strict=True)
    )
    return replace(state, q=q, v=v, a=a, acc=acc, tangents=tangents, directors=directors, memories=memories)


def combined(model: Model, base: State, others: list[tuple[float, State]]) -> StateTangent:
    """Sum of weights times states near ``base``, as a tangent of one column: a difference quotient.

    Parameters
    ----------
    model : Model
        The model of ``base``.
    base : State
        The state in the middle.
    others : list of (float, State)
        Weights, whose sum is zero, and states.
    """
    side = cross(base.tangents, base.directors)
    q, v, a, acc = np.zeros((4, model.dof_count))
    spin = np.zeros(model.edge_count)
    memories = [None if m is None else np.zeros(np.shape(m)) for m in base.memories]
    edges = slice(model.twist0, model.twist0 + model.edge_count)
    for weight, state in others:
        q += weight * (state.q - base.q)
        q[edges] += weight * 2.0 * np.pi * (state.turns - base.turns)
        v += weight * (state.v - base.v)
        a += weight * (state.a - base.a)
        acc += weight * (state.acc - base.acc)
        # parallel transport between the two tangents has no part about them to first order
        carried = transport(state.directors, state.tangents, base.tangents)
        spin += weight * np.sum(carried * side, axis=1)
        for k, (bound, total) in enumerate(zip(model.bound, memories, strict=True)):
            here, there = base.memories[k], state.memories[k]
            if total is not None and here is not None and there is not None:
                total += weight * _difference(there, here, bound.growing)
    columns = tuple(None if m is None else m[..., None] for m in memories)
    return StateTangent(q[:, None], v[:, None], a[:, None], acc[:, None], spin[:, None], columns)


def _difference(memory: np.ndarray, base: np.ndarray, growing: bool) -> np.ndarray:
    """Difference of two memories; of a medium's, of the cells of ``base``, the others being as good as untouched."""
    if not growing:
        return memory - base
    out = np.zeros(np.shape(base))
    here, there = (table[1:, :CELL].astype(np.int64) for table in (base, memory))
    if not (len(here) and len(there)):
        return out
    low = np.minimum(here.min(axis=0), there.min(axis=0))
    size = np.maximum(here.max(axis=0), there.max(axis=0)) - low + 1
    one, other = (np.ravel_multi_index(tuple((cells - low).T), tuple(size)) for cells in (here, there))
    _, k, found = np.intersect1d(one, other, assume_unique=True, return_indices=True)
    out[k + 1, CELL:] = memory[found + 1, CELL:] - base[k + 1, CELL:]
    return out
