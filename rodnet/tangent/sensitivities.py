"""Sensitivities of a run: its trajectory, and the derivatives of everything in it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from rodnet.observer import Observer
from rodnet.recordings.observation import Observation
from rodnet.robot import Robot
from rodnet.simulation import Simulation
from rodnet.solve.model import Model
from rodnet.tangent.columns import make_columns
from rodnet.tangent.follow import Tangent
from rodnet.tangent.instruments import as_recorded, functions_of, split
from rodnet.tangent.state import StateTangent, moved
from rodnet.tangent.variation import Variation
from rodnet.trajectory import Trajectory

STEP = 1e-5  # of differences of observations, against edges and radians


class Sensitivities:
    """A trajectory and its derivatives by parameters, the last axis of every array.

    Attributes
    ----------
    trajectory : Trajectory
        The run.
    names, units : tuple of str
        Of the parameters; changes of the initial state count in multiples of themselves.
    values : ndarray, shape (k,)
        Of the parameters.
    t : ndarray, shape (T,)
        Times [s].
    x, v : ndarray, shape (T, N, 3, k)
        Derivatives of node positions and velocities.
    theta, w : ndarray, shape (T, E, k)
        Derivatives of twist angles and their rates.
    observed, outputs : dict
        What was observed, shapes (T, ...), and its derivatives, shapes (T, ..., k), by name.
    final : StateTangent
        Derivative of the last state, for `Tangent`.
    """

    def __init__(
        self,
        trajectory: Trajectory,
        columns: list[Any],
        motion: list[tuple[np.ndarray, np.ndarray]],
        observed: Mapping[str, np.ndarray],
        outputs: Mapping[str, np.ndarray],
        final: StateTangent,
        twist0: int,
    ) -> None:
        self.trajectory, self.t = trajectory, trajectory.t
        self.names = tuple(c.name for c in columns)
        self.units = tuple(c.unit for c in columns)
        self.values = np.array([c.value for c in columns])
        nodes, edges, k = trajectory.x.shape[1], len(trajectory.edges), len(columns)
        shape = len(motion), nodes, 3, k
        self.x = np.stack([dq[: 3 * nodes] for dq, _ in motion]).reshape(shape)
        self.v = np.stack([dv[: 3 * nodes] for _, dv in motion]).reshape(shape)
        self.theta = np.stack([dq[twist0 : twist0 + edges] for dq, _ in motion])
        self.w = np.stack([dv[twist0 : twist0 + edges] for _, dv in motion])
        self.observed, self.outputs, self.final = dict(observed), dict(outputs), final

    def __repr__(self) -> str:
        return f"Sensitivities({len(self.t)} states by {', '.join(self.names)})"

    def to_xarray(self) -> Any:
        """Return an `xarray.Dataset`: derivatives ``d_position`` and so on, over ``parameter``, with units.

        The unit of a derivative is that of the quantity over that of the parameter, which is the coordinate
        ``parameter_unit``.
        """
        base = self.trajectory.to_xarray()
        data: dict[str, Any] = {
            "d_position": (("time", "node", "axis", "parameter"), self.x, {"units": "m per parameter"}),
            "d_velocity": (("time", "node", "axis", "parameter"), self.v, {"units": "m/s per parameter"}),
            "d_twist": (("time", "edge", "parameter"), self.theta, {"units": "rad per parameter"}),
            "d_twist_rate": (("time", "edge", "parameter"), self.w, {"units": "rad/s per parameter"}),
        }
        for name, values in self.outputs.items():
            dims = tuple(f"{name}_{i}" for i in range(values.ndim - 2))
            data[name] = (("time", *dims), self.observed[name], {})
            data[f"d_{name}"] = (("time", *dims, "parameter"), values, {})
        coords = {
            "parameter": list(self.names),
            "parameter_unit": ("parameter", list(self.units)),
            "parameter_value": ("parameter", self.values),
        }
        return base.assign(data).assign_coords(coords)


def sensitivities(
    robot: Robot,
    duration: float,
    *,
    parameters: Sequence[str] | Mapping[str, float] = (),
    initial: Mapping[str, Mapping[str, Any]] | None = None,
    observe: Mapping[str, Any] | Sequence[Observation] | None = None,
    save_every: int = 1,
    progress: bool = False,
    **options: Any,
) -> Sensitivities:
    """Run a robot and differentiate the whole computed motion by parameters and by its initial state.

    The derivative is that of the numbers that the stepper computes, not of the differential equation: it
    agrees with differences of whole runs to the solver's tolerance (docs, theory: sensitivities).

    Parameters
    ----------
    robot : Robot
        What moves.
    duration : float
        Time to simulate [s].
    parameters : sequence of str, or mapping
        Paths of the robot's parameters, ``"drag.viscosity"``; a glob, ``"tail*.E"``, counts as one
        parameter; ``"drag.c[3]"`` is one value of an array. A mapping gives changes that are worth
        considering, which sets the scale for parameters that are zero.
    initial : mapping, optional
        Changes of the initial state by name: each a mapping with displacements ``"x"`` [m], velocities
        ``"v"`` [m/s], or both, of shape (N, 3), of the nodes; directors follow by parallel transport.
    observe : mapping or sequence, optional
        What is to be differentiated, too: functions of an `rodnet.Observer` by name, and instruments such as
        `rodnet.Markers`, whose readings are those of `rodnet.observe`. Parameters of instruments may be among the
        parameters, ``"markers.scale"``.
    save_every : int
        Keep every so many-th step.
    progress : bool
        Show a progress bar.
    **options
        Of `Simulation`: dt, stepper, velocity, spin, tolerance.

    Returns
    -------
    Sensitivities

    Raises
    ------
    ParameterError
        For an unknown path, or values that do not fit.
    ConvergenceError
        If a step fails.
    """
    functions = functions_of(observe)
    paths, eyes = split(parameters, functions)
    sim = Simulation(robot, **options)
    columns: list[Variation] = []
    if paths or initial or not eyes:
        columns = make_columns(robot, paths, initial, options, sim.model)  # type: ignore[arg-type]
    # in the order of the parameters, those of the robot first
    place = len(paths)
    columns[place:place] = [eye.variation for eye in eyes]
    motion: list[tuple[np.ndarray, np.ndarray]] = []  # what a medium remembers would be far more
    times: list[float] = []
    seen: dict[str, list[np.ndarray]] = {name: [] for name in functions}
    slopes: dict[str, list[np.ndarray]] = {name: [] for name in functions}

    def read_off(view: Observer) -> None:
        motion.append((tangent.current.q, tangent.current.v))
        times.append(view.state.t)
        for name, one in functions.items():
            function = one.read if isinstance(one, Observation) else one
            seen[name].append(np.asarray(function(view), dtype=float))
            slope = observed(sim.model, view, tangent.current, function, robot)
            for k, eye in enumerate(eyes, start=place):
                if eye.name == name:
                    slope[..., k] = eye.slope(view)
            slopes[name].append(slope)

    def keep(view: Observer) -> bool:
        if view.state.index % save_every == 0:
            read_off(view)
        return False

    with Tangent(sim, columns) as tangent:
        keep(sim.observe())
        trajectory = sim.run(duration, save_every=save_every, stop=keep, progress=progress)
        if len(motion) < len(trajectory):  # the last state is kept, whatever its number
            read_off(sim.observe())
        final = tangent.current
    read, outputs = ({n: np.stack(v) for n, v in found.items()} for found in (seen, slopes))
    for name, one in functions.items():
        if isinstance(one, Observation):
            late = [k for k, eye in enumerate(eyes, start=place) if eye.late and eye.name == name]
            read[name], outputs[name] = as_recorded(
                one, np.array(times), sim.dt, read[name], outputs[name], late
            )
    return Sensitivities(trajectory, columns, motion, read, outputs, final, sim.model.twist0)


def observed(
    model: Model, view: Observer, tangent: StateTangent, function: Callable[[Observer], Any], robot: Robot
) -> np.ndarray:
    """Derivative of a function of a state, shape (..., k), by differences of that function."""
    length = float(model.rest_length.min())
    columns = []
    for c in range(tangent.count):
        dq, dv = tangent.q[:, c], tangent.v[:, c]
        size = max(
            float(np.abs(dq[: model.twist0]).max()) / length,
            float(np.abs(dq[model.twist0 :]).max(initial=0.0)),
        )
        size = max(size, float(np.abs(dv).max()) / max(float(np.abs(view.state.v).max()), length))
        step = STEP / size if size > 0.0 else 1.0
        up, down = (
            np.asarray(
                function(Observer(model, moved(model, view.state, tangent, c, s * step), robot.sensors)),
                dtype=float,
            )
            for s in (1.0, -1.0)
        )
        columns.append((up - down) / (2.0 * step))
    return np.stack(columns, axis=-1)
