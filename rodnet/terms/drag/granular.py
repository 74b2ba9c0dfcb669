"""Granular resistive force theory: drag of dry grains, independent of the rate, growing with depth."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.compiled import kernel
from rodnet.parameters import Parameter
from rodnet.terms.drag.line import line_sites
from rodnet.terms.drag.required import require
from rodnet.terms.drag.slip import BoundSlipLaw, SlipLaw

if TYPE_CHECKING:
    from rodnet.solve.model import Model
    from rodnet.terms.base import BoundTerm


def mean_depth(height: Any, surface: Any, radius: Any) -> tuple[np.ndarray, np.ndarray]:
    """Depth of what lies below the surface, averaged over a rod's height, and its slope by the depth.

    ``height`` is that of the axis [m]. The average makes the depth of a rod that comes out of the
    grains go to zero smoothly.
    """
    depth = surface - np.asarray(height)
    part = np.clip((depth + radius) / (2.0 * radius), 0.0, 1.0)  # of the rod's height that is below
    return np.where(part < 1.0, radius * part**2, depth), part


@kernel
def _granular(v, x, tangent, radius, t, p, f, dfdv, dfdtangent, dfdx):
    CF, CS, gamma, surface, speed = p
    depth = surface - x[2]
    part = min(max((depth + radius) / (2.0 * radius), 0.0), 1.0)
    w = 2.0 * radius * (radius * part * part if part < 1.0 else depth)
    s = math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2 + speed**2)
    a = (v[0] * tangent[0] + v[1] * tangent[1] + v[2] * tangent[2]) / s
    square = 0.0
    for i in range(3):
        square += (v[i] / s - a * tangent[i]) ** 2
    g = gamma / math.sqrt(1.0 + gamma**2 * square)
    B = np.empty((3, 3))
    D = np.empty((3, 3))
    for i in range(3):
        ni = v[i] / s - a * tangent[i]
        unit = CF * v[i] / s + CS * g * ni
        f[i] = -w * unit
        dfdx[i, 2] = 2.0 * radius * part * unit
        for j in range(3):
            B[i, j] = -CS * g**3 * ni * (v[j] / s - a * tangent[j])
        B[i, i] += CS * g
    for i in range(3):
        along = B[i, 0] * tangent[0] + B[i, 1] * tangent[1] + B[i, 2] * tangent[2]
        for j in range(3):
            dfdtangent[i, j] = w * (a * B[i, j] + along * v[j] / s)
            D[i, j] = B[i, j] - along * tangent[j]
        D[i, i] += CF
    for i in range(3):
        along = (D[i, 0] * v[0] + D[i, 1] * v[1] + D[i, 2] * v[2]) / s
        for j in range(3):
            dfdv[i, j] = -w / s * (D[i, j] - along * v[j] / s)


class GranularForce(SlipLaw):
    """Granular resistive force theory, f = -2 r z (CF u + CS gamma u_n / sqrt(1 + gamma^2 u_n^2)).

    u = v / sqrt(v^2 + speed^2) is the direction of motion, u_n its part across the rod, z the depth
    below the surface, averaged over the rod's height (none above it). Faster than ``speed`` the force
    does not depend on the rate; slower it is viscous, so that a rod that should stand still creeps.

    Parameters
    ----------
    CF : float or Parameter
        Frictional stress per depth [N/m^3], on the projected area 2 r per unit length.
    CS : float or Parameter
        Stress of the grains pushed aside, per depth [N/m^3].
    gamma : float or Parameter
        How soon that stress comes up as the motion turns away from the rod's axis [1].
    surface : float or Parameter
        Height z of the surface of the grains [m].
    speed : float or Parameter
        Regularisation speed [m/s], well below the speeds of interest.
    axial_torque : bool
        Let the friction oppose the slip of the rod's surface, spin included: CF (v, r w) /
        sqrt(v^2 + (r w)^2 + speed^2) instead of CF u, its last part at the arm r about the axis.

    Notes
    -----
    CF, CS and gamma have no defaults, because grains and packings differ: drag rods through yours and fit
    them. Results depend on gamma above all (the example ``snake_in_sand``). Lift,
    which the theory in a horizontal plane does not have, and drag on the rod's ends are left out.
    """

    CF = Parameter(None, unit="N/m^3", bounds=(0, None), null=0.0, doc="friction along and across, per depth")
    CS = Parameter(None, unit="N/m^3", bounds=(0, None), null=0.0, doc="stress across the rod, per depth")
    gamma = Parameter(None, unit="1", bounds=(0, None), kind="shape", doc="steepness of the stress across")
    surface = Parameter(0.0, unit="m", kind="shape", doc="height of the surface")
    speed = Parameter(1e-3, unit="m/s", bounds=(1e-12, None), kind="shape", doc="regularisation speed")
    source = (
        "form after Maladen et al. 2009, Science 325, 314; Zhang & Goldman 2014, Phys. Fluids 26, 101308; relative "
        "slip with spin: Jung et al. 2017, Phys. Fluids 29, 041702"
    )
    claims: ClassVar[set[str]] = {"dissipative"}
    example: ClassVar[dict[str, Any]] = {"CF": 1.8e5, "CS": 4.2e5, "gamma": 4.0, "surface": 0.2}
    kernel = _granular

    def __init__(self, on: Any = "*", **options: Any) -> None:
        super().__init__(on, **options)
        require(self, "CF", "CS", "gamma")

    def force(self, site: Any, p: Any) -> np.ndarray:
        """Force per unit length [N/m], shape (n, 3)."""
        return -self._width(site, p)[0] * self._unit(site, p)[0]

    def _width(self, site: Any, p: Any) -> tuple[np.ndarray, np.ndarray]:
        """2 r z and its derivative by the depth, shape (n, 1)."""
        r = site.radius[:, None]
        depth, slope = mean_depth(site.x[:, 2:], p.surface, r)
        return 2.0 * r * depth, 2.0 * r * slope

    def _unit(self, site: Any, p: Any) -> tuple[np.ndarray, ...]:
        """Minus the force at 2 r z = 1; u, u.t, u_n, the slope g, and the regularised speed."""
        s = np.sqrt(np.sum(site.v**2, axis=1, keepdims=True) + p.speed**2)
        u = site.v / s
        a = np.sum(u * site.tangent, axis=1, keepdims=True)
        n = u - a * site.tangent
        g = p.gamma / np.sqrt(1.0 + p.gamma**2 * np.sum(n**2, axis=1, keepdims=True))
        return p.CF * u + p.CS * g * n, u, a, n, g, s

    def jacobian(self, site: Any, p: Any, m_old: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Derivatives of the force by velocity, tangent and place, shape (n, 3, 3) each."""
        (w, slope), (unit, u, a, n, g, s) = self._width(site, p), self._unit(site, p)
        t, one = site.tangent, np.eye(3)
        w, a, g, s = (c[:, :, None] for c in (w, a, g, s))
        CF, CS = (np.reshape(c, (-1, 1, 1)) for c in (p.CF, p.CS))
        outer = lambda b, c: b[:, :, None] * c[:, None, :]  # noqa: E731
        B = CS * (g * one - g**3 * outer(n, n))
        by_v = -w / s * (CF * one + B @ (one - outer(t, t))) @ (one - outer(u, u))
        by_x = np.zeros_like(by_v)
        by_x[:, :, 2] = slope * unit
        return {"v": by_v, "tangent": w * (B @ (a * one + outer(t, u))), "x": by_x}

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the half edges of the rods that ``on`` names."""
        if self.axial_torque:
            return BoundSlipLaw(self, model, line_sites(model, self.on, self.tangent))
        return super().bind(model)

    def _slip(self, site: Any, spin: np.ndarray, p: Any) -> tuple[np.ndarray, ...]:
        """Slip (v, r w) over its regularised length, shape (n, 4), that length, and that without spin."""
        slip = np.concatenate([site.v, site.radius[:, None] * spin], axis=1)
        S, s = (np.sqrt(np.sum(c**2, axis=1, keepdims=True) + p.speed**2) for c in (slip, site.v))
        return slip / S, S, s

    def slip_load(self, site: Any, spin: np.ndarray, p: Any) -> tuple[np.ndarray, np.ndarray]:
        """Force [N/m] and torque [N] per unit length, shapes (n, 3) and (n, 1)."""
        w, _ = self._width(site, p)
        slip, _, s = self._slip(site, spin, p)
        # the force without spin, its friction turned towards the slip of the surface
        force = self.force(site, p) - w * p.CF * (slip[:, :3] - site.v / s)
        return force, -w * p.CF * site.radius[:, None] * slip[:, 3:]

    def slip_jacobian(self, site: Any, spin: np.ndarray, p: Any) -> dict[str, np.ndarray]:
        """Derivatives of force and torque, shapes (n, 4, 3) and, by the spin, (n, 4)."""
        (w, slope), r = self._width(site, p), site.radius[:, None]
        slip, S, s = self._slip(site, spin, p)
        u, known = site.v / s, self.jacobian(site, p)
        arm = np.concatenate([np.ones_like(u), r], axis=1)  # of each component of the load
        by_slip = -(w * p.CF / S)[:, :, None] * (np.eye(4) - slip[:, :, None] * slip[:, None, :])
        by_slip = arm[:, :, None] * by_slip
        friction = np.eye(3) - u[:, :, None] * u[:, None, :]
        by_v, by_x = by_slip[:, :, :3].copy(), np.zeros((len(u), 4, 3))
        by_v[:, :3] += known["v"] + (w * p.CF / s)[:, :, None] * friction
        by_x[:, :, 2] = slope * p.CF * arm * slip  # the height takes from the depth
        by_x[:, :3, 2] += known["x"][:, :, 2] - slope * p.CF * u
        by_t = np.concatenate([known["tangent"], np.zeros((len(u), 1, 3))], axis=1)
        return {"v": by_v, "tangent": by_t, "x": by_x, "spin": by_slip[:, :, 3] * r}
