"""A step seen from inside: directors, springs, prescribed degrees of freedom, Newton's iterates."""

from __future__ import annotations

import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.kinematics.frames import relative_rotation
from rodnet.solve.evaluation import Evaluation
from rodnet.solve.model import Model
from rodnet.solve.newton import Newton, StepReport
from rodnet.viz.colours import HOT, shades
from rodnet.viz.rerun_log import FORCE, HELD, MEASURED, NOTE, SERIES, SOFT, STIFF, Log

if TYPE_CHECKING:
    from rodnet.simulation import Simulation

AXES = {"m1": (220, 70, 60), "m2": (60, 130, 230), "t": (120, 170, 40)}
TINY = 1e-300


@dataclass
class _Iterates:
    """Newton's iterates of one step, with what is shown of them.

    Attributes
    ----------
    x : ndarray, shape (K, N, 3)
        Node positions [m], ghosts included.
    r : ndarray, shape (K, dof_count)
        Residuals of the unknowns [N, N m] over the force and moment scale; NaN where they are unknown.
    frames : ndarray, shape (K, E, 3, 3)
        Directors m1, m2, t as columns.
    natural : ndarray, shape (K, S, 3)
        Direction that each spring would give its second edge.
    moment : ndarray, shape (K, S)
        Sizes of the springs' moments [N m]; NaN for a folded state.
    turn : ndarray, shape (K, S)
        Angles between the springs' second edges and the direction that the first ones carry for them
        [rad]; near pi the state is folded.
    bad : ndarray of bool, shape (dof_count,)
        Where a force is not a finite number.
    """

    x: np.ndarray
    r: np.ndarray
    frames: np.ndarray
    natural: np.ndarray
    moment: np.ndarray
    turn: np.ndarray
    bad: np.ndarray


def debug(sim: Simulation, path: str | Path | None = None) -> Path:
    """Write an ``.rrd`` of the next step of a simulation, which itself is left as it is.

    Shows the directors of every edge, the springs with their moments and the directions that they
    would give their edges, the held nodes and the walls' ghost edges, the residual of every degree of
    freedom (forces as arrows, moments about the edges as colours of the edges), and the iterates of
    Newton's method on the timeline ``iteration``. `ConvergenceError` writes one by itself.

    Parameters
    ----------
    sim : Simulation
        The simulation, at the state before the step.
    path : path, optional
        The file; by default ``rodnet-debug-....rrd`` in the current directory, or a temporary one.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    with Log(path or _default_path(), "debug") as log:
        # a model of its own: terms keep angles and natural shapes there, which the next step starts from
        model = Model(sim.robot)
        newton = Newton(model, sim.newton.tolerance)
        state, dt = sim.state, sim.next_dt
        sensors = sim.observe().sensors
        _, report = newton.step(state, sim.stepper, state.t + dt, dt, sensors, sim.inputs, keep_history=True)
        seen = _replay(sim, model, newton, report)
        columns = log.count("iteration", len(seen.x))
        _log_shape(log, model, columns, seen, state.q)
        _log_springs(log, model, columns, seen)
        _log_residual(log, model, columns, seen)
        tries = [] if report.ok else _tries(sim, newton, sensors)
        log.about(_description(sim, model, report, seen, tries))
        log.blueprint(
            {"residual over its scale (log10)": "/residual"},
            _in_view(seen.x[:, : model.graph.node_count]),
            title=f"step from t = {state.t:g} s: {report.status.value}",
            timeline="iteration",
            bars={"residual by degree of freedom (positions, then twists)": "/residual_by_dof"},
        )
    return log.path


def _in_view(x: np.ndarray) -> np.ndarray:
    """What the 3D view opens on: all iterates, unless they fly apart; shape (K, N, 3)."""
    first, everything = x[0], x.reshape(-1, 3)
    size, extent = (np.linalg.norm(np.ptp(points, axis=0)) for points in (first, everything))
    return everything if extent < 3.0 * size else first


def _default_path() -> Path:
    try:
        folder = Path.cwd()
    except OSError:  # the directory has been removed
        folder = Path(tempfile.gettempdir())
    if not os.access(folder, os.W_OK):
        folder = Path(tempfile.gettempdir())
    handle, name = tempfile.mkstemp(prefix="rodnet-debug-", suffix=".rrd", dir=folder)
    os.close(handle)
    return Path(name)


def _replay(sim: Simulation, m: Model, newton: Newton, report: StepReport) -> _Iterates:
    """Evaluate every iterate again; without one (a first guess without forces), the guess itself."""
    state = sim.state
    cv, _ = sim.stepper.coefficients(sim.next_dt)
    iterates = report.history or [(_guess(sim, m), np.full(m.dof_count, np.nan))]
    q = np.stack([q for q, _ in iterates])
    r = np.stack([r for _, r in iterates])
    r[:, m.held] = 0.0
    force, moment = newton.scales
    r[:, : m.twist0] /= force
    r[:, m.twist0 :] /= moment
    count, ev = len(q), Evaluation(m)
    ev.set_source(state.tangents, state.directors, state.tau, state.q)
    shape = (count, m.spring_count)
    seen = _Iterates(
        q[:, : m.twist0].reshape(count, -1, 3),
        r,
        np.zeros((count, m.edge_count, 3, 3)),
        np.zeros((*shape, 3)),
        np.full(shape, np.nan),
        np.zeros(shape),
        np.zeros(m.dof_count, dtype=bool),
    )
    for k in range(count):
        fine = ev.update(q[k], cv * (q[k] - state.q), state.t + sim.next_dt, sim.next_dt, cv, False)
        seen.frames[k] = np.stack([ev.M1, ev.M2, ev.T], axis=-1)
        V, W = seen.frames[k][m.edge1] @ m.Q1, seen.frames[k][m.edge2] @ m.Q2
        seen.turn[k] = np.arccos(np.clip(np.sum(V[:, :, 2] * W[:, :, 2], axis=1), -1.0, 1.0))
        rest = V @ relative_rotation(m.eps0) @ np.swapaxes(m.Q2, 1, 2)
        seen.natural[k] = m.sign2[:, None] * rest[:, :, 2]
        if fine:
            seen.moment[k] = np.linalg.norm(ev.spring_moments(), axis=1)
            seen.bad |= ~np.isfinite(ev.F)
    seen.bad[m.held] = False
    return seen


def _guess(sim: Simulation, m: Model) -> np.ndarray:
    """Where Newton's method starts, shape (dof_count,)."""
    state, stepper = sim.state, sim.stepper
    q = state.q.copy()
    q[m.free] = stepper.predict(state, sim.next_dt, [])[m.free]
    if len(m.held):
        now = state.t + stepper.nodes[0] * sim.next_dt
        m.prescribe(q, now, state.q[m.twist0 :], (state.tangents, state.directors))
    return q


def _log_shape(log: Log, m: Model, columns, seen: _Iterates, before: np.ndarray) -> None:
    """Rods coloured by kind, their shape before the step, directors, held nodes and walls."""
    x, length = seen.x, m.rest_length
    thin = 0.04 * float(np.median(length[: m.graph.edge_count]))
    old = before[: m.twist0].reshape(-1, 3)
    for rod in m.graph.rods.values():
        color = STIFF if rod.kind == "rigid" else SOFT
        log.strips(f"robot/rods/{rod.name}", columns, x[:, rod.nodes], thin, color)
    log.fixed("robot/before", [old[rod.nodes] for rod in m.graph.rods.values()], 0.5 * thin, (90, 90, 90))
    middle = 0.5 * (x[:, m.edges[:, 0]] + x[:, m.edges[:, 1]])
    for k, (name, color) in enumerate(AXES.items()):
        arrows = 0.4 * length[:, None] * seen.frames[..., k]
        log.arrows(f"robot/directors/{name}", columns, middle, arrows, color, 0.8 * thin)
    held = [n for c in m.constraints for n in c.nodes if n < m.graph.node_count]
    if held:
        log.points("robot/prescribed", columns, x[:, np.unique(held)], 5.0 * thin, HELD)
    first = m.graph.edge_count + len(m.ghosts)  # after the graph's edges come those of walls, then of joints
    for name, ghosts, color in (
        ("walls", m.edges[m.graph.edge_count : first], HELD),
        ("joints", m.edges[first:], NOTE),
    ):
        if len(ghosts):
            log.segments(f"robot/{name}", columns, x[:, ghosts], 2.0 * thin, color)


def _log_springs(log: Log, m: Model, columns, seen: _Iterates) -> None:
    """Springs, coloured and sized by their moment, with the directions that they would give their edges."""
    typical = float(np.median(m.rest_length[: m.graph.edge_count]))
    share = np.sqrt(
        np.nan_to_num(seen.moment) / max(float(np.nan_to_num(seen.moment).max(initial=0.0)), 1e-300)
    )
    at = seen.x[:, m.spring_node]
    log.points("robot/springs", columns, at, typical * (0.08 + 0.12 * share), shades(share))
    arrows = 0.5 * m.rest_length[m.edge2][:, None] * seen.natural
    log.arrows("robot/natural", columns, at, arrows, NOTE, 0.02 * typical)


def _log_residual(log: Log, m: Model, columns, seen: _Iterates) -> None:
    """Residual forces as arrows, moments about the edges as colours, their sizes over the iterations."""
    size, count = m.graph.size, len(seen.x)
    force = seen.r[:, : m.twist0].reshape(count, -1, 3)
    twist = np.abs(seen.r[:, m.twist0 : m.turn0])
    force_size = np.linalg.norm(force, axis=2)
    largest = np.nan_to_num(force_size).max(axis=1)[:, None, None]
    arrows = 0.15 * size * force / np.where(largest > 0.0, largest, 1.0)
    log.arrows("robot/residual/forces", columns, seen.x, arrows, FORCE, size / 350)
    ends = seen.x[:, m.edges]
    colors = shades(1.0 + np.log10(np.maximum(np.nan_to_num(twist), TINY)) / 10.0)
    typical = float(np.median(m.rest_length[: m.graph.edge_count]))
    log.segments("robot/residual/moments", columns, ends, 0.07 * typical, colors)
    bad = np.unique(np.concatenate([np.flatnonzero(seen.bad[: m.twist0]) // 3]))
    if len(bad):
        names = [m.graph.node_name(n) if n < m.graph.node_count else "wall" for n in bad]
        labels = [f"{name}: not a finite force" for name in names]
        log.points("robot/not_finite", columns, seen.x[:, bad], 0.2 * typical, HOT, labels)
    for name, values, color in (
        ("forces", force_size.max(axis=1, initial=0.0), MEASURED),
        ("moments", twist.max(axis=1, initial=0.0), SERIES[1]),
    ):
        # without any residual there is nothing to draw
        values = np.where(values > 0.0, np.log10(np.maximum(values, TINY)), np.nan)
        log.series(f"residual/{name}", columns, values, name, color, 2.5)
    log.bars("residual_by_dof", "iteration", np.abs(np.nan_to_num(seen.r)), MEASURED)


def _tries(sim: Simulation, newton: Newton, sensors: Any) -> list[tuple[float, StepReport]]:
    """What shorter steps from the same state do, halved until one converges, as the simulation does."""
    from rodnet.steps import MAX_HALVINGS

    tries, dt, state = [], sim.next_dt, sim.state
    for _ in range(MAX_HALVINGS):
        dt *= 0.5
        _, report = newton.step(state, sim.stepper, state.t + dt, dt, sensors, sim.inputs)
        tries.append((dt, report))
        if report.ok:
            break
    return tries


def _description(sim: Simulation, m: Model, report: StepReport, seen: _Iterates, tries: list) -> str:
    """What happened, where it is worst, and what the colours mean."""
    state, last = sim.state, np.abs(np.nan_to_num(seen.r[-1]))
    # over all iterates: a state that folds is not kept as an iterate itself
    k = int(np.argmax(seen.turn.max(axis=0))) if m.spring_count else -1
    lines = [
        f"**{report.status.value}**: t = {state.t:g} s to {state.t + sim.next_dt:g} s in one step, "
        f"{sim.stepper.name}, {report.iterations} iterations, largest residual over its scale "
        f"{report.residual:.3g}" + (f" at {m.dof_name(report.worst)}." if report.worst >= 0 else "."),
        "",
    ]
    if not report.history:
        lines += ["There are no forces at the first guess, which is what is shown.", ""]
    if len(sim.stepper.nodes) > 1:
        lines += [f"The iterates of its {len(sim.stepper.nodes)} stages follow one another.", ""]
    if k >= 0:
        angle = float(np.degrees(seen.turn[:, k].max()))
        name = m.graph.node_name(int(m.spring_node[k]))
        lines += [f"Farthest from its natural direction: {angle:.0f} degrees at {name} (180 is a fold).", ""]
    if seen.bad.any():
        names = [m.dof_name(int(i)) for i in np.flatnonzero(seen.bad)[:8]]
        lines += [f"Not a finite number: the force on {', '.join(names)}.", ""]
    worst = [int(i) for i in np.argsort(-last)[:8] if last[i] > 0.0]
    if worst:
        lines += ["| largest at the last iterate | over its scale |", "|---|---|"]
        lines += [f"| {m.dof_name(i)} | {last[i]:.2e} |" for i in worst]
        lines.append("")
    if tries:
        lines += ["| a shorter step, dt [s] | ended as | residual | worst |", "|---|---|---|---|"]
        lines += [
            f"| {dt:.3g} | {t.status.name.lower()} | {t.residual:.2g} | "
            f"{m.dof_name(t.worst) if t.worst >= 0 else ''} |"
            for dt, t in tries
        ]
        lines.append("")
    lines.append(
        "Arrows on edges: m1 red, m2 blue, t green; yellow: where a spring would turn its second edge. "
        "Dots: springs, by the square root of their moment (blue small, red and large the largest). "
        "Long green arrows: residual forces, over the largest of each iterate. Edges: residual moments about "
        "them, from blue (1e-10 of the scale) to red (1). Pink: held nodes and walls. Dark thin line: the "
        "shape before the step."
    )
    return "\n".join(lines)
