"""Refits that were caught: trials in initial states that are not theirs, all in parameters far from the case's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import rodnet as rn
from rodnet.diagnosis.begin import begun_again, best_fit, fitted_on, from_home
from rodnet.diagnosis.chosen import Accepted
from rodnet.diagnosis.confirm import at_other_places, profiles
from rodnet.diagnosis.design import propose_places
from rodnet.diagnosis.places import elsewhere, maxima
from rodnet.diagnosis.refit import refit
from rodnet.diagnosis.screen import screen
from rodnet.diagnosis.workbench import Workbench
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken


def test_a_trial_that_was_caught_begins_again_and_the_others_stay():
    """With a soft spot in the model, one trial's initial shape far off: it comes back to noise, by its own alone."""
    recordings = [
        shaken.record(k, "stiffness-defect", {"loss": 0.8, "place": 0.3, "width": 0.1}).cut(0.0, 0.5)
        for k in range(2)
    ]
    case = replace(shaken.CASE, per_trial=("initial.position",))
    bench = Workbench.of(case, recordings, Serial(), shaken.SIGMA)
    base = bench.fit()
    spot = rn.candidates(shaken.build(recordings[0]), [], ["stiffness-defect"])[0]
    values = {**base.values, "rod.E": 2e6} | dict(zip(spot.paths, (0.8, 0.3, 0.1, 0.5), strict=True))
    own = [dict(base.own[0]), {path: value + 0.03 for path, value in base.own[1].items()}]
    caught = bench.evaluate(bench.problem([spot], values, own), np.zeros(4 + 1 + sum(map(len, own))), [spot])
    assert caught.fits[1].residual.std() > 1.5 * caught.fits[0].residual.std()

    free = begun_again(bench, replace(base, deviance=10.0 * caught.deviance), caught)
    assert free.deviance < 1.3 * free.samples
    # a model that explains little, or leaves a third, is left as it is: so are trials that are no worse than others
    noise = caught.samples
    third = replace(base, deviance=noise + 3.0 * (caught.deviance - noise))
    assert begun_again(bench, third, caught) is caught
    assert begun_again(bench, replace(base, deviance=caught.deviance), caught) is caught
    assert begun_again(bench, replace(base, deviance=10.0 * caught.deviance), free) is free


def test_a_search_that_went_far_begins_again_where_the_case_does():
    """A model without the effect has ended at an eighth of the stiffness: with it, the truth is found from the case."""
    spot = rn.candidates(shaken.build(shaken.record(0)), [], ["stiffness-defect"])[0]
    truth = dict(zip(spot.paths, (0.8, 0.3, 0.1, 1.0), strict=True))
    recordings = [
        shaken.record(k, "stiffness-defect", {p.partition(".")[2]: v for p, v in truth.items()}).cut(0.0, 0.5)
        for k in range(2)
    ]
    bench = Workbench.of(shaken.CASE, recordings, Serial(), shaken.SIGMA)
    far = bench.evaluate(bench.problem((), {"rod.E": 2.5e5}), np.zeros(1))
    score = screen(bench, far, [spot])[0]
    values = {"rod.E": 2.5e5} | {p: v for p, v in score.shape.items()} | {spot.strength[0]: -0.5}
    stuck = bench.evaluate(bench.problem([spot], values), np.zeros(5), [spot])
    found = from_home(bench, far, stuck, score)
    assert found.deviance < 1.2 * found.samples < stuck.deviance
    assert abs(np.log(found.values["rod.E"] / 2e6)) < 0.2
    assert abs(found.values[spot.strength[0]] - 0.8) < 0.1
    # what is complete, or near the case's own values, stays as it is
    assert from_home(bench, far, found, score) is found
    near = bench.evaluate(bench.problem((), {"rod.E": 1.9e6}), np.zeros(1))
    assert from_home(bench, near, near, score) is near


def test_a_search_from_another_place_ends_elsewhere_and_begins_again():
    """Where the score has two maxima over the places of a bank, a search from one does not come to the other."""
    place = 0.49
    recordings = [
        shaken.record(k, "drag-region", {"gain": 2.0, "place": place, "width": 0.11}) for k in range(2)
    ]
    case = replace(
        shaken.CASE, free=["rod.E", "drag.eta_n"], tied={"drag.eta_t": lambda v: 0.5 * v["drag.eta_n"]}
    )
    bench = Workbench.of(case, recordings, Serial(), shaken.SIGMA)
    base = bench.fit()
    (region,) = rn.candidates(shaken.build(recordings[0]), [], ["drag-region"])
    score = screen(bench, base, [region])[0]
    best, other, *_ = maxima(score, region.place)
    assert best.shape == score.shape and best.strength == score.strength and best.chi2 == score.chi2
    assert abs(other.shape[region.place] - best.shape[region.place]) > 0.2

    wrong = replace(score, shape=other.shape, strength=other.strength, chi2=other.chi2, follow=other.follow)
    stuck = best_fit(bench, base, wrong)
    assert abs(stuck.values[region.place] - place) > 0.2 and stuck.deviance > 1.2 * stuck.samples
    found, others = elsewhere(bench, base, stuck, wrong)
    assert not others  # what was left behind explains far less
    assert abs(found.values[region.place] - place) < 0.03 and found.deviance < 1.1 * found.samples
    # it is where the best place's own search ends, and stays there
    right = best_fit(bench, base, score)
    assert elsewhere(bench, base, right, score) == (right, ())


def softer(k, points, loss):
    """A trial of a rod that is softer near its end, of the case's own mesh: nothing else tells places apart."""
    attrs = shaken.drive(k)
    true = shaken.with_effect(
        shaken.robot(attrs), "stiffness-defect", {"loss": loss, "place": 0.8, "width": 0.2}
    )
    traj = rn.Simulation(true, dt=shaken.DT, stepper="sdirk2").run(shaken.DURATION)
    t = np.arange(0.0, shaken.DURATION, 1.0 / shaken.RATE)
    seen = rn.observe([rn.Markers(true, points)], traj, t)[0]
    seen = seen + shaken.SIGMA * np.random.default_rng(k).standard_normal(seen.shape)
    return rn.Recording(t, seen, names=[f"m{i}" for i in range(len(points))], name=f"trial{k}", attrs=attrs)


def test_the_interval_of_a_place_holds_another_that_explains_as_much():
    """Seen at its tip alone, a rod that is soft here moves as one that is stiff there; with all markers it does not."""
    held = {}
    for points, size in ((["rod@100%"], 0.35), (shaken.POINTS, 0.6)):
        recordings = [softer(k, points, size) for k in range(2)]
        case = replace(shaken.CASE, observe=lambda rec, robot, points=points: rn.Markers(robot, points))
        bench = Workbench.of(case, recordings, Serial(), shaken.SIGMA)
        base = bench.fit()
        (spot,) = rn.candidates(shaken.build(recordings[0]), [], ["stiffness-defect"])
        (one,) = refit(bench, base, screen(bench, base, [spot]), 1)
        alone = profiles(bench, one.fitted, spot.paths)
        found, fits = at_other_places(bench, one.fitted, Accepted(one, base, []), alone)
        assert [fit.values[spot.place] for fit in fits] == list(found[spot.place].also)
        told = propose_places(bench, one.fitted, {spot.id: fits}, 0.0, lambda text: None)
        assert [proposal.between[1] for proposal in told] == [
            f"{spot.id} at {x:.2f}" for x in found[spot.place].also
        ]
        held[len(points)] = found[spot.place], found[spot.strength[0]], alone[spot.place]
    place, loss, before = held[1]
    assert before.value > 0.6 and before.low > 0.45
    (other,) = place.also
    assert place.low < other < 0.45 and place.high == before.high and other < before.low
    assert loss.value > 0.0 > loss.also[0] > loss.low
    sure, strength, before = held[4]
    assert sure == before and not strength.also and sure.low < 0.8 < sure.high


def test_a_refit_that_ended_early_is_fitted_on_along_its_valley():
    """More drag in a region: by how much and how wide is known as a product, which a first fit is content with."""
    truth = {"gain": 1.5, "place": 0.6, "width": 0.1}
    recordings = [shaken.record(k, "drag-region", truth) for k in range(2)]
    bench = Workbench.of(shaken.CASE, recordings, Serial(), shaken.SIGMA)
    (region,) = rn.candidates(shaken.build(recordings[0]), [], ["drag-region"])
    gain, place, width = (f"{region.id}.{name}" for name in truth)
    narrow = {"rod.E": 2e6, gain: 3.0, place: 0.6, width: 0.05}
    early = bench.fit([region], narrow, flat=0.3)
    on = fitted_on(bench, early)
    lowest = bench.fit(
        [region], {"rod.E": 2e6} | {f"{region.id}.{k}": v for k, v in truth.items()}, flat=1e-7
    )
    assert early.deviance - lowest.deviance > 20.0
    assert abs(on.deviance - lowest.deviance) < 0.5
    assert abs(on.values[place] - lowest.values[place]) < 0.2 * lowest.sd(place)
    assert fitted_on(bench, on) is on
