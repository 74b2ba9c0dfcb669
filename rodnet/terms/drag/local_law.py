"""A force of the surroundings that has no name: a sum of simple laws of velocity, place and time."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np

from rodnet.compiled import kernel
from rodnet.parameters import Parameter
from rodnet.terms.drag.line import DragModel

AXES = "xyz"
COEFFICIENTS = (
    "linear", "along", "square", "rate_free", "later", *(f"g{a}" for a in AXES), *(f"h{a}" for a in AXES),
    *(f"k{a}{b}" for a in AXES for b in AXES), *(f"m{a}" for a in AXES),
)  # fmt: skip


@kernel
def _local_law(v, x, tangent, radius, t, p, f, dfdv, dfdtangent, dfdx):
    linear, along, square, rate_free, later = p[0], p[1], p[2], p[3], p[4]
    creep = p[23]
    a = v[0] * tangent[0] + v[1] * tangent[1] + v[2] * tangent[2]
    speed = math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2 + creep**2)
    place = p[20] * x[0] + p[21] * x[1] + p[22] * x[2]
    factor = linear + later * t + place + square * speed + rate_free / speed
    slope = square / speed - rate_free / speed**3  # d factor / d v = slope v
    for i in range(3):
        f[i] = p[5 + i] + p[8 + i] * t + factor * v[i] + along * a * tangent[i]
        for j in range(3):
            f[i] += p[11 + 3 * i + j] * x[j]
            dfdx[i, j] = p[11 + 3 * i + j] + p[20 + j] * v[i]
            dfdv[i, j] = slope * v[i] * v[j] + along * tangent[i] * tangent[j]
            dfdtangent[i, j] = along * tangent[i] * v[j]
        dfdv[i, i] += factor
        dfdtangent[i, i] += along * a


def _load(axis: str) -> Parameter:
    return Parameter(0.0, unit="N/m", null=0.0, doc=f"constant force per length, along {axis}")


def _growth(axis: str) -> Parameter:
    return Parameter(0.0, unit="N/m/s", null=0.0, doc=f"force per length along {axis}, proportional to time")


def _slope(axes: str) -> Parameter:
    return Parameter(
        0.0,
        unit="N/m^2",
        null=0.0,
        doc=f"force per length along {axes[0]}, proportional to the place {axes[1]}",
    )


def _thicker(axis: str) -> Parameter:
    doc = f"force per length along the velocity, proportional to speed and the place {axis}"
    return Parameter(0.0, unit="N s/m^3", null=0.0, doc=doc)


class LocalLaw(DragModel):
    """Force per length ``g + h t + K x + (a + e t + m.x + b s + c / s) v + d (v.t) t``, ``s = sqrt(|v|^2 + creep^2)``.

    No law of nature, but what a diagnosis describes an unexplained remainder by: a load ``g`` that may grow with
    the time ``t`` and differ from place to place; resistances that do not depend on speed, grow with it, make the
    force independent of it, or grow with time or place; and one along the rod alone. Negative coefficients resist the
    motion.

    Parameters
    ----------
    linear, along : float or Parameter
        a and d, force per length and velocity, in all directions and along the rod [N s/m^2].
    square : float or Parameter
        b, force per length and squared speed [N s^2/m^3].
    rate_free : float or Parameter
        c, force per length against or with the motion [N/m].
    later : float or Parameter
        e, by which ``linear`` grows with time [N/m^2].
    gx, gy, gz : float or Parameter
        g, constant force per length [N/m].
    hx, hy, hz : float or Parameter
        h, by which it grows with time [N/m/s].
    kxx, kxy, ..., kzz : float or Parameter
        K, by which it grows with the place: ``kxz`` is that along x per length of z [N/m^2].
    mx, my, mz : float or Parameter
        m, by which ``linear`` grows with the place [N s/m^3].
    creep : float or Parameter
        Speed below which ``rate_free`` fades [m/s].
    """

    default_name = "local_law"
    of_medium = False  # but of who knows what
    source = "docs, theory: diagnosis"
    kernel: ClassVar[Any] = _local_law
    example: ClassVar[dict[str, float]] = {
        "linear": -0.4, "along": 0.2, "square": -0.3, "rate_free": -0.02, "later": 0.1, "gz": -0.1, "hx": 0.2,
        "kxx": -1.0, "kxz": 0.5, "kyx": 0.3, "mx": -0.4, "mz": 0.7,
    }  # fmt: skip
    linear = Parameter(
        0.0, unit="N s/m^2", null=0.0, doc="force per length along the velocity, proportional to speed"
    )
    along = Parameter(
        0.0,
        unit="N s/m^2",
        null=0.0,
        doc="force per length along the rod, proportional to the speed along it",
    )
    square = Parameter(
        0.0,
        unit="N s^2/m^3",
        null=0.0,
        doc="force per length along the velocity, proportional to the speed squared",
    )
    rate_free = Parameter(
        0.0, unit="N/m", null=0.0, doc="force per length along the velocity, the same at any speed"
    )
    later = Parameter(
        0.0, unit="N/m^2", null=0.0, doc="force per length along the velocity, proportional to speed and time"
    )
    gx, gy, gz = _load("x"), _load("y"), _load("z")
    hx, hy, hz = _growth("x"), _growth("y"), _growth("z")
    kxx, kxy, kxz = _slope("xx"), _slope("xy"), _slope("xz")
    kyx, kyy, kyz = _slope("yx"), _slope("yy"), _slope("yz")
    kzx, kzy, kzz = _slope("zx"), _slope("zy"), _slope("zz")
    mx, my, mz = _thicker("x"), _thicker("y"), _thicker("z")
    creep = Parameter(
        1e-3, unit="m/s", bounds=(1e-12, None), kind="shape", doc="speed below which rate_free fades"
    )

    def force(self, site: Any, p: Any) -> np.ndarray:
        """Force per unit length [N/m], shape (n, 3)."""
        count = len(site.v)
        values = np.stack([np.broadcast_to(np.ravel(getattr(p, c)), count) for c in COEFFICIENTS], axis=1)
        others = [name for name in self.declared() if name not in COEFFICIENTS]
        rest = np.stack([np.broadcast_to(np.ravel(getattr(p, name)), count) for name in others], axis=1)
        return np.asarray(np.einsum("nm,nmi->ni", values, self.shares(site, rest)))

    def shares(self, site: Any, rest: np.ndarray) -> np.ndarray:
        """Force per unit length [N/m] that each coefficient makes if it is one, in their order, shape (n, m, 3).

        The ``rest`` of the parameters, ``creep`` [m/s] here, has shape (n, 1).
        """
        v, t = site.v, site.tangent
        speed = np.sqrt(np.sum(v * v, axis=1, keepdims=True) + rest**2)
        out = np.zeros((len(v), len(COEFFICIENTS), 3))
        out[:, 0], out[:, 1] = v, np.sum(v * t, axis=1, keepdims=True) * t
        out[:, 2], out[:, 3], out[:, 4] = speed * v, v / speed, site.t * v
        for i in range(3):
            out[:, 5 + i, i], out[:, 8 + i, i] = 1.0, site.t
            out[:, 11 + 3 * i : 14 + 3 * i, i] = site.x
            out[:, 20 + i] = site.x[:, [i]] * v
        return out
