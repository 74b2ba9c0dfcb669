"""One robot drawn in several ways is one robot."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import rodnet as rn
from rodnet.testing import Probe
from rodnet.testing.strategies import generators, sketches

few = settings(deadline=None, max_examples=30)
TIGHT = rn.Tolerance(residual=1e-12, update=1e-14, iterations=60)


def robot(drawing):
    return rn.Robot(
        drawing.graph,
        [
            rn.Stretching(),
            rn.Bending(),
            rn.Twisting(),
            rn.ResistiveForce(viscosity=5.0, axial_torque=True, length=0.1),
            rn.Gravity(),
        ],
    )


def compare(one, other, rng):
    """Energies, forces, Jacobians and a short simulation of two drawings."""
    a, b = Probe(robot(one), rng), Probe(robot(other), rng)
    b.q, b.v = one.carry(a.q, other), one.carry(a.v, other)
    b.source = (*one.carry_frames(*a.source[:2], other), np.zeros(b.model.spring_count))
    a.source = (*a.source[:2], np.zeros(a.model.spring_count))
    assert b.energy() == pytest.approx(a.energy(), rel=1e-9)
    F = a.forces()
    assert np.abs(one.carry(F, other) - b.forces()).max() <= 1e-9 * np.abs(F).max()
    d = rng.normal(size=len(F))
    Jd = a.jacobian(cv=10.0) @ d
    assert (
        np.abs(one.carry(Jd, other) - b.jacobian(cv=10.0) @ one.carry(d, other)).max()
        <= 1e-9 * np.abs(Jd).max()
    )
    first, second = (rn.Simulation(robot(drawing), 1e-3, tolerance=TIGHT) for drawing in (one, other))
    for _ in range(3):
        assert first.step().ok and second.step().ok
    moved = first.state.q - np.concatenate([one.graph.x0.ravel(), np.zeros(one.graph.edge_count)])
    error = np.abs(one.carry(first.state.q, other) - second.state.q).max()
    assert np.abs(moved).max() > 1e-6 and error <= 1e-9 * one.graph.size


@given(sketch=sketches(), rng=generators())
@few
def test_numbering_changes_nothing(sketch, rng):
    sketch = sketch.framed()
    compare(sketch.draw(), sketch.reordered(rng.permutation(len(sketch.rods))).draw(), rng)


@given(sketch=sketches(), rng=generators())
@few
def test_the_direction_of_drawing_changes_nothing(sketch, rng):
    sketch = sketch.framed()
    which = np.flatnonzero(rng.random(len(sketch.rods)) < 0.6)
    compare(sketch.draw(), sketch.flipped(*which).draw(), rng)


@given(sketch=sketches(edges=5), rng=generators())
@few
def test_cutting_a_rod_in_two_that_are_joined_changes_nothing(sketch, rng):
    rods = [
        k for k, r in enumerate(sketch.rods) if len(r.points) > 2 and not r.closed and r.natural == "initial"
    ]
    assume(rods)
    which = int(rng.choice(rods))
    sketch = sketch.framed()
    at = int(rng.integers(1, len(sketch.rods[which].points) - 1))
    compare(sketch.draw(), sketch.cut(which, at).draw(), rng)


@given(sketch=sketches(), rng=generators(), spin=st.booleans())
@few
def test_directors_that_nobody_chose_change_nothing(sketch, rng, spin):
    """With round sections the order of drawing may choose other directors, to no effect."""
    rods = tuple(
        r if r.section is None else replace(r, section=rn.circular(r.section.radius)) for r in sketch.rods
    )
    sketch = replace(sketch, rods=rods)
    other = sketch.reordered(rng.permutation(len(rods)))
    if spin:
        other = replace(
            other,
            rods=tuple(
                r if r.section is None else replace(r, director=rng.normal(size=3)) for r in other.rods
            ),
        )
    compare(sketch.draw(), other.draw(), rng)


def test_smooth_chain_lengths_do_not_depend_on_cuts():
    """The L of Gray and Hancock is that of the smooth chain, by default."""
    material = rn.Material(E=1e6)
    whole, halves = rn.StickFigure(), rn.StickFigure()
    whole.rod("a", [(0, 0, 0), (0.2, 0, 0)], edges=10, material=material, radius=2e-3)
    halves.rod("a", [(0, 0, 0), (0.1, 0, 0)], edges=5, material=material, radius=2e-3)
    halves.rod("b", [(0.2, 0, 0), "a.end"], edges=5, material=material, radius=2e-3)
    figures = [whole, halves]
    for joint in (
        {"kind": "rigid"},
        {"kind": "hinge", "axis": (0, 1, 0)},
        {"kind": "elastic", "stiffness": 1e-3},
    ):
        for at, start in (("a:5", whole), ("a.end", halves)):
            jointed = copy.deepcopy(start)
            jointed.joint(at, **joint)
            figures.append(jointed)
    v = np.array([0.01, 0.02, 0.03])
    forces = []
    for fig in figures:
        model = rn.Simulation(rn.Robot(fig.build(), [rn.ResistiveForce(viscosity=1.0)])).model
        ev, rates = rn.solve.evaluation.Evaluation(model), np.zeros(model.dof_count)
        rates[: model.twist0] = np.tile(v, model.node_count)
        q = np.concatenate([model.x0.ravel(), np.zeros(model.edge_count)])
        assert ev.update(q, rates, 0.0, 1.0, 0.0, False)
        forces.append(ev.F[: model.twist0].reshape(-1, 3).sum(axis=0))
    for force in forces[1:]:
        assert force == pytest.approx(forces[0], rel=1e-12)
