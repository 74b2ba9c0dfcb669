"""Grains that jam between rods, yield, and stay behind: a drag law with memory held by the medium."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

import rodnet as rn
from rodnet.terms.drag.resistive import gray_hancock

POWER = 3  # of the jam in the stiffness: little until the force chains hang together
TRACE = 1e-3  # of rods passing: below, a place counts as left

REACH = 2.0  # of force chains from rods and from place to place, in cells

# columns of the memory; the last lasts for a step
JAM, PASSING, CONFINED, FLUID, LOADED = range(5)


@rn.kernel
def _confinement(x, tangent, radius, length, reach, gap, out):
    """Fill the number of rods that are close enough to each site for grains to arch in between.

    Rods count by the length beside the site within ``reach``; ``gap`` is the width at which one counts half.
    What is nearer than the two radii is the site's own rod.
    """
    size = np.sqrt(np.sum(tangent**2, axis=1))
    for a in range(len(x)):
        for b in range(len(x)):
            along, square, aligned = 0.0, 0.0, 0.0
            for i in range(3):
                d = x[b, i] - x[a, i]
                along += d * tangent[a, i] / size[a]
                square += d * d
                aligned += tangent[a, i] * tangent[b, i] / (size[a] * size[b])
            beside = 1.0 - abs(along) / reach
            if beside <= 0.0:
                continue
            width = np.sqrt(max(square - along * along, 0.0)) - radius[a] - radius[b]
            if width > 0.0:  # a rod all along the site counts as one
                out[a] += length[b] * abs(aligned) / reach * beside / (1.0 + (width / gap) ** 6)


@rn.kernel
def _yielding(v, x, tangent, radius, t, p, f, dfdv, dfdtangent):
    """Fill force per length and its derivative by the velocity at one site; ``p = (yield_stress, speed)``."""
    size = np.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2 + p[1] ** 2)
    strength = 2.0 * radius * p[0] / size
    for i in range(3):
        f[i] = -strength * v[i]
        dfdv[i, i] = -strength
        for j in range(3):
            dfdv[i, j] += strength * (v[i] / size) * (v[j] / size)


class Yielding(rn.DragModel):
    """Yield stress of grains that a body pushes aside, f = -sigma d v / sqrt(v^2 + u^2) per unit length.

    It holds the robot where it is, but for creep, until the thrust exceeds it: for the head of diameter
    and length d that is sigma d^2.

    Parameters
    ----------
    on : str or sequence of str
        The rods that feel it; their diameter is d.
    yield_stress : float or Parameter
        sigma [Pa].
    speed : float or Parameter
        u, of the creep below the yield stress [m/s].
    """

    source = "Du et al., threshold angular speed; Bingham's yield stress, regularised"
    default_name = "yielding"
    regime = "speed"
    contains = ("medium-friction", "yield")  # the same on rods of one radius
    claims: ClassVar[set[str]] = {"dissipative", "objective"}
    yield_stress = rn.Parameter(
        0.3, unit="Pa", bounds=(0, None), null=0.0, doc="sigma, stress at which grains flow"
    )
    speed = rn.Parameter(
        1e-6, unit="m/s", bounds=(1e-9, None), kind="shape", doc="u, of creep below the yield stress"
    )
    kernel = _yielding

    def force(self, site: Any, p: Any) -> np.ndarray:
        """Force per unit length [N/m], shape (n, 3)."""
        size = np.sqrt(rn.dot(site.v, site.v) + p.speed**2)
        return -2.0 * p.yield_stress * site.radius[:, None] * site.v / size


class Jamming(rn.DragModel):
    """Drag that jammed grains and their yield stress add to resistive force theory.

    f = -s J (eta_t v_t + eta_n v_n) - (1 + s J) sigma d v / sqrt(v^2 + u^2) per unit length, with the jam J, from 0
    to 1, that the medium remembers in cells of edge ``cell``. It builds up by the work that rods do on grains that
    are confined between them, J = 1 - exp(-W / work); a cluster of cells that rods load yields as a whole when its
    mean reaches ``limit``, then flows and heals; and a jam stays where it is when the rods move on.

    Parameters
    ----------
    on : str or sequence of str
        The rods that feel it.
    cell : float
        Edge of the medium's cells [m]: width of the zone that a rod disturbs, one grain by default.
    slenderness : float
        L/r in the coefficients of Gray and Hancock [1].
    viscosity, stiffening, yield_stress, speed, work, grain, arch, crowding, limit, collapse, healing, passing
        Values or `rodnet.Parameter` objects, see the table in the documentation.
    """

    default_name = "jam"
    regime = "spacing"
    contains = ("medium-friction", "yield", "grain-yield")  # where nothing is confined
    memory_size = 5
    memory_names = ("jam", "passing", "confined", "fluid", "loaded")
    memory_frame = "medium"
    cell = 9.4e-3
    example_memory = (0.9, 0.05, 0.3, 0.5, 1.0)
    example: ClassVar[dict[str, Any]] = {"crowding": 0.2, "arch": 10.0}  # any rod nearby confines
    source = "Du et al., discussion of jamming; Cates et al. 1998; To, Lai & Pak 2001; Gravish et al. 2010"
    claims: ClassVar[set[str]] = {"dissipative", "objective"}
    viscosity = rn.Parameter(
        6.828, unit="Pa s", bounds=(0, None), kind="shape", doc="viscosity of flowing grains"
    )
    stiffening = rn.Parameter(
        200.0, unit="1", bounds=(0, None), null=0.0, doc="s: a full jam's drag over the viscous"
    )
    yield_stress = rn.Parameter(
        0.3, unit="Pa", bounds=(0, None), null=0.0, doc="sigma, of grains that do not jam"
    )
    speed = rn.Parameter(
        1e-6, unit="m/s", bounds=(1e-9, None), kind="shape", doc="u, of creep below the yield stress"
    )
    work = rn.Parameter(0.5, unit="J/m^3", bounds=(1e-9, None), kind="shape", doc="work per volume that jams")
    grain = rn.Parameter(9.4e-3, unit="m", bounds=(1e-6, None), kind="shape", doc="diameter of the grains")
    arch = rn.Parameter(
        3.0, unit="1", bounds=(1e-3, None), kind="shape", doc="gap that half of all arches bridge, in grains"
    )
    crowding = rn.Parameter(
        2.0, unit="1", bounds=(1e-3, None), kind="shape", doc="arches at a rod beyond which grains jam"
    )
    limit = rn.Parameter(0.4, unit="1", bounds=(1e-3, 1), kind="shape", doc="mean jam that yields")
    collapse = rn.Parameter(
        0.2, unit="s", bounds=(1e-6, None), kind="shape", doc="time in which it collapses"
    )
    healing = rn.Parameter(
        3.0, unit="s", bounds=(1e-6, None), kind="shape", doc="time in which the grains flow"
    )
    passing = rn.Parameter(
        5.0, unit="s", bounds=(1e-6, None), kind="shape", doc="time in which a rod's passage is forgotten"
    )

    def __init__(self, on: Any = "*", *, slenderness: float = 35.0, **options: Any) -> None:
        super().__init__(on, **options)
        if not slenderness > 1.0:
            raise rn.TermError(f"Jamming: slenderness = {slenderness!r} must be above 1")
        self.slenderness = slenderness

    # -- the law --------------------------------------------------------------------------
    def _resistance(self, site: Any, p: Any) -> tuple[np.ndarray, ...]:
        """Viscous and yield force per length, both against motion, and their factors."""
        eta_t, eta_n = gray_hancock(p.viscosity, self.slenderness, 1.0)
        viscous = eta_n * site.v + (eta_t - eta_n) * rn.dot(site.v, site.tangent) * site.tangent
        size = np.sqrt(rn.dot(site.v, site.v) + p.speed**2)
        strength = 2.0 * p.yield_stress * site.radius[:, None]
        return viscous, strength * site.v / size, eta_t, eta_n, size, strength

    def _growth(self, site: Any, p: Any, m: np.ndarray) -> tuple[np.ndarray, ...]:
        """Growth of the jam by power [s/W per length], and its derivatives by confinement and fluidity."""
        beyond = np.maximum(confinement(m) / p.crowding - 1.0, 0.0)
        scale = site.dt / (self.cell**2 * p.work)
        solid = 1.0 - m[:, [FLUID]]
        return scale * beyond**2 * solid, 2.0 * scale * beyond / p.crowding * solid, -scale * beyond**2

    def _jam(self, p: Any, m: np.ndarray, growth: np.ndarray, power: np.ndarray) -> tuple[np.ndarray, ...]:
        """The new jam, and the share of what was not jammed that still is not."""
        remains = np.exp(-growth * (1.0 + p.stiffening * m[:, [JAM]] ** POWER) * power)
        return 1.0 - (1.0 - m[:, [JAM]]) * remains, remains

    def update(self, site: Any, p: Any, m_old: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Force per unit length [N/m] and new memory, shapes (n, 3) and (n, 5)."""
        viscous, plastic, *_ = self._resistance(site, p)
        power = rn.dot(site.v, viscous + plastic)
        jam, _ = self._jam(p, m_old, self._growth(site, p, m_old)[0], power)
        stiff = p.stiffening * jam**POWER
        force = -stiff * viscous - (1.0 + stiff) * plastic
        return force, np.concatenate([jam, m_old[:, 1:]], axis=1)

    def jacobian(self, site: Any, p: Any, m_old: np.ndarray) -> dict[str, np.ndarray]:
        """Derivatives by velocity, tangent, position and memory; see the documentation."""
        outer = lambda a, b: a[:, :, None] * b[:, None, :]  # noqa: E731
        column = lambda a: np.asarray(a)[..., None]  # noqa: E731
        v, t = site.v, site.tangent
        viscous, plastic, eta_t, eta_n, size, strength = self._resistance(site, p)
        resistance = viscous + plastic
        power = rn.dot(v, resistance)
        growth, by_confinement, by_fluid = self._growth(site, p, m_old)
        jam, remains = self._jam(p, m_old, growth, power)
        skew = column(eta_t - eta_n)
        viscous_v = column(eta_n) * np.eye(3) + skew * outer(t, t)
        viscous_t = skew * (rn.dot(v, t)[:, :, None] * np.eye(3) + outer(t, v))
        plastic_v = column(strength / size) * (np.eye(3) - outer(v / size, v / size))
        power_v = resistance + np.einsum("nij,ni->nj", viscous_v + plastic_v, v)
        power_t = np.einsum("nij,ni->nj", viscous_t, v)
        # the jam by the power, and by what the medium remembers
        old = m_old[:, [JAM]]
        stiff, slope = 1.0 + p.stiffening * old**POWER, POWER * p.stiffening * old ** (POWER - 1)
        room = (1.0 - old) * remains
        jam_m = np.zeros((len(v), self.memory_size))
        trace = m_old[:, [PASSING]] + TRACE
        jam_m[:, [JAM]] = remains + room * growth * slope * power
        jam_m[:, [CONFINED]] = room * stiff * power * by_confinement / trace
        jam_m[:, [PASSING]] = -jam_m[:, [CONFINED]] * confinement(m_old)
        jam_m[:, [FLUID]] = room * stiff * power * by_fluid
        jam_power = room * growth * stiff
        s, sJ = column(POWER * p.stiffening * jam ** (POWER - 1)), column(p.stiffening * jam**POWER)
        return {
            "v": -sJ * viscous_v - (1.0 + sJ) * plastic_v - s * outer(resistance, jam_power * power_v),
            "tangent": -sJ * viscous_t - s * outer(resistance, jam_power * power_t),
            "x": np.zeros((len(v), 3, 3)),
            "memory": -s * outer(resistance, jam_m),
        }

    # -- the medium -----------------------------------------------------------------------
    def disturb(self, site: Any, p: Any, m: np.ndarray) -> np.ndarray:
        """Rods passing, how many others confine the grains around each, and that it is now, shape (n, 5)."""
        rods = np.zeros(len(site.x))
        gap = float(np.ravel(p.arch)[0] * np.ravel(p.grain)[0])
        _confinement(site.x, site.tangent, site.radius, site.length, self.cell, gap, rods)
        change = np.zeros_like(m)
        change[:, [PASSING]] = site.dt / p.passing
        change[:, [CONFINED]] = site.dt / p.passing * rods[:, None]
        change[:, LOADED] = 1.0
        return change

    def settle(self, cells: Any, p: Any, m: np.ndarray) -> np.ndarray:
        """Each cluster that rods load yields as a whole, collapses while it flows, and heals, shape (n, 5)."""
        m = m.copy()
        m[:, JAM] = np.clip(m[:, JAM], 0.0, 1.0)
        m[:, [PASSING, CONFINED]] *= np.exp(-cells.dt / p.passing)
        m[:, FLUID] = np.clip(m[:, FLUID], 0.0, 1.0) * np.exp(-cells.dt / p.healing)
        beyond = np.maximum(confinement(m)[:, 0] / p.crowding - 1.0, 0.0)
        near, cluster = clusters(cells.x, m[:, LOADED] > 0.0, beyond > 0.0, REACH * cells.size)
        weight = beyond[near] * m[near, PASSING]  # where rods are most of the time
        excess = np.bincount(cluster, weights=weight * (m[near, JAM] - p.limit))
        m[near[excess[cluster] > 0.0], FLUID] = 1.0
        m[:, LOADED] = 0.0
        m[:, JAM] *= np.exp(-cells.dt / p.collapse * m[:, FLUID])
        return m


def confinement(m: np.ndarray) -> np.ndarray:
    """Number of rods that confine the grains at a place, averaged over those that passed there, shape (n, 1)."""
    return m[:, [CONFINED]] / (m[:, [PASSING]] + TRACE)


def clusters(
    x: np.ndarray, loaded: np.ndarray, confined: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """Find the confined cells that rods load now, and which of them hang together.

    Parameters
    ----------
    x : ndarray, shape (n, 3)
        Middles of the cells [m].
    loaded, confined : ndarray of bool, shape (n,)
        Where rods are now, and where grains can jam.
    reach : float
        Distance over which force chains carry a load [m].

    Returns
    -------
    near, cluster : ndarray of int, shape (k,)
        Numbers of the confined cells within ``reach`` of a loaded one, and of the cluster of each.
    """
    near = np.flatnonzero(confined)
    if not len(near) or not loaded.any():
        return near[:0], near[:0]
    reach *= 1.0 + 1e-9  # cells are on a lattice: those at just this distance count, whatever the rounding
    near = near[np.isfinite(cKDTree(x[loaded]).query(x[near], distance_upper_bound=reach)[0])]
    i, j = cKDTree(x[near]).query_pairs(reach, output_type="ndarray").T
    links = coo_matrix((np.ones(len(i), dtype=bool), (i, j)), shape=(len(near), len(near)))
    return near, connected_components(links, directed=False)[1]
