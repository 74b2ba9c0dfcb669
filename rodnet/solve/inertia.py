"""Accelerations that balance the forces at the start of a run, where forces of inertia depend on them."""

from __future__ import annotations

import numpy as np

from rodnet.errors import TermError
from rodnet.solve.evaluation import Evaluation


def starting_acceleration(ev: Evaluation, heavy: np.ndarray) -> np.ndarray:
    """Solve M a = F(a) at an evaluated state.

    Parameters
    ----------
    ev : Evaluation
        Evaluated at the state, with no acceleration.
    heavy : ndarray of int
        Free degrees of freedom that have mass.

    Returns
    -------
    ndarray, shape (len(heavy),)
        Their accelerations; the evaluation is at that state then.

    Raises
    ------
    TermError
        If there is no solution: a force that drives its own acceleration.
    """
    m = ev.model
    mass, start = m.mass[heavy], ev.F[heavy].copy()
    inertial = [b for b in m.bound if b.inertial]
    if not inertial:
        return start / mass
    from scipy.sparse.linalg import LinearOperator, cg

    def force(acceleration: np.ndarray) -> np.ndarray:
        ev.a[heavy] = acceleration
        return np.sum([b.forces(ev) for b in inertial], axis=0)[heavy]

    still = force(0.0 * start)
    shape = (len(heavy), len(heavy))
    # forces are linear in accelerations; in units of the root of mass the matrix is near the identity
    root = np.sqrt(mass)
    matrix = LinearOperator(shape, lambda y: y - (force(y / root) - still) / root, dtype=float)
    y, failed = cg(matrix, start / root, rtol=1e-12, atol=0.0, maxiter=10 * len(heavy))
    if failed:
        names = ", ".join(b.term.name for b in inertial)
        raise TermError(f"no acceleration at t = 0 balances the forces; look at the masses of {names}")
    return y / root
