"""`check_stepper`: order of accuracy, energy, momentum and restart of a time stepper."""

from __future__ import annotations

import pickle
import tempfile
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from rodnet.graph.material import Material
from rodnet.graph.stick_figure import StickFigure
from rodnet.robot import Robot
from rodnet.simulation import Simulation
from rodnet.solve.newton import Tolerance
from rodnet.solve.statics import equilibrium
from rodnet.solve.steppers import State, Stepper, make_stepper
from rodnet.terms.constraints import Clamp
from rodnet.terms.drag.resistive import ResistiveForce
from rodnet.terms.energies import Bending, Stretching, Twisting
from rodnet.terms.loads import Gravity, PointForce
from rodnet.testing.report import Report
from rodnet.trajectory import Trajectory

TIGHT = Tolerance(residual=1e-11, update=1e-14, iterations=50)
KEPT = ("t", "q", "v", "a", "acc", "directors")  # of a state, when a run is continued
SLACK = 0.25  # by which a fitted order may fall short
THIN = 5e-6  # drift of the angular momentum that a rod as thin as ours still has


def check_stepper(stepper: str | Stepper | type[Stepper]) -> Report:
    """Check a time stepper on a swinging, an overdamped, a vibrating and a free rod.

    The fitted order of convergence must reach the one that it declares, on a rod that swings under
    gravity and on one in a very viscous medium; the energy of a rod that vibrates by itself must
    not grow, or (steppers of second order) only by an error that vanishes with dt; the linear
    momentum of a free rod stays, its angular momentum up to an error of the declared order; a run
    continued from a saved state or from a file equals the uninterrupted one bit for bit, also where
    step size control chooses the steps; the stepper keeps nothing between steps.

    Parameters
    ----------
    stepper : str, Stepper or Stepper class
        A registered name, an instance, or a class without required arguments.

    Returns
    -------
    Report
        The checks with their errors.

    Raises
    ------
    ContractError
        If a check fails.
    """
    stepper = make_stepper(stepper() if isinstance(stepper, type) else stepper)
    report = Report(f"check_stepper({type(stepper).__name__})")
    before = pickle.dumps(vars(stepper))
    _check_restart(stepper, report)
    _check_order("swinging", _swing, 0.3, 32, stepper, report)
    _check_order("overdamped", _creep, 0.5, 16, stepper, report)
    _check_energy(stepper, report)
    _check_momentum(stepper, report)
    _check_angular_momentum(stepper, report)
    _check_files(stepper, report)
    report.demand(
        "no state of its own", pickle.dumps(vars(stepper)) == before, "stepping changed the stepper's attributes",
        "Everything that a step needs from the last one belongs into the State.",
    )  # fmt: skip
    return report


def _rod(points: list[tuple[float, float, float]], E: float, radius: float, **options) -> StickFigure:
    figure = StickFigure()
    return figure.rod("rod", points, edges=6, material=Material(E=E, rho=1000.0), radius=radius, **options)


def _elastic() -> list:
    return [Stretching(), Bending(), Twisting()]


def _swing(stepper: Stepper, dt: float, adaptive: float | None = None) -> Simulation:
    """A soft rod that hangs from a clamp and swings sideways, as a pendulum does."""
    robot = Robot(
        _rod([(0, 0, 0), (0, 0, -0.3)], 1e5, 4e-3).build(), [*_elastic(), Gravity(), Clamp(at="rod.start")]
    )
    sim = Simulation(robot, dt, stepper=stepper, tolerance=TIGHT, adaptive=adaptive)
    state = equilibrium(robot, residual=1e-9).state()
    v = np.zeros_like(state.v)
    nodes = robot.graph.node_count
    v[: 3 * nodes].reshape(-1, 3)[:, 0] = 0.1 * (robot.graph.x0[:, 2] / 0.3) ** 2
    sim.restore(replace(state, v=v, index=0))
    return sim


def _creep(stepper: Stepper, dt: float) -> Simulation:
    """A rod in a very viscous medium under a force that grows smoothly from nothing."""
    robot = Robot(
        _rod([(0, 0, 0), (0.1, 0, 0)], 1e6, 3e-3).build(),
        [
            *_elastic(), ResistiveForce(viscosity=2.0), Clamp(at="rod.start"),
            PointForce(at="rod.end", force=lambda t: np.array([0.0, 0.0, 0.02 * (1.0 - np.cos(5.0 * t))])),
        ],
    )  # fmt: skip
    return Simulation(robot, dt, stepper=stepper, tolerance=TIGHT)


def _vibration(stepper: Stepper, dt: float) -> Simulation:
    """A rod that is let go from a bent shape."""
    robot = Robot(
        _rod([(0, 0, 0), (0.1, 0, 0.01), (0.19, 0, 0.05)], 2e5, 4e-3, natural="straight").build(),
        [*_elastic(), Clamp(at="rod.start")],
    )
    return Simulation(robot, dt, stepper=stepper, tolerance=TIGHT)


def _run(sim: Simulation, steps: int, report: Report) -> State:
    for _ in range(steps):
        result = sim.step()
        report.demand(
            "steps converge", result.ok and result.substeps == 1,
            f"a step of {sim.dt:g} s fails ({result.status.value})", "Check coefficients(), offsets() and predict().",
        )  # fmt: skip
    return sim.state


def _check_order(
    name: str,
    make: Callable[[Stepper, float], Simulation],
    duration: float,
    steps: int,
    stepper: Stepper,
    report: Report,
) -> None:
    """Order of convergence from differences between runs of halved time steps."""
    ends = [_run(make(stepper, duration / n), n, report).q for n in (steps, 2 * steps, 4 * steps, 8 * steps)]
    gaps = [float(np.abs(a - b).max()) for a, b in pairwise(ends)]
    found = float(np.log2(gaps[-2] / gaps[-1]))
    report.require(
        f"order, {name} rod", max(stepper.order - found, 0.0), SLACK,
        f"errors fall as dt^{found:.2f}, not as dt^{stepper.order}",
        "Check the coefficients, or declare another order.",
    )  # fmt: skip


def _check_energy(stepper: Stepper, report: Report) -> None:
    """The energy of a vibrating rod never grows (first order), or by an error that vanishes with dt."""
    growth = []
    for dt in (2e-3, 1e-3):
        sim = _vibration(stepper, dt)
        energies = [_energy(sim, sim.state)]
        for _ in range(round(0.4 / dt)):
            energies.append(_energy(sim, _run(sim, 1, report)))
        relative = np.array(energies) / energies[0]
        growth.append(float(np.diff(relative).max() if stepper.order == 1 else relative.max() - 1.0))
    if stepper.order == 1:
        report.require(
            "energy", max(growth), 1e-9, "the energy of a rod without actuation grows in a step",
            "A stepper of first order is there for its robustness: make it dissipative.",
        )  # fmt: skip
        return
    report.require(
        "energy",
        growth[0],
        5e-2,
        "the energy of a rod without actuation grows",
        "Damp what dt does not resolve.",
    )
    report.require(
        "energy by dt", growth[1] / max(growth[0], 1e-6), 0.6,
        "the growth of energy does not vanish with dt", "Check the coefficients.",
    )  # fmt: skip


def _energy(sim: Simulation, state: State) -> float:
    """Kinetic and stored energy [J]."""
    m, ev = sim.model, sim.newton.ev
    ev.set_source(state.tangents, state.directors, state.tau, state.q)
    ev.update(state.q, state.v, state.t, sim.dt, 0.0, False)
    return float(0.5 * m.mass @ state.v**2 + sum(b.energy(ev) for b in m.bound))


def _check_momentum(stepper: Stepper, report: Report) -> None:
    """A free rod keeps its linear momentum."""
    robot = Robot(_rod([(0, 0, 0), (0.1, 0, 0), (0.19, 0, 0.05)], 1e6, 4e-3).build(), _elastic())
    velocity = 0.3 * np.random.default_rng(0).normal(size=robot.graph.x0.shape)
    sim = Simulation(robot, 1e-3, stepper=stepper, velocity=velocity, tolerance=TIGHT)
    mass = robot.graph.node_mass

    def momentum(state: State) -> np.ndarray:
        return mass @ state.v[: velocity.size].reshape(-1, 3)

    start, size = momentum(sim.state), float(mass @ np.linalg.norm(velocity, axis=1))
    error = np.abs(momentum(_run(sim, 50, report)) - start).max() / size
    report.require(
        "linear momentum",
        error,
        1e-9,
        "a free rod changes its momentum",
        "Velocities must be linear in forces.",
    )


def _check_angular_momentum(stepper: Stepper, report: Report) -> None:
    """A free rod that spins and bends keeps its angular momentum, as far as the order goes.

    The rod is so thin that its spin about its own axis, which nothing couples back, does not count.
    """
    figure = StickFigure()
    points = [(0, 0, 0), (0.1, 0, 0.01), (0.15, 0.06, 0.05)]
    figure.rod("rod", points, edges=6, material=Material(E=1e8, rho=1000.0), radius=1e-4)
    robot = Robot(figure.build(), _elastic())
    mass = robot.graph.node_mass
    arms = robot.graph.x0 - mass @ robot.graph.x0 / mass.sum()
    velocity = np.cross((3.0, -5.0, 2.0), arms)
    drift = []
    for steps in (50, 100, 200):
        sim = Simulation(robot, 0.1 / steps, stepper=stepper, velocity=velocity, tolerance=TIGHT)
        _run(sim, steps, report)
        x, v = (a[: velocity.size].reshape(-1, 3) for a in (sim.state.q, sim.state.v))
        start, end = (mass @ np.cross(*pair) for pair in ((arms, velocity), (x, v)))
        drift.append(float(np.linalg.norm(end - start) / np.linalg.norm(start)))
    found = float(np.log2(drift[1] / drift[2])) if drift[2] > THIN else np.inf
    report.require(
        "angular momentum", drift[0], 0.3, "a free rod changes its angular momentum by much",
        "Forces that balance at one time must act on velocities of that time.",
    )  # fmt: skip
    report.require(
        "angular momentum by dt", max(stepper.order - found, 0.0), SLACK,
        f"the drift of a free rod's angular momentum falls as dt^{found:.2f}, not as dt^{stepper.order}",
        "Check the coefficients.",
    )  # fmt: skip


def _check_files(stepper: Stepper, report: Report) -> None:
    """A run continued from its file equals the uninterrupted one, with fixed and with chosen steps."""
    for adaptive, name in ((None, "restart from a file"), (0.05, "restart of chosen steps")):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "run.nc")
            sim = _swing(stepper, 5e-3, adaptive)
            sim.run(0.04, out=path)
            other = _swing(stepper, 5e-3, adaptive)
            other.restore(Trajectory.load(path, other.robot).state(-1))
        ends = [s.run(0.04).state() for s in (sim, other)]
        report.demand(
            name, all(np.array_equal(*(getattr(end, k) for end in ends)) for k in KEPT),
            "a run continued from its file differs from the uninterrupted one",
            "Everything that a step needs from the last one belongs into the State.",
        )  # fmt: skip


def _check_restart(stepper: Stepper, report: Report) -> None:
    """A run from a saved state equals the uninterrupted one."""
    sim = _swing(stepper, 5e-3)
    middle = _run(sim, 4, report)
    end = _run(sim, 4, report)
    other = _swing(stepper, 5e-3)
    other.restore(middle)
    again = _run(other, 4, report)
    report.demand(
        "restart", all(np.array_equal(getattr(end, k), getattr(again, k)) for k in KEPT),
        "a run continued from a saved state differs from the uninterrupted one",
        "Everything that a step needs from the last one belongs into the State.",
    )  # fmt: skip
