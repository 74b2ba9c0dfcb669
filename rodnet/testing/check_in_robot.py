"""`check_in_robot`: whether a term works where people will put it, in a branched robot with joints of every kind."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import RodnetError
from rodnet.graph.material import Material, elliptic
from rodnet.graph.rod_graph import RodGraph
from rodnet.graph.stick_figure import StickFigure
from rodnet.parameters import Parameter
from rodnet.robot import Robot
from rodnet.simulation import Simulation
from rodnet.solve.model import Model
from rodnet.solve.steppers import State
from rodnet.terms.actuators import Actuator
from rodnet.terms.base import Term
from rodnet.terms.constraints import Constraint
from rodnet.terms.energies import Bending, Stretching, Twisting
from rodnet.testing.bound import same_states
from rodnet.testing.check_term import place
from rodnet.testing.report import ContractError, Report
from rodnet.testing.states import Probe
from rodnet.trajectory import Trajectory

if TYPE_CHECKING:
    from rodnet.solve.steppers import Stepper

STEPS = 6  # of each run; it is broken off and continued in the middle
TINY = 1e-6  # step of differences [edge lengths]: friction has a corner where the last step ended


def check_in_robot(
    term: Term | type[Term],
    *,
    graph: RodGraph | None = None,
    steppers: Sequence[str | Stepper] = ("sdirk2", "alpha"),
    seed: int = 0,
    rtol: float = 1e-5,
    speed: float = 0.1,
    dt: float = 1e-3,
    sensors: Mapping[str, Any] | None = None,
) -> Report:
    """Check a term in a whole robot: with joints, second-order steppers, a restart from a file, and a sweep.

    `check_term` asks whether a term is right; this, whether it works in company. With each stepper a few steps
    must converge; the term's Jacobian at the state that they reach, with the memory that it has by then, must be
    the derivative of its forces; and a run that is saved half way and continued from the file must end in the same
    state, bit for bit. A sweep over each of its parameters, sent and read as by worker processes, must
    reproduce that run where nothing is changed, and give another result where something is. (A term that
    has no parameters is swept over the stiffness of a rod.)

    Parameters
    ----------
    term : Term or Term class
        As for `check_term`.
    graph : RodGraph, optional
        Where to check it, with a rod ``"rod"``; by default `rodnet.testing.branched`.
    steppers : sequence of str or Stepper
        What to run it with; the sweep takes the first.
    seed : int
        Seed of the velocities that the robot starts with.
    rtol : float
        Allowed error of derivatives, relative to the largest entry.
    speed : float
        Typical speed of the robot [m/s].
    dt : float
        Time step [s].
    sensors : mapping, optional
        Readings that an actuator's command finds.

    Returns
    -------
    Report
        The checks with their largest errors; print it.

    Raises
    ------
    ContractError
        If a check fails; says which, and what to do.
    """
    cls = term if isinstance(term, type) else type(term)
    if not issubclass(cls, Term):
        raise ContractError(f"check_in_robot needs a rodnet term or a class of terms, got {term!r}")
    report = Report(f"check_in_robot({cls.__name__})")
    graph = branched() if graph is None else graph
    placed = place(term, graph, report)
    # names of their own: the term may be one of these, and count twice
    company = [Stretching(name="axial"), Bending(name="bend"), Twisting(name="twist")]
    robot = Robot(graph, [*company, placed], {k: partial(_reading, v) for k, v in (sensors or {}).items()})
    rng = np.random.default_rng(seed)
    velocity = speed * rng.normal(size=(graph.node_count, 3))
    ends = []
    for stepper in steppers:
        sim = Simulation(robot, dt, stepper=stepper, velocity=velocity)
        path = _run(sim, report)
        probe = _probe(sim, len(company), path, speed, dict(sensors or {}))
        _check_derivatives(sim.stepper.name, probe, report, rng, rtol)
        _check_restart(robot, sim, path, report)
        ends.append(path[-1])
    _check_sweep(robot, len(company), steppers[0], velocity, dt, ends[0], report)
    return report


def branched() -> RodGraph:
    """A rod with branches on branches: welded, on a hinge, on a ball joint and on an elastic joint.

    The rod ``"rod"`` starts at the origin along x, and its nodes 1 and 2 carry nothing else.
    """
    figure = StickFigure()
    rubber, resin = Material(E=1e7, nu=0.4), Material(E=2e7, nu=0.3, rho=1200.0)
    points = [(0, 0, 0), (0.02, 0, 0), (0.041, 0.006, 0), (0.058, 0.006, 0.008), (0.075, 0.002, 0.014)]
    figure.rod("rod", points, material=rubber, section=elliptic(5e-3, 4e-3))
    figure.rod("arm", ["rod.end", (0.09, 0.013, 0.02), (0.104, 0.028, 0.018)], material=resin, radius=3e-3)
    figure.rod("leg", ["rod.end", (0.094, -0.012, 0.012), (0.11, -0.024, 0.02)], material=resin, radius=3e-3)
    figure.rod("hand", ["arm:1", (0.088, 0.028, 0.032), (0.092, 0.045, 0.038)], material=rubber, radius=2e-3)
    figure.rod("fin", ["hand:1", (0.075, 0.028, 0.047), (0.06, 0.012, 0.048)], material=rubber, radius=2e-3)
    figure.rod("spur", ["rod:3", (0.056, -0.012, 0.016), (0.06, -0.03, 0.02)], material=resin, radius=2e-3)
    figure.joint("arm:1", kind="hinge", axis=(0, 1, 1), of="hand", stiffness=2e-3, angle=0.1)
    figure.joint("hand:1", kind="ball", of="fin")
    figure.joint("rod:3", kind="elastic", of="spur", stiffness=(0.02, 0.05), axis=(0, -1, 0.3))
    return figure.build()


def _reading(value: Any, _: Any) -> Any:
    return value


def _run(sim: Simulation, report: Report) -> list[State]:
    """States of a run."""
    path = [sim.state]
    for _ in range(STEPS):
        result = sim.step()
        report.demand(
            f"{sim.stepper.name}: steps converge", result.ok,
            f"a step of {sim.dt:g} s of a robot with joints fails: {result.status.value}",
            "Check the sign and the magnitude of the force and its derivatives, or pass a smaller dt=.",
        )  # fmt: skip
        path.append(sim.state)
    return path


def _probe(sim: Simulation, at: int, path: list[State], speed: float, sensors: Any) -> Probe:
    """The term alone where the last step ends, with the memory that it had where that began."""
    term = sim.robot.terms[at]
    # what exerts no force of its own: the whole robot under its command
    alone = not isinstance(term, Actuator | Constraint)
    model = Model(Robot(sim.robot.graph, [term])) if alone else Model(sim.robot)
    bound, memory = model.bound[0 if alone else at], path[-2].memories[at]
    if memory is not None:
        bound.restore(model, memory)
    return Probe.between(model, path[-2], path[-1], speed=speed, sensors=MappingProxyType(sensors))


def _check_derivatives(
    name: str, probe: Probe, report: Report, rng: np.random.Generator, rtol: float
) -> None:
    for by, (error, where) in probe.slope_errors(rng, TINY).items():
        report.require(
            f"{name}: Jacobian by {by}", error, rtol,
            f"at a state of a run the assembled derivative is wrong for the {where}",
            "Run check_term, which finds what is wrong with a derivative; where that passes, it depends on what is "
            "special here: joints, and a memory with a past.",
        )  # fmt: skip


def _check_restart(robot: Robot, sim: Simulation, path: list[State], report: Report) -> None:
    """A run that is continued from a file ends where the uninterrupted one does."""
    check, half = f"{sim.stepper.name}: continued from a file", STEPS // 2
    with tempfile.TemporaryDirectory() as folder:
        first, later = (Simulation(robot, sim.dt, stepper=sim.stepper) for _ in range(2))
        try:
            first.restore(path[half - 1])
            first.run(sim.dt, out=Path(folder) / "run.nc")
            later.restore(Trajectory.load(Path(folder) / "run.nc", robot).state())
        except RodnetError as error:
            report.demand(
                check, False, str(error), "A memory is a finite array whose shape a new robot knows."
            )
        for _ in range(STEPS - half):
            later.step()
        report.demand(
            check, same_states(later.state, path[-1]), "the run ends elsewhere",
            "What changes from step to step belongs into the memory (next_memory and restore).",
        )  # fmt: skip


def _check_sweep(
    robot: Robot, at: int, stepper: Any, velocity: np.ndarray, dt: float, end: State, report: Report
) -> None:
    """Sweep each parameter, as worker processes do it."""
    from rodnet.sweeps.driver import sweep

    term = robot.terms[at]
    swept = {f"{term.name}.{name}": p for name, p in term.parameter_items() if p.value is not None}
    if not swept:  # a robot of another material is drawn anew
        swept = {"rod.E": robot.parameters["rod.E"]}
        robot = robot.with_parameters({path: p.value for path, p in swept.items()})
        sim = Simulation(robot, dt, stepper=stepper, velocity=velocity)
        end = _run(sim, report)[-1]
    rest = {path: p.value for path, p in swept.items()}
    rows = [rest, *({**rest, path: _varied(p).value} for path, p in swept.items())]
    found = sweep(
        partial(_same_robot, robot), metrics=_end, samples=rows, duration=STEPS * dt, dt=dt, workers=0,
        options={"stepper": stepper, "velocity": velocity},
    )  # fmt: skip
    errors = [str(e) for e in found["error"].values if str(e)]
    report.demand(
        "sweep", not errors, f"a run of the sweep fails: {errors[:1]}", "Try the values one by one."
    )
    q = found["q"].values
    report.demand(
        "sweep: as it was", np.array_equal(q[0], end.q), "in a sweep the same robot moves differently",
        "A term is sent to other processes by pickling: what it is made of must survive that.",
    )  # fmt: skip
    still = [path for k, path in enumerate(swept, start=1) if np.array_equal(q[k], q[0])]
    for path, p in swept.items():
        report.demand(
            "sweep: parameters matter", path not in still or (p.kind == "shape" and len(still) < len(swept)),
            f"'{path}' = {_varied(p).value} moves the robot exactly as {p.value} does",
            "Read parameters from the argument p, or where the term is bound; if this one has no effect here, give "
            "the class attribute example values with which it has.",
        )  # fmt: skip


def _varied(p: Parameter) -> Parameter:
    """The parameter with a value nearby: some are bound to each other, as a reach to a radius."""
    low, high = p.bounds
    for factor, shift in ((0.95, 0.0), (1.05, 0.0), (1.0, 0.1), (1.0, -0.1)):
        value = np.asarray(p.value) * factor + shift
        if np.all((value >= low) & (value <= high) & (value != p.value)):
            return p.with_value(value)
    return p


def _same_robot(robot: Robot) -> Robot:
    return robot


def _end(traj: Trajectory) -> dict[str, Any]:
    return {"q": traj.state().q}
