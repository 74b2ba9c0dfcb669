"""Accelerations that balance the forces at the start of a run, where forces of inertia depend on them."""

from __future__ import annotations

import numpy as np

from rodnet.errors import TermError
from rodnet.solve.evaluation import Evaluation


def starting_acceleration(ev: Evaluation, a: np.ndarray) -> None:
    """Solve M a = F(a) at an evaluated state, in place; rigid bodies are at the start of a step.

    Parameters
    ----------
    ev : Evaluation
        Evaluated at the state, with no acceleration.
    a : ndarray, shape (dof_count,)
        Accelerations, with those that are prescribed.

    Raises
    ------
    TermError
        If there is no solution: a force that drives its own acceleration.
    """
    m = ev.model
    heavy = m.free[m.mass[m.free] > 0.0]
    start = ev.F.copy()

    def balance(F: np.ndarray) -> None:
        """Accelerations of the heavy degrees of freedom and of the bodies under given forces."""
        a[heavy] = F[heavy] / m.mass[heavy]
        if m.bodies is not None:
            ev.F[:] = F
            m.bodies.set_accelerations(m, ev, a)

    held = a.copy()
    balance(start)
    inertial = [b for b in m.bound if b.inertial]
    if not inertial:
        return
    from scipy.sparse.linalg import LinearOperator, gmres

    def forces() -> np.ndarray:
        return np.sum([b.forces(ev) for b in inertial], axis=0)

    ev.a[:] = 0.0
    without = forces()
    moved = heavy if m.bodies is None else np.concatenate([heavy, m.bodies.own.ravel()])
    moved = moved[m.reduced[moved] >= 0]

    def response(y: np.ndarray) -> np.ndarray:
        """Accelerations under the forces that go with accelerations ``y``."""
        ev.a[:] = held
        ev.a[moved] = y
        if m.bodies is not None:
            m.bodies.sweep(m, ev, ev.a)
        F = forces() - without
        if m.bodies is not None:
            m.bodies.gather(m, ev, F)
        a[:] = held
        balance(start + F)
        return a[moved]

    # linear in y: what it is without, and what each acceleration adds
    still = response(np.zeros(len(moved)))
    root = np.sqrt(m.metric[moved])
    change = LinearOperator((len(moved),) * 2, lambda y: y - root * (response(y / root) - still), dtype=float)
    y, failed = gmres(change, root * still, rtol=1e-13, atol=0.0, restart=min(len(moved), 200), maxiter=10)
    if failed:
        names = ", ".join(b.term.name for b in inertial)
        raise TermError(f"no acceleration at t = 0 balances the forces; look at the masses of {names}")
    response(y / root)
