"""Forces on the body without a law, hats over body and time, and what small ones change in a run."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from rodnet.errors import DerivativeError, RodnetError
from rodnet.graph.rod_graph import RodGraph
from rodnet.inference.comparison import Comparison
from rodnet.inference.packing import unpack_trial
from rodnet.inference.shots import Shots, why
from rodnet.solve.model import Model
from rodnet.tangent.differences import Differences
from rodnet.tangent.fast import Fast
from rodnet.tangent.follow import Tangent
from rodnet.tangent.state import StateTangent, zero
from rodnet.tangent.twin import Twin
from rodnet.tangent.variation import Variation

if TYPE_CHECKING:
    from rodnet.simulation import Simulation
    from rodnet.solve.watch import Stage

ALONG, TIMES = 12, 6  # hats along all of the body, and in the time of a trial


@dataclass(frozen=True)
class Hats:
    """Piecewise linear functions over a body and time.

    Attributes
    ----------
    rods : tuple of str
        The rod of each hat over the body.
    places : tuple of float
        Where it is one: fraction of the rod's length.
    times : tuple of float
        Where each hat over time is one [s].
    """

    rods: tuple[str, ...]
    places: tuple[float, ...]
    times: tuple[float, ...]

    @classmethod
    def over(cls, graph: RodGraph, duration: float, along: int = ALONG, times: int = TIMES) -> Hats:
        """Share hats out among the rods by their lengths, one at least on each; no more than a rod has edges."""
        total = sum(rod.length for rod in graph.rods.values())
        rods: list[str] = []
        places: list[float] = []
        for rod in graph.rods.values():
            count = max(1, min(round(along * rod.length / total), len(rod.edges)))
            count = 1 if rod.kind == "rigid" else count
            rods += [rod.name] * count
            places += np.linspace(0.0, 1.0, count).tolist() if count > 1 else [0.5]
        return cls(tuple(rods), tuple(places), tuple(np.linspace(0.0, duration, times).tolist()))

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of hats over the body, of hats over time, and of axes."""
        return len(self.rods), len(self.times), 3

    @property
    def count(self) -> int:
        """Number of strengths: of each hat over body and time, along each axis."""
        return int(np.prod(self.shape))

    def weights(self, graph: RodGraph) -> np.ndarray:
        """Force on each node [N] of one newton per metre in each hat over the body, shape (N, B)."""
        found = np.zeros((graph.node_count, len(self.rods)))
        for name in dict.fromkeys(self.rods):
            rod = graph.rods[name]
            columns = [k for k, one in enumerate(self.rods) if one == name]
            knots = [self.places[k] for k in columns]
            lengths = graph.rest_length[rod.edges]
            s = np.concatenate([[0.0], np.cumsum(lengths)]) / lengths.sum()
            share = 0.5 * (np.append(lengths, 0.0) + np.insert(lengths, 0, 0.0))
            for k, hat in zip(columns, np.eye(len(knots)), strict=True):
                value = np.interp(s, knots, hat) if len(knots) > 1 else np.ones(len(s))
                np.add.at(found[:, k], rod.nodes, value * share)
        return found

    def at(self, t: float) -> np.ndarray:
        """Values of the hats over time, shape (T,)."""
        return np.array([np.interp(t, self.times, hat) for hat in np.eye(len(self.times))])


def force_response(packed: bytes, values: dict[str, float], hats: Hats) -> np.ndarray | str:
    """Derivative of a trial's prewhitened residual by the strength of each hat, in any process.

    Parameters
    ----------
    packed : bytes
        The trial (`rodnet.inference.comparison.pack_trial`).
    values : dict
        Of its parameters, by path.
    hats : Hats
        Of forces per length.

    Returns
    -------
    ndarray, shape (n, B T 3)
        Per newton per metre; or why there is none.
    """
    trial = unpack_trial(packed)
    try:
        return _response(trial, values, hats)
    except RodnetError as error:
        return why(error)
    except DerivativeError as error:
        return str(error)


def _response(trial: Comparison, values: dict[str, float], hats: Hats) -> np.ndarray:
    shots = Shots(trial, values, {})
    names = [f"residual_force[{k}]" for k in range(hats.count)]
    columns = [Variation(name, "N/m", 0.0, (), acts=False) for name in names]
    shots.move(names, columns, zero(shots.sim.model, shots.sim.state, len(names)), partial(_Pushed, hats))
    shot = shots.shoot(0)
    return trial._whiten(shot.predicted, shot.slopes, slice(None), None)[0][:, 1:]


class _Pushed(Tangent):
    """The tangent of a simulation by forces that are not there."""

    def __init__(self, hats: Hats, sim: Simulation, columns: list[Variation], initial: StateTangent) -> None:
        super().__init__(sim, columns, initial)
        self._push = push = _Push(hats, self.model)
        if self.fast is not None:
            self.fast = _PushedFast(push, self.model, self.newton, columns)
            self._sort_memories()

    @cached_property
    def differences(self) -> Differences:
        """What finds the rest by whole evaluations."""
        return _PushedDifferences(self._push, Twin(Model(self.sim.robot)), self.columns)


class _Push:
    """Forces of all hats on the degrees of freedom."""

    def __init__(self, hats: Hats, model: Model) -> None:
        self.hats = hats
        self.weights = hats.weights(model.graph)
        node, body = np.nonzero(self.weights)
        self.value = np.repeat(self.weights[node, body], 3)
        axis = np.tile(np.arange(3), len(node))
        self.rows = 3 * np.repeat(node, 3) + axis
        self.columns = np.repeat(body, 3) * len(hats.times) * 3 + axis

    def active(self, t: float) -> list[tuple[int, float]]:
        """Hats over time that are not zero, and their values."""
        values = self.hats.at(t)
        return [(int(k), float(values[k])) for k in np.flatnonzero(values)]

    def subtract(self, t: float, out: np.ndarray) -> None:
        """Take the forces from the residual's change, shape (dof_count, k)."""
        for k, value in self.active(t):
            out[self.rows, self.columns + 3 * k] -= value * self.value


class _PushedFast(Fast):
    def __init__(self, push: _Push, *args: object) -> None:
        self.push = push
        super().__init__(*args)  # type: ignore[arg-type]

    def _change(self, stage: Stage, tangent: StateTangent, out: np.ndarray) -> None:
        super()._change(stage, tangent, out)
        self.push.subtract(stage.now, out)


class _PushedDifferences(Differences):
    """Likewise where whole evaluations are needed; what rigid bodies carry feels no force then."""

    def __init__(self, push: _Push, twin: Twin, columns: list[Variation]) -> None:
        super().__init__(twin, columns)
        self.push = push

    def residual(
        self, stage: Stage, tangent, done, q, sensors, which, steps, near, here
    ) -> tuple[np.ndarray, np.ndarray]:
        model = self.twin.model
        out, held = super().residual(stage, tangent, done, q, sensors, which, steps, near, here)
        if not all(near):
            return out, held  # the compiled way adds the forces
        change = np.zeros((model.dof_count, len(self.columns)))
        self.push.subtract(stage.now, change)
        free = change[model.free]
        for b in model.adding:
            if b.replacing:
                free[b.rows] = 0.0
        return out + free[:, which], held
