"""Natural curvature that an actuator drives, bound to the springs of its rods."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import TermError
from rodnet.terms.actuators import Actuator, _BoundActuator
from rodnet.terms.base import BoundTerm, Term
from rodnet.terms.spring_moments import runs_against

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model


class BoundNatural(BoundTerm):
    """Natural strains of springs that do not change in time.

    Parameters
    ----------
    term : Term
        Whose they are.
    model : Model
        The model.
    springs : ndarray of int, shape (n,)
        The springs.
    angles : ndarray, shape (n, 3)
        What is added to their natural (kappa1, kappa2, tau) [rad].
    """

    def __init__(self, term: Term, model: Model, springs: np.ndarray, angles: np.ndarray) -> None:
        super().__init__(term)
        self.springs = springs
        self.offset = angles * np.where(runs_against(model, springs)[:, None], [1.0, -1.0, 1.0], 1.0)
        model.eps0[springs] += self.offset


class _BoundCurvature(_BoundActuator):
    """Natural curvature of springs, as an offset of their strains."""

    def __init__(self, term: Actuator, model: Model) -> None:
        self.springs = model.springs_on(term.on)
        super().__init__(term, None)
        graph = model.graph
        start = np.zeros(model.edge_count)
        for rod in graph.rods.values():
            start[rod.edges] = np.cumsum(graph.rest_length[rod.edges])
        first, second, forward = (a[self.springs] for a in (model.edge1, model.edge2, model.sign2 > 0))
        # walls stand before a rod's start or after its end; there the stencil runs against the rod
        wall = first >= graph.edge_count
        self.s = start[np.where(wall, second, first)]
        self.s -= np.where(wall & forward, graph.rest_length[second], 0.0)
        self.turn = np.stack([np.ones(len(wall)), np.where(wall & ~forward, -1.0, 1.0)], axis=1)
        self.length = model.spring_length[self.springs]
        self.offset, self.rate = np.zeros((2, len(self.springs), 2))  # [rad] and [rad/s]
        self.dt = 0.0
        self._set(model, 0.0, model.no_sensors)
        self.memory = self.next_memory(None)

    def _set(self, model: Model, t: float, sensors: Any) -> None:
        self._apply(model, self._commanded(t, sensors))

    def _commanded(self, t: float, sensors: Any) -> np.ndarray:
        """Offsets of the strains that the commanded curvatures amount to [rad], shape (n, 2)."""
        kappa = np.asarray(self.actuator.command(t, _with_stations(sensors, self.s), self.p), dtype=float)
        if kappa.shape not in ((2,), (len(self.springs), 2)) or not np.all(np.isfinite(kappa)):
            raise TermError(
                f"actuator '{self.actuator.name}': command must return finite curvatures of shape (2,) or "
                f"({len(self.springs)}, 2) [1/m], got shape {kappa.shape}"
            )
        return np.broadcast_to(kappa, (len(self.springs), 2)) * self.length[:, None] * self.turn

    def _apply(self, model: Model, offset: np.ndarray) -> None:
        self.offset = offset
        waves = [b for b in getattr(model, "bound", ()) if isinstance(b, _BoundCurvature)]
        if not waves:  # the model is still binding its terms, one after the other
            model.eps0[self.springs, :2] += offset
            return
        model.eps0[:, :2] = 0.0  # summed afresh: differences would add up round-off, and a restart differ
        for b in model.bound:
            if isinstance(b, _BoundCurvature | BoundNatural):
                model.eps0[b.springs, :2] += b.offset[:, :2]

    def begin_step(self, model: Model, t: float, dt: float, sensors: Any, inputs: dict[str, Any]) -> None:
        self._take(inputs)
        self._set(model, t, sensors)
        self.dt, self.rate = dt, self._end_rate(model, dt)

    def _end_rate(self, model: Model, dt: float) -> np.ndarray:
        """Rate at the end of a step [rad/s] as the stepper has it: the mean, or of second order a parabola's."""
        if self.at_rest:
            return np.zeros_like(self.offset)
        old, _, before, last = self.memory  # type: ignore[misc]
        mean = (self.offset - old) / dt
        if model.order < 2:
            return mean
        return np.where(
            last > 0.0, mean + dt / (dt + last) * (mean - (old - before) / np.maximum(last, 1e-300)), mean
        )

    def next_memory(self, ev: Evaluation | None) -> np.ndarray:
        before = self.offset if self.memory is None else self.memory[0]
        return np.stack([self.offset, self.rate, before, np.full_like(self.offset, self.dt)])

    def accept(self, model: Model, memory: np.ndarray) -> None:
        self.memory = memory

    def restore(self, model: Model, memory: np.ndarray) -> None:
        super().restore(model, memory)
        self._apply(model, memory[0].copy())
        self.rate = memory[1].copy()

    def power(self, ev: Evaluation) -> float:
        """Power that the actuator puts in: moments times the rates of the natural curvatures [W]."""
        return -float(np.sum(ev.stress[self.springs, :2] * self.rate))


def _with_stations(sensors: Any, s: np.ndarray) -> Any:
    """Sensor readings and the arc length of the springs."""
    out = copy.copy(sensors) if isinstance(sensors, dict) else dict(sensors)
    out["s"] = s
    return out
