"""Resistive force theory: linear anisotropic drag on slender rods."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import TermError
from rodnet.parameters import Parameter
from rodnet.terms.base import BoundTerm
from rodnet.terms.drag.line import DragModel, SiteTable, _BoundLaw, _BoundLine, edge_dofs, line_sites

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.pattern import Pattern

SMOOTH = math.radians(30.0)  # a joint that turns more ends a smooth chain of rods


def gray_hancock(viscosity: Any, length: Any, radius: Any) -> tuple[Any, Any]:
    """Drag coefficients per unit length along and across a slender rod [Pa s].

    eta_t = 2 pi mu / (ln(2L/r) - 1/2), eta_n = 4 pi mu / (ln(2L/r) + 1/2), with the natural
    logarithm (paper, external forces; Gray & Hancock 1955).
    """
    log = np.log(2.0 * np.asarray(length) / np.asarray(radius))
    return 2.0 * np.pi * viscosity / (log - 0.5), 4.0 * np.pi * viscosity / (log + 0.5)


def lighthill(viscosity: Any, length: Any, radius: Any) -> tuple[Any, Any]:
    """Drag coefficients per unit length along and across a flagellum [Pa s].

    eta_t = 2 pi mu / ln(2q/r), eta_n = 4 pi mu / (ln(2q/r) + 1/2) with q = 0.09 times the wavelength
    ``length``, measured along the rod (Lighthill 1976).
    """
    log = np.log(0.18 * np.asarray(length) / np.asarray(radius))
    return 2.0 * np.pi * viscosity / log, 4.0 * np.pi * viscosity / (log + 0.5)


FORMULAS = {"gray-hancock": gray_hancock, "lighthill": lighthill}
# least L/r: less slender, and a formula gives nonsense (Lighthill's: less drag across than along)
LEAST = {"gray-hancock": 1.0, "lighthill": math.exp(0.5) / 0.18}


class ResistiveForce(DragModel):
    """Resistive force theory, f = -eta_t v_t - eta_n v_n per unit length.

    The coefficients are those of Gray and Hancock, or of Lighthill, for a ``viscosity``, or
    ``eta_t`` and ``eta_n`` given directly.

    Parameters
    ----------
    viscosity : float or Parameter
        Dynamic viscosity of the medium [Pa s].
    eta_t, eta_n : float or Parameter
        Coefficients along and across the rod [Pa s]; both or none.
    coefficients : {"gray-hancock", "lighthill"}
        Formula that gives them from a viscosity.
    length : float, optional
        The L of Gray and Hancock [m]; by default the length of the smooth chain of rods (joined at
        nodes of two edges, turning less than 30 degrees, whatever the joint) that a rod belongs to, so
        that splitting a rod in two or putting a hinge into it changes nothing. For Lighthill's formula,
        which needs it, the wavelength of the rod's shape, measured along the rod.
    axial_torque : bool
        Add the torque -4 pi mu r^2 dtheta/dt per unit length of a spinning rod.
    """

    viscosity = Parameter(None, unit="Pa s", bounds=(0, None), null=0.0, doc="dynamic viscosity")
    eta_t = Parameter(None, unit="Pa s", bounds=(0, None), null=0.0, doc="drag along the rod")
    eta_n = Parameter(None, unit="Pa s", bounds=(0, None), null=0.0, doc="drag across the rod")
    source = "Gray & Hancock 1955; Lighthill 1976; Du et al., external forces"
    claims: ClassVar[set[str]] = {"dissipative", "objective"}
    example: ClassVar[dict[str, Any]] = {"viscosity": 1.0}

    def __init__(
        self,
        on: Any = "*",
        *,
        coefficients: str = "gray-hancock",
        length: float | None = None,
        axial_torque: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(on, **options)
        if coefficients not in FORMULAS:
            raise TermError(
                f"ResistiveForce: coefficients = {coefficients!r} must be one of {', '.join(map(repr, FORMULAS))}; "
                "numbers of your own are eta_t= and eta_n="
            )
        direct = [p.value is not None for p in (self.eta_t, self.eta_n)]
        if any(direct) != all(direct) or all(direct) == (self.viscosity.value is not None):
            raise TermError("ResistiveForce: give viscosity=, or both eta_t= and eta_n=")
        if axial_torque and all(direct):
            raise TermError("ResistiveForce: axial_torque needs viscosity=")
        if length is not None and not length > 0:
            raise TermError(f"ResistiveForce: length = {length!r} must be positive [m]")
        if coefficients == "lighthill" and length is None and not all(direct):
            raise TermError(
                "ResistiveForce: Lighthill's coefficients need length=, the wavelength of the rod's shape [m]"
            )
        if axial_torque and self.flow is not None:
            raise TermError(
                "ResistiveForce: axial_torque is that of a rod in a medium at rest; leave it out with flow="
            )
        self.formula, self.length, self.axial_torque = coefficients, length, axial_torque

    def coefficients(self, p: Any, length: Any, radius: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return eta_t and eta_n [Pa s] at the sites, shape (n,)."""
        if p.viscosity is None:
            pair = p.eta_t, p.eta_n
        else:
            pair = FORMULAS[self.formula](np.ravel(p.viscosity), length, radius)
        return tuple(np.ascontiguousarray(np.broadcast_to(np.ravel(c), np.shape(radius))) for c in pair)  # type: ignore

    def force(self, site: Any, p: Any) -> np.ndarray:
        """Force per unit length [N/m], shape (n, 3)."""
        length = self.length or 1.0
        eta_t, eta_n = self.coefficients(p, length, site.radius)
        along = np.sum(site.v * site.tangent, axis=1, keepdims=True) * site.tangent
        return -eta_n[:, None] * site.v - (eta_t - eta_n)[:, None] * along

    def jacobian(self, site: Any, p: Any, m_old: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Derivatives of the force by velocity, tangent and place, shape (n, 3, 3) each."""
        eta_t, eta_n = self.coefficients(p, self.length or 1.0, site.radius)
        v, t, one = site.v, site.tangent, np.eye(3)
        less = (eta_t - eta_n)[:, None, None]
        along = np.sum(v * t, axis=1)[:, None, None]
        by_v = -eta_n[:, None, None] * one - less * t[:, :, None] * t[:, None, :]
        by_t = -less * (along * one + t[:, :, None] * v[:, None, :])
        return {"v": by_v, "tangent": by_t, "x": np.zeros_like(by_v)}

    def site_coefficients(
        self, model: Model, sites: SiteTable, owner: str = "", instead: str = "eta_t=, eta_n="
    ) -> np.ndarray:
        """Coefficients eta_t and eta_n [Pa s] at the sites of a model, shape (n, 2).

        A message says ``owner`` needs them and could be given ``instead``.
        """
        chains = smooth_chain_lengths(model)
        length = np.full(len(sites.node), self.length) if self.length else chains[sites.edgeA]
        slender = length / sites.radius
        if self.viscosity.value is not None and slender.min() < LEAST[self.formula]:
            worst = model.graph.edge_name(int(sites.edgeA[np.argmin(slender)]))
            raise TermError(
                f"{owner or type(self).__name__}: the rod at '{worst}' is not slender (L/r = {slender.min():.2g}); "
                f"give length= or coefficients {instead}"
            )
        p = self.values(len(sites.node))
        return np.stack(self.coefficients(p, length, sites.radius), axis=1)

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the sites of the rods that ``on`` names."""
        sites = line_sites(model, self.on, self.tangent)
        if self.flow is None:
            return _BoundResistiveForce(self, model, sites)
        bound = _BoundLaw(self, model, sites)
        bound.p = given(self.site_coefficients(model, sites))
        return bound


def given(eta: np.ndarray) -> SimpleNamespace:
    """Parameters of a `ResistiveForce` whose coefficients (n, 2) are given for each site."""
    return SimpleNamespace(viscosity=None, eta_t=eta[:, :1], eta_n=eta[:, 1:])


class _BoundResistiveForce(_BoundLine):
    def __init__(self, term: ResistiveForce, model: Model, sites: SiteTable) -> None:
        from rodnet.terms.drag import kernels

        super().__init__(term, model, sites)
        self.resistive_force, self.spin_force = kernels.resistive_force, kernels.spin_drag
        self.eta = term.site_coefficients(model, sites)
        self.spun = model.graph.edge_indices(term.on) if term.axial_torque else np.zeros(0, dtype=np.int64)
        if term.axial_torque:
            graph = model.graph
            mu = term.viscosity.value
            self.spin_drag = 4.0 * np.pi * mu * graph.radius[self.spun] ** 2 * graph.rest_length[self.spun]
            self.spun_dofs = edge_dofs(model, self.spun)
            self.stencils.append(self.spun_dofs)

    def find_slots(self, pattern: Pattern, stencils: list[np.ndarray]) -> None:
        from rodnet.packed import Packed
        from rodnet.terms.drag.kernels import SPUN

        super().find_slots(pattern, stencils)
        self.packed = self.pack(self.eta)
        if len(self.spun):
            self.packed_spun = Packed(SPUN, self.spin_drag, self.spun, self.spun_dofs, self.slots[1])

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        largest = self.resistive_force(self.packed.table, ev.state, ev.cv, F, data, jac)
        if len(self.spun):
            self.spin_force(self.packed_spun.table, ev.state, ev.cv, F, data, jac)
        return largest


def smooth_chain_lengths(model: Model) -> np.ndarray:
    """Length [m] of the smooth chain of edges that each edge belongs to, shape (E,)."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    graph = model.graph
    pairs = [np.stack([rod.edges[:-1], rod.edges[1:]], axis=1) for rod in graph.rods.values()]
    pairs += [rod.edges[[[-1, 0]]] for rod in graph.rods.values() if rod.closed]
    # ends of edges by node; joints do not part what lies in one line
    nodes = graph.edges.ravel()
    order, degree = np.argsort(nodes, kind="stable"), np.bincount(nodes, minlength=graph.node_count)
    first = order[(np.cumsum(degree) - degree)[degree == 2]]
    second = order[(np.cumsum(degree) - degree)[degree == 2] + 1]
    away = np.where(np.arange(len(nodes)) % 2, -1.0, 1.0)[:, None] * np.repeat(
        model.t0[: graph.edge_count], 2, axis=0
    )
    smooth = -np.sum(away[first] * away[second], axis=1) > math.cos(SMOOTH)
    smooth &= graph.rigid[first // 2] == graph.rigid[second // 2]
    pairs.append(np.stack([first[smooth], second[smooth]], axis=1) // 2)
    one, other = np.concatenate(pairs).T
    links = coo_matrix((np.ones(len(one)), (one, other)), shape=(graph.edge_count,) * 2)
    _, label = connected_components(links, directed=False)
    return np.bincount(label, weights=graph.rest_length)[label]
