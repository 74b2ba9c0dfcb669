"""Rigid bodies of a graph: which stiff parts they consist of, their mass, centre and inertia."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import GraphError
from rodnet.kinematics.frames import transport, unit

if TYPE_CHECKING:
    from rodnet.graph.stick_figure import StickFigure

# corners of a regular tetrahedron of unit radius
CORNERS = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]]) / np.sqrt(3.0)


@dataclass(frozen=True)
class BodySpec:
    """What the user said of one rigid body; see `StickFigure.body`."""

    name: str
    parts: tuple[str, ...]
    mass: float | None = None
    com: np.ndarray | None = None
    inertia: np.ndarray | None = None


@dataclass(frozen=True)
class Body:
    """A rigid body of a graph, in the graph's initial position.

    Attributes
    ----------
    name : str
        Its name.
    nodes, edges : ndarray of int
        Its nodes and edges.
    mass : float
        Its own mass [kg], without what soft rods bring to its nodes.
    com : ndarray, shape (3,)
        Centre of that mass [m].
    inertia : ndarray, shape (3, 3)
        Moments of inertia about the centre, in space [kg m^2].
    """

    name: str
    nodes: np.ndarray
    edges: np.ndarray
    mass: float
    com: np.ndarray
    inertia: np.ndarray

    def mass_points(self) -> np.ndarray:
        """Places of four equal masses with the body's mass, centre and inertia [m], shape (4, 3)."""
        second = 0.5 * np.trace(self.inertia) * np.eye(3) - self.inertia
        values, axes = np.linalg.eigh(second)
        arms = axes * np.sqrt(3.0 * np.maximum(values, 0.0) / self.mass)
        return self.com + CORNERS @ arms.T

    def moved(self, old: np.ndarray, new: np.ndarray, edges: np.ndarray) -> tuple[Body, np.ndarray]:
        """Return the body after a rigid motion of its nodes, and the rotation, shape (3, 3).

        Parameters
        ----------
        old, new : ndarray, shape (N, 3)
            Positions of all nodes of the graph [m] before and after.
        edges : ndarray, shape (E, 2)
            Nodes of all edges.

        Raises
        ------
        GraphError
            If the positions deform the body.
        """
        arms, turned = (x[self.nodes] - x[self.nodes].mean(axis=0) for x in (old, new))
        rank = np.linalg.matrix_rank(arms, tol=1e-9 * np.abs(arms).max())
        if rank < 2:  # a straight body does not show its spin: the smallest rotation
            i, j = edges[self.edges[0]]
            R = transport(np.eye(3), unit(old[j] - old[i]), unit(new[j] - new[i])).T
        else:
            u, _, vt = np.linalg.svd(turned.T @ arms)
            R = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
        if np.abs(turned - arms @ R.T).max() > 1e-6 * np.abs(arms).max():
            raise GraphError(f"the positions deform the rigid body '{self.name}'; move its nodes as one")
        com = new[self.nodes].mean(axis=0) + R @ (self.com - old[self.nodes].mean(axis=0))
        return replace(self, com=com, inertia=R @ self.inertia @ R.T), R


def check_body(
    figure: StickFigure, parts: str | Sequence[str], name: str | None, mass: Any, com: Any, inertia: Any
) -> BodySpec:
    """Check what `StickFigure.body` was given."""
    names = (parts,) if isinstance(parts, str) else tuple(parts)
    if not names:
        raise GraphError("a body needs at least one stiff part: fig.body('head')")
    name = name or names[0]
    taken = {part: body.name for body in figure.bodies.values() for part in body.parts}
    for part in names:
        spec = figure.specs.get(part)
        if spec is None:
            raise GraphError(
                f"body '{name}': there is no part '{part}'; draw it first, fig.rigid('{part}', ...)"
            )
        if spec.kind != "rigid":
            raise GraphError(f"body '{name}': '{part}' is a soft rod; draw it with fig.rigid(...) instead")
        if part in taken:
            raise GraphError(f"body '{name}': the part '{part}' already belongs to the body '{taken[part]}'")
    if len(set(names)) != len(names):
        raise GraphError(f"body '{name}': a part is named twice")
    if mass is not None and not (np.isfinite(mass) and mass > 0):
        raise GraphError(f"body '{name}': mass = {mass!r} must be positive and finite [kg]")
    if com is not None:
        com = np.asarray(com, dtype=float)
        if com.shape != (3,) or not np.all(np.isfinite(com)):
            raise GraphError(f"body '{name}': com must be a finite point (x, y, z) [m]")
    return BodySpec(name, names, mass, com, None if inertia is None else _check_inertia(name, inertia))


def _check_inertia(name: str, inertia: Any) -> np.ndarray:
    """Moments of inertia as a matrix; three numbers are those about the axes."""
    tensor = np.asarray(inertia, dtype=float)
    tensor = np.diag(tensor) if tensor.shape == (3,) else tensor
    if tensor.shape != (3, 3) or not np.all(np.isfinite(tensor)):
        raise GraphError(f"body '{name}': inertia must be finite, of shape (3,) or (3, 3) [kg m^2]")
    size = np.abs(tensor).max()
    if np.abs(tensor - tensor.T).max() > 1e-9 * size:
        raise GraphError(f"body '{name}': the inertia must be symmetric")
    least, middle, largest = np.linalg.eigvalsh(tensor)
    if not (least >= 0.0 < largest and largest <= (least + middle) * (1.0 + 1e-6)):
        raise GraphError(
            f"body '{name}': no body has the principal moments {least:.4g}, {middle:.4g}, {largest:.4g} kg m^2: none "
            "is negative or exceeds the sum of the two others; check axes, products of inertia and units"
        )
    return tensor


def make_bodies(
    figure: StickFigure, first: np.ndarray, x0: np.ndarray, edges: np.ndarray, props: dict[str, np.ndarray]
) -> tuple[Body, ...]:
    """Make the bodies of a figure, and take the masses of their parts out of ``props``.

    Parameters
    ----------
    figure : StickFigure
        What was drawn.
    first : ndarray of int
        First edge of each part, in the order of drawing.
    x0, edges : ndarray, shapes (N, 3) and (E, 2)
        Positions [m] and the nodes of each edge.
    props : dict
        ``mass``, ``radius`` and ``inertia`` (about its axis) of each edge, arrays of shape (E,).
    """
    number = {name: k for k, name in enumerate(figure.specs)}
    owner: dict[int, str] = {}
    bodies = []
    for spec in figure.bodies.values():
        spans = [np.arange(first[number[part]], first[number[part] + 1]) for part in spec.parts]
        mine = np.concatenate(spans)
        nodes = np.unique(edges[mine])
        shared = next((n for n in nodes.tolist() if n in owner), None)
        if shared is not None:
            raise GraphError(
                f"the bodies '{owner[shared]}' and '{spec.name}' share a node; make them one body, or join them by a "
                "short stiff part that belongs to neither, fig.rigid('shaft', ...)"
            )
        owner.update(dict.fromkeys(nodes.tolist(), spec.name))
        bodies.append(_body(spec, nodes, mine, x0, edges, props))
        props["mass"][mine] = props["inertia"][mine] = 0.0
    return tuple(bodies)


def _body(spec: BodySpec, nodes, mine, x0, edges, props) -> Body:
    """Mass properties as given, else those of uniform cylinders along the body's edges."""
    mass, radius = props["mass"][mine], props["radius"][mine]
    total = float(mass.sum()) if spec.mass is None else float(spec.mass)
    if not total > 0.0:
        raise GraphError(f"body '{spec.name}': there is no soft rod to take a density from; give mass= [kg]")
    share = mass if mass.sum() > 0.0 else np.linalg.norm(x0[edges[mine, 1]] - x0[edges[mine, 0]], axis=1)
    mass = total * share / share.sum()
    middle, vector = x0[edges[mine]].mean(axis=1), x0[edges[mine, 1]] - x0[edges[mine, 0]]
    centre = mass @ middle / total
    com = centre if spec.com is None else spec.com
    inertia = spec.inertia
    if inertia is None:
        second = np.einsum("e,ei,ej->ij", mass / 12.0, vector, vector)
        second += np.einsum("e,ei,ej->ij", mass, middle - centre, middle - centre)
        t = unit(vector)
        across = np.eye(3) - t[:, :, None] * t[:, None, :]
        second += np.einsum("e,eij->ij", 0.25 * mass * radius**2, across)
        inertia = np.trace(second) * np.eye(3) - second
    return Body(spec.name, nodes, mine, total, np.asarray(com, dtype=float), inertia)
