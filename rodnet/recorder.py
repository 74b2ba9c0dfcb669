"""Recording a run: states are collected, and written to a file as they come."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import OutputError
from rodnet.solve.steppers import Pace, State
from rodnet.storage import (
    FORMAT,
    TrajectoryFile,
    check_writable,
    graph_attributes,
    join,
    mend,
    read,
    stack_rows,
)
from rodnet.trajectory import Trajectory, finish_file

if TYPE_CHECKING:
    from rodnet.simulation import Simulation

CHUNK = 256  # frames written at once,
PAUSE = 2.0  # or what has come together in so many seconds


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
            "adaptive": int(sim.adaptive is not None),
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
            assert self.path is not None
            self._before, arrays = read(self.path)
            for key in ("graph", "terms", "dt", "stepper", "adaptive"):
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
            mend(self.path, self._before, arrays)
        self._file = None if self.path is None else TrajectoryFile(self.path, self.header, self.resumed)
        if self._file is not None and self.resumed:  # whatever it was before
            self._file.set(status="unfinished")

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
        for i, b in enumerate(m.bound):
            memories = [s.memories[i] for s in frames]
            if b.growing:
                chunk[f"state/field{i}"] = stack_rows(memories)
            elif memories[0] is not None:
                chunk[f"state/memory{i}"] = np.stack([np.asarray(a) for a in memories])
        if self._file is not None:  # first: if Ctrl-C comes in between, the same frames are written again
            self._file.append(chunk)
        self._chunks.append(chunk)
        self._frames, self._written = [], self._clock()

    def finish(self, status: str, events: dict[str, list[float]]) -> Trajectory:
        """Write what is left and return the trajectory."""
        self._flush()
        arrays = {name: join([c[name] for c in self._chunks]) for name in self._chunks[-1]}
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
            finish_file(self._file, traj)
            self._file.close()
        return traj
