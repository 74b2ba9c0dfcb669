"""Terms that are linear in what a parameter changes: their coefficients change, and one kernel serves all columns."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from rodnet.tangent.compare import Near, alike
from rodnet.terms.base import BoundTerm
from rodnet.terms.contact.elastic_wall import ElasticWall
from rodnet.terms.dissipation import _BoundMassDamping
from rodnet.terms.drag.change import Current, ScaledDrag, _BoundChange, at_time, shares_within
from rodnet.terms.drag.line import _BoundKernelLaw, _BoundLaw
from rodnet.terms.drag.local_law import COEFFICIENTS, LocalLaw
from rodnet.terms.drag.resistive import ResistiveForce, _BoundResistiveForce
from rodnet.terms.drag.stokes import _BoundSphere

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model


@dataclass
class LinearChange:
    """What one column changes of a residual M a - F, at a fixed state.

    Attributes
    ----------
    mass, damping, constant : ndarray, shape (dof_count,), or None
        Changes of the diagonal of M, of that by which rates are resisted, and of what does not depend on the state.
    spin : ndarray, shape (edge_count,), or None
        Of the drag on the spin of edges [N m s].
    lines : dict
        By number of the bound term: of the resistance (eta_t, eta_n) of its sites, times their length, (n, 2).
    laws : dict
        By number of a bound `LocalLaw`: of the coefficients of its sites, times their length, (n, coefficients).
    beside : list of (BoundTerm, ndarray)
        Likewise of bound laws that the model lacks.
    scaled : list of (BoundTerm, float)
        Changes of the drag by a factor, with their weights.
    flows : list of (BoundTerm, ndarray)
        Currents with their coefficients times their weights, (24,).
    walls : list of (BoundTerm, ndarray)
        Walls that give with their normal, position, layer, and stiffness times weight, (6,).
    """

    mass: np.ndarray | None = None
    damping: np.ndarray | None = None
    constant: np.ndarray | None = None
    spin: np.ndarray | None = None
    lines: dict[int, np.ndarray] = field(default_factory=dict)
    laws: dict[int, np.ndarray] = field(default_factory=dict)
    beside: list[tuple[Any, np.ndarray]] = field(default_factory=list)
    scaled: list[tuple[_BoundChange, float]] = field(default_factory=list)
    flows: list[tuple[_BoundChange, np.ndarray]] = field(default_factory=list)
    walls: list[tuple[Any, np.ndarray]] = field(default_factory=list)

    def lay(self, near: Near) -> bool:
        """Add what terms amount to that the model lacks, with their weights; False if it is not of these kinds."""
        if all(isinstance(b, _BoundChange) and b.scales for _, b in near):
            self.scaled += [(b, w) for w, b in near if not b.idle]
            return True
        if all(isinstance(b, _BoundChange) and _is_current(b) for _, b in near):
            self.flows += [(b, w * b.law.coefficients(b.p)) for w, b in near if not b.idle]
            return True
        if all(_is_wall(b) for _, b in near):
            self.walls += [(b, _wall(b, w)) for w, b in near if b.p.stiffness]
            return True
        if not all(type(b) is _BoundKernelLaw and isinstance(b.term, LocalLaw) for _, b in near):
            return False
        self.beside += [(b, w * b.sites.weight[:, None] * b.vector[:, : len(COEFFICIENTS)]) for w, b in near]
        return True

    def add(self, model: Model, k: int, near: Near) -> bool:
        """Add what a bound term's change amounts to; False if it is not of these kinds."""
        kind = type(near[0][1])
        if any(type(b) is not kind for _, b in near):
            return False
        if kind is _BoundResistiveForce:
            one = near[0][1]
            names = "node", "edgeA", "edgeB", "cA", "cB"
            if not all(alike(getattr(one.sites, n), getattr(b.sites, n)) for _, b in near for n in names):
                return False
            self.lines[k] = np.sum([w * b.sites.weight[:, None] * b.eta for w, b in near], axis=0)
            if len(one.spun):
                self._spin(model, one.spun, _sum(near, "spin_drag"))
            return True
        if kind is _BoundKernelLaw and isinstance(near[0][1].term, LocalLaw):
            m = len(COEFFICIENTS)
            rest = near[0][1].vector[:, m:]
            if any(not np.array_equal(b.vector[:, m:], rest) for _, b in near):
                return False
            self.laws[k] = np.sum([w * b.sites.weight[:, None] * b.vector[:, :m] for w, b in near], axis=0)
            return True
        if all(_is_wall(b) for _, b in near):
            self.walls += [(b, _wall(b, w)) for w, b in near]
            return True
        if kind is _BoundChange and near[0][1].scales:
            self.scaled += [(b, w) for w, b in near]
            return True
        if kind is _BoundChange and _is_current(near[0][1]):
            laws = near[0][1].laws
            if laws.crowds or not all(type(part.law) is ResistiveForce for part in laws.parts):
                return False  # a current that is there is one of their arguments, or neighbours multiply it
            self.flows += [(b, w * b.law.coefficients(b.p)) for w, b in near]
            return True
        if kind is _BoundSphere:
            self._damp(model, near[0][1].dofs, np.repeat(_sum(near, "force"), 3))
            self._spin(model, near[0][1].edge, _sum(near, "torque"))
            return True
        if kind is _BoundMassDamping:
            self._damp(model, near[0][1].dofs, _sum(near, "weight"))
            self._spin(model, near[0][1].edges, _sum(near, "spin"))
            return True
        return False

    def _damp(self, model: Model, dofs: np.ndarray, change: np.ndarray) -> None:
        if self.damping is None:
            self.damping = np.zeros(model.dof_count)
        np.add.at(self.damping, dofs, change)

    def _spin(self, model: Model, edges: np.ndarray, change: np.ndarray) -> None:
        if self.spin is None:
            self.spin = np.zeros(model.edge_count)
        np.add.at(self.spin, edges, change)


def _is_current(bound: _BoundChange) -> bool:
    return isinstance(bound.law, Current) and type(bound.law).change is Current.change


def _is_wall(bound: Any) -> bool:
    if type(bound) is not _BoundLaw or type(bound.law) is not ElasticWall:
        return False
    return not any(np.ndim(getattr(bound.p, name)) for name in bound.law.declared())


def _wall(bound: Any, weight: float) -> np.ndarray:
    p = bound.p
    return np.array([*bound.law.normal, p.position, p.layer, weight * p.stiffness])


def _sites(bound: Any, *others: np.ndarray) -> bytes:
    """What a law's sites are, and what else it depends on."""
    sites = bound.sites
    arrays = sites.node, sites.edgeA, sites.edgeB, sites.cA, sites.cB, *others
    return b"|".join(np.ascontiguousarray(a).tobytes() for a in arrays)


def _laws(bound: _BoundChange) -> Any:
    """Which laws a change is of, and where."""
    laws = tuple((id(part.law), b"" if part.eta is None else part.eta.tobytes()) for part in bound.laws.parts)
    crowds = [np.asarray(one.crowding) for one in bound.laws.crowds]
    return laws, _sites(bound, bound.sites.weight, bound.sites.radius, *crowds)


def _sum(near: Near, name: str) -> np.ndarray:
    return np.sum([w * getattr(b, name) for w, b in near], axis=0)


class LinearChanges:
    """The changes of all columns together.

    Parameters
    ----------
    model : Model
        The model.
    ev : Evaluation
        Which holds the states to come.
    columns : list of (int, LinearChange)
        Numbers of columns, and what they change.
    """

    def __init__(self, model: Model, ev: Evaluation, columns: list[tuple[int, LinearChange]]) -> None:
        from rodnet.tangent import linear_kernels

        self.ev, self._kernels, self.twist0 = ev, linear_kernels, model.twist0
        self._mass, self._damping, self._constant, self._spin = (
            _stacked([(c, getattr(one, name)) for c, one in columns])
            for name in ("mass", "damping", "constant", "spin")
        )
        self._ones = np.ones(model.dof_count)
        numbers = sorted({k for _, one in columns for k in one.lines})
        lines: list[tuple[BoundTerm, Any]] = [
            (model.bound[k], _stacked([(c, one.lines.get(k)) for c, one in columns])) for k in numbers
        ]
        numbers = sorted({k for _, one in columns for k in one.laws})
        laws = [(model.bound[k], _stacked([(c, one.laws.get(k)) for c, one in columns])) for k in numbers]
        beside: dict[bytes, list[tuple[Any, int, np.ndarray]]] = {}
        for c, one in columns:
            for b, change in one.beside:
                # the shares of laws on the same sites differ in nothing but how they fade
                rest = b.vector[:, len(COEFFICIENTS) :]
                beside.setdefault(_sites(b, rest), []).append((b, c, change))
        laws += [(some[0][0], _stacked([(c, change) for _, c, change in some])) for some in beside.values()]
        scaled: dict[Any, list[tuple[_BoundChange, int, float]]] = {}
        flows: dict[Any, list[tuple[_BoundChange, int, np.ndarray]]] = {}
        for c, one in columns:
            for factor, weight in one.scaled:
                scaled.setdefault(_laws(factor), []).append((factor, c, weight))
            for flow, change in one.flows:
                flows.setdefault(_laws(flow), []).append((flow, c, change))
        self._scaled = [(some, np.array([c for _, c, _ in some])) for some in scaled.values()]
        walls: dict[bytes, list[tuple[Any, int, np.ndarray]]] = {}
        for c, one in columns:
            for wall, row in one.walls:
                walls.setdefault(_sites(wall, wall.sites.weight), []).append((wall, c, row))
        self._walls = [
            (some[0][0].sites, np.stack([row for *_, row in some]), np.array([c for _, c, _ in some]))
            for some in walls.values()
        ]  # fmt: skip
        self._flows = [
            (some[0][0], np.array([c for _, c, _ in some]), np.stack([change for *_, change in some], axis=1),
             np.array([cast(Current, b.law).frequency_of(b.p) for b, *_ in some]),
             np.stack([cast(Current, b.law).window(b.p) for b, *_ in some], axis=1))
            for some in flows.values()
        ]  # fmt: skip
        self._laws = [(b, *stack) for b, stack in laws if stack is not None]
        self._lines = [(b.packed, *stack) for b, stack in lines if stack is not None]  # type: ignore[attr-defined]

    def add(self, a: np.ndarray, out: np.ndarray) -> None:
        """Add the change of the residual to ``out``, shape (dof_count, k), at accelerations ``a``."""
        kernels, ev = self._kernels, self.ev
        for stack, factor in ((self._mass, a), (self._damping, ev.rates), (self._constant, self._ones)):
            if stack is not None:
                kernels.diagonal_changes(*stack, factor, out)
        if self._spin is not None:
            kernels.spin_changes(*self._spin, ev.state, self.twist0, out)
        for packed, change, which in self._lines:
            kernels.line_changes(packed.table, change, which, ev.state, out)
        for sites, walls, which in self._walls:
            kernels.wall_changes(sites.node, sites.weight, walls, which, ev.x, out)
        for bound, change, which in self._laws:
            shares = bound.term.shares(bound.view(ev), bound.vector[:, len(COEFFICIENTS) :])  # type: ignore[attr-defined]
            rows = 3 * bound.sites.node[:, None, None] + np.arange(3)[:, None]  # type: ignore[attr-defined]
            np.subtract.at(out, (rows, which), np.einsum("nmi,nmc->nic", shares, change))
        for some, which in self._scaled:  # the drag that they change is the same
            self._add_scaled(some, which, out)
        # currents that are small, or against which the drag is linear
        for bound, which, coefficients, frequency, windows in self._flows:
            site, now = bound.view(ev), at_time(coefficients, frequency, ev.t)
            lengths = bound.sites.weight[:, None] * bound.laws.crowding(ev)
            resistance = lengths[:, :, None] * bound.laws.slopes(site)["v"]
            current = now[:3] + np.einsum("nj,ijc->nic", site.x, now[3:].reshape(3, 3, -1))
            if windows[3].any():
                current = current * shares_within(site.x, windows)[:, None, :]
            rows = 3 * bound.sites.node[:, None, None] + np.arange(3)[:, None]
            np.add.at(out, (rows, which), resistance @ current)

    def _add_scaled(
        self, some: list[tuple[_BoundChange, int, float]], which: np.ndarray, out: np.ndarray
    ) -> None:
        """Add what factors on the same drag change, which are bound changes with their columns and weights."""
        first, ev = some[0][0], self.ev
        site, sites = first.view(ev), first.sites
        seen = first.laws.against(site)[0]
        factors = np.hstack(
            [weight * cast(ScaledDrag, b.law).factor(seen, b.cells, b.p)[0] for b, _, weight in some]
        )
        eta = first.laws.plain
        if eta is not None:
            packed = eta, sites.node, sites.edgeA, sites.edgeB, sites.cA, sites.cB, sites.weight
            self._kernels.scaled_changes(packed, factors, which, ev.state, out)
            return
        force = sites.weight[:, None] * first.laws.crowding(ev) * first.laws.force(site)
        rows = 3 * sites.node[:, None, None] + np.arange(3)[:, None]
        np.subtract.at(out, (rows, which), force[:, :, None] * factors[:, None, :])


def _stacked(arrays: list[tuple[int, np.ndarray | None]]) -> tuple[np.ndarray, np.ndarray] | None:
    """Arrays of some columns, columns innermost, and which columns these are; None if there are none."""
    some = [(c, a) for c, a in arrays if a is not None and a.any()]
    if not some:
        return None
    which = np.array([c for c, _ in some], dtype=np.int64)
    return np.ascontiguousarray(np.stack([a for _, a in some], axis=-1)), which
