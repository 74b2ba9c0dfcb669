"""The adapter: rodnet as a solver of cosseratbench."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from cosseratbench.scenario import End, Scenario
from cosseratbench.solver import Capability, Diverged
from cosseratbench.trajectory import Trajectory

import rodnet as rn
from rodnet.kinematics.frames import cross
from rodnet_cosseratbench.contacts import bound_cylinders, refuse_beyond_ends
from rodnet_cosseratbench.robot import make_robot, rod_name, turned, upright

QUASI_STATIC = 0.5  # step over the time 1 / w of the slowest motion, where only its end counts,
DYNAMIC = 0.02  # and where the motion itself does
REST = 1e-4  # speed of every rod below which a quasi-static scenario may be at rest, over its length [1/s],
STILL = 1e-9  # and below which nothing can be said
WINDOW = 2.0  # time over which it has halved at least, over 1 / w of the slowest motion
LONG, LONG_STEPS = 1e3, 2  # from there to its equilibrium: steps over the time 1 / w of the slowest motion


class RodnetSolver:
    """Discrete elastic rods with implicit time steps.

    Parameters
    ----------
    time_step_scale : float
        Factor on the time step.
    """

    name = "rodnet"
    backend_version = rn.__version__
    capabilities = frozenset(
        {
            Capability.STRETCH,
            Capability.ROD_CONTACT,
            Capability.ROD_FRICTION,
            Capability.CYLINDER_CONTACT,
            Capability.PLANE_CONTACT,
        }
    )

    def __init__(self, time_step_scale: float = 1.0) -> None:
        self.time_step_scale = time_step_scale

    def numerics(self, scenario: Scenario, n_frames: int) -> tuple[str, float, int, float]:
        """Stepper, time step [s], steps per frame, and rate of damping [1/s]."""
        frame, slowest = scenario.duration / (n_frames - 1), scenario.slowest_frequency()
        share = QUASI_STATIC if scenario.quasi_static else DYNAMIC
        count = max(math.ceil(frame * slowest / (share * self.time_step_scale) - 1e-9), 1)
        stepper = "sdirk2"
        return stepper, frame / count, count, 2.0 * slowest if scenario.quasi_static else 0.0

    def settings(self, scenario: Scenario, *, n_elements: int, n_frames: int) -> dict[str, Any]:
        """Return the numerical choices for a scenario."""
        stepper, dt, _, damping = self.numerics(scenario, n_frames)
        return {"integrator": f"{stepper} (implicit)", "time_step": dt, "damping_rate": damping}

    def run(self, scenario: Scenario, *, n_elements: int, n_frames: int) -> Trajectory:
        """Simulate a scenario; see `cosseratbench.solver.Solver`.

        Raises
        ------
        Diverged
            If a step does not converge.
        NotImplementedError
            If the scenario asks for what rodnet does not model; says what.
        """
        stepper, dt, count, damping = self.numerics(scenario, n_frames)
        turn = upright(scenario)
        robot = make_robot(turned(scenario, turn), n_elements, damping=damping)
        sim = rn.Simulation(robot, dt, stepper=stepper)
        rods = [sim.model.graph.rods[rod_name(k)] for k in range(len(scenario.rods))]
        rests = scenario.quasi_static and not any(o.friction for o in (*scenario.rods, *scenario.obstacles))
        shown = (settling if rests else frames)(sim, scenario, count, n_frames)
        x, d1 = (np.stack(part) @ turn for part in zip(*shown, strict=True))
        times = np.linspace(0.0, scenario.duration, n_frames)
        return Trajectory(
            times, tuple(x[:, rod.nodes] for rod in rods), tuple(d1[:, rod.edges] for rod in rods)
        )


def frames(
    sim: rn.Simulation, scenario: Scenario, count: int, n_frames: int
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield node positions and first material directors of every ``count``-th step, ``n_frames`` in all."""
    cylinders = bound_cylinders(sim, scenario)
    yield shape(sim)
    for _ in range(n_frames - 1):
        for _ in range(count):
            result = sim.step()
            if not result.ok:
                raise Diverged(f"a step failed: {result.status.value}", time=sim.t)
            refuse_beyond_ends(sim, cylinders)
        yield shape(sim)


def settling(
    sim: rn.Simulation, scenario: Scenario, count: int, n_frames: int
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield frames until all is at rest and nothing drives it any more, then those of the equilibrium there.

    The equilibrium is what implicit Euler finds in a few very long steps. Not with friction, which holds rods in
    many places, and whose creep such steps would draw out.
    """
    motions = [rod.motion(end) for rod in scenario.rods for end in End]
    driven = max((m.times[-1] for m in motions if m is not None), default=0.0)
    interval, slowest = scenario.duration / (n_frames - 1), scenario.slowest_frequency()
    window = math.ceil(WINDOW / (slowest * interval))
    rods = [sim.model.graph.rods[rod_name(k)] for k in range(len(scenario.rods))]
    speeds: list[np.ndarray] = []
    before = None
    for k, frame in enumerate(frames(sim, scenario, count, n_frames)):
        yield frame
        if before is not None:
            moved = np.linalg.norm(frame[0] - before, axis=1)
            speeds.append(np.array([moved[rod.nodes].max() / rod.length for rod in rods]) / interval)
        before = frame[0]
        if k == n_frames - 1 or sim.t < driven + window * interval or len(speeds) <= window:
            continue
        slow, slower = (speeds[-1] < REST).all(), speeds[-1] < np.maximum(0.5 * speeds[-1 - window], STILL)
        if slow and slower.all():
            long = rn.Simulation(sim.robot, LONG / slowest, predict=False)
            long.restore(sim.state)
            if all(long.step().ok for _ in range(LONG_STEPS)):
                yield from [shape(long)] * (n_frames - 1 - k)
                return


def shape(sim: rn.Simulation) -> tuple[np.ndarray, np.ndarray]:
    """Node positions, shape (N, 3), and first material directors of the edges, shape (E, 3)."""
    graph, state, view = sim.model.graph, sim.state, sim.observe()
    d1, t = state.directors[: graph.edge_count], state.tangents[: graph.edge_count]
    angle = view.theta[:, None]
    return view.x.copy(), np.cos(angle) * d1 + np.sin(angle) * cross(t, d1)
