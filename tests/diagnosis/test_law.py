"""What no candidate explains: it is not named, a law is drafted from it, and the law runs like any other term."""

import re

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.crossval import cross_gains, left_out, reduced
from rodnet.diagnosis.forces import force_columns, library_of, searched_of
from rodnet.diagnosis.law import _choices, draft
from rodnet.diagnosis.library import CREEP, OF_THE_SCENE, Piece, crowds, law_of, pieces
from rodnet.diagnosis.measures import Measures
from rodnet.diagnosis.repaired import repaired_robot, with_effects, write
from rodnet.diagnosis.workbench import Workbench
from rodnet.inference.evaluate import evaluate
from rodnet.report.law_words import parts_in_words
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken
from tests.diagnosis.test_page import assert_tidy, text_of

# a spring to a place 50 mm beside, on one part of the body
TETHER = {"kxx": -4.0, "kyy": -4.0, "kzz": -4.0, "gx": 1.3, "gy": 0.2}


def record(k: int, share: float = 1.0) -> rn.Recording:
    """A trial of a rod that is tethered from 60 to 70 % of its length."""
    true = shaken.robot(shaken.drive(k), 2 * shaken.EDGES)
    springs = {path: share * value for path, value in TETHER.items()}
    tether = rn.LocalLaw(on=[f"rod:{j}-{j + 1}" for j in (15, 16)], name="tether", **springs)
    true = true.with_terms(tether)
    traj = rn.Simulation(true, dt=shaken.DT / 2, stepper="sdirk2").run(shaken.DURATION)
    t = np.arange(0.0, shaken.DURATION, 1.0 / shaken.RATE)
    seen = rn.observe([rn.Markers(true, shaken.POINTS)], traj, t)[0]
    seen = seen + shaken.SIGMA * np.random.default_rng(k).standard_normal(seen.shape)
    return rn.Recording(t, seen, names=[f"m{i}" for i in range(4)], name=f"trial{k}", attrs=shaken.drive(k))


@pytest.fixture(scope="module")
def trials():
    return [record(k) for k in range(4)]


@pytest.fixture(scope="module")
def found(trials):
    return rn.diagnose(
        shaken.CASE, trials[:3], hold_out=trials[3:], candidates=["gravity"], noise=shaken.SIGMA, workers=0
    )


@pytest.fixture(scope="module")
def bench(trials):
    return Workbench.of(shaken.CASE, trials[:2], Serial(), shaken.SIGMA)


@pytest.mark.slow
def test_an_effect_outside_the_bank_is_not_named(found):
    assert found.verdict in ("surrogate", "partial", "class")  # a load beside it was accepted
    assert found.findings[-1].id == "local-law"
    assert found.findings[-1].status == "surrogate"


@pytest.mark.slow
def test_the_law_removes_most_of_the_error_on_trials_not_seen(found):
    assert found.explained_fraction > 0.5
    assert found.left.excess < found.remainder.excess


@pytest.mark.slow
def test_the_page_tells_its_parts_in_words_with_units(found, tmp_path):
    text = text_of(found.page(), tmp_path / "report.html")
    assert_tidy(text)
    ranks = text.split("How the explanations rank:")[1].split("##")[0]
    assert "| < 1e-9 |" in re.sub(r"[\s|]+\|", " |", ranks)
    words = parts_in_words(found.law.pieces)
    assert set(found.law.candidate.paths) <= set(words)
    for path in found.law.candidate.strength:
        assert words[path] in text
    assert f"{len(found.law.candidate.strength)} parts" in text
    # for as long as the recording
    seconds = found.recordings[0].duration
    assert f"rodnet run repaired.toml --duration {seconds:.4g} --dt {shaken.DT:g} --stepper sdirk2" in text


@pytest.mark.slow
def test_a_law_that_trials_not_seen_contradict_is_not_in_the_repaired_model(trials):
    """The tether pulls the other way in the trial that is held out: weight, a law beside it and one alone fail."""
    found = rn.diagnose(
        shaken.CASE,
        trials[:2],
        hold_out=[record(3, -1.0)],
        candidates=["gravity"],
        noise=shaken.SIGMA,
        workers=0,
    )
    assert found.law is not None and not found.law.judgement.accepted
    assert "held out no better" in found.law.judgement.reasons[0]
    assert "local-law" not in [one.id for one in found.findings]
    assert not any(path.startswith("local-law") for path in found.model.values)
    assert found.law.alone_after > found.held.before.error
    assert found.openings == len(found.held.chain) + 2


def test_a_rod_that_is_not_round_is_told_by_its_section():
    """One that bends more easily one way than the other: no force on parts of the body does that."""
    trials = []
    for k in range(3):
        true = shaken.robot(shaken.drive(k), 2 * shaken.EDGES).with_terms(rn.SectionStiffness(first=0.8))
        traj = rn.Simulation(true, dt=shaken.DT / 2, stepper="sdirk2").run(shaken.DURATION)
        t = np.arange(0.0, shaken.DURATION, 1.0 / shaken.RATE)
        seen = rn.observe([rn.Markers(true, shaken.POINTS)], traj, t)[0]
        seen = seen + shaken.SIGMA * np.random.default_rng(k).standard_normal(seen.shape)
        trials.append(rn.Recording(t, seen, names=list("abcd"), name=f"flat{k}", attrs=shaken.drive(k)))
    flat = Workbench.of(shaken.CASE, trials, Serial(), shaken.SIGMA)
    model = flat.fit()
    found = draft(flat, model, force_columns(flat, model, library_of(flat)), 0.0, lambda text: None)
    assert found is not None and found.judgement.accepted
    assert found.pieces[-1].kind == "section"
    count = found.refit.fitted.samples
    assert found.refit.fitted.deviance - count < 0.2 * (model.deviance - count)


def test_a_law_that_is_the_same_all_along_is_told_once():
    """Not for each third of the rod; to first order something small may seem to be beside it."""
    trials = []
    for k in range(3):  # on the mesh of the model: nothing else is wrong
        plain = shaken.robot(shaken.drive(k))
        creep = CREEP * Measures.of(plain, shaken.DURATION).speed
        true = plain.with_terms(rn.LocalLaw(on="rod", rate_free=-0.15, creep=creep))
        trials.append(shaken.record(k, change=lambda _, true=true: true))
    alike = Workbench.of(shaken.CASE, trials, Serial(), shaken.SIGMA)
    model = alike.fit()
    found = draft(alike, model, force_columns(alike, model, library_of(alike)), 0.0, lambda text: None)
    assert found is not None and found.judgement.accepted
    parts = found.candidate.strength
    assert [path for path in parts if path.endswith(".rate_free")] == ["law-body.rate_free"]
    assert len(parts) <= 2
    assert found.refit.fitted.values["law-body.rate_free"] == pytest.approx(-0.15, rel=0.2)


def stirred(x, t):
    """A shear that pulses."""
    return np.stack([1.2 * (1.0 + np.sin(3.4 * np.pi * t)) * x[:, 2], 0.0 * x[:, 0], 0.0 * x[:, 0]], axis=1)


@pytest.mark.slow
def test_a_medium_that_is_stirred_is_told_by_a_current_that_pulses(tmp_path):
    trials = []
    for k in range(4):
        attrs = {**shaken.drive(k), "lift": 3.0}
        true = shaken.robot(attrs, 2 * shaken.EDGES)
        drag = rn.ResistiveForce(eta_t=1.0, eta_n=2.0, flow=stirred)
        true = rn.Robot(true.graph, [drag if isinstance(t, rn.ResistiveForce) else t for t in true.terms])
        traj = rn.Simulation(true, dt=shaken.DT / 2, stepper="sdirk2").run(shaken.DURATION)
        t = np.arange(0.0, shaken.DURATION, 1.0 / shaken.RATE)
        seen = rn.observe([rn.Markers(true, shaken.POINTS)], traj, t)[0]
        seen = seen + shaken.SIGMA * np.random.default_rng(k).standard_normal(seen.shape)
        trials.append(rn.Recording(t, seen, names=list("abcd"), name=f"stirred{k}", attrs=attrs))
    found = rn.diagnose(
        shaken.CASE, trials[:3], hold_out=trials[3:], candidates=["yield"], noise=shaken.SIGMA, workers=0
    )
    assert found.findings[-1].id == "local-law"
    (path,) = (p for p in found.model.values if p.endswith(".frequency"))
    assert found.model.values[path] == pytest.approx(1.7, rel=0.1)
    assert found.explained_fraction > 0.8
    write(found, tmp_path)
    robot = rn.Robot.load(tmp_path / "repaired.toml")
    assert robot.parameters[path].value == found.model.values[path]


@pytest.mark.slow
def test_the_law_is_saved_and_runs(found, trials, tmp_path):
    write(found, tmp_path)
    robot = rn.Robot.load(tmp_path / "repaired.toml")
    law = [t for t in robot.terms if t.name.startswith("law-")]
    assert law
    ours = rn.Simulation(robot, dt=shaken.DT, stepper="sdirk2").run(0.2).x[-1]
    here = rn.Simulation(repaired_robot(found), dt=shaken.DT, stepper="sdirk2").run(0.2).x[-1]
    np.testing.assert_allclose(ours, here, atol=1e-5)  # its motion is a spline in the file
    plain = evaluate(shaken.CASE, trials[3:], workers=0).total()["metric"]
    with_law = evaluate(shaken.CASE, trials[3:], model=tmp_path, workers=0).total()["metric"]
    assert with_law < 0.7 * plain


def drafted(*terms):
    """What is drafted where terms act that the model lacks, and the model, in three trials that go far."""
    trials = []
    for k in range(3):
        attrs = {**shaken.drive(k), "lift": 3.0}
        true = shaken.robot(attrs, 2 * shaken.EDGES).with_terms(*terms)
        traj = rn.Simulation(true, dt=shaken.DT / 2, stepper="sdirk2").run(shaken.DURATION)
        t = np.arange(0.0, shaken.DURATION, 1.0 / shaken.RATE)
        seen = rn.observe([rn.Markers(true, shaken.POINTS)], traj, t)[0]
        seen = seen + shaken.SIGMA * np.random.default_rng(k).standard_normal(seen.shape)
        trials.append(rn.Recording(t, seen, names=list("abcd"), name=f"trial{k}", attrs=attrs))
    bench = Workbench.of(shaken.CASE, trials, Serial(), shaken.SIGMA)
    model = bench.fit()
    found = draft(bench, model, force_columns(bench, model, library_of(bench)), 0.0, lambda text: None)
    assert found is not None and found.judgement.accepted
    return found, model


@pytest.mark.slow
def test_a_medium_that_turns_in_one_place_is_told_by_an_eddy():
    """Where it is, how wide and how fast, though the library's patches are elsewhere."""
    found, model = drafted(rn.LocalFlow(axz=0.9, azx=-0.9, x=0.4, z=0.05, width=0.12))
    values, (name,) = found.refit.fitted.values, {p.name for p in found.pieces if p.kind == "eddy"}
    assert values[f"{name}.azx"] < -0.5
    assert values[f"{name}.x"] == pytest.approx(0.4, abs=0.03)
    assert values[f"{name}.width"] == pytest.approx(0.12, abs=0.03)
    count = found.refit.fitted.samples
    assert found.refit.fitted.deviance - count < 0.2 * (model.deviance - count)


class Mud(rn.DragModel):
    """A ball that resists, with an edge."""

    middle, radius = np.array([0.42, 0.0, 0.06]), 0.08

    def force(self, site, p):
        away = np.linalg.norm(site.x - self.middle, axis=1, keepdims=True)
        return -2.0 * site.v / (1.0 + np.exp((away - self.radius) / (0.1 * self.radius)))


@pytest.mark.slow
def test_a_place_that_holds_what_moves_through_it_is_told_by_a_patch():
    """Though its edge is sharper than a patch can have."""
    found, model = drafted(Mud(on="rod"))
    values, (name,) = found.refit.fitted.values, {p.name for p in found.pieces if p.kind == "patch"}
    assert values[f"{name}.linear"] < -0.5
    assert values[f"{name}.x"] == pytest.approx(0.42, abs=0.05)
    count = found.refit.fitted.samples
    assert found.refit.fitted.deviance - count < 0.2 * (model.deviance - count)


def test_a_piece_survives_json():
    (one, *_) = pieces(shaken.robot(shaken.drive(0)), 1.0)
    assert Piece.from_dict(one.to_dict()) == one
    with pytest.raises(rn.CaseError, match="cannot be read"):
        Piece.from_dict({"kind": "nothing"})


def test_a_case_takes_a_law_up(trials):
    some = [piece.to_dict() for piece in pieces(shaken.build(trials[0]), 1.0)]
    robot = with_effects(shaken.CASE, [some]).robot(trials[0])
    assert "law-0.linear" in robot.parameters


def test_columns_of_a_law_are_difference_quotients(bench):
    """One run gives all; the whitened residual's change by a coefficient is that of two runs."""
    fitted = bench.fit()
    library = [
        *library_of(bench),
        *(p for p in searched_of(bench) if p.name in ("law-pulse-7", "law-eddy-0-5")),
    ]
    columns, law = force_columns(bench, fitted, library), law_of(library)
    some = (
        "law-1.kzy",
        "law-2.rate_free",
        "law-0.hx",
        "law-2.square",
        "law-flow.azx",
        "law-pulse-7.byz",
        "law-eddy-0-5.azx",
    )
    for path in some:
        # a law is linear in it, and its effect is far above Newton's tolerance
        small = columns.scales[path] * (
            0.02 if any(word in path for word in ("flow", "pulse", "eddy")) else 1.0
        )
        ends = []
        for value in (small, -small):
            problem = bench.problem([law], {**fitted.values, path: value}, fitted.own, free=[])
            ends.append(np.concatenate([f.residual for f in problem.fits(np.zeros(1), slopes=False)]))
        quotient = (ends[0] - ends[1]) / 2.0 * columns.scales[path] / small
        mine = columns.columns[:, columns.names.index(path)]
        np.testing.assert_allclose(mine, quotient, atol=1e-6 * np.abs(quotient).max(), err_msg=path)


def test_gains_of_more_that_is_common_are_those_of_trials_left_out(bench):
    """A direction that is free already gains nothing; with one of its own a trial alone is as well off as left out."""
    fitted = bench.fit()
    own = np.concatenate([fitted.jacobian_of(k) for k in range(2)])
    again = cross_gains(*reduced(fitted, own), np.ones((1, 1, 1)))
    np.testing.assert_allclose(again, 0.0, atol=1e-3 * np.abs(left_out(fitted)).max())


def branched(edges: int = 8) -> rn.Robot:
    """Two rods that meet at a sharp angle, shaken in a viscous fluid."""
    fig = rn.StickFigure()
    soft = rn.Material(E=2e6, rho=1200.0)
    fig.rod("one", [(0, 0, 0), (0.3, 0, 0)], edges=edges, material=soft, radius=4e-3)
    fig.rod("two", ["one.start", (0.28, 0.1, 0.0)], edges=edges, material=soft, radius=4e-3)
    held = rn.PrescribedMotion(
        at="one.start", position=shaken.Shake(0.05, 1.0, 0.5), orientation=shaken.upright
    )
    drag = rn.ResistiveForce(eta_t=1.0, eta_n=2.0)
    return rn.Robot(fig.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), drag, held])


def test_the_library_knows_neighbours():
    """Of rods that are near each other, as an edit of their law; it runs, is stored, and is not offered twice."""
    robot = branched()
    (piece,) = crowds(robot)
    assert piece.paths == ("drag.crowding",)
    assert Piece.from_dict(piece.to_dict()) == piece
    law = law_of([piece], {"drag.crowding": 0.5})
    built = law.build(robot).with_parameters({"drag.crowding": 0.8})
    assert isinstance(built.terms[3], rn.CrowdedForce)
    assert law.build(built) is None
    ends = [rn.Simulation(r, dt=0.02).run(0.6).x[-1] for r in (robot, built, law.build(robot))]
    np.testing.assert_allclose(ends[2], ends[0], rtol=0.0, atol=1e-12)
    assert np.abs(ends[1] - ends[0]).max() > 1e-4
    assert crowds(shaken.build(record(0))) == []


def test_the_library_of_a_branched_robot_is_scored_as_a_whole():
    """Neighbours and currents do not go together: each has columns all the same, and no law has both."""
    case = rn.Case(lambda rec: branched(), seen, free=["one.E"], options=shaken.options, name="branched")
    t = np.arange(0.0, 0.6, 0.04)
    true = rn.Simulation(branched(), dt=0.02).run(0.6)
    rec = rn.Recording(
        t, rn.observe([seen(None, branched())], true, t)[0], names=["a", "b"], name="one", attrs={}
    )
    bench = Workbench.of(case, [rec], Serial(), 1e-3)
    fitted = bench.fit()
    whole, others = library_of(bench), searched_of(bench)
    columns = force_columns(bench, fitted, [*whole, *others])
    kinds = {name.partition(".")[0] for name in columns.names}
    assert {"law-0", "law-1", "law-flow", "law-section-0", "law-section-1", "law-pulse-3", "drag"} <= kinds
    for group in _choices(whole, others):
        assert not {"drag", "law-flow"} <= {path.partition(".")[0] for path in group}


def seen(rec, robot):
    return rn.Markers(robot, ["one.end", "two.end"])


def test_a_law_beside_a_misfit_is_not_of_the_scene(bench):
    columns = force_columns(bench, bench.fit(), library_of(bench))
    kept = columns.without(OF_THE_SCENE)
    assert {"law-0.gx", "law-1.linear", "law-2.rate_free"} <= set(kept.names)
    assert not any(name.endswith((".kxx", ".hz", ".later")) for name in kept.names)
    assert kept.columns.shape[1] == len(kept.one_sided) == len(kept.names)
    k = kept.names.index("law-2.linear")
    np.testing.assert_array_equal(kept.columns[:, k], columns.columns[:, columns.names.index("law-2.linear")])
