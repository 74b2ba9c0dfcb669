"""Grains that jam between rods, yield, and stay behind: a drag law with memory held by the medium."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
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


@rn.kernel
def _respond(v, tangent, radius, given, m, f, jam, dfdv, dfdtangent, dfdm):
    """Fill force per length and new jam at each site, and if their arrays have rows the force's derivatives.

    ``given`` are eta_t, eta_n, stiffening, yield stress, speed, the power per length that jams in a step, crowding.
    """
    viscous, plastic, by_v, power_v = np.empty(3), np.empty(3), np.empty((3, 3)), np.empty(3)
    for a in range(len(v)):
        eta_t, eta_n, stiffening, stress, speed, work, crowding = given[a]
        u, t = v[a], tangent[a]
        skew, along = eta_t - eta_n, u[0] * t[0] + u[1] * t[1] + u[2] * t[2]
        size = np.sqrt(u[0] ** 2 + u[1] ** 2 + u[2] ** 2 + speed**2)
        strength = 2.0 * radius[a] * stress / size
        power = 0.0
        for i in range(3):
            viscous[i] = eta_n * u[i] + skew * along * t[i]
            plastic[i] = strength * u[i]
            power += u[i] * (viscous[i] + plastic[i])
        # the jam by the power, and by what the medium remembers
        old, trace, solid = m[a, JAM], m[a, PASSING] + TRACE, 1.0 - m[a, FLUID]
        confined = m[a, CONFINED] / trace
        beyond = confined / crowding - 1.0
        if beyond < 0.0:
            beyond = 0.0
        growth = beyond**2 * solid / work
        before = 1.0 + stiffening * old**POWER
        room = (1.0 - old) * np.exp(-growth * before * power)
        jam[a, 0] = 1.0 - room
        stiff = stiffening * jam[a, 0] ** POWER
        for i in range(3):
            f[a, i] = -stiff * viscous[i] - (1.0 + stiff) * plastic[i]
        if len(dfdv) == 0:
            continue
        slope = POWER * stiffening * jam[a, 0] ** (POWER - 1)
        by_power = room * growth * before
        for j in range(3):
            power_v[j] = viscous[j] + plastic[j]
            for i in range(3):
                by_v[i, j] = skew * t[i] * t[j]
                plastic_v = -strength * (u[i] / size) * (u[j] / size)
                if i == j:
                    by_v[i, j] += eta_n
                    plastic_v += strength
                dfdv[a, i, j] = -stiff * by_v[i, j] - (1.0 + stiff) * plastic_v
                power_v[j] += (by_v[i, j] + plastic_v) * u[i]
        by_confined = room * before * power * 2.0 * beyond * solid / (work * crowding * trace)
        by_old = np.exp(-growth * before * power)
        by_old += room * growth * POWER * stiffening * old ** (POWER - 1) * power
        by_fluid = -room * before * power * beyond**2 / work
        for i in range(3):
            resisted = -slope * (viscous[i] + plastic[i])
            dfdm[a, i, JAM] = resisted * by_old
            dfdm[a, i, CONFINED] = resisted * by_confined
            dfdm[a, i, PASSING] = -resisted * by_confined * confined
            dfdm[a, i, FLUID] = resisted * by_fluid
            for j in range(3):
                turned = skew * u[j] * t[i]
                if i == j:
                    turned += skew * along
                power_t = 2.0 * skew * along * u[j]
                dfdv[a, i, j] += resisted * by_power * power_v[j]
                dfdtangent[a, i, j] = -stiff * turned + resisted * by_power * power_t


@rn.kernel
def _join(pairs, cluster):
    """Give all that pairs connect the number of the first of them; to begin with, each has its own."""
    for k in range(len(pairs)):
        one, other = pairs[k]
        while cluster[one] != one:  # what is passed on the way gets nearer to its first
            cluster[one] = cluster[cluster[one]]
            one = cluster[one]
        while cluster[other] != other:
            cluster[other] = cluster[cluster[other]]
            other = cluster[other]
        cluster[max(one, other)] = min(one, other)
    for k in range(len(cluster)):  # the first of a cluster comes before the others
        cluster[k] = cluster[cluster[k]]


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

    f = -s J^3 (eta_t v_t + eta_n v_n) - (1 + s J^3) sigma d v / sqrt(v^2 + u^2) per unit length, with the jam J, from
    0 to 1, that the medium remembers in cells of edge ``cell``. It builds up by the work W that rods do on grains that
    are confined between them, J = 1 - exp(-W (C / crowding - 1)^2 / work) where the count C of rods nearby exceeds
    ``crowding``; a cluster of cells that rods load yields as a whole when its
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
    def _response(self, site: Any, p: Any, m: np.ndarray, derivatives: bool) -> tuple[np.ndarray, ...]:
        """What `_respond` fills: force, new jam, and derivatives of the force by v, tangent and memory."""
        n = len(site.v)
        given = np.empty((n, 7))
        eta = gray_hancock(p.viscosity, self.slenderness, 1.0)
        work = self.cell**2 * p.work / site.dt
        for k, value in enumerate((*eta, p.stiffening, p.yield_stress, p.speed, work, p.crowding)):
            given[:, [k]] = value
        some = n if derivatives else 0
        shapes = (n, 3), (n, 1), (some, 3, 3), (some, 3, 3), (some, 3, self.memory_size)
        out = tuple(np.zeros(shape) for shape in shapes)
        _respond(site.v, site.tangent, site.radius, given, m, *out)
        return out

    def update(self, site: Any, p: Any, m_old: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Force per unit length [N/m] and new memory, shapes (n, 3) and (n, 5)."""
        force, jam, *_ = self._response(site, p, m_old, False)
        return force, np.concatenate([jam, m_old[:, 1:]], axis=1)

    def jacobian(self, site: Any, p: Any, m_old: np.ndarray) -> dict[str, np.ndarray]:
        """Derivatives by velocity, tangent, position and memory; see the documentation."""
        _, _, by_v, by_tangent, by_memory = self._response(site, p, m_old, True)
        return {"v": by_v, "tangent": by_tangent, "x": np.zeros_like(by_v), "memory": by_memory}

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
    cluster = np.arange(len(near))
    _join(cKDTree(x[near]).query_pairs(reach, output_type="ndarray"), cluster)
    return near, cluster
