"""Materials and cross-sections: where the stiffnesses of a rod come from."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real

from rodnet.errors import GraphError
from rodnet.parameters import is_number


def _positive(owner: str, **values: float) -> None:
    for name, value in values.items():
        if not isinstance(value, Real) or not (math.isfinite(value) and value > 0):
            shown = value if isinstance(value, Real) else repr(value)
            raise GraphError(f"{owner}: {name} = {shown} must be a positive, finite number in SI units")


@dataclass(frozen=True)
class Material:
    """A linear elastic, isotropic material.

    Parameters
    ----------
    E : float
        Young's modulus [Pa].
    nu : float
        Poisson's ratio [1], in (-1, 0.5].
    rho : float
        Density [kg/m^3].
    """

    E: float
    nu: float = 0.5
    rho: float = 1000.0

    def __post_init__(self) -> None:
        _positive("Material", E=self.E, rho=self.rho)
        if not (is_number(self.nu) and -1.0 < self.nu <= 0.5):
            raise GraphError(f"Material: Poisson's ratio nu = {self.nu!r} must lie in (-1, 0.5]")

    @property
    def G(self) -> float:
        """Shear modulus [Pa]."""
        return self.E / (2.0 * (1.0 + self.nu))


@dataclass(frozen=True)
class Section:
    """A cross-section by its geometric moments; use one of the subclasses for common shapes.

    Attributes
    ----------
    area : float
        Area [m^2].
    I1, I2 : float
        Second moments for bending about the first (m2-axis, kappa1) and second (m1-axis, kappa2)
        curvature [m^4].
    J : float
        Torsion constant [m^4] (not the polar moment, unless the section is circular).
    radius : float
        Representative outer radius [m], for drag, pictures and contact.
    """

    area: float
    I1: float
    I2: float
    J: float
    radius: float

    def __post_init__(self) -> None:
        _positive("Section", area=self.area, I1=self.I1, I2=self.I2, J=self.J, radius=self.radius)

    @property
    def polar(self) -> float:
        """Polar second moment I1 + I2 [m^4], which gives the rotary inertia per length rho * polar."""
        return self.I1 + self.I2

    def scaled(self, factor: float) -> Section:
        """Return the similar section, ``factor`` times as large."""
        if factor == 1.0:
            return self
        fourth = factor**4
        return Section(
            factor**2 * self.area, fourth * self.I1, fourth * self.I2, fourth * self.J, factor * self.radius
        )


def circular(radius: float) -> Section:
    """Solid circle of the given radius [m]; J = pi/2 r^4 (the paper prints r^2)."""
    _positive("circular section", radius=radius)
    second = math.pi / 4.0 * radius**4
    return Section(math.pi * radius**2, second, second, 2.0 * second, radius)


def hollow(radius: float, inner: float) -> Section:
    """Circular tube with outer ``radius`` and ``inner`` radius [m]."""
    _positive("hollow section", radius=radius, inner=inner)
    if inner >= radius:
        raise GraphError(
            f"hollow section: inner radius {inner:g} m must be smaller than the outer {radius:g} m"
        )
    second = math.pi / 4.0 * (radius**4 - inner**4)
    return Section(math.pi * (radius**2 - inner**2), second, second, 2.0 * second, radius)


def elliptic(a: float, b: float) -> Section:
    """Solid ellipse with half axes ``a`` along m1 and ``b`` along m2 [m].

    kappa1 bends about m2, so I1 = pi/4 a^3 b; the torsion constant is Saint-Venant's
    pi a^3 b^3 / (a^2 + b^2).
    """
    _positive("elliptic section", a=a, b=b)
    return Section(
        math.pi * a * b,
        math.pi / 4.0 * a**3 * b,
        math.pi / 4.0 * a * b**3,
        math.pi * a**3 * b**3 / (a * a + b * b),
        math.sqrt(a * b),
    )
