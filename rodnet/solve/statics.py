"""Static equilibrium by proximal steps: each minimises the energy plus a penalty on moving far.

A proximal step is an implicit Euler step from rest, so it uses the same Newton's method; the time
step grows until inertia no longer counts. Rigid modes without load stay where they are. A step that
fails or ends on a saddle of what it should minimise is done again with updates that descend
(`rodnet.solve.descent`), so that the energy never rises. An equilibrium that is unstable is given a push:
it is left.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import coo_matrix, csc_matrix, diags_array
from scipy.sparse.csgraph import connected_components

from rodnet.errors import EquilibriumError, FoldedStateError, ParameterError, PathDependenceWarning
from rodnet.solve.descent import Inertia, conservative, descend, push, scaled
from rodnet.solve.evaluation import Evaluation
from rodnet.solve.model import Model
from rodnet.solve.newton import Status, Tolerance
from rodnet.solve.steppers import ImplicitEuler, State
from rodnet.terms.spring_moments import SpringMoments

if TYPE_CHECKING:
    from rodnet.robot import Robot
    from rodnet.trajectory import Trajectory

MAX_STEPS = 400
GROWTH = 4.0
ITERATIONS = 12  # of Newton's method; where it needs more, descending is quicker
FALL = 300.0  # times the slowest bending motion: what is slower than that is held by nothing
ROUND_OFF = 1e-12  # of unknowns that are scaled to unit stiffness
MODES = ("translation along x", "translation along y", "translation along z")


def equilibrium(
    robot: Robot, *, t: float = 0.0, start: State | None = None, residual: float = 1e-8
) -> Trajectory:
    """Find the static equilibrium that a robot creeps into.

    Parameters
    ----------
    robot : Robot
        The robot; loads, actuators and prescribed motions are taken at time ``t``. A motor that is
        given by its speed stays at the angle of ``start``.
    t : float
        Time at which functions of time are evaluated [s].
    start : State, optional
        Where to begin, e.g. a neighbouring equilibrium; by default the initial shape.
    residual : float
        Largest unbalanced force (or moment) against the largest one in the robot.

    Returns
    -------
    Trajectory
        One state, at rest: shape, energies, internal forces, reactions; ``traj.state()`` starts a
        simulation from it.

    Raises
    ------
    EquilibriumError
        If there is none: a part that nothing holds is under load (the rigid mode is named), or the
        steps do not converge.

    Warns
    -----
    PathDependenceWarning
        If friction of a tendon bears load: then there are many equilibria, and this is but one of them.
    """
    from rodnet.observer import Observer
    from rodnet.recorder import Recorder
    from rodnet.simulation import Simulation

    if not np.isfinite(t):
        raise ParameterError(f"equilibrium: t = {t!r} must be a finite time [s]")
    sim = Simulation(robot, 1.0, tolerance=Tolerance(residual=1e-2 * residual, iterations=ITERATIONS))
    state = start or sim.state
    if start is not None:
        sim.restore(start)
    model, euler = sim.model, ImplicitEuler()
    for b in model.bound:
        b.at_rest = True
    slow = _slow_time(model)
    dt = 0.1 * slow
    limit = saddle = np.inf
    rest = np.zeros(model.dof_count)
    recorder, report = Recorder(sim, None), None
    for _ in range(MAX_STEPS):
        still = replace(state, v=rest, a=rest, acc=rest, t=t)
        sensors = Observer(model, still, robot.sensors).sensors
        new, report = sim.newton.step(still, euler, t, dt, sensors, {})
        recorder.count(report.iterations, 1)
        saddle *= 1.2
        stable = new is not None and not _inertia(sim.newton.ev, model, new, t, dt).directions.size
        if new is None or not stable:
            lower, iterations = descend(sim, still, t, dt, sensors)
            recorder.count(iterations, 1)
            if lower is None and new is None:
                limit = dt if report.status is Status.SINGULAR else limit
                dt /= GROWTH
                if dt < 1e-12:
                    break
                continue
            if lower is None:
                saddle = dt
                dt *= 0.5
                continue
            new = lower
        moved = float(np.abs(new.v[: model.twist0]).max()) * dt / model.graph.size
        state = replace(new, v=rest, a=rest, acc=rest, t=t, index=0)
        if np.abs(state.q[: model.twist0]).max() > 1e4 * model.graph.size + np.abs(model.x0).max():
            raise EquilibriumError(f"there is no equilibrium: {_free_mode(model, state, t)}")
        # with tiny loads on stiff rods round-off keeps forces unbalanced: then nothing moves any more
        settled = moved < 1e-11 and dt > min(1e3 * slow, 0.5 * saddle)
        if _imbalance(sim.newton.ev, model, state, t) <= residual or settled:
            unstable = _inertia(sim.newton.ev, model, state, t, np.inf).directions
            if not unstable.size:
                recorder.add(state)
                _warn_of_the_way(model, state)
                return recorder.finish("equilibrium", {})
            state.q[model.free] += push(model, unstable)
        # many iterations announce a failure: grow only while Newton's method finds steps easy
        easy = not stable or report.iterations <= 6
        growth = GROWTH if easy else 1.5 if report.iterations <= 12 else 0.7
        if dt * growth < limit and dt < 1e12:
            dt = min(dt * growth, max(dt, 0.7 * saddle))
    if report is not None and report.status is Status.FOLDED:
        raise FoldedStateError(
            "no equilibrium: two edges of a spring fold back on each other; use a finer mesh there"
        )
    worst = model.dof_name(report.worst) if report is not None and report.worst >= 0 else "none"
    raise EquilibriumError(
        f"no equilibrium found in {MAX_STEPS} steps; largest residual at {worst}. {_free_mode(model, state, t)}"
    )


def _warn_of_the_way(model: Model, state: State) -> None:
    found = (b.path_dependence(memory) for b, memory in zip(model.bound, state.memories, strict=True))
    reasons = [reason for reason in found if reason]
    if reasons:
        warnings.warn(
            f"this equilibrium is one of many: {'; '.join(reasons)}. Which one is reached depends on the way there, "
            "and that of the solver may go to and fro; for the one at the end of a motion run that motion, slowly "
            "(schedule=, rodnet.Simulation), or give friction=0 for the one without friction",
            PathDependenceWarning,
            stacklevel=3,
        )


def stiffness_matrix(
    robot: Robot, state: State | None = None, *, t: float = 0.0
) -> tuple[csc_matrix, np.ndarray]:
    """Tangent stiffness -dF/dq over the free degrees of freedom, and their indices; as in statics no time passes.

    Parameters
    ----------
    robot : Robot
        The robot.
    state : State, optional
        Where; by default the initial shape.
    t : float
        Time at which loads and constraints are taken [s].

    Returns
    -------
    K : csc_matrix, shape (n, n)
        [N/m], [N], [N m] by kind of degree of freedom.
    free : ndarray, shape (n,)
        Their indices in q. An eigenvalue that becomes negative is a lost stability.
    """
    from rodnet.simulation import Simulation

    sim = Simulation(robot, 1.0)
    if state is not None:
        sim.restore(state)
    state, model = sim.state, sim.model
    for b, memory in zip(model.bound, state.memories, strict=True):
        b.at_rest = True
        if memory is not None:
            b.restore(model, memory)
    return _tangent(sim.newton.ev, model, state, t), model.free


def bearing_strains(robot: Robot) -> np.ndarray:
    """Strains of the springs that bear the loads on the initial shape, were this shape the natural one.

    To first order: of all moments that are in balance with the loads, those of the least elastic energy. What nothing
    holds falls, and bears nothing.

    Parameters
    ----------
    robot : Robot
        The robot; loads and actuators are taken at t = 0, at rest.

    Returns
    -------
    ndarray, shape (spring_count, 3)
        (kappa1, kappa2, tau) of each spring [rad].

    Notes
    -----
    Least elastic energy after Castigliano (1879); docs, theory: what differs along a rod.
    """
    from scipy.sparse.linalg import splu

    from rodnet.simulation import Simulation

    sim = Simulation(robot, 1.0)
    model, ev, state = sim.model, sim.newton.ev, sim.state
    rest = np.zeros(model.dof_count)
    ev.set_source(state.tangents, state.directors, state.tau, state.q)
    ev.update(state.q, rest, 0.0, 1.0, 0.0, False)
    model.eps0[:] = ev.eps  # so that nothing is strained
    K = _tangent(ev, model, state, 0.0)
    force = ev.F[model.free].copy()
    if not np.any(force):
        return np.zeros_like(ev.eps)
    K = K + diags_array(model.metric[model.free] / (FALL * _slow_time(model)) ** 2)
    # unknowns of one size, whatever their units
    stiff = np.abs(K.diagonal())
    scale = diags_array(1.0 / np.sqrt(np.where(stiff > 0.0, stiff, 1.0)))
    free = diags_array(np.full(len(force), ROUND_OFF))  # hinges and bodies may turn without stiffness or mass
    way = np.zeros(model.dof_count)
    way[model.free] = scale @ splu(csc_matrix(scale @ K @ scale + free)).solve(scale @ force)
    if ev.bodies is not None:
        ev.bodies.spread(way)
    strains, springs = np.zeros_like(ev.eps), SpringMoments(model, np.arange(model.first_law))
    gradient, _ = springs.gradient(ev)
    strains[: model.first_law] = np.einsum("nki,ni->nk", gradient, way[springs.dofs])
    return strains


def _tangent(ev: Evaluation, model: Model, state: State, t: float) -> csc_matrix:
    ev.set_source(state.tangents, state.directors, state.tau, state.q)
    ev.update(state.q, np.zeros(model.dof_count), t, 1.0, 0.0, True)
    K = model.jacobian().tocsc()
    rows = [b.rows for b in model.adding if b.replacing]
    if rows:  # what they prescribe does not move: symmetric again
        kept = np.ones(K.shape[0])
        kept[np.concatenate(rows)] = 0.0
        K = diags_array(kept) @ K @ diags_array(kept) + diags_array((1.0 - kept) * K.diagonal())
    return csc_matrix(K)


def _inertia(ev: Evaluation, model: Model, state: State, t: float, dt: float) -> Inertia:
    """Whether the energy of a step that ends at ``state`` is at a minimum there.

    Loads without an energy have no minimum to speak of: then no direction of descent is found.
    """
    K = _tangent(ev, model, state, t)
    if not conservative(K):
        return Inertia(csc_matrix((0, 0)), np.zeros(0))
    return Inertia(K, model.metric[model.free] / dt**2)


def _slow_time(model: Model) -> float:
    """Time scale of the slowest bending motion [s]."""
    graph = model.graph
    length = max(graph.size, float(graph.rest_length.max()))
    soft = min(graph.EI1.min(), graph.EI2.min())  # infinite for rigid bodies alone
    return float(np.sqrt(model.node_mass.sum() * length**3 / soft)) if np.isfinite(soft) else 1.0


def _imbalance(ev: Evaluation, model: Model, state: State, t: float) -> float:
    """Largest unbalanced force or moment over the free degrees of freedom, scaled."""
    ev.set_source(state.tangents, state.directors, state.tau, state.q)
    ev.update(state.q, np.zeros(model.dof_count), t, 1.0, 0.0, False)
    return scaled(model, ev, ev.F[model.free])


def _free_mode(model: Model, state: State, t: float) -> str:
    """Name the component and the rigid mode that carries a net load."""
    links = coo_matrix((np.ones(model.edge_count), model.edges.T), shape=(model.node_count,) * 2)
    count, label = connected_components(links, directed=False)
    held = np.zeros(model.node_count, dtype=bool)
    for c in model.constraints:
        held[c.nodes] = True
    ev = Evaluation(model)
    ev.set_source(state.tangents, state.directors, state.tau, state.q)
    ev.update(state.q, np.zeros(model.dof_count), t, 1.0, 0.0, False)
    F = ev.F[: model.twist0].reshape(-1, 3)
    for k in range(count):
        mine = label == k
        total = F[mine].sum(axis=0)
        axis = int(np.argmax(np.abs(total)))
        if not held[mine].any() and abs(total[axis]) > 1e-6 * max(ev.force_scale, 1e-300):
            first = model.graph.node_name(int(np.flatnonzero(mine)[0]))
            return (
                f"nothing holds the part with node '{first}' and a net force of {total[axis]:.3g} N drives its "
                f"{MODES[axis]}; add a constraint (rodnet.Clamp, Hinge) or balance the loads"
            )
    return "Try a start closer to the equilibrium, or smaller loads one after the other (start=)."
