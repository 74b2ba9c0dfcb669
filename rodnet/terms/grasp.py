"""A gripper on one edge of a rod, as two markers tell it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

from rodnet.errors import TermError
from rodnet.parameters import Parameter
from rodnet.terms.constraints import Constraint


class Grasp(Constraint):
    """A gripper that holds one edge of a rod, as known from two markers: a point and a direction.

    The held edge keeps its natural length (a rod hardly stretches, marker distances breathe), so the
    first node follows ``position`` and the second lies along ``tangent``.

    Parameters
    ----------
    at : str
        The held edge, e.g. ``"cable:0-1"``.
    position : callable
        ``position(t)`` of the edge's first node [m], shape (3,).
    tangent : callable
        ``tangent(t)``, the direction of the edge, shape (3,), of any length.
    twist : {"free", "no-spin"}
        What two markers cannot tell: the rod turns freely in the gripper (a swivel), or the gripper
        turns without spin about its own axis (a rotation-minimising frame).
    duration : float
        With ``twist="no-spin"``: the time up to which the frame is prepared [s].
    offset : float or Parameter
        Turn of the rod in a no-spin gripper against its initial state [rad].
    """

    default_name = "grasp"
    source = "essential boundary condition; rotation-minimising frame: Wang et al. 2008"
    offset = Parameter(0.0, unit="rad", null=0.0, kind="shape", doc="turn of the rod in the gripper")
    example: ClassVar[dict[str, Any]] = {
        "position": lambda t: np.array([0.0, 0.0, 0.01 * np.sin(t)]),
        "tangent": lambda t: np.array([1.0, 0.1 * np.sin(t), 0.0]),
        "twist": "no-spin",
        "duration": 1.0,
    }

    def __init__(
        self,
        *,
        at: str,
        position: Callable[[float], np.ndarray],
        tangent: Callable[[float], np.ndarray],
        twist: str,
        duration: float | None = None,
        name: str | None = None,
        **parameters: Any,
    ) -> None:
        from rodnet.terms.functions import NoSpinFrame, Remembered, UnitDirection

        super().__init__(at=at, name=name, **parameters)
        if twist not in ("free", "no-spin"):
            raise TermError(f"Grasp: twist must be 'free' or 'no-spin', not {twist!r}")
        if twist == "no-spin" and not (duration and duration > 0):
            raise TermError("Grasp: twist='no-spin' needs duration= [s], the time span of the motion")
        self._position = Remembered(position)
        self._tangent = Remembered(UnitDirection(tangent))
        self.holds = {"position"} if twist == "free" else {"position", "orientation"}  # type: ignore[misc]
        self._frame = (
            Remembered(NoSpinFrame(self._tangent, duration)) if duration and twist == "no-spin" else None
        )

    def position(self, t: float, x0: np.ndarray, p: Any) -> np.ndarray:
        """Positions of the edge's two nodes [m], shape (2, 3)."""
        if len(x0) != 2:
            raise TermError(
                f"grasp '{self.name}' must hold one edge (at='rod:0-1'), it holds {len(x0)} nodes"
            )
        start = self._position(t)
        return np.stack([start, start + np.linalg.norm(x0[1] - x0[0]) * self._tangent(t)])

    def orientation(self, t: float, p: Any) -> np.ndarray:
        """Rotation from the initial orientation, shape (3, 3)."""
        from rodnet.kinematics.frames import rotation

        if self._frame is None:
            return np.eye(3)
        frame = self._frame(t)
        return rotation(p.offset * self._tangent(t)) @ frame if p.offset else frame
