"""Random robots, and several ways to draw one and the same robot.

A `Sketch` says what a robot is: points, rods between them, hubs. `Sketch.draw` turns it into a
`RodGraph` and remembers which node and edge became which, so that a state can be carried from one
drawing of a robot to another: with rods in another order, drawn the other way round, or cut in two.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from rodnet.graph.material import Material, Section, circular, elliptic, hollow
from rodnet.graph.rod_graph import RodGraph
from rodnet.graph.stick_figure import StickFigure
from rodnet.kinematics.frames import unit

EDGE = 0.02  # typical length of an edge [m]
APART = np.radians(40.0)  # smallest angle between two edges at a node of a random robot


@dataclass(frozen=True)
class SketchRod:
    """One rod of a `Sketch`.

    Attributes
    ----------
    name : str
        Its name.
    points : tuple of int
        Indices of the sketch's points along it.
    section : Section or None
        None for a stiff part.
    material : Material or None
        None for a stiff part.
    natural : {"initial", "straight"}
        Its undeformed shape.
    closed : bool
        Whether it is a ring.
    director : ndarray or None
        First material director at its start; carried from its neighbours if None.
    """

    name: str
    points: tuple[int, ...]
    section: Section | None = None
    material: Material | None = None
    natural: str = "initial"
    closed: bool = False
    director: np.ndarray | None = None

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """End points of each edge."""
        ring = self.points + self.points[:1] if self.closed else self.points
        return list(pairwise(ring))


@dataclass(frozen=True)
class Drawing:
    """A graph, and where the points and edges of its sketch went.

    Attributes
    ----------
    graph : RodGraph
        The graph.
    nodes : ndarray, shape (points,)
        Node of each point of the sketch.
    edges : dict
        Edge and direction (+1 or -1) by its two points in increasing order.
    """

    graph: RodGraph
    nodes: np.ndarray
    edges: Mapping[tuple[int, int], tuple[int, float]]

    def carry(self, q: np.ndarray, to: Drawing) -> np.ndarray:
        """Carry a vector over the degrees of freedom (positions, rates, forces) to another drawing."""
        n = len(self.nodes)
        out = np.empty(to.graph.dof_count)
        out[: 3 * n].reshape(-1, 3)[to.nodes] = q[: 3 * n].reshape(-1, 3)[self.nodes]
        for pair, (edge, sign) in self.edges.items():
            other, direction = to.edges[pair]
            out[3 * n + other] = sign * direction * q[3 * n + edge]
        return out

    def carry_frames(
        self, tangents: np.ndarray, directors: np.ndarray, to: Drawing
    ) -> tuple[np.ndarray, np.ndarray]:
        """Carry tangents and first directors, shape (E, 3) each.

        Tangents turn round with the direction of drawing. Where the other drawing starts from other
        directors, the carried ones differ from these by the same angle about the edge.
        """
        t, d = np.empty_like(tangents), np.empty_like(directors)
        for pair, (edge, sign) in self.edges.items():
            other, direction = to.edges[pair]
            i, j = self.graph.edges[edge]
            axis = unit(self.graph.x0[j] - self.graph.x0[i])
            first, wanted = self.graph.d1[edge], to.graph.d1[other]
            cos, sin = first @ wanted, np.cross(axis, first) @ wanted
            d[other] = cos * directors[edge] + sin * np.cross(tangents[edge], directors[edge])
            t[other] = sign * direction * tangents[edge]
        return t, d


@dataclass(frozen=True)
class Sketch:
    """A robot before it is drawn.

    Attributes
    ----------
    points : ndarray, shape (n, 3)
        Positions of the nodes [m].
    rods : tuple of SketchRod
        Rods and stiff parts, in the order of drawing.
    hubs : dict
        Hub edge of a joint, by its two points, by the joint's point.
    """

    points: np.ndarray
    rods: tuple[SketchRod, ...]
    hubs: Mapping[int, tuple[int, int]] = field(default_factory=dict)

    def draw(self) -> Drawing:
        """Build the graph."""
        figure = StickFigure()
        reference: dict[int, str] = {}
        for rod in self.rods:
            points = [reference.get(p, self.points[p]) for p in rod.points]
            if rod.section is None or rod.material is None:
                length = sum(float(np.linalg.norm(self.points[b] - self.points[a])) for a, b in rod.pairs)
                figure.rigid(rod.name, points, mass=0.1 * length, radius=4e-3)
            else:
                figure.rod(
                    rod.name, points, material=rod.material, section=rod.section, natural=rod.natural,
                    closed=rod.closed, director=None if rod.director is None else rod.director.tolist(),
                )  # fmt: skip
            for k, p in enumerate(rod.points):
                reference.setdefault(p, f"{rod.name}:{k}")
        for point, pair in self.hubs.items():
            rod, k = next((r, k) for r in self.rods for k, ab in enumerate(r.pairs) if set(ab) == set(pair))
            figure.joint(reference[point], hub=f"{rod.name}:{k}-{k + 1}")
        graph = figure.build()
        nodes, edges = np.empty(len(self.points), dtype=np.int64), {}
        for rod in self.rods:
            built = graph.rods[rod.name]
            nodes[list(rod.points)] = built.nodes[: len(rod.points)]
            for (a, b), edge in zip(rod.pairs, built.edges, strict=True):
                edges[min(a, b), max(a, b)] = (int(edge), 1.0 if a < b else -1.0)
        return Drawing(graph, nodes, edges)

    # -- other drawings of the same robot --------------------------------------------------
    def framed(self) -> Sketch:
        """The same robot with the material directors that it is drawn with written down."""
        drawing = self.draw()
        rods = [
            rod
            if rod.section is None
            else replace(rod, director=drawing.graph.d1[drawing.graph.rods[rod.name].edges[0]])
            for rod in self.rods
        ]
        return replace(self, rods=tuple(rods))

    def reordered(self, order: np.ndarray) -> Sketch:
        """The same robot with its rods, hence its nodes and edges, in another order."""
        return replace(self, rods=tuple(self.rods[k] for k in order))

    def flipped(self, *which: int) -> Sketch:
        """The same robot with some rods drawn from their end to their start."""
        drawing, rods = self.draw(), list(self.rods)
        for k in which:
            rod = rods[k]
            last = drawing.graph.rods[rod.name].edges[-1]
            points = rod.points[:1] + rod.points[:0:-1] if rod.closed else rod.points[::-1]
            director = None if rod.section is None else drawing.graph.d1[last]
            rods[k] = replace(rod, points=points, director=director)
        return replace(self, rods=tuple(rods))

    def cut(self, which: int, at: int) -> Sketch:
        """The same robot with one rod drawn as two that are joined at its node ``at``."""
        rod, drawing = self.rods[which], self.draw()
        if rod.closed or not 0 < at < len(rod.points) - 1:
            raise ValueError(f"rod '{rod.name}' has no inner node {at} to cut it at")
        director = drawing.graph.d1[drawing.graph.rods[rod.name].edges[at]]
        second = replace(
            rod,
            name=f"{rod.name}b",
            points=rod.points[at:],
            director=None if rod.section is None else director,
        )
        first = replace(rod, points=rod.points[: at + 1])
        return replace(self, rods=(*self.rods[:which], first, *self.rods[which + 1 :], second))


def random_sketch(
    rng: np.random.Generator,
    *,
    rods: int = 3,
    edges: int = 3,
    degree: int = 3,
    loops: int = 0,
    ring: bool = False,
    stiff: bool = True,
    hubs: bool = False,
    joints: str = "anywhere",
) -> Sketch:
    """A random robot: a tree of curved rods with uneven edges, closed by ``loops`` more rods.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of all chance.
    rods, edges : int
        Number of rods, and the largest number of edges of one.
    degree : int
        Largest number of edges that meet at a node.
    loops : int
        Rods that join two nodes of the tree.
    ring : bool
        Add a closed rod apart from the others: a second robot in the same graph.
    stiff : bool
        Make some of the rods after the first stiff parts.
    hubs : bool
        Declare a hub at some of the joints.
    joints : {"anywhere", "star"}
        Where new rods begin: at any node, or all at the first rod's end as far as ``degree`` allows.
    """
    maker = _Maker(rng, degree)
    start = maker.add_point(np.zeros(3))
    maker.walk(start, np.array([1.0, 0.0, 0.0]), max(edges, 2), stiff=False)
    hub = maker.rods[0].points[-1]
    for _ in range(rods - 1):
        open_nodes = [p for p, around in maker.around.items() if len(around) < degree]
        node = hub if joints == "star" and hub in open_nodes else int(rng.choice(open_nodes))
        direction = maker.free_direction(node)
        if direction is not None:
            maker.walk(node, direction, int(rng.integers(1, edges + 1)), stiff and rng.random() < 0.3)
    for _ in range(loops):
        maker.close_loop()
    if ring:
        maker.add_ring()
    declared = {}
    for point, around in maker.around.items():
        if hubs and len(around) > 2 and rng.random() < 0.7:
            declared[point] = (point, int(rng.choice(around)))
    return Sketch(np.array(maker.points), tuple(maker.rods), declared)


class _Maker:
    """Grows a random sketch rod by rod."""

    def __init__(self, rng: np.random.Generator, degree: int) -> None:
        self.rng, self.degree = rng, degree
        self.points: list[np.ndarray] = []
        self.rods: list[SketchRod] = []
        self.around: dict[int, list[int]] = {}

    def add_point(self, x: np.ndarray) -> int:
        self.points.append(x)
        self.around[len(self.points) - 1] = []
        return len(self.points) - 1

    def add_rod(self, points: list[int], stiff: bool, closed: bool = False) -> None:
        rng = self.rng
        if not closed and len(self.rods) and rng.random() < 0.5:
            points = points[::-1]
        section, material = None, None
        if not stiff:
            r = rng.uniform(2e-3, 4e-3)
            section = [circular(r), elliptic(r, r * rng.uniform(0.5, 1.5)), hollow(r, 0.6 * r)][
                rng.integers(3)
            ]
            material = Material(
                E=rng.uniform(1e6, 3e6), nu=rng.uniform(0.2, 0.5), rho=rng.uniform(800.0, 1500.0)
            )
        natural = "straight" if not stiff and rng.random() < 0.3 else "initial"
        rod = SketchRod(f"r{len(self.rods)}", tuple(points), section, material, natural, closed)
        self.rods.append(rod)
        for a, b in rod.pairs:
            self.around[a].append(b)
            self.around[b].append(a)

    def walk(self, start: int, direction: np.ndarray, count: int, stiff: bool) -> None:
        """Add a rod that leaves a node in a direction and bends by up to 40 degrees per node."""
        points = [start]
        for k in range(count):
            if k:
                turn = self.rng.normal(size=3)
                direction = unit(direction + 0.5 * unit(turn - turn @ direction * direction))
            points.append(
                self.add_point(self.points[points[-1]] + EDGE * self.rng.uniform(0.6, 1.4) * direction)
            )
        self.add_rod(points, stiff)

    def free_direction(self, node: int) -> np.ndarray | None:
        """A direction that keeps apart from the edges at a node."""
        taken = [unit(self.points[p] - self.points[node]) for p in self.around[node]]
        for _ in range(100):
            direction = unit(self.rng.normal(size=3))
            if all(direction @ t < np.cos(APART) for t in taken):
                return direction
        return None

    def close_loop(self) -> None:
        """Join two nodes of the tree by a rod of three edges."""
        for _ in range(50):
            a, b = (int(k) for k in self.rng.choice(len(self.points), 2, replace=False))
            if len(self.around[a]) >= self.degree or len(self.around[b]) >= self.degree:
                continue
            first, second = self.free_direction(a), self.free_direction(b)
            if first is None or second is None:
                continue
            inner = [self.points[a] + EDGE * first, self.points[b] + EDGE * second]
            span = inner[1] - inner[0]
            if np.linalg.norm(span) > 0.5 * EDGE and min(unit(span) @ first, -unit(span) @ second) > -0.7:
                self.add_rod([a, *(self.add_point(x) for x in inner), b], False)
                return

    def add_ring(self) -> None:
        """Add a ring of six edges far from the rest."""
        angle = np.arange(6) * np.pi / 3.0
        circle = EDGE * np.stack([np.cos(angle), np.sin(angle), 0.2 * np.cos(2.0 * angle)], axis=1)
        points = [self.add_point(x) for x in circle + np.array([0.0, 0.0, 50.0 * EDGE])]
        self.add_rod(points, False, closed=True)
