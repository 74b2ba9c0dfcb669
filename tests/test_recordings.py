"""Recordings: round trips through files, views, and files that are broken or hostile."""

from __future__ import annotations

import dataclasses
import io
import json
import pickle
import warnings
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rodnet as rn


def recording(**changes):
    rng = np.random.default_rng(0)
    markers = rng.normal(size=(12, 3, 3))
    markers[4, 1] = np.nan
    suspect = np.zeros((12, 3), dtype=bool)
    suspect[0, 2] = suspect[7, 0] = True
    values = {
        "t": 0.01 * np.arange(12),
        "markers": markers,
        "names": ["base", "middle", "tip"],
        "edges": [(0, 1), (1, 2)],
        "prescribed": [0],
        "suspect": suspect,
        "channels": {"rpm": np.linspace(0, 100, 12)},
        "attrs": {"payload_kg": 0.2, "u": np.arange(3.0), "operator": "hand"},
        "group": "monday",
        **changes,
    }
    return rn.Recording(**values)


@pytest.mark.parametrize("suffix", ["npz", "csv", "nc"])
def test_round_trip(tmp_path, suffix):
    rec = recording()
    back = rn.read_recording(rec.save(tmp_path / f"trial.{suffix}"))
    assert back.digest == rec.digest  # times, positions, flags, channels
    assert (back.names, back.group, back.name) == (rec.names, "monday", "trial")
    assert np.array_equal(back.edges, rec.edges) and np.array_equal(back.prescribed, rec.prescribed)
    assert back.attrs["payload_kg"] == 0.2 and back.attrs["operator"] == "hand"
    assert np.array_equal(back.attrs["u"], np.arange(3.0))
    assert back.channels["rpm"](0.055) == pytest.approx(50.0)


@pytest.mark.parametrize("suffix", ["npz", "csv", "nc"])
@pytest.mark.parametrize("dof", [4.0, np.inf])
def test_the_noise_that_is_known_is_kept(tmp_path, suffix, dof):
    noise = rn.NoiseModel(white=np.array([1e-4, 2e-4, 3e-4]), slow=1e-4, time=0.4, dof=dof)
    rec = recording(noise=noise)
    back = rn.read_recording(rec.save(tmp_path / f"trial.{suffix}")).noise
    assert back.to_dict() == noise.to_dict()
    assert rn.read_recording(recording().save(tmp_path / f"other.{suffix}")).noise is None


@pytest.mark.parametrize("name", ["tip #1", "tip [left]", " tip"])
def test_names_that_a_table_cannot_keep_are_refused(tmp_path, name):
    rec = recording(names=("base", name, "end"))
    with pytest.raises(rn.OutputError, match="cannot be a column's name"):
        rec.save(tmp_path / "trial.csv")
    assert rn.read_recording(rec.save(tmp_path / "trial.npz")).names == ("base", name, "end")
    with pytest.raises(rn.OutputError, match="cannot be a column's name"):
        recording(channels={name: np.linspace(0.0, 1.0, 12)}).save(tmp_path / "trial.csv")


@pytest.mark.parametrize("name", ["acc_x", "acc.z", "t", "marker"])
def test_channels_that_a_table_would_read_as_something_else_are_refused(tmp_path, name):
    rec = recording(channels={name: np.linspace(0.0, 1.0, 12)})
    with pytest.raises(rn.OutputError, match="would be read as something else"):
        rec.save(tmp_path / "trial.csv")


@pytest.mark.parametrize("suffix", ["npz", "csv", "nc"])
def test_that_y_was_not_recorded_is_kept(tmp_path, suffix):
    plane = np.random.default_rng(0).normal(size=(12, 3, 2))
    plane[4, 1] = np.nan
    rec = recording(markers=plane)
    assert rec.planar and not recording().planar and "in the plane" in repr(rec)
    assert rec.cut(0.0, 0.05).planar and pickle.loads(pickle.dumps(rec)).planar
    back = rn.read_recording(rec.save(tmp_path / f"trial.{suffix}"))
    assert back.planar and back.digest == rec.digest


def test_what_is_given_a_y_is_not_planar_any_more():
    rec = recording(markers=np.zeros((12, 3, 2)))
    assert rec.replace(name="other").planar
    assert not rec.replace(markers=np.ones((12, 3, 3))).planar
    assert not recording(markers=np.zeros((12, 3, 3))).planar  # y was recorded, as zero


@settings(max_examples=25, deadline=None)
@given(frames=st.integers(3, 20), count=st.integers(1, 4), seed=st.integers(0, 99), lost=st.floats(0, 0.5))
def test_round_trip_of_any_numbers(tmp_path_factory, frames, count, seed, lost):
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(frames, count, 3)) * 10.0 ** rng.integers(-6, 1)
    x[1:][rng.random((frames - 1, count)) < lost] = np.nan
    rec = rn.Recording(np.cumsum(rng.uniform(0.001, 1.0, frames)), x)
    folder = tmp_path_factory.mktemp("any")
    for suffix in ("npz", "csv", "nc"):
        assert rn.read_recording(rec.save(folder / f"x.{suffix}")).digest == rec.digest


def test_single_precision_times_are_even_again(tmp_path):
    t = (0.01 * np.arange(500)).astype(np.float32)
    np.savez(tmp_path / "a.npz", t=t, markers=np.zeros((500, 1, 3), dtype=np.float32))
    rec = rn.read_recording(tmp_path / "a.npz")
    assert np.abs(rec.t - 0.01 * np.arange(500)).max() < 1e-12
    uneven = t.astype(float) + 1e-4 * np.sin(np.arange(500))
    assert np.array_equal(rn.Recording(uneven, np.zeros((500, 1, 3))).t, uneven)


def test_long_and_wide_tables_in_other_units_are_the_same(tmp_path):
    (tmp_path / "wide.csv").write_text(
        "time [ms],tip.x [mm],tip.y [mm],tip.z [mm],load\n0,1,2,3,7\n10,1.5,2,3,8\n20,,,,9\n"
    )
    (tmp_path / "long.csv").write_text(
        "t,marker,x [cm],y [cm],z [cm],load\n0,tip,0.1,0.2,0.3,7\n0.01,tip,0.15,0.2,0.3,8\n0.02,tip,,,,9\n"
    )
    wide, long = (rn.read_recording(tmp_path / f"{k}.csv") for k in ("wide", "long"))
    assert np.allclose(wide.markers, long.markers, equal_nan=True, rtol=1e-12)
    assert np.allclose(wide.t, [0, 0.01, 0.02]) and np.allclose(long.t, wide.t)
    assert wide.names == long.names == ("tip",)
    assert np.isnan(wide.markers[2]).all()
    assert list(wide.channels) == ["load"] and np.array_equal(long.channels["load"], [7, 8, 9])


def test_motion_capture_file(tmp_path):
    import c3d

    writer = c3d.Writer(point_rate=100.0)
    points = np.zeros((20, 2, 5), dtype=np.float32)
    points[:, 0, 0] = np.arange(20)
    points[:, 1, 2] = 250.0
    points[5, 1, 3] = -1.0
    for frame in points:
        writer.add_frames([(frame, np.zeros((0, 0)))])
    writer.set_point_labels(["tip", "base"])
    with warnings.catch_warnings(), (tmp_path / "walk.c3d").open("wb") as file:
        warnings.simplefilter("ignore")  # the writer misses analogue channels
        writer.write(file)
    rec = rn.read_recording(tmp_path / "walk.c3d")
    assert rec.names == ("tip", "base")
    assert np.allclose(rec.markers[:, 0, 0], 1e-3 * np.arange(20))  # millimetres, as the file says
    assert rec.markers[0, 1, 2] == pytest.approx(0.25)
    assert np.isnan(rec.markers[5, 1]).all()
    assert rec.rate == pytest.approx(100.0)


def test_set_metadata_and_groups(tmp_path):
    (tmp_path / "meta.json").write_text(json.dumps({"payload": 2, "groups": {"day1": ["a2.npz", "a10.npz"]}}))
    for name in ("a10", "a2", "b1"):
        recording(group="").save(tmp_path / f"{name}.npz")
    with np.load(tmp_path / "a2.npz") as file:  # without a group of its own
        np.savez(tmp_path / "a2.npz", **{k: file[k] for k in file.files if k != "group"})
    found = rn.read_recordings(tmp_path)
    assert [rec.name for rec in found] == ["a2", "a10", "b1"]
    assert found[0].group == "day1" and found[0].meta["payload"] == 2
    assert [rec.name for rec in rn.read_recordings(str(tmp_path / "a*.npz"))] == ["a2", "a10"]
    with pytest.raises(rn.RecordingError, match="no recording at"):
        rn.read_recordings(tmp_path / "c*.npz")


@pytest.mark.parametrize("suffix", ["npz", "csv", "nc"])
def test_trials_made_in_a_loop_are_groups_of_their_own(tmp_path, suffix):
    """Whatever they were called before they were written; a group that was given stays."""
    for k in range(3):
        recording(group="").save(tmp_path / f"trial_{k}.{suffix}")
    back = [rn.read_recording(tmp_path / f"trial_{k}.{suffix}") for k in range(3)]
    assert [rec.group for rec in back] == ["trial_0", "trial_1", "trial_2"]
    assert back[0].replace(name="other").group == "other"
    assert recording().replace(name="other").group == "monday"


def test_a_part_of_a_channel_has_no_times():
    rpm = recording().channels["rpm"]
    assert float(rpm[2:5].max()) == float(rpm[4])
    with pytest.raises(rn.RecordingError, match="a part of a channel has no times"):
        rpm[2:5](0.03)


@pytest.mark.parametrize(
    "changes", [{"attrs": {"file": "a.txt"}}, {"attrs": {"rpm": 1.0}, "channels": {"rpm": np.zeros(12)}}]
)
def test_names_that_numpy_cannot_keep_are_refused(tmp_path, changes):
    """Arguments of its own, and one name of an attribute and a channel."""
    with pytest.raises(rn.OutputError, match="cannot be named"):
        recording(**changes).save(tmp_path / "trial.npz")


def test_views():
    rec = recording()
    assert rec.free.tolist() == [1, 2]
    assert np.isnan(rec.trusted[0, 2]).all() and np.isfinite(rec.markers[0, 2]).all()
    assert rec.marker("tip") == 2
    with pytest.raises(rn.RecordingError, match="it has base, middle, tip"):
        rec.marker("tipp")
    part = rec.cut(0.03, 0.08)
    assert (part.t[0], len(part.t), part.channels["rpm"][0]) == (0.03, 6, rec.channels["rpm"][3])


def test_first_frames_go_round_an_outlier():
    t = 0.01 * np.arange(20)
    x = (np.array([0.1, 0.0, 0.2]) + t[:, None, None] * np.array([1.0, -2.0, 0.5])).repeat(2, axis=1)
    x[1, 1] += 0.02
    suspect = np.zeros((20, 2), dtype=bool)
    suspect[1, 1] = True
    position, velocity = rn.Recording(t, x, suspect=suspect).first_frames()
    assert np.allclose(position, [0.1, 0.0, 0.2]) and np.allclose(velocity, [1.0, -2.0, 0.5])


def saved(**arrays):
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


GOOD = {"t": 0.01 * np.arange(5), "markers": np.zeros((5, 2, 3))}
BROKEN = {
    "pickle.npz": (saved(**GOOD, who=np.array([{"a": 1}, None], dtype=object)), "'who' holds Python objects"),
    "torn.npz": (saved(**GOOD)[:200], "cannot read"),
    "text.npz": (b"hello", "cannot read"),
    "bare.npz": (saved(t=GOOD["t"]), "lacks markers"),
    "shape.npz": (saved(t=GOOD["t"], markers=np.zeros((5, 6))), r"\(frames, markers, 3\)"),
    "rows.npz": (saved(t=GOOD["t"], markers=np.zeros((4, 2, 3))), "4 frames and 't' 5"),
    "back.npz": (saved(t=GOOD["t"][::-1], markers=GOOD["markers"]), "times must increase"),
    "nan.npz": (saved(t=np.full(5, np.nan), markers=GOOD["markers"]), "not finite"),
    "blind.npz": (saved(t=GOOD["t"], markers=np.full((5, 2, 3), np.nan)), "never sees marker 0, 1"),
    "mm.npz": (saved(t=GOOD["t"], markers=np.linspace(0, 972, 30).reshape(5, 2, 3)), "units='mm'"),
    "edge.npz": (saved(**GOOD, edges=np.array([[0, 7]])), "names marker 7"),
    "held.npz": (saved(**GOOD, prescribed=np.array([-1])), "'prescribed'"),
    "flags.npz": (saved(**GOOD, suspect=np.zeros(5)), "'suspect'"),
    "names.npz": (saved(**GOOD, names=np.array(["a", "a"])), "all different"),
    "words.csv": (b"t,a.x,a.y,a.z\n0,1,2,three\n1,1,1,1\n2,1,1,1\n", "'three', which is no number"),
    "axis.csv": (b"t,a.x,a.y\n0,1,2\n1,1,1\n2,1,1\n", "no column 'a.z'"),
    "untimed.csv": (b"a.x,a.y,a.z\n0,1,2\n", "no column 't'"),
    "twice.csv": (b"t,marker,x,y,z\n0,a,0,0,0\n0,a,0,0,0\n1,a,0,0,0\n2,a,0,0,0\n", "twice"),
    "empty.csv": (b"", "cannot read"),
    "feet.csv": (b"t,a.x [ft],a.y,a.z\n0,1,2,3\n1,1,1,1\n2,1,1,1\n", r"is in \[ft\]"),
    "bytes.csv": (b"\xff\xfe\x00\x01", "cannot read"),
    "fake.nc": (b"CDF nonsense", "cannot read"),
    "fake.c3d": (b"\x02P" + bytes(600), "cannot read|no frames"),
    "trial.pkl": (b"cos\nsystem\n(S'true'\ntR.", "unknown suffix"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_files_are_refused_with_a_reason(tmp_path, name):
    content, message = BROKEN[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(rn.RecordingError, match=message) as caught:
        rn.read_recording(tmp_path / name)
    assert name in str(caught.value)


def test_times_in_milliseconds_are_doubted(tmp_path):
    slow = rn.Recording(100.0 / 3.0 * np.arange(5), np.zeros((5, 1, 3)))
    with pytest.warns(rn.PlausibilityWarning, match="film.npz' are 33.3 s apart; .* divide them by 1000"):
        rn.read_recording(slow.save(tmp_path / "film.npz"))


def test_what_a_recording_lacks_is_named_with_what_it_has():
    rec = rn.Recording(**GOOD, name="film", attrs={"payload_kg": 0.1}, channels={"rpm": np.zeros(5)})
    with pytest.raises(rn.RodnetError, match="recording 'film' called 'payload'; did you mean 'payload_kg'"):
        rec.attrs["payload"]
    with pytest.raises(rn.RodnetError, match="channel of recording 'film' called 'speed'; there are rpm"):
        rec.channels["speed"]
    assert pickle.loads(pickle.dumps(rec)).attrs == dataclasses.asdict(rec)["attrs"] == {"payload_kg": 0.1}


def test_a_file_that_claims_more_than_memory_is_refused(tmp_path, monkeypatch):
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**14,)})
    with zipfile.ZipFile(tmp_path / "claim.npz", "w") as archive:
        archive.writestr("t.npy", header.getvalue())
    with pytest.raises(rn.RecordingError, match="cannot read"):
        rn.read_recording(tmp_path / "claim.npz")
    recording().save(tmp_path / "large.npz")
    monkeypatch.setattr("rodnet.recordings.npz_file.LARGEST_FILE", 1000)
    with pytest.raises(rn.RecordingError, match="unpacks to"):
        rn.read_recording(tmp_path / "large.npz")


def test_units_by_hand(tmp_path):
    (tmp_path / "mm.npz").write_bytes(saved(t=GOOD["t"], markers=np.linspace(0, 972, 30).reshape(5, 2, 3)))
    assert np.nanmax(rn.read_recording(tmp_path / "mm.npz", units="mm").markers) == pytest.approx(0.972)
    (tmp_path / "mm.csv").write_text(
        "t,tip.x [mm],tip.y [mm],tip.z [mm]\n" + "".join(f"{k},100,{k},0\n" for k in range(5))
    )
    (tmp_path / "long.csv").write_text(
        "t,marker,x [mm],y [mm],z [mm]\n" + "".join(f"{k},a,100,{k},0\n" for k in range(5))
    )
    for file in ("mm.csv", "long.csv"):  # what is given by hand counts, not what the heading says
        for units, metres in ((None, 0.1), ("mm", 0.1), ("cm", 1.0)):
            assert rn.read_recording(tmp_path / file, units=units).markers[0, 0, 0] == pytest.approx(metres)
    with pytest.raises(rn.RecordingError, match="not one of"):
        rn.read_recording(tmp_path / "mm.npz", units="feet")
    with pytest.raises(rn.RecordingError, match="no recording"):
        rn.read_recording(tmp_path / "absent.npz")
