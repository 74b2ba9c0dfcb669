"""The drag laws of a robot that changes of them look up, as one function of all their sites."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import TermError
from rodnet.terms.base import Term
from rodnet.terms.drag.flow import Flow
from rodnet.terms.drag.line import DragModel, LineSites, SiteTable, _BoundKernelLaw, difference
from rodnet.terms.drag.resistive import ResistiveForce, _BoundResistiveForce, given
from rodnet.terms.drag.walls import WalledForce

if TYPE_CHECKING:
    from rodnet.robot import Robot
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.terms.drag.change import DragChange

Slopes = dict[str, np.ndarray]
KEYS = ("v", "tangent", "x")  # what a law is differentiated by


class Laws:
    """The drag laws of a robot, as one function of all their sites.

    Parameters
    ----------
    term : DragChange
        Which asks.
    model : Model
        Of the robot.

    Attributes
    ----------
    crowds : list of Crowded
        What neighbours do to some of them.
    """

    def __init__(self, term: DragChange, model: Model) -> None:
        if term.eta_t.value is not None:
            medium = ResistiveForce(term.on, eta_t=term.eta_t.value, eta_n=term.eta_n.value)
            found: list[tuple[int, Any]] = [(-1, medium)]
        else:
            terms = enumerate(model.robot.terms)
            found = [(k, t) for k, t in terms if isinstance(t, DragModel) and can_change(t)]
        self.parts: list[ChangedLaw] = []
        self.crowds: list[Crowded] = []
        tables: list[SiteTable] = []
        chosen = np.zeros(model.edge_count, dtype=bool)
        chosen[model.graph.edge_indices(term.on)] = True
        first = 0
        for number, law in found:
            alone = law.alone
            bound: Any = alone.bind(model)
            table = bound.sites
            if bound.memory is not None or not chosen[table.edgeA].any():
                continue
            plain = isinstance(bound, _BoundResistiveForce)
            inner, eta = (given(bound.eta), bound.eta) if plain else (bound.p, None)
            vector = bound.vector if isinstance(bound, _BoundKernelLaw) else None
            where = slice(first, first + len(table.node))
            self.parts.append(ChangedLaw(bound.term, inner, where, eta, vector))
            tables.append(table)
            if alone is not law:  # neighbours matter to it
                self.crowds.append(Crowded(number, where, law.values(len(table.node)).crowding))
            first += len(table.node)
        if not tables:
            raise TermError(
                f"{type(term).__name__} '{term.name}': no drag law without memory acts on {term.on}; put one there, or "
                "give eta_t= and eta_n= of the medium"
            )
        self.sites = SiteTable(
            *(np.concatenate([getattr(t, k) for t in tables]) for k in SiteTable.__dataclass_fields__)
        )
        # a law may act on more rods than are asked for
        self.sites.weight = np.where(chosen[self.sites.edgeA], self.sites.weight, 0.0)

    @property
    def plain(self) -> np.ndarray | None:
        """Coefficients (n, 2) of the sites, if there is no law but a `ResistiveForce` in a medium at rest."""
        one = self.parts[0]
        return None if len(self.parts) > 1 or self.crowds else one.eta

    def force(self, site: LineSites) -> np.ndarray:
        """Force per length [N/m], shape (n, 3)."""
        return _joined([part.force(part.of(site)) for part in self.parts])

    def against(self, site: LineSites) -> tuple[LineSites, np.ndarray | None]:
        """The sites with velocities against the flow of each law, and its gradient (n, 3, 3); None without any."""
        if all(part.law.flow is None for part in self.parts):
            return site, None
        seen, gradient = [], np.zeros((len(site.v), 3, 3))
        for part in self.parts:
            mine = part.of(site)
            seen.append(mine.v)
            if part.law.flow is not None:
                gradient[part.where] = part.law.flow.gradient(mine.x, mine.t)
        return replace(site, v=_joined(seen)), gradient

    def slopes(self, site: LineSites) -> Slopes:
        """Derivatives of the force by ``"v"``, ``"tangent"`` and ``"x"``, shape (n, 3, 3) each."""
        found: list[Slopes] = []
        for part in self.parts:
            s = part.of(site)
            known = part.slopes(s)
            if part.law.flow is not None:
                known["x"] = known["x"] - known["v"] @ part.law.flow.gradient(s.x, s.t)
            found.append(known)
        return {key: _joined([one[key] for one in found]) for key in KEYS}

    def crowding(self, ev: Evaluation) -> np.ndarray | float:
        """Factor by which neighbours make the laws and their changes stronger, shape (n, 1); one without any."""
        if not self.crowds:
            return 1.0
        factor = np.ones((len(self.sites.node), 1))
        for one in self.crowds:
            crowd = ev.model.bound[one.number].crowd(ev)  # type: ignore[attr-defined]
            factor[one.where] = np.exp(one.crowding * crowd[:, None])
        return factor

    def drift(
        self, site: LineSites, u: np.ndarray, slopes: bool, gradient: np.ndarray | None = None
    ) -> tuple[np.ndarray, Slopes]:
        """Force at the velocity against a current less that without it, and its derivatives, as above.

        Laws that are linear in the velocity are asked once, for -u alone: nothing is lost to round-off.

        Parameters
        ----------
        site : LineSites
            Where.
        u : ndarray, shape (3,) or (n, 3)
            The current [m/s].
        slopes : bool
            Whether derivatives are asked for.
        gradient : ndarray, shape (3, 3) or (n, 3, 3), optional
            Of the current, d u_i / d x_j [1/s].
        """
        forces: list[np.ndarray] = []
        found: list[Slopes] = []
        against = -np.broadcast_to(u, site.v.shape)
        for part in self.parts:
            s, law = part.of(site), part.law
            linear = isinstance(law, ResistiveForce | WalledForce)
            moved = replace(s, v=against[part.where] if linear else s.v + against[part.where])
            force = part.force(moved)
            forces.append(force if linear else force - part.force(s))
            if slopes:
                there, here = part.slopes(moved), {} if linear else part.slopes(s)
                by_v = there["v"]
                if linear:
                    found.append(there | {"v": np.zeros_like(by_v)})
                else:
                    found.append({key: there[key] - here[key] for key in KEYS})
                    if law.flow is not None:
                        found[-1]["x"] = found[-1]["x"] - found[-1]["v"] @ law.flow.gradient(s.x, s.t)
                if gradient is not None:
                    here_of = gradient[part.where] if gradient.ndim == 3 else gradient
                    found[-1]["x"] = found[-1]["x"] - by_v @ here_of
        return _joined(forces), {key: _joined([one[key] for one in found]) for key in KEYS if slopes}


@dataclass(frozen=True)
class Crowded:
    """What neighbours do to a drag law of a robot.

    Attributes
    ----------
    number : int
        Of the law, which remembers the crowd, among the robot's terms.
    where : slice
        Which of all sites are its own.
    crowding : float or ndarray, shape (n, 1)
        Logarithm of the factor that one neighbour makes [1].
    """

    number: int
    where: slice
    crowding: Any


@dataclass(frozen=True)
class ChangedLaw:
    """A drag law of a robot.

    Attributes
    ----------
    law, p
        It, and its parameters.
    where : slice
        Which of all sites are its own.
    eta : ndarray, shape (n, 2), or None
        Coefficients of a `ResistiveForce` in a medium at rest.
    vector : ndarray, shape (n, m), or None
        Parameters of a law that is compiled site by site.
    """

    law: Any
    p: Any
    where: slice
    eta: np.ndarray | None
    vector: np.ndarray | None

    def of(self, site: LineSites) -> LineSites:
        """What the law sees of all sites."""
        if self.eta is not None and len(self.eta) == len(site.v):
            return site
        k = self.where
        mine = LineSites(
            site.v[k], site.x[k], site.tangent[k], site.radius[k], site.length[k], site.t, site.dt
        )
        if self.law.flow is not None:
            mine = replace(mine, v=mine.v - self.law.flow.velocity(mine.x, mine.t))
        return mine

    def force(self, site: LineSites) -> np.ndarray:
        """Force per length [N/m], shape (n, 3)."""
        if self.eta is not None:
            return self._resistance(site, False)[0]
        if self.vector is not None:
            return self._compiled(site)[0]
        return np.asarray(self.law.force(site, self.p), dtype=float)

    def slopes(self, site: LineSites) -> Slopes:
        """Its derivatives by ``"v"``, ``"tangent"`` and ``"x"``, shape (n, 3, 3) each."""
        if self.eta is not None:
            return dict(zip(KEYS, self._resistance(site, True)[1:], strict=True))
        if self.vector is not None:
            return dict(zip(KEYS, self._compiled(site)[1:], strict=True))
        return _slopes(self.law, self.p, site)

    def _resistance(self, site: LineSites, slopes: bool) -> tuple[np.ndarray, ...]:
        """Force and derivatives of a `ResistiveForce`: its law, compiled."""
        from rodnet.terms.drag.kernels import site_resistance

        n = len(site.v)
        f, more = np.empty((n, 3)), np.zeros((3, n if slopes else 0, 3, 3))
        site_resistance(self.eta, np.ascontiguousarray(site.v), site.tangent, f, more[0], more[1], slopes)
        return f, *more

    def _compiled(self, site: LineSites) -> tuple[np.ndarray, ...]:
        """Force and derivatives of a law with a kernel: many times as fast as its arrays."""
        from rodnet.terms.drag.site_loop import is_placed, law_address, site_law

        law, n = type(self.law).kernel, len(site.v)
        f, more = np.zeros((n, 3)), np.zeros((3, n, 3, 3))
        seen = map(np.ascontiguousarray, (site.v, site.x, site.tangent, site.radius))
        site_law(law_address(law), is_placed(law), site.t, self.vector, *seen, f, *more)
        return f, *more


def _joined(arrays: list[np.ndarray]) -> np.ndarray:
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)


def _slopes(law: Any, p: Any, site: LineSites) -> Slopes:
    """Derivatives of one law by what it sees, those that it does not give by differences."""
    known = dict(law.jacobian(site, p))
    for key in KEYS:
        if known.get(key) is None:
            known[key] = difference(lambda at: np.asarray(law.force(at, p), dtype=float), site, key)
    return known


def can_change(term: Term) -> bool:
    """Whether a term is a drag law that a change can look up: a medium's, local and without memory."""
    if not isinstance(term, DragModel) or not term.of_medium:
        return False
    return not term.memory_size and term.memory_frame == "body"


def flow_of(robot: Robot) -> Flow | None:
    """Flow of a robot's medium, that of its first law that has one; None in a medium at rest."""
    return next((term.flow for term in robot.terms if can_change(term) and term.flow is not None), None)  # type: ignore[attr-defined]
