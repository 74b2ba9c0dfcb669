"""Grips and shakers that do not do quite what was prescribed: offsets, delays, gains."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from rodnet.parameters import Parameter
from rodnet.terms.constraints import Constraint, Grasp, PrescribedMotion, turned


class _Shifted(Constraint):
    """A constraint with an offset in the gripper's frame, that runs late."""

    shift_x = Parameter(0.0, unit="m", null=0.0, doc="offset along x, in the gripper's frame")
    shift_y = Parameter(0.0, unit="m", null=0.0, doc="offset along y, in the gripper's frame")
    shift_z = Parameter(0.0, unit="m", null=0.0, doc="offset along z, in the gripper's frame")
    lag = Parameter(0.0, unit="s", bounds=(-1.0, 1.0), null=0.0, doc="by how much the motion runs late")

    @staticmethod
    def shift(R: np.ndarray, p: Any) -> np.ndarray:
        """Offset in space [m], shape (3,), of a gripper with the rotation ``R``."""
        return np.asarray(p.shift_x * R[:, 0] + p.shift_y * R[:, 1] + p.shift_z * R[:, 2])


class ImperfectMotion(PrescribedMotion, _Shifted):
    """Prescribed motion that is not followed exactly: x = x0 + R(t - lag) shift + (1 + gain) position(t - lag).

    For a shaker that runs late or falls short, and a mount beside the place where it was measured.

    Parameters
    ----------
    gain : float or Parameter
        Relative change of the displacement [1].
    shift_x, shift_y, shift_z : float or Parameter
        Offset of what is held, turning with the prescribed orientation [m].
    lag : float or Parameter
        Delay against what is prescribed [s].
    """

    source = "essential boundary condition; docs, theory: what differs along a rod (grips)"
    gain = Parameter(0.0, unit="1", bounds=(-1.0, None), null=0.0, doc="relative change of the displacement")
    example: ClassVar[dict[str, Any]] = {
        "position": lambda t: np.array([0.01 * np.sin(t), 0.0, 0.0]),
        "gain": 0.1, "shift_x": 1e-3, "shift_y": 1e-3, "shift_z": -1e-3, "lag": 0.01,
    }  # fmt: skip

    def orientation(self, t: float, p: Any) -> np.ndarray:
        """Rotation from the initial orientation, shape (3, 3)."""
        return super().orientation(t - p.lag, p)

    def position(self, t: float, x0: np.ndarray, p: Any) -> np.ndarray:
        """Positions of the held nodes [m], shape (n, 3)."""
        R = self.orientation(t, p)
        moved = self.shift(R, p)
        if self.displacement is not None:
            moved += (1.0 + p.gain) * self.displacement(t - p.lag)
        return turned(x0, R) + moved


class ImperfectGrasp(Grasp, _Shifted):
    """A grasp beside the place where it was measured, or late: the held edge is shifted and follows with a delay.

    Parameters
    ----------
    shift_x, shift_y, shift_z : float or Parameter
        Offset of the held edge, which turns with a no-spin gripper [m].
    lag : float or Parameter
        Delay against what was measured [s].
    """

    source = "essential boundary condition; docs, theory: what differs along a rod (grips)"
    example: ClassVar[dict[str, Any]] = {
        "position": lambda t: np.array([0.0, 0.0, 0.01 * np.sin(t)]),
        "tangent": lambda t: np.array([1.0, 0.1 * np.sin(t), 0.0]),
        "twist": "no-spin", "duration": 1.0, "shift_x": 1e-3, "shift_y": 1e-3, "shift_z": -1e-3, "lag": 0.01,
    }  # fmt: skip

    def orientation(self, t: float, p: Any) -> np.ndarray:
        """Rotation from the initial orientation, shape (3, 3)."""
        return super().orientation(t - p.lag, p)

    def position(self, t: float, x0: np.ndarray, p: Any) -> np.ndarray:
        """Positions of the edge's two nodes [m], shape (2, 3)."""
        return super().position(t - p.lag, x0, p) + self.shift(self.orientation(t, p), p)
