"""The state in which a run begins: as drawn, but for what constraints prescribe at the first moment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from rodnet.errors import DisplacedStartError, FoldedStateError, ParameterError
from rodnet.solve.body_motion import check_spin
from rodnet.solve.evaluation import Evaluation
from rodnet.solve.inertia import starting_acceleration
from rodnet.solve.joint_frames import initial_twists
from rodnet.solve.model import Model
from rodnet.solve.newton import Newton
from rodnet.solve.steppers import State, Stepper

ALIKE = 1e-6  # of a displacement: by how much nodes may differ that are moved by one vector


def initial_state(
    newton: Newton, stepper: Stepper, dt: float, velocity: Any, spin: Mapping[str, Any]
) -> State:
    """Return the state at t = 0.

    Parameters
    ----------
    newton : Newton
        Of the model.
    stepper : Stepper
        What will go on from there.
    dt : float
        Time step, for rates of what is prescribed [s].
    velocity : array_like, shape (n, 3), or None
        Of the nodes [m/s].
    spin : mapping
        Of rigid bodies by name [rad/s].

    Raises
    ------
    ParameterError
        If the velocity has another shape, or is not finite.
    DisplacedStartError
        If a constraint moves its nodes far from where they are drawn.
    FoldedStateError
        If edges of a spring are antiparallel.
    """
    m, ev = newton.model, newton.ev
    q, v, a = (np.zeros(m.dof_count) for _ in range(3))
    q[: m.twist0], q[m.twist0 : m.turn0] = m.x0.ravel(), m.theta0
    if velocity is not None:
        velocity = np.asarray(velocity, dtype=float)
        if velocity.shape != (m.graph.node_count, 3) or not np.all(np.isfinite(velocity)):
            raise ParameterError(
                f"velocity must be finite and of shape {(m.graph.node_count, 3)} [m/s], got {velocity.shape}"
            )
        v[: velocity.size] = velocity.ravel()
    v[m.held] = 0.0
    if m.moving:
        m.prescribe(q, 0.0, np.zeros(m.edge_count), (m.t0, m.d10))
        carried = _carry(m, q)
        jump = max((c.jump() for c in m.moving if c not in carried), default=0.0)
        if jump > 0.5 * m.shortest_free:
            raise DisplacedStartError(
                f"a constraint moves a node by {jump:.3g} m at t = 0, more than half an edge beside it; "
                "prescribed motion must start at the robot's initial position"
            )
        rates = m.prescribed_rates(q, 0.0, dt)
        v[m.held], a[m.held] = rates[0][m.held], rates[1][m.held]
    ev.set_source(m.t0, m.d10, initial_twists(m), q)
    _set_bodies(ev, q, v, spin)
    if not ev.update(q, v, 0.0, dt, 0.0, False):
        raise FoldedStateError("the initial shape is folded: two edges of a spring are (nearly) antiparallel")
    if stepper.needs_acceleration:
        starting_acceleration(ev, a)
    for b in m.remembering:
        b.begin(q)
    memories = tuple(None if b.memory is None else b.memory.copy() for b in m.bound)
    turns = np.zeros(m.edge_count, dtype=np.int64)
    return State(0.0, 0, q, v, a, a.copy(), *newton.frames(q, turns), memories, turns)


def _carry(model: Model, q: np.ndarray) -> list[Any]:
    """Move along what hangs on one shifted constraint alone: it begins as if it had been drawn there.

    Returns these constraints. Of rods that others hold as well, nobody can tell the shape between them.
    """
    shifted = [c for c in model.moving if c.law.carries]
    if model.bodies is not None or not shifted:
        return []
    x = q[: model.twist0].reshape(-1, 3)
    n, edges = len(model.x0), model.edges
    pairs = np.concatenate([edges, np.stack([edges[model.edge1, 0], edges[model.edge2, 0]], axis=1)])
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    label = connected_components(links, directed=False)[1]
    parts = [set(label[c.nodes].tolist()) for c in model.constraints]
    found = []
    for c, mine in zip(model.constraints, parts, strict=True):
        if c not in shifted:
            continue
        moved = x[c.nodes] - model.x0[c.nodes]
        mean = moved.mean(axis=0)
        size = float(np.linalg.norm(mean))
        alone = sum(bool(mine & other) for other in parts) == 1
        if alone and size > 0.0 and np.abs(moved - mean).max() < ALIKE * size:
            free = np.isin(label, list(mine))
            free[c.nodes] = False
            x[free] += mean
            found.append(c)
    return found


def _set_bodies(ev: Evaluation, q: np.ndarray, v: np.ndarray, spin: Mapping[str, Any]) -> None:
    """Put what rigid bodies carry where the bodies are, and let it move with them."""
    m = ev.model
    given = check_spin(spin, [] if m.bodies is None else m.bodies.names)
    if m.bodies is None or ev.bodies is None:
        return
    m.bodies.set_motion(m, v, given)
    ev.q[:] = q
    ev.bodies.place()
    q[:] = ev.q
    ev.bodies.spread(v)
