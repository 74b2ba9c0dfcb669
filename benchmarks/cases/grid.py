"""Loops: a net of welded rods, held at its border, sags into equilibrium."""

from __future__ import annotations

from benchmarks.cases import Demand, Options, Result, Table
from benchmarks.process import ChildFailure, child

TITLE = "A net of rods in equilibrium"
PATIENCE = 150.0  # s

CODE = """
import json, sys, time
import rodnet as rn
from benchmarks import scenes
side = int(sys.argv[1])
rn.equilibrium(scenes.grid(4))  # compiles
start = time.process_time()
robot = scenes.grid(side)
built = time.process_time()
found = rn.equilibrium(robot)
done = time.process_time()
print(json.dumps({"nodes": robot.graph.node_count, "edges": robot.graph.edge_count, "build": built - start,
                  "solve": done - built, "sag": float(-found.x[-1][:, 2].min()), "size": robot.graph.size}))
"""


def measure(options: Options) -> Result:
    """Time set-up and solution, each net in a new process."""
    table = Table(
        "Set-up and equilibrium",
        ["net", "nodes", "edges", "set-up [s]", "equilibrium [s]", "together [s]", "largest sag / side"],
    )
    text = "A horizontal net of welded rods, mesh of 2 cm, radius 1 mm, E = 10 MPa, border held, under its weight."
    result = Result(TITLE, text, [table])
    for side in (8,) if options.quick else (10, 20, 60):
        together = None
        try:
            r = child(CODE, side, timeout=PATIENCE)
        except ChildFailure as failure:
            table.rows.append([f"{side} x {side}", None, None, None, f"none: {failure}", None, None])
        else:
            together = r["build"] + r["solve"]
            row = [r["nodes"], r["edges"], r["build"], r["solve"], together, r["sag"] / r["size"]]
            table.rows.append([f"{side} x {side}", *row])
        if side == 60:
            result.demands.append(Demand("60 x 60 net", 60.0, together, "s"))
    return result
