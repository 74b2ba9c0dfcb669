"""Trajectories: what a run recorded, its views, and saving and loading."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import OutputError
from rodnet.names import Named
from rodnet.observer import Observer
from rodnet.solve.steppers import Pace, State
from rodnet.storage import TrajectoryFile, check_free, check_writable, graph_attributes, read, unstacked

if TYPE_CHECKING:
    from rodnet.diagnostics import Internal, Reaction
    from rodnet.robot import Robot


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
        self.rods = Named(
            {
                r["name"]: RodView(
                    r["name"],
                    r["kind"],
                    np.array(r["nodes"]),
                    np.array(r["edges"]),
                    np.array(r["radius"], dtype=float),
                )
                for r in graph["rods"]
            },
            what="rod",
        )
        self.status: str = self.header.get("status", "unfinished")
        self.events: dict[str, list[float]] = Named(self.header.get("events", {}), what="event")
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

    @property
    def rates(self) -> np.ndarray:
        """Rates of all degrees of freedom [m/s, rad/s], shape (T, D)."""
        return self._arrays["state/rate"]

    @property
    def accelerations(self) -> np.ndarray:
        """Accelerations of all degrees of freedom [m/s^2, rad/s^2], shape (T, D)."""
        return self._arrays["state/acceleration"]

    def state(self, k: int = -1) -> State:
        """Return the k-th recorded state, for `Simulation.restore`."""
        a = self._arrays
        if "state/dof" not in a:
            raise OutputError("this trajectory file holds no states to restart from")
        memories = tuple(self._memory(i, k) for i in range(self.header["terms"]))
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

    def view(self, k: int = -1) -> Observer:
        """Return the k-th recorded state as sensors see it; needs the robot."""
        replay = self._replay
        return Observer(replay.model, self.state(k), replay.traj.robot.sensors)

    def _memory(self, i: int, k: int) -> np.ndarray | None:
        """Memory of the i-th term at the k-th state; None without memory."""
        if f"state/field{i}" in self._arrays:
            return unstacked(self._arrays[f"state/field{i}"][k])
        return self._arrays[f"state/memory{i}"][k].copy() if f"state/memory{i}" in self._arrays else None

    def medium(self, name: str, k: int = -1) -> tuple[np.ndarray, np.ndarray]:
        """Cells that a law with ``memory_frame = "medium"`` has touched by the k-th state.

        Returns
        -------
        x : ndarray, shape (c, 3)
            Their middles [m].
        memory : ndarray, shape (c, memory_size)
            What they remember.
        """
        from rodnet.terms.drag.medium import cells_of

        if self.robot is None:
            raise OutputError("this needs the robot: load the file with Trajectory.load(path, robot)")
        fields = {t.name: i for i, t in enumerate(self.robot.terms) if f"state/field{i}" in self._arrays}
        if name not in fields:
            known = ", ".join(map(repr, fields)) or "no term's"
            raise OutputError(f"'{name}' has no memory that the medium holds; that is {known}")
        memory = self._memory(fields[name], k)
        assert memory is not None
        return cells_of(memory, getattr(self.robot.terms[fields[name]], "cell"))  # noqa: B009

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
        found = stored if stored and self.robot is None else getattr(self._replay.balance, name)
        return Named(found, what="term")

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
        return Named(self._replay.balance.reactions, what="constraint")

    def term_forces(self, name: str, frames: Any = slice(None)) -> np.ndarray:
        """Forces of one term on the nodes, shape (T, N, 3) [N].

        Parameters
        ----------
        name : str
            The term.
        frames : int, slice or array of int, optional
            The states to evaluate, all by default: what is taken of the time axis.
        """
        return self._replay.term_forces(name, frames)

    def at(self, selector: str) -> np.ndarray:
        """Position over time of a node or station, e.g. ``"tail0@50%"``, shape (T, 3) [m]."""
        if self.robot is None:
            raise OutputError("selectors need the robot: load the file with Trajectory.load(path, robot)")
        edge, fraction = self.robot.graph.station(selector)
        i, j = self.edges[edge]
        return (1.0 - fraction) * self.x[:, i] + fraction * self.x[:, j]

    def joint_angle(self, at: str) -> np.ndarray:
        """Angle of a hinge over time [rad], shape (T,), whole turns included; zero as drawn.

        Positive where the second body is turned against the first by the right hand about the axis. Of
        a hinge with more bodies: shape (T, n), each against the first.

        Raises
        ------
        GraphError
            If there is no hinge at that node.
        """
        if self.robot is None:
            raise OutputError("joints need the robot: load the file with Trajectory.load(path, robot)")
        from rodnet.solve.joint_frames import hinge_angles

        a = self._arrays
        return hinge_angles(self._replay.model, at, a["state/dof"], a["state/turns"])

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
            If it cannot be written, or another process is writing it.
        """
        path = check_writable(path)
        check_free(path)
        partial = path.with_name(path.name + ".part")
        file = TrajectoryFile(partial, self.header, append=False)
        try:
            file.append({k: v for k, v in self._arrays.items() if ":" not in k})
            finish_file(file, self)
        except BaseException:
            file.close()
            partial.unlink(missing_ok=True)
            raise
        file.close()
        os.replace(partial, path)
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
        if robot is not None:
            mine = {"graph": graph_attributes(robot.graph), "terms": len(robot.terms)}
            for what, value in mine.items():
                if what in header and header[what] != value:
                    raise OutputError(
                        f"'{path}' is of a robot with another {what.rstrip('s')}: not the same robot"
                    )
        return traj


def finish_file(file: TrajectoryFile, traj: Trajectory) -> None:
    """Add what a finished run implies to its file: energies, powers and statistics."""
    if traj.robot is not None:
        for label, unit in (("energies", "J"), ("powers", "W")):
            for name, values in getattr(traj, label).items():
                file.put(f"{label}:{name}", ("time",), values, unit)
    file.set(status=traj.status, events=traj.events, stats=traj.stats)
