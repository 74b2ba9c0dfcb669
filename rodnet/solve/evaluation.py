"""Everything that is known at one state: geometry, strains, stresses, forces, Jacobian."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rodnet.solve.body_motion import BodyMotion

if TYPE_CHECKING:
    from rodnet.solve.model import Model


class Evaluation:
    """A model evaluated at one state; the arrays are buffers that the next state overwrites.

    Attributes
    ----------
    q, rates : ndarray, shape (dof_count,)
        Degrees of freedom and their rates ([m], [rad] and per s).
    a : ndarray, shape (dof_count,)
        Accelerations, for forces of inertia; zero where no step is taken.
    x, v : ndarray, shape (node_count, 3)
        Positions [m] and velocities [m/s], views of these.
    theta, w : ndarray, shape (edge_count,)
        Twist angles [rad] and their rates [rad/s], views likewise.
    L, T, M1, M2 : ndarray
        Lengths [m], tangents and material directors of the edges.
    S : ndarray, shape (edge_count, 3)
        Holonomy vectors (ts x t) / (1 + ts.t) of the edges against their source tangents ``ts``.
    eps : ndarray, shape (spring_count, 3)
        Strains (kappa1, kappa2, tau) of the springs [rad], relative to the natural shape.
    stretch : ndarray, shape (edge_count,)
        Axial strain of the edges.
    stress, modulus : ndarray, shapes (spring_count, 3) and (spring_count, 3, 3)
        Derivatives of the energy by the springs' strains [N m].
    stretch_stress, stretch_modulus : ndarray, shape (edge_count,)
        Derivatives of the energy per unit length by the axial strain [N].
    F : ndarray, shape (dof_count,)
        Sum of all forces, -dE/dq included.
    cv, ca : float
        Derivatives of velocity and acceleration by the position that the stepper imposes [1/s], [1/s^2].
    bodies : BodyMotion or None
        What the rigid bodies carry. Forces and Jacobian are then those on the bodies.
    fold : float
        Smallest 1 + cos of a turning angle.
    force_scale, moment_scale : float
        Largest force [N] and moment [N m] of one edge, spring or site.
    """

    eps: np.ndarray
    driven_ref: np.ndarray

    def __init__(self, model: Model) -> None:
        from rodnet.kinematics import kernels

        n, e, s = model.node_count, model.edge_count, model.spring_count
        self.model, self._kernels = model, kernels
        self.t = self.dt = self.cv = self.ca = 0.0
        self.q: np.ndarray = np.zeros(model.dof_count)
        self.rates: np.ndarray = np.zeros(model.dof_count)
        self.a: np.ndarray = np.zeros(model.dof_count)
        self.x, self.theta = self.q[: 3 * n].reshape(-1, 3), self.q[3 * n : 3 * n + e]
        self.v, self.w = self.rates[: 3 * n].reshape(-1, 3), self.rates[3 * n : 3 * n + e]
        self.ts: np.ndarray = model.t0.copy()
        self.d1s: np.ndarray = model.d10.copy()
        self.tau_ref, self.driven_ref, self.theta_ref = np.zeros(s), np.zeros(s), np.zeros(e)
        self.L, self.stretch, self.stretch_stress, self.stretch_modulus = np.zeros((4, e))
        self.T, self.M1, self.M2, self.S = np.zeros((4, e, 3))
        self.eps, self.stress = np.zeros((s, 3)), np.zeros((s, 3))
        # where all laws of the springs are quadratic the moduli are constant
        self.modulus = np.zeros((s, 3, 3)) if model.stressing else model.quadratic_stiffness()
        self.F: np.ndarray = np.zeros(model.dof_count)
        self._group()
        self.bodies: BodyMotion | None = None
        if model.bodies is not None:
            self.bodies = BodyMotion(model.bodies, model, self)
        self.fold = 2.0
        self.force_scale = self.moment_scale = 0.0

    def _group(self) -> None:
        """Collect the kernels' arguments that never change: handing them over costs more than small kernels do."""
        from rodnet.packed import Packed

        m = self.model
        geometry = self.L, self.T, self.M1, self.M2, self.S, m.rest_length
        springs = m.edge1, m.edge2, m.Q1, m.Q2, self.eps
        derivatives = self.stretch_stress, self.stretch_modulus, self.stress, self.modulus
        places = m.sign1, m.sign2, m.stretch_dofs, m.stretch_slots, m.spring_dofs, m.spring_slots
        source = self.ts, self.d1s, self.tau_ref, self.theta_ref, m.driven, self.driven_ref, m.spin
        n, dn, dpsi, ddpsi = derivatives
        states = self.x, self.theta, m.edges, *geometry, self.stretch, *springs
        self._configure = *states, m.axial_stiffness, n, dn, m.eps0, dpsi, ddpsi, *source
        self._elastic = m.edges, *geometry, *springs, *derivatives, *places, self.F, self.ts
        self._quadratic = Packed(self._kernels.QUADRATIC, *self._configure[:-7], *places, self.F, *source)
        # what terms see of a state
        kinematics = self.x, self.v, self.theta, self.w, m.edges, self.L, self.T, self.S, self.ts
        self._state = Packed(self._kernels.STATE, *kinematics)
        self.state = self._state.table

    def set_source(
        self,
        tangents: np.ndarray,
        directors: np.ndarray,
        tau: np.ndarray,
        q: np.ndarray | None = None,
        bodies: bool = True,
    ) -> None:
        """Take frames, twists and ``q`` of the last accepted state, where motors are now; without ``q``, zeros.

        Without ``bodies`` their orientations are left to the guess of a step (`BodyMotion.begin`).
        """
        self.ts[:], self.d1s[:], self.tau_ref[:] = tangents, directors, tau
        self.driven_ref[:] = self.model.driven
        self.theta_ref[:] = 0.0 if q is None else q[self.model.twist0 : self.model.turn0]
        if bodies and self.bodies is not None:
            if q is None:
                raise ValueError("a robot with rigid bodies needs q of the last accepted state")
            self.bodies.set_source(q)

    def update(self, q: np.ndarray, v: np.ndarray, t: float, dt: float, cv: float, jac: bool) -> bool:
        """Evaluate everything at ``q`` with rates ``v``; with ``jac`` also fill ``model.data``.

        Returns False for a folded state, where forces are not defined.
        """
        self.q[:] = q
        self.rates[:] = v
        if self.bodies is not None:
            self.bodies.place()
        return self.assemble(t, dt, cv, jac)

    def assemble(self, t: float, dt: float, cv: float, jac: bool, reduced: bool = True) -> bool:
        """Evaluate everything at the state that the buffers ``q`` and ``rates`` hold; see `update`.

        Unless ``reduced``, forces and Jacobian of what rigid bodies carry are not moved to the bodies.
        """
        m = self.model
        self.t, self.dt, self.cv = t, dt, cv
        if self.bodies is not None and self.bodies.too_far:
            self.fold = 0.0
            return False
        data, kernels = m.data if jac else m.scrap, self._kernels
        K = m.quadratic_stiffness() if m.summed_version != m.stiffness_version else m.summed_stiffness
        if m.stressing:
            self.fold = kernels.configure(*self._configure, K)
            if not self.fold > kernels.FOLD:
                return False
            for b in m.stressing:
                b.stress(self)
            largest, self.moment_scale = kernels.elastic_forces(*self._elastic, data, jac)
        else:
            self.fold, largest, self.moment_scale = kernels.quadratic_forces(
                self._quadratic.table, K, data, jac
            )
            if not self.fold > kernels.FOLD:
                return False
        F = self.F
        for b in m.adding:
            force = b.add(self, F, data, jac)
            if force > largest:
                largest = force
        if jac and m.coupling:
            m.couple(self)
        self.force_scale = largest
        if reduced and self.bodies is not None:
            force, moment = self.bodies.reduce(cv, data, jac)
            self.force_scale, self.moment_scale = max(largest, force), max(self.moment_scale, moment)
        return True

    def spring_moments(self) -> np.ndarray:
        """Moment vector of each spring, dE = moment . (rotation of edge 2 - of edge 1), shape (S, 3) [N m]."""
        from rodnet.kinematics.moments import spring_moments

        m, moment = self.model, np.empty_like(self.stress)
        spring_moments(m.edge1, m.edge2, m.Q1, m.Q2, self.T, self.M1, self.M2, self.stress, moment)
        return moment
