"""Laws for what a model leaves: drafted by a diagnosis, and by PySINDy's sparse regression on the located force."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

import rodnet as rn
from benchmarks.cases import Options, Result, Table
from benchmarks.cases.diagnosis import CASE, DT, EDGES, POINTS, RATE, SIGMA, case_robot
from rodnet.diagnosis.library import CREEP
from rodnet.diagnosis.locate import TrialLocation
from rodnet.diagnosis.measures import Measures
from rodnet.terms.drag.local_law import LocalLaw

TITLE = "Laws for what is left"
# what the recordings have and no name of those tried explains
HIDDEN: dict[str, dict[str, float]] = {
    "a load and drag of the squared speed": {"gz": -0.05, "square": -6.0},
    "drag that grows from left to right": {"mx": -4.0, "linear": -0.5},
    "a force that does not depend on the rate": {"rate_free": -0.15},
}
TRIED = ["camera-scale"]
TRIALS, HELD_OUT = 7, 2
# of PySINDy's sequentially thresholded least squares, chosen on trials left out
THRESHOLDS = np.geomspace(0.003, 0.3, 9)


def _recording(k: int, duration: float, law: Mapping[str, float], creep: float) -> rn.Recording:
    """A trial with a hidden law, on a mesh twice as fine and with half the time step."""
    true = case_robot(k, 2 * EDGES).with_terms(LocalLaw(on="rod", name="hidden", creep=creep, **law))
    traj = rn.Simulation(true, dt=DT / 2, stepper="sdirk2").run(duration)
    t = np.arange(0.0, duration, 1.0 / RATE)
    seen = rn.observe([rn.Markers(true, POINTS)], traj, t)[0]
    seen = seen + SIGMA * np.random.default_rng(k).standard_normal(seen.shape)
    names = [p.replace("@", "_") for p in POINTS]
    return rn.Recording(t, seen, names=names, name=f"trial{k}", attrs={"k": k})


def features(trial: TrialLocation, creep: float) -> dict[str, np.ndarray]:
    """What a local law has coefficients for, at each hat and along each axis, shape (B, T, 3) each."""
    v, x = trial.velocity, _places(trial)
    t = np.array(trial.hats.times)[:, None]
    speed = np.sqrt(np.sum(v**2, axis=2, keepdims=True) + creep**2)
    axes = dict(zip("xyz", np.eye(3), strict=True))
    found = {"linear": v, "square": speed * v, "rate_free": v / speed, "later": t * v}
    for k, (a, unit) in enumerate(axes.items()):
        found[f"g{a}"] = np.broadcast_to(unit, v.shape)
        found[f"h{a}"] = np.broadcast_to(t * unit, v.shape)
        found[f"m{a}"] = x[..., k : k + 1] * v
        found |= {f"k{a}{b}": x[..., n : n + 1] * unit for n, b in enumerate(axes)}
    return found


def _places(trial: TrialLocation) -> np.ndarray:
    """Where each hat is, shape (B, T, 3) [m]: the case has a single rod."""
    nodes = np.linspace(0.0, 1.0, trial.motion.x.shape[1])
    frames = [np.argmin(np.abs(trial.motion.t - t)) for t in trial.hats.times]
    x = trial.motion.x[frames]
    return np.stack(
        [[[np.interp(s, nodes, f[:, k]) for k in range(3)] for f in x] for s in trial.hats.places]
    )


def regressed(trials: list[TrialLocation], creep: float) -> dict[str, float]:
    """Coefficients by PySINDy's STLSQ on the force that was located, its threshold from trials left out."""
    from pysindy import STLSQ

    names = list(features(trials[0], creep))
    rows, forces, groups = [], [], []
    for k, trial in enumerate(trials):
        # where nothing is seen the prior stands in the place of a force
        seen = ~trial.blind
        weight = 1.0 / trial.sd[seen]
        found = features(trial, creep)
        rows.append(np.stack([(found[name][seen] * weight).ravel() for name in names], axis=1))
        forces.append((trial.mean[seen] * weight).ravel())
        groups += [k] * len(forces[-1])
    X, y = np.concatenate(rows), np.concatenate(forces)
    size = np.linalg.norm(X, axis=0)
    idle = size < 1e-9 * size.max()
    size = np.where(idle, np.inf, size) / np.linalg.norm(y)  # a threshold is a share of what there is
    X, trial_of = X / size, np.array(groups)

    def fitted(threshold: float, rows: np.ndarray) -> np.ndarray:
        return np.ravel(STLSQ(threshold, alpha=1e-6).fit(X[rows], y[rows]).coef_)

    def left(threshold: float) -> float:
        out = [trial_of == k for k in range(len(trials))]
        return sum(float(np.sum((y[o] - X[o] @ fitted(threshold, ~o)) ** 2)) for o in out)

    values = fitted(min(THRESHOLDS, key=left), trial_of >= 0) / size
    return {name: float(v) for name, v in zip(names, values, strict=True) if v != 0.0}


def _with_law(law: Mapping[str, float], creep: float) -> rn.Case:
    """The case with a law in it as it is."""
    return rn.Case(
        lambda rec: CASE.robot(rec).with_terms(LocalLaw(on="rod", name="found", creep=creep, **law)),
        CASE.observe, free=CASE.free, options=CASE.options, name="with a law",
    )  # fmt: skip


def _row(what: str, law: Mapping[str, float], duration: float) -> list[list[Any]]:
    creep = CREEP * Measures.of(case_robot(0), duration).speed
    trials = [_recording(k, duration, law, creep) for k in range(TRIALS)]
    learn, unseen = trials[:-HELD_OUT], trials[-HELD_OUT:]
    found = rn.diagnose(CASE, learn, hold_out=unseen, candidates=TRIED, noise=SIGMA, workers=0)
    assert found.held is not None
    before, after = found.held.before.error, found.held.after.error
    rows: list[list[Any]] = [[what, "no law", "", before, 0.0]]

    def add(who: str, parts: list[str], error: float) -> None:
        excess = before**2 - SIGMA**2
        rows.append([what, who, ", ".join(parts), error, (before**2 - error**2) / excess])

    add("rodnet", [p.partition(".")[2] for f in found.findings for p in f.parameters], after)
    if found.location is not None:
        other = regressed(found.location.trials, creep)
        values = dict(found.plain.values)
        told = rn.evaluate(_with_law(other, creep), unseen, values, workers=0)
        error = float(np.sqrt(np.mean([row["metric"] ** 2 for row in told.files])))
        add("PySINDy, on the force that was located", list(other), error)
    return rows


def measure(options: Options) -> Result:
    """Draft a law for each hidden one, and regress another."""
    duration = 1.0 if options.quick else 2.0
    hidden = dict(list(HIDDEN.items())[:1]) if options.quick else HIDDEN
    rows = [row for what, law in hidden.items() for row in _row(what, law, duration)]
    table = Table(
        f"Five trials of {duration:g} s, two more held out; errors are of these",
        ["hidden", "law by", "its parts", "rms error [m]", "share of the excess removed"],
        rows,
    )
    text = (
        "What the rod above is not told of: a law of the surroundings that none of the names tried can express. A "
        "diagnosis drafts a law by regression in the output, and refits it. PySINDy's sequentially thresholded least "
        "squares has the same features (all but drag along the rod), at the force over body and time that the same "
        "diagnosis located, weighted by its standard deviation, its threshold chosen on trials left out; the law runs "
        "as it comes."
    )
    return Result(TITLE, text, [table])
