"""How a calibration searches: robust losses, starts, executors, interruptions, splits of recordings."""

from __future__ import annotations

import json
import signal
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.workbench import Workbench
from rodnet.inference.comparison import Comparison, Fit
from rodnet.inference.losses import LOSSES
from rodnet.inference.problem import reject
from rodnet.inference.search import minimise
from rodnet.inference.split import split
from rodnet.sweeps.collect import Serial
from tests.inference.swings import cable, eyes, record

WHITE = rn.NoiseModel(white=3e-4)
FREE = ["cable.E", "mass_damping.rate"]


def calibrate(recordings, **options):
    options = {"observe": eyes, "workers": 0, "free": FREE, **options}
    return rn.calibrate(cable(E=3e6, rate=0.8), recordings, **options)


@pytest.fixture(scope="module")
def spoilt():
    """One trial in which one sample of ten lies far to one side."""
    rec = record(cable(), WHITE, 5)
    x, bad = rec.markers.copy(), np.random.default_rng(1).random(rec.markers.shape[:2]) < 0.1
    x[bad] += [0.0, 0.0, 0.02]
    return rec.replace(markers=x)


@pytest.mark.parametrize("loss", [name for name in LOSSES if name != "linear"])
def test_derivatives_of_losses(loss):
    s = np.array([0.1, 0.7, 3.0, 40.0])
    h = 1e-6 * s
    value, first, second = LOSSES[loss]
    np.testing.assert_allclose((value(s + h) - value(s - h)) / (2 * h), first(s), rtol=1e-6)
    np.testing.assert_allclose((first(s + h) - first(s - h)) / (2 * h), second(s), rtol=1e-6, atol=1e-9)


def test_robust_losses_are_not_drawn_aside(spoilt):
    drawn = calibrate([spoilt], loss="linear", outliers=None, misfit=False).parameters["cable.E"]
    for loss in ("soft_l1", "cauchy"):
        found = calibrate([spoilt], loss=loss, outliers=None)
        one = found.parameters["cable.E"]
        assert abs(np.log(one.value / 2e6)) < min(4.0 * one.sd, 0.5 * abs(np.log(drawn.value / 2e6)))
        assert "robust loss" in found.message


def test_a_profile_is_of_the_loss_that_was_minimised():
    """Normal noise: its interval is about the linearised one, not a trace about the optimum."""
    rec = record(cable(), WHITE, 2, duration=0.5)
    found = calibrate([rec], loss="soft_l1", outliers=None)
    profile, one = found.profile("cable.E", workers=0), found.parameters["cable.E"]
    assert (profile.high - profile.low) / (one.high - one.low) == pytest.approx(1.0, abs=0.3)


def test_variances_of_a_robust_loss_with_normal_noise():
    # of the Huber estimator with threshold 1, whose efficiency for normal errors is 0.903
    rec = record(cable(), WHITE, 2, duration=0.5)
    found = calibrate([rec], loss="huber", outliers=None)
    assert found.variance_factor == pytest.approx(1.0 / 0.903, rel=0.1)


def test_a_misfit_is_no_outlier():
    """A model that is off by 20 mm for a while, in a wave, and three samples that jump by 20 mm: these are left out."""
    noise = rn.NoiseModel(white=3e-5, slow=5e-4, time=0.3)
    rec = record(cable(), noise, 3, duration=3.0)
    trial = Comparison(rn.Case(lambda rec: cable(), eyes), rec, {"markers": noise})
    wave = np.where(rec.t > 1.0, 0.02 * np.sin(9.0 * (rec.t - 1.0)), 0.0)[:, None, None]
    measured = rec.markers.copy()
    jumps = ([40, 170, 250], [0, 1, 1])
    measured[jumps] += [0.0, 0.02, 0.0]
    fit = Fit([measured], [rec.markers + wave * np.array([1.0, 0.3, 0.0])], np.zeros(0), None, [])
    (out,) = reject(trial, fit, 5.0)
    assert sorted(zip(*np.nonzero(out), strict=True)) == sorted(zip(*jumps, strict=True))


def test_executors_and_starts_find_the_same():
    recs = [record(cable(), WHITE, k, duration=0.15) for k in range(2)]
    here = calibrate(recs)
    with ThreadPoolExecutor(1) as pool:
        there = calibrate(recs, workers=None, executor=pool, starts=2)
        pool.submit(int).result()  # it is left running
    assert there.values == pytest.approx(here.values, rel=1e-5)
    with pytest.raises(rn.ParameterError, match="either executor or workers"):
        calibrate(recs, executor=ThreadPoolExecutor(1))


class Heard:
    """Hears how a search goes on, and presses Ctrl-C after an evaluation."""

    def __init__(self, after=None):
        self.texts, self.after = [], after

    def __call__(self, text):
        self.texts.append(text)
        if self.after is not None and self.evaluations == self.after:
            self.after = None
            signal.raise_signal(signal.SIGINT)

    @property
    def evaluations(self):
        return len(self.residuals)

    @property
    def residuals(self):
        """Of every evaluation, as it was told [sd]."""
        return [float(text.split()[-2]) for text in self.texts if text.startswith("evaluation")]


def test_an_interrupted_search_goes_on_where_it_was(tmp_path):
    recs, kept = [record(cable(), WHITE, 0, duration=0.2)], tmp_path / "search.json"
    whole = Heard()
    truth = calibrate(recs, progress=whole)
    heard = Heard(3)
    part = calibrate(recs, checkpoint=kept, progress=heard)
    assert part.interrupted and not part.success and "interrupted" in part.message
    assert part.chi2 < calibrate(recs, evaluations=1).chi2
    rest = Heard()
    found = calibrate(recs, checkpoint=kept, progress=rest)
    assert found.success
    for path, one in truth.parameters.items():  # both end within 0.02 standard deviations of the minimum
        assert abs(found.values[path] - one.value) < 0.04 * (one.high - one.low) / (2.0 * 1.96)
    assert rest.residuals[0] == heard.residuals[-1] < whole.residuals[0]  # from the best place so far
    # what has ended is not searched again, and another calibration begins afresh
    again = Heard()
    assert calibrate(recs, checkpoint=kept, progress=again).values == found.values
    assert again.evaluations == 0
    other = Heard()
    calibrate([recs[0].replace(markers=recs[0].markers + 1e-4)], checkpoint=kept, progress=other)
    assert other.evaluations >= whole.evaluations - 1


def test_a_broken_checkpoint_is_replaced(tmp_path):
    kept = tmp_path / "search.json"
    kept.write_text("{")
    calibrate([record(cable(), WHITE, 0, duration=0.05)], checkpoint=kept)
    assert json.loads(kept.read_text())["done"]["start 1"]["success"]


def test_held_out_trials_may_have_their_own_start():
    kick = np.zeros((5, 3))
    kick[:, 2] = np.linspace(0.0, 0.15, 5)
    recs = [record(cable(), WHITE, k, velocity=s * kick) for k, s in ((0, 1.0), (1, -0.6))]
    found = calibrate(recs[:1], per_trial=["initial.velocity"], modes=3)
    without, own = (found.predictions(recs[1:], own=own)["trial1"] for own in (False, True))
    assert own.rms["markers"] < 2.5 * WHITE.white < 0.2 * without.rms["markers"]


def recordings(groups):
    x = np.zeros((3, 1, 3))
    return [rn.Recording([0.0, 0.1, 0.2], x, name=f"r{k}", group=g) for k, g in enumerate(groups)]


def test_groups_are_never_divided():
    recs = recordings(["a", "b", "a", "c", "d", "e", "b"])
    parts = split(recs)
    groups = [{r.group for r in part} for part in (parts.train, parts.held_out, parts.confirm)]
    assert [len(g) for g in groups] == [3, 1, 1] and set.union(*groups) == set("abcde")
    assert sum(map(len, (parts.train, parts.held_out, parts.confirm))) == len(recs)
    assert "by group, 60/20/20" in str(parts)
    assert split(recs[::-1]).held_out[0].group == parts.held_out[0].group


@pytest.mark.parametrize(
    ("count", "sizes"), [(1, (1, 0, 0)), (2, (1, 1, 0)), (3, (1, 1, 1)), (10, (6, 2, 2))]
)
def test_shares_of_trials(count, sizes):
    parts = split(recordings([""] * count))
    assert tuple(map(len, (parts.train, parts.held_out, parts.confirm))) == sizes


def test_patterns_say_what_is_held_out():
    recs = recordings(["a", "a", "b", "c"])
    parts = split(recs, ["group=b"], ["r3"])
    assert [r.name for r in parts.train] == ["r0", "r1"]
    assert ([r.name for r in parts.held_out], [r.name for r in parts.confirm]) == (["r2"], ["r3"])
    with pytest.raises(rn.ParameterError, match="fits no recording"):
        split(recs, ["x*"])
    with pytest.raises(rn.ParameterError, match="nothing to fit"):
        split(recs, ["r*"])
    with pytest.raises(rn.ParameterError, match="r3 would be held out and left alone to confirm"):
        split(recs, ["r2", "r3"], ["r3"])


class Cornered(rn.DragModel):
    """Drag with a corner in its parameter, at 1; its memory leaves derivatives to differences."""

    memory_size = 1
    default_name = "cornered"
    rate = rn.Parameter(1.0, unit="Pa s", bounds=(0.0, 5.0), doc="drag beside the corner")

    def update(self, site, p, m_old):
        return -(0.05 + abs(p.rate - 1.0)) * site.v, m_old


def test_where_a_law_has_a_corner_a_search_begins_beside_it():
    plain = cable()

    def made(rate):
        return rn.Robot(plain.graph, [*plain.terms, Cornered(rate=rate)])

    with pytest.raises(rn.DerivativeError, match="corner"):
        rn.sensitivities(made(1.0), 0.3, parameters=["cornered.rate"], dt=0.01)
    rec = record(made(1.4), WHITE, 6, duration=0.5)
    case = rn.Case(lambda rec: made(1.0), eyes, free=("cornered.rate",), name="cornered")
    found = Workbench.of(case, [rec], Serial(), {"markers": WHITE}).fit()
    off = abs(found.values["cornered.rate"] - 1.0) - 0.4  # either side of the corner fits as well
    assert abs(off) < 4.0 * found.sd("cornered.rate")


def test_where_steps_take_far_more_iterations_than_usual_is_no_place_for_a_search():
    """Friction that sets in within next to no curvature: a step is halved again and again. Predictions may."""
    plain = cable()
    robot = rn.Robot(plain.graph, [*plain.terms, rn.DryFriction(moment=5e-3, curvature=1e-7)])
    rec = record(plain, WHITE, 8, duration=0.3)
    trial = Comparison(rn.Case(lambda rec: robot, eyes), rec, {"markers": WHITE})
    with pytest.raises(rn.ConvergenceError, match=r"more than 30 iterations .* take a shorter step than"):
        trial.evaluate({})
    assert np.isfinite(trial.predict({})[0][0]).all()
    case = rn.Case(lambda rec: robot, eyes, free=("cable.E",), name="rubbed")
    with pytest.raises(rn.ConvergenceError, match=rf"'{rec.name}' takes more than 30 iterations"):
        Workbench.of(case, [rec], Serial(), {"markers": WHITE}).fit()


@pytest.mark.parametrize("noise", [None, {"markers": WHITE}], ids=["far from small", "small"])
def test_a_search_that_begins_at_a_bound_does_not_creep_away_from_it(noise):
    rec, told = record(cable(), WHITE, 7, duration=0.5), []
    made = cable(rate=0.0)
    case = rn.Case(lambda rec: made, eyes, free=("mass_damping.rate",), name="bound")
    bench = Workbench.of(case, [rec], Serial(), {"markers": WHITE})
    bench = replace(bench, case=replace(bench.case, noise=noise), tell=told.append)
    found = bench.fit(flat=1e-8)
    assert abs(found.values["mass_damping.rate"] - 1.5) < 4.0 * found.sd("mass_damping.rate")
    assert sum("evaluation" in line for line in told) <= 5


@dataclass
class Straight:
    """As much of a problem as a search needs, with residuals that are linear in the coordinates."""

    J: np.ndarray
    r: np.ndarray
    bounds: list[tuple[float, float]]
    evaluations: int = 0
    interrupted = False
    failures = ()

    def __post_init__(self):
        self.quantities = [SimpleNamespace(bounds=b) for b in self.bounds]
        self.places = []

    def joint(self, z):
        self.evaluations += 1
        self.places.append(z)
        return self.r + self.J @ z, self.J

    def at(self, z):
        return None

    def hold(self):
        pass


def test_a_start_at_a_bound_that_it_is_pushed_to_makes_no_long_first_step():
    """What the others are hardly known by is not thrown far away by it."""
    J = np.array([[1.0, 0.0], [0.0, 0.01]])
    problem = Straight(
        J, np.array([5.0, -3.0]), [(0.0, np.inf), (-np.inf, np.inf)]
    )  # the least is at (0, 300)
    found = minimise(problem, np.zeros(2), "linear", 60, lambda text: None)
    steps = np.abs(np.diff([z[1] for z in problem.places]))
    assert steps[steps > 0.0][0] < 3.0
    assert found.z[1] == pytest.approx(300.0, rel=1e-2)
