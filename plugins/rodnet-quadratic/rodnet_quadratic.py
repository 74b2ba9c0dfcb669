"""Form drag on rods, quadratic in the velocity: what a plug-in with a drag law looks like."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

import rodnet as rn


@rn.kernel
def _quadratic(v, x, tangent, radius, t, p, f, dfdv, dfdtangent):
    """Fill force per length and derivatives at one site; ``p = (c,)``."""
    c = p[0]
    speed = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    for i in range(3):
        f[i] = -c * speed * v[i]
        dfdv[i, i] = -c * speed
        for j in range(3):
            if speed > 0.0:
                dfdv[i, j] -= c * v[i] * v[j] / speed


class Quadratic(rn.DragModel):
    """Form drag per unit length, f = -c |v| v.

    Parameters
    ----------
    on : str or sequence of str
        The rods that feel it.
    c : float or Parameter
        Coefficient [N s^2/m^3]: 1/2 rho Cd d for a rod of diameter d across the flow.
    """

    source = "form drag at high Reynolds number, c = 1/2 rho Cd d"
    claims = {"dissipative", "objective"}
    c = rn.Parameter(1.0, unit="N s^2/m^3", bounds=(0, None), null=0.0, doc="coefficient, 1/2 rho Cd d")
    kernel = _quadratic

    def force(self, site: Any, p: Any) -> np.ndarray:
        """Force per unit length [N/m], shape (n, 3)."""
        return -p.c * rn.norm(site.v) * site.v

    def jacobian(self, site: Any, p: Any) -> dict[str, np.ndarray]:
        """Derivatives by velocity, tangent and position, shape (n, 3, 3) each."""
        speed = rn.norm(site.v)[:, :, None]
        outer = site.v[:, :, None] * site.v[:, None, :] / np.maximum(speed, np.finfo(float).tiny)
        zero = np.zeros_like(outer)
        c = np.asarray(p.c)[..., None]
        return {"v": -c * (speed * np.eye(3) + outer), "tangent": zero, "x": zero}
