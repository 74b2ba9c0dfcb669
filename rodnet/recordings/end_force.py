"""What a force cell reads that holds a robot."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import RecordingError
from rodnet.names import meant
from rodnet.parameters import Parameter
from rodnet.recordings.channels import ChannelReader, channel_of
from rodnet.terms.constraints import BoundConstraint, Constraint

if TYPE_CHECKING:
    from rodnet.observer import Observer
    from rodnet.recordings.recording import Recording
    from rodnet.robot import Robot
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model

DT = 1e-2  # [s] only laws with memory ask for it


class EndForce(ChannelReader):
    """Force that the robot exerts on what holds it, at a constraint.

    What the constraint must do so that the held nodes move as prescribed, M a - F there, with the other sign.

    Parameters
    ----------
    robot : Robot
        What is observed.
    channel : str
        Channel of the recording, shape (T, axes) [N]; of one axis also (T,).
    at : str
        Name of the constraint, a `Clamp`, `Hinge`, `Grasp` or `PrescribedMotion`.
    axes : str
        Axes that the cell measures, ``"xyz"`` by default.
    gain : float
        Of the cell: read over true force.
    zero : array_like, shape (3,)
        What it reads without a load [N].

    Raises
    ------
    RecordingError
        If there is no such constraint or axis.
    """

    default_name = "end_force"
    unit: ClassVar[str] = "N"
    explicit = True
    gain = Parameter(1.0, unit="1", bounds=(0.01, 100.0), null=1.0, doc="read over true force")
    zero = Parameter(np.zeros(3), unit="N", bounds=(None, None), null=0.0, doc="what is read without a load")

    def __init__(
        self, robot: Robot, channel: str, *, at: str, axes: str = "xyz", name: str | None = None,
        **parameters: Any,
    ) -> None:  # fmt: skip
        super().__init__(robot, name=name, **parameters)
        held = [term.name for term in robot.terms if isinstance(term, Constraint)]
        if at not in held:
            raise RecordingError(
                f"EndForce: no constraint is called {at!r}; {meant(at, held)}there are {', '.join(held) or 'none'}"
            )
        if not axes or set(axes) - set("xyz") or len(set(axes)) != len(axes):
            raise RecordingError(f"EndForce: axes = {axes!r} must be some of x, y, z")
        self.channel, self.at, self.axes = channel, at, ["xyz".index(a) for a in axes]
        self._twins: list[tuple[Model, Model, Evaluation]] = []

    def read(self, view: Observer) -> np.ndarray:
        """Return the force [N] as the cell reads it, shape (axes,)."""
        from rodnet.diagnostics import Reaction

        m, ev = self._twin(view._model)
        state = view.state
        for bound, memory in zip(m.bound, state.memories, strict=True):
            if memory is not None:
                bound.restore(m, memory)
                bound.rewind()
        ev.set_source(state.tangents, state.directors, state.tau, state.q)
        ev.a[:] = state.a
        ev.update(state.q, state.v, state.t, DT, 0.0, False)
        held = next(b for b in m.bound if isinstance(b, BoundConstraint) and b.term.name == self.at)
        reaction = Reaction.zeros(1, len(held.nodes))
        reaction.measure(0, held, m.mass * state.a - ev.F, ev)
        zero = np.broadcast_to(self.zero.value, 3)
        return np.asarray((zero - self.gain.value * reaction.force[0])[self.axes])

    def _twin(self, model: Model) -> tuple[Model, Evaluation]:
        """A model of the same robot to evaluate states with; that of a run is in the midst of it."""
        from rodnet.solve.evaluation import Evaluation
        from rodnet.solve.model import Model

        for known, twin, ev in self._twins:
            if known is model:
                return twin, ev
        twin = Model(model.robot)
        self._twins = [*self._twins[-15:], (model, twin, Evaluation(twin))]
        return self._twins[-1][1:]

    def measured(self, rec: Recording) -> np.ndarray:
        """Return the channel, shape (T, axes)."""
        values = channel_of(rec, self.channel, None)
        values = values[:, None] if values.ndim == 1 else values
        if values.shape[1:] != (len(self.axes),):
            raise rec.error(
                f"channel '{self.channel}' {values.shape} must have {len(self.axes)} forces for each frame"
            )
        return values
