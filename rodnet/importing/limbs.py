"""The limbs of a surface and how they are joined: a graph of axes, edited until every limb is one."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from rodnet.errors import MeshError
from rodnet.importing.curves import arc_length
from rodnet.importing.sections import Sections
from rodnet.importing.wavefronts import Regions


@dataclass(eq=False)
class Limb:
    """A limb between two nodes of a `LimbGraph`, or a ring without any.

    Attributes
    ----------
    ends : list of int
        Its nodes; the same one twice, if it comes back to it.
    path : ndarray, shape (n, 3)
        Points of its axis [m], in order, without the nodes themselves.
    radius : float
        Typical radius [m].
    sections : Sections or None
        Cross-sections at the path's points.
    closed : bool
        Whether it is a ring, joined to nothing.
    clear : list of float
        How far from its nodes the surfaces of its neighbours reach along it [m].
    """

    ends: list[int]
    path: np.ndarray
    radius: float
    sections: Sections | None = None
    closed: bool = False
    clear: list[float] = field(default_factory=lambda: [0.0, 0.0])

    def flip(self) -> None:
        """Run from the other end."""
        self.ends, self.clear = self.ends[::-1], self.clear[::-1]
        self.path = self.path[::-1]
        if self.sections is not None:
            self.sections = self.sections.take(np.arange(len(self.path))[::-1])


class LimbGraph:
    """Limbs and the nodes where they end: junctions of three or more, and tips of one.

    Attributes
    ----------
    limbs : list of Limb
        The limbs.
    nodes : dict of int to ndarray, shape (3,)
        Positions of the nodes [m].
    """

    def __init__(self, regions: Regions) -> None:
        self.limbs: list[Limb] = []
        count = len(regions.centroid)
        neighbours: list[list[int]] = [[] for _ in range(count)]
        for i, j in regions.arcs.tolist():
            neighbours[i].append(j)
            neighbours[j].append(i)
        stops = [i for i in range(count) if len(neighbours[i]) != 2]
        if not stops:
            raise MeshError(
                "the surface has no tip and no junction; split the ring in two and import the halves"
            )
        self.nodes = {i: regions.centroid[i] for i in stops}
        for i in stops:
            for j in neighbours[i]:
                chain = [i, j]
                while chain[-1] not in self.nodes:
                    chain.append(next(k for k in neighbours[chain[-1]] if k != chain[-2]))
                if (chain[-1], chain[-2]) > (i, j):  # each is walked from both of its ends
                    inner = chain[1:-1] if len(chain) > 3 else chain
                    # fronts that have just set out, or are about to end, are not rings yet
                    for tip, drop in ((i, slice(1, None)), (chain[-1], slice(None, -1))):
                        for _ in range(2 if len(neighbours[tip]) == 1 else 0):
                            inner = inner[drop] if len(inner) > 4 else inner
                    path = regions.centroid[inner]
                    self.limbs.append(Limb([i, chain[-1]], path, float(np.median(regions.spread[inner]))))

    def at(self, node: int) -> list[tuple[Limb, int]]:
        """Limbs at a node, with the end (0 or 1) that lies there."""
        return [
            (limb, end) for limb in self.limbs for end in (0, 1) if not limb.closed and limb.ends[end] == node
        ]

    def degree(self, node: int) -> int:
        """Number of limb ends at a node."""
        return len(self.at(node))

    @property
    def loops(self) -> int:
        """Number of independent loops."""
        parts = {node: node for node in self.nodes}

        def root(node: int) -> int:
            while parts[node] != node:
                node = parts[node]
            return node

        found = 0
        for limb in self.limbs:
            a, b = (0, 0) if limb.closed else (root(limb.ends[0]), root(limb.ends[1]))
            found += a == b
            if a != b:
                parts[a] = b
        return found

    def length(self, limb: Limb) -> float:
        """Length of a limb from node to node [m]."""
        if limb.closed:
            return float(arc_length(np.vstack([limb.path, limb.path[:1]]))[-1])
        a, b = (self.nodes[end] for end in limb.ends)
        return float(arc_length(np.vstack([a, limb.path, b]))[-1])

    # -- edits ------------------------------------------------------------------------------
    def remove(self, limb: Limb) -> None:
        """Take a limb away; nodes that are left with two limbs vanish into one limb."""
        self.limbs.remove(limb)
        self.tidy()

    def contract(self, limb: Limb) -> None:
        """Make one node of a limb's two ends."""
        a, b = limb.ends
        self.limbs.remove(limb)
        if a != b:
            self.nodes[a] = 0.5 * (self.nodes[a] + self.nodes[b])
            for other in self.limbs:
                if not other.closed:
                    other.ends = [a if end == b else end for end in other.ends]
        self.tidy()

    def tidy(self) -> None:
        """Drop nodes without limbs, join the limbs at nodes of two."""
        for node in list(self.nodes):
            here = self.at(node)
            if not here:
                del self.nodes[node]
            elif len(here) == 2:
                self._join(node, here)

    def _join(self, node: int, here: list[tuple[Limb, int]]) -> None:
        (one, end), (two, start) = here
        del self.nodes[node]
        if one is two:
            one.closed, one.ends, one.sections = True, [-1, -1], None
            return
        if end == 0:
            one.flip()
        if start == 1:
            two.flip()
        weight = np.array([len(one.path), len(two.path)])
        one.radius = float(weight @ [one.radius, two.radius] / weight.sum())
        one.path = np.vstack([one.path, two.path])
        one.ends, one.clear, one.sections = [one.ends[0], two.ends[1]], [one.clear[0], two.clear[1]], None
        self.limbs.remove(two)
