"""A medium that is elastic for a while: Maxwell elements between a rod and the medium around it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import TermError
from rodnet.parameters import Parameter
from rodnet.terms.base import BoundTerm, Term

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model

STATE = 6  # of the memory of a node: stretch (3), and place at the end of the step (3)


class MaxwellMedium(Term):
    """Force per length -modulus z against a stretch z that the medium forgets: dz/dt = v - z/time.

    What moves to and fro faster than ``time`` meets a spring, what goes on slowly a viscosity of ``modulus * time``.
    Beside a viscous law it makes a Jeffreys medium: a polymer solution, mud, a gel. Along a step nodes move at a
    constant rate: second order. The stretch belongs to the rod's material points, and a run begins without any.

    Parameters
    ----------
    on : str or sequence of str
        The rods.
    modulus : float or Parameter
        Force per length and stretch [N/m^2].
    time : float or Parameter
        Relaxation time [s].

    Raises
    ------
    TermError
        If the parameters are arrays.
    """

    kind = "drag"
    default_name = "maxwell"
    source = "Maxwell 1867; Bird, Armstrong & Hassager 1987, Dynamics of Polymeric Liquids, sec. 5.2"
    claims: ClassVar[set[str]] = set()
    example: ClassVar[dict[str, float]] = {"modulus": 5.0, "time": 0.02}
    modulus = Parameter(0.0, unit="N/m^2", bounds=(0, None), null=0.0, doc="force per length and stretch")
    time = Parameter(1.0, unit="s", bounds=(1e-6, None), kind="shape", doc="relaxation time")

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the nodes of the edges that ``on`` names."""
        self.check_numbers()
        return _BoundMaxwell(self, model)


class _BoundMaxwell(BoundTerm):
    """The memory holds stretch and place at the last accepted state, those before its step, and the step's length."""

    def __init__(self, term: MaxwellMedium, model: Model) -> None:
        super().__init__(term)
        p, graph = term.values(), model.graph
        self.modulus, self.time = float(p.modulus), float(p.time)
        edges = graph.edge_indices(term.on)
        if not len(edges):
            raise TermError(f"MaxwellMedium: on={term.on} names no edge")
        length = np.bincount(graph.edges[edges].ravel(), np.repeat(0.5 * graph.rest_length[edges], 2))
        self.node = np.flatnonzero(length)
        self.length = length[self.node]
        self.past_dt: float | None = None  # of a recorded step that is evaluated again
        self.dofs = (3 * self.node[:, None] + np.arange(3)).astype(np.int32)
        self.stencils = [self.dofs]
        self._begin(model.x0[self.node])

    def begin(self, q: np.ndarray) -> None:
        self._begin(q[self.dofs])

    def _begin(self, x: np.ndarray) -> None:
        start = np.hstack([np.zeros_like(x), x])
        self.memory = np.hstack([start, start, np.ones((len(x), 1))])

    @property
    def constants(self) -> tuple[Any, ...]:
        """What the law depends on beside places, memory and time."""
        return self.modulus, self.time, self.length

    def rewind(self) -> None:
        assert self.memory is not None
        old = self.memory[:, STATE : 2 * STATE]
        self.past_dt = float(self.memory[0, -1])
        self.memory = np.hstack([old, old, self.memory[:, -1:]])

    def restore(self, model: Model, memory: np.ndarray) -> None:
        super().restore(model, memory)
        self.past_dt = None

    def law(self, x: np.ndarray, memory: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """Forces [N] (n, 3) at places, and the memory after the step to them."""
        z = self._after(x, memory, dt)
        return self._forces(z), np.hstack([z, x, memory[:, :STATE], np.full((len(z), 1), dt)])

    def linear(
        self, x: np.ndarray, memory: np.ndarray, dt: float, d_x: np.ndarray, d_memory: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Change of both with places (n, 3, k) and memory (n, 13, k): the law is linear."""
        z = self._after(d_x, d_memory, dt)
        return self._forces(z), np.concatenate(
            [z, d_x, d_memory[:, :STATE], np.zeros_like(d_memory[:, -1:])], axis=1
        )

    def weights(self, dt: float) -> tuple[float, float]:
        """Shares that the stretch before the step, and the way since then, have in the stretch after it."""
        if self.at_rest:  # all that was stretched has relaxed
            return 0.0, 0.0
        x = (dt if self.past_dt is None else self.past_dt) / self.time
        return math.exp(-x), -math.expm1(-x) / x

    def _after(self, x: np.ndarray, memory: np.ndarray, dt: float) -> np.ndarray:
        left, gone = self.weights(dt)
        return np.asarray(left * memory[:, :3] + gone * (x - memory[:, 3:STATE]))

    def _forces(self, z: np.ndarray) -> np.ndarray:
        return np.asarray(-self.modulus * np.einsum("n,n...->n...", self.length, z))

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        if self.modulus == 0.0:
            return 0.0
        assert self.memory is not None
        forces = self._forces(self._after(ev.x[self.node], self.memory, ev.dt))
        F[self.dofs] += forces
        if jac:
            slope = self.modulus * self.weights(ev.dt)[1] * self.length
            np.add.at(data, self.slots[0], slope[:, None, None] * np.eye(3))
        return float(np.abs(forces).max())

    def next_memory(self, ev: Evaluation) -> np.ndarray:
        assert self.memory is not None
        return self.law(ev.x[self.node], self.memory, ev.dt)[1]

    def accept(self, model: Model, memory: np.ndarray) -> None:
        self.memory, self.past_dt = memory, None
