"""Bend-twist springs under moments that belong to no energy: what damping and friction share.

A law gives the moments sigma conjugate to the strains (kappa1, kappa2, tau) of each spring, and their
derivatives R by the eleven degrees of freedom of its stencil. With the gradient B of the strains and
their second derivatives H_k the force is -B^T sigma and minus its derivative B^T R + sum sigma_k H_k
(docs, theory: dissipation). The Hessian comes from the elastic kernel, as that of a linear energy.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.pattern import Pattern

STENCIL = 11  # x0, theta1, x1, theta2, x2


def runs_against(model: Model, springs: np.ndarray) -> np.ndarray:
    """Whether springs have a stencil that runs against their rod: those of walls at a rod's end, shape (n,)."""
    return (model.edge1[springs] >= model.graph.edge_count) & (model.sign2[springs] < 0)


class SpringMoments:
    """Adds the forces of given moments on some of a model's springs.

    Parameters
    ----------
    model : Model
        The model.
    springs : ndarray of int, shape (n,)
        Which springs.

    Attributes
    ----------
    dofs : ndarray of int32, shape (n, 11)
        Stencils of the springs, for the bound term to declare.
    """

    def __init__(self, model: Model, springs: np.ndarray) -> None:
        self.model, self.springs = model, springs
        self.dofs = np.ascontiguousarray(model.spring_dofs[springs])
        self.edge1, self.edge2 = model.edge1[springs], model.edge2[springs]
        self.sign1, self.sign2 = model.sign1[springs], model.sign2[springs]
        n = len(springs)
        # three copies of every spring, each with one strain as its energy and a block of its own
        self._own = np.arange(3 * n * STENCIL, dtype=np.int32).reshape(3 * n, STENCIL)
        rows = STENCIL * np.arange(3 * n * STENCIL).reshape(3 * n, STENCIL)
        self._own_slots = np.ascontiguousarray(
            (rows[:, :, None] + np.array([0, 3, 4, 7, 8])).astype(np.int32)
        )
        self._thrice = [np.repeat(a, 3, axis=0) for a in (self.edge1, self.edge2, self.sign1, self.sign2)]
        self._unit, self._flat = np.tile(np.eye(3), (n, 1)), np.zeros((3 * n, 3, 3))
        self._none = np.zeros((n, 3, 3))
        self._gradient, self._scrap = np.zeros(3 * n * STENCIL), np.zeros(1)
        self._hessian: np.ndarray | None = None  # large, and not asked for by every law

    def find_slots(self, pattern: Pattern, reduced: np.ndarray) -> None:
        """Find the places of the springs' blocks; ``reduced`` are their free degrees of freedom."""
        self.slots = pattern.places(reduced)
        columns = pattern.triple_places(reduced, [0, 4, 8]), pattern.places(reduced, reduced[:, [3, 7]])
        self._columns = np.ascontiguousarray(np.concatenate(columns, axis=2)[:, :, [0, 3, 1, 4, 2]])

    def gradient(self, ev: Evaluation, hessian: bool = False) -> tuple[np.ndarray, np.ndarray | None]:
        """Return B, shape (n, 3, 11), and if asked for the second derivatives, shape (n, 3, 11, 11)."""
        m, n = self.model, len(self.springs)
        e1, e2, s1, s2 = self._thrice
        Q1, Q2 = (np.repeat(Q[self.springs], 3, axis=0) for Q in (m.Q1, m.Q2))
        self._gradient[:] = 0.0
        data = self._scrap
        if hessian:
            if self._hessian is None:
                self._hessian = np.zeros(3 * n * STENCIL**2)
            data = self._hessian
            data[:] = 0.0
        self._kernel(
            e1, e2, Q1, Q2, s1, s2, self._own, ev.L, ev.T, ev.M1, ev.M2, ev.S, ev.ts, self._unit, self._unit,
            self._flat, self._gradient, self._own_slots, data, hessian,
        )  # fmt: skip
        B = -self._gradient.reshape(n, 3, STENCIL)
        return B, data.reshape(n, 3, STENCIL, STENCIL) if hessian else None

    def add(
        self, ev: Evaluation, sigma: np.ndarray, D: np.ndarray | None, F: np.ndarray, data: np.ndarray
    ) -> float:
        """Add the forces of the moments ``sigma`` (n, 3) and, with their derivatives ``D`` (n, 3, 3) by the strains,
        minus the derivatives of these forces.

        Returns the largest force [N].
        """
        force = self.add_forces(ev, np.ascontiguousarray(sigma), F, data, D is not None)
        if D is not None:
            B, _ = self.gradient(ev)
            R = np.einsum("nkl,nli->nki", D, B)
            np.add.at(data, self.slots, np.einsum("nki,nkj->nij", B, R))
        return force

    def add_forces(
        self, ev: Evaluation, sigma: np.ndarray, F: np.ndarray, data: np.ndarray, jac: bool
    ) -> float:
        """Add the forces of moments, and with ``jac`` minus their derivatives at fixed moments; return the largest."""
        m = self.model
        force, _ = self._kernel(
            self.edge1, self.edge2, m.Q1[self.springs], m.Q2[self.springs], self.sign1, self.sign2, self.dofs,
            ev.L, ev.T, ev.M1, ev.M2, ev.S, ev.ts, sigma, sigma, self._none, F, self._columns,
            data if jac else self._scrap, jac,
        )  # fmt: skip
        return float(force)

    @property
    def _kernel(self):
        from rodnet.kinematics.kernels import spring_forces

        return spring_forces
