"""Small motions about an equilibrium: vibration modes, decay and growth.

Linearised at rest, M a + C v + K q = 0 over the free degrees of freedom; a motion exp(rate t) solves
(rate^2 M + rate C + K) shape = 0 (docs, theory: modes and stability).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.sparse import csc_matrix, diags

from rodnet.errors import ParameterError
from rodnet.solve.statics import _slow_time
from rodnet.solve.steppers import State

if TYPE_CHECKING:
    from rodnet.robot import Robot
    from rodnet.simulation import Simulation

PRECISION = 1e-8  # of a mode
SHIFT = 0.3  # rate about which modes are sought, over that of the robot's slowest bending
FASTER = 30.0  # than bending: where modes are sought anew
BRIEF = 1e-9  # of the time of the slowest bending: in so short a step motors stand still
STILL = 1e-3  # rate over that of the slowest mode below which a motion counts as none: a rigid mode's noise


class Linearised(NamedTuple):
    """Stiffness, damping and mass over the free degrees of freedom, sparse (n, n), and their indices (n,)."""

    K: csc_matrix
    C: csc_matrix
    M: csc_matrix
    free: np.ndarray


@dataclass(frozen=True)
class Modes:
    """Small motions about an equilibrium, the slowest first.

    Attributes
    ----------
    rate : ndarray of complex, shape (m,)
        Motions go as exp(rate t) [1/s]; of a conjugate pair the one that turns forward.
    x : ndarray of complex, shape (m, N, 3)
        Displacements of the nodes, the largest of them 1 [m]; real where nothing is damped.
    theta : ndarray of complex, shape (m, E)
        Twist angles of the edges in the same measure [rad].
    still : float
        Rates below this are zero to round-off [1/s].
    """

    rate: np.ndarray
    x: np.ndarray
    theta: np.ndarray
    still: float

    def __len__(self) -> int:
        return len(self.rate)

    @property
    def frequency(self) -> np.ndarray:
        """Frequencies [Hz], shape (m,); 0 for what does not vibrate."""
        return self.rate.imag / (2.0 * np.pi)

    @property
    def decay(self) -> np.ndarray:
        """Rates of decay [1/s], shape (m,); negative for what grows."""
        return -self.rate.real

    @property
    def free(self) -> np.ndarray:
        """Which modes neither vibrate nor decay nor grow, shape (m,): rigid motions, as a rule."""
        return np.abs(self.rate) < self.still

    @property
    def stable(self) -> bool:
        """Whether none of these modes grows."""
        return bool(np.all(self.rate.real < self.still))


def modes(robot: Robot, state: State | None = None, *, count: int = 6, t: float = 0.0) -> Modes:
    """Find the slowest small motions about an equilibrium.

    Parameters
    ----------
    robot : Robot
        The robot. Drag and damping count; loads, actuators and prescribed motions are taken at time ``t``.
    state : State, optional
        The equilibrium, e.g. ``rn.equilibrium(robot).state()``; by default the initial shape. It need not
        be stable.
    count : int
        Number of modes.
    t : float
        Time at which functions of time are evaluated [s].

    Returns
    -------
    Modes
        Frequencies, decay rates and shapes.

    Raises
    ------
    ParameterError
        If ``count`` is not a positive integer.

    Examples
    --------
    >>> import rodnet as rn
    >>> fig = rn.StickFigure()
    >>> points = [(0, 0, 0), (0.2, 0, 0)]
    >>> _ = fig.rod("beam", points, edges=32, material=rn.Material(E=1e7), radius=2e-3)
    >>> terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Clamp(at="beam.start")]
    >>> print(rn.modes(rn.Robot(fig.build(), terms), count=2).frequency.round(2))  # in two planes
    [1.4 1.4]
    """
    if isinstance(count, bool) or not isinstance(count, int | np.integer) or count < 1:
        raise ParameterError(f"modes: count = {count!r} must be a positive integer")
    sim = _simulation(robot, state)
    model = sim.model
    system = linearised(sim, sim.state, t)
    slow = 1.0 / _slow_time(model)
    rate, shape = _solve(system, SHIFT * slow, int(count))
    # what tension makes stiff, a heavy chain, is faster by far than bending
    if (faster := _beyond_gap(np.abs(rate))) > FASTER * slow:
        slow = faster
        rate, shape = _solve(system, SHIFT * slow, int(count))
    full = np.zeros((len(rate), model.dof_count), dtype=shape.dtype)
    full[:, system.free] = shape.T
    if sim.newton.ev.bodies is not None:
        for row in full:
            for part in (row.real, row.imag) if np.iscomplexobj(row) else (row,):
                whole = part.copy()
                sim.newton.ev.bodies.spread(whole)
                part[:] = whole
    nodes, edges = model.graph.node_count, model.graph.edge_count
    x = full[:, : 3 * nodes].reshape(-1, nodes, 3)
    theta = full[:, model.twist0 : model.twist0 + edges]
    size = np.abs(x).max(axis=(1, 2), initial=0.0)
    turn = np.abs(theta).max(axis=1, initial=0.0)
    scale = np.where(size > 1e-9 * turn * model.graph.size, size, np.maximum(turn, 1e-300))
    return Modes(rate, x / scale[:, None, None], theta / scale[:, None], STILL * slow)


def _beyond_gap(rate: np.ndarray) -> float:
    """The slowest of ascending rates that is not a rigid mode's noise."""
    if not len(rate):
        return 0.0
    jumps = np.flatnonzero(rate[1:] > 1e3 * rate[:-1])
    return float(rate[jumps[-1] + 1] if len(jumps) else rate[0])


def linearised(sim: Simulation, state: State, t: float = 0.0) -> Linearised:
    """Linearise a robot at rest about a state: motors stand, and natural shapes that are driven are those at the time.

    What has memory has that of the state, and answers as over the time of the slowest bending: a set that takes much
    longer stays as it is.
    """
    model, ev, rest = sim.model, sim.newton.ev, np.zeros(sim.model.dof_count)
    span = _slow_time(model)
    for b, memory in zip(model.bound, state.memories, strict=True):
        if memory is not None:
            b.restore(model, memory)
    for b in model.beginning:
        b.begin_step(model, t, BRIEF * span, model.no_sensors, {})
    ev.set_source(state.tangents, state.directors, state.tau, state.q)
    ev.a[:] = 0.0

    def jacobian(cv: float, ca: float) -> csc_matrix:
        ev.ca = ca
        if ev.bodies is not None:
            ev.bodies.ca = ca if ca else -1.0
        ev.update(state.q, rest, t, span, cv, True)
        return model.jacobian().tocsc()

    K = jacobian(0.0, 0.0)
    C = jacobian(1.0, 0.0) - K
    # rigid bodies and forces of inertia bring their own
    M = diags(model.mass[model.free]).tocsc()
    if ev.bodies is not None or any(b.inertial for b in model.bound):
        M = M + jacobian(0.0, 1.0) - K
    ev.ca = 0.0
    if ev.bodies is not None:
        ev.bodies.ca = -1.0
    return Linearised(K, C, csc_matrix(M), model.free)


def _simulation(robot: Robot, state: State | None) -> Simulation:
    from rodnet.simulation import Simulation

    sim = Simulation(robot, 1.0)
    if state is not None:
        sim.restore(state)
    return sim


def _solve(system: Linearised, shift: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Slowest rates (m,) and their shapes (n, m)."""
    from scipy.sparse.linalg import splu

    K, C, M, free = system
    n = len(free)
    # unknowns of one size, whatever their units
    scale = diags(1.0 / np.sqrt(np.abs((K + shift * C + shift**2 * M).diagonal())))
    K, C, M = (csc_matrix(scale @ part @ scale) for part in (K, C, M))
    lu = splu(csc_matrix(K + shift * C + shift**2 * M))
    if np.abs(C.data).max(initial=0.0) <= 1e-12 * np.abs(K.data).max(initial=0.0) * shift:
        squares, shapes = _largest(lambda y: -lu.solve(M @ y), n, count)
        # the two of a round rod may come as a conjugate pair, apart by round-off: they span a real plane
        close = np.abs(squares.imag) <= 1e-6 * np.abs(squares)
        shapes = np.where(close, np.where(squares.imag < 0.0, shapes.imag, shapes.real), shapes)
        squares = np.where(close, squares.real + 0j, squares)
        rate = np.sqrt(shift**2 + 1.0 / squares)
        if close.all():
            shapes = shapes.real
    else:

        def operator(y: np.ndarray) -> np.ndarray:
            """Solve the step from shape and rate / shift, (x, u), to those less the shift."""
            start = y[:n] / shift
            x = -lu.solve(shift * (M @ y[n:]) + shift * (C @ start) + shift**2 * (M @ start))
            return np.vstack([x, x + start])

        inverse, shapes = _largest(operator, 2 * n, 2 * count + 2)
        rate = shift + 1.0 / inverse
        forward = rate.imag >= -1e-9 * np.abs(rate)
        rate, shapes = rate[forward], shapes[:n, forward]
    # what only decays or grows does not turn
    rate = np.where(np.abs(rate.imag) <= 1e-7 * np.abs(rate), rate.real + 0j, rate)
    rate = np.where(rate.imag < 0.0, rate.conj(), rate)
    order = np.argsort(np.abs(rate), kind="stable")[:count]
    return rate[order], scale @ shapes[:, order]


def _largest(
    operator: Callable[[np.ndarray], np.ndarray], n: int, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues (m,) of an operator on (n, k) that are largest, complex, and eigenvectors (n, m).

    By block Arnoldi: unlike one vector, a block finds all of a multiple eigenvalue, and rigid modes and round
    rods have such.
    """
    from scipy.linalg import eig, qr

    width = min(n, max(count + 4, 10))
    new = qr(np.random.default_rng(0).standard_normal((n, width)), mode="economic")[0]
    V, W = np.zeros((n, 0)), np.zeros((n, 0))
    for done in itertools.count(1):
        V = np.hstack([V, new])
        new = operator(new)
        W = np.hstack([W, new])
        size = V.shape[1]
        if done % 4 and size < n:
            new = _beside(V, new)
            continue
        inverse, small = eig(V.T @ W)
        # what has no mass has no rate; and where motions are damped, some values belong to nothing yet
        left = np.linalg.norm(W @ small - V @ (small * inverse), axis=0)
        known = (left <= PRECISION * np.abs(inverse)) | (size == n)
        fine = np.flatnonzero(known & (np.abs(inverse) > 1e-14 * np.abs(inverse).max()))
        if size == n or len(fine) >= min(count + 2, n - 2):
            break
        new = _beside(V, new)
    order = fine[np.argsort(-np.abs(inverse[fine]), kind="stable")][:count]
    return inverse[order], V @ small[:, order]


def _beside(V: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Orthonormal columns for what is new beside the orthonormal columns of V, at most as many as are missing."""
    from scipy.linalg import qr

    for _ in range(3):  # what is left of a block that has converged is noise
        new = qr(new - V @ (V.T @ new), mode="economic")[0]
    return new[:, : len(V) - V.shape[1]]
