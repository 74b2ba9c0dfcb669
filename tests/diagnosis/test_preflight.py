"""Driven markers beside their commands, odd markers, and how often trials were opened in all."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.heldout import note, openings
from rodnet.diagnosis.preflight import held, preflight
from rodnet.diagnosis.workbench import Workbench
from rodnet.inference.evaluate import measures
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken

POINTS = ["rod.start", *shaken.POINTS]
DURATION, RATE = 1.4, 100.0


@dataclass(frozen=True)
class Off:
    """A drive that comes late, by a factor, or from elsewhere."""

    drive: shaken.Shake
    lag: float = 0.0
    gain: float = 1.0

    def __call__(self, t: float) -> np.ndarray:
        return self.gain * self.drive(max(t - self.lag, 0.0))


def observe(rec, robot):
    return rn.Markers(robot, POINTS)


CASE = replace(shaken.CASE, observe=observe)


def record(k, shift=0.0, swapped=False, **off):
    """A trial of a rod whose drive does not do what the case takes it to do."""
    attrs = shaken.drive(k)
    plain = shaken.robot(attrs)
    shake = Off(shaken.Shake(**attrs), **off)
    motion = rn.PrescribedMotion(at="rod.start", position=shake, orientation=shaken.upright)
    true = rn.Robot(plain.graph, [*plain.terms[:-1], motion])
    traj = rn.Simulation(true, dt=0.01, stepper="sdirk2").run(DURATION)
    t = np.arange(0.0, DURATION, 1.0 / RATE)
    seen = rn.observe([rn.Markers(true, POINTS)], traj, t)[0]
    seen = seen + shaken.SIGMA * np.random.default_rng(k).standard_normal(seen.shape)
    seen[:, 0, 2] += shift
    if swapped:
        half = len(t) // 2
        seen[half:, [2, 4]] = seen[half:, [4, 2]]
    edges = [(i, i + 1) for i in range(len(POINTS) - 1)]
    names = [f"m{i}" for i in range(len(POINTS))]
    return rn.Recording(t, seen, names=names, edges=edges, name=f"trial{k}", attrs=attrs)


def checked(recs):
    bench = Workbench.of(CASE, recs, Serial(), rn.NoiseModel(white=shaken.SIGMA))
    return preflight(bench, bench.fit(values=bench.start))


def test_a_drive_that_does_as_it_is_told_is_not_doubted():
    found = checked([record(0), record(1)])
    (one,) = found.driven  # the other markers move by themselves
    assert one.marker == "m0"
    assert one.rms == pytest.approx(np.sqrt(3.0) * shaken.SIGMA, rel=0.1)
    assert not one.astray
    assert found.remarks == []


@pytest.mark.parametrize(
    ("off", "kind", "value"),
    [({"lag": 0.03}, "lag", 0.03), ({"gain": 0.8}, "gain", 0.8), ({}, "shift", 0.02)],
)
def test_a_drive_that_does_not_is_told_with_what_is_wrong(off, kind, value):
    (one,) = checked([record(k, shift=0.0 if off else 0.02, **off) for k in (0, 1)]).driven
    assert one.astray
    assert max(one.share, key=one.share.get) == kind
    assert getattr(one, kind) == pytest.approx(value, rel=0.05)
    told = {"lag": "late", "gain": "0.8", "shift": "20"}[kind]
    assert "m0 is driven" in one.words and told in one.words


def in_the_plane(k):
    """A trial of which a camera saw x and z alone."""
    seen = record(k)
    flat = rn.Recording(
        seen.t, seen.markers[:, :, [0, 2]], names=seen.names, name=seen.name, attrs=dict(seen.attrs)
    )
    assert flat.planar and np.ptp(seen.markers[:, 0, 1]) > 0.02  # it moves along y, too
    return flat


def test_what_was_not_recorded_is_no_error_of_a_drive():
    (one,) = checked([in_the_plane(0), in_the_plane(1)]).driven
    assert one.rms == pytest.approx(np.sqrt(2.0) * shaken.SIGMA, rel=0.1)
    assert not one.astray


def test_distances_are_of_what_was_recorded():
    """A camera that sees a plane knows nothing of what moves out of it."""
    rec = in_the_plane(0)
    robot = CASE.robot(rec)
    seen = CASE.observations(rec, robot)
    traj = rn.Simulation(robot, dt=0.01, stepper="sdirk2").run(DURATION)
    found = measures(CASE, rec, seen, rn.observe(seen, traj, rec.t))
    assert found["metric"] == pytest.approx(shaken.SIGMA, rel=0.1)
    assert found["mean_mm_5s"] < 2e3 * shaken.SIGMA


def test_swapped_markers_are_told_before_physics_is_blamed():
    found = checked([record(0, swapped=True), record(1)])
    assert any("trial0" in remark and "swapped" in remark for remark in found.remarks)


def test_a_marker_on_an_edge_is_driven_only_if_both_its_nodes_are():
    robot = shaken.build(record(0))
    clamp = rn.Clamp(at=["rod:5", "rod:6"])
    stiff = rn.Robot(robot.graph, [*robot.terms, clamp])
    step = 100.0 / shaken.EDGES
    places = ["rod.start", f"rod@{5.5 * step}%", f"rod@{4.5 * step}%", "rod.end"]
    assert held(stiff, rn.Markers(stiff, places)).tolist() == [True, True, False, False]


def test_a_ledger_counts_what_earlier_runs_have_opened(tmp_path):
    first, second = record(0), record(1)
    ledger = tmp_path / "case.ledger.jsonl"
    assert openings(ledger, [first]) == 0
    note(ledger, [first], "held out: model as it is")
    note(ledger, [first, second], "held out: yield")
    assert openings(ledger, [first]) == 2
    assert openings(ledger, [second]) == 1
    assert openings(None, [first]) is None
    # of trials that were made in memory, what they were read by counts, too
    third = first.replace(channels={"force": first.t})
    note(ledger, [third], "held out: drag")
    assert openings(ledger, [first]) == 2 and openings(ledger, [third]) == 1
