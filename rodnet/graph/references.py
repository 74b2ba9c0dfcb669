"""What ``"arm:3"``, ``"arm.end"`` and ``"arm:3-4"`` mean while a figure is being drawn."""

from __future__ import annotations

from collections.abc import Mapping

from rodnet.errors import GraphError
from rodnet.graph.rod_spec import RodSpec
from rodnet.graph.selectors import parse

Specs = Mapping[str, RodSpec]


def node_of(specs: Specs, text: str) -> int:
    """Number of a node that exists."""
    selector = parse(text)
    spec = specs.get(selector.glob)
    if spec is None:
        raise GraphError(
            f"'{text}': there is no rod '{selector.glob}' yet; known are {', '.join(specs) or 'none'}"
        )
    if selector.end is not None:
        return spec.nodes[0 if selector.end == "start" else -1]
    if selector.node is not None and selector.node2 is None:
        if selector.node >= len(spec.nodes):
            raise GraphError(f"'{text}': rod '{spec.name}' has nodes 0 to {len(spec.nodes) - 1}")
        return spec.nodes[selector.node]
    raise GraphError(
        f"'{text}' is not a node reference; write '{spec.name}.start', '{spec.name}.end' or '{spec.name}:3'"
    )


def edge_of(specs: Specs, text: str) -> tuple[RodSpec, int]:
    """Rod and number of the edge ``"rod:1-2"``."""
    selector = parse(text)
    spec = specs.get(selector.glob)
    if spec is None or selector.node is None or selector.node2 != selector.node + 1:
        raise GraphError(f"'{text}' names no edge; write e.g. 'head:1-2'")
    if selector.node >= spec.edge_count:
        raise GraphError(f"'{text}': '{spec.name}' has {spec.edge_count} edges")
    return spec, selector.node


def edge_at(specs: Specs, at: str, node: int, text: str, role: str = "") -> tuple[str, int]:
    """Return the edge of a rod, or the edge that is named, that ends at a joint's node."""
    if ":" in text:
        spec, k = edge_of(specs, text)
        found = [k] if node in (spec.nodes[k], spec.nodes[(k + 1) % len(spec.nodes)]) else []
    else:
        if text not in specs:
            raise GraphError(f"joint at '{at}': there is no rod '{text}' yet; draw the rods first")
        spec, n = specs[text], len(specs[text].nodes)
        ends = [(k, (spec.nodes[k], spec.nodes[(k + 1) % n])) for k in range(spec.edge_count)]
        found = [k for k, pair in ends if node in pair]
    if len(found) != 1:
        what = "does not end there" if not found else f"passes through; name one edge, '{text}:k-k+1'"
        raise GraphError(f"joint at '{at}': {role}'{text}' {what}")
    return spec.name, found[0]
