"""The blind benchmark: two codes agree where nothing is missing, effects do something, scores say what is so."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rodnet as rn
from benchmarks.blind import drives as driving
from benchmarks.blind import instruments, judge, plan, robots
from benchmarks.blind.effects import BANK, EFFECTS, FINER, OUTSIDE, in_engine_terms
from benchmarks.blind.generate import PLANNED, Setting, _kept, generate, left_over, nominal_file, setting

T = np.arange(21) / 25.0
TIPS = {
    "shaken": [(0, 0.5), (0, 1.0)],
    "spatial": [(0, 0.5), (0, 1.0)],
    "branched": [(0, 1.0), (1, 1.0), (2, 1.0)],
    "spun": [(0, 0.5), (0, 1.0)],
    "tendon": [(0, 0.5), (0, 1.0)],
}
HELD = ("shaken", "spatial", "branched")


def drawn(family: str, seed: int = 5):
    """A machine and its drives."""
    rng = np.random.default_rng(seed)
    return robots.machine(family, rng), driving.drives(family, rng)


def test_sets_of_two_seeds_in_one_folder_do_not_share_machines(tmp_path):
    """An effect is sized against its own machine without it: another's made an effect of 5e-6 look like 70 sigma."""
    specs = [one for one in plan.plan("first", "smoke") if one.kind == "effect"]
    files = {nominal_file(seed, specs[0], tmp_path, 30) for seed in ("first", "second", "first")}
    assert len(files) == 2


@pytest.mark.parametrize("family", HELD)
def test_two_theories_agree_where_nothing_is_missing(family):
    """Elastica's explicit Cosserat rods and rodnet's implicit Kirchhoff rods, of unlike meshes, move alike."""
    elastica = pytest.importorskip("benchmarks.blind.elastica", reason="needs PyElastica")
    from benchmarks.blind import finer

    machine, drives = drawn(family)
    theirs = elastica.converged(machine, drives[0], {}, T, TIPS[family], elements=24)
    ours = finer.simulate(machine, drives[0], {}, T, TIPS[family], elements=40)
    moved = np.abs(theirs - theirs[0]).max()
    assert moved > 0.01
    assert np.abs(theirs - ours).max() < 0.015 * moved


def test_a_couple_between_elements_turns_the_whole_rod_by_nothing():
    """What bends a rod that is twisted, too, acts on one element as on the next, the other way, to second order."""
    pytest.importorskip("benchmarks.blind.elastica", reason="needs PyElastica")
    import elastica as ea
    from scipy.spatial.transform import Rotation

    from benchmarks.blind.forces import Hardening

    def left(count, length=0.3):
        h = length / count
        turns = Rotation.from_rotvec(np.outer((np.arange(count) + 0.5) * h, [9.0, -6.0, 12.0])).as_matrix()
        points = np.zeros((3, count + 1))
        points[:, 1:] = np.cumsum(h * turns[:, :, 2].T, axis=1)
        rod = ea.CosseratRod.straight_rod(
            count, points[:, 0].copy(), turns[0, :, 2], turns[0, :, 0], length, 5e-3, 1e3, youngs_modulus=1e6,
            shear_modulus=3e5, position=points, directors=np.ascontiguousarray(turns.transpose(2, 1, 0)),
        )  # fmt: skip
        rod.compute_internal_forces_and_torques(0.0)
        rod.external_torques[:] = 0.0
        Hardening(1.0, 1e-2, np.zeros_like(rod.kappa)).apply_torques(rod)
        whole = np.einsum("ijk,ik->j", rod.director_collection, rod.external_torques)
        return np.linalg.norm(whole) / np.abs(rod.external_torques).max()

    assert left(40) < 2e-3 and 3.5 < left(20) / left(40) < 4.5


@pytest.mark.parametrize("id", [e.id for e in (*BANK, *OUTSIDE) if e.acts == "rods"])
def test_every_effect_of_elastica_vanishes_with_its_strength_and_shows_with_it(id):
    """At strength zero the rods move as without it, bit for bit; at the first guess they don't."""
    elastica = pytest.importorskip("benchmarks.blind.elastica", reason="needs PyElastica")
    effect = EFFECTS[id]
    machine, drives = drawn(effect.families[0])
    values = effect.draw(np.random.default_rng(0), machine)
    if "onset" in values:
        values["onset"] = 0.2
    if id in ("contact", "obstacle"):
        values["height"] = -0.01  # the rods begin in it
    if id == "rope":
        values["length"] = 0.05  # it is taut from the beginning
    t, tips = T[:12], TIPS[effect.families[0]]

    def run(**changed):
        effects = {id: in_engine_terms(id, values | changed)}
        return elastica.simulate(machine, drives[3], effects, t, tips, elements=10, start=-0.95)

    without = elastica.simulate(machine, drives[3], {}, t, tips, elements=10, start=-0.95)
    np.testing.assert_array_equal(run(**{effect.strength: 0.0}), without)
    assert np.abs(run() - without).max() > 1e-7


@pytest.mark.parametrize("id", [e.id for e in FINER])
def test_every_effect_of_the_finer_engine_shows(id):
    """It can be simulated, and changes what is seen."""
    from benchmarks.blind import finer

    effect = EFFECTS[id]
    machine, drives = drawn(effect.families[0])
    tips = TIPS[effect.families[0]]
    seen = [
        finer.simulate(machine, drives[3], effects, T[:10], tips, elements=12, start=-0.05)
        for effects in ({}, {id: effect.draw(np.random.default_rng(0), machine)})
    ]
    assert np.abs(seen[1] - seen[0]).max() > 1e-7


def test_local_effects_are_local():
    """A soft spot at the root's end leaves the bending beyond it as it is: its parameters are read as meant."""
    elastica = pytest.importorskip("benchmarks.blind.elastica", reason="needs PyElastica")
    import elastica as ea

    machine, _ = drawn("shaken")
    arm = machine.arms[0]
    rod = ea.CosseratRod.straight_rod(
        20, arm.root, arm.direction, arm.normal, arm.length, machine.radius, machine.density,
        youngs_modulus=machine.young, shear_modulus=machine.young / 3.0,
    )  # fmt: skip
    before = rod.bend_matrix.copy()
    nodes = arm.length * np.arange(21) / 20
    spot = {"stiffness-defect": {"loss": 0.4, "place": 0.3, "width": 0.06}}
    elastica._material(rod, machine, arm, spot, nodes, own=True)
    compliance = before[0, 0] / rod.bend_matrix[0, 0]
    cells = nodes[1:-1] / arm.length
    assert (compliance[np.abs(cells - 0.3) > 0.06 + 0.025] == 1.0).all()
    assert compliance.max() == pytest.approx(1.0 / 0.6)
    # what the spot adds to the bending of the whole does not depend on the mesh
    assert (compliance - 1.0).sum() / 20 == pytest.approx(2 * 0.06 * (1.0 / 0.6 - 1.0))


def test_noise_is_as_large_and_as_slow_as_declared():
    """Variance sigma^2, autocorrelation share * exp(-lag / time), and so many samples lost."""
    camera = instruments.Instrument(1e-3, slow=0.5, time=0.4, lost=0.05)
    noise = camera.see(np.zeros((4000, 20, 3)), 0.04, np.random.default_rng(0))
    assert np.nanstd(noise) == pytest.approx(1e-3, rel=0.03)
    for lag in (1, 5):
        expected = 0.5e-6 * np.exp(-0.04 * lag / 0.4)
        assert np.nanmean(noise[lag:] * noise[:-lag]) == pytest.approx(expected, rel=0.1)
    assert np.isnan(noise).all(axis=2).mean() == pytest.approx(0.05, abs=0.015)
    assert np.isfinite(noise[0]).all()


def test_where_a_machine_is_held_otherwise_than_drawn_shows_at_rest():
    """Beside its place by the offset, turned by the angle; and markers beside the axis by theirs, across it."""
    elastica = pytest.importorskip("benchmarks.blind.elastica", reason="needs PyElastica")
    machine, _ = drawn("spatial")
    zero = np.zeros((1, 3))
    still = driving.Drive(zero, zero, np.ones(1), np.zeros((1, 2)))

    def seen(**effects):
        given = {id.replace("_", "-"): values for id, values in effects.items()}
        return elastica.simulate(machine, still, given, T[:2], TIPS["spatial"], elements=12, start=0.0)[0]

    plain = seen()
    np.testing.assert_allclose(
        seen(grasp_offset={"shift": [1e-3, 2e-3, 3e-3]}) - plain, [[1e-3, 2e-3, 3e-3]] * 2
    )
    R = robots.rotations(np.array([[0.0, 0.1, 0.0]]))[0]
    turned = seen(root_direction={"angle": 0.1, "axis": [0.0, 1.0, 0.0]})
    np.testing.assert_allclose(turned, plain @ R.T, atol=1e-12)
    off = seen(marker_offset={"offset": [3e-3, 4e-3]}) - plain
    np.testing.assert_allclose(np.linalg.norm(off, axis=1), 5e-3, rtol=1e-3)
    ends = machine.arms[0].shape(machine.arms[0].length * np.array([0.0, 0.499, 0.501, 0.999, 1.0]))[0]
    along = np.array([ends[2] - ends[1], ends[4] - ends[3]])
    cosine = np.sum(off * along, axis=1) / (5e-3 * np.linalg.norm(along, axis=1))
    assert np.abs(cosine).max() < 0.05  # of the element's direction


def test_a_medium_jams_where_rods_are_near_and_not_at_their_joint():
    """The end of a rod that touches another, and its end alone; as drawn it is free."""
    pytest.importorskip("elastica", reason="needs PyElastica")
    from types import SimpleNamespace

    from benchmarks.blind.forces import Spacing

    machine, _ = drawn("branched")
    arcs = [np.linspace(0.0, arm.length, 21) for arm in machine.arms]
    rods = [
        SimpleNamespace(position_collection=arm.shape(s)[0].T.copy())
        for arm, s in zip(machine.arms, arcs, strict=True)
    ]
    jam = {"gain": 3.0, "spacing": 0.1 * machine.arms[0].length}
    before = Spacing(machine, rods, arcs, 1, jam).factor()
    assert before[0] == before[1] == before[-1] == 1.0
    rods[2].position_collection[:, -1] = rods[1].position_collection[:, -1]
    after = Spacing(machine, rods, arcs, 1, jam).factor()
    assert after[-1] == 4.0
    np.testing.assert_array_equal(after[:10], before[:10])


def test_a_drive_begins_at_rest_where_the_machine_was_drawn():
    """Nothing is displaced at t = 0, and velocities vanish there."""
    for family in HELD:
        for drive in drawn(family)[1]:
            t = np.array([-1e-4, 0.0, 1e-4])
            for values in drive.motion(t):
                assert np.abs(values).max() < 1e-9


def test_a_late_gripper_follows_a_steady_tow_by_its_time_constant():
    """First-order lag: behind by tow * lag once it moves steadily, and the command itself without lag."""
    zero = np.zeros((1, 3))
    tow = driving.Drive(zero, zero, np.ones(1), np.zeros((1, 2)), np.array([0.05, 0.0, 0.01]))
    t = np.array([2.0, 3.0])
    behind = tow.motion(t)[0] - replace(tow, lag=0.1).motion(t)[0]
    np.testing.assert_allclose(behind, 0.1 * tow.tow * np.ones((2, 1)), rtol=1e-5)
    np.testing.assert_allclose(replace(tow, lag=1e-6).motion(t)[0], tow.motion(t)[0], rtol=1e-4)


@pytest.mark.parametrize("family", HELD)
def test_the_menu_of_next_trials_goes_beyond_those_that_there_are(family):
    """Larger moves, and a turn so far that a weight pulls across what it pulled along; still from rest."""
    t = np.linspace(0.0, 4.0, 401)

    def largest(drives):
        moved = [[np.linalg.norm(v, axis=1).max() for v in drive.motion(t)] for drive in drives]
        return np.max(moved, axis=0)

    there = drawn(family)[1]
    menu = driving.menu(family, np.random.default_rng(7), PLANNED)
    assert len(menu) == PLANNED
    assert (largest(menu) > 1.3 * largest(there)).all()
    slow_and_far = menu[5].motion(t)[1]
    assert np.linalg.norm(slow_and_far, axis=1).max() > 0.9
    assert np.abs(np.gradient(slow_and_far, t, axis=0)).max() < 5.0
    for drive in menu:
        assert np.abs(np.concatenate(drive.motion(np.zeros(1)))).max() < 1e-9


def test_what_a_refit_absorbs_does_not_count():
    """A change along what the nominal parameters can do leaves nothing, nor what only lost markers would see.

    Nor does one in the last trial, which is held out, count.
    """
    rng = np.random.default_rng(0)
    whole = rng.normal(size=(3, 3, 5, 4, 3))
    one, two, across = whole[:, :-1]
    kept = [0, 2]
    A = np.stack([v[:, :, kept].ravel() for v in (one, two)], axis=1)
    seen = across[:, :, kept].ravel()
    left = seen - A @ np.linalg.lstsq(A, seen, rcond=None)[0]
    one, two, across = whole
    found = left_over(3.0 * one - two + across, [one, two], kept)
    assert found == pytest.approx(np.sqrt(np.mean(left**2)))
    across[:-1, :, kept] = 0.0
    assert left_over(one + across, [one, two], kept) < 1e-12


@pytest.mark.parametrize(
    ("id", "moved"), [("misplaced-marker", {"along": 0.02}), ("slipping-marker", {"speed": 0.01})]
)
def test_a_marker_elsewhere_is_on_its_rod(id, moved):
    """What it shows is what one shows that sits there."""
    from benchmarks.blind.generate import Setting

    machine, drives = drawn("spatial")
    length = machine.arms[0].length
    places = [(0, 0.25), (0, 0.5), (0, 1.0)]
    there = Setting(machine, drives[3:4], T, places, "finer")
    (seen,) = there.simulate({id: {**moved, "marker": 1}}, 6)
    away = 0.02 if "along" in moved else 0.01 * T[-1]
    (true,) = Setting(machine, drives[3:4], T, [(0, 0.5 + away / length)], "finer").simulate({}, 6)
    (plain,) = there.simulate({}, 6)
    assert np.abs(seen[-1, 1] - true[-1, 0]).max() < 2e-4  # rods of twelve edges
    assert np.abs(seen[-1, 1] - plain[-1, 1]).max() > 5.0 * np.abs(seen[-1, 1] - true[-1, 0]).max()
    np.testing.assert_array_equal(seen[:, [0, 2]], plain[:, [0, 2]])


def test_a_plan_is_drawn_from_its_seed_and_holds_what_is_demanded():
    """The same seed, the same set; 66 effects (some come out too small), 60 controls of each kind, 30 outside."""
    specs = plan.plan("a")
    assert specs == plan.plan("a") != plan.plan("b")
    assert len({s.name for s in specs}) == len(specs)
    kinds = [s.kind for s in specs]
    assert [kinds.count(k) for k in ("effect", "control", "outside")] == [66, 180, 30]
    effects = [s for s in specs if s.kind == "effect"]
    modes = {}
    for s in effects:
        modes.setdefault(s.effects[0], set()).add(s.concealed)
    assert len(modes) >= 20
    assert sum(found == set(plan.CONCEALED) for found in modes.values()) >= 10
    assert np.mean([s.family != "shaken" for s in specs]) > 1 / 3
    for kind in plan.CONTROLS:
        assert len({(s.family, s.machine) for s in specs if s.effects == (kind,)}) >= 20
    for s in specs:
        assert all(s.family in EFFECTS[id].families for id in s.effects if s.kind != "control")
        assert not any(word in s.name for word in (s.kind, s.concealed, *s.effects))


def test_trials_that_are_alike_are_of_one_regime_and_seen_by_one_marker():
    """Beside a menu of others; a full set stays what it was."""
    specs = plan.plan("a", "alike")
    assert len(specs) == plan.SETS["alike"].alike and {s.kind for s in specs} == {"alike"}
    assert not {s.name for s in specs} & {s.name for s in plan.plan("a")}
    for spec in specs:
        there = setting("a", spec)
        swings = [
            d.turn.ravel() @ d.turn.ravel() for d in there.drives
        ]  # amplitudes of a regime differ by half
        assert max(swings) < 2.3 * min(swings)
        assert len({tuple(d.frequency) for d in there.drives}) == 5
        kept = _kept(spec, {}, there.places)
        assert [there.places[k] for k in kept] == [(0, 1.0)] and not spec.slow
    marked = replace(specs[0], effects=("slipping-marker",))
    assert _kept(marked, {"slipping-marker": {"marker": 3}}, setting("a", marked).places) == [3, 7]


def test_shares_make_up_the_set():
    """Each case in one of them, controls of each kind in all; a share that is none is refused."""
    specs = plan.plan("a")
    parts = [plan.part(specs, f"{k}/10") for k in range(1, 11)]
    assert sorted(s.name for p in parts for s in p) == sorted(s.name for s in specs)
    for p in parts:
        assert [sum(s.effects == (kind,) for s in p) for kind in plan.CONTROLS] == [6, 6, 6]
        assert sum(s.kind == "outside" for s in p) == 3
    effects = [plan.part(specs, f"effect:{k}/4") for k in range(1, 5)]
    assert sorted(s.name for p in effects for s in p) == sorted(s.name for s in specs if s.kind == "effect")
    assert max(len(p) for p in effects) - min(len(p) for p in effects) <= 1
    for wrong in ("0/10", "11/10", "1", "a/b", "effects:1/4"):
        with pytest.raises(ValueError, match="K/N"):
            plan.part(specs, wrong)


def test_a_case_is_what_rodnet_reads_and_keeps_its_truth_apart(tmp_path, monkeypatch):
    """Recordings can be inspected, the case builds their robots, and neither says what is in them."""
    spec = next(s for s in plan.plan("t", "small") if s.kind == "control")

    def still(self, effects, elements, machine=None):
        at = [
            self.machine.arms[k].shape(np.array([0.0, s * self.machine.arms[k].length]))[0][1]
            for k, s in self.places
        ]
        return np.broadcast_to(np.array(at), (len(self.drives), len(self.t), len(at), 3))

    monkeypatch.setattr(Setting, "simulate", still)
    generate("t", spec, tmp_path)
    files = sorted((tmp_path / "data" / spec.name).glob("*.npz"))
    recordings = rn.read_recordings([str(f) for f in files])
    assert len(recordings) == plan.TRIALS
    case = rn.load_case(files[0].parent / "CASE.py")
    for rec in recordings:
        robot = case.robot(rec)
        case.observations(rec, robot)
        assert not {"effects", "kind", "truth"} & {*rec.attrs, *rec.channels, *rec.meta}
    assert rn.inspect(recordings).files
    assert (tmp_path / "truth" / f"{spec.name}.json").exists()
    assert len(case.drives(recordings[0])) == PLANNED


def test_a_root_that_gives_is_found_in_a_foreign_recording():
    """Recorded of PyElastica's rods: the case without it leaves many sigma on a held-out trial, with it the noise."""
    folder = Path(__file__).parent / "data" / "blind" / "give"
    truth = json.loads((folder.parent / "give.json").read_text())
    noise = rn.NoiseModel(white=truth["sigma_m"])
    files = [str(folder / f"trial_{k}.npz") for k in (1, 2, 4)]
    trials = [rec.cut(0.0, 1.0).replace(noise=noise) for rec in rn.read_recordings(files)]
    found = rn.diagnose(
        rn.load_case(folder / "CASE.py"), trials[:2], hold_out=trials[2:], candidates=["root-compliance"], workers=0
    ).to_dict()  # fmt: skip
    judged = judge.judge(truth, found)
    assert found["verdict"] in ("class", "surrogate")  # so few trials are not enough for a name
    assert judged["true cause in the stated class"] and judged["80 % of held-out excess removed"]
    (term,) = found["terms"]
    length = term["parameters"]["root-compliance@grip.length"]
    assert length["low"] <= truth["truth"]["root-compliance"]["length"] <= length["high"]
    assert length["high"] - length["low"] < 0.15 * length["value"]
    assert found["placebo_after"] > 1.5 * found["error_after"]
