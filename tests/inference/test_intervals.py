"""Stated intervals hold the truth as often as they say: a small part of the count in `benchmarks/intervals.py`."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.stats import chi2

from benchmarks import intervals

SEEDS = range(3)


@pytest.mark.parametrize(
    "cell", range(len(intervals.CELLS)), ids=lambda k: "-".join(map(str, intervals.CELLS[k]))
)
def test_parameters_are_off_by_as_much_as_is_stated(cell):
    rows = [intervals.held(cell, seed) for seed in SEEDS]
    off = np.array([list(row["off"].values()) for row in rows])
    low, high = chi2.ppf([1e-3, 1.0 - 1e-3], off.size)
    assert low < (off**2).sum() < high


def test_the_whole_count_is_on_record():
    found = json.loads(intervals.OUT.read_text())
    assert len(found["cells"]) == len(intervals.CELLS)
    for cell in found["cells"]:
        assert cell["sets"] >= 100
        assert all(0.86 * cell["sets"] <= n <= cell["sets"] for n in cell["held"].values())
    assert 0.93 <= found["pooled"] <= 0.97
