"""What is so strong that first order tells little of it is found all the same."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rodnet as rn
from rodnet.diagnosis import strong as module
from rodnet.diagnosis.begin import fit_both, wandered
from rodnet.diagnosis.candidate import as_family, candidates
from rodnet.diagnosis.classes import _followed
from rodnet.diagnosis.far import at_places
from rodnet.diagnosis.far import runs as far_runs
from rodnet.diagnosis.refit import refit
from rodnet.diagnosis.screen import screen
from rodnet.diagnosis.strong import strong
from rodnet.diagnosis.workbench import Workbench
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken

VISCOSITY = 30.0  # [Pa s]: of the turns at the root next to nothing arrives at the tip


class Turning:
    """Turns of the root about the rod's axis."""

    def __init__(self, angle: float, frequency: float) -> None:
        self.angle, self.frequency = angle, frequency

    def __call__(self, t: float) -> np.ndarray:
        ramp = 1.0 - np.exp(-((t / 0.2) ** 2))
        angle = ramp * self.angle * np.sin(2.0 * np.pi * self.frequency * t)
        return Rotation.from_rotvec([angle, 0.0, 0.0]).as_matrix()


def at_rest(t):
    """No displacement."""
    return np.zeros(3)


def turned(attrs, edges=shaken.EDGES):
    """A curved rod whose root turns."""
    figure = rn.StickFigure()
    s = np.linspace(0.0, shaken.LENGTH, edges + 1)
    points = np.stack([s, 1.5 * s**2, np.zeros_like(s)], axis=1)
    figure.rod("rod", points, material=rn.Material(E=2e6, rho=1200.0), radius=4e-3)
    held = rn.PrescribedMotion(
        at="rod.start", position=at_rest, orientation=Turning(attrs["angle"], attrs["frequency"])
    )
    elastic = rn.Stretching(), rn.Bending(), rn.Twisting()
    return rn.Robot(figure.build(), [*elastic, rn.ResistiveForce(eta_t=1.0, eta_n=2.0), held])


def build(rec):
    """The robot of a recording."""
    return turned(rec.attrs)


def observe(rec, robot):
    """Its markers."""
    return [rn.Markers(robot, shaken.POINTS)]


def options(rec, robot):
    """Of the simulation."""
    return {"dt": shaken.DT, "stepper": "sdirk2"}


CASE = rn.Case(build, observe, free=("drag.eta_n",), options=options, name="turned")


def record(k):
    """A trial in a medium that all but stops the rod's spin."""
    attrs = {"angle": 1.2 + 0.3 * k, "frequency": 0.6 + 0.15 * k}
    true = turned(attrs, 2 * shaken.EDGES).with_terms(rn.SpinDrag(viscosity=VISCOSITY))
    traj = rn.Simulation(true, dt=shaken.DT / 2, stepper="sdirk2").run(shaken.DURATION)
    t = np.arange(0.0, shaken.DURATION, 1.0 / shaken.RATE)
    seen = rn.observe([rn.Markers(true, shaken.POINTS)], traj, t)[0]
    seen = seen + shaken.SIGMA * np.random.default_rng(k).standard_normal(seen.shape)
    return rn.Recording(t, seen, names=list("abcd"), name=f"turned{k}", attrs=attrs)


def test_a_spin_that_is_all_but_stopped_is_found_far_from_first_order():
    trials = [record(k) for k in range(3)]
    bench = Workbench.of(CASE, trials, Serial(), shaken.SIGMA)
    model = bench.fit()
    robot = CASE.robot(trials[0])
    scores = screen(bench, model, candidates(robot, [], ["axial-drag", "gravity"]))
    (linear,) = (s for s in scores if s.candidate.id == "axial-drag")
    found = strong(bench, model, scores, set())
    assert found and found[0].candidate.id == "axial-drag"
    value = found[0].strength["axial-drag.viscosity"]
    assert linear.chi2 < 0.5 * model.deviance and value > 2.0 * linear.strength["axial-drag.viscosity"]
    fitted = bench.fit([found[0].candidate], {**model.values, "axial-drag.viscosity": value}, model.own)
    assert abs(np.log(fitted.values["axial-drag.viscosity"] / VISCOSITY)) < 0.5
    assert not strong(bench, fitted, scores, set())  # of what leaves little first order tells


def test_strengths_go_on_as_long_as_each_takes_off_more(monkeypatch):
    """From a strength on that does a fourth of what is needed, to the one that is nearest, and one further."""
    trials = [record(k) for k in range(3)]
    bench = Workbench.of(CASE, trials, Serial(), shaken.SIGMA)
    model = bench.fit()
    scores = screen(bench, model, candidates(CASE.robot(trials[0]), [], ["axial-drag"]))
    near = strong(bench, model, scores, set())[0].strength["axial-drag.viscosity"]
    tried = []

    def runs(*given):
        for change, share in far_runs(*given):
            tried.append(share)
            yield change, share

    monkeypatch.setattr(module, "runs", runs)
    monkeypatch.setattr(module, "STRENGTHS", (1.0,))
    monkeypatch.setattr(module, "ONWARDS", (3.0, 10.0, 30.0, 100.0, 300.0))
    assert strong(bench, model, scores, set())[0].strength["axial-drag.viscosity"] == near
    ends = np.flatnonzero(np.diff(tried) > 0.0)  # of the ways from the model and from the case's values
    assert len(tried) < 2 * 6 and len(ends) == 2 and ends[-1] == len(tried) - 2


LAG = 0.55  # [s], of drives that take 0.6 to 1.7 s for a turn


def test_a_lag_of_half_a_turn_is_found_where_its_derivative_at_none_explains_next_to_nothing():
    """Beside the stiffness that the case has: the calibration has gone far from it to hide the lag."""

    def late(robot):
        (one,) = candidates(robot, [], ["drive-lag"])
        return one.build(robot).with_parameters({one.strength[0]: LAG})

    trials = [shaken.record(k, change=late) for k in range(3)]
    bench = Workbench.of(shaken.CASE, trials, Serial(), shaken.SIGMA)
    model = bench.fit()
    bank = candidates(shaken.CASE.robot(trials[0]), [], ["drive-lag", "gravity", "yield", "kelvin-voigt"])
    scores = screen(bench, model, bank)
    (linear,) = (s for s in scores if s.candidate.family == "drive-lag")
    assert linear.chi2 < 0.1 * model.deviance
    assert wandered(bench, model)
    found = strong(bench, model, scores, set())
    assert found and found[0].candidate.family == "drive-lag"
    assert found[0].begin is not None and found[0].begin.values["rod.E"] == 2e6
    (refitted,) = refit(bench, model, found[:1], 1)
    (path,) = found[0].candidate.strength
    assert abs(refitted.fitted.values[path] - LAG) < 0.02


class Lumps(rn.DragModel):
    """Grains that hold on to a rod where they are strong enough: nothing at all below a threshold."""

    default_name = "lumps"
    claims = {"dissipative", "objective"}
    strength = rn.Parameter(10.0, unit="Pa s", bounds=(0, None), null=0.0, doc="of the grains")

    def force(self, site, p):
        return -max(p.strength - 2.0, 0.0) * site.v

    def jacobian(self, site, p):
        eye = np.broadcast_to(np.eye(3), (len(site.v), 3, 3))
        return {"v": -max(p.strength - 2.0, 0.0) * eye}


LUMPS = as_family("lumps", Lumps)


def in_lumps(count):
    """So many trials of the rod in grains that hold it, and the case that knows of none."""
    trials = [
        shaken.record(k, change=lambda robot: robot.with_terms(Lumps(strength=16.0))) for k in range(count)
    ]
    return Workbench.of(shaken.CASE, trials, Serial(), shaken.SIGMA)


def test_what_has_no_first_order_is_tried_at_what_its_author_takes_for_usual():
    """Grains below the threshold do nothing, and so does the derivative; the worst trial shows where they do."""
    bench = in_lumps(3)
    model, robot = bench.fit(), shaken.CASE.robot(bench.recordings[0])
    (one,) = LUMPS(robot, [])
    scores = screen(bench, model, [one])
    assert scores[0].chi2 == 0.0 and scores[0].strength == {"lumps.strength": 0.0}
    found = strong(bench, model, scores, set())
    (first,) = found
    assert first.strength["lumps.strength"] == pytest.approx(10.0)  # what it is where nobody gives it
    (refitted,) = refit(bench, model, found, 1)
    fitted = (
        refitted.fitted
    )  # a stiffer rod in stronger grains moves much the same, but not where there are none
    assert fitted.values["lumps.strength"] > 5.0
    assert model.deviance - fitted.deviance > 0.9 * (model.deviance - model.samples)


def test_what_has_no_first_order_stands_beside_other_effects_and_in_their_place():
    """A fit of two begins without it; where another effect is asked again in its place, it begins where it was."""
    bench = in_lumps(2)
    model, robot = bench.fit(), shaken.CASE.robot(bench.recordings[0])
    (one,), (other, *_) = LUMPS(robot, []), candidates(robot, [], ["gravity"])
    silent, load = (next(s for s in screen(bench, model, [c])) for c in (one, other))
    both = fit_both(bench, model, silent, load)
    assert both.values["lumps.strength"] < 2.0 and both.deviance < model.deviance
    known = bench.fit([one], {**model.values, "lumps.strength": 16.0}, model.own)
    found = _followed(bench, model, [one], known.deviance, known.values)
    assert found.deviance == pytest.approx(known.deviance, rel=1e-3)


def test_what_was_tried_is_not_tried_again():
    trials = [record(k) for k in range(2)]
    bench = Workbench.of(CASE, trials, Serial(), shaken.SIGMA)
    model = bench.fit()
    scores = screen(bench, model, candidates(CASE.robot(trials[0]), [], ["axial-drag"]))
    assert not strong(bench, model, scores, {"axial-drag"})


def test_a_strong_region_is_begun_where_and_as_strong_as_it_is():
    """First order says less than half of it; runs at the places of the bank know better."""
    gain, place, width = 4.0, 0.6, 0.1
    values = {"gain": gain, "place": place, "width": width}
    trials = [shaken.record(k, "drag-region", values) for k in range(3)]
    bench = Workbench.of(shaken.CASE, trials, Serial(), shaken.SIGMA)
    base = bench.fit()
    (score,) = screen(bench, base, candidates(shaken.build(trials[0]), [], ["drag-region"]))
    id = score.candidate.id
    begun = at_places(bench, base, score)
    assert abs(begun.shape[f"{id}.place"] - place) < 0.1
    first, found = (
        s.strength[f"{id}.gain"] * s.shape[f"{id}.width"] / (gain * width) for s in (score, begun)
    )
    assert first < 0.5 and 0.7 < found < 1.4
