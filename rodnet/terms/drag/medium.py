"""Memory held by the medium: a field of cells that stay in their place while rods move through them.

What is stored is sparse: cells that no rod has been near are as the untouched medium. The theory is in the
documentation, "Memory of the medium".
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import TermError
from rodnet.terms.drag.line import DragModel, LineSites, SiteTable, _BoundLine, difference, start_sites

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model

FAINT = 1e-6  # of the largest change of the medium: less does not spread to further cells
_STEP = np.cbrt(np.finfo(float).eps)  # relative step of central differences


@dataclass(frozen=True)
class Cells:
    """What `DragModel.settle` sees: arrays over cells of the medium, one row each.

    Attributes
    ----------
    x : ndarray, shape (n, 3)
        Their middles [m].
    size : float
        Their edge [m].
    t, dt : float
        Time and time step [s].
    """

    x: np.ndarray
    size: float
    t: float
    dt: float


@dataclass(frozen=True)
class Field:
    """Memory on a lattice of cells that is fixed in space.

    Attributes
    ----------
    size : float
        Edge of a cell [m].
    untouched : ndarray, shape (k,)
        Memory where no cell is stored.
    codes : ndarray of int64, shape (c,)
        The stored cells, in ascending order.
    values : ndarray, shape (c, k)
        Their memories.
    """

    size: float
    untouched: np.ndarray
    codes: np.ndarray
    values: np.ndarray

    def gather(self, x: np.ndarray, slopes: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """Memory at points (n, 3) and its derivative by them, if asked for, shapes (n, k) and (n, k, 3)."""
        from rodnet.terms.drag.field_kernels import gather

        value = np.tile(self.untouched, (len(x), 1))
        slope = np.zeros((len(x) if slopes else 0, value.shape[1], 3))
        gather(np.ascontiguousarray(x), self.size, self.codes, self._change, value, slope)
        return value, slope

    def gathered(self, x: np.ndarray, changes: np.ndarray) -> np.ndarray:
        """What cells' changes (c, k, l) amount to at points (n, 3), shape (n, k, l)."""
        from rodnet.terms.drag.field_kernels import gather

        kinds = changes.shape[1:]
        flat = np.ascontiguousarray(changes.reshape(len(changes), np.prod(kinds)))
        value = np.zeros((len(x), flat.shape[1]))
        gather(np.ascontiguousarray(x), self.size, self.codes, flat, value, np.zeros((0, 0, 3)))
        return value.reshape(len(x), *kinds)

    def at(self, codes: np.ndarray) -> np.ndarray:
        """Memory of some cells, shape (n, k)."""
        values = np.tile(self.untouched, (len(codes), 1))
        _, here, there = np.intersect1d(codes, self.codes, assume_unique=True, return_indices=True)
        values[here] = self.values[there]
        return values

    @cached_property
    def _change(self) -> np.ndarray:
        return self.values - self.untouched

    def with_cells(self, codes: np.ndarray) -> Field:
        """The same field with these cells stored, too."""
        at = np.searchsorted(self.codes, codes)
        inside = at < len(self.codes)
        known = inside.copy()
        known[inside] = self.codes[at[inside]] == codes[inside]
        new = np.unique(codes[~known])  # few: a rod moves by a part of a cell in a step
        at = np.searchsorted(self.codes, new)
        values = np.insert(self.values, at, self.untouched, axis=0)
        return replace(self, codes=np.insert(self.codes, at, new), values=values)

    def deposited(self, x: np.ndarray, amount: np.ndarray) -> Field:
        """The field after adding amounts (n, k) at points (n, 3), spread over the cells around each."""
        from rodnet.terms.drag.field_kernels import deposit, stencils

        x = np.ascontiguousarray(x)
        codes, weights = np.empty((len(x), 27), dtype=np.int64), np.empty((len(x), 27))
        stencils(x, self.size, codes, weights)
        field = self.with_cells(codes)
        deposit(np.searchsorted(field.codes, codes), weights, amount, field.values)
        return field

    def diffused(self, diffusivity: np.ndarray, dt: float) -> Field:
        """The field after diffusion [m^2/s] for a time [s], into cells that were not stored, too."""
        number = diffusivity * dt / self.size**2
        if not number.any() or not len(self.codes):
            return self
        # explicit steps are stable up to 1/6; round numbers lie well inside of what takes so many
        parts = int(np.ceil(7.99 * number.max()))
        field = self
        for _ in range(parts):
            change = np.abs(field.values - self.untouched)[:, number > 0.0]
            strong = np.any(change > FAINT * change.max(axis=0), axis=1)
            field = field.with_cells((field.codes[strong] + _neighbours()[:, None]).ravel())
            inflow = np.zeros_like(field.values)
            for step in _neighbours():
                at = np.minimum(np.searchsorted(field.codes, field.codes + step), len(field.codes) - 1)
                there = field.codes[at] == field.codes + step  # nothing flows where no cell is
                inflow[there] += field.values[at[there]] - field.values[there]
            field = replace(field, values=field.values + number / parts * inflow)
        return field

    def indices(self) -> np.ndarray:
        """Whole-number places of the stored cells, shape (c, 3); times ``size`` they are their middles."""
        from rodnet.terms.drag.field_kernels import BITS, HALF

        mask = (1 << BITS) - 1
        parts = [(self.codes >> (BITS * k)) & mask for k in (2, 1, 0)]
        return np.stack(parts, axis=1) - HALF


def _neighbours() -> np.ndarray:
    """Differences of the codes of cells that share a face, shape (6,)."""
    from rodnet.terms.drag.field_kernels import BITS

    steps = np.array([1, 1 << BITS, 1 << 2 * BITS], dtype=np.int64)
    return np.concatenate([steps, -steps])


def _codes(indices: np.ndarray) -> np.ndarray:
    from rodnet.terms.drag.field_kernels import BITS, HALF

    i, j, k = indices.astype(np.int64).T + HALF
    return (((i << BITS) + j) << BITS) + k


def cells_of(memory: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Middles (c, 3) [m] and memories (c, k) of the cells in the memory of a state."""
    k = (memory.shape[1] - 3) // 2
    return memory[1:, :3] * size, memory[1:, 3 : 3 + k].copy()


class BoundMediumLaw(_BoundLine):
    """A law whose memory the medium holds.

    Its ``memory`` has a row for each cell: its place (3 whole numbers), its memory, and that before the
    last step, with which a recorded state can be evaluated again. The first row holds that step's dt.
    """

    growing = True

    def __init__(self, term: DragModel, model: Model, sites: SiteTable) -> None:
        super().__init__(term, model, sites)
        self.law = term
        self.past_dt: float | None = None  # dt of a recorded step that is evaluated again
        fresh = np.asarray(term.initial_memory(start_sites(model, sites), self.p), dtype=float)
        if not np.all(fresh == fresh[0]):
            raise TermError(
                f"{type(term).__name__}.initial_memory must be alike at all sites: it is the untouched medium's"
            )
        self.cell_p = term.values()
        self.settles = type(term).settle is not DragModel.settle
        self.disturbs = type(term).disturb is not DragModel.disturb
        arrays = [name for name, value in vars(self.cell_p).items() if np.ndim(value)]
        if arrays and self.settles:
            raise TermError(
                f"{type(term).__name__}: {', '.join(arrays)} must be a single number, cells have no other"
            )
        empty = Field(
            float(term.cell or 0.0), fresh[0], np.zeros(0, np.int64), np.zeros((0, term.memory_size))
        )
        self._keep(empty, empty.values, 1.0)

    @property
    def constants(self) -> tuple[Any, ...]:
        """What the law depends on beside motion, memory and time."""
        return self.p, self.cell_p, self.sites.radius, self.sites.weight, self.law

    # -- memory ---------------------------------------------------------------------------
    def pack_field(self, field: Field, old: np.ndarray, dt: float) -> np.ndarray:
        """Return the memory that holds a field, that before the step, and the step's dt."""
        memory = np.zeros((1 + len(field.codes), 3 + 2 * self.law.memory_size))
        memory[0, 0] = dt
        memory[1:] = np.concatenate([field.indices(), field.values, old], axis=1)
        return memory

    def _keep(self, field: Field, old: np.ndarray, dt: float) -> None:
        self.field, self.memory = field, self.pack_field(field, old, dt)

    def accept(self, model: Model, memory: np.ndarray) -> None:
        k = self.law.memory_size
        codes, values = _codes(memory[1:, :3]), np.ascontiguousarray(memory[1:, 3 : 3 + k])
        self.field, self.memory = replace(self.field, codes=codes, values=values), memory

    def restore(self, model: Model, memory: np.ndarray) -> None:
        self.accept(model, memory.copy())

    def rewind(self) -> None:
        assert self.memory is not None
        old = np.ascontiguousarray(self.memory[1:, 3 + self.law.memory_size :])
        self.past_dt = float(self.memory[0, 0])
        self._keep(replace(self.field, values=old), old, self.past_dt)

    def evolved(self, site: LineSites, field: Field) -> Field:
        """The field at the end of a step in which sites have moved like this, by all that the law says."""
        law = self.law
        m, _ = field.gather(site.x, False)
        new = np.asarray(law.update(site, self.p, m)[1], dtype=float)
        # a site's change is that of the medium within a cell's cross-section along its length
        change = new - m
        if self.disturbs:
            change = change + np.asarray(law.disturb(site, self.p, m), dtype=float)
        field = field.deposited(site.x, change * (site.length / field.size)[:, None])
        diffusivity = np.broadcast_to(law.diffusivity(self.cell_p), law.memory_size)
        field = field.diffused(np.asarray(diffusivity, dtype=float), site.dt)
        if self.settles and len(field.codes):
            cells = Cells(field.indices() * field.size, field.size, site.t, site.dt)
            settled = np.asarray(law.settle(cells, self.cell_p, field.values), dtype=float)
            field = replace(field, values=settled)
        return field

    def next_memory(self, ev: Evaluation) -> np.ndarray:
        site = self.view(ev)
        field = self.evolved(site, self.field)
        return self.pack_field(field, self.field.at(field.codes), site.dt)

    # -- forces ---------------------------------------------------------------------------
    def view(self, ev: Evaluation) -> LineSites:
        site = super().view(ev)
        return site if self.past_dt is None else replace(site, dt=self.past_dt)

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        site = self.view(ev)
        m, slope = self.field.gather(site.x, jac)
        force = lambda s, memory=m: np.asarray(self.law.update(s, self.p, memory)[0], dtype=float)  # noqa: E731
        w = site.length[:, None]
        f = force(site) * w
        if not jac:
            zero = np.zeros((len(f), 3, 3))
            return self.scatter(ev, f, zero, zero, 0.0, F, data, False)
        known = self.law.jacobian(site, self.p, m)
        parts = {}
        for key in ("v", "tangent", "x"):
            given = known.get(key)
            parts[key] = difference(force, site, key) if given is None else np.asarray(given)
        if slope.any():  # the memory that a site finds changes with its place
            parts["x"] = parts["x"] + self.by_memory(site, m, known) @ slope
        v, tangent, x = (parts[key] * w[:, :, None] for key in ("v", "tangent", "x"))
        return self.scatter(ev, f, ev.cv * v + x, tangent, 1.0, F, data, True)

    def by_memory(
        self, site: LineSites, m: np.ndarray, known: dict[str, Any] | None = None, sizes: Any = 0.0
    ) -> np.ndarray:
        """Derivative of forces per length by the memory that their sites find, shape (n, 3, k).

        ``sizes``, shape (k,), are changes of memories that are small, where it is known: a memory may be zero still.
        """
        found = (self.law.jacobian(site, self.p, m) if known is None else known).get("memory")
        if found is not None:
            return np.asarray(found)
        force = lambda memory: np.asarray(self.law.update(site, self.p, memory)[0], dtype=float)  # noqa: E731
        out = np.empty((len(m), 3, m.shape[1]))
        steps = np.maximum(_STEP * np.maximum(np.abs(m).max(axis=0, initial=0.0), 1e-6), sizes)
        for k in range(m.shape[1]):
            step = np.zeros(m.shape[1])
            step[k] = steps[k]
            out[:, :, k] = (force(m + step) - force(m - step)) / (2.0 * step[k])
        return out
