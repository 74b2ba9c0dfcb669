"""What slow noise might be, if its estimate were wrong, is looked for all the same."""

from __future__ import annotations

import numpy as np
import pytest

import rodnet as rn
from tests.diagnosis import shaken

SLOW, TIME, UNSURE = 5e-4, 1.0, 1.5  # [m], [s], and how wrong that may be
TRIED = ["stiffness-gradient", "marker-slip", "gravity", "yield", "drive-gain"]


def wandering(count, shape, rng):
    """Noise that lasts: an Ornstein-Uhlenbeck process."""
    rho = np.exp(-1.0 / shaken.RATE / TIME)
    x = SLOW * rng.standard_normal((count, *shape))
    for k in range(1, count):
        x[k] = rho * x[k - 1] + np.sqrt(1.0 - rho**2) * x[k]
    return x


def record(k, drift, **effect):
    """A trial with slow noise, and a marker that slips."""
    rec = shaken.record(k, "stiffness-gradient", effect, drift=[0.0, drift, 0.0, 0.0])
    seen = rec.markers + wandering(len(rec.t), rec.markers.shape[1:], np.random.default_rng(k))
    return rn.Recording(rec.t, seen, names=rec.names, name=rec.name, attrs=rec.attrs)


@pytest.mark.parametrize("drift", [0.0, pytest.param(2e-3, marks=pytest.mark.slow)])
def test_a_marker_that_slips_is_told_from_noise_that_lasts(drift):
    recs = [record(k, drift, slope=0.6) for k in range(5)]
    noise = rn.NoiseModel(white=shaken.SIGMA, slow=SLOW, time=TIME, unsure=UNSURE)
    found = rn.diagnose(shaken.CASE, recs, candidates=TRIED, noise=noise, workers=0)
    ids = [one.id for one in found.findings]
    assert ids == ["stiffness-gradient@rod", *(["marker-slip@markers:1"] if drift else [])]
