"""Surface meshes of shapes with known axes and radii become stick figures with those axes and radii."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import rodnet as rn
from tests.importing.shapes import random_star, star, tube, turned, y_directions

RUBBER = rn.Material(E=1e6)


def load(mesh, **options) -> rn.ImportedFigure:
    return rn.from_mesh(mesh, units="mm", material=RUBBER, **options)


def topology(report) -> tuple[int, int, int, int]:
    return len(report.rods), len(report.junctions), report.tips, report.loops


def nodes(found, name) -> np.ndarray:
    """Nodes of a rod in mm."""
    return 1e3 * found.figure.points[found.figure.specs[name].nodes]


def radii(found, name) -> np.ndarray:
    return 1e3 * np.array([section.radius for section in found.figure.specs[name].sections])


def off_line(points, start, end) -> np.ndarray:
    """Distance of points from the line through two others."""
    along = (np.asarray(end) - start) / np.linalg.norm(np.asarray(end) - start)
    away = points - start
    return np.linalg.norm(away - (away @ along)[:, None] * along, axis=1)


def middle(points) -> np.ndarray:
    n = len(points)
    return points[n // 5 : n - n // 5]


# -- shapes with known axes -----------------------------------------------------------------------
Y_RADII = (8.0, 9.0, 10.0)


def check_y(found, transform=None, tolerance=0.2, share=0.03, tips=0.5):
    """Every limb of the Y is where it should be, with its own radius."""
    transform = np.eye(4) if transform is None else transform
    centre = transform[:3, 3]
    ends = trimesh.transform_points(100.0 * y_directions(), transform)
    assert topology(found.report) == (3, 1, 3, 0)
    (junction,) = found.report.junctions
    assert len(junction.rods) == 3
    assert np.linalg.norm(1e3 * np.array(junction.position) - centre) < 2.0
    taken = set()
    for rod in found.report.rods:
        points = nodes(found, rod.name)
        limb = int(np.argmin(np.linalg.norm(ends - points[-1], axis=1)))
        taken.add(limb)
        assert off_line(middle(points), centre, ends[limb]).max() < tolerance
        assert np.linalg.norm(points[-1] - ends[limb]) < tips
        assert radii(found, rod.name)[1:] == pytest.approx(Y_RADII[limb], rel=share)
    assert taken == {0, 1, 2}


def test_y_shaped_tube():
    found = load(star(y_directions(), (100, 100, 100), Y_RADII))
    check_y(found)
    assert found.report.coverage > 0.99
    assert found.report.radius_residual < 1e-4
    assert not found.report.warnings
    graph = found.figure.build()
    assert len(graph.rods) == 3 and np.bincount(graph.edges.ravel()).max() == 3


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_result_does_not_depend_on_how_the_mesh_lies_or_is_numbered(seed):
    mesh, transform = turned(star(y_directions(), (100, 100, 100), Y_RADII), seed)
    check_y(load(mesh), transform)


@pytest.mark.parametrize(("sections", "share"), [(8, 0.055), (12, 0.03), (96, 0.03)])
def test_coarse_and_fine_meshes(sections, share):
    """An octagon in the circle has 10 % less area: the radius is that of the mesh, not of the ideal tube."""
    check_y(load(star(y_directions(), (100, 100, 100), Y_RADII, sections)), share=share)


def test_overlapping_shells_are_united():
    limbs = [tube([(0, 0, 0), 100 * d], r) for d, r in zip(y_directions(), Y_RADII, strict=True)]
    found = load(trimesh.util.concatenate(limbs))
    check_y(found)
    assert "3 shells" in found.report.notes[0]


def test_rough_surface():
    """Vertices off by up to 0.3 mm leave the axis within 0.3 mm."""
    mesh = star(y_directions(), (100, 100, 100), Y_RADII).subdivide()
    rng = np.random.default_rng(0)
    rough = trimesh.Trimesh(
        mesh.vertices + rng.uniform(-0.3, 0.3, mesh.vertices.shape), mesh.faces, process=False
    )
    check_y(load(rough), tolerance=0.3, tips=1.0)


@pytest.mark.parametrize("end", [(0, 0, 100), (30, -20, 70)])
def test_straight_tube(end):
    found = load(tube([(0, 0, 0), end], 8.0))
    assert topology(found.report) == (1, 0, 2, 0)
    points = nodes(found, "limb0")
    assert off_line(points, np.zeros(3), end).max() < 1e-3
    assert np.linalg.norm(points[-1] - points[0]) == pytest.approx(np.linalg.norm(end), rel=1e-3)
    assert radii(found, "limb0") == pytest.approx(8.0, rel=0.01)


@pytest.mark.parametrize("angle", [90.0, 50.0])
def test_four_limbs_that_cross(angle):
    a, b = 0.0, np.radians(angle)
    arms = [(np.cos(t), np.sin(t), 0.0) for t in (a, b, a + np.pi, b + np.pi)]
    found = load(star(arms, (90,) * 4, (8.0, 6.0, 8.0, 6.0)))
    assert topology(found.report) == (4, 1, 4, 0)
    assert np.linalg.norm(1e3 * np.array(found.report.junctions[0].position)) < 1.0
    assert sorted(1e3 * rod.radius for rod in found.report.rods) == pytest.approx([6, 6, 8, 8], rel=0.01)
    for rod in found.report.rods:
        points = nodes(found, rod.name)
        assert off_line(points, np.zeros(3), 90 * np.array(arms)[np.argmax(arms @ points[-1])]).max() < 0.2


@pytest.mark.filterwarnings("ignore:.*times as long as wide")
@pytest.mark.parametrize("seed", [3, 79, 113, 158, 189])
def test_random_stars_of_tapering_limbs(seed):
    """Axes within 0.1 mm from the clearance to the tip, at any number of limbs, angles and thicknesses."""
    mesh, tips, shape = random_star(seed)
    mesh, transform = turned(mesh, seed)
    found = load(mesh)
    assert topology(found.report) == (len(tips), 1, len(tips), 0)
    centre, ends = transform[:3, 3], trimesh.transform_points(tips, transform)
    assert 1e3 * np.array(found.report.junctions[0].position) == pytest.approx(centre, abs=0.1)
    for rod in found.report.rods:
        points = nodes(found, rod.name)
        limb = int(np.argmin(np.linalg.norm(ends - points[-1], axis=1)))
        assert off_line(points, centre, ends[limb]).max() < 0.1
        assert points[-1] == pytest.approx(ends[limb], abs=0.1)
        half = radii(found, rod.name)[rod.edges // 2 :]
        s = (np.arange(rod.edges) + 0.5)[rod.edges // 2 :] / rod.edges
        assert half == pytest.approx(np.interp(s, [0, 1], shape[limb]), rel=0.04)


def test_tree_with_two_junctions():
    spine = np.array([(0, 0, 0), (90, 0, 0)], dtype=float)
    twigs = {(-60, 50, 0): 0, (-60, -50, 10): 0, (150, 40, 30): 1, (140, -60, 0): 1}
    limbs = [tube(spine, 9.0)] + [tube([spine[k], end], 6.0) for end, k in twigs.items()]
    found = load(trimesh.boolean.union(limbs))
    assert topology(found.report) == (5, 2, 4, 0)
    at = sorted(junction.position for junction in found.report.junctions)
    assert 1e3 * np.array(at) == pytest.approx(spine, abs=2.0)
    for rod in found.report.rods:
        points = nodes(found, rod.name)
        ends = [spine[1], *np.array(list(twigs))]
        k = int(np.argmin(np.linalg.norm(ends - points[-1], axis=1)))
        start = spine[0] if k == 0 else spine[list(twigs.values())[k - 1]]
        if rod.radius > 8e-3:
            start, k = spine[0], 0
        assert off_line(middle(points), start, ends[k]).max() < 0.2
    assert {round(1e3 * rod.radius) for rod in found.report.rods} == {9, 6}


def test_limbs_of_unlike_and_tapering_radius():
    """Cones: the radius of every edge is that of the cone in its middle, and grows to nothing else at the junction."""
    shape = ((10.0, 4.0), (8.0, 8.0), (5.0, 2.0))
    found = load(star(y_directions(), (140, 100, 80), shape))
    assert topology(found.report) == (3, 1, 3, 0)
    for rod, length, (root, tip) in zip(found.report.rods, (140, 100, 80), shape, strict=True):
        s = (np.arange(rod.edges) + 0.5) / rod.edges
        inner = s * length > 15.0
        assert 1e3 * rod.length == pytest.approx(length, rel=0.01)
        assert radii(found, rod.name)[inner] == pytest.approx((root + (tip - root) * s)[inner], rel=0.03)


def test_curved_limb():
    """Three quarters of a circle of 60 mm: axis within 0.1 mm, also by its ends within 0.5 mm, length within 1 %."""
    angle = np.linspace(0.0, 1.5 * np.pi, 60)
    line = 60.0 * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    found = load(tube(line, 7.0), edge_length=4e-3)
    points = nodes(found, "limb0")
    off = np.hypot(np.linalg.norm(points[:, :2], axis=1) - 60.0, points[:, 2])
    assert off[5:-5].max() < 0.1 and off.max() < 0.5
    assert 1e3 * found.report.rods[0].length == pytest.approx(60 * 1.5 * np.pi, rel=0.01)
    assert radii(found, "limb0") == pytest.approx(7.0, rel=0.015)


def test_ring():
    found = load(trimesh.creation.torus(50, 8, 48, 24))
    assert topology(found.report) == (1, 0, 0, 1)
    assert found.figure.specs["limb0"].closed and found.report.rods[0].closed
    points = nodes(found, "limb0")
    assert np.hypot(np.linalg.norm(points[:, :2], axis=1) - 50, points[:, 2]).max() < 0.2
    assert radii(found, "limb0") == pytest.approx(8.0, rel=0.02)
    found.figure.build()


def test_ring_with_a_handle():
    """A ring that is joined to a limb at one node becomes two rods: a rod does not come back to its start."""
    handle = tube([(50, 0, 0), (150, 0, 0)], 7.0)
    found = load(trimesh.boolean.union([trimesh.creation.torus(50, 8, 48, 24), handle]))
    assert topology(found.report) == (3, 1, 1, 1)
    assert 1e3 * np.array(found.report.junctions[0].position) == pytest.approx([50, 0, 0], abs=2.0)
    assert sum(1e3 * rod.length for rod in found.report.rods) == pytest.approx(100 * np.pi + 100, rel=0.02)
    found.figure.build()


def test_imported_robot_runs_and_weighs_what_the_mesh_does():
    found = load(star(y_directions(), (100, 100, 100), Y_RADII), edges=8)
    graph = found.figure.build()
    assert all(len(rod.edges) == 8 for rod in graph.rods.values())
    # the overlap at the junction counts three times
    assert graph.node_mass.sum() == pytest.approx(RUBBER.rho * found.surface.volume, rel=0.03)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), rn.Clamp(at="limb0.end")]
    assert np.isfinite(rn.equilibrium(rn.Robot(graph, terms)).x).all()


# -- files ------------------------------------------------------------------------------------------
@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "glb", "off"])
def test_formats(tmp_path, suffix):
    path = tmp_path / f"y.{suffix}"
    star(y_directions(), (100, 100, 100), Y_RADII, 16).export(path)
    # glTF is in metres by its standard; the exported numbers are meant as mm
    check_y(rn.from_mesh(path, units="mm", material=RUBBER), share=0.03)


def test_glb_with_a_scene_graph(tmp_path):
    """One tube, drawn three times by nodes with transforms, a mirrored and a nested one among them, is a Y."""
    turn = trimesh.transformations.rotation_matrix
    path, scene = tmp_path / "scene.glb", trimesh.Scene()
    limb = tube([(0, 0, 0), (0.05, 0, 0)], 0.004)
    scene.graph.update(frame_from="world", frame_to="hub", matrix=np.diag([2.0, 2.0, 2.0, 1.0]))
    for k, mirror in enumerate((1.0, -1.0, 1.0)):
        placed = turn(2.0 * np.pi * k / 3.0, (0, 0, 1)) @ np.diag([1.0, mirror, 1.0, 1.0])
        scene.add_geometry(
            limb, node_name=f"limb {k}", geom_name="tube", parent_node_name="hub", transform=placed
        )
    scene.export(path)
    report = rn.from_mesh(path, material=RUBBER).report
    assert topology(report) == (3, 1, 3, 0)
    assert [rod.length for rod in report.rods] == pytest.approx([0.1] * 3, rel=2e-3)
    assert [rod.radius for rod in report.rods] == pytest.approx([0.008] * 3, rel=0.03)


def test_glb_knows_its_unit(tmp_path):
    path = tmp_path / "tube.glb"
    tube([(0, 0, 0), (0.1, 0, 0)], 0.008).export(path)
    found = rn.from_mesh(path, material=RUBBER)
    assert found.report.rods[0].length == pytest.approx(0.1, rel=1e-3)


def test_report_reads_and_serialises():
    import json

    report = load(star(y_directions(), (100, 100, 100), Y_RADII, 12)).report
    text = str(report)
    for part in (
        "3 rods, 1 junction, 3 tips, 0 loops",
        "covers",
        "limb0",
        "limb0.start joins limb0, limb1, limb2",
    ):
        assert part in text
    values = json.loads(json.dumps(report.to_dict()))
    assert len(values["rods"]) == 3 and len(values["rods"][0]["s"]) == len(values["rods"][0]["profile"])
