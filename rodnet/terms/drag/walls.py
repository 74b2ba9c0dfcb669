"""Viscous drag beside walls: a plane, and a tube around the rods."""

from __future__ import annotations

import copy
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import TermError
from rodnet.parameters import Parameter
from rodnet.terms.base import BoundTerm
from rodnet.terms.drag.line import DragModel, line_sites
from rodnet.terms.drag.required import require
from rodnet.terms.drag.resistive import smooth_chain_lengths

if TYPE_CHECKING:
    from rodnet.solve.model import Model

SLENDER = 5.0  # least L/r: below, images of the rod as a line of forces mean nothing


class WalledForce(DragModel):
    """Resistive force theory beside a wall: drag along, across, and across towards the wall.

    f = -eta_t v_t - eta_n v_n - (eta_w - eta_n) (v . m) m with m the part across the rod of the unit
    vector w from the wall. Walls derive from it and implement `place` and `resistances`.

    Parameters
    ----------
    viscosity : float or Parameter
        Dynamic viscosity [Pa s].
    roughness : float or Parameter
        Smallest gap between rod and wall, over the rod's radius [1]: nearer, drag grows no more.
    length : float, optional
        The L of Gray and Hancock [m], by default the smooth chain's, as in `ResistiveForce`.
    """

    viscosity = Parameter(None, unit="Pa s", bounds=(0, None), null=0.0, doc="dynamic viscosity")
    roughness = Parameter(0.01, unit="1", bounds=(1e-9, None), kind="shape", doc="smallest gap over radius")
    claims: ClassVar[set[str]] = {"dissipative"}

    def __init__(self, on: Any = "*", *, length: Any = None, **options: Any) -> None:
        super().__init__(on, **options)
        require(self, "viscosity")
        if length is not None and not length > 0:
            raise TermError(f"{type(self).__name__}: length = {length!r} must be positive [m]")
        self.length = length

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the sites of the rods that ``on`` names, with the length that each belongs to."""
        sites = line_sites(model, self.on, self.tangent)
        length = smooth_chain_lengths(model)[sites.edgeA] if self.length is None else self.length
        slender = length / sites.radius
        if slender.min() < SLENDER:
            worst = model.graph.edge_name(int(sites.edgeA[np.argmin(slender)]))
            raise TermError(
                f"{type(self).__name__}: the rod at '{worst}' is not slender (L/r = {slender.min():.2g}); give length="
            )
        self.fits(model, sites.node, sites.radius)
        law = copy.copy(self)
        law.length = np.reshape(length, (-1, 1))
        return super(WalledForce, law).bind(model)

    def fits(self, model: Model, node: np.ndarray, radius: np.ndarray) -> None:
        """Raise `TermError` for a rod that starts in the wall."""

    def place(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where places are against the wall.

        Returns
        -------
        d : ndarray, shape (n, 1)
            The coordinate that `resistances` depend on [m].
        w : ndarray, shape (n, 3)
            Unit vector along which it grows.
        dw : ndarray, shape (n, 3, 3)
            Derivative of w by the place [1/m].
        """
        raise TermError(f"{type(self).__name__} must implement place(self, x)")

    def resistances(self, d: np.ndarray, radius: np.ndarray, length: Any, p: Any) -> np.ndarray:
        """Resistances over viscosity and their derivatives by d, shape (2, 3, n, 1).

        The three are those along the rod, across it along the wall, and across it towards the wall.
        """
        raise TermError(f"{type(self).__name__} must implement resistances(self, d, radius, length, p)")

    def _parts(self, site: Any, p: Any) -> SimpleNamespace:
        d, w, dw = self.place(site.x)
        eta, slope = self.resistances(d, site.radius[:, None], 1.0 if self.length is None else self.length, p)
        dot = lambda a, b: np.sum(a * b, axis=1, keepdims=True)  # noqa: E731
        v, t = site.v, site.tangent
        m = w - dot(w, t) * t
        return SimpleNamespace(
            eta=p.viscosity * eta,
            slope=p.viscosity * slope,
            w=w,
            dw=dw,
            m=m,
            a=dot(v, t),
            b=dot(v, m),
            c=dot(w, t),
        )

    def force(self, site: Any, p: Any) -> np.ndarray:
        """Force per unit length [N/m], shape (n, 3)."""
        k = self._parts(site, p)
        eta_t, eta_n, eta_w = k.eta
        return -eta_n * site.v - (eta_t - eta_n) * k.a * site.tangent - (eta_w - eta_n) * k.b * k.m

    def jacobian(self, site: Any, p: Any, m_old: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Derivatives of the force by velocity, tangent and place, shape (n, 3, 3) each."""
        k, v, t, one = self._parts(site, p), site.v, site.tangent, np.eye(3)
        outer = lambda b, c: b[:, :, None] * c[:, None, :]  # noqa: E731
        eta_t, eta_n, eta_w = k.eta[:, :, :, None]
        a, b, c = (s[:, :, None] for s in (k.a, k.b, k.c))
        less, more = eta_t - eta_n, eta_w - eta_n
        by_v = -eta_n * one - less * outer(t, t) - more * outer(k.m, k.m)
        by_m = -more * (b * one + outer(k.m, v))
        by_t = -less * (a * one + outer(t, v)) - by_m @ (c * one + outer(t, k.w))
        slope_t, slope_n, slope_w = k.slope
        by_d = -slope_n * v - (slope_t - slope_n) * k.a * t - (slope_w - slope_n) * k.b * k.m
        by_x = outer(by_d, k.w) + by_m @ (one - outer(t, t)) @ k.dw
        return {"v": by_v, "tangent": by_t, "x": by_x}


def _at_least(value: np.ndarray, least: np.ndarray, width: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A smooth maximum of two values, over a width about where they are equal, and its slope by the first."""
    root = np.sqrt((value - least) ** 2 + width**2)
    return 0.5 * (value + least + root), 0.5 * (1.0 + (value - least) / root)


class PlaneWallForce(WalledForce):
    """Viscous drag on rods above a plane wall that the medium sticks to.

    Mobilities are those of the middle of a uniform line of Stokeslets with their images in the wall
    (Blake): far from it Gray and Hancock's, at heights between the rod's radius and its length those
    of Brennen and Winet, and the exact ones of a cylinder beside a wall where they almost touch.

    Parameters
    ----------
    point : (3,)
        A point of the wall [m].
    normal : (3,)
        Direction into the medium.
    """

    source = (
        "Blake 1971, Proc. Camb. Phil. Soc. 70, 303; Brennen & Winet 1977, Annu. Rev. Fluid Mech. 9, 339; "
        "Jeffrey & Onishi 1981, Q. J. Mech. Appl. Math. 34, 129"
    )
    example: ClassVar[dict[str, Any]] = {"viscosity": 1.0, "point": (0.0, 0.0, -10.0)}

    def __init__(
        self, on: Any = "*", *, point: Any = (0.0, 0.0, 0.0), normal: Any = (0.0, 0.0, 1.0), **options: Any
    ) -> None:
        super().__init__(on, **options)
        self.point, self.normal = (
            _place("PlaneWallForce", "point", point),
            _axis("PlaneWallForce", "normal", normal),
        )

    def fits(self, model: Model, node: np.ndarray, radius: np.ndarray) -> None:
        """Raise `TermError` for a rod whose axis starts behind the wall."""
        height = (model.x0[node] - self.point) @ self.normal
        if height.min() < 0.0:
            worst = model.graph.node_name(int(node[np.argmin(height)]))
            raise TermError(
                f"PlaneWallForce: '{worst}' is {-height.min():.3g} m behind the wall; turn the normal or move the point"
            )

    def place(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Height above the wall [m], its normal, and zeros."""
        w = np.broadcast_to(self.normal, x.shape)
        return ((x - self.point) @ self.normal)[:, None], w, np.zeros((len(x), 3, 3))

    def resistances(self, d: np.ndarray, radius: np.ndarray, length: Any, p: Any) -> np.ndarray:
        """Resistances over viscosity and their derivatives by the height, shape (2, 3, n, 1)."""
        least = p.roughness * radius
        gap, dh = _at_least(d - radius, least, least)
        h = radius + gap
        # the cylinder beside the wall, in two dimensions
        X = h / radius
        near, tanh = np.arccosh(X), np.sqrt(1.0 - 1.0 / X**2)
        dnear, dtanh = 1.0 / (radius * X * tanh), 1.0 / (radius * X**3 * tanh)
        # what the line's finite length adds; zero, with c = 1, for an endless line
        half = length / (2.0 * h)
        far = np.log(2.0 * half) - np.arcsinh(half)
        c = half / np.hypot(half, 1.0)
        dfar, dc = -(1.0 - c) / h, -c * (1.0 - c**2) / h
        mobility = np.array(
            [
                4.0 * (near + far) - 2.0 + c + c**3,
                2.0 * (near + far) + 1.0 - c,
                2.0 * (near + far - tanh) + 3.0 - 4.0 * c + c**3,
            ]
        )
        slope = dh * np.array(
            [
                4.0 * (dnear + dfar) + (1.0 + 3.0 * c**2) * dc,
                2.0 * (dnear + dfar) - dc,
                2.0 * (dnear + dfar - dtanh) + (3.0 * c**2 - 4.0) * dc,
            ]
        )
        return 8.0 * np.pi * np.array([1.0 / mobility, -slope / mobility**2])


class TubeForce(WalledForce):
    """Viscous drag on rods along a tube that the medium fills and sticks to.

    The mobilities are the exact ones of a cylinder inside a cylinder at any eccentricity, as long as
    the tube is narrower than the rod is long, and go over into those of Gray and Hancock, in an unbounded
    medium, as it gets wider: 8 pi / eta = -1/2 ln(exp(-2 B_free) + exp(-2 B_tube)) in units where B is
    a logarithm of lengths.

    Parameters
    ----------
    tube_radius : float or Parameter
        Inner radius of the tube [m].
    point : (3,)
        A point of its axis [m].
    axis : (3,)
        Direction of its axis, which rods should roughly follow.
    """

    tube_radius = Parameter(
        0.053, unit="m", bounds=(1e-12, None), kind="shape", doc="inner radius of the tube"
    )
    source = (
        "Happel & Brenner 1983, ch. 7 (concentric); Jeffrey & Onishi 1981, Q. J. Mech. Appl. Math. 34, 129 "
        "(bipolar coordinates)"
    )
    example: ClassVar[dict[str, Any]] = {"viscosity": 1.0, "tube_radius": 10.0}

    def __init__(
        self, on: Any = "*", *, point: Any = (0.0, 0.0, 0.0), axis: Any = (1.0, 0.0, 0.0), **options: Any
    ) -> None:
        super().__init__(on, **options)
        self.point, self.axis = _place("TubeForce", "point", point), _axis("TubeForce", "axis", axis)

    def _arm(self, x: np.ndarray) -> np.ndarray:
        arm = x - self.point
        return arm - (arm @ self.axis)[:, None] * self.axis

    def fits(self, model: Model, node: np.ndarray, radius: np.ndarray) -> None:
        """Raise `TermError` for a rod whose axis starts outside the tube, or that is too thick for it."""
        room = np.ravel(self.values(len(node)).tube_radius) - np.maximum(
            np.linalg.norm(self._arm(model.x0[node]), axis=1), radius
        )
        if room.min() <= 0.0:
            worst = model.graph.node_name(int(node[np.argmin(room)]))
            raise TermError(
                f"TubeForce: '{worst}' is outside the tube, by {-room.min():.3g} m; give point=, axis= and tube_radius="
            )

    def place(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distance from the axis [m], the direction away from it, and its derivative."""
        arm = self._arm(x)
        d = np.linalg.norm(arm, axis=1, keepdims=True)
        # at the axis no direction is singled out, and none matters there
        least = 1e-8 * float(np.max(self.tube_radius.value))
        divisor = np.maximum(d, least)
        w = arm / divisor
        across = np.eye(3) - np.outer(self.axis, self.axis)
        turn = np.where((d > least)[:, :, None], w[:, :, None] * w[:, None, :], 0.0)
        return d, w, (across - turn) / divisor[:, :, None]

    def resistances(self, d: np.ndarray, radius: np.ndarray, length: Any, p: Any) -> np.ndarray:
        """Resistances over viscosity and their derivatives by the distance, shape (2, 3, n, 1)."""
        R, r = p.tube_radius, radius
        # the square of an eccentricity that leaves the least gap, zero on the axis
        most, width = (R - r * (1.0 + p.roughness)) ** 2, p.roughness * r * R
        square, slope = _at_least(-(d**2), -most, width)
        start, _ = _at_least(0.0 * d, -most, width)
        excess = ((R - r) ** 2 + square - start) / (2.0 * R * r)
        dexcess = -slope * d / (R * r)
        # bipolar coordinates: their difference between the cylinders
        X, sinh = 1.0 + excess, np.sqrt(excess * (excess + 2.0))
        delta, ddelta = np.arccosh(X), dexcess / sinh
        share = 2.0 * R * r / (R**2 + r**2)
        walled = np.array([delta, delta - share * sinh, delta - sinh / X])
        dwalled = np.array([ddelta, ddelta - share * X / sinh * dexcess, ddelta - dexcess / (sinh * X**2)])
        log = np.log(2.0 * length / r)
        free = np.array([log - 0.5, log + 0.5, log + 0.5])
        wide = np.exp(2.0 * np.minimum(walled - free, 100.0))
        mobility = walled - 0.5 * np.log1p(wide)
        slope = dwalled / (1.0 + wide)
        factor = np.pi * np.array([2.0, 4.0, 4.0]).reshape(3, 1, 1)
        return np.array([factor / mobility, -factor * slope / mobility**2])


def _place(owner: str, name: str, value: Any) -> np.ndarray:
    point = np.asarray(value, dtype=float)
    if point.shape != (3,) or not np.all(np.isfinite(point)):
        raise TermError(f"{owner}: {name} = {value!r} must be a finite vector (3,)")
    return point


def _axis(owner: str, name: str, value: Any) -> np.ndarray:
    vector = _place(owner, name, value)
    length = np.linalg.norm(vector)
    if not length > 0:
        raise TermError(f"{owner}: {name} must not be zero")
    return vector / length
