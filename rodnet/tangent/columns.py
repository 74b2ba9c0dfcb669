"""What sensitivities are taken by: parameters of a robot by path, and changes of its initial state."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

import numpy as np

from rodnet.errors import ParameterError, PlausibilityWarning
from rodnet.kinematics.frames import cross, transport, unit
from rodnet.names import listed, meant
from rodnet.parameters import Parameter
from rodnet.robot import Robot
from rodnet.simulation import Simulation
from rodnet.solve.model import Model
from rodnet.solve.steppers import make_stepper
from rodnet.tangent.compare import alike
from rodnet.tangent.state import StateTangent, combined, zero
from rodnet.terms.actuators import _BoundActuator
from rodnet.terms.base import Term
from rodnet.terms.constraints import BoundConstraint, Constraint
from rodnet.terms.drag.stokes import StokesHead
from rodnet.terms.local.earlier import BalancedStart, EarlierSet
from rodnet.terms.tendons import Tendon

STEP = float(np.cbrt(np.finfo(float).eps))  # of central differences, relative
TINY = 1e-8  # of differences from nothing, relative


class Near(NamedTuple):
    """As much of a simulation as most columns need."""

    model: Model


@dataclass(frozen=True)
class Variation:
    """One column: a quantity, and simulations with it changed by small steps.

    The derivative of whatever these simulations have is the sum of weights times it, a difference
    quotient. It is only ever taken of single evaluations and of initial states.

    Attributes
    ----------
    name, unit : str
        Its path and SI unit.
    value : float
        Where the derivative is taken.
    near : tuple of (float, Simulation)
        Weights, whose sum is zero, and simulations; with ``start`` their models are enough.
    acts : bool
        Whether it changes anything but the initial state.
    start : tuple of ndarray, optional
        Displacements [m] and velocities [m/s] of the nodes, shapes (node_count, 3), where these are all that
        it changes of the initial state.
    added : tuple of (float, tuple of Term)
        Weights, and terms that a robot has beside those of the simulation, with no effect but the column's own.
    turn : ndarray, shape (edge_count,), optional
        Beside ``start``, angles of the directors about the edges [rad].
    """

    name: str
    unit: str
    value: float
    near: tuple[tuple[float, Any], ...]
    acts: bool = True
    start: tuple[np.ndarray, np.ndarray] | None = None
    added: tuple[tuple[float, tuple[Term, ...]], ...] = ()
    turn: np.ndarray | None = None

    def initial(self, sim: Simulation) -> StateTangent:
        """Derivative of the initial state of ``sim``."""
        if self.start is not None:
            tangent = zero(sim.model, sim.state, 1)
            for array, change in zip((tangent.q, tangent.v), self.start, strict=True):
                array[: change.size, 0] = change.ravel()
                array[sim.model.held] = 0.0
            tangent.spin[:, 0] = _start_spin(sim, self.start[0], tangent.q[:, 0])
            if self.turn is not None:
                tangent.spin[:, 0] += self.turn
            return tangent
        others = [(weight, other.state) for weight, other in self.near]
        return combined(sim.model, sim.state, others)


def _start_spin(sim: Simulation, dx: np.ndarray, dq: np.ndarray) -> np.ndarray:
    """Spin of the initial directors: none but where constraints have moved an edge from where it is drawn.

    There the ways from the drawn to the changed tangents and from there on enclose an angle.
    """
    model, state = sim.model, sim.state
    if not dx.any():
        return np.zeros(model.edge_count)

    def tangents(x: np.ndarray) -> np.ndarray:
        return unit(x[model.edges[:, 1]] - x[model.edges[:, 0]])

    x, drawn = state.q[: model.twist0].reshape(-1, 3), model.x0.copy()
    moved = dq[: model.twist0].reshape(-1, 3)
    side, spin = cross(state.tangents, state.directors), np.zeros(model.edge_count)
    step = STEP * float(model.rest_length.min()) / float(np.abs(dx).max())
    for h in (step, -step):
        drawn[: len(dx)] = model.x0[: len(dx)] + h * dx
        begin, end = tangents(drawn), tangents(x + h * moved)
        d1 = transport(transport(model.d10, model.t0, begin), begin, end)
        spin += np.sum(transport(d1, end, state.tangents) * side, axis=1) / (2.0 * h)
    return spin


def stencil(value: float, step: float, bounds: tuple[float, float]) -> list[tuple[float, float]]:
    """Weights and places of a difference quotient of second order within bounds."""
    low, high = bounds
    if low <= value - step and value + step <= high:
        return [(0.5 / step, value + step), (-0.5 / step, value - step)]
    if value + 2.0 * step > high:
        step = -step
    if not low <= value + 2.0 * step <= high:
        raise ParameterError(f"the bounds [{low:g}, {high:g}] leave no room for a derivative at {value:g}")
    return [(-1.5 / step, value), (2.0 / step, value + step), (-0.5 / step, value + 2.0 * step)]


def find(robot: Robot, path: str) -> dict[str, Parameter]:
    """Parameters that a path names; a glob such as ``"tail*.E"`` may name several, which are one then.

    Raises
    ------
    ParameterError
        If there is none, or their values differ.
    """
    known = robot.parameters
    names = [path] if path in known else [name for name in known if fnmatchcase(name, path)]
    if not names:
        raise ParameterError(f"no parameter {path!r}; {meant(path, known)}{listed(known)}")
    found = {name: known[name] for name in names}
    for name, parameter in found.items():
        if np.ndim(parameter.value):
            raise ParameterError(
                f"'{name}' has {np.size(parameter.value)} values, one per site; sensitivities are by single numbers: "
                f"give one of them, '{name}[0]'"
            )
    values = [p.value for p in found.values()]
    if len(set(values)) > 1:
        raise ParameterError(f"'{path}' stands for {', '.join(names)}, whose values differ: {values}")
    return found


def _indexed(robot: Robot, path: str) -> tuple[str, int] | None:
    """Path and index of one value of an array, ``"drag.viscosity[3]"``."""
    name, bracket, rest = path.partition("[")
    if not bracket or not rest.endswith("]") or name not in robot.parameters:
        return None
    try:
        index = int(rest[:-1])
    except ValueError:
        return None
    size = np.size(robot.parameters[name].value)
    if not np.ndim(robot.parameters[name].value) or not 0 <= index < size:
        raise ParameterError(f"'{path}': '{name}' has {size} values, numbered from 0")
    return name, index


def by_parameter(robot: Robot, path: str, scale: float | None, options: Mapping[str, Any]) -> Variation:
    """Column of a parameter of the robot.

    Parameters
    ----------
    robot : Robot
        The robot.
    path : str
        A path or a glob, or with an index one value of an array.
    scale : float, optional
        Change that is worth considering, for parameters that are zero.
    options : mapping
        Of the `Simulation`.
    """
    indexed = _indexed(robot, path)
    if indexed is None:
        found = find(robot, path)
        first = next(iter(found.values()))
        values: np.ndarray | None = None
        value = float(first.value)
    else:
        found = {indexed[0]: robot.parameters[indexed[0]]}
        first = found[indexed[0]]
        values = np.asarray(first.value, dtype=float)
        value = float(values.flat[indexed[1]])
    low = max(p.bounds[0] for p in found.values())
    high = min(p.bounds[1] for p in found.values())
    size = abs(value) or scale or 1.0
    robots = []
    for weight, place in stencil(value, STEP * size, (low, high)):
        given: Any = place
        if values is not None and indexed is not None:
            given = values.copy()
            given.flat[indexed[1]] = place
        robots.append((weight, robot._changed(dict.fromkeys(found, given))))
    near = [(weight, Near(Model(changed))) for weight, changed in robots]
    if _begin_alike([other.model for _, other in near], options):
        nothing = np.zeros(robot.graph.x0.shape)
        return Variation(path, first.unit, value, tuple(near), start=(nothing, nothing))
    with warnings.catch_warnings():  # what is implausible of them is of the robot itself, which was told
        warnings.simplefilter("ignore", PlausibilityWarning)
        sims = tuple((weight, Simulation(changed, **options)) for weight, changed in robots)
    return Variation(path, first.unit, value, sims)


def _begin_alike(models: Sequence[Model], options: Mapping[str, Any]) -> bool:
    """Whether simulations of models begin in the same state, for all that these say: then no run of them is set up."""
    one, *others = models
    if (
        one.bodies is not None
        or one.joints
        or make_stepper(options.get("stepper", "euler")).needs_acceleration
    ):
        return False
    places = all(
        np.array_equal(getattr(one, k), getattr(m, k)) for m in others for k in ("x0", "d10", "held")
    )
    known = [(b, c) for m in others for b, c in zip(one.bound, m.bound, strict=True)]
    return places and all(
        alike(b.memory, c.memory) and (alike(b, c) or not isinstance(b, BoundConstraint)) for b, c in known
    )


def by_added(robot: Robot, edited: Robot, path: str, scale: float | None) -> Variation:
    """Column of a parameter of terms that ``robot`` lacks, and which at its present value have no effect.

    As nothing comes of the null value, there is no round-off in the difference from it: a tiny step to one side does.

    Parameters
    ----------
    robot : Robot
        The robot that is simulated.
    edited : Robot
        The same with more terms.
    path : str
        Path of one number of these.
    scale : float, optional
        Change that is worth considering, for parameters that are zero.
    """
    found = find(edited, path)
    first = next(iter(found.values()))
    value, step = float(first.value), TINY * (scale or 1.0)
    if value + step > first.bounds[1]:
        step = -step
    terms = _touched(robot, edited, dict.fromkeys(found, value + step))
    return Variation(path, first.unit, value, (), acts=False, added=((1.0 / (value + step - value), terms),))


def _touched(robot: Robot, edited: Robot, values: Mapping[str, float]) -> tuple[Term, ...]:
    """Terms that ``robot`` lacks and that have a changed parameter; the others have no effect."""
    names, before = {term.name for term in robot.terms}, set(map(id, edited.terms))
    return tuple(t for t in edited._changed(values).terms if t.name not in names and id(t) not in before)


def by_replaced(robot: Robot, edited: Robot, path: str, scale: float | None) -> Variation | None:
    """Column of a parameter of one term in the place of another that does the same at the parameter's present value.

    What it changes is a difference of two of its kind that would act beside the robot's own, each with its own memory.
    None where the robots differ by more than such a term.

    Parameters
    ----------
    robot : Robot
        The robot that is simulated.
    edited : Robot
        The same with the other term.
    path : str
        Path of one number of it.
    scale : float, optional
        Change that is worth considering, for parameters that are zero.
    """
    if edited.graph is not robot.graph or len(edited.terms) != len(robot.terms):
        return None
    other = _differing(robot, edited)
    found = find(edited, path)
    first = next(iter(found.values()))
    value, added = float(first.value), []
    for weight, place in stencil(value, STEP * (abs(value) or scale or 1.0), first.bounds):
        changed = edited._changed(dict.fromkeys(found, place))
        if len(other) != 1 or _differing(edited, changed) != other:
            return None
        added.append((weight, (changed.terms[other[0]],)))
    return Variation(path, first.unit, value, (), acts=False, added=tuple(added))


def _differing(one: Robot, other: Robot) -> list[int]:
    return [k for k, (a, b) in enumerate(zip(one.terms, other.terms, strict=True)) if a is not b]


def by_edit(robot: Robot, edited: Robot, path: str, scale: float | None) -> Variation:
    """Column of a parameter of terms that ``robot`` lacks, which change its model but not how it begins."""
    found = find(edited, path)
    first = next(iter(found.values()))
    value, near = float(first.value), []
    for weight, place in stencil(value, STEP * (abs(value) or scale or 1.0), first.bounds):
        changed = copy.copy(robot)
        changed.terms = (*robot.terms, *_touched(robot, edited, dict.fromkeys(found, place)))
        near.append((weight, Near(Model(changed))))
    nothing = np.zeros(edited.graph.x0.shape)
    return Variation(path, first.unit, value, tuple(near), start=(nothing, nothing))


def by_start(
    robot: Robot, name: str, change: Mapping[str, Any], options: Mapping[str, Any], remembers: bool = True
) -> Variation:
    """Column of a change of the initial state: displacements ``x`` [m] and velocities ``v`` [m/s] of all nodes, and
    angles ``turn`` [rad] of the directors about edges that nothing holds, of robots without joints and bodies.

    Raises
    ------
    ParameterError
        If it is none, or of another shape.
    """
    shape = robot.graph.x0.shape
    unknown = sorted(set(change) - {"x", "v", "turn"})
    if unknown or not change:
        raise ParameterError(
            f"initial '{name}' has {', '.join(unknown) or 'nothing'}; give 'x' [m], 'v' [m/s] or 'turn' [rad]"
        )
    dx, dv = (np.zeros(shape) if change.get(k) is None else np.asarray(change[k], dtype=float) for k in "xv")
    for key, array in (("x", dx), ("v", dv)):
        if array.shape != shape or not np.all(np.isfinite(array)):
            raise ParameterError(
                f"initial '{name}': {key} must be finite and of shape {shape}, one row per node, got {array.shape}"
            )
    turn = change.get("turn")
    acts, graph = _felt(robot, dx, turn), robot.graph
    # directors are carried along by parallel transport, unless joints or bodies turn with them; memories may begin with
    # where the robot does
    rates = make_stepper(options.get("stepper", "euler")).needs_acceleration
    begun = remembers and (bool(dx.any()) or turn is not None)
    plain = not (graph.joints or graph.bodies or rates or begun)
    if plain and not acts:
        return Variation(name, "1", 0.0, (), acts=False, start=(dx, dv), turn=turn)
    shortest = float(graph.rest_length.min())
    start = (
        np.zeros(shape) if options.get("velocity") is None else np.asarray(options["velocity"], dtype=float)
    )
    of_v = max(np.abs(start).max(), shortest)
    largest = max(float(np.abs(dx).max()) / shortest, float(np.abs(dv).max()) / of_v)
    step = STEP / largest if largest > 0.0 else STEP
    near = []
    for weight, place in stencil(0.0, step, (-np.inf, np.inf)):
        posed = graph.with_positions(graph.x0 + place * dx) if dx.any() else graph
        posed = posed if turn is None else posed.twisted(place * turn)
        other = robot if posed is graph else Robot(posed, robot.terms, robot.sensors)
        near.append((weight, Simulation(other, **{**options, "velocity": start + place * dv})))
    return Variation(name, "1", 0.0, tuple(near), acts=acts)


def _felt(robot: Robot, dx: np.ndarray, turn: np.ndarray | None = None) -> bool:
    """Whether a change of the initial positions changes more than where a run begins.

    What is held is held where it was, directions of walls, joints and bodies are as they were, and tendons are
    as long: only these terms of rodnet look at the initial positions, those that are defined by the shape at the start,
    and heads of a shape of their own; those of others may.
    """
    graph = robot.graph
    defined = any(
        isinstance(t, EarlierSet | BalancedStart)
        or (isinstance(t, StokesHead) and t.shape is not None and graph.figure is None)
        for t in robot.terms
    )
    if defined:
        return bool(dx.any()) or turn is not None
    known = np.zeros(graph.node_count, dtype=bool)
    for term in robot.terms:
        if not type(term).__module__.startswith("rodnet.") or isinstance(term, Tendon):
            return bool(dx.any())
        if isinstance(term, Constraint):
            known[term.held_nodes(graph)] = True
            for node in (*term.walls(graph), *(joint.node for joint in term.pivots(graph))):
                known[graph.edges[(graph.edges == node).any(axis=1)]] = True
    for joint in graph.joints:
        known[graph.edges[(graph.edges == joint.node).any(axis=1)]] = True
    for body in graph.bodies:
        known[body.nodes] = True
    return bool(dx[known].any())


def make_columns(
    robot: Robot,
    parameters: Sequence[str] | Mapping[str, float],
    initial: Mapping[str, Mapping[str, Any]] | None,
    options: Mapping[str, Any],
    model: Model | None = None,
) -> list[Variation]:
    """All columns, parameters first; ``model`` is that of the robot, if there is one already.

    Raises
    ------
    ParameterError
        If there are none, or one is given twice.
    """
    if isinstance(parameters, str):
        parameters = [parameters]
    scales = dict(parameters) if isinstance(parameters, Mapping) else dict.fromkeys(parameters)
    if not isinstance(parameters, Mapping) and len(scales) < len(parameters):
        twice = next(p for p in parameters if list(parameters).count(p) > 1)
        raise ParameterError(f"the parameter '{twice}' is given twice")
    common = sorted(set(scales) & set(initial or {}))
    if common:
        raise ParameterError(f"'{common[0]}' names a parameter and a change of the initial state")
    if not scales and not initial:
        raise ParameterError(
            "there is nothing to take sensitivities by; give parameters=['tail*.E', ...] or initial={...}"
        )
    columns = [by_parameter(robot, path, scale, options) for path, scale in scales.items()]
    if not initial:
        return columns
    bound = (Model(robot) if model is None else model).bound
    remembers = any(b.memory is not None and not isinstance(b, _BoundActuator) for b in bound)
    return columns + [by_start(robot, n, change, options, remembers) for n, change in initial.items()]
