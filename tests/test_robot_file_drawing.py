"""Rods in files as they were drawn: a mesh, a taper and a length are one number each, and nothing is lost."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rodnet as rn
from rodnet.files.figure_tables import draw, figure_tables
from tests.same_robots import same, same_robots, through_a_file

RUBBER = rn.Material(E=1e6, nu=0.4, rho=1100.0)


def tree():
    """A tapered trunk with a bent branch, a curved one, a ring, and joints at their ends."""
    figure = rn.StickFigure()
    figure.rod(
        "trunk", [(0, 0, 0), (0.1 / 3, 0, 0.2)], edges=9, material=RUBBER, radius=rn.Taper(3e-3, 1e-3 / 3)
    )
    figure.rod(
        "branch", ["trunk.end", (0.1, 0.02, 0.3), (0.1, 0.1, 1 / 3)], edges=8, material=RUBBER, radius=1e-3
    )
    figure.rod("twig", ["branch:3", (0.2, 0, 0.3)], edges=3, material=RUBBER, radius=1e-3)
    s = np.linspace(0.0, 3.0, 31)
    bow = 0.1 * np.stack([np.sin(s), s / 7, np.cos(s) - 1.0], axis=1)
    figure.rod("bow", ["trunk.start", *bow[1:]], edges=12, material=RUBBER, radius=rn.Taper(1e-3, 2e-3))
    corners = [(0.3, 0, 0), (0.4, 0, 0), (0.4, 0.1, 0), (0.3, 0.1 / 3, 0)]
    figure.rod("ring", corners, edges=14, closed=True, material=RUBBER, radius=rn.Taper(1e-3, 2e-3))
    figure.joint("trunk.end", kind="hinge", axis=(0, 1, 0), of="branch", stiffness=1e-3)
    figure.joint("trunk.start", hub="trunk")
    return figure


def robot_of(figure):
    return rn.Robot(
        figure.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Clamp(at="trunk.start")]
    )


def test_rods_are_written_as_they_were_drawn():
    tables = figure_tables(tree())
    rods = {rod["name"]: rod for rod in tables["rod"]}
    assert rods["trunk"]["points"] == [[0.0, 0.0, 0.0], [0.1 / 3, 0.0, 0.2]]
    assert rods["branch"]["points"] == ["trunk.end", [0.1, 0.02, 0.3], [0.1, 0.1, 1 / 3]]
    assert rods["twig"]["points"] == ["branch:3", [0.2, 0.0, 0.3]]
    assert [rod["edges"] for rod in tables["rod"]] == [9, 8, 3, 12, 14]
    assert rods["trunk"]["radius"] == {"start": 3e-3, "end": 1e-3 / 3}
    assert rods["ring"]["radius"] == {"start": 1e-3, "end": 2e-3}
    hub, hinge = tables["joint"]
    assert (hub["at"], hub["hub"]) == ("trunk.start", "trunk")
    assert hinge["of"] == ["branch"]


def test_what_is_read_back_is_the_same_to_the_last_bit(tmp_path):
    robot = robot_of(tree())
    again = through_a_file(robot, tmp_path)
    same_robots(robot, again)
    assert again.save(tmp_path / "again.toml").read_text() == (tmp_path / "robot.toml").read_text()


def edited(robot, folder, *changes):
    text = robot.save(folder / "robot.toml").read_text()
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    (folder / "edited.toml").write_text(text)
    return rn.Robot.load(folder / "edited.toml")


def test_one_number_changes_the_mesh_the_taper_or_the_length(tmp_path):
    robot = robot_of(tree())
    graph = edited(robot, tmp_path, ("edges = 9", "edges = 40")).graph
    assert [rod.edges.size for rod in graph.rods.values()] == [40, 8, 3, 12, 14]
    figure = tree()
    assert graph.rest_length[graph.rods["trunk"].edges].sum() == pytest.approx(
        np.hypot(0.1 / 3, 0.2), rel=1e-12
    )
    trunk = graph.rods["trunk"]
    assert graph.x0[trunk.nodes[-1]].tolist() == figure.build().x0[figure.specs["trunk"].nodes[-1]].tolist()
    assert graph.radius[trunk.edges][[0, -1]] == pytest.approx([3e-3 - 1e-3 / 30, 1e-3 / 3 + 1e-3 / 30])
    graph = edited(robot, tmp_path, ("{start = 0.003,", "{start = 0.004,")).graph
    assert graph.radius[0] == pytest.approx(0.004 - (0.004 - 1e-3 / 3) / 18)
    graph = edited(robot, tmp_path, ("[0.2, 0.0, 0.3]", "[0.4, 0.0, 0.3]")).graph
    assert graph.x0[graph.rods["twig"].nodes[-1]].tolist() == [0.4, 0.0, 0.3]


def test_what_has_a_row_for_each_node_says_so_when_the_mesh_is_changed(tmp_path):
    robot = robot_of(tree())
    robot = rn.Robot(robot.graph.with_positions(robot.graph.x0 + np.array([0.0, 0.0, 0.01])), robot.terms)
    same_robots(robot, through_a_file(robot, tmp_path))
    with pytest.raises(
        rn.RobotFileError, match=r"\[shape\]: positions .* one row for each node.*take \[shape\] out"
    ):
        edited(robot, tmp_path, ("edges = 9", "edges = 10"))


def test_a_rod_drawn_node_by_node_keeps_its_nodes(tmp_path):
    figure = rn.StickFigure()
    nodes = [(0, 0, 0), (0.1, 0, 0), (0.2, 0.01, 0)]
    figure.rod("trunk", nodes, material=RUBBER, radius=[1e-3, 2e-3])
    (rod,) = figure_tables(figure)["rod"]
    assert rod["points"] == [list(map(float, p)) for p in nodes]
    assert "edges" not in rod
    assert rod["radius"] == [1e-3, 2e-3]


@settings(deadline=None, max_examples=60)
@given(
    st.lists(st.tuples(*[st.floats(-1.0, 1.0)] * 3), min_size=2, max_size=9, unique=True),
    st.integers(1, 12),
    st.booleans(),
    st.tuples(st.floats(1e-4, 1e-2), st.floats(1e-4, 1e-2)),
)
def test_any_drawing_comes_back_to_the_last_bit(points, edges, closed, radii):
    figure = rn.StickFigure()
    closed = closed and len(points) > 2 and edges > 2
    try:
        figure.rod("rod", points, edges=edges, closed=closed, material=RUBBER, radius=rn.Taper(*radii))
        graph = figure.build()
    except rn.GraphError:  # a corner folds back, or two points are too near
        return
    tables = figure_tables(figure)
    assert tables["rod"][0]["edges"] == edges
    same(draw(tables).build(), graph)


def test_a_ring_is_joined_by_its_first_point_alone():
    figure = rn.StickFigure()
    figure.rod("arm", [(0, 0, 0), (0.1, 0, 0)], edges=2, material=RUBBER, radius=1e-3)
    with pytest.raises(rn.GraphError, match="only its first point"):
        figure.rod(
            "ring",
            [(0.2, 0, 0), (0.2, 0.1, 0), "arm.end"],
            edges=9,
            closed=True,
            material=RUBBER,
            radius=1e-3,
        )
