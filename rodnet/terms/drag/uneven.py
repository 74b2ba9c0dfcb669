"""A current that differs from place to place and pulses: a stirred medium, as a diagnosis describes it."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from rodnet.parameters import Parameter
from rodnet.terms.drag.change import Current
from rodnet.terms.drag.changes import MEDIUM

AXES = "xyz"
STEADY = (*(f"u{a}" for a in AXES), *(f"a{a}{b}" for a in AXES for b in AXES))
LATER = (*(f"v{a}" for a in AXES), *(f"b{a}{b}" for a in AXES for b in AXES))


def current_along(axis: str, part: str) -> Parameter:
    """Parameter of a current along an axis, in a place or part of a period."""
    return Parameter(0.0, unit="m/s", null=0.0, doc=f"current along {axis}, {part}")


def shear(axes: str, part: str) -> Parameter:
    """Parameter of the growth of a current."""
    doc = f"by which the current along {axes[0]} grows per length of {axes[1]}, {part}"
    return Parameter(0.0, unit="1/s", null=0.0, doc=doc)


class UnevenFlow(Current):
    """A current ``(U + A x) cos(w t) + (V + B x) sin(w t)``, ``w = 2 pi frequency``: the model's laws against it.

    No law of nature, but what a diagnosis describes a current by of which nothing is known: to first order in the
    place, and steady (``frequency=0``) or pulsing.

    Parameters
    ----------
    ux, uy, uz, axx, axy, ..., azz : float or Parameter
        U [m/s] and A [1/s]: ``axz`` is the growth of the current along x per length of z.
    vx, vy, vz, bxx, bxy, ..., bzz : float or Parameter
        V [m/s] and B [1/s], a quarter of a period later.
    frequency : float or Parameter
        Of the pulses [Hz].
    """

    default_name = "uneven_flow"
    source = "docs, theory: diagnosis"
    claims: ClassVar[set[str]] = set()
    example: ClassVar[dict[str, float]] = {
        "ux": 0.05, "uz": -0.02, "axz": 0.8, "ayx": -0.5, "vy": 0.04, "bzx": 0.6, "frequency": 0.7, **MEDIUM,
    }  # fmt: skip
    ux, uy, uz = (current_along(a, "at the origin, at first") for a in AXES)
    axx, axy, axz = (shear("x" + a, "at first") for a in AXES)
    ayx, ayy, ayz = (shear("y" + a, "at first") for a in AXES)
    azx, azy, azz = (shear("z" + a, "at first") for a in AXES)
    vx, vy, vz = (current_along(a, "at the origin, a quarter of a period later") for a in AXES)
    bxx, bxy, bxz = (shear("x" + a, "a quarter of a period later") for a in AXES)
    byx, byy, byz = (shear("y" + a, "a quarter of a period later") for a in AXES)
    bzx, bzy, bzz = (shear("z" + a, "a quarter of a period later") for a in AXES)
    frequency = Parameter(0.0, unit="Hz", bounds=(0, None), kind="shape", doc="of the pulses; 0 is steady")

    def coefficients(self, p: Any) -> np.ndarray:
        """Values of U, A row by row, V and B, shape (24,)."""
        return np.array([getattr(p, name) for name in (*STEADY, *LATER)], dtype=float)

    def frequency_of(self, p: Any) -> float:
        """Frequency [Hz]."""
        return float(p.frequency)
