"""Changes of drag laws that a robot has: what a law lacks, as a term beside it.

A change looks up the laws of a robot and adds a force that is a function of theirs: at its null value none. So
the medium's own parameters stay where they are, and whatever law a robot has can be made to yield, jam or flow.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import TermError
from rodnet.parameters import Parameter
from rodnet.terms.base import BoundTerm, Term
from rodnet.terms.drag.changed import KEYS, Laws, Slopes
from rodnet.terms.drag.line import LineSites, _BoundLine
from rodnet.terms.local.stations import half_edge_cells

if TYPE_CHECKING:
    from rodnet.packed import Packed
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.pattern import Pattern

NONE = np.zeros((0, 3))  # no slopes


class DragChange(Term):
    """A change of the drag laws of a robot, on the rods that ``on`` names; laws implement `change`.

    It acts on every law of force per length without memory, so far as that acts on these rods; a law is found
    whatever it is called. Where neighbours make a law stronger (`CrowdedForce`), they make its change as much
    stronger. With ``eta_t`` and ``eta_n`` it is the change of a medium of these coefficients, which itself is not
    there.

    Parameters
    ----------
    on : str or sequence of str
        The rods.
    eta_t, eta_n : float or Parameter, optional
        Coefficients along and across the rod [Pa s] of what is changed; both or none.
    """

    kind = "drag"
    eta_t = Parameter(None, unit="Pa s", bounds=(0, None), kind="shape", doc="drag along that is changed")
    eta_n = Parameter(None, unit="Pa s", bounds=(0, None), kind="shape", doc="drag across that is changed")

    def __init__(self, on: Any = "*", **options: Any) -> None:
        super().__init__(on, **options)
        if (self.eta_t.value is None) != (self.eta_n.value is None):
            raise TermError(f"{type(self).__name__}: give both eta_t= and eta_n=, or neither")

    def change(
        self, laws: Laws, site: LineSites, cells: np.ndarray, p: Any, slopes: bool
    ) -> tuple[np.ndarray, Slopes]:
        """Force per length [N/m] that comes on top, shape (n, 3), and its derivatives if asked for.

        Parameters
        ----------
        laws : Laws
            What the robot's laws say: ``laws.force(site)``, ``laws.slopes(site)``.
        site : LineSites
            Where.
        cells : ndarray, shape (n, 2)
            Part of its rod that each site stands for, over the rod's length.
        p
            Parameters.
        slopes : bool
            Whether derivatives are asked for: by ``"v"``, ``"tangent"`` and ``"x"``, shape (n, 3, 3) each.
        """
        raise TermError(f"{type(self).__name__} must implement change(self, laws, site, cells, p, slopes)")

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the sites of the laws that it changes.

        Raises
        ------
        TermError
            If there is none.
        """
        self.check_numbers()
        return _BoundChange(self, model, Laws(self, model))


class Current(DragChange):
    """A medium that moves by itself: the laws against its current; laws give that of a place and time.

    It is ``(U + A x) cos(w t) + (V + B x) sin(w t)`` with ``w = 2 pi frequency``, everywhere or within a window.
    """

    def coefficients(self, p: Any) -> np.ndarray:
        """Values of U, A row by row, V and B, shape (24,)."""
        raise TermError(f"{type(self).__name__} must implement coefficients(self, p)")

    def frequency_of(self, p: Any) -> float:
        """Frequency [Hz]; zero of what is steady."""
        return 0.0

    def window(self, p: Any) -> np.ndarray:
        """Middle c [m] and b [1/m^2] of ``exp(-b |x - c|^2)``, by which the current fades, shape (4,)."""
        return np.zeros(4)

    def current(self, site: LineSites, p: Any) -> tuple[np.ndarray, np.ndarray]:
        """Velocity of the medium [m/s], shape (n, 3), and its gradient [1/s], shape (3, 3) or (n, 3, 3)."""
        now = at_time(self.coefficients(p)[:, None], self.frequency_of(p), site.t)[:, 0]
        A, window = now[3:].reshape(3, 3), self.window(p)
        u = now[:3] + site.x @ A.T
        if not window[3]:
            return u, A
        share, away = shares_within(site.x, window[:, None])[:, 0], site.x - window[:3]
        u = share[:, None] * u
        return u, share[:, None, None] * A - 2.0 * window[3] * u[:, :, None] * away[:, None, :]

    def change(
        self, laws: Laws, site: LineSites, cells: np.ndarray, p: Any, slopes: bool
    ) -> tuple[np.ndarray, Slopes]:
        """Force per length [N/m] that comes on top, shape (n, 3), and its derivatives."""
        u, gradient = self.current(site, p)
        return laws.drift(site, u, slopes, gradient)


def at_time(coefficients: np.ndarray, frequency: Any, t: float) -> np.ndarray:
    """Current at the origin and its gradient row by row at a time, of several currents, shape (12, k)."""
    angle = 2.0 * np.pi * np.asarray(frequency) * t
    return np.cos(angle) * coefficients[:12] + np.sin(angle) * coefficients[12:]


def shares_within(x: np.ndarray, windows: np.ndarray) -> np.ndarray:
    """What is left of k currents at places (n, 3) by their windows, shape (4, k); shape (n, k)."""
    away = x[:, :, None] - windows[:3]
    return np.asarray(np.exp(-windows[3] * np.sum(away**2, axis=1)))


class _BoundChange(_BoundLine):
    """The change of all laws at once; where it vanishes nothing is evaluated."""

    def __init__(self, term: DragChange, model: Model, laws: Laws) -> None:
        super().__init__(term, model, laws.sites)
        self.law, self.laws = term, laws
        self.p = term.values()
        strengths = [(k, d.null) for k, d in term.declared().items() if d.null is not None]
        self.idle = all(getattr(self.p, k) == null for k, null in strengths if getattr(self.p, k) is not None)
        s = self.sites
        cells = half_edge_cells(model, s.node, s.edgeA)
        if np.any(s.edgeB >= 0):
            two = s.edgeB >= 0
            other = half_edge_cells(model, s.node, np.where(two, s.edgeB, s.edgeA))
            low, high = np.minimum(cells[:, 0], other[:, 0]), np.maximum(cells[:, 1], other[:, 1])
            size = np.diff(cells, axis=1)[:, 0] + np.diff(other, axis=1)[:, 0]
            two &= high - low < 1.5 * size  # where a ring closes one of the two stands for both
            cells = np.where(two[:, None], np.stack([low, high], axis=1), cells)
        self.cells = cells
        self.packed: Packed | None = None

    def find_slots(self, pattern: Pattern, stencils: list[np.ndarray]) -> None:
        super().find_slots(pattern, stencils)
        eta = self.laws.plain
        self.packed = self.pack(eta) if eta is not None and self.scales else None

    @property
    def scales(self) -> bool:
        """Whether it is a factor on the laws."""
        return type(self.law).change is ScaledDrag.change

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        if self.idle:
            return 0.0
        site = self.view(ev)
        if self.packed is not None:
            return self._scaled(ev, site, F, data, jac)
        w = self._weights(ev)
        f, slopes = self.law.change(self.laws, site, self.cells, self.p, jac)
        if not jac:
            zero = np.zeros((len(f), 3, 3))
            return self.scatter(ev, w * f, zero, zero, 0.0, F, data, False)
        v, tangent, x = (slopes[key] * w[:, :, None] for key in KEYS)
        return self.scatter(ev, w * f, ev.cv * v + x, tangent, 1.0, F, data, True)

    def _scaled(self, ev: Evaluation, site: LineSites, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        """The same of a factor on resistive force theory, compiled."""
        from rodnet.terms.drag.kernels import scaled_resistance

        g, *by = self.law.factor(site, self.cells, self.p)  # type: ignore[attr-defined]
        by_v, by_x = (NONE if slope is None else np.ascontiguousarray(slope) for slope in by)
        table = self.packed.table  # type: ignore[union-attr]
        return scaled_resistance(table, np.ravel(g), by_v, by_x, ev.state, ev.cv, F, data, jac)

    def _weights(self, ev: Evaluation) -> np.ndarray:
        """Lengths of the sites [m], times what neighbours make of a force there, shape (n, 1)."""
        return self.sites.weight[:, None] * self.laws.crowding(ev)

    def site_forces(self, ev: Evaluation) -> np.ndarray:
        """Forces on the sites [N], shape (n, 3)."""
        return self._weights(ev) * self.law.change(self.laws, self.view(ev), self.cells, self.p, False)[0]


class ScaledDrag(DragChange):
    """Drag that is ``1 + factor`` times as strong; laws implement `factor`."""

    claims: ClassVar[set[str]] = {"objective"}

    def factor(
        self, site: LineSites, cells: np.ndarray, p: Any
    ) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
        """Relative change of the drag, shape (n, 1), and its derivatives by velocity and place, (n, 3) or None.

        Velocities are those against the medium.
        """
        raise TermError(f"{type(self).__name__} must implement factor(self, site, cells, p)")

    def change(
        self, laws: Laws, site: LineSites, cells: np.ndarray, p: Any, slopes: bool
    ) -> tuple[np.ndarray, Slopes]:
        """Force per length [N/m] that comes on top, shape (n, 3), and its derivatives."""
        force = laws.force(site)
        seen, gradient = laws.against(site)
        g, by_v, by_x = self.factor(seen, cells, p)
        if gradient is not None and by_v is not None:
            moved = -np.einsum("ni,nik->nk", by_v, gradient)
            by_x = moved if by_x is None else by_x + moved
        if not slopes:
            return g * force, {}
        found = {key: g[:, :, None] * slope for key, slope in laws.slopes(site).items()}
        for key, slope in (("v", by_v), ("x", by_x)):
            if slope is not None:
                found[key] = found[key] + force[:, :, None] * slope[:, None, :]
        return g * force, found
