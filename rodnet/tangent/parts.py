"""What a parameter changes in a model, piece by piece, and the change of the residual that follows."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.solve.evaluation import Evaluation
from rodnet.tangent.added import AddedTerms, Unfit
from rodnet.tangent.compare import alike
from rodnet.tangent.held import HeldTangent
from rodnet.tangent.linear import LinearChange
from rodnet.tangent.remembered import SpringMemoryTangent
from rodnet.tangent.remembered_media import MediumTangent
from rodnet.tangent.remembered_places import PlaceMemoryTangent
from rodnet.tangent.tendons import TendonTangent
from rodnet.terms.actuators import _BoundActuator, _BoundTwist
from rodnet.terms.base import BoundTerm
from rodnet.terms.constraints import BoundConstraint
from rodnet.terms.dissipation import _BoundKelvinVoigt, _BoundMassDamping
from rodnet.terms.drag.change import _BoundChange
from rodnet.terms.drag.crowding import _BoundCrowded
from rodnet.terms.drag.line import _BoundLaw, _BoundLine
from rodnet.terms.drag.stokes import _BoundResistance, _BoundSphere
from rodnet.terms.driven_curvature import _BoundCurvature
from rodnet.terms.drives import _BoundDCMotor
from rodnet.terms.loads import Gravity, _BoundLoad
from rodnet.terms.tendons import _BoundTendon

if TYPE_CHECKING:
    from rodnet.solve.model import Model
    from rodnet.solve.watch import Stage
    from rodnet.tangent.variation import Variation

MOTORS = _BoundTwist, _BoundDCMotor  # of which it is known what their angle does
# terms that know nothing of the model but their own arrays
_OWN = (_BoundLine, _BoundSphere, _BoundResistance, _BoundLoad, _BoundMassDamping)


def _steady(bound: BoundTerm) -> bool:
    """Whether a term leaves the springs' stiffnesses as they are."""
    return not isinstance(bound, _BoundTwist) or (bound.isotropic and type(bound) in MOTORS)


def _forceful(model: Model, bound: BoundTerm) -> bool:
    """Whether a term does more than change masses, stiffnesses and natural shapes."""
    duties = (
        model.stressing,
        model.adding,
        model.beginning,
        model.coupling,
        model.remembering,
        model.constraints,
    )
    return any(bound in some for some in duties)


class Part:
    """How the residual of a model changes with one column, at a fixed state.

    Parameters
    ----------
    model : Model
        The model.
    ev : Evaluation
        Where it is evaluated.
    column : Variation
        The column.

    Attributes
    ----------
    linear : LinearChange
        What it changes of coefficients that the residual is linear in.
    motors : list of (int, list)
        Motors whose command it changes: number of the bound term, and weights with bound terms nearby.
    remembered : list of (int, list)
        The same of laws that remember strains of springs or places, or whose memory a medium holds.

    Raises
    ------
    Unfit
        If it changes what only whole evaluations can tell.
    """

    def __init__(self, model: Model, ev: Evaluation, column: Variation) -> None:
        self.model, self.ev = model, ev
        self.near = [(weight, sim.model) for weight, sim in column.near] if column.acts else []
        models = [m for _, m in self.near]
        if any(m.dof_count != model.dof_count or not np.array_equal(m.free, model.free) for m in models):
            raise Unfit
        if any(_forceful(m, b) for m in models for b in m.bound[len(model.bound) :]):
            raise Unfit
        self.added: AddedTerms | None = AddedTerms(model, ev, column.added) if column.added else None
        self.linear = LinearChange(mass=self._sum("mass"))
        if self.added is not None and self.linear.lay(self.added.each):
            self.added = None
        self.axial, self.lengths = self._sum("axial_stiffness"), self._sum("rest_length")
        summed = self._combine([m.quadratic_stiffness() for m in models], model.quadratic_stiffness())
        self.stiffness, self.offset = summed, self._sum("eps0")
        frames = any(
            not np.array_equal(getattr(m, name), getattr(model, name))
            for m in models
            for name in ("Q1", "Q2")
        )
        driven = any(isinstance(b, _BoundActuator) and not isinstance(b, _BoundTendon) for b in model.bound)
        remembered = any(SpringMemoryTangent.knows(model, b) for b in model.bound)
        if frames and (model.stressing or remembered or driven):  # whose natural shapes only a step knows
            raise Unfit
        if summed is not None and not all(_steady(b) for b in model.bound):
            raise Unfit
        self.whole = [(w, Evaluation(m)) for w, m in self.near] if frames else []
        elastic = frames or any(
            p is not None for p in (self.axial, self.lengths, self.stiffness, self.offset)
        )
        self.elastic = elastic and not frames
        self.turned = [b.spring for b in model.bound if isinstance(b, _BoundTwist)]
        self.motors: list[tuple[int, list[tuple[float, _BoundTwist]]]] = []
        self.remembered: list[tuple[int, list[tuple[float, BoundTerm]]]] = []
        self.moves = False  # whether it changes what is prescribed
        self.pull: np.ndarray | None = None
        self.viscosity: np.ndarray | None = None
        self.terms: list[tuple[BoundTerm, list[tuple[float, BoundTerm, Any]]]] = []
        for k, bound in enumerate(model.bound):
            self._add(k, bound, elastic or self.linear.mass is not None)

    def _combine(self, arrays: list[np.ndarray], base: np.ndarray) -> np.ndarray | None:
        if all(np.array_equal(a, base) for a in arrays):
            return None
        return np.sum([w * a for (w, _), a in zip(self.near, arrays, strict=True)], axis=0)

    def _sum(self, name: str) -> np.ndarray | None:
        return self._combine([getattr(m, name) for _, m in self.near], getattr(self.model, name))

    def _add(self, k: int, bound: BoundTerm, changed: bool) -> None:
        others = [(w, m.bound[k]) for w, m in self.near]
        same = all(alike(bound, other) for _, other in others)
        if (
            isinstance(bound, _BoundDCMotor)
            and self.stiffness is not None
            and self.stiffness[bound.spring].any()
        ):
            if not others:  # what it takes off the joint's stiffness changes, too
                raise Unfit
            same = False
        if same and (not changed or isinstance(bound, _OWN) or bound not in self.model.adding):
            return
        if bound.memory is None and any(other.memory is not None for _, other in others):
            raise Unfit  # what a run does not remember
        if isinstance(bound, BoundConstraint):
            if bound.moving:
                alike_held = all(o.moving and np.array_equal(o.dofs, bound.dofs) for _, o in others)
                if not alike_held or not HeldTangent.knows(self.model):
                    raise Unfit
                self.moves = True
            return  # else what it holds stays where the initial state has it
        if isinstance(bound, _BoundTwist) and type(bound) in MOTORS and bound.isotropic:
            self.motors.append((k, [(w, b) for w, b in others]))
            return
        remembers = (
            SpringMemoryTangent.knows(self.model, bound)
            or PlaceMemoryTangent.knows(bound)
            or MediumTangent.knows(bound)
            or TendonTangent.knows(self.model, bound)
        )
        if remembers:
            self.remembered.append((k, others))
            return
        reads = bound in self.model.beginning and not isinstance(bound, _BoundLoad)
        crowded = isinstance(bound, _BoundCrowded)  # of its memory a tangent of its own knows
        forgets = type(bound) is _BoundLaw and bound.memory is None
        laws = (
            (bound in self.model.remembering and not crowded and not forgets)
            or bound in self.model.coupling
            or reads
        )
        if laws or isinstance(bound, _BoundActuator) or (bound in self.model.stressing and not same):
            raise Unfit
        if bound in self.model.adding:
            if isinstance(bound, _BoundLoad) and type(bound.law) is Gravity:
                self._weigh(bound, others)
                return
            if self.linear.add(self.model, k, others) or self._damp(others):
                return
            if self._driven(bound):
                raise Unfit
            views = []
            for weight, other in others:
                view = copy.copy(self.ev)
                if not isinstance(other, _BoundChange):  # which looks up neighbours where they are remembered
                    view.model = next(m for w, m in self.near if other in m.bound)
                views.append((weight, other, view))
            self.terms.append((bound, views))

    def _driven(self, bound: BoundTerm) -> bool:
        """Whether a term depends on what actuators of this run drive, which stands still in models nearby."""
        drives: tuple[type, ...] = () if isinstance(bound, _OWN) else (_BoundCurvature,)
        if isinstance(bound, _BoundKelvinVoigt):
            drives = (_BoundCurvature, _BoundTwist)
        return any(isinstance(b, drives) for b in self.model.bound)

    def _damp(self, others: list[tuple[float, Any]]) -> bool:
        """Take the change of a rod's own viscosity, unless actuators drive what it is measured against."""
        if self.whole or not all(isinstance(b, _BoundKelvinVoigt) for _, b in others):
            return False
        if any(isinstance(b, _BoundTwist | _BoundCurvature) for b in self.model.bound):
            return False
        if self.viscosity is None or self.pull is None:
            self.viscosity = np.zeros((self.model.spring_count, 3, 3))
            self.pull = np.zeros(self.model.edge_count)
        for weight, b in others:
            self.viscosity[b.springs] += (
                weight * b.roots[:, None] * b.model.spring_stiffness[b.springs] * b.roots
            )
            self.pull[b.edges] += weight * b.stretching / b.length
        return True

    @property
    def viscous(self) -> bool:
        """Whether the viscosity of rods changes."""
        return self.viscosity is not None

    def _weigh(self, own: Any, others: list[tuple[float, Any]]) -> None:
        """Weight does not change with the state; weights of a quotient sum to zero, and what is the same cancels."""
        here = own._evaluated(self.ev)[0]
        weight = np.sum([w * (other._evaluated(self.ev)[0] - here) for w, other in others], axis=0)
        before = self.linear.constant
        self.linear.constant = -weight if before is None else before - weight

    @property
    def idle(self) -> bool:
        """Whether there is nothing for `add`."""
        return not self.terms and not self.whole and self.added is None

    def add(self, stage: Stage, out: np.ndarray) -> None:
        """Add the residual's change (dof_count,) that is not that of ``linear``, quadratic energies or motors."""
        ev = self.ev
        if self.added is not None:
            self.added.add(stage, out)
        if self.terms:
            for spring in self.turned:  # motors nearby stand where they began
                for _, near in self.near:
                    near.Q1[spring], near.Q2[spring] = self.model.Q1[spring], self.model.Q2[spring]
        for own, views in self.terms:
            for weight, bound, view in views:
                if own.memory is not None and bound.memory is not None:
                    bound.restore(view.model, own.memory)
                view.t, view.dt, view.cv, view.ca = ev.t, ev.dt, ev.cv, ev.ca
                if isinstance(bound, _BoundLoad):
                    bound.begin_step(view.model, stage.now, stage.elapsed, stage.sensors, stage.inputs)
                force = np.zeros_like(out)
                bound.add(view, force, self.model.scrap, False)
                out -= weight * force
        for weight, near in self.whole:
            near.q[:], near.rates[:] = ev.q, ev.rates
            near.set_source(ev.ts, ev.d1s, ev.tau_ref, ev.q)
            near._kernels.quadratic_forces(
                near._quadratic.table, near.model.quadratic_stiffness(), near.model.scrap, False
            )
            out -= weight * near.F
