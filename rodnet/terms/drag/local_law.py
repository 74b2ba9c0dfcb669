"""A force of the surroundings that has no name: a sum of simple laws of the velocity, each with a coefficient."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np

from rodnet.compiled import kernel
from rodnet.parameters import Parameter
from rodnet.terms.drag.line import DragModel


@kernel
def _local_law(v, x, tangent, radius, t, p, f, dfdv, dfdtangent):
    gx, gy, gz, linear, along, square, rate_free, creep = p
    a = v[0] * tangent[0] + v[1] * tangent[1] + v[2] * tangent[2]
    speed = math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2 + creep**2)
    factor = linear + square * speed + rate_free / speed
    slope = square / speed - rate_free / speed**3  # d factor / d v = slope v
    g = (gx, gy, gz)
    for i in range(3):
        f[i] = g[i] + factor * v[i] + along * a * tangent[i]
        for j in range(3):
            dfdv[i, j] = slope * v[i] * v[j] + along * tangent[i] * tangent[j]
            dfdtangent[i, j] = along * tangent[i] * v[j]
        dfdv[i, i] += factor
        dfdtangent[i, i] += along * a


class LocalLaw(DragModel):
    """Force per length ``g + (a + b s + c / s) v + d (v.t) t`` with ``s = sqrt(|v|^2 + creep^2)``; no law of nature.

    What a diagnosis describes an unexplained remainder by: a load ``g``, resistances that do not depend on
    speed, grow with it, or make the force independent of it, and one along the rod alone. Negative coefficients
    resist the motion.

    Parameters
    ----------
    gx, gy, gz : float or Parameter
        Constant force per length [N/m].
    linear, along : float or Parameter
        Force per length and velocity, in all directions and along the rod [N s/m^2].
    square : float or Parameter
        Force per length and squared speed [N s^2/m^3].
    rate_free : float or Parameter
        Force per length against or with the motion [N/m].
    creep : float or Parameter
        Speed below which that fades [m/s].
    """

    default_name = "local_law"
    source = "docs, theory: diagnosis"
    kernel: ClassVar[Any] = _local_law
    gx = Parameter(0.0, unit="N/m", null=0.0, doc="constant force per length, along x")
    gy = Parameter(0.0, unit="N/m", null=0.0, doc="along y")
    gz = Parameter(0.0, unit="N/m", null=0.0, doc="along z")
    linear = Parameter(0.0, unit="N s/m^2", null=0.0, doc="per velocity")
    along = Parameter(0.0, unit="N s/m^2", null=0.0, doc="per velocity along the rod")
    square = Parameter(0.0, unit="N s^2/m^3", null=0.0, doc="per squared speed")
    rate_free = Parameter(0.0, unit="N/m", null=0.0, doc="in the direction of motion")
    creep = Parameter(
        1e-3, unit="m/s", bounds=(1e-12, None), kind="shape", doc="speed below which that fades"
    )

    def force(self, site: Any, p: Any) -> np.ndarray:
        """Force per unit length [N/m], shape (n, 3)."""
        v, t = site.v, site.tangent
        speed = np.sqrt(np.sum(v * v, axis=1, keepdims=True) + p.creep**2)
        factor = p.linear + p.square * speed + p.rate_free / speed
        g = np.stack([np.broadcast_to(np.ravel(c), len(v)) for c in (p.gx, p.gy, p.gz)], axis=1)
        return g + factor * v + p.along * np.sum(v * t, axis=1, keepdims=True) * t
