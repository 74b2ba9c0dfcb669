"""The tangent of what is prescribed: what grippers change reaches the rest through the Jacobian's other columns.

Prescribed degrees of freedom are eliminated, and no column of the Jacobian is theirs. A second model, the same but
that nothing is eliminated, has them all: the change of the residual is its stiffness times their changes and its
damping times those of their rates.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np
from scipy.sparse import csr_matrix

from rodnet.solve.evaluation import Evaluation
from rodnet.solve.model import Model
from rodnet.tangent.compare import alike
from rodnet.terms.constraints import BoundConstraint

if TYPE_CHECKING:
    from rodnet.solve.bodies import Bodies
    from rodnet.solve.steppers import Rates
    from rodnet.solve.watch import Stage
    from rodnet.tangent.state import StateTangent
    from rodnet.terms.prescribed import PrescribedState

# a derivative of rates by positions beside which nothing else is left of a term's derivative [1/s]
FAST = 1e16

Near = list[tuple[float, Model]]


class _Released(Model):
    """A model all of whose degrees of freedom have their places in the Jacobian."""

    def _eliminate(self, bodies: Bodies | None) -> None:
        super()._eliminate(bodies)
        self.free = self.reduced = np.arange(self.dof_count, dtype=np.int32)


def _differing(model: Model, near: Near) -> list[tuple[float, PrescribedState]]:
    """Weights, and what prescribes a motion that differs from the model's."""
    moving = [k for k, b in enumerate(near[0][1].bound) if isinstance(b, BoundConstraint) and b.moving]
    changed = [k for k in moving if not all(alike(model.bound[k], m.bound[k]) for _, m in near)]
    return [(weight, cast(BoundConstraint, m.bound[k]).state) for weight, m in near for k in changed]


class HeldTangent:
    """Changes of prescribed motion, for all columns at a time.

    Parameters
    ----------
    model : Model
        The model, for which `knows` holds.
    near : dict
        By column: weights of a difference quotient, and models whose prescribed motion differs.
    """

    def __init__(self, model: Model, near: dict[int, Near]) -> None:
        self.model = model
        self.near = {column: _differing(model, models) for column, models in near.items()}
        self.released = _Released(model.robot)
        self.ev = Evaluation(self.released)
        places = self.released.solver.matrix(np.arange(1.0, self.released.solver.size + 1.0)).tocsr()
        block = places[model.free][:, model.held].tocsr()
        self._place, self._shape = block.data.astype(np.int64) - 1, block.shape
        self._entries = block.indices, block.indptr
        self._D, self._scrap = np.zeros(len(self.released.data)), np.zeros(model.dof_count)
        self._inertial = [b for b in self.released.adding if b.inertial]
        turns = (model.held >= model.twist0) & (model.held < model.turn0)
        self._turns, self._edges = np.flatnonzero(turns), model.held[turns] - model.twist0
        driven = np.concatenate([c.dofs for c in model.moving])
        self._moving = np.isin(model.held, driven)
        self._follows = self._moving[
            self._turns
        ]  # what is prescribed of these edges are directors, not angles

    @staticmethod
    def knows(model: Model) -> bool:
        """Whether the forces of a model depend on nothing but its motion."""
        steady = not any(b.memory is not None or b.replacing for b in model.bound)
        return bool(model.moving) and steady and not model.robot.sensors

    def change(self, stage: Stage, tangent: StateTangent, now: np.ndarray) -> np.ndarray:
        """Changes of prescribed degrees of freedom ``now``, rates and accelerations, as far as models tell.

        Shape (3, held, k). Of directors they are at fixed source frames.
        """
        held, state = self.model.held, stage.state
        found = np.zeros((3, len(held), tangent.count))
        found[0, ~self._moving] = tangent.q[held[~self._moving]]
        twist0, source = self.model.twist0, (state.tangents, state.directors)
        h = self.model.span(stage.dt)
        v, a = np.zeros((2, len(now)))
        for column, near in self.near.items():
            for weight, c in near:
                q = now.copy()
                c.place(q, stage.now)
                c.orient(q, stage.now, state.q[twist0:], source)
                found[0, :, column] += weight * q[held]
                if stage.stepper.exact_rates:
                    c.move(q, stage.now, h, v, a)
                    found[1, :, column] += weight * v[held]
                    found[2, :, column] += weight * a[held]
                    v[held], a[held] = 0.0, 0.0
        return found

    def add(
        self, stage: Stage, ev: Evaluation, tangent: StateTangent, done: Rates, found: np.ndarray,
        sources: np.ndarray, out: np.ndarray,
    ) -> None:  # fmt: skip
        """Add the change of the residual to ``out``, and to ``found`` what changed source frames do.

        ``sources`` are those of `rodnet.tangent.step_kernels.turn_sources`, of which those of what is held are of
        frames alone.
        """
        m, cv, ca = self.model, stage.motion.cv, stage.motion.ca
        turned = sources[m.dof_count + self._edges]
        found[0, self._turns[self._follows]] -= turned[self._follows]
        if not stage.stepper.exact_rates:
            v0, a0 = stage.stepper.offsets(tangent, stage.dt, done)  # type: ignore[arg-type]
            moved = found[0] - tangent.q[m.held]
            found[1] = cv * moved + (0.0 if v0 is None else v0[m.held])
            found[2] = ca * moved + a0[m.held]
        shift, rates = found[0].copy(), found[1] + sources[m.held]
        shift[self._turns] += turned
        K, D, M = self._matrices(stage, ev)
        out[m.free] += K @ shift + D @ rates
        if M is not None:
            out[m.free] += M @ found[2]

    def _matrices(self, stage: Stage, ev: Evaluation) -> tuple[csr_matrix, csr_matrix, csr_matrix | None]:
        """Minus the derivatives of the free forces by what is held, its rates and accelerations, shape (free, held)."""
        m, mine, state = self.released, self.ev, stage.state
        mine.set_source(state.tangents, state.directors, state.tau, state.q)
        for b in m.beginning:
            b.begin_step(m, stage.now, stage.elapsed, stage.sensors, stage.inputs)
        mine.a[:], mine.ca = ev.a, ev.ca
        mine.update(ev.q, ev.rates, ev.t, ev.dt, ev.cv, True)
        data, self._D[:] = m.data[self._place], 0.0
        mine.cv = FAST
        for b in m.adding:
            b.add(mine, self._scrap, self._D, True)
        damping = self._D[self._place] / FAST
        mine.cv = ev.cv
        form = lambda values: csr_matrix((values, *self._entries), shape=self._shape)  # noqa: E731
        if not self._inertial:
            return form(data - ev.cv * damping), form(damping), None
        self._D[:] = 0.0
        mine.ca = FAST
        for b in self._inertial:
            b.add(mine, self._scrap, self._D, True)
        inertia = self._D[self._place] / FAST
        return form(data - ev.cv * damping - ev.ca * inertia), form(damping), form(inertia)
