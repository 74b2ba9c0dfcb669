"""Grips and shakers that do not do quite what was prescribed: offsets, delays, gains."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from rodnet.kinematics.frames import mean_rotation
from rodnet.parameters import Parameter
from rodnet.terms.constraints import Constraint, PrescribedMotion, turned
from rodnet.terms.grasp import Grasp


class _Shifted(Constraint):
    """A constraint with an offset in the gripper's frame, that runs late."""

    carries = True
    shift_x = Parameter(0.0, unit="m", null=0.0, doc="offset along x, in the gripper's frame")
    shift_y = Parameter(0.0, unit="m", null=0.0, doc="offset along y, in the gripper's frame")
    shift_z = Parameter(0.0, unit="m", null=0.0, doc="offset along z, in the gripper's frame")
    lag = Parameter(0.0, unit="s", bounds=(-1.0, 1.0), null=0.0, doc="by how much the motion runs late")
    spread = Parameter(
        0.0, unit="1", bounds=(0.0, 2.0), kind="shape",
        doc="variance of the delays over the lag's square: 0 one delay, 1 a lag of first order",
    )  # fmt: skip

    @staticmethod
    def shift(R: np.ndarray, p: Any) -> np.ndarray:
        """Offset in space [m], shape (3,), of a gripper with the rotation ``R``."""
        return np.asarray(p.shift_x * R[:, 0] + p.shift_y * R[:, 1] + p.shift_z * R[:, 2])

    @staticmethod
    def followed(t: Any, p: Any) -> tuple[tuple[float, Any], ...]:
        """Times of the command that are followed at ``t`` [s] (or at many), each with its weight.

        Two, of the Gauss rule for delays that have a gamma distribution (docs, theory: what differs along a rod).
        """
        root = math.sqrt(p.spread * (1.0 + p.spread))
        if p.lag == 0.0 or root == 0.0:
            return ((1.0, t - p.lag),)
        less = 0.5 * (1.0 + math.sqrt(p.spread / (1.0 + p.spread)))  # weight of the shorter delay
        mean = 1.0 + p.spread
        return (less, t - p.lag * (mean - root)), (1.0 - less, t - p.lag * (mean + root))

    def orientation(self, t: float, p: Any) -> np.ndarray:
        """Rotation from the initial orientation, shape (3, 3): the mean of those that are followed."""
        pairs = self.followed(t, p)
        if len(pairs) == 1 or "orientation" not in self.holds:
            return super().orientation(pairs[0][1], p)
        (_, early), (share, late) = pairs
        return mean_rotation(super().orientation(early, p), super().orientation(late, p), share)


class ImperfectMotion(_Shifted, PrescribedMotion):
    """Prescribed motion that is not followed exactly: x = x0 + R(t - lag) shift + (1 + gain) position(t - lag).

    R turns by 1 + turning times the angle that is prescribed, about the same axis. With a ``spread`` of the delays R
    and position are means over times about t - lag.

    For a shaker that runs late or falls short, and a mount beside the place where it was measured.

    Parameters
    ----------
    gain : float or Parameter
        Relative change of the displacement [1].
    turning : float or Parameter
        Relative change of the angle of rotation from the initial orientation [1], below half a turn.
    shift_x, shift_y, shift_z : float or Parameter
        Offset of what is held, turning with the prescribed orientation [m].
    lag : float or Parameter
        Mean delay against what is prescribed [s].
    spread : float or Parameter
        Variance of the delays over the lag's square [1]: 0 for one delay, 1 for a lag of first order.
    """

    source = "essential boundary condition; docs, theory: what differs along a rod (grips)"
    gain = Parameter(0.0, unit="1", bounds=(-1.0, None), null=0.0, doc="relative change of the displacement")
    turning = Parameter(
        0.0, unit="1", bounds=(-1.0, None), null=0.0, doc="relative change of the angle of rotation"
    )
    example: ClassVar[dict[str, Any]] = {
        "position": lambda t: np.array([0.01 * np.sin(t), 0.0, 0.0]),
        "orientation": lambda t: np.array([0.0, 0.0, np.sin(0.2 * t), np.cos(0.2 * t)]),
        "gain": 0.1, "turning": 0.1, "shift_x": 1e-3, "shift_y": 1e-3, "shift_z": -1e-3, "lag": 0.1, "spread": 0.5,
    }  # fmt: skip

    def orientation(self, t: float, p: Any) -> np.ndarray:
        """Rotation from the initial orientation, shape (3, 3)."""
        R = super().orientation(t, p)
        if p.turning == 0.0 or self.rotation is None:
            return R
        return np.asarray(
            Rotation.from_rotvec((1.0 + p.turning) * Rotation.from_matrix(R).as_rotvec()).as_matrix()
        )

    def position(self, t: float, x0: np.ndarray, p: Any) -> np.ndarray:
        """Positions of the held nodes [m], shape (n, 3)."""
        R = self.orientation(t, p)
        moved = self.shift(R, p)
        if self.displacement is not None:
            for weight, s in self.followed(t, p):
                moved += weight * (1.0 + p.gain) * self.displacement(s)
        return turned(x0, R) + moved

    def many(self, times: np.ndarray, x0: np.ndarray, p: Any) -> tuple[np.ndarray, np.ndarray]:
        """Positions and rotations at many times, shapes (m, n, 3) and (m, 3, 3)."""
        pairs = self.followed(times, p)
        R = self.rotations(pairs[0][1])
        if len(pairs) > 1 and self.rotation is not None:
            R = mean_rotation(R, self.rotations(pairs[1][1]), pairs[1][0])
        if p.turning != 0.0 and self.rotation is not None:
            R = Rotation.from_rotvec((1.0 + p.turning) * Rotation.from_matrix(R).as_rotvec()).as_matrix()
        moved = R @ np.array([p.shift_x, p.shift_y, p.shift_z])
        if self.displacement is not None:
            moved = moved + (1.0 + p.gain) * sum(weight * self.displacement.many(s) for weight, s in pairs)
        return turned(x0, R) + moved[:, None], R


class ImperfectGrasp(_Shifted, Grasp):
    """A grasp beside the place where it was measured, or late: the held edge is shifted and follows with a delay.

    Parameters
    ----------
    shift_x, shift_y, shift_z : float or Parameter
        Offset of the held edge, which turns with a no-spin gripper [m].
    lag : float or Parameter
        Mean delay against what was measured [s].
    spread : float or Parameter
        Variance of the delays over the lag's square [1]: 0 for one delay, 1 for a lag of first order.
    """

    source = "essential boundary condition; docs, theory: what differs along a rod (grips)"
    example: ClassVar[dict[str, Any]] = {
        "position": lambda t: np.array([0.0, 0.0, 0.01 * np.sin(t)]),
        "tangent": lambda t: np.array([1.0, 0.1 * np.sin(t), 0.0]),
        "twist": "no-spin", "duration": 1.0, "shift_x": 1e-3, "shift_y": 1e-3, "shift_z": -1e-3, "lag": 0.1,
        "spread": 0.5,
    }  # fmt: skip

    def position(self, t: float, x0: np.ndarray, p: Any) -> np.ndarray:
        """Positions of the edge's two nodes [m], shape (2, 3); its length is kept."""
        pairs = self.followed(t, p)
        x = np.sum([w * super(ImperfectGrasp, self).position(s, x0, p) for w, s in pairs], axis=0)
        if len(pairs) > 1:
            x[1] = x[0] + (x[1] - x[0]) * np.linalg.norm(x0[1] - x0[0]) / np.linalg.norm(x[1] - x[0])
        return np.asarray(x + self.shift(self.orientation(t, p), p))
