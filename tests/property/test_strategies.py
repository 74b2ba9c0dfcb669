"""The random robots and states are as rich as they are meant to be."""

import numpy as np
import pytest
from hypothesis import given, settings

import rodnet as rn
from rodnet.testing import Probe, random_sketch
from rodnet.testing.strategies import generators, sketches


@given(sketch=sketches(), rng=generators())
@settings(deadline=None, max_examples=30)
def test_every_sketch_can_be_drawn_and_every_state_evaluated(sketch, rng):
    drawing = sketch.draw()
    assert sorted(drawing.nodes) == list(range(drawing.graph.node_count))
    assert len(drawing.edges) == drawing.graph.edge_count
    probe = Probe(rn.Robot(drawing.graph, [rn.Stretching(), rn.Bending(), rn.Twisting()]), rng)
    assert np.all(np.isfinite(probe.forces()))
    q = rng.normal(size=drawing.graph.dof_count)
    other = sketch.flipped(0).draw()
    assert np.array_equal(other.carry(drawing.carry(q, other), drawing), q)


def test_states_are_far_from_rest():
    rng = np.random.default_rng(0)
    graph = random_sketch(rng, rods=6, edges=4, degree=6, loops=1, joints="star").draw().graph
    robot = rn.Robot(graph, [rn.Bending()])
    probes = [Probe(robot, rng) for _ in range(20)]
    stretch = np.concatenate([1.0 + p.evaluate().stretch for p in probes])
    turns = np.degrees([np.arccos(p.ev.fold - 1.0) for p in probes if p.evaluate()])
    turned = np.concatenate(
        [np.degrees(np.arccos(np.sum(p.source[0] * p.evaluate().T, axis=1))) for p in probes]
    )
    assert 0.3 <= stretch.min() < 0.5 and 2.5 < stretch.max() <= 3.0
    assert 140.0 < turns.max() <= 150.0
    assert 140.0 < turned.max() <= 150.0


@pytest.mark.parametrize("degree", range(2, 7))
def test_joints_of_every_degree(degree):
    found = set()
    for seed in range(30):
        sketch = random_sketch(
            np.random.default_rng(seed), rods=degree, degree=degree, joints="star", hubs=seed % 2
        )
        drawing = sketch.draw()
        found.add(int(np.bincount(drawing.graph.edges.ravel()).max()))
        assert all(point in range(len(sketch.points)) for point in sketch.hubs)
    assert max(found) == degree
