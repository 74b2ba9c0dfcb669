"""Mass that differs along a rod: a gradient, and a lump."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import TermError
from rodnet.parameters import Parameter
from rodnet.terms.base import BoundTerm, Term
from rodnet.terms.local.stations import bump, half_edge_cells

if TYPE_CHECKING:
    from rodnet.solve.model import Model


class MassChange(Term):
    """Mass that is added to a rod's, with inertia, weight and damping; laws implement `masses`.

    It is in the model's masses before any term is bound, so whatever acts on mass acts on it.
    """

    kind = "load"

    def masses(self, cells: np.ndarray, mass: np.ndarray, p: Any) -> np.ndarray:
        """Mass added to each half edge [kg], shape (n,).

        Parameters
        ----------
        cells : ndarray, shape (n, 2)
            Where it begins and ends along its rod, over the rod's length.
        mass : ndarray, shape (n,)
            Its own mass [kg].
        p
            Parameters.
        """
        raise TermError(f"{type(self).__name__} must implement masses(self, cells, mass, p)")

    def add_masses(self, model: Model) -> None:
        """Add to the model's masses, and to moments of inertia in proportion.

        Raises
        ------
        TermError
            If a mass would be negative.
        """
        self.check_numbers()
        graph, p = model.graph, self.values()
        node_mass, inertia = model.node_mass.copy(), model.edge_inertia.copy()
        for name in graph.rod_names(self.on):
            edges = graph.rods[name].edges
            edges = edges[np.isin(edges, graph.edge_indices(self.on))]
            own = graph.edge_mass[edges]
            if not own.any():  # rigid bodies have masses of their own
                continue
            node, edge = graph.edges[edges].ravel(), np.repeat(edges, 2)
            added = self.masses(half_edge_cells(model, node, edge), np.repeat(0.5 * own, 2), p)
            np.add.at(node_mass, node, added)
            inertia[edges] *= 1.0 + added.reshape(-1, 2).sum(axis=1) / own
        if node_mass.min() < 0.0 or inertia.min() < 0.0:
            raise TermError(f"{type(self).__name__} '{self.name}' leaves a node with a negative mass")
        model.node_mass, model.edge_inertia = node_mass, inertia

    def bind(self, model: Model) -> BoundTerm:
        """Nothing is left to do."""
        model.graph.edge_indices(self.on)
        return BoundTerm(self)


class MassGradient(MassChange):
    """Mass per length that changes along a rod, by the factor 1 + slope (s - 1/2).

    Parameters
    ----------
    on : str or sequence of str
        The rods; s runs from 0 to 1 along each.
    slope : float or Parameter
        Change from start to end, over the mean [1].
    """

    default_name = "mass_gradient"
    source = "lumped masses; docs, theory: what differs along a rod"
    example: ClassVar[dict[str, float]] = {"slope": 0.8}
    slope = Parameter(
        0.0, unit="1", bounds=(-1.98, 1.98), null=0.0, doc="change from start to end, over the mean"
    )

    def masses(self, cells: np.ndarray, mass: np.ndarray, p: Any) -> np.ndarray:
        """Mass added to each half edge [kg], shape (n,)."""
        return p.slope * (cells.mean(axis=1) - 0.5) * mass


class LocalMass(MassChange):
    """A mass that sits somewhere on a rod: a marker, a connector, a payload.

    Parameters
    ----------
    on : str or sequence of str
        The rods, each of which carries one.
    mass : float or Parameter
        The mass [kg].
    place, width : float or Parameter
        Its place and half width, over the rod's length [1].
    """

    default_name = "lump"
    source = "lumped masses; docs, theory: what differs along a rod"
    example: ClassVar[dict[str, float]] = {"mass": 2e-3, "place": 0.6, "width": 0.1}
    mass = Parameter(0.0, unit="kg", bounds=(0, None), null=0.0, doc="mass of the lump")
    place = Parameter(0.5, unit="1", bounds=(0.0, 1.0), kind="shape", doc="middle, over the rod's length")
    width = Parameter(
        0.02, unit="1", bounds=(1e-3, 1.0), kind="shape", doc="half width, over the rod's length"
    )

    def masses(self, cells: np.ndarray, mass: np.ndarray, p: Any) -> np.ndarray:
        """Mass added to each half edge [kg], shape (n,)."""
        part = bump(cells, p.place, p.width) * np.diff(cells, axis=1)[:, 0]
        if not part.sum() > 0.0:
            raise TermError(
                f"LocalMass '{self.name}': nothing of {self.on} is near place = {p.place:g}; move it, or let on= "
                "name more"
            )
        return p.mass * part / part.sum()
