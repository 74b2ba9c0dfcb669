"""Media whose resistance depends on the speed: shear-thinning fluids, and fluids with a yield stress."""

from __future__ import annotations

import copy
import math
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.compiled import inlined, kernel
from rodnet.errors import TermError
from rodnet.parameters import Parameter
from rodnet.terms.base import BoundTerm
from rodnet.terms.drag.line import line_sites
from rodnet.terms.drag.required import require
from rodnet.terms.drag.resistive import FORMULAS, ResistiveForce
from rodnet.terms.drag.slip import BoundSlipLaw, SlipLaw

if TYPE_CHECKING:
    from rodnet.solve.model import Model


class SpeedDependentForce(SlipLaw):
    """Drag f = -M_t v_t - M_n v_n whose resistances depend on the square of the speed.

    Laws derive from it and implement `resistances`. The shape numbers zeta are the coefficients of
    resistive force theory over the viscosity: of a formula, or given.

    Parameters
    ----------
    zeta_t, zeta_n : float or Parameter, optional
        Shape numbers along and across [1]; both or none.
    coefficients, length
        What gives them otherwise, as in `ResistiveForce`.
    axial_torque : bool
        Let the speed be that of the surface, v^2 + (r w)^2 with the spin w, and add the torque against it.
    """

    zeta_t = Parameter(None, unit="1", bounds=(0, None), kind="shape", doc="drag along, over viscosity")
    zeta_n = Parameter(None, unit="1", bounds=(0, None), kind="shape", doc="drag across, over viscosity")
    claims: ClassVar[set[str]] = {"dissipative", "objective"}
    required: ClassVar[tuple[str, ...]] = ()  # parameters that must be given

    def __init__(
        self,
        on: Any = "*",
        *,
        coefficients: str = "gray-hancock",
        length: float | None = None,
        **options: Any,
    ) -> None:
        super().__init__(on, **options)
        require(self, *self.required)
        direct = [p.value is not None for p in (self.zeta_t, self.zeta_n)]
        if any(direct) != all(direct):
            raise TermError(f"{type(self).__name__}: give both zeta_t= and zeta_n=, or neither")
        self.direct = all(direct)
        # the formula of a fluid of viscosity 1 Pa s, with its checks
        self.shape = ResistiveForce(on, viscosity=1.0, coefficients=coefficients, length=length)

    def resistances(
        self, square: np.ndarray, radius: np.ndarray, zeta: tuple[Any, Any], p: Any
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Resistances M_t and M_n [Pa s] and their derivatives by the squared speed, shape (n, 1) each.

        Parameters
        ----------
        square, radius : ndarray, shape (n, 1)
            Squared speed [m^2/s^2] and radius [m].
        zeta : tuple
            Shape numbers along and across [1].
        p
            Parameters.
        """
        raise TermError(f"{type(self).__name__} must implement resistances(self, square, radius, zeta, p)")

    def spin_resistance(
        self, square: np.ndarray, radius: np.ndarray, p: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        """Torque per length over the spin [N s] and its derivative by the squared speed, shape (n, 1) each.

        The stress that the law puts on a surface that slides, on one that turns: ``zeta_t`` of 4 pi, the
        exact number of a cylinder in a fluid of constant viscosity, at the arm r.
        """
        zeta = 4.0 * np.pi, 0.0
        M, _, slope, _ = self.resistances(square, radius, zeta, p)
        return radius**2 * M, radius**2 * slope

    def _square(self, site: Any, spin: Any = 0.0) -> np.ndarray:
        return np.sum(site.v**2, axis=1, keepdims=True) + (site.radius[:, None] * spin) ** 2

    def _resistances(self, site: Any, p: Any, spin: Any = 0.0) -> tuple[np.ndarray, ...]:
        zeta, radius = (p.zeta_t, p.zeta_n), site.radius[:, None]
        if p.zeta_t is None:
            zeta = FORMULAS[self.shape.formula](1.0, self.shape.length or 1.0, radius)
        return self.resistances(self._square(site, spin), radius, zeta, p)

    def force(self, site: Any, p: Any, spin: Any = 0.0) -> np.ndarray:
        """Force per unit length [N/m], shape (n, 3), of a surface that turns by ``spin`` [rad/s], (n, 1)."""
        M_t, M_n, _, _ = self._resistances(site, p, spin)
        along = np.sum(site.v * site.tangent, axis=1, keepdims=True) * site.tangent
        return -M_n * site.v - (M_t - M_n) * along

    def jacobian(
        self, site: Any, p: Any, m_old: np.ndarray | None = None, spin: Any = 0.0
    ) -> dict[str, np.ndarray]:
        """Derivatives of the force by velocity, tangent and place, shape (n, 3, 3) each."""
        v, t, one = site.v, site.tangent, np.eye(3)
        M_t, M_n, slope_t, slope_n = (c[:, :, None] for c in self._resistances(site, p, spin))
        a = np.sum(v * t, axis=1)[:, None, None]
        outer = lambda b, c: b[:, :, None] * c[:, None, :]  # noqa: E731
        by_v = -M_n * one - (M_t - M_n) * outer(t, t)
        by_v -= 2.0 * (slope_n * outer(v, v) + (slope_t - slope_n) * a * outer(t, v))
        by_t = -(M_t - M_n) * (a * one + outer(t, v))
        return {"v": by_v, "tangent": by_t, "x": np.zeros_like(by_v)}

    def slip_load(self, site: Any, spin: np.ndarray, p: Any) -> tuple[np.ndarray, np.ndarray]:
        """Force [N/m] and torque [N] per unit length, shapes (n, 3) and (n, 1)."""
        M, _ = self.spin_resistance(self._square(site, spin), site.radius[:, None], p)
        return self.force(site, p, spin), -M * spin

    def slip_jacobian(self, site: Any, spin: np.ndarray, p: Any) -> dict[str, np.ndarray]:
        """Derivatives of force and torque, shapes (n, 4, 3) and, by the spin, (n, 4)."""
        radius, v, t = site.radius[:, None], site.v, site.tangent
        _, _, slope_t, slope_n = self._resistances(site, p, spin)
        M, slope = self.spin_resistance(self._square(site, spin), radius, p)
        known = self.jacobian(site, p, spin=spin)
        by_v = np.concatenate([known["v"], (-2.0 * slope * spin * v)[:, None, :]], axis=1)
        none = np.zeros((len(v), 1, 3))
        by_t, by_x = (np.concatenate([known[key], none], axis=1) for key in ("tangent", "x"))
        along = np.sum(v * t, axis=1, keepdims=True) * t
        double = 2.0 * radius**2 * spin  # of the squared speed by the spin
        by_spin = -double * np.concatenate([slope_n * v + (slope_t - slope_n) * along, slope * spin], axis=1)
        by_spin[:, 3:] -= M
        return {"v": by_v, "tangent": by_t, "x": by_x, "spin": by_spin}

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the sites of the rods that ``on`` names, with the shape numbers that they have there."""
        sites = line_sites(model, self.on, self.tangent)
        if self.direct:
            return BoundSlipLaw(self, model, sites) if self.axial_torque else super().bind(model)
        law = copy.copy(self)
        zeta = self.shape.site_coefficients(model, sites, type(self).__name__, "zeta_t=, zeta_n=")
        law.zeta_t, law.zeta_n = (
            p.with_value(z) for p, z in zip((self.zeta_t, self.zeta_n), zeta.T, strict=True)
        )
        return (
            BoundSlipLaw(law, model, sites)
            if self.axial_torque
            else super(SpeedDependentForce, law).bind(model)
        )


@inlined
def _fill(v, tangent, M_t, M_n, slope_t, slope_n, f, dfdv, dfdtangent):
    a = v[0] * tangent[0] + v[1] * tangent[1] + v[2] * tangent[2]
    less = M_t - M_n
    for i in range(3):
        f[i] = -M_n * v[i] - less * a * tangent[i]
        slope = 2.0 * (slope_n * v[i] + (slope_t - slope_n) * a * tangent[i])
        for j in range(3):
            dfdv[i, j] = -less * tangent[i] * tangent[j] - slope * v[j]
            dfdtangent[i, j] = -less * tangent[i] * v[j]
        dfdv[i, i] -= M_n
        dfdtangent[i, i] -= less * a


@kernel
def _power_law(v, x, tangent, radius, t, p, f, dfdv, dfdtangent):
    zeta_t, zeta_n, viscosity, rate, exponent = p
    scale = 1.0 / (radius * rate) ** 2
    base = 1.0 + scale * (v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    mu = viscosity * base ** (0.5 * (exponent - 1.0))
    slope = 0.5 * (exponent - 1.0) * scale * mu / base
    _fill(v, tangent, zeta_t * mu, zeta_n * mu, zeta_t * slope, zeta_n * slope, f, dfdv, dfdtangent)


class PowerLawForce(SpeedDependentForce):
    """Drag of a shear-thinning fluid, mu = viscosity (1 + (v / (r rate))^2)^((exponent - 1) / 2).

    Resistive force theory with the viscosity at the shear rate v/r beside the rod: Carreau's law,
    which is a power law where the shear is faster than ``rate``, and Newtonian where it is slower.

    Parameters
    ----------
    viscosity : float or Parameter
        Viscosity at rest [Pa s].
    rate : float or Parameter
        Shear rate at which the power law begins [1/s]; its consistency is viscosity rate^(1 - exponent).
    exponent : float or Parameter
        1 is Newtonian, less is thinning, more is thickening [1].
    """

    viscosity = Parameter(None, unit="Pa s", bounds=(0, None), null=0.0, doc="viscosity at rest")
    rate = Parameter(
        None, unit="1/s", bounds=(1e-12, None), kind="shape", doc="rate where the power law begins"
    )
    exponent = Parameter(None, unit="1", bounds=(0, None), kind="shape", doc="exponent of the power law")
    source = "Carreau 1972; Riley & Lauga 2017, Phys. Rev. E 95, 062416 (local viscosity in resistive force theory)"
    required = ("viscosity", "rate", "exponent")
    example: ClassVar[dict[str, Any]] = {
        "zeta_t": 2.0, "zeta_n": 3.0, "viscosity": 1.0, "rate": 1.0, "exponent": 0.5,
    }  # fmt: skip
    kernel = _power_law

    def resistances(
        self, square: np.ndarray, radius: np.ndarray, zeta: tuple[Any, Any], p: Any
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Resistances [Pa s] and their derivatives by the squared speed, shape (n, 1) each."""
        scale = 1.0 / (radius * p.rate) ** 2
        base = 1.0 + scale * square
        mu = p.viscosity * base ** (0.5 * (p.exponent - 1.0))
        slope = 0.5 * (p.exponent - 1.0) * scale * mu / base
        return zeta[0] * mu, zeta[1] * mu, zeta[0] * slope, zeta[1] * slope


SMALL = 1e-2  # below which (1 - exp(-y))/y is summed as a series


@kernel
def _bingham(v, x, tangent, radius, t, p, f, dfdv, dfdtangent):
    zeta_t, zeta_n, viscosity, yield_stress, bearing, speed = p
    y = max(math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2) / speed, 1e-100)
    if y < SMALL:
        h = 1.0 - y * (1.0 / 2.0 - y * (1.0 / 6.0 - y * (1.0 / 24.0 - y / 120.0)))
        slope = -1.0 / 2.0 + y * (1.0 / 3.0 - y * (1.0 / 8.0 - y * (1.0 / 30.0 - y / 144.0)))
    else:
        h = -math.expm1(-y) / y
        slope = (math.exp(-y) - h) / y
    stress = yield_stress * radius / speed
    along, across = 2.0 * math.pi * stress, 2.0 * bearing * stress
    slope /= 2.0 * y * speed**2
    _fill(
        v, tangent, zeta_t * viscosity + along * h, zeta_n * viscosity + across * h, along * slope,
        across * slope, f, dfdv, dfdtangent,
    )  # fmt: skip


class BinghamForce(SpeedDependentForce):
    """Drag of a fluid with a yield stress, f = -f_y(direction) (1 - exp(-v/speed)) - viscous drag.

    The yield forces per unit length are 2 pi r yield_stress along the rod (the stress on its
    surface) and 2 r bearing yield_stress across it (plasticity theory of a pile in clay); the viscous
    part is resistive force theory with the plastic viscosity. Below the yield force the rod creeps no
    faster than about ``speed``, which takes the place of rest (after Papanastasiou).

    Parameters
    ----------
    viscosity : float or Parameter
        Plastic viscosity [Pa s].
    yield_stress : float or Parameter
        Yield stress [Pa].
    bearing : float or Parameter
        Bearing capacity number [1]: 9.14 for a smooth rod, 4 sqrt(2) + 2 pi = 11.94 for a rough one.
    speed : float or Parameter
        Regularisation speed [m/s], well below the speeds of interest.
    """

    viscosity = Parameter(None, unit="Pa s", bounds=(0, None), null=0.0, doc="plastic viscosity")
    yield_stress = Parameter(None, unit="Pa", bounds=(0, None), null=0.0, doc="yield stress")
    bearing = Parameter(
        4.0 * math.sqrt(2.0) + 2.0 * math.pi, unit="1", bounds=(0, None), kind="shape", doc="bearing capacity"
    )
    speed = Parameter(1e-5, unit="m/s", bounds=(1e-12, None), kind="shape", doc="regularisation speed")
    source = (
        "Randolph & Houlsby 1984, Geotechnique 34, 613 (yield across); Papanastasiou 1987, J. Rheol. 31, 385"
    )
    required = ("viscosity", "yield_stress")
    example: ClassVar[dict[str, Any]] = {
        "zeta_t": 2.0, "zeta_n": 3.0, "viscosity": 1.0, "yield_stress": 10.0,
    }  # fmt: skip
    kernel = _bingham

    def resistances(
        self, square: np.ndarray, radius: np.ndarray, zeta: tuple[Any, Any], p: Any
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Resistances [Pa s] and their derivatives by the squared speed, shape (n, 1) each."""
        y = np.maximum(np.sqrt(square) / p.speed, 1e-100)
        large = np.maximum(y, SMALL)
        h = -np.expm1(-large) / large
        slope = (np.exp(-large) - h) / large
        series = 1.0 - y * (1 / 2 - y * (1 / 6 - y * (1 / 24 - y / 120)))
        series_slope = -1 / 2 + y * (1 / 3 - y * (1 / 8 - y * (1 / 30 - y / 144)))
        h, slope = np.where(y < SMALL, series, h), np.where(y < SMALL, series_slope, slope)
        stress = p.yield_stress * radius / p.speed
        along, across = 2.0 * np.pi * stress, 2.0 * p.bearing * stress
        slope = slope / (2.0 * y * np.square(p.speed))
        return (
            zeta[0] * p.viscosity + along * h,
            zeta[1] * p.viscosity + across * h,
            along * slope,
            across * slope,
        )
