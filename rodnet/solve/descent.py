"""Descent to a minimum of the energy: what to do where Newton's method is drawn to a saddle.

Newton's method looks for a balance of forces and takes an unstable one as readily as a stable one: a
net under its own weight, whose rods buckle all over, has many. The elimination of the symmetric
Hessian tells in how many directions the energy falls away, and which; with these curvatures
taken as positive an update leads down, and away from saddles.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import SuperLU, splu

from rodnet.solve.steppers import ImplicitEuler, State

if TYPE_CHECKING:
    from rodnet.simulation import Simulation
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model

UPDATES = 60  # of one descent
HALVINGS = 30
PUSH = 1e-6  # of the robot's size, where an equilibrium is unstable
ROUND_OFF = 1e-13  # a pivot of the matrix scaled to a unit diagonal that is this small has no sign


class Inertia:
    """Elimination of a symmetric matrix on its diagonal, K = L D L^T up to scaling and ordering.

    There are as many negative pivots in D as K has negative eigenvalues (Sylvester). A column x of L^-T
    that belongs to one is a direction with x.K x < 0, and those of several pivots are conjugate.

    Parameters
    ----------
    K : csc_matrix, shape (n, n)
        Symmetric, its whole diagonal stored.
    shift : ndarray, shape (n,)
        What to add to the diagonal.

    Attributes
    ----------
    known : bool
        Whether elimination succeeded without leaving the diagonal; if not, there is no `descent`.
    directions : ndarray, shape (n, k)
        Conjugate directions of negative curvature, scaled to x.K x = -1.
    """

    def __init__(self, K: csc_matrix, shift: np.ndarray) -> None:
        n = K.shape[0]
        self.known, self.directions = False, np.zeros((n, 0))
        if not n or not np.all(np.isfinite(K.data)):
            return
        # the order of elimination is a good one only if indices are sorted and zeros stay in place
        A = csc_matrix(K, copy=True)
        A.sort_indices()
        columns = np.repeat(np.arange(n), np.diff(A.indptr))
        A.data[A.indices == columns] += shift
        size = np.abs(A.diagonal())
        self._scale = 1.0 / np.sqrt(np.where(size > 0.0, size, 1.0))
        A.data *= self._scale[A.indices] * self._scale[columns]
        try:
            lu = splu(A, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        except RuntimeError:  # a pivot is zero
            return
        if np.any(lu.perm_r != lu.perm_c):
            return
        self.known, self._lu = True, lu
        self.directions = self._negative(A, lu)

    def _negative(self, A: csc_matrix, lu: SuperLU) -> np.ndarray:
        pivots = lu.U.diagonal()
        found = np.flatnonzero(pivots < -ROUND_OFF)
        if not len(found):
            return np.zeros((len(pivots), 0))
        found = found[np.argsort(pivots[found], kind="stable")]
        # L^-T e_k = A^-1 L D e_k
        x = lu.solve(lu.L[:, found].toarray()[lu.perm_c]) * pivots[found]
        # the curvature itself is hardly rounded: it tells instability from the noise of a rigid mode
        curvature = np.sum(x * (A @ x), axis=0)
        real = curvature < -ROUND_OFF * np.sum(x * x, axis=0)
        return self._scale[:, None] * x[:, real] / np.sqrt(-curvature[real])

    def descent(self, b: np.ndarray) -> np.ndarray:
        """Newton update for the load ``b`` with the negative curvatures taken as positive ones, shape (n,).

        So it leads down the energy and away from a saddle, where K^-1 b leads to it.
        """
        x = self._scale * self._lu.solve(self._scale * b)
        return x + self.directions @ (2.0 * (self.directions.T @ b))


def conservative(K: csc_matrix) -> bool:
    """Whether a tangent stiffness is that of an energy."""
    if K.nnz == 0:
        return False
    return np.abs((K - K.T).data).max(initial=0.0) <= 1e-9 * np.abs(K.data).max()


def push(model: Model, directions: np.ndarray) -> np.ndarray:
    """Small displacement of the free degrees of freedom along all the given directions, shape (n,)."""
    moved = np.abs(directions[model.free < model.twist0]).max(axis=0, initial=0.0)
    largest = np.maximum(moved, 1e-3 * np.abs(directions).max(axis=0))
    return PUSH * model.graph.size * (directions / largest).sum(axis=1)


def scaled(model: Model, ev: Evaluation, residual: np.ndarray) -> float:
    """Largest residual against the largest force (positions) or moment (twists) of the evaluated state."""
    size = np.abs(residual)
    k = int(np.searchsorted(model.free, model.twist0))
    force = max(ev.force_scale, 1e-300)
    moment = max(ev.moment_scale, force * float(model.rest_length.min()))
    return max(float(size[:k].max(initial=0.0)) / force, float(size[k:].max(initial=0.0)) / moment)


class _Slope:
    """Residual of a proximal step, M (q - start) / dt^2 - F at rest, along updates from ``q``."""

    def __init__(self, sim: Simulation, start: np.ndarray, t: float, dt: float) -> None:
        self.model, self.ev, self.t = sim.model, sim.newton.ev, t
        self.start, self.q = start, start.copy()
        self.inertia = self.model.metric[self.model.free] / dt**2
        self.rest, self.update = np.zeros((2, self.model.dof_count))

    def evaluate(self, scale: float = 0.0, jac: bool = False) -> bool:
        """Put the evaluation at ``q + scale * update``; False where that is folded."""
        return self.ev.update(self.q + scale * self.update, self.rest, self.t, 1.0, 0.0, jac)

    def residual(self) -> np.ndarray:
        """Residual over the free degrees of freedom at the evaluated state."""
        free = self.model.free
        return self.inertia * (self.ev.q - self.start)[free] - self.ev.F[free]

    def along(self, scale: float) -> float:
        """Slope of what the step minimises along the update, infinite for a folded state."""
        if not self.evaluate(scale):
            return np.inf
        return float(self.residual() @ self.update[self.model.free])

    def longest(self) -> float:
        """Largest factor on the update for which no edge turns or stretches by more than half."""
        m = self.model
        x = self.update[: m.twist0].reshape(-1, 3)
        change = np.linalg.norm(x[m.edges[:, 1]] - x[m.edges[:, 0]], axis=1) / self.ev.L
        twist = np.abs(self.update[m.twist0 :]).max(initial=0.0)  # and rotations of rigid bodies
        longest = 1.0 / max(2.0 * change.max(initial=0.0), twist / 3.0, 1e-300)
        return (
            longest * m.largest_step(self.q, longest * self.update, self.ev.bodies) if m.bounding else longest
        )

    def search(self, unstable: bool) -> float | None:
        """Factor on the update that brings the energy down, by the trapezoidal rule; None if none does.

        Where the slope steepens the update leads out of a saddle, and is doubled.
        """
        first, longest = self.along(0.0), self.longest()
        scale = min(1.0, longest)
        for _ in range(HALVINGS):
            slope = self.along(scale)
            if slope <= 0.9 * abs(first):
                break
            scale *= 0.5
        else:
            return None
        while unstable and slope <= 0.5 * first and 2.0 * scale <= longest:
            slope = self.along(2.0 * scale)
            if slope > 0.0:
                break
            scale *= 2.0
        return scale


def descend(
    sim: Simulation, state: State, t: float, dt: float, sensors: Mapping[str, Any]
) -> tuple[State | None, int]:
    """Do a proximal step from rest by updates that do not climb.

    Parameters
    ----------
    sim : Simulation
        The simulation.
    state : State
        Where the step begins.
    t, dt : float
        Time at which loads are taken, and time step [s].
    sensors : mapping
        Their readings where the step begins.

    Returns
    -------
    state : State or None
        A minimum, or a state on the way there if edges have turned far from the frames that they began
        with; None if the updates do not converge, or there are loads without an energy.
    updates : int
        Their number.
    """
    model, newton = sim.model, sim.newton
    for b, memory in zip(model.bound, state.memories, strict=True):
        if memory is not None:
            b.restore(model, memory)
    newton.ev.set_source(state.tangents, state.directors, state.tau, state.q)
    for b in model.beginning:
        b.begin_step(model, t, dt, sensors, {})
    start = state.q.copy()
    if model.moving:
        model.prescribe(start, t, state.q[model.twist0 :], (state.tangents, state.directors))
    step = _Slope(sim, start, t, dt)
    for done in range(UPDATES):
        if not step.evaluate(jac=True):
            return None, done
        residual = step.residual()
        K = model.jacobian().tocsc()
        local = Inertia(K, step.inertia)
        if not (conservative(K) and local.known):
            return None, done
        unstable = local.directions.size > 0
        balanced = scaled(model, newton.ev, residual) <= newton.tolerance.residual
        update = push(model, local.directions) if balanced and unstable else local.descent(-residual)
        step.update[model.free] = update
        if step.ev.bodies is not None:
            step.ev.bodies.spread(step.update)
        # round-off may keep forces unbalanced: then nothing moves any more
        settled = np.abs(step.update[: model.twist0]).max() <= newton.tolerance.update * newton.length
        turned = newton.turns.largest(state) > 0.5 * np.pi
        if ((balanced or settled) and not unstable) or (done and (turned or newton.ev.fold < 0.5)):
            rest = step.rest
            if not newton.turns.count(state, rest.copy(), 0.0, 0.0):
                return None, done
            return newton._accepted(state, ImplicitEuler(), t, dt, rest, rest.copy(), None), done
        scale = step.search(unstable)
        if scale is None:
            return None, done
        step.q += scale * step.update
    return None, UPDATES
