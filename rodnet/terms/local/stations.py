"""Where springs and half edges lie along their rods, and smooth profiles of that place."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from rodnet.graph.rod_graph import RodGraph
    from rodnet.solve.model import Model

# ends of panels over a bump's width: functions of it that are all but singular at its middle are smooth in each
PANELS = np.array([-7.0, -4.0, -2.5, -1.4, -0.7, -0.3, -0.1, 0.0, 0.1, 0.3, 0.7, 1.4, 2.5, 4.0, 7.0])
NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)


def arcs(graph: RodGraph) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Place where each edge begins along its rod and its length, both over the rod's, and the number of its rod.

    Rods run as they are drawn, from 0 to 1; shape (E,) each.
    """
    start, extent, number = np.zeros(graph.edge_count), np.zeros(graph.edge_count), np.zeros(graph.edge_count)
    for k, rod in enumerate(graph.rods.values()):
        length = graph.rest_length[rod.edges]
        total = float(length.sum())
        start[rod.edges] = (np.cumsum(length) - length) / total
        extent[rod.edges], number[rod.edges] = length / total, k
    return start, extent, number


def spring_cells(model: Model, springs: np.ndarray) -> np.ndarray:
    """Part of its rod that each spring stands for, from and to, over the rod's length; shape (n, 2).

    That is half an edge on either side of its node; beside a wall, and at a joint with another rod, on the
    side of its second edge only.
    """
    graph = model.graph
    start, extent, number = arcs(graph)
    first, second, node = model.edge1[springs], model.edge2[springs], model.spring_node[springs]
    forward = graph.edges[second, 0] == node  # the second edge leads away from the node along the rod
    place = start[second] + np.where(forward, 0.0, extent[second])
    inner = first < graph.edge_count
    safe = np.where(inner, first, second)
    behind = np.where(inner & (number[safe] == number[second]), 0.5 * extent[safe], 0.0)
    ahead = 0.5 * extent[second]
    low = place - np.where(forward, behind, ahead)
    return np.stack([low, place + np.where(forward, ahead, behind)], axis=1)


def half_edge_cells(model: Model, node: np.ndarray, edge: np.ndarray) -> np.ndarray:
    """Part of its rod that the half of an edge at a node stands for, over the rod's length; shape (n, 2)."""
    start, extent, _ = arcs(model.graph)
    low = start[edge] + np.where(model.graph.edges[edge, 0] == node, 0.0, 0.5 * extent[edge])
    return np.stack([low, low + 0.5 * extent[edge]], axis=1)


def bump(cells: np.ndarray, place: float, width: float) -> np.ndarray:
    """Mean over cells of exp(-(s - place)^2 / (2 width^2)), shape (n,).

    The mean, not the value in the middle: what a bump does in all is then the same on every mesh.
    """
    from scipy.special import erf

    low, high = cells.T
    scale = math.sqrt(2.0) * width
    area = math.sqrt(math.pi / 2.0) * width * (erf((high - place) / scale) - erf((low - place) / scale))
    return area / (high - low)


def mean_of_bump(
    function: Callable[[np.ndarray], np.ndarray], cells: np.ndarray, place: float, width: float
) -> np.ndarray:
    """Mean over cells of a function of exp(-(s - place)^2 / (2 width^2)), shape (n,), by Gauss's rule.

    Parameters
    ----------
    function : callable
        Of an array, element by element; smooth between 0 and 1.
    cells : ndarray, shape (n, 2)
        From and to, over the rod's length.
    place, width : float
        Of the bump, over the rod's length.
    """
    low, high = cells.T
    ends = np.clip(place + width * PANELS, low[:, None], high[:, None])
    ends = np.concatenate([low[:, None], ends, high[:, None]], axis=1)
    half, middle = 0.5 * np.diff(ends, axis=1), 0.5 * (ends[:, :-1] + ends[:, 1:])
    s = middle[..., None] + half[..., None] * NODES
    values = function(np.exp(-0.5 * ((s - place) / width) ** 2))
    return np.asarray(np.einsum("npk,k,np->n", values, WEIGHTS, half) / (high - low))
