"""Looking at recordings: what is counted, what is remarked, the page and the command."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import rodnet as rn

T = 0.01 * np.arange(300)


def trial(seed=0, start=0.5, **changes):
    """Five markers on a straight rod that rests until ``start``, then swings."""
    rng = np.random.default_rng(seed)
    x = np.zeros((300, 5, 3))
    x[..., 0] = 0.1 * np.arange(5)
    moving = np.maximum(T - start, 0.0)
    x[..., 2] = 0.05 * np.sin(9.0 * moving)[:, None]
    x += rn.NoiseModel(5e-5).sample(T, 5, rng)
    return rn.Recording(T, x, edges=[(i, i + 1) for i in range(4)], name=f"trial{seed}", **changes)


def test_counts():
    rec = trial(start=1.0)
    x, suspect = rec.markers.copy(), np.zeros((300, 5), dtype=bool)
    x[100:120, 2] = np.nan
    suspect[0, 4] = True
    keep = np.r_[0:200, 203:300]
    rec = rec.replace(t=T[keep], markers=x[keep], suspect=suspect[keep], channels={"rpm": np.zeros(297)})
    found = rn.inspect(rec)
    (file,) = found.files
    assert (file["frames"], file["steps_missing"]) == (297, 3)
    assert file["lost"] == pytest.approx(20 / (297 * 5))
    assert file["longest_gap_s"] == pytest.approx(0.21)
    assert file["starts_at_rest"] and file["rest_s"] == pytest.approx(1.0, abs=0.1)
    assert file["channels"] == {"rpm": [297]}
    assert any("first two frames of marker 4 are suspect" in r for r in found.remarks)
    assert any("3 frames are missing" in r for r in found.remarks)
    assert not rn.inspect(trial(start=0.0)).files[0]["starts_at_rest"]


def test_a_marker_that_slips_is_remarked():
    rec = trial()
    x = rec.markers.copy()
    x[150:, 3, 0] += 0.03
    remarks = rn.inspect([trial(1), rec.replace(markers=x)]).remarks
    assert len(remarks) == 1 and "trial0: the distance of markers" in remarks[0]


def test_what_is_never_seen_whole_is_no_edge_and_what_nobody_sees_may_move():
    rec = trial(start=0.0)
    suspect = np.zeros((300, 5), dtype=bool)
    suspect[:, 1::2] = True
    (file,) = rn.inspect(rec.replace(suspect=suspect)).files
    assert file["breathing_mm"] is None or np.isnan(file["breathing_mm"])
    x = rec.markers.copy()
    x[100:250] = np.nan
    (file,) = rn.inspect(rec.replace(markers=x)).files
    assert file["rest_s"] == 0.0


def test_too_short_for_a_noise_model_is_said():
    found = rn.inspect(trial().cut(0.0, 0.1))
    assert found.noise is None and "at least 20 good frames" in found.remarks[0]


def test_page_is_self_contained(tmp_path):
    page = (
        rn.inspect([trial(0), trial(1, attrs={"payload": 0.2})]).save(tmp_path / "deep/page.html").read_text()
    )
    assert "viewport" in page and page.count("data:image/png") == 2
    assert not re.findall(r'(?:src|href)="(?!data:)', page)
    assert "white" in page.lower() and "trial1" in page
    with pytest.raises(rn.OutputError, match="cannot write"):
        rn.inspect(trial()).save(tmp_path)


def test_command(tmp_path):
    for k in range(2):
        trial(k, group="").save(tmp_path / f"trial{k}.npz")
    command = [str(Path(sys.executable).with_name("rodnet")), "inspect", str(tmp_path)]
    told = subprocess.run([*command, "--out", "page.html"], cwd=tmp_path, capture_output=True, text=True)
    assert told.returncode == 0, told.stderr
    assert "trial0" in told.stdout
    assert float(re.search(r"white ([\d.]+) mm", told.stdout)[1]) == pytest.approx(0.05, rel=0.1)
    assert (tmp_path / "page.html").stat().st_size > 10_000
    found = json.loads(
        subprocess.run([*command, "--json"], capture_output=True, text=True).stdout.splitlines()[-1]
    )
    assert [f["name"] for f in found["files"]] == ["trial0", "trial1"]
    wrong = subprocess.run([*command[:2], "nowhere.npz"], cwd=tmp_path, capture_output=True, text=True)
    assert wrong.returncode == 2 and "there is no recording at 'nowhere.npz'" in wrong.stderr
