"""``rodnet import`` prints the report of what the file became, and draws it."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

import rodnet as rn
from tests.importing.shapes import star, tube, y_directions


def rodnet(*arguments, cwd):
    code = "from rodnet.cli import main; main()"
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)], cwd=cwd, capture_output=True, text=True
    )


def test_import_of_a_mesh(tmp_path):
    star(y_directions(), (100, 100, 100), (8, 9, 10), 16).export(tmp_path / "y.stl")
    result = rodnet(
        "import", "y.stl", "--units", "mm", "--picture", "y.png", "--out", "y.toml", "--json", cwd=tmp_path
    )
    assert result.returncode == 0, result.stderr
    report = json.loads(result.stdout.splitlines()[-1])
    assert len(report["rods"]) == 3 and report["coverage"] > 0.98
    assert (tmp_path / "y.png").stat().st_size > 10_000
    graph = rn.Robot.load(tmp_path / "y.toml").graph
    assert len(graph.rods) == 3
    total = sum(np.pi * rod["radius"] ** 2 * rod["length"] for rod in report["rods"])
    assert graph.node_mass.sum() == pytest.approx(1000.0 * total, rel=1e-3)


def test_import_without_unit_fails_with_a_remedy(tmp_path):
    tube([(0, 0, 0), (100, 0, 0)], 8.0).export(tmp_path / "a.stl")
    result = rodnet("import", "a.stl", cwd=tmp_path)
    assert result.returncode == 2 and "pass units='mm'" in result.stderr


def test_import_of_lines(tmp_path):
    (tmp_path / "a.swc").write_text("1 3 0 0 0 1 -1\n2 3 9 0 0 1 1\n3 3 12 5 0 1 2\n4 3 12 -5 0 1 2\n")
    result = rodnet("import", "a.swc", "--json", cwd=tmp_path)
    report = json.loads(result.stdout.splitlines()[-1])
    assert len(report["rods"]) == 3 and report["coverage"] is None


def test_doubts_reach_standard_error(tmp_path):
    tube([(0, 0, 0), (100, 0, 0)], 8.0).export(tmp_path / "a.stl")
    result = rodnet("import", "a.stl", "--units", "1", cwd=tmp_path)
    assert (
        result.returncode == 0
        and "warning: 'a.stl': " in result.stderr
        and "pass units='mm'" in result.stderr
    )


@pytest.mark.parametrize("closed", [True, False])
def test_picture_of_lines(tmp_path, closed):
    angle = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    pairs = [(k, (k + 1) % 16) for k in range(16 if closed else 15)]
    found = rn.from_lines((circle, pairs), units="m", radius=0.02, material=rn.Material(E=1e6))
    assert rn.viz.plot_import(found, tmp_path / "a.png").stat().st_size > 5_000


def test_rodnet_stays_light():
    code = "import sys, rodnet; assert not {'trimesh', 'scipy', 'numpy'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_doubt_is_told_once(tmp_path):
    tube([(0, 0, 0), (100, 0, 0)], 8.0).export(tmp_path / "a.stl")
    result = rodnet("import", "a.stl", "--units", "1", cwd=tmp_path)
    assert (result.stdout + result.stderr).count("pass units='mm'") == 1


def test_a_drawing_says_which_way_its_y_axis_points(tmp_path):
    line = '<path d="M 0 0 L 10 0 L 20 10"/>'
    (tmp_path / "a.svg").write_text(f'<svg xmlns="http://www.w3.org/2000/svg">{line}</svg>')
    result = rodnet(
        "import", "a.svg", "--units", "mm", "--radius", "1e-4", "--edge-length", "1e-3", cwd=tmp_path
    )
    assert result.returncode == 0, result.stderr
    assert "y axis of SVG points down" in result.stdout
