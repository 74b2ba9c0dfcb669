"""Checks of a term bound to a graph: derivatives, claims, and steps of a simulation."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from rodnet.graph.rod_graph import RodGraph
from rodnet.robot import Robot
from rodnet.simulation import Simulation
from rodnet.solve.evaluation import Evaluation
from rodnet.solve.model import Model
from rodnet.solve.steppers import State
from rodnet.terms.actuators import Actuator
from rodnet.terms.base import Term
from rodnet.terms.constraints import Constraint
from rodnet.terms.drag.line import DragModel
from rodnet.terms.drag.medium import BoundMediumLaw
from rodnet.terms.energies import Bending, Stretching, Twisting
from rodnet.terms.loads import LoadModel
from rodnet.testing.medium import fill_field
from rodnet.testing.report import Report
from rodnet.testing.states import Probe, random_rotation
from rodnet.testing.taylor import taylor_slope


def check_bound(
    term: Term,
    graph: RodGraph,
    report: Report,
    rng: np.random.Generator,
    rtol: float,
    speed: float,
    sensors: Mapping[str, Any],
) -> None:
    """Check forces, derivatives and claims at one random state of a graph.

    Actuators and constraints exert no force of their own; they are checked in company of the elastic
    energies, whose derivatives must stay right under their commands.
    """
    acts = isinstance(term, Actuator | Constraint)
    robot = Robot(graph, [Stretching(), Bending(), Twisting(), term] if acts else [term])
    probe = Probe(robot, rng, speed=speed, sensors=sensors)
    bound = probe.model.bound[-1]
    fresh = copy.deepcopy(bound.memory)
    if fresh is not None and not acts:
        for k in range(3):  # a memory with a history: friction has a corner where the last step ended
            past = probe.q - 1e-2 * (3 - k) * probe.units * np.cos(np.arange(len(probe.q)))
            bound.restore(probe.model, np.asarray(bound.next_memory(probe.evaluate(past))))
        if isinstance(bound, BoundMediumLaw):
            fill_field(bound, probe.model, rng)
    _check_forces(probe, report)
    _check_derivatives(term, probe, report, rtol)
    if term.kind == "energy":
        _check_energy(probe, report, rng)
    if not acts and term.kind in ("energy", "drag", "load"):
        _check_null(term, graph, probe, report)
    if fresh is not None:  # a history would have to turn with the robot
        bound.restore(probe.model, fresh)
    _check_claims(term, probe, report, rng)


def _check_forces(probe: Probe, report: Report) -> None:
    """Forces are finite, repeatable, added, and the same with and without a Jacobian."""
    model, first = probe.model, probe.forces()
    report.demand(
        "finite", bool(np.all(np.isfinite(first))), "a force is not finite", "Guard divisions and roots."
    )
    bound, memory = model.bound[-1], copy.deepcopy(model.bound[-1].memory)
    bound.next_memory(probe.ev)
    again, with_jacobian = probe.forces(), probe.evaluate(jac=True).F.copy()
    report.demand(
        "repeatable", np.array_equal(first, again), "the same state gives other forces at a second evaluation",
        "A bound term must not change in add(); memory changes in restore() only.",
    )  # fmt: skip
    size = max(float(np.abs(first).max()), 1e-300)
    report.require(
        "forces with a Jacobian", np.abs(first - with_jacobian).max() / size, 1e-12,
        "add() gives other forces when a Jacobian is asked for", "Compute both from the same formula.",
    )  # fmt: skip
    report.demand(
        "memory is kept", _equal(memory, bound.memory),
        "an evaluation changed the memory of the last accepted state", "Return the new memory, do not store it.",
    )  # fmt: skip
    if bound.replacing:
        return
    ev = probe.evaluate()
    twice = np.zeros(model.dof_count)
    for _ in range(2):
        bound.add(ev, twice, model.scrap, False)
    report.require(
        "forces are added", np.abs(twice - 2.0 * bound.forces(ev)).max() / size, 1e-12,
        "add() does not add to F", "Use F[dofs] += ..., or np.add.at where degrees of freedom repeat.",
    )  # fmt: skip


def _differenced(term: Term) -> bool:
    """Whether the framework itself differences this law."""
    if isinstance(term, DragModel):
        return type(term).bind is DragModel.bind and type(term).kernel is None
    return isinstance(term, LoadModel)


def _check_derivatives(term: Term, probe: Probe, report: Report, rtol: float) -> None:
    allowed = 10.0 * rtol if _differenced(term) else rtol
    for by, (error, where) in probe.jacobian_errors().items():
        report.require(
            f"Jacobian by {by}", error, allowed, f"the assembled derivative is wrong for the {where}",
            "Compare jacobian(), psi(), the kernel or the bound term's add() with the derivative of the force "
            "(data receives minus the derivative of the force by the position, and cv times that by the velocity).",
        )  # fmt: skip


def _check_energy(probe: Probe, report: Report, rng: np.random.Generator) -> None:
    """The forces are the derivatives of the energy."""
    model = probe.model
    direction = np.zeros(model.dof_count)
    direction[model.free] = (probe.units * rng.normal(size=model.dof_count))[model.free]
    direction *= 1e-2 / float(np.abs(direction / probe.units).max())
    energy, slope = probe.energy(), -float(probe.forces() @ direction)
    curvature = direction[model.free] @ probe.jacobian() @ direction[model.free]

    def along(h: float) -> float:
        return probe.energy(probe.q + h * direction)

    def mean(h: float) -> float:  # of both sides: on one, cubic and quartic terms may cancel
        return 0.5 * (along(h) + along(-h))

    for order, energies, coefficients, what in (
        (1, along, (energy, slope), "minus the force"),
        (2, mean, (energy, 0.0, 0.5 * curvature), "the Jacobian"),
    ):
        found = taylor_slope(energies, coefficients, largest=1.0)
        report.require(
            f"Taylor test of order {order}", max(order + 1 - found, 0.0), 0.5,
            f"{what} is no derivative of the energy: the remainder falls as h^{found:.2f}, not as h^{order + 1}",
            "Check psi and its derivatives against each other.",
        )  # fmt: skip


def _check_null(term: Term, graph: RodGraph, probe: Probe, report: Report) -> None:
    """At the null values of all its strengths a drag or load does nothing; any term stays finite."""
    strengths = {name: p.null for name, p in term.parameter_items() if p.kind == "strength"}
    nulls = {name: null for name, null in strengths.items() if null is not None}
    if not nulls:
        return
    other = copy.copy(probe)
    other.model = Model(Robot(graph, [with_values(term, nulls)]))
    other.ev = Evaluation(other.model)
    F, values = other.forces(), ", ".join(f"{k} = {v:g}" for k, v in nulls.items())
    report.demand(
        "finite at null",
        bool(np.all(np.isfinite(F))),
        f"with {values} a force is not finite",
        "Guard divisions.",
    )
    if nulls == strengths and term.kind in ("drag", "load"):
        report.require(
            "null value", np.abs(F).max(), 0.0, f"with {values} forces remain",
            "At its null value a term must do nothing, bit for bit; declare null= only where that is so.",
        )  # fmt: skip


def _check_claims(term: Term, probe: Probe, report: Report, rng: np.random.Generator) -> None:
    F, alone = probe.forces(), not isinstance(term, Actuator | Constraint)
    scale = max(float(np.abs(F * probe.units).max()), 1e-300)
    if "conservative" in term.claims and alone:
        J = probe.jacobian() * probe.units[probe.model.free][:, None] * probe.units[probe.model.free][None, :]
        size = max(float(np.abs(J).max(initial=0.0)), 1e-300)
        report.require(
            "conservative: symmetry", np.abs(J - J.T).max(initial=0.0) / size, 1e-8,
            "the Jacobian is not symmetric, so the force is no gradient", "Drop the claim \"conservative\".",
        )  # fmt: skip
        moved = np.abs((probe.forces(v=0.0 * probe.v) - F) * probe.units).max() / scale
        report.require(
            "conservative: rates",
            moved,
            1e-12,
            "the force depends on the velocity",
            'Drop the claim "conservative".',
        )
    if "dissipative" in term.claims and alone:
        power = float(F @ probe.v) / max(float(np.abs(F) @ np.abs(probe.v)), 1e-300)
        report.require(
            "dissipative: robot", power, 1e-12, "it puts power into a robot in a still medium",
            "Check the sign of the force, or drop the claim \"dissipative\".",
        )  # fmt: skip
    if "objective" in term.claims and alone:
        R, shift = random_rotation(rng), rng.normal(size=3)
        other = probe.rotated(R, shift)
        error = np.abs((other.forces() - probe.turn_vector(F, R)) * probe.units).max() / scale
        report.require(
            "objective: robot", error, 1e-8, "the forces do not turn with a robot that is moved as a rigid body",
            "The law singles out a place or a direction: drop the claim \"objective\".",
        )  # fmt: skip
        if term.kind == "energy":
            change = abs(other.energy() - probe.energy()) / max(abs(probe.energy()), 1e-300)
            report.require(
                "objective: energy",
                change,
                1e-9,
                "a rigid motion changes the energy",
                'Drop the claim "objective".',
            )


def check_steps(
    term: Term,
    graph: RodGraph,
    report: Report,
    rng: np.random.Generator,
    speed: float,
    dt: float,
    sensors: Mapping[str, Any],
) -> None:
    """A few steps converge, and can be repeated bit for bit after a rejected step and from a restart."""
    # names of their own: the term may be one of these, and count twice
    terms = [Stretching(name="axial"), Bending(name="bend"), Twisting(name="twist"), term]
    robot = Robot(graph, terms, {name: _constant(value) for name, value in sensors.items()})
    velocity = speed * rng.normal(size=(graph.node_count, 3))
    sim = Simulation(robot, dt, velocity=velocity)
    states = [sim.state]
    for _ in range(4):
        result = sim.step()
        report.demand(
            "steps converge", result.ok, f"a step of {dt:g} s of a small robot fails: {result.status.value}",
            "Check the sign and the magnitude of the force and its derivatives, or pass a smaller dt=.",
        )  # fmt: skip
        states.append(sim.state)
    middle = states[2]
    remedy = "What changes during a step belongs into the memory (next_memory and restore)."
    # an attempt that is given up must leave no trace
    sim.newton.step(middle, sim.stepper, middle.t + 7.0 * dt, 7.0 * dt, sim.observe().sensors, {})
    sim.restore(middle)
    fresh = Simulation(robot, dt, velocity=velocity)
    fresh.restore(middle)
    for other, what in ((sim, "after a rejected step"), (fresh, "from a restart")):
        for state in states[3:]:
            other.step()
            report.demand(
                f"repeatable {what}", same_states(other.state, state), f"steps {what} differ", remedy
            )


def _constant(value: Any) -> Callable[[Any], Any]:
    return lambda _: value


def _equal(a: np.ndarray | None, b: np.ndarray | None) -> bool:
    return a is b if a is None or b is None else np.array_equal(a, b)


def same_states(a: State, b: State) -> bool:
    """Whether two states are equal bit for bit, memories included."""
    memories = all(_equal(m, n) for m, n in zip(a.memories, b.memories, strict=True))
    return memories and all(
        np.array_equal(getattr(a, k), getattr(b, k)) for k in ("q", "v", "a", "directors")
    )


def with_values(term: Term, values: Mapping[str, Any]) -> Term:
    """A copy of a term with other parameter values."""
    other = copy.copy(term)
    for name, value in values.items():
        setattr(other, name, getattr(term, name).with_value(value))
    return other
