"""Rigid bodies of a graph: which stiff parts they consist of, their mass, centre and inertia."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import GraphError
from rodnet.kinematics.frames import transport, unit
from rodnet.parameters import is_number

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
    volume: float | None = None
    cob: np.ndarray | None = None


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
    volume : float or None
        Volume that it displaces [m^3]; None for that of its parts as cylinders.
    cob : ndarray, shape (3,), or None
        Centre of that volume, of buoyancy [m]; None for the centre of mass.
    """

    name: str
    nodes: np.ndarray
    edges: np.ndarray
    mass: float
    com: np.ndarray
    inertia: np.ndarray
    volume: float | None = None
    cob: np.ndarray | None = None

    def mass_points(self) -> np.ndarray:
        """Places of four equal masses with the body's mass, centre and inertia [m], shape (4, 3)."""
        return self.com + CORNERS @ self._arms().T

    def _arms(self) -> np.ndarray:
        second = 0.5 * np.trace(self.inertia) * np.eye(3) - self.inertia
        values, axes = np.linalg.eigh(second)
        # the symmetric root: alone the axes would be anybody's choice where radii of gyration are alike
        return (axes * np.sqrt(3.0 * np.maximum(values, 0.0) / self.mass)) @ axes.T

    def displaced(self) -> np.ndarray:
        """Shares of the displaced volume at the four masses [m^3], with its sum and its centre, shape (4,).

        Some may be negative: forces in proportion to them have the resultant of the volume's, wherever its centre is.

        Raises
        ------
        GraphError
            If the centre lies beside a body that is flat there, and shares can't reach it.
        """
        if self.volume is None:
            return np.zeros(4)
        if self.cob is None:
            return np.full(4, 0.25 * self.volume)
        arms, off = self._arms(), self.cob - self.com
        across = np.linalg.lstsq(arms, off, rcond=1e-9)[0]
        if np.linalg.norm(arms @ across - off) > 1e-9 * (np.abs(arms).max() + np.linalg.norm(off)):
            raise GraphError(
                f"body '{self.name}': its mass is flat, and the centre of its volume lies beside it; give inertia= of "
                "a body that is as thick as it is"
            )
        return 0.25 * self.volume * (1.0 + 3.0 * CORNERS @ across)

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
        before, after = old[self.nodes].mean(axis=0), new[self.nodes].mean(axis=0)
        com = after + R @ (self.com - before)
        cob = None if self.cob is None else after + R @ (self.cob - before)
        return replace(self, com=com, cob=cob, inertia=R @ self.inertia @ R.T), R


def check_body(
    figure: StickFigure,
    parts: str | Sequence[str],
    name: str | None,
    mass: Any,
    com: Any,
    inertia: Any,
    volume: Any = None,
    cob: Any = None,
    mesh: Any = None,
) -> BodySpec:
    """Check what `StickFigure.body` was given, and take what is left from the mesh."""
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
    if volume is not None and not (is_number(volume) and volume >= 0):
        raise GraphError(f"body '{name}': volume = {volume!r} must be a volume [m^3], zero or more")
    if cob is not None and volume is None and mesh is None:
        raise GraphError(f"body '{name}': cob is the centre of a volume; give volume= [m^3], too")
    com, cob = _check_point(name, "com", com), _check_point(name, "cob", cob)
    if mesh is not None:
        mass, com, inertia, volume, cob = _of_mesh(name, mesh, mass, com, inertia, volume, cob)
    inertia = None if inertia is None else _check_inertia(name, inertia)
    return BodySpec(name, names, mass, com, inertia, None if volume is None else float(volume), cob)


def _check_point(name: str, what: str, point: Any) -> np.ndarray | None:
    if point is None:
        return None
    point = np.asarray(point, dtype=float)
    if point.shape != (3,) or not np.all(np.isfinite(point)):
        raise GraphError(f"body '{name}': {what} must be a finite point (x, y, z) [m]")
    return point


def _of_mesh(
    name: str, mesh: Any, mass: Any, com: Any, inertia: Any, volume: Any, cob: Any
) -> tuple[Any, ...]:
    """What was not given from a closed mesh of uniform density."""
    wanted = (
        "is_watertight",
        "is_winding_consistent",
        "volume",
        "center_mass",
        "moment_inertia",
        "mass",
        "density",
    )
    if not all(hasattr(type(mesh), word) for word in wanted):
        raise GraphError(f"body '{name}': mesh must be a trimesh.Trimesh, not {type(mesh).__name__}")
    if not (mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0.0):
        what = (
            "points inward; turn it, mesh.invert()"
            if mesh.is_watertight and mesh.volume < 0.0
            else "is not closed"
        )
        raise GraphError(
            f"body '{name}': the surface of its mesh {what}; volume and inertia are those of a closed surface"
        )
    if mass is None and mesh.density == 1.0:  # that of every mesh to begin with
        raise GraphError(f"body '{name}': give mass= [kg], or set mesh.density [kg/m^3]")
    if (
        inertia is None
        and com is not None
        and not np.allclose(com, mesh.center_mass, rtol=0.0, atol=1e-9 * mesh.scale)
    ):
        raise GraphError(
            f"body '{name}': com is not that of the mesh, so it is not uniform; give inertia= about com, too"
        )
    mass = float(mesh.mass) if mass is None else mass
    inertia = mesh.moment_inertia * (mass / mesh.mass) if inertia is None else inertia
    centre = np.array(mesh.center_mass, dtype=float)
    cob = centre if cob is None else cob
    return mass, centre if com is None else com, inertia, mesh.volume if volume is None else volume, cob


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
    return Body(spec.name, nodes, mine, total, np.asarray(com, dtype=float), inertia, spec.volume, spec.cob)
