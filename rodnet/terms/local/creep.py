"""Plastic set: the natural shape of a rod creeps after the shape that it is held in."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.kinematics.frames import relative_strains
from rodnet.parameters import Parameter
from rodnet.terms.base import BoundTerm, Term
from rodnet.terms.local.section import stiffness_left
from rodnet.terms.spring_moments import SpringMoments

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.pattern import Pattern

STATE = 6  # of the memory of a spring: set (3), and the strain at the end of the step (3)


class PlasticSet(Term):
    """A natural shape that creeps after the present one: moment K (strain - share z), dz/dt = (strain - z)/time.

    K is what a soft spot, a give or a section leave of the rod's stiffness. The rod starts without a set. What it is
    held at for much longer than ``time`` it keeps in part, and loses again when it is let go; this is the standard
    linear solid, whose modulus relaxes by ``share``. A ``time`` beyond the length of a recording makes the set as good
    as permanent. Along a step strains change linearly: second order.

    Parameters
    ----------
    on : str or sequence of str
        The rods.
    share : float or Parameter
        Part of the strain that becomes natural [1].
    time : float or Parameter
        Time constant [s].
    """

    kind = "drag"
    default_name = "set"
    source = "standard linear solid (Zener 1948) with the anelastic strain as memory"
    claims: ClassVar[set[str]] = {"objective"}
    example: ClassVar[dict[str, float]] = {"share": 0.4, "time": 0.01}
    share = Parameter(
        0.0, unit="1", bounds=(0.0, 0.99), null=0.0, doc="part of the strain that becomes natural"
    )
    time = Parameter(10.0, unit="s", bounds=(1e-6, None), kind="shape", doc="time constant of the set")

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the springs whose edges ``on`` names."""
        self.check_numbers()
        return _BoundSet(self, model)


class _BoundSet(BoundTerm):
    """The memory holds set and strain at the last accepted state, those before its step, and the step's length."""

    def __init__(self, term: PlasticSet, model: Model) -> None:
        super().__init__(term)
        p = term.values()
        self.share, self.time = float(p.share), float(p.time)
        self.model, self.moments = model, SpringMoments(model, model.springs_on(term.on))
        self._version, self._K = -1, np.zeros((0, 3, 3))
        self.past_dt: float | None = None  # of a recorded step that is evaluated again
        self.stencils = [self.moments.dofs]

    def find_slots(self, pattern: Pattern, stencils: list[np.ndarray]) -> None:
        self.moments.find_slots(pattern, stencils[0])
        model, s = self.model, self.moments.springs  # by now all natural shapes are set
        frames = model.start_frames
        V, W = frames[model.edge1[s]] @ model.Q1[s], frames[model.edge2[s]] @ model.Q2[s]
        start = np.hstack([np.zeros((len(s), 3)), relative_strains(V, W) - model.eps0[s]])
        self.memory = np.hstack([start, start, np.ones((len(s), 1))])

    @property
    def constants(self) -> tuple[Any, ...]:
        """What the law depends on beside strain, memory and time."""
        return self.share, self.time, self._stiffness()

    def rewind(self) -> None:
        assert self.memory is not None
        old = self.memory[:, STATE : 2 * STATE]
        if len(old):
            self.past_dt = float(self.memory[0, -1])
        self.memory = np.hstack([old, old, self.memory[:, -1:]])

    def restore(self, model: Model, memory: np.ndarray) -> None:
        super().restore(model, memory)
        self.past_dt = None

    def law(self, strain: np.ndarray, memory: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """Moments (n, 3) at strains, and the memory after the step to them."""
        z = self._after(strain, memory, dt)
        return self._moments(z), np.hstack([z, strain, memory[:, :STATE], np.full((len(z), 1), dt)])

    def linear(
        self, strain: np.ndarray, memory: np.ndarray, dt: float, d_strain: np.ndarray, d_memory: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Change of both with strains (n, 3, k) and memory (n, 13, k): the law is linear."""
        z = self._after(d_strain, d_memory, dt)
        return self._moments(z), np.concatenate(
            [z, d_strain, d_memory[:, :STATE], np.zeros_like(d_memory[:, -1:])], axis=1
        )

    def _weights(self, dt: float) -> tuple[float, float, float]:
        """Shares that set and strain before the step, and the strain after it, have in the set after it."""
        if self.at_rest:
            return 1.0, 0.0, 0.0
        x = (dt if self.past_dt is None else self.past_dt) / self.time
        left, mean = math.exp(-x), -math.expm1(-x) / x
        return left, mean - left, 1.0 - mean

    def _after(self, strain: np.ndarray, memory: np.ndarray, dt: float) -> np.ndarray:
        """Set after a step."""
        left, before, now = self._weights(dt)
        return np.asarray(left * memory[:, :3] + before * memory[:, 3:STATE] + now * strain)

    def _moments(self, z: np.ndarray) -> np.ndarray:
        return np.asarray(-self.share * np.einsum("nkl,nl...->nk...", self._stiffness(), z))

    def _stiffness(self) -> np.ndarray:
        """Stiffness of the springs, shape (n, 3, 3): a motor can turn a section."""
        if self._version != self.model.stiffness_version:
            self._K = stiffness_left(self.model, self.moments.springs)
            self._version = self.model.stiffness_version
        return self._K

    def _strain(self, ev: Evaluation) -> np.ndarray:
        return np.asarray((ev.eps - ev.model.eps0)[self.moments.springs])

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        if self.share == 0.0:
            return 0.0
        assert self.memory is not None
        z = self._after(self._strain(ev), self.memory, ev.dt)
        D = None
        if jac:
            D = -self.share * self._weights(ev.dt)[2] * self._stiffness()
        return self.moments.add(ev, self._moments(z), D, F, data)

    def next_memory(self, ev: Evaluation) -> np.ndarray:
        assert self.memory is not None
        return self.law(self._strain(ev), self.memory, ev.dt)[1]

    def accept(self, model: Model, memory: np.ndarray) -> None:
        self.memory, self.past_dt = memory, None
