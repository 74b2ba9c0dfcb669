"""Trajectories: what a run recorded, its views, and saving and loading."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import OutputError
from rodnet.solve.steppers import Pace, State
from rodnet.storage import FORMAT, TrajectoryFile, check_writable, graph_attributes, read

if TYPE_CHECKING:
    from rodnet.diagnostics import Internal, Reaction
    from rodnet.robot import Robot
    from rodnet.simulation import Simulation

CHUNK = 256  # frames written at once,
PAUSE = 2.0  # or what has come together in so many seconds


@dataclass(frozen=True)
class RodView:
    """One rod of a trajectory, as far as pictures need it.

    Attributes
    ----------
    name, kind : str
        Name, and ``"rod"`` or ``"rigid"``.
    nodes, edges : ndarray
        Indices from start to end.
    radius : ndarray, shape (edges,)
        Outer radii [m].
    """

    name: str
    kind: str
    nodes: np.ndarray
    edges: np.ndarray
    radius: np.ndarray


class Trajectory:
    """The recorded states of a run.

    Attributes
    ----------
    t : ndarray, shape (T,)
        Times [s].
    x, v : ndarray, shape (T, N, 3)
        Node positions [m] and velocities [m/s].
    theta, w : ndarray, shape (T, E)
        Twist angles [rad], full turns included, and their rates [rad/s].
    edges : ndarray, shape (E, 2)
        Node indices of the edges.
    rods : dict
        `RodView` by name.
    robot : Robot or None
        The robot; None if the file was loaded without it.
    status : str
        "finished", "stopped", "interrupted" or "failed".
    events : dict
        Times of each event [s].
    stats : dict
        Totals: ``steps``, ``iterations``, ``substeps``, ``seconds``, ``factorizations``, ``fallbacks``.
    path : Path or None
        The file it was written to.
    """

    def __init__(
        self,
        arrays: Mapping[str, np.ndarray],
        header: Mapping[str, Any],
        robot: Robot | None = None,
        path: Path | None = None,
    ) -> None:
        self._arrays, self.header, self.robot, self.path = dict(arrays), dict(header), robot, path
        self.t = self._arrays["time"]
        self.x, self.v = self._arrays["position"], self._arrays["velocity"]
        self.theta, self.w = self._arrays["twist"], self._arrays["twist_rate"]
        graph = self.header["graph"]
        self.edges = np.array(graph["edges"], dtype=np.int64)
        self.rods = {
            r["name"]: RodView(
                r["name"],
                r["kind"],
                np.array(r["nodes"]),
                np.array(r["edges"]),
                np.array(r["radius"], dtype=float),
            )
            for r in graph["rods"]
        }
        self.status: str = self.header.get("status", "unfinished")
        self.events: dict[str, list[float]] = self.header.get("events", {})
        self.stats: dict[str, float] = self.header.get("stats", {})
        self.dt: float = self.header["dt"]

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        return f"Trajectory({len(self)} states, t = {self.t[0]:g} to {self.t[-1]:g} s, {self.status})"

    @property
    def directors(self) -> np.ndarray:
        """First reference directors of the edges, shape (T, E, 3)."""
        return self._arrays["state/director"][:, : len(self.edges)]

    def state(self, k: int = -1) -> State:
        """Return the k-th recorded state, for `Simulation.restore`."""
        a = self._arrays
        if "state/dof" not in a:
            raise OutputError("this trajectory file holds no states to restart from")
        memories = tuple(
            a[f"state/memory{i}"][k].copy() if f"state/memory{i}" in a else None
            for i in range(self.header["terms"])
        )
        names = ("dof", "rate", "acceleration", "algorithmic", "tangent", "director", "tau", "turns")
        q, v, acceleration, acc, tangents, directors, tau, turns = (a[f"state/{n}"][k].copy() for n in names)
        index, pace = int(a["state/index"][k]), None
        if "state/pace_step" in a:
            step, *rest = (a[f"state/pace_{name}"][k].copy() for name in Pace._fields)
            pace = Pace(float(step), *rest)
        return State(
            float(self.t[k]),
            index,
            q,
            v,
            acceleration,
            acc,
            tangents,
            directors,
            tau,
            memories,
            turns,
            pace,
        )

    # -- derived quantities -----------------------------------------------------------------
    @cached_property
    def _replay(self) -> Any:
        from rodnet.diagnostics import Replay

        if self.robot is None:
            raise OutputError(
                "this needs the robot's terms: load the file with Trajectory.load(path, robot), "
                "where robot is built by the same code as for the run"
            )
        return Replay(self)

    def _table(self, name: str) -> dict[str, np.ndarray]:
        stored = {k.split(":", 1)[1]: v for k, v in self._arrays.items() if k.startswith(f"{name}:")}
        return stored if stored and self.robot is None else getattr(self._replay, name)

    @property
    def energies(self) -> dict[str, np.ndarray]:
        """Stored energy by term, and ``"kinetic"`` [J], each of shape (T,)."""
        return self._table("energies")

    @property
    def powers(self) -> dict[str, np.ndarray]:
        """Power put in by term [W], shape (T,); motors positive, drag negative.

        ``"elastic"`` is what the stored energy gives back, minus its rate, and ``"kinetic"`` the rate of
        kinetic energy: the sum of the others equals it to the solver's tolerance.
        """
        return self._table("powers")

    @property
    def internal(self) -> Internal:
        """Internal forces and moments along every rod (see `rodnet.diagnostics.Internal`)."""
        return self._replay.internal

    @property
    def reactions(self) -> dict[str, Reaction]:
        """Force and moment that each constraint exerts on the robot, by its name."""
        return self._replay.reactions

    def term_forces(self, name: str) -> np.ndarray:
        """Forces of one term on the nodes, shape (T, N, 3) [N]."""
        return self._replay.term_forces(name)

    def at(self, selector: str) -> np.ndarray:
        """Position over time of a node or station, e.g. ``"tail0@50%"``, shape (T, 3) [m]."""
        if self.robot is None:
            raise OutputError("selectors need the robot: load the file with Trajectory.load(path, robot)")
        edge, fraction = self.robot.graph.station(selector)
        i, j = self.edges[edge]
        return (1.0 - fraction) * self.x[:, i] + fraction * self.x[:, j]

    # -- formats ------------------------------------------------------------------------------
    def to_xarray(self) -> Any:
        """Return an `xarray.Dataset`: position, velocity, twist, twist_rate, energies and powers, with units."""
        import xarray as xr

        def var(dims: tuple[str, ...], values: np.ndarray, unit: str) -> Any:
            return xr.Variable(dims, values, {"units": unit})

        data = {
            "position": var(("time", "node", "axis"), self.x, "m"),
            "velocity": var(("time", "node", "axis"), self.v, "m/s"),
            "twist": var(("time", "edge"), self.theta, "rad"),
            "twist_rate": var(("time", "edge"), self.w, "rad/s"),
            "edge_node": var(("edge", "end"), self.edges, "1"),
        }
        if self.robot is not None or any(k.startswith("energies:") for k in self._arrays):
            for label, table, unit in (("energy", self.energies, "J"), ("power", self.powers, "W")):
                names = list(table)
                data[label] = var(
                    ("time", f"{label}_term"), np.stack([table[n] for n in names], axis=1), unit
                )
                data[f"{label}_term"] = xr.Variable((f"{label}_term",), names)
        coords = {"time": var(("time",), self.t, "s"), "axis": ["x", "y", "z"]}
        rod_of_node = np.full(self.x.shape[1], "", dtype=object)
        for rod in self.rods.values():
            for n in rod.nodes:
                rod_of_node[n] = rod_of_node[n] or rod.name
        coords["rod"] = ("node", rod_of_node.astype(str))
        return xr.Dataset(
            data, coords, {"status": self.status, "dt": self.dt, "stepper": self.header.get("stepper", "")}
        )

    def save(self, path: str | Path) -> Path:
        """Write everything to a NetCDF-4 file, energies and powers included.

        Raises
        ------
        OutputError
            If it cannot be written.
        """
        path = check_writable(path)
        file = TrajectoryFile(path, self.header, append=False)
        try:
            file.append({k: v for k, v in self._arrays.items() if ":" not in k})
            _finish_file(file, self)
        finally:
            file.close()
        self.path = path
        return path

    @classmethod
    def load(cls, path: str | Path, robot: Robot | None = None) -> Trajectory:
        """Read a trajectory file.

        Parameters
        ----------
        path : path
            The file.
        robot : Robot, optional
            The robot that made it, built by the same code; needed for restart, internal forces,
            reactions and selectors.

        Raises
        ------
        OutputError
            If the file is missing, cut off, of another kind, or made by another robot.
        """
        header, arrays = read(path)
        traj = cls(arrays, header, robot, Path(path))
        if robot is not None and robot.graph.node_count != traj.x.shape[1]:
            raise OutputError(
                f"'{path}' holds {traj.x.shape[1]} nodes, the robot has {robot.graph.node_count}: not the same robot"
            )
        return traj


def _finish_file(file: TrajectoryFile, traj: Trajectory) -> None:
    if traj.robot is not None:
        for label, unit in (("energies", "J"), ("powers", "W")):
            for name, values in getattr(traj, label).items():
                file.put(f"{label}:{name}", ("time",), values, unit)
    file.set(status=traj.status, events=traj.events, stats=traj.stats)


class Recorder:
    """Collects the states of a run, and writes them to a file in chunks."""

    def __init__(self, sim: Simulation, out: str | Path | None, append: bool = False) -> None:
        import time

        self.sim = sim
        self.path = check_writable(out) if out is not None else None
        self.resumed = append and self.path is not None and self.path.exists()
        self._clock, self._started = time.perf_counter, time.perf_counter()
        self._written = self._started
        self.header: dict[str, Any] = {
            "format": FORMAT,
            "dt": sim.dt,
            "stepper": sim.stepper.name,
            "terms": len(sim.model.bound),
            "graph": graph_attributes(sim.model.graph),
            "status": "unfinished",
        }
        self._frames: list[State] = []
        self._chunks: list[dict[str, np.ndarray]] = []
        self.steps = self.iterations = self.substeps = 0
        self.last_index = -1
        self._before: dict[str, Any] = {}
        if self.resumed:
            self._before, arrays = read(self.path)  # type: ignore[arg-type]
            for key in ("graph", "terms", "dt", "stepper"):
                if self._before.get(key) != self.header[key]:
                    raise OutputError(
                        f"cannot continue '{self.path}': its {key} is not this simulation's; take the robot, dt "
                        "and stepper of the first run, or write to another file"
                    )
            self._chunks.append({k: v for k, v in arrays.items() if "time" in k or ":" not in k})
            self.last_index = int(arrays["state/index"][-1])
            if self.last_index != sim.state.index:
                raise OutputError(
                    f"cannot continue '{self.path}': it ends at step {self.last_index}, "
                    f"the simulation is at {sim.state.index}"
                )
        self._file = None if self.path is None else TrajectoryFile(self.path, self.header, self.resumed)

    def count(self, iterations: int, substeps: int) -> None:
        """Add to the statistics."""
        self.steps += 1
        self.iterations += iterations
        self.substeps += substeps

    def add(self, state: State) -> None:
        """Record a state."""
        self._frames.append(state)
        self.last_index = state.index
        late = self._clock() - self._written > PAUSE
        if len(self._frames) >= CHUNK or late or not self._chunks:  # the first at once: a readable file
            self._flush()

    def _flush(self) -> None:
        if not self._frames:
            return
        m, frames = self.sim.model, self._frames
        n, e, k = m.graph.node_count, m.graph.edge_count, m.twist0
        stack = lambda name: np.stack([getattr(s, name) for s in frames])  # noqa: E731
        q, v, turns = stack("q"), stack("v"), stack("turns")
        chunk = {
            "time": np.array([s.t for s in frames]),
            "position": q[:, : 3 * n].reshape(-1, n, 3),
            "velocity": v[:, : 3 * n].reshape(-1, n, 3),
            "twist": q[:, k : k + e] + 2.0 * np.pi * turns[:, :e],
            "twist_rate": v[:, k : k + e],
            "state/index": np.array([s.index for s in frames], dtype=np.int64),
            "state/dof": q,
            "state/rate": v,
            "state/acceleration": stack("a"),
            "state/algorithmic": stack("acc"),
            "state/tangent": stack("tangents"),
            "state/director": stack("directors"),
            "state/tau": stack("tau"),
            "state/turns": turns,
        }
        if self.sim.adaptive is not None:
            paces = [s.pace or self.sim.adaptive.start(s, self.sim.dt) for s in frames]
            for i, name in enumerate(Pace._fields):
                chunk[f"state/pace_{name}"] = np.stack([np.asarray(p[i]) for p in paces])
        for i, memory in enumerate(frames[0].memories):
            if memory is not None:
                chunk[f"state/memory{i}"] = np.stack([np.asarray(s.memories[i]) for s in frames])
        if self._file is not None:  # first: if Ctrl-C comes in between, the same frames are written again
            self._file.append(chunk)
        self._chunks.append(chunk)
        self._frames, self._written = [], self._clock()

    def finish(self, status: str, events: dict[str, list[float]]) -> Trajectory:
        """Write what is left and return the trajectory."""
        self._flush()
        arrays = {name: np.concatenate([c[name] for c in self._chunks]) for name in self._chunks[-1]}
        solver = self.sim.model.solver
        stats = {
            "steps": self.steps,
            "iterations": self.iterations,
            "substeps": self.substeps,
            "seconds": self._clock() - self._started,
            "factorizations": solver.factorizations,
            "fallbacks": solver.fallbacks,
        }
        for name, value in self._before.get("stats", {}).items():  # of the run that this one continues
            stats[name] = stats.get(name, 0) + value
        for name, times in self._before.get("events", {}).items():
            events[name] = [*times, *events.get(name, [])]
        self.header.update(status=status, events=events, stats=stats)
        traj = Trajectory(arrays, self.header, self.sim.robot, self.path)
        if self._file is not None:
            _finish_file(self._file, traj)
            self._file.close()
        return traj
