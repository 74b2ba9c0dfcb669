"""Line drawings in all formats become rods with shared nodes; radii come along."""

from __future__ import annotations

import re
import warnings

import numpy as np
import pytest
import trimesh

import rodnet as rn

RUBBER = rn.Material(E=1e6)
# a fork: a handle of two segments, two tines of one and of two
POINTS = np.array(
    [(0, 0, 0), (50, 0, 0), (100, 0, 0), (160, 40, 0), (150, -30, 20), (200, -40, 20)], dtype=float
)
SEGMENTS = [(0, 1), (1, 2), (2, 3), (2, 4), (4, 5)]


def load(source, **options) -> rn.ImportedFigure:
    return rn.from_lines(source, **{"units": "mm", "radius": 2e-3, "material": RUBBER, **options})


def write(path, kind):
    """The fork in a format."""
    if kind == "obj":
        rows = [f"v {x} {y} {z}" for x, y, z in POINTS] + ["l 1 2 3", "l 3 4 # a tine", "l -4/1 -2/1 -1/1"]
    elif kind == "ply":
        head = f"ply\nformat ascii 1.0\nelement vertex {len(POINTS)}\n" + "".join(
            f"property float {c}\n" for c in "xyz"
        )
        head += f"element edge {len(SEGMENTS)}\nproperty int vertex1\nproperty int vertex2\nend_header"
        rows = [head] + [f"{x} {y} {z}" for x, y, z in POINTS] + [f"{i} {j}" for i, j in SEGMENTS]
    elif kind == "swc":
        parent = {j: i for i, j in SEGMENTS}
        rows = ["# a fork"] + [
            f"{k + 1} 3 {x} {y} {z} {2.0 + 0.1 * k} {parent[k] + 1 if k in parent else -1}"
            for k, (x, y, z) in enumerate(POINTS)
        ]
    elif kind == "dxf":
        rows = ["0", "SECTION", "2", "ENTITIES"]
        for i, j in SEGMENTS:
            (x, y, _), (u, v, _) = POINTS[i], POINTS[j]
            rows += ["0", "LINE", "8", "0", "10", str(x), "20", str(y), "11", str(u), "21", str(v)]
        rows += ["0", "ENDSEC", "0", "EOF"]
    else:
        lines = "".join(
            f'<path d="M {POINTS[i][0]} {POINTS[i][1]} L {POINTS[j][0]} {POINTS[j][1]}"/>'
            for i, j in SEGMENTS
        )
        rows = [f'<svg xmlns="http://www.w3.org/2000/svg">{lines}</svg>']
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize("kind", ["obj", "ply", "swc", "dxf", "svg"])
def test_a_fork_in_every_format(tmp_path, kind):
    found = load(write(tmp_path / f"fork.{kind}", kind), radius=None if kind == "swc" else 2e-3)
    report = found.report
    assert (len(report.rods), len(report.junctions), report.tips, report.loops) == (3, 1, 3, 0)
    assert 1e3 * np.array(report.junctions[0].position) == pytest.approx(POINTS[2])
    flat = kind in ("dxf", "svg")
    expected = POINTS * [1, 1, 0] if flat else POINTS
    assert np.unique(np.round(1e3 * found.figure.points, 6), axis=0) == pytest.approx(
        np.unique(expected, axis=0)
    )
    lengths = sorted(1e3 * rod.length for rod in report.rods)
    steps = {frozenset(s): np.linalg.norm(np.subtract(*expected[list(s)])) for s in SEGMENTS}
    assert lengths == pytest.approx(
        sorted([steps[frozenset((2, 3))], 100, steps[frozenset((2, 4))] + steps[frozenset((4, 5))]])
    )
    graph = found.figure.build()
    assert graph.node_count == 6 and len(graph.edges) == 5


def test_radii_of_swc_are_those_of_its_cones(tmp_path):
    """The radius of an edge gives it the volume of the frustum between its points; the unit is the micrometre."""
    found = load(write(tmp_path / "fork.swc", "swc"), radius=None, units=None)
    graph = found.figure.build()
    r = 2.0 + 0.1 * np.arange(6)
    volume = sum(
        np.pi / 3 * np.linalg.norm(POINTS[i] - POINTS[j]) * (r[i] ** 2 + r[i] * r[j] + r[j] ** 2)
        for i, j in SEGMENTS
    )
    assert graph.node_mass.sum() == pytest.approx(RUBBER.rho * volume * 1e-18, rel=1e-9)
    assert found.report.rods[0].radius == pytest.approx(2.3e-6, rel=0.1)
    fine = load(tmp_path / "fork.swc", radius=None, units=None, edge_length=2e-6)
    assert fine.figure.build().node_mass.sum() == pytest.approx(graph.node_mass.sum(), rel=1e-3)


def test_a_cell_body_does_not_swell_its_branches(tmp_path):
    (tmp_path / "cell.swc").write_text(
        "1 1 0 0 0 12 -1\n2 3 20 0 0 1 1\n3 3 60 0 0 1 2\n4 3 0 30 0 2 1\n5 3 0 -30 0 2 1\n"
    )
    found = load(tmp_path / "cell.swc", radius=None, units=None)
    assert max(rod.profile.max() for rod in found.report.rods) == pytest.approx(2e-6)
    assert "cell body" in found.report.notes[0]


def test_branches_of_a_cell_with_a_body_of_three_points(tmp_path):
    """Branches of types 2 and 3 keep their own radii and meet at the cell body; its two lines keep theirs."""
    (tmp_path / "cell.swc").write_text(
        "1 1 0 0 0 8 -1\n2 1 0 -8 0 8 1\n3 1 0 8 0 8 1\n4 3 8 0 0 1 1\n5 3 40 0 0 1 4\n"
        "6 2 -8 0 0 2 1\n7 2 -50 0 0 2 6\n8 2 -70 20 0 1 7\n9 2 -70 -20 0 1 7\n"
    )
    report = load(tmp_path / "cell.swc", radius=None, units=None).report
    assert (len(report.rods), len(report.junctions), report.tips) == (6, 2, 5)
    mean = np.sqrt((1.0 + 2.0 + 4.0) / 3.0)  # of cones from 2 to 1
    assert [1e6 * rod.radius for rod in report.rods] == pytest.approx([2, 1, mean, mean, 8, 8], rel=1e-3)


def test_curves_drawn_finer_than_their_radius(tmp_path):
    """The transform of a group counts; points much closer than the radius are no nodes, and it is said."""
    (tmp_path / "arc.svg").write_text(
        '<svg xmlns="http://www.w3.org/2000/svg"><g transform="translate(10,0) scale(2)">'
        '<path d="M 0 0 L 10 0 C 20 0 20 10 10 10"/></g></svg>'
    )
    with pytest.warns(UserWarning, match=r"much shorter than its radius of 2 mm; pass edge_length="):
        load(tmp_path / "arc.svg")
    found = load(tmp_path / "arc.svg", edge_length=4e-3)
    points = 1e3 * found.figure.points
    assert points.min(axis=0) == pytest.approx([10, 0, 0], abs=0.05)
    assert points.max(axis=0) == pytest.approx([45, 20, 0], abs=0.2)


def test_edges_are_spread_along_chains():
    found = load((POINTS, SEGMENTS), edge_length=5e-3)
    assert [rod.edges for rod in found.report.rods] == [round(rod.length / 5e-3) for rod in found.report.rods]
    assert {rod.edges for rod in load((POINTS, SEGMENTS), edges=7).report.rods} == {7}


def test_a_ring_and_loops():
    """A free ring is one closed rod; a square with a diagonal three rods between two junctions."""
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    circle = 50 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    ring = load((circle, [(k, (k + 1) % 24) for k in range(24)]))
    assert ring.figure.specs["rod0"].closed and (ring.report.tips, ring.report.loops) == (0, 1)
    ring.figure.build()
    square = np.array([(0, 0, 0), (50, 0, 0), (50, 50, 0), (0, 50, 0)])
    found = load((square, [(0, 1), (1, 2), (2, 3), (3, 0), (0, 2)]))
    assert (len(found.report.rods), len(found.report.junctions), found.report.loops) == (3, 2, 2)
    found.figure.build()


def test_a_lasso():
    """A loop that comes back to its own junction is two rods."""
    points = np.array([(0, 0, 0), (50, 0, 0), (80, 30, 0), (110, 0, 0), (80, -30, 0)])
    found = load((points, [(0, 1), (1, 2), (2, 3), (3, 4), (4, 1)]))
    assert (len(found.report.rods), len(found.report.junctions), found.report.tips, found.report.loops) == (
        3,
        1,
        1,
        1,
    )
    found.figure.build()


def test_points_close_to_one_another_and_ends_on_lines_are_joined():
    """Segments drawn one by one, a branch that ends on a line between its points, a line drawn twice."""
    points = np.array(
        [(0, 0, 0), (100, 0, 0), (100, 1e-5, 0), (150, 0, 0), (60, 0, 0), (60, 50, 0), (0, 0, 0), (100, 0, 0)]
    )
    found = load((points, [(0, 1), (2, 3), (4, 5), (6, 7)]))
    assert (len(found.report.rods), len(found.report.junctions), found.report.tips) == (3, 1, 3)
    assert 1e3 * np.array(found.report.junctions[0].position) == pytest.approx([60, 0, 0])
    assert "2 lines drawn twice" in found.report.notes[0] or "1 lines drawn twice" in found.report.notes[0]


def test_parts_that_nearly_touch():
    points = np.array([(0, 0, 0), (100, 0, 0), (100.3, 0, 0), (150, 40, 0)])
    with pytest.warns(UserWarning, match=r"2 separate parts.*300 um apart at .*pass join="):
        found = load((points, [(0, 1), (2, 3)]))
    assert len(found.report.rods) == 2
    joined = load((points, [(0, 1), (2, 3)]), join=5e-4)
    assert (len(joined.report.rods), joined.report.tips) == (1, 2)


def test_an_imported_drawing_runs():
    found = load((POINTS, SEGMENTS), edge_length=1e-2)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), rn.Clamp(at="rod0.end")]
    assert np.isfinite(rn.equilibrium(rn.Robot(found.figure.build(), terms)).x).all()


FILES = {
    "faces.obj": ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "no line records.*rodnet.from_mesh"),
    "beyond.obj": ("v 0 0 0\nv 1 0 0\nl 1 3\n", "names point 3, and there are 2"),
    "word.obj": ("v 0 0 zero\nl 1 1\n", "line 1: 'v 0 0 zero'"),
    "short.swc": ("1 1 0 0 0 1\n", "line 1.*seven columns"),
    "orphan.swc": ("1 1 0 0 0 1 -1\n2 1 1 0 0 1 7\n", "point 2 has the parent 7, which is not there"),
    "thin.swc": ("1 3 0 0 0 1 -1\n2 3 9 0 0 0 1\n", "point 2 has the radius 0"),
    "twice.swc": ("1 3 0 0 0 1 -1\n1 3 9 0 0 1 1\n", "same index"),
    "cycle.swc": ("1 3 0 0 0 1 3\n2 3 9 0 0 1 1\n3 3 9 9 0 1 2\n", "no point is a root"),
    "own.swc": ("1 3 0 0 0 1 -1\n2 3 9 0 0 1 2\n", "point 2 is its own parent"),
    "half.swc": ("1 3 0 0 0 1 -1\n2.5 3 9 0 0 1 1\n", "line 2.*whole numbers"),
    "endless.swc": ("1 3 0 0 0 1 -1\n2 3 9 0 0 inf 1\n", "point 2 has the radius inf"),
    "beyond.ply": (
        "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n"
        "element edge 1\nproperty int vertex1\nproperty int vertex2\nend_header\n0 0 0\n1 0 0\n0 7\n",
        "names a point that is not there",
    ),
    "empty.swc": ("# nothing\n", "has no points"),
    "a.step": ("", "lines are read from .ply"),
    "bad.svg": ("<svg", "cannot be read as SVG"),
}


@pytest.mark.parametrize("name", FILES)
def test_broken_files_are_named(tmp_path, name):
    text, message = FILES[name]
    (tmp_path / name).write_text(text)
    with pytest.raises(rn.MeshError, match=f"(?s){re.escape(name)}.*{message}"):
        load(tmp_path / name)


FOLDED = (np.array([(0, 0, 0), (50, 0, 0), (20, 1e-3, 0)]), [(0, 1), (1, 2)])
ERRORS = {
    "no unit": (lambda: load((POINTS, SEGMENTS), units=None), "does not say its unit"),
    "no radius": (lambda: load((POINTS, SEGMENTS), radius=None), "has no radii; pass radius="),
    "bad radius": (lambda: load((POINTS, SEGMENTS), radius=-1.0), "radius = -1.0 must be positive"),
    "a surface": (lambda: load(trimesh.creation.box()), "holds a surface.*rodnet.from_mesh"),
    "not lines": (lambda: load(5), "not int"),
    "shapes": (lambda: load((POINTS[:, :2], SEGMENTS)), r"shapes \(n, 3\)"),
    "beyond": (lambda: load((POINTS, [(0, 9)])), "names point 9, and there are 6"),
    "no file": (lambda: load("nowhere.swc"), "there is no file"),
    "folds": (lambda: load(FOLDED), r"folds back on itself at \(50, 0, 0\)"),
    "one place": (lambda: load((np.zeros((2, 3)), [(0, 1)])), "all its points coincide"),
    "NaN": (lambda: load((POINTS * np.nan, SEGMENTS)), "not finite"),
    "join": (lambda: load((POINTS, SEGMENTS), join=5.0), "join = 5.0 must be a distance"),
}  # fmt: skip


@pytest.mark.parametrize("case", ERRORS)
def test_errors_name_the_remedy(case):
    act, message = ERRORS[case]
    with warnings.catch_warnings(), pytest.raises(rn.RodnetError, match=f"(?s){message}"):
        warnings.simplefilter("ignore")
        act()
