"""Terms that a robot lacks: what they would change to first order, found along a run without them.

At its null value such a term does nothing, whatever it remembers. So the run needs no trace of it, and the
derivative of the residual by its strength is that of its force at the states of the run, with a memory of its own
that follows the run.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rodnet.solve.model import _overrides
from rodnet.solve.pattern import build_pattern
from rodnet.terms.actuators import Actuator
from rodnet.terms.base import BoundTerm, Term
from rodnet.terms.constraints import Constraint

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.steppers import State
    from rodnet.solve.watch import Stage

KINDS = "drag", "load", "contact", "energy"
# of a model: what a term may change that is no force
SHAPES = "eps0", "spring_stiffness", "Q1", "Q2", "mass"


class Unfit(Exception):
    """More changes than can be told from single pieces."""


class AddedTerms:
    """Terms beside those of a model, at values near the null value.

    Parameters
    ----------
    model : Model
        The model without them.
    ev : Evaluation
        Which holds the states to come.
    near : tuple of (float, tuple of Term)
        Weights of a difference quotient, and the terms; what is left out is without effect.

    Raises
    ------
    Unfit
        If they are not forces alone.
    """

    def __init__(
        self, model: Model, ev: Evaluation, near: tuple[tuple[float, tuple[Term, ...]], ...]
    ) -> None:
        self.model, self.ev = model, ev
        self.near = [(weight, [_bound(term, model) for term in terms]) for weight, terms in near]
        bound = [b for _, some in self.near for b in some]
        self.beginning = any(_overrides(b, "begin_step") for b in bound)
        self.remembering = [b for b in bound if b.memory is not None or _overrides(b, "next_memory")]
        self._known: list[tuple[np.ndarray, list[np.ndarray | None]]] = []
        self._at: np.ndarray | None = None  # degrees of freedom of the state whose memories are in place

    @property
    def each(self) -> list[tuple[float, BoundTerm]]:
        """All terms with their weights."""
        return [(weight, b) for weight, some in self.near for b in some]

    def add(self, stage: Stage, out: np.ndarray) -> None:
        """Add the change of the residual of a solved stage, shape (dof_count,)."""
        self._remember(stage.state)
        for weight, bound in self.near:
            force = np.zeros_like(out)
            for b in bound:
                if self.beginning:
                    b.begin_step(self.model, stage.now, stage.elapsed, stage.sensors, stage.inputs)
                b.add(self.ev, force, self.model.scrap, False)
            out -= weight * force

    def _remember(self, state: State) -> None:
        """Put the memories of the state in place that a step begins with."""
        if not self.remembering or state.q is self._at:
            return
        if not self._known:
            for b in self.remembering:
                b.begin(state.q)
            self._known.append(
                (state.q, [None if b.memory is None else b.memory.copy() for b in self.remembering])
            )
        for q, memories in self._known:
            if q is state.q:
                for b, memory in zip(self.remembering, memories, strict=True):
                    if memory is not None:
                        b.restore(self.model, memory)
        self._at = state.q

    def accepted(self, begin: State, new: State) -> None:
        """Let the terms keep what they remember of an accepted step, whose last stage the evaluation holds."""
        if not self.remembering:
            return
        memories = [b.next_memory(self.ev) for b in self.remembering]
        for b, memory in zip(self.remembering, memories, strict=True):
            if memory is not None:
                b.accept(self.model, memory)
        # the state that the step began with may be needed once more, where steps are halved
        self._known = [one for one in self._known if one[0] is begin.q] + [(new.q, memories)]
        self._at = new.q


def _bound(term: Term, model: Model) -> BoundTerm:
    """Bind a term to a model of which it is no part, without any place in its Jacobian."""
    if term.kind not in KINDS or isinstance(term, Actuator | Constraint):
        raise Unfit
    if type(term).add_masses is not Term.add_masses:
        raise Unfit
    before = {name: (getattr(model, name), getattr(model, name).copy()) for name in SHAPES}
    bound = term.bind(model)
    nowhere = [np.full(np.shape(stencil), -1, dtype=np.int32) for stencil in bound.stencils]
    bound.find_slots(build_pattern(len(model.free), []), nowhere)
    bound.stencils = []
    changed = False
    for name, (array, values) in before.items():
        if getattr(model, name) is not array or not np.array_equal(array, values):
            array[...] = values
            setattr(model, name, array)
            changed = True
    if changed or bound.replacing or bound.axial_stiffness is not None:
        raise Unfit
    if _overrides(bound, "stress") or _overrides(bound, "spring_stiffness"):
        raise Unfit
    return bound
