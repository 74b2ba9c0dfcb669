"""The adapter: rodnet as a solver of cosseratbench."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from cosseratbench.scenario import Scenario
from cosseratbench.solver import Capability, Diverged
from cosseratbench.trajectory import Trajectory

import rodnet as rn
from rodnet.kinematics.frames import cross
from rodnet_cosseratbench.robot import make_robot, rod_name, turned, upright

QUASI_STATIC = 0.5  # step over the time 1 / w of the slowest motion
DYNAMIC = 0.02


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
        x, d1 = (np.stack(part) @ turn for part in zip(*frames(sim, count, n_frames), strict=True))
        times = np.linspace(0.0, scenario.duration, n_frames)
        return Trajectory(
            times, tuple(x[:, rod.nodes] for rod in rods), tuple(d1[:, rod.edges] for rod in rods)
        )


def frames(sim: rn.Simulation, count: int, n_frames: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield node positions and first material directors of every ``count``-th step, ``n_frames`` in all."""
    for k in range(n_frames):
        if k:
            for _ in range(count):
                result = sim.step()
                if not result.ok:
                    raise Diverged(f"a step failed: {result.status.value}", time=sim.t)
        graph, state, view = sim.model.graph, sim.state, sim.observe()
        d1, t = state.directors[: graph.edge_count], state.tangents[: graph.edge_count]
        angle = view.theta[:, None]
        yield view.x.copy(), np.cos(angle) * d1 + np.sin(angle) * cross(t, d1)
