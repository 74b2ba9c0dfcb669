"""What all contact terms share: parameters, and their defaults."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import TermError
from rodnet.parameters import Parameter
from rodnet.terms.base import Term

if TYPE_CHECKING:
    from rodnet.graph.rod_graph import RodGraph

REACH = 0.1  # default reach over the radius, or the sum of both
FIRMNESS = 0.03  # default stiffness x reach over the axial stiffness EA


class Contact(Term):
    """Base class of contact terms: a barrier on the gap, and Coulomb friction.

    Parameters
    ----------
    friction : float or Parameter
        Coefficient of friction [1].
    stiffness : float or Parameter
        Contact force at about half the reach, over the reach [N/m]; by default 0.03 EA / reach.
    reach : float or Parameter
        Gap at which contact begins [m]; by default a tenth of the rod's radius (of the sum of both
        radii between rods).
    slip : float or Parameter
        Speed below which friction is regularised [m/s].
    damping : float or Parameter
        Share by which the normal force grows per speed of approach, and falls per speed of parting [s/m].
    rod_radius : float or Parameter
        Outer radius of the rods [m]; by default their own.
    """

    kind = "contact"
    friction = Parameter(0.0, unit="1", bounds=(0, None), doc="coefficient of friction")
    stiffness = Parameter(
        None, unit="N/m", bounds=(1e-30, None), doc="force at half the reach, over the reach"
    )
    reach = Parameter(None, unit="m", bounds=(1e-12, None), kind="shape", doc="gap at which contact begins")
    slip = Parameter(
        1e-3, unit="m/s", bounds=(1e-12, None), kind="shape", doc="speed that regularises friction"
    )
    damping = Parameter(0.0, unit="s/m", bounds=(0, None), doc="damping of the normal force")
    rod_radius = Parameter(None, unit="m", bounds=(0, None), kind="shape", doc="outer radius of the rods")


def edge_radii(term: Contact, graph: RodGraph) -> np.ndarray:
    """Outer radius of every edge [m], shape (E,).

    Raises
    ------
    TermError
        If it is not one number.
    """
    radius = term.rod_radius.value
    if np.size(radius) > 1:
        raise TermError(
            f"contact '{term.name}': rod_radius is one number; give a contact for each kind of rod (on=)"
        )
    return graph.radius if radius is None else np.full(graph.edge_count, float(np.max(radius)))


def firmness(term: Contact, graph: RodGraph) -> np.ndarray:
    """Axial stiffness that the default contact stiffness of every edge follows from [N], shape (E,).

    A rigid body has none of its own and counts as the stiffest soft rod.
    """
    soft = np.isfinite(graph.EA)
    if not soft.any() and term.stiffness.value is None:
        raise TermError(
            f"contact '{term.name}': rigid bodies alone do not say how firm they are; give stiffness= [N/m]"
        )
    return np.where(soft, graph.EA, graph.EA[soft].max(initial=0.0))


def law_table(
    p: Any, radius: np.ndarray, EA: np.ndarray, clearance: np.ndarray | float = np.inf
) -> np.ndarray:
    """Stiffness, reach, friction, slip speed and damping of each site, shape (n, 5).

    Parameters
    ----------
    p : namespace
        The term's values.
    radius, EA : ndarray, shape (n,)
        Radius (or sum of radii) [m], and axial stiffness [N].
    clearance : ndarray, shape (n,), or float
        The default reach is at most half of it [m].
    """
    n = len(radius)
    reach = (
        np.minimum(REACH * radius, 0.5 * clearance)
        if p.reach is None
        else np.broadcast_to(np.ravel(p.reach), n)
    )
    stiffness = FIRMNESS * EA / reach if p.stiffness is None else np.broadcast_to(np.ravel(p.stiffness), n)
    friction, slip, damping = (np.broadcast_to(np.ravel(a), n) for a in (p.friction, p.slip, p.damping))
    return np.ascontiguousarray(np.stack([stiffness, reach, friction, slip, damping], axis=1))
