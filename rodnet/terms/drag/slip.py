"""Line drag with a torque about the rods' own axes: laws of the surface's slip, along, across and around.

A point of a rod's surface slides along with the axis and around with the spin. A law of this kind depends on
both at once, so its sites are half edges that know the spin of their edge.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import TermError
from rodnet.terms.base import BoundTerm
from rodnet.terms.drag.line import DragModel, LineSites, SiteTable, edge_dofs

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model


class SlipLaw(DragModel):
    """A drag law that can also resist a rod's spin, by the slip of its surface.

    Laws derive from it and implement `slip_load` and `slip_jacobian` beside ``force``; without spin
    these give ``force``.

    Parameters
    ----------
    axial_torque : bool
        Whether spin counts: the rods meet a torque about their own axes, and slide more easily while they
        spin. It takes the law's vectorised form, edge tangents, and a medium at rest.
    """

    def __init__(self, on: Any = "*", *, axial_torque: bool = False, **options: Any) -> None:
        super().__init__(on, **options)
        if axial_torque and (self.flow is not None or self.tangent != "edge"):
            what = "flow=" if self.flow is not None else 'tangent="node"'
            raise TermError(
                f"{type(self).__name__}: axial_torque is that of an edge in a medium at rest; leave it out with {what}"
            )
        self.axial_torque = bool(axial_torque)

    def slip_load(self, site: LineSites, spin: np.ndarray, p: Any) -> tuple[np.ndarray, np.ndarray]:
        """Force [N/m] and torque about the tangent [N] per unit length.

        Parameters
        ----------
        site : LineSites
            The sites, as for ``force``.
        spin : ndarray, shape (n, 1)
            Angular velocity about the tangent [rad/s].
        p
            Parameters.

        Returns
        -------
        ndarray, shapes (n, 3) and (n, 1)
        """
        raise TermError(f"{type(self).__name__} must implement slip_load(self, site, spin, p)")

    def slip_jacobian(self, site: LineSites, spin: np.ndarray, p: Any) -> dict[str, np.ndarray]:
        """Derivatives of (force, torque) by ``"v"``, ``"tangent"``, ``"x"`` (n, 4, 3) and ``"spin"`` (n, 4)."""
        raise TermError(f"{type(self).__name__} must implement slip_jacobian(self, site, spin, p)")


class BoundSlipLaw(BoundTerm):
    """A law of the slip, bound to half edges; each acts on the ends and the twist of its edge.

    The edge spins with its frame: with the twist's rate, less the turn S.(de/dt)/l of the transported
    director. By virtual work a torque acts on the twist and as a couple of forces on the ends.
    """

    def __init__(self, term: SlipLaw, model: Model, sites: SiteTable) -> None:
        super().__init__(term)
        self.law, self.sites = term, sites
        self.p = term.values(len(sites.node))
        self.dofs = edge_dofs(model, sites.edgeA)
        self.stencils = [self.dofs]
        end = model.edges[sites.edgeA, 1] == sites.node
        self.own = np.zeros((len(end), 3, 7))  # from the edge's degrees of freedom to the site's place
        self.own[~end, :, :3] = self.own[end, :, 3:6] = np.eye(3)

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        s = self.sites
        e = s.edgeA
        L, T, S = ev.L[e][:, None], ev.T[e], ev.S[e]
        rate = ev.v[ev.model.edges[e, 1]] - ev.v[ev.model.edges[e, 0]]
        arm = S / L
        spin = ev.w[e][:, None] - np.sum(arm * rate, axis=1, keepdims=True)
        turning = np.concatenate([arm, -arm, np.ones_like(L)], axis=1)  # of the spin by the rates
        site = LineSites(ev.v[s.node], ev.x[s.node], T, s.radius, s.weight, ev.t, ev.dt)
        force, torque = (s.weight[:, None] * f for f in self.law.slip_load(site, spin, self.p))
        load = np.einsum("nai,na->ni", self.own, force) + torque * turning
        np.add.at(F, self.dofs, load)
        if jac:
            by = {k: s.weight.reshape((-1,) + (1,) * (b.ndim - 1)) * b
                  for k, b in self.law.slip_jacobian(site, spin, self.p).items()}  # fmt: skip
            one = np.eye(3)
            by_edge = np.zeros((len(e), 3, 7))  # of the edge vector by the degrees of freedom
            by_edge[:, :, :3], by_edge[:, :, 3:6] = -one, one
            tangent = (one - T[:, :, None] * T[:, None, :]) / L[:, :, None]
            # dS by the edge vector: S = (ts x t) / (1 + ts.t)
            ts = ev.ts[e]
            cross = np.cross(ts[:, None, :], tangent.transpose(0, 2, 1)).transpose(0, 2, 1)
            chi = 1.0 + np.sum(ts * T, axis=1)[:, None, None]
            dS = (cross - S[:, :, None] * np.einsum("na,nab->nb", ts, tangent)[:, None, :]) / chi
            darm = (dS - arm[:, :, None] * T[:, None, :]) / L[:, :, None]
            dspin = ev.cv * turning - np.einsum("na,nab,nbi->ni", rate, darm, by_edge)
            place = ev.cv * by["v"] + by["x"]
            slope = np.einsum("nka,nai->nki", place, self.own)
            slope += np.einsum("nka,nab,nbi->nki", by["tangent"], tangent, by_edge)
            slope += by["spin"][:, :, None] * dspin[:, None, :]
            block = np.einsum("naj,nai->nji", self.own, slope[:, :3])
            block += turning[:, :, None] * slope[:, 3:]
            couple = torque[:, :, None] * np.einsum("nab,nbi->nai", darm, by_edge)
            block[:, :3] += couple
            block[:, 3:6] -= couple
            np.add.at(data, self.slots[0], -block)
        return float(np.abs(force).max(initial=0.0))
