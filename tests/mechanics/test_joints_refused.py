"""Joints that make no sense, and joints in the wrong place."""

import numpy as np
import pytest

import rodnet as rn
from tests.mechanics.beams import rest
from tests.mechanics.linkages import ROD, beams

Z, Y, X = np.eye(3)[::-1]


@pytest.mark.parametrize(
    ("joint", "message"),
    [
        ({"kind": "pin"}, "kind must be one of"),
        ({"kind": "hinge"}, "say about which axis"),
        ({"kind": "hinge", "axis": (0, 0, 0)}, "not zero"),
        ({"kind": "hinge", "axis": (0, 0, 1), "stiffness": -1.0}, "not negative"),
        ({"kind": "hinge", "axis": (0, 0, 1), "stiffness": (1.0, 2.0)}, "one number"),
        ({"kind": "hinge", "axis": (0, 0, 1), "angle": 0.3}, "only if it has a stiffness"),
        ({"kind": "hinge", "axis": (0, 0, 1), "stiffness": 1.0}, "say which of them turn"),
        ({"kind": "ball", "stiffness": 1.0}, "has no stiffness"),
        ({"kind": "elastic"}, "needs its stiffness"),
        ({"kind": "elastic", "stiffness": 0.0}, "is a ball joint"),
        ({"kind": "elastic", "stiffness": (1, 1, 1), "axes": np.ones((3, 3)), "of": "two"}, "orthogonal"),
        ({"kind": "hinge", "axis": (0, 0, 1), "of": "four"}, "no rod 'four'"),
        ({"kind": "hinge", "axis": (0, 0, 1), "of": "far"}, "'far' does not end there"),
        ({"kind": "hinge", "axis": (0, 0, 1), "hub": "one:0-1"}, "only a weld has a hub"),
        ({"kind": "weld", "axis": (0, 0, 1)}, "a weld has a hub"),
        ({"kind": "rigid", "of": "two"}, "nothing turns"),
        ({"kind": "elastic", "stiffness": (1, 2, 3), "axis": (0, 0, 1), "of": "two"}, "need the three axes"),
        ({"kind": "elastic", "stiffness": 1e8, "of": "two"}, "kind='rigid'"),
    ],
)
def test_joints_that_make_no_sense(joint, message):
    figure = rn.StickFigure()
    figure.rod("one", [(0, 0, 0), (0.1, 0, 0)], edges=2, **ROD)
    figure.rod("two", ["one.end", (0.2, 0, 0)], edges=2, **ROD)
    figure.rod("three", ["one.end", (0.1, 0.1, 0)], edges=2, **ROD)
    figure.rod("far", ["two.end", (0.2, 0.1, 0)], edges=2, **ROD)
    with pytest.raises(rn.GraphError, match=message):
        figure.joint("one.end", **joint)
        figure.build()


def test_joints_in_the_wrong_place():
    with pytest.raises(rn.GraphError, match="is clamped"):
        beams(8, "hinge", [rn.Clamp(at="one.end", name="second")], axis=Z)
    figure = rn.StickFigure()
    figure.rod("one", [(0, 0, 0), (0.1, 0, 0)], edges=2, **ROD)
    figure.joint("one.end", kind="ball")
    with pytest.raises(rn.GraphError, match="only one edge ends there"):
        figure.build()
    with pytest.raises(rn.GraphError, match="there is one already"):
        figure.joint("one.end", kind="rigid")
    with pytest.raises(rn.GraphError, match="there is no joint at"):
        rest(beams(8, None, [])).joint_angle("one.end")


def test_constraints_that_would_weld_a_ball_joint():
    """A wall, or a held axis, would join what a ball joint keeps apart; holding its position does not."""
    with pytest.raises(rn.GraphError, match=r"the ball joint at 'one.end' is clamped"):
        beams(8, "ball", [rn.Clamp(at="two.start", name="second")])
    turning = rn.PrescribedMotion(at="one.end", orientation=lambda t: np.eye(3))
    with pytest.raises(rn.GraphError, match=r"the ball joint at 'one.end' is clamped"):
        beams(8, "ball", [turning])
    with pytest.raises(rn.GraphError, match="two joints at 'one:4'"):
        beams(8, "ball", [rn.Hinge(at="one.end", axis=Y)])
    held = beams(8, "ball", [rn.Hinge(at="one.end"), rn.Gravity(), rn.ResistiveForce(viscosity=1.0)])
    traj = rn.Simulation(held, 0.05).run(5.0)
    swing = traj.at("two.end")[-1] - traj.at("one.end")[-1]
    assert swing[2] < -0.99 * np.linalg.norm(swing)
