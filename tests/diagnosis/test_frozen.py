"""Effects in files of a repaired model are those that were fitted, whatever recording they are put into."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.frozen import freeze, thaw
from rodnet.diagnosis.repaired import as_splines, effects_of, with_effects
from tests.diagnosis import shaken
from tests.diagnosis.bank_robots import ROBOTS, instruments


def told(robot):
    """Parameters of a robot, all there is to say of them."""
    return {
        path: (np.asarray(p.value).tolist(), p.unit, p.bounds, p.null, p.kind)
        for path, p in robot.parameters.items()
    }


def numbers(term):
    """Whatever else a term is made of that is numbers or words."""
    told = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(term).items()}
    return {k: v for k, v in told.items() if isinstance(v, (int, float, str, list))}


@pytest.mark.parametrize("name", ROBOTS)
def test_effects_survive_json(name):
    robot, _ = ROBOTS[name]()
    frozen = 0
    for one in rn.candidates(robot, instruments(robot)):
        effect = json.loads(json.dumps(freeze(one), allow_nan=False))
        if isinstance(effect, str):
            assert effect == one.id
            continue
        frozen += 1
        built, again = one.build(robot), thaw(effect, robot)
        assert told(again) == told(built), one.id
        assert [type(t) for t in again.terms] == [type(t) for t in built.terms]
        for mine, own in zip(again.terms, built.terms, strict=True):
            assert numbers(mine) == numbers(own), one.id
    assert frozen > 10


@pytest.mark.parametrize("family", ["tether", "depth", "wall", "obstacle"])
def test_a_recording_that_begins_elsewhere_gets_the_effect_that_was_fitted(family):
    """Not one with a point, a level or bounds of its own."""

    def build(rec):
        robot, figure = shaken.build(rec), rn.StickFigure()
        begin = np.array([0.0, 0.0, 0.0] if rec.name == "here" else [0.3, 0.0, -0.2])
        ends = [begin, begin + np.array([shaken.LENGTH, 0.0, 0.0])]
        figure.rod("rod", ends, edges=shaken.EDGES, material=rn.Material(E=2e6, rho=1200.0), radius=4e-3)
        return rn.Robot(figure.build(), robot.terms)

    case, rec = replace(shaken.CASE, build=build), shaken.record(0).cut(0.0, 0.4)
    here, there = build(rec.replace(name="here")), build(rec.replace(name="there"))
    one, *_ = rn.candidates(here, [], [family])
    repaired = with_effects(case, effects_of([one], None))
    for robot, name in ((here, "here"), (there, "there")):
        mine, own = repaired.robot(rec.replace(name=name)), one.build(robot)
        assert told(mine) == told(own)
        assert numbers(mine.terms[-1]) == numbers(own.terms[-1])


def test_a_robot_without_the_rod_goes_without_the_effect():
    (one, *_) = rn.candidates(shaken.build(shaken.record(0)), [], ["tether"])
    figure = rn.StickFigure()
    figure.rod("other", [(0, 0, 0), (1, 0, 0)], edges=4, material=rn.Material(E=2e6, rho=1200.0), radius=4e-3)
    other = rn.Robot(figure.build(), [rn.Stretching(), rn.Bending(), rn.Twisting()])
    assert thaw(freeze(one), other) is other
    with pytest.raises(rn.CaseError, match="cannot be read"):
        thaw({"id": "x"}, other)
    with pytest.raises(rn.CaseError, match="not installed"):
        thaw({"id": "x", "parameters": [], "terms": [{"class": "nowhere.at_all:Law", "options": {}}]}, other)


def test_a_law_is_told_by_its_pieces_after_a_resumed_run():
    """Where the candidate is another object than that of the draft, for each stage is read by itself."""
    from types import SimpleNamespace

    from rodnet.diagnosis.library import law_of, pieces

    some = pieces(shaken.build(shaken.record(0)), 1.0)
    draft = SimpleNamespace(pieces=some, candidate=law_of(some))
    (effect,) = effects_of([pickle.loads(pickle.dumps(draft.candidate))], draft)
    assert [piece["name"] for piece in effect] == [piece.name for piece in some]


class Recorded:
    """A drive as a noisy record at 100 Hz, linear between its samples and at rest before the first."""

    def __init__(self):
        t = np.arange(0.0, 2.0, 0.01)
        self.t, self.y = t, 0.02 * np.sin(6.0 * t) + 1e-4 * np.random.default_rng(0).standard_normal(len(t))

    def __call__(self, t):
        return np.array([0.0, np.interp(t, self.t, self.y), 0.0])


def test_a_motion_that_runs_late_begins_as_it_was_recorded():
    """What was prescribed before the beginning is asked for, too: no polynomial goes on there."""
    drive, plain = Recorded(), shaken.build(shaken.record(0))
    held = rn.ImperfectMotion(
        at="rod.start", position=drive, orientation=shaken.upright, lag=0.05, spread=0.5, name="grip"
    )
    robot = as_splines(rn.Robot(plain.graph, [*plain.terms[:-1], held]), 1.5)
    motion = next(term for term in robot.terms if term.name == "grip")
    earliest = min(s for _, s in held.followed(0.0, held.values()))
    assert earliest < -0.1
    for t in np.linspace(earliest, 1.4, 60):
        np.testing.assert_allclose(motion.displacement(t), drive(t), atol=3e-4)


def test_drag_that_is_added_is_that_of_the_medium_where_it_flows():
    """A yield stress of a river acts against the river; in another recording it is another one."""
    still = shaken.build(shaken.record(0))
    for speed in (0.1, 0.4):
        law = rn.ResistiveForce(eta_t=0.2, eta_n=0.4, flow=(speed, 0.0, 0.0))
        rest = [term for term in still.terms if not isinstance(term, rn.ResistiveForce)]
        robot = rn.Robot(still.graph, [*rest, law])
        some = {c.id: c for c in rn.candidates(robot, [], ["yield", "medium-friction", "depth"])}
        for id in ("yield", "medium-friction"):
            for built in (some[id].build(robot), thaw(json.loads(json.dumps(freeze(some[id]))), robot)):
                added = built.terms[-1]
                np.testing.assert_allclose(added.flow.velocity(np.zeros((1, 3)), 0.0), [[speed, 0.0, 0.0]])
        assert some["yield"].build(still).terms[-1].flow is None
