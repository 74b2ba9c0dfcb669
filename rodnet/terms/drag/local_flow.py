"""A current in a patch of the medium: an eddy, a jet, as a diagnosis describes it."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from rodnet.parameters import Parameter
from rodnet.terms.drag.change import Current
from rodnet.terms.drag.changes import MEDIUM
from rodnet.terms.drag.uneven import AXES, STEADY, current_along, shear


def middle_along(axis: str) -> Parameter:
    """The middle of a patch."""
    return Parameter(0.0, unit="m", kind="shape", doc=f"middle of the patch along {axis}")


def width_of_patch() -> Parameter:
    """How wide a patch is."""
    return Parameter(0.1, unit="m", bounds=(1e-6, None), kind="shape", doc="where it has faded to 1/e")


class LocalFlow(Current):
    """A current ``(U + A (x - c)) exp(-|x - c|^2 / width^2)``: the model's laws against it.

    No law of nature, but what a diagnosis describes a current by that is not everywhere: a jet is a U, an eddy an A
    whose parts across the diagonal are opposite.

    Parameters
    ----------
    ux, uy, uz, axx, axy, ..., azz : float or Parameter
        U [m/s] and A [1/s]: ``axz`` is the growth of the current along x per length of z.
    x, y, z : float or Parameter
        Middle c of the patch [m].
    width : float or Parameter
        Distance from the middle at which the current has faded to 1/e [m].
    """

    default_name = "local_flow"
    source = "docs, theory: diagnosis"
    claims: ClassVar[set[str]] = set()
    example: ClassVar[dict[str, float]] = {
        "ux": 0.05, "uz": -0.02, "axz": 0.8, "azx": -0.8, "x": 0.02, "z": 0.03, "width": 0.1, **MEDIUM,
    }  # fmt: skip
    ux, uy, uz = (current_along(a, "in the middle") for a in AXES)
    axx, axy, axz = (shear("x" + a, "in the middle") for a in AXES)
    ayx, ayy, ayz = (shear("y" + a, "in the middle") for a in AXES)
    azx, azy, azz = (shear("z" + a, "in the middle") for a in AXES)
    x, y, z = (middle_along(a) for a in AXES)
    width = width_of_patch()

    def coefficients(self, p: Any) -> np.ndarray:
        """Values of U at the origin, A row by row, and zeros of what pulses, shape (24,)."""
        values = np.array([getattr(p, name) for name in STEADY], dtype=float)
        values[:3] -= values[3:].reshape(3, 3) @ self.window(p)[:3]
        return np.concatenate([values, np.zeros(12)])

    def window(self, p: Any) -> np.ndarray:
        """Middle [m] and 1/width^2 [1/m^2], shape (4,)."""
        return np.array([p.x, p.y, p.z, 1.0 / p.width**2], dtype=float)
