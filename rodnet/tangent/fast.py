"""The tangent of a step in compiled blocks of columns, for what the graph's own pattern holds.

The derivative of a stage's residual by everything that the step begins with, at fixed new positions, is
linear algebra with matrices that are there or cheap: the Jacobian, and its part that comes from rates.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.solve.linear import GROWTH_LIMIT
from rodnet.solve.newton import Newton, StepReport
from rodnet.solve.steppers import Rates, State
from rodnet.tangent.added import Unfit
from rodnet.tangent.held import HeldTangent
from rodnet.tangent.linear import LinearChanges
from rodnet.tangent.memories import memories
from rodnet.tangent.parts import Part
from rodnet.tangent.state import StateTangent
from rodnet.terms.dissipation import _BoundMassDamping
from rodnet.terms.drag.line import _BoundLine
from rodnet.terms.drag.maxwell import _BoundMaxwell
from rodnet.terms.drag.stokes import _BoundSphere
from rodnet.terms.joints import _BoundJoints
from rodnet.terms.loads import _BoundLoad
from rodnet.terms.tendons import _BoundTendon

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.watch import Stage
    from rodnet.tangent.variation import Variation
    from rodnet.terms.base import BoundTerm

# a derivative of rates by positions that leaves nothing of a term's derivative but the part by rates [1/s]: of
# what else there is, round-off of the Jacobian itself is left
FAST = 1e16
# terms whose slots are all that they add to the Jacobian
_LOCAL = (_BoundLine, _BoundSphere, _BoundMassDamping, _BoundLoad)


def fits(model: Model) -> bool:
    """Whether a model's residual depends on what a step begins with only in the ways that are known here."""
    return model.bodies is None and not model.coupling


def by_acceleration(ev: Evaluation, terms: list[BoundTerm], data: np.ndarray, scrap: np.ndarray) -> None:
    """Put minus the derivative of forces of inertia by the accelerations into ``data``, as values of a Jacobian."""
    ca, ev.ca, data[:] = ev.ca, FAST, 0.0
    for b in terms:
        b.add(ev, scrap, data, True)
    ev.ca = ca
    data *= 1.0 / FAST


class Fast:
    """Stages of one model, for many columns at a time.

    Parameters
    ----------
    model : Model
        The model, for which `fits` holds.
    newton : Newton
        Whose evaluation holds each solved stage.
    columns : list of Variation
        The columns; blocks have as many columns, and more up to a multiple of eight.

    Attributes
    ----------
    parts : list of (Part or None)
        What each column changes; None where that takes whole evaluations.
    memories : dict
        By number of the bound term: what knows how its memory changes.
    deaf : set of int
        Bound terms whose memory changes no force.
    held : HeldTangent or None
        What knows of all that is prescribed, if columns change it.
    """

    def __init__(self, model: Model, newton: Newton, columns: list[Variation]) -> None:
        self.model, self.newton, self.count = model, newton, len(columns)
        self.wide = -(-max(self.count, 1) // 8) * 8
        self.memories = memories(model, columns)
        self.deaf = {k for k, b in enumerate(model.bound) if isinstance(b, _BoundJoints)}
        self.parts: list[Part | None] = [self._part(column) for column in columns]
        moving = {c: part.near for c, part in enumerate(self.parts) if part is not None and part.moves}
        self.held = HeldTangent(model, moving) if moving else None
        self._D = np.zeros(len(model.data))
        self._scrap = np.zeros(model.dof_count)
        self._rated = [
            b
            for b in model.adding
            if not (isinstance(b, _BoundMaxwell | _BoundTendon) or (isinstance(b, _BoundLoad) and b.law.dead))
        ]
        self._inertial = [b for b in model.adding if b.inertial]
        self._M = np.zeros(len(model.data)) if self._inertial else None
        self._acting = [part for part in self.parts if part is not None and not part.idle]
        self._acting_columns = np.array(
            [c for c, part in enumerate(self.parts) if part is not None and not part.idle], dtype=np.int64
        )
        linear = [(c, part.linear) for c, part in enumerate(self.parts) if part is not None]
        self._linear = LinearChanges(model, newton.ev, linear)
        self._own = np.zeros((len(self._acting), model.dof_count))
        self._sources = np.zeros((model.dof_count + model.edge_count, self.wide))
        self._v0, self._a0, self._da = np.zeros((3, model.dof_count * self.wide))
        self._out = np.zeros((model.dof_count, self.wide))
        self._weighed: dict[tuple[Any, ...], tuple[list[int], np.ndarray]] = {}
        self._y = np.zeros((len(model.free), self.wide))
        for number, memory in self.memories.items():
            memory.take(number, self.parts)
        # equations that stand in the place of others: what changes those does not change them
        rows = [b.rows for b in model.adding if b.replacing]
        self._replaced = model.free[np.concatenate(rows)] if rows else None
        self._pack()

    def _part(self, column: Variation) -> Part | None:
        try:
            part = Part(self.model, self.newton.ev, column)
        except Unfit:
            return None
        return part if all(k in self.memories for k, _ in part.motors) else None

    def _pack(self) -> None:
        from rodnet.packed import Packed
        from rodnet.tangent import elastic_kernels, solve_kernels, step_kernels

        m, ev = self.model, self.newton.ev
        self._kernels, self._elastic_kernels, self._solve_kernels = (
            step_kernels,
            elastic_kernels,
            solve_kernels,
        )
        self._edges = Packed(step_kernels.EDGES, m.edges, ev.L, ev.T, ev.S, ev.ts, ev.v, ev.F)
        places = np.arange(1.0, m.solver.size + 1.0)
        A = m.solver.matrix(places)
        A.sort_indices()
        self._tree = m.solver._tree
        free = m.free.astype(np.int64)
        position = np.arange(len(free))
        if self._tree is not None:
            self._order = self._tree._factors[0].astype(np.int64)
            position[self._order] = np.arange(len(free))
        start, column, place = self._asked(A)
        entry = np.zeros(2 * int(np.diff(start).max(initial=0)), dtype=np.int64)
        self._rows = Packed(
            step_kernels.ROWS, start, place, free[column], free, position, m.mass, entry, np.zeros(len(entry))
        )
        self._position = position
        self._changes = self._packed_changes()
        self._elastic = Packed(
            elastic_kernels.ELASTIC, m.edges, ev.L, ev.T, ev.M1, ev.M2, ev.S, m.rest_length, ev.stretch, m.edge1,
            m.edge2, m.Q1, m.Q2, m.sign1, m.sign2, m.spring_dofs, ev.eps, m.eps0, m.axial_stiffness,
        )  # fmt: skip

    def _asked(self, A: csr_matrix) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Entries of the Jacobian that a right-hand side may ask for: of twist angles, and of rates.

        ``A`` holds their places, counted from one.
        """
        m = self.model
        place = A.data.astype(np.int64) - 1
        rated = np.zeros(len(m.data), dtype=bool)
        for b in self._rated:
            if isinstance(b, _LOCAL):
                slots_of_rates = list(b.slots)
                if isinstance(b, _BoundLine):  # laws are local: they see the rates of the site's own node
                    slots_of_rates[0] = b.slots[0][:, :, :1]
                for slots in slots_of_rates:
                    for k in range(3):  # one number may stand for three columns
                        rated[np.minimum(slots + k, len(m.data) - 1)] = True
            else:
                rated[:] = True
        keep = rated[place] | (m.free[A.indices] >= m.twist0)
        start = np.concatenate([[0], np.cumsum(keep)])[A.indptr]
        return start.astype(np.int64), A.indices[keep].astype(np.int64), place[keep]

    def _packed_changes(self):
        from rodnet.packed import Packed

        m = self.model
        which = [
            c for c, part in enumerate(self.parts) if part is not None and (part.elastic or part.viscous)
        ]
        if not which:
            return None

        def stacked(name: str, shape: tuple[int, ...]) -> np.ndarray:
            arrays = [getattr(self.parts[c], name) for c in which]
            full = [np.zeros(shape) if a is None else a for a in arrays]
            return np.ascontiguousarray(np.stack(full, axis=-1))

        s, e = m.spring_count, m.edge_count
        viscous = any(self.parts[c].viscous for c in which)  # type: ignore[union-attr]
        damped, pulling = (s, e) if viscous else (0, 0)
        return Packed(
            self._elastic_kernels.CHANGES, np.array(which, dtype=np.int64), stacked("axial", (e,)),
            stacked("lengths", (e,)), stacked("stiffness", (s, 3, 3)), stacked("offset", (s, 3)),
            stacked("pull", (pulling,)), stacked("viscosity", (damped, 3, 3)),
        )  # fmt: skip

    # -- one stage --------------------------------------------------------------------------
    def matrices(self, stage: Stage) -> None:
        """Factorise the Jacobian at the solution, and find its part that comes from the rates."""
        m, newton, ev = self.model, self.newton, self.newton.ev
        if not newton._has_jacobian:
            newton._residual(stage.now, stage.elapsed, stage.motion, True, StepReport())
        m.solver.factor(m.data)
        cv, D = ev.cv, self._D
        D[:] = 0.0
        ev.cv = FAST
        for b in self._rated:
            b.add(ev, self._scrap, D, True)
        ev.cv = cv
        D *= 1.0 / FAST
        if self._M is not None:
            by_acceleration(ev, self._inertial, self._M, self._scrap)

    def solve(
        self,
        stage: Stage,
        tangent: StateTangent,
        done: Rates,
        rest: np.ndarray | None,
        held: np.ndarray | None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives of a solved stage: degrees of freedom, rates, accelerations, and spins of the directors.

        Parameters
        ----------
        stage : Stage
            The stage.
        tangent : StateTangent
            Of the state that the step begins with.
        done : list
            Derivatives of the rates of the stages before.
        rest : ndarray, shape (dof_count, k), optional
            Change of the residual that comes from elsewhere.
        held : ndarray, shape (3, held, k), optional
            Changes of what is prescribed, its rates and accelerations.
        """
        m, k = self.model, self._kernels
        self.matrices(stage)
        shape = m.dof_count, self.wide
        cv, ca = stage.motion.cv, stage.motion.ca
        blocks, weights = self._offsets(stage, tangent, done)
        v0, a0, da, flat = self._v0, self._a0, self._da, self._sources.reshape(-1)
        out = self._out if rest is None else rest
        k.begin(
            blocks, weights, tangent.q.reshape(-1), m.held, self.wide, cv, ca, v0, a0, flat, da, out.reshape(-1),
            rest is None,
        )  # fmt: skip
        q_old, known = tangent.q, None
        if self.held is not None:
            known = self.held.change(stage, tangent, self.newton.ev.q)
        if held is not None and len(m.held):  # what they change comes from elsewhere
            q_old = q_old.copy()
            q_old[m.held] = 0.0
        replaced = None if self._replaced is None else out[self._replaced]
        self._change(stage, tangent, out)
        edges, rows, wide, twist0 = self._edges.table, self._rows.table, self.wide, m.twist0
        x_old, spin_old = stage.state.q, tangent.spin.reshape(-1)
        k.turn_sources(edges, twist0, wide, x_old, q_old.reshape(-1), spin_old, flat, out.reshape(-1))
        if self.held is not None and known is not None:
            self.held.add(stage, self.newton.ev, tangent, done, known, self._sources, out)
        if self._replaced is not None:
            out[self._replaced] = replaced
        if self._M is not None:
            out[m.free] += m.solver.matrix(self._M) @ da.reshape(shape)[m.free]
        y = self._y
        k.right_sides(rows, twist0, wide, m.data, self._D, cv, ca, flat, da, out.reshape(-1), y.reshape(-1))
        y = self._solved(y)
        changes = known if held is None else held
        create = np.zeros if len(m.held) and changes is None else np.empty
        dq, dv_new, da_new = create(shape), create(shape), create(shape)
        spin = np.empty((m.edge_count, wide))
        if len(m.held) and changes is not None:
            dq[m.held], dv_new[m.held], da_new[m.held] = changes
            if held is not None:  # now all that turns the frames
                k.turn_sources(
                    edges, twist0, wide, x_old, tangent.q.reshape(-1), spin_old, flat, out.reshape(-1)
                )
        k.advance(
            edges, rows, twist0, wide, y.reshape(-1), cv, ca, tangent.q.reshape(-1), v0, a0, flat,
            dq.reshape(-1), dv_new.reshape(-1), da_new.reshape(-1), spin.reshape(-1),
        )  # fmt: skip
        return dq, dv_new, da_new, spin

    @property
    def turned(self) -> np.ndarray:
        """Angles (edge_count, k) by which the solved stage's changed source frames turn directors."""
        return self._sources[self.model.dof_count :]

    def _offsets(
        self, stage: Stage, tangent: StateTangent, done: Rates
    ) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
        """Blocks of which the stepper's offsets are weighted sums, and their weights for v0 and a0."""
        blocks = [tangent.q, tangent.v, tangent.a, tangent.acc, *(block for pair in done for block in pair)]
        key = stage.stepper, stage.dt, len(blocks)
        if key not in self._weighed:
            if len(self._weighed) >= 16:  # the step size varies
                self._weighed.clear()
            unit = np.eye(len(blocks))
            state: Any = SimpleNamespace(q=unit[0], v=unit[1], a=unit[2], acc=unit[3])
            pairs = [(unit[k], unit[k + 1]) for k in range(4, len(blocks), 2)]
            v0, a0 = stage.stepper.offsets(state, stage.dt, pairs)
            weights = np.stack([np.zeros(len(blocks)) if v0 is None else v0, a0])
            some = np.flatnonzero(weights.any(axis=0))
            self._weighed[key] = some.tolist(), np.ascontiguousarray(weights[:, some])
        which, weights = self._weighed[key]
        return tuple([blocks[k].reshape(-1) for k in which]), weights

    def _change(self, stage: Stage, tangent: StateTangent, out: np.ndarray) -> None:
        """Add what columns change, and what the memories that are known here do, to the residual's change."""
        ev = self.newton.ev
        if self._changes is not None:
            K = self.model.quadratic_stiffness()
            self._elastic_kernels.elastic_changes(self._elastic.table, self._changes.table, K, ev.state, out)
        self._linear.add(self.newton._a, out)
        if self._acting:
            self._own[:] = 0.0
            for row, part in zip(self._own, self._acting, strict=True):
                part.add(stage, row)
            self._kernels.spread(self._own, self._acting_columns, out)
        for number, memory in self.memories.items():
            memory.add(stage, ev, tangent.memories[number], out)

    def accepted(self, begin: State, new: State) -> None:
        """Let what columns add to the model keep its memories."""
        for part in self._acting:
            if part.added is not None:
                part.added.accepted(begin, new)

    def _solved(self, y: np.ndarray) -> np.ndarray:
        """Solution of the stage's linear systems, rows in the order of elimination."""
        solver = self.model.solver
        tree = self._tree
        if (
            tree is not None
            and solver._quick is tree
            and solver._general is None
            and solver._growth <= GROWTH_LIMIT
        ):
            self._solve_kernels.solve_wide(y.reshape(-1), self.wide, *tree._factors[1:])
            return y
        b = np.ascontiguousarray(y[self._position])
        x = np.empty_like(y)
        x[self._position] = solver.solve(b)
        return x
