"""The rod graph: names and selectors, nodes and masses, frames, springs, natural shapes, polylines."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.graph.polyline import distribute_edges
from rodnet.kinematics.frames import material_frames

RUBBER = rn.Material(E=1e6, nu=0.5, rho=1000.0)
SOFT = {"material": RUBBER, "radius": 2e-3}


def tree():
    """A trunk with two branches and a stiff foot."""
    figure = rn.StickFigure()
    figure.rod("trunk", [(0, 0, 0), (0, 0, 0.1)], edges=5, **SOFT)
    figure.rod("branch0", ["trunk.end", (0.05, 0, 0.15)], edges=4, **SOFT)
    figure.rod("branch1", ["trunk:3", (-0.05, 0.02, 0.06)], edges=3, **SOFT)
    figure.rigid("foot", ["trunk.start", (0.01, 0, 0), (0.02, 0.01, 0)], mass=0.01, radius=3e-3)
    figure.group("crown", ["branch0", "branch1"])
    return figure.build()


# -- names ---------------------------------------------------------------------------------------
def test_selectors_of_nodes():
    graph = tree()
    trunk = graph.rods["trunk"].nodes
    assert list(graph.nodes("trunk")) == list(trunk)
    assert graph.node("trunk:3") == trunk[3] == graph.rods["branch1"].nodes[0]
    assert graph.node("trunk.start") == trunk[0] == graph.node("foot:0")
    assert graph.node("trunk.end") == graph.node("branch0.start")
    assert graph.node("trunk@40%") == trunk[2] == graph.node("trunk@0.04m")
    assert list(graph.nodes("trunk:1-3")) == list(trunk[1:4])
    assert list(graph.nodes(["trunk.end", "branch0.start"])) == [trunk[-1]]  # no repetition
    assert graph.rod_names("branch*") == graph.rod_names("crown") == ["branch0", "branch1"]
    assert graph.rod_names(["foot", "crown"]) == ["branch0", "branch1", "foot"]  # in order of definition
    assert len(graph.nodes("crown.end")) == 2


def test_selectors_of_edges_springs_and_stations():
    graph = tree()
    trunk = graph.rods["trunk"].edges
    assert list(graph.edge_indices("trunk:3-4")) == [trunk[3]]
    assert list(graph.edge_indices(["trunk.end", "trunk.start"])) == [trunk[-1], trunk[0]]
    assert graph.station("trunk@50%") == (trunk[2], pytest.approx(0.5))
    assert graph.station("trunk.end") == (trunk[-1], 1.0)
    assert graph.station("trunk:2") == (trunk[2], 0.0)
    assert len(graph.spring_indices("trunk")) == 4
    assert (
        graph.edge_name(trunk[1]) == "trunk:1-2" and graph.node_name(graph.node("branch0:2")) == "branch0:2"
    )
    assert graph.dof_name(3 * graph.node("branch1.end") + 1) == "y of branch1:3"
    assert graph.dof_name(3 * graph.node_count + int(trunk[4])) == "twist of trunk:4-5"


@pytest.mark.parametrize(
    ("selector", "message"),
    [
        ("trnk", "no rod or group is named 'trnk'; did you mean 'trunk'"),
        ("xyz*", "known are: trunk, branch0"),
        ("trunk:6", "'trunk' has nodes 0 to 5"),
        ("trunk@43%", "lies between nodes of rod 'trunk'; the nearest is 'trunk:2'"),
        ("trunk@120%", "is 0.1 m long"),
        ("trunk@-1%", "is 0.1 m long"),
        ("trunk[0]", r"trunk\[0\]"),
        ("trunk:a", "trunk:a"),
        ("", "''"),
        (3, "3"),
    ],
)
def test_selectors_that_name_nothing(selector, message):
    with pytest.raises(rn.GraphError, match=message):
        tree().nodes([selector])


def test_selectors_that_name_too_much_or_no_edge():
    graph = tree()
    with pytest.raises(rn.GraphError, match="names 6 nodes where one is needed"):
        graph.node("trunk")
    with pytest.raises(rn.GraphError, match="names no edge of rod 'trunk'"):
        graph.edge_indices("trunk:3")
    with pytest.raises(rn.GraphError, match="names no edge of rod 'trunk'"):
        graph.edge_indices("trunk:1-3")
    with pytest.raises(rn.GraphError, match="matches 2 rods"):
        graph.station("branch*@50%")


@pytest.mark.parametrize("name", ["a b", "a.b", "a:1", "a@1", "a[1]", "a*", "", None])
def test_names_may_not_look_like_selectors(name):
    with pytest.raises(rn.GraphError, match="not a valid name"):
        rn.StickFigure().rod(name, [(0, 0, 0), (1, 0, 0)], **SOFT)


def test_a_graph_does_not_change():
    graph = tree()
    for array in (graph.x0, graph.edges, graph.EA, graph.node_mass, graph.edge_inertia):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    with pytest.raises(AttributeError):
        graph.x0 = graph.x0.copy()


def test_the_figure_can_be_changed_after_building():
    figure = rn.StickFigure()
    figure.rod("one", [(0, 0, 0), (1, 0, 0)], edges=2, **SOFT)
    first = figure.build()
    figure.rod("two", ["one.end", (1, 1, 0)], edges=2, **SOFT)
    assert (len(first.rods), len(figure.build().rods)) == (1, 2)


# -- masses and stiffnesses ----------------------------------------------------------------------
def test_masses_and_inertias_are_those_of_the_bodies():
    graph = tree()
    lengths = {name: rod.length for name, rod in graph.rods.items()}
    soft = RUBBER.rho * np.pi * 4e-6 * sum(lengths[n] for n in ("trunk", "branch0", "branch1"))
    assert graph.node_mass.sum() == pytest.approx(soft + 0.01)
    edge = graph.rods["branch0"].edges[0]
    per_length = RUBBER.rho * np.pi / 2.0 * 2e-3**4
    assert graph.edge_inertia[edge] == pytest.approx(per_length * graph.rest_length[edge])
    foot = graph.rods["foot"].edges
    assert graph.edge_inertia[foot].sum() == pytest.approx(0.5 * 0.01 * 3e-3**2)
    # a rod's free end node carries half an edge
    assert graph.node_mass[graph.node("branch0.end")] == pytest.approx(
        0.5 * RUBBER.rho * np.pi * 4e-6 * graph.rest_length[graph.rods["branch0"].edges[-1]]
    )


def test_stiff_parts_are_multiples_of_the_stiffest_soft_rod():
    """A stiff part refers to the stiffest soft rod, in tension and in bending."""
    figure = rn.StickFigure()
    figure.rod("thin", [(0, 0, 0), (1, 0, 0)], edges=2, material=RUBBER, radius=1e-3)
    figure.rod("thick", ["thin.end", (2, 0, 0)], edges=2, material=RUBBER, radius=4e-3)
    figure.rigid("block", ["thick.end", (3, 0, 0)], stiffening=(50.0, 2000.0))
    graph = figure.build()
    block, thick = graph.rods["block"].edges[0], graph.rods["thick"].edges[0]
    assert graph.EA[block] == pytest.approx(50.0 * graph.EA[thick])
    assert graph.EI1[block] == pytest.approx(2000.0 * graph.EI1[thick]) == pytest.approx(graph.EI2[block])
    assert graph.GJ[block] == pytest.approx(2000.0 * graph.GJ[thick])


def test_half_edges_in_series():
    """1/k = l1/(2 EI1) + l2/(2 EI2), between edges of unlike length and section, and the same for GJ."""
    figure = rn.StickFigure()
    figure.rod("one", [(0, 0, 0), (0.01, 0, 0), (0.03, 0, 0)], material=RUBBER, radius=[1e-3, 2e-3])
    figure.rod("two", ["one.end", (0.08, 0, 0)], edges=2, material=rn.Material(E=5e6, nu=0.3), radius=1.5e-3)
    graph = figure.build()
    for s in range(len(graph.springs)):
        a, b = graph.springs.edge1[s], graph.springs.edge2[s]
        for stiffness, k in ((graph.EI1, 0), (graph.EI2, 1), (graph.GJ, 2)):
            series = 1.0 / (
                graph.rest_length[a] / (2 * stiffness[a]) + graph.rest_length[b] / (2 * stiffness[b])
            )
            assert graph.springs.stiffness[s, k, k] == pytest.approx(series)
        assert graph.springs.stiffness[s, 0, 2] == pytest.approx(0.0, abs=1e-20)


def test_a_rigid_root_has_no_compliance_of_its_own():
    def root(kind):
        figure = rn.StickFigure()
        figure.rigid("hub", [(0, 0, 0), (0.01, 0, 0)])
        figure.rod("arm", ["hub.end", (0.11, 0, 0)], edges=10, root=kind, **SOFT)
        graph = figure.build()
        return graph.springs.stiffness[np.flatnonzero(graph.springs.node == graph.node("hub.end"))[0]]

    EI = 1e6 * np.pi / 4 * 16e-12
    assert root("clamped")[0, 0] == pytest.approx(2 * EI / 0.01, rel=2e-4)
    # both halves as stiff as the stiff part: that much stiffer than a spring inside the rod
    assert root("rigid")[0, 0] == pytest.approx(1e4 * EI / 0.01, rel=1e-3)


# -- joints --------------------------------------------------------------------------------------
def star(order, hub=None):
    tips = {"a": (1, 0, 0), "b": (0, 1, 0), "c": (-1, -0.5, 0.3), "d": (0.2, -0.4, 1)}
    figure, first = rn.StickFigure(), order[0]
    for name in order:
        figure.rod(name, [f"{first}.start" if name != first else (0, 0, 0), tips[name]], edges=3, **SOFT)
    if hub:
        figure.joint(f"{first}.start", hub=hub)
    return figure.build()


def test_a_joint_pairs_all_edges_or_those_with_its_hub():
    assert len(star("abcd").springs) == 4 * 2 + 6
    graph = star("abcd", hub="c:0-1")
    pairs = graph.springs.take(np.flatnonzero(graph.springs.node == 0))
    hub = graph.rods["c"].edges[0]
    assert len(pairs) == 3 and np.all((pairs.edge1 == hub) | (pairs.edge2 == hub))
    assert np.all(pairs.weight == 1.0)
    with pytest.raises(rn.GraphError, match="the hub edge 'c:1-2' does not end there"):
        star("abcd", hub="c:1-2")


def test_star_mesh_weights():
    """Equal stiffnesses: k/4 for each of six pairs, so that one edge against three welded ones feels 3/4 k."""
    graph = star("abcd")
    pairs = graph.springs.take(np.flatnonzero(graph.springs.node == 0))
    k = (graph.EI1 + graph.EI2)[[graph.rods[n].edges[0] for n in "abcd"]]
    k = k / graph.rest_length[[graph.rods[n].edges[0] for n in "abcd"]]
    expected = {frozenset((i, j)): (k[i] + k[j]) / k.sum() for i in range(4) for j in range(i)}
    first = [graph.rods[n].edges[0] for n in "abcd"]
    for a, b, weight in zip(pairs.edge1, pairs.edge2, pairs.weight, strict=True):
        assert weight == pytest.approx(expected[frozenset((first.index(a), first.index(b)))])


def test_the_order_of_drawing_a_star_does_not_matter():
    loads = rn.PointForce(at="a.end", force=(0, 1e-5, 2e-5))
    shapes = []
    for drawn in ("abcd", "dbca"):
        terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Clamp(at="b.end"), loads]
        traj = rn.equilibrium(rn.Robot(star(drawn), terms), residual=1e-11)
        shapes.append(np.array([traj.at(f"{name}:{k}")[-1] for name in "abcd" for k in range(4)]))
    assert shapes[0] == pytest.approx(shapes[1], abs=1e-9)


# -- frames and natural shapes -------------------------------------------------------------------
def test_frames_are_right_handed_and_carried_without_twist():
    graph = tree()
    t = graph.x0[graph.edges[:, 1]] - graph.x0[graph.edges[:, 0]]
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    frames = material_frames(t, graph.d1, np.zeros(len(t)))
    assert np.swapaxes(frames, 1, 2) @ frames == pytest.approx(np.tile(np.eye(3), (len(t), 1, 1)), abs=1e-14)
    assert np.linalg.det(frames) == pytest.approx(1.0)
    sim = rn.Simulation(rn.Robot(graph, [rn.Stretching(), rn.Bending(), rn.Twisting()]))
    assert sim.state.tau == pytest.approx(0.0, abs=1e-14)


def test_opposite_edges_of_a_hub_do_not_cancel():
    """A trap of the paper's robot: with a common director the spring of opposite edges goes dead."""
    robot = rn.robots.flagellated(2, 100.0, edges=3)
    graph = robot.graph
    joint = np.flatnonzero(graph.springs.node == graph.node("head.end"))
    assert len(joint) == 2
    sim = rn.Simulation(robot)
    sim.newton.ev.update(sim.state.q, sim.state.v, 0.0, 1.0, 0.0, True)
    modulus = sim.newton.ev.modulus[joint]
    assert np.linalg.eigvalsh(modulus).min() > 0.5 * graph.springs.stiffness[joint][:, 2, 2].min()


def test_director_of_an_elliptic_rod():
    """m1 at the start is the given direction, made normal; the half axis a lies along it."""
    figure = rn.StickFigure()
    figure.rod(
        "strip",
        [(0, 0, 0), (1, 0, 0)],
        edges=4,
        material=RUBBER,
        section=rn.elliptic(3e-3, 1e-3),
        director=(5, 0, 1),
    )
    graph = figure.build()
    assert graph.d1 == pytest.approx(np.tile((0, 0, 1.0), (4, 1)))
    assert graph.EI1[0] / graph.EI2[0] == pytest.approx(9.0)


def arc(natural="initial", **options):
    angles = np.linspace(0.0, 1.5, 7)
    points = 0.1 * np.stack([np.sin(angles), 1.0 - np.cos(angles), 0 * angles], axis=1)
    figure = rn.StickFigure()
    figure.rod("arc", list(points), natural=natural, **SOFT, **options)
    return rn.Robot(figure.build(), [rn.Stretching(), rn.Bending(), rn.Twisting()])


def energy(robot):
    traj = rn.Simulation(robot, 1e-9).run(1e-9)
    return sum(v[0] for v in traj.energies.values())


def test_natural_shapes():
    assert energy(arc()) < 1e-30
    EI = 1e6 * np.pi / 4 * 16e-12
    length = 2 * 0.1 * np.sin(0.125)
    bent = 5 * 0.5 * EI / length * (2 * np.tan(0.125)) ** 2
    assert energy(arc("straight")) == pytest.approx(bent, rel=1e-12)
    # the curvature that the polygon has, per length, in the direction of bending
    kappa = 0.25 / length
    drawn = arc(natural_curvature=(kappa, 0.0), director=(0, 1, 0))
    assert energy(drawn) == pytest.approx(0.0, abs=1e-12 * bent)
    varied = np.stack([np.linspace(0.5, 1.5, 5) * kappa, np.zeros(5)], axis=1)
    assert 0.0 < energy(arc(natural_curvature=varied, director=(0, 1, 0))) < 0.2 * bent
    twist = 3.0
    GJ = RUBBER.G * np.pi / 2 * 16e-12
    straight = rn.StickFigure().rod("rod", [(0, 0, 0), (1, 0, 0)], edges=10, natural_twist=twist, **SOFT)
    robot = rn.Robot(straight.build(), [rn.Stretching(), rn.Bending(), rn.Twisting()])
    assert energy(robot) == pytest.approx(0.5 * GJ * twist**2 * 0.9, rel=1e-12)


def test_splitting_a_naturally_curved_rod_changes_nothing():
    """The halves at the new joint keep the natural curvature of the edges that they belong to."""

    def shape(split):
        figure = rn.StickFigure()
        options = {"natural_curvature": (8.0, 3.0), "natural_twist": 0.0, **SOFT}
        if split:
            figure.rod("one", [(0, 0, 0), (0.1, 0, 0)], edges=5, **options)
            figure.rod("two", ["one.end", (0.2, 0, 0)], edges=5, **options)
        else:
            figure.rod("one", [(0, 0, 0), (0.2, 0, 0)], edges=10, **options)
        terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Clamp(at="one.start")]
        return rn.equilibrium(rn.Robot(figure.build(), terms), residual=1e-11).x[-1]

    assert shape(True) == pytest.approx(shape(False), abs=1e-10)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"natural_curvature": (1.0, 2.0, 3.0)}, "natural_curvature needs shape"),
        ({"natural_curvature": [[1.0]]}, "natural_curvature needs shape"),
        ({"natural_curvature": 1.0}, "natural_curvature needs shape"),
        ({"natural_twist": [1.0]}, "natural_twist"),
        ({"natural_twist": np.ones(4)}, "natural_twist"),
        ({"natural_curvature": (np.nan, 0.0)}, "must be finite"),
        ({"natural_curvature": (1e3, 0.0)}, "turns by .* rad from one edge to the next; use more edges"),
        ({"natural": "bent"}, "'initial' or 'straight'"),
    ],
)
def test_natural_shapes_that_make_no_sense(options, message):
    with pytest.raises(rn.GraphError, match=f"'arc'.*{message}"):
        arc(**options)


# -- polylines -----------------------------------------------------------------------------------
def test_edges_are_spread_over_a_coarse_polyline_and_keep_its_corners():
    points = np.array([(0, 0, 0), (0.3, 0, 0), (0.3, 0.1, 0)], dtype=float)
    line = distribute_edges(points, 8)
    assert len(line) == 9
    assert points[1].tolist() in line.tolist()
    assert np.linalg.norm(np.diff(line, axis=0), axis=1) == pytest.approx(0.05)


def test_a_fine_polyline_is_resampled_at_equal_steps():
    angles = np.linspace(0, np.pi, 201)
    points = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    line = distribute_edges(points, 12)
    assert line[0] == pytest.approx(points[0]) and line[-1] == pytest.approx(points[-1])
    assert np.linalg.norm(line[:, :2], axis=1) == pytest.approx(1.0, abs=1e-3)
    assert np.ptp(np.linalg.norm(np.diff(line, axis=0), axis=1)) < 1e-3


def test_rings_close_and_references_join():
    ring = rn.StickFigure().rod(
        "ring", [(1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0)], edges=12, closed=True, **SOFT
    )
    graph = ring.build()
    assert (graph.node_count, graph.edge_count, len(graph.springs)) == (12, 12, 12)
    assert np.bincount(graph.edges.ravel()).tolist() == [2] * 12
    with pytest.raises(rn.GraphError, match="visits the same node twice"):
        rn.StickFigure().rod("a", [(0, 0, 0), (1, 0, 0)], **SOFT).rod(
            "b", ["a.end", (1, 1, 0), "a.end"], **SOFT
        )
    with pytest.raises(rn.GraphError, match="only its first and last points may be references"):
        rn.StickFigure().rod("a", [(0, 0, 0), (1, 0, 0)], **SOFT).rod(
            "b", [(2, 0, 0), "a.end", (1, 1, 0)], edges=4, **SOFT
        )


def test_another_initial_position_keeps_the_natural_shape():
    graph = arc().graph
    straight = np.stack([np.linspace(0, 0.15, 7), np.zeros(7), np.zeros(7)], axis=1)
    moved = graph.with_positions(straight)
    robot = rn.Robot(moved, [rn.Bending()])
    assert energy(robot) > 0.0
    assert np.array_equal(moved.springs.Q1, graph.springs.Q1)
    with pytest.raises(rn.GraphError, match="shape"):
        graph.with_positions(straight[:3])
    with pytest.raises(rn.GraphError, match="no length to the edge arc:0-1"):
        graph.with_positions(np.vstack([straight[:1], straight[:-1]]))


def test_a_parameter_of_a_rod_reaches_its_stiffness():
    robot = rn.Robot(tree(), [rn.Stretching(), rn.Bending(), rn.Twisting()])
    softer = robot.with_parameters({"branch0.E": 5e5, "trunk.rho": 2000.0})
    edge = robot.graph.rods["branch0"].edges[0]
    assert softer.graph.EI1[edge] == pytest.approx(0.5 * robot.graph.EI1[edge])
    assert robot.graph.EI1[edge] == pytest.approx(1e6 * np.pi / 4 * 16e-12)  # the old one stays
    trunk = robot.graph.node("trunk:1")
    assert softer.graph.node_mass[trunk] == pytest.approx(2.0 * robot.graph.node_mass[trunk])
