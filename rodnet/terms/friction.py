"""Dry friction inside a rod, with pre-sliding: strands, sheaths and tendons that rub as it bends and twists."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import TermError
from rodnet.kinematics.frames import relative_strains
from rodnet.parameters import Parameter
from rodnet.terms.base import BoundTerm, Term
from rodnet.terms.friction_kernels import dahl, dahl_slope
from rodnet.terms.spring_moments import SpringMoments, runs_against

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.pattern import Pattern

STATE = 6  # of the memory of a spring: friction state z (3), and the strain it was reached at (3)


class DryFriction(Term):
    """Rate-independent friction moments against bending and twisting, after Dahl, with pre-sliding.

    The moments are ``moment z`` against (kappa1, kappa2) and ``torque z`` against twist; the state z, at
    most 1 long, follows dz = dy - abs(dy) z with y the strain over its pre-sliding scale. Small motions are
    elastic, with the stiffness moment / curvature; large ones slide under the full moment. Along a step
    the law is integrated exactly, so a loop does not depend on how many steps it takes.

    It acts in rods and welds. The springs of joints that turn (hinges, ball and elastic joints) are not of
    the rods' material and have no part in it.

    Strands that held rods bent and have just let go, such as tendons, resist the way back from the first moment
    on. With ``pull`` the friction is theirs: it acts where they ran, and begins at its limit.

    Parameters
    ----------
    on : str or sequence of str
        The rods.
    pull : mapping, optional
        By rod, where strands have bent it to, in its directors m1 and m2, ``{"arm": (p1, p2)}``: the sum of a unit
        vector for each strand that was tight. The moments are those of one strand, times the length of this sum.
    moment, torque : float or Parameter
        Friction moments when sliding, in bending and in twist [N m].
    rubs : bool
        Whether there is friction at all; if not, the term only keeps ``pull``, for a diagnosis to try it.
    curvature, twist : float or Parameter
        Pre-sliding scales: a reversal is over within a few of them [1/m] and [rad/m].
    """

    kind = "drag"
    default_name = "friction"
    source = "Dahl 1968 (of first order; the Bouc-Wen model of exponent 1 with equal constants)"
    claims: ClassVar[set[str]] = {"objective"}
    example: ClassVar[dict[str, float]] = {"moment": 0.01, "torque": 0.02, "curvature": 5.0, "twist": 8.0}

    moment = Parameter(0.0, unit="N m", bounds=(0, None), null=0.0, doc="friction moment in bending")
    torque = Parameter(0.0, unit="N m", bounds=(0, None), null=0.0, doc="friction torque in twisting")
    curvature = Parameter(
        1.0, unit="1/m", bounds=(1e-9, None), kind="shape", doc="pre-sliding scale in bending"
    )
    twist = Parameter(
        1.0, unit="rad/m", bounds=(1e-9, None), kind="shape", doc="pre-sliding scale in twisting"
    )

    def __init__(
        self, on: Any = "*", *, pull: Mapping[str, Any] | None = None, rubs: bool = True, **options: Any
    ) -> None:
        super().__init__(on, **options)
        self.rubs = rubs
        self.pull = None if pull is None else {rod: np.asarray(p, dtype=float) for rod, p in pull.items()}
        for rod, p in (self.pull or {}).items():
            if p.shape != (2,) or not np.isfinite(p).all():
                raise TermError(
                    f"friction '{self.name}': pull of '{rod}' must be two finite numbers, not {p}"
                )

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the springs whose edges ``on`` names, with ``pull`` those of its rods."""
        self.check_numbers()
        return _BoundFriction(self, model) if self.rubs else BoundTerm(self)


class _BoundFriction(BoundTerm):
    def __init__(self, term: DryFriction, model: Model) -> None:
        super().__init__(term)
        springs = model.springs_on(term.on)
        self.model, self.moments, p = model, SpringMoments(model, springs), term.values()
        self.limit = np.tile([p.moment, p.moment, p.torque], (len(springs), 1))
        self.first = np.zeros((len(springs), 3))  # state at the beginning
        if term.pull is not None:
            pulls = _pulls(model, springs, term.pull)
            strands = np.linalg.norm(pulls, axis=1, keepdims=True)
            self.limit *= strands
            self.first[:, :2] = -pulls / np.where(strands > 0.0, strands, 1.0)  # against the way back
        length = model.spring_length[self.moments.springs]
        self.scale = length[:, None] * np.array([p.curvature, p.curvature, p.twist])  # rad
        self.stencils = [self.moments.dofs]

    # The memory holds the state at the last accepted step and the one before: with the latter a
    # recorded state can be evaluated again.
    def find_slots(self, pattern: Pattern, stencils: list[np.ndarray]) -> None:
        self.moments.find_slots(pattern, stencils[0])
        model, s = self.model, self.moments.springs  # by now all actuators have set natural shapes
        frames = model.start_frames
        V, W = frames[model.edge1[s]] @ model.Q1[s], frames[model.edge2[s]] @ model.Q2[s]
        start = np.hstack([self.first, relative_strains(V, W) - model.eps0[s]])
        self.memory = np.hstack([start, start])

    @property
    def constants(self) -> tuple[np.ndarray, ...]:
        """What the law depends on beside strain, memory and time."""
        return self.limit, self.scale

    def rewind(self) -> None:
        assert self.memory is not None
        old = self.memory[:, STATE:]
        self.memory = np.hstack([old, old])

    def law(self, strain: np.ndarray, memory: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
        """Moments (n, 3) at strains, and the memory after the step to them."""
        z = dahl(memory[:, :3], (strain - memory[:, 3:STATE]) / self.scale)
        return self.limit * z, np.hstack([z, strain, memory[:, :STATE]])

    def linear(
        self, strain: np.ndarray, memory: np.ndarray, dt: float, d_strain: np.ndarray, d_memory: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Change of both with strains (n, 3, k) and memory (n, 12, k), on the side of a corner that the step took."""
        old, step = memory[:, :3], (strain - memory[:, 3:STATE]) / self.scale
        d_step = (d_strain - d_memory[:, 3:STATE]) / self.scale[:, :, None]
        slope, left = dahl_slope(old, step)
        d_z = left[:, :, None] * d_memory[:, :3] + slope @ d_step
        return self.limit[:, :, None] * d_z, np.concatenate([d_z, d_strain, d_memory[:, :STATE]], axis=1)

    def _strain(self, ev: Evaluation) -> np.ndarray:
        return np.asarray(ev.eps[self.moments.springs] - ev.model.eps0[self.moments.springs])

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        if not self.limit.any():
            return 0.0
        assert self.memory is not None
        old, step = self.memory[:, :3], (self._strain(ev) - self.memory[:, 3:STATE]) / self.scale
        D = None
        if jac:
            D = self.limit[:, :, None] * dahl_slope(old, step)[0] / self.scale[:, None, :]
        return self.moments.add(ev, self.limit * dahl(old, step), D, F, data)

    def next_memory(self, ev: Evaluation) -> np.ndarray:
        assert self.memory is not None
        return self.law(self._strain(ev), self.memory, ev.dt)[1]

    def accept(self, model: Model, memory: np.ndarray) -> None:
        self.memory = memory


def _pulls(model: Model, springs: np.ndarray, pull: Mapping[str, np.ndarray]) -> np.ndarray:
    """Pull at each spring, shape (n, 2): between a rod with and a part without any, that of the rod."""
    by_edge, has = np.zeros((model.edge_count, 2)), np.zeros((model.edge_count, 1))
    for rod, p in pull.items():
        edges = model.graph.edge_indices([rod])
        by_edge[edges], has[edges] = p, 1.0
    one, two = model.edge1[springs], model.edge2[springs]
    pulls = (by_edge[one] + by_edge[two]) / np.maximum(has[one] + has[two], 1.0)
    pulls[runs_against(model, springs), 1] *= -1.0
    return pulls
