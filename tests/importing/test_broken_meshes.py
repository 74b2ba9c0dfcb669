"""What is wrong with a mesh is named, with its remedy: an error, or a warning; never a wrong robot in silence."""

from __future__ import annotations

import re
import warnings

import numpy as np
import pytest
import trimesh

import rodnet as rn
from tests.importing.shapes import star, tube, y_directions

RUBBER = rn.Material(E=1e6)
TUBE = tube([(0, 0, 0), (100, 0, 0)], 8.0)


def load(mesh, units="mm", **options) -> rn.ImportedFigure:
    return rn.from_mesh(mesh, units=units, material=RUBBER, **options)


def warned(message, act):
    """One warning, maybe among others, says this."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = act()
    assert [w for w in caught if re.search(message, str(w.message), re.DOTALL)], [
        str(w.message) for w in caught
    ]
    assert found.report.warnings == tuple(str(w.message).partition(": ")[2] for w in caught)
    return found


def part(mesh, mask) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces[mask], process=False)


def figure_eight() -> trimesh.Trimesh:
    """A tube bent through itself."""
    t = np.linspace(0.35 * np.pi, 2.05 * np.pi, 80)
    return tube(120.0 * np.stack([np.cos(t), np.sin(2 * t) / 2, 0.0 * t], axis=1), 8.0)


def half_shell() -> trimesh.Trimesh:
    return part(TUBE, TUBE.triangles_center[:, 2] > 0.5)


def with_cavity() -> trimesh.Trimesh:
    inside = tube([(10, 0, 0), (90, 0, 0)], 4.0)
    inside.invert()
    return trimesh.util.concatenate([TUBE, inside])


def torn() -> trimesh.Trimesh:
    """Every other facet is missing."""
    return part(TUBE, np.arange(len(TUBE.faces)) % 2 == 0)


NAN = trimesh.Trimesh([(0, 0, 0), (np.nan, 0, 0), (0, 1, 0)], [(0, 1, 2)], process=False)
ERRORS = {
    "no unit": (lambda: load(TUBE, units=None), "does not say its unit of length; pass units='mm'"),
    "strange unit": (lambda: load(TUBE, units="parsec"), "units = 'parsec' is not known"),
    "negative unit": (lambda: load(TUBE, units=-1.0), "units = -1.0 must be positive"),
    "no such file": (lambda: load("nowhere.stl"), "there is no file 'nowhere.stl'"),
    "two parts": (
        lambda: load(trimesh.util.concatenate([TUBE, tube([(0, 50, 0), (80, 50, 0)], 7.0)])),
        r"2 separate parts \(100 mm at .*80 mm at .*one by one",
    ),
    "sphere": (lambda: load(trimesh.creation.icosphere(3, 20.0)), "not limbed.*fig.rigid"),
    "cube": (lambda: load(trimesh.creation.box((20, 20, 20))), "not limbed.*1.. times as long as wide"),
    "plate": (lambda: load(trimesh.creation.box((60, 60, 3))), "is a plate.*draw its middle by rods"),
    "strip": (
        lambda: load(trimesh.creation.box((200, 30, 3))),
        "no shape of limbs: the rods that were found stand for . % of its surface.*fig.rigid",
    ),
    "disc": (lambda: load(trimesh.creation.cylinder(30, 4)), "is a plate.*draw its middle by rods"),
    "endless": (lambda: load(trimesh.Trimesh(TUBE.vertices * 1e300, TUBE.faces, process=False)), "m long; pass other"),
    "nothing": (lambda: load(trimesh.Trimesh(TUBE.vertices * 1e-300, TUBE.faces, process=False)), "m long; pass other"),
    "pipe": (lambda: load(trimesh.creation.annulus(8, 10, 100)), "tube with a bore.*fill it"),
    "thick pipe": (lambda: load(trimesh.creation.annulus(3, 10, 150)), "inner wall; fill its bore.*hollow"),
    "torn": (lambda: load(torn()), "surface is torn.*mend it first"),
    "no faces": (
        lambda: load(trimesh.PointCloud([(0, 0, 0), (1, 0, 0)])),
        "lines or points and no surface.*from_lines",
    ),
    "NaN": (lambda: load(NAN), "not finite numbers"),
    "one point": (
        lambda: load(trimesh.Trimesh(np.ones((3, 3)), [(0, 1, 2)], process=False)),
        "all its vertices coincide",
    ),
    "only needles": (
        lambda: load(trimesh.Trimesh([(0, 0, 0), (1, 0, 0)], [(0, 1, 1), (0, 0, 1)], process=False)),
        "all its faces are degenerate",
    ),
    "not a mesh": (lambda: load([(0, 0, 0)]), "a path or a trimesh.Trimesh, not list"),
    "no material": (lambda: rn.from_mesh(TUBE, units="mm", material=1e6), "must be a rodnet.Material"),
    "no edges": (lambda: load(TUBE, edges=0), "edges = 0 must be a positive integer"),
    "edge length": (lambda: load(TUBE, edge_length=-1.0), "edge_length = -1.0 must be positive"),
    "edges twice": (lambda: load(TUBE, edge_length=1e-3, edges=5), "not both"),
    "bad name": (lambda: load(TUBE, name="a[0]"), "not a valid name"),
}  # fmt: skip


@pytest.mark.parametrize("case", ERRORS)
def test_errors_name_the_remedy(case):
    act, message = ERRORS[case]
    with pytest.raises(rn.RodnetError, match=f"(?s){message}"):
        act()


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.stl", "solid nothing\nendsolid\n", "has no faces"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nl 1 2\n", "no surface.*from_lines"),
        ("a.step", "ISO-10303-21;", "surfaces are read from .stl"),
        ("a.ply", "not a ply at all", "cannot be read as PLY"),
    ],
)
def test_broken_files(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(rn.MeshError, match=f"(?s)'{name}'.*{message}"):
        load(tmp_path / name)


WARNINGS = {
    "open ends": (part(TUBE, np.abs(TUBE.face_normals[:, 0]) < 0.5), "mm", "open: 2 holes closed, the largest 16 mm"),
    "half a shell": (half_shell(), "mm", "open: 1 hole closed, the largest 10"),
    "through itself": (figure_eight(), "mm", "runs through itself.*make it one solid"),
    "metres": (TUBE, "m", "100 m long; if it is meant to be 100 mm, pass units='mm'"),
    "millimetres": (tube([(0, 0, 0), (0.5, 0, 0)], 0.04), "mm", "500 um long; if it is meant to be 0.5 m|500 mm"),
    "cavity": (with_cavity(), "mm", "cavity of 80 mm is left out.*hollow"),
    "ribbon": (trimesh.creation.box((150, 20, 10)), "mm", "not round.*2 times as wide as thick.*elliptic"),
    "stubby": (tube([(0, 0, 0), (50, 0, 0)], 8.0), "mm", "only 3.. times as long as wide"),
    "body": (
        trimesh.boolean.union([trimesh.creation.icosphere(3, 25.0), star(y_directions(), (100,) * 3, (6.0,) * 3)]),
        "mm",
        r"no rod stands for .* of the surface, (49.6|50) mm across at \(.*fig.rigid",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", WARNINGS)
def test_doubts_are_warnings_in_the_report_too(case):
    mesh, units, message = WARNINGS[case]
    found = warned(message, lambda: load(mesh, units=units))
    assert found.report.warnings and "warning: " in str(found.report)
    found.figure.build()


@pytest.mark.filterwarnings("ignore:.*cavity of 36 mm is left out")
def test_a_hollow_ball_is_refused():
    ball = trimesh.boolean.difference([trimesh.creation.icosphere(3, 20), trimesh.creation.icosphere(3, 18)])
    with pytest.raises(rn.MeshError, match=r"not limbed.*fig\.rigid"):
        load(ball)


def test_a_hole_through_a_limb_is_noticed():
    """The rods have no loop there, the surface has a handle."""
    drilled = trimesh.boolean.difference([TUBE, tube([(50, -20, 0), (50, 20, 0)], 2.0)])
    found = warned("1 handles and the rods have 0 loops", lambda: load(drilled))
    assert len(found.report.rods) == 1


def test_limbs_from_the_rim_of_a_body():
    """Axes that do not meet: rods run to the middle of the body, and it is said."""
    body = tube([(0, 0, 0), (0, 0, 90)], 15.0)
    legs = [tube([(x, y, -120), (x, y, 5)], 3.0) for x, y in ((11, 0), (-11, 0))]
    found = warned("miss it by up to 11 mm.*fig.rigid", lambda: load(trimesh.boolean.union([body, *legs])))
    assert (len(found.report.rods), found.report.tips) == (3, 3)


def test_degenerate_faces_and_inside_out():
    """Repeated, collapsed and inverted faces are mended: the tube is found as it was."""
    faces = np.vstack(
        [TUBE.faces, TUBE.faces[:20], np.column_stack([TUBE.faces[:5, :2], TUBE.faces[:5, :1]])]
    )
    found = load(trimesh.Trimesh(TUBE.vertices, faces, process=False))
    inside_out = load(trimesh.Trimesh(TUBE.vertices, TUBE.faces[:, ::-1], process=False))
    mixed = TUBE.faces.copy()
    mixed[::7] = mixed[::7, ::-1]
    for each in (found, inside_out, load(trimesh.Trimesh(TUBE.vertices, mixed, process=False))):
        assert each.report.rods[0].length == pytest.approx(0.1, rel=1e-3)
        assert each.report.rods[0].radius == pytest.approx(8e-3, rel=0.01)
    assert "25 degenerate or repeated faces" in found.report.notes[0]


def test_far_too_many_faces():
    line = np.linspace(0.0, 100.0, 301)[:, None] * [1.0, 0, 0]
    found = warned("102,340 faces.*decimate", lambda: load(tube(line, 8.0, sections=170)))
    assert found.report.rods[0].length == pytest.approx(0.1, rel=1e-3)
