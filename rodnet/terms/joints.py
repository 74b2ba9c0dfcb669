"""Elasticity of joints: hinges with a spring, elastic joints."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from rodnet.errors import FoldedStateError
from rodnet.parameters import Parameter
from rodnet.terms.base import BoundTerm, Term

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model


class JointElasticity(Term):
    """Elasticity of hinges and elastic joints, E = sum 1/2 k_a rho_a^2.

    rho is the rotation vector between the two frames of the joint [rad], so a moment M about an axis
    turns the joint by exactly M / k; a hinge counts its turns. The stiffnesses are those that
    `StickFigure.joint` was given. A robot gets this term by itself, for the joints that have no other;
    one of its own gives a joint a factor of its own: ``JointElasticity("arm.end", name="elbow")``.

    Parameters
    ----------
    on : str or sequence of str
        The joints' nodes.
    scale : float or Parameter
        Factor on all stiffnesses.
    """

    kind = "energy"
    default_name = "joints"
    source = "docs, theory: springs and joints (joints that turn)"
    once = True
    claims: ClassVar[set[str]] = {"conservative", "objective"}
    scale = Parameter(1.0, unit="1", bounds=(0, None), doc="factor on the joints' stiffnesses")

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the joints at the nodes that ``on`` names."""
        return _BoundJoints(self, model) if model.joint_laws else _BoundFrames(self, model)


class _BoundFrames(BoundTerm):
    """Keeps the length of the edges that stand for frames: no force is on them at rest."""

    def __init__(self, term: JointElasticity, model: Model) -> None:
        super().__init__(term)
        self.nodes = set(model.graph.nodes(term.on).tolist())
        self.axial_stiffness = np.zeros(model.edge_count)
        for frames in model.joints:
            if frames.joint.node in self.nodes:
                self.axial_stiffness[frames.edges] = frames.axial

    def energy(self, ev: Evaluation) -> float:
        assert self.axial_stiffness is not None
        return float(0.5 * np.sum(self.axial_stiffness * ev.stretch**2 * ev.model.rest_length))


class _BoundJoints(_BoundFrames):
    """Evaluates the joints' law and adds to the springs' stresses."""

    def __init__(self, term: JointElasticity, model: Model) -> None:
        super().__init__(term, model)
        from rodnet.kinematics.joint_kernels import joint_law

        self.law, self.first = joint_law, model.first_law
        joints = [frames.joint for frames, _ in model.joint_laws]
        mine = np.array([joint.node in self.nodes for joint in joints])
        self.memory = np.zeros((len(joints), 3))
        self.names = [joint.at for joint in joints]
        self.hinge = np.array([joint.kind == "hinge" for joint in joints], dtype=bool)
        stiffness = np.array([joint.stiffness for joint in joints]).reshape(-1, 3)
        self.K = term.values().scale * mine[:, None] * stiffness

    def stress(self, ev: Evaluation) -> None:
        self.law(self.first, self.hinge, self.K, ev.eps, ev.stress, ev.modulus)

    def next_memory(self, ev: Evaluation) -> np.ndarray:
        """Rotation vectors, to notice where they jump to the other side: at half a turn."""
        k1, k2, tau = ev.eps[self.first :].T
        cosine = np.maximum(1.0 + np.cos(tau), 1e-12)
        gibbs = np.stack([-k2 / cosine, k1 / cosine, np.sin(tau) / cosine], axis=1)
        size = np.linalg.norm(gibbs, axis=1, keepdims=True)
        turn = np.where(self.hinge[:, None], 0.0, 2.0 * np.arctan(size) * gibbs / np.maximum(size, 1e-300))
        before = self.memory
        assert before is not None
        far = np.minimum(np.sum(turn**2, axis=1), np.sum(before**2, axis=1)) > (0.5 * np.pi) ** 2
        over = np.flatnonzero(far & (np.sum(turn * before, axis=1) < 0.0))
        if len(over):
            raise FoldedStateError(
                f"the elastic joint at '{self.names[over[0]]}' turns by more than half a turn (t = {ev.t:g} s), where "
                "its moment is not defined; a hinge may turn as far as it likes, kind='hinge'"
            )
        return turn

    def energy(self, ev: Evaluation) -> float:
        scrap = np.empty_like(ev.stress), np.empty_like(ev.modulus)
        return super().energy(ev) + float(self.law(self.first, self.hinge, self.K, ev.eps, *scrap))
