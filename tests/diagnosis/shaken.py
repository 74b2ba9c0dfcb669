"""A rod in a viscous fluid, shaken at its root: recordings of what a model lacks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import rodnet as rn
from rodnet.diagnosis.candidate import candidates
from rodnet.diagnosis.workbench import Fitted

LENGTH, EDGES, DT, DURATION, RATE, SIGMA = 0.5, 12, 0.02, 1.4, 25.0, 1e-3
POINTS = [f"rod@{k}%" for k in (25, 50, 75, 100)]


@dataclass(frozen=True)
class Shake:
    """Displacement of the root."""

    amplitude: float
    frequency: float
    lift: float

    def __call__(self, t: float) -> np.ndarray:
        ramp = 1.0 - np.exp(-((t / 0.2) ** 2))
        phase = 2.0 * np.pi * self.frequency * t
        return ramp * np.array(
            [0.0, self.amplitude * np.sin(phase), self.lift * self.amplitude * np.sin(0.6 * phase)]
        )


def drive(k: int) -> dict[str, Any]:
    """The drive of a trial, different in each."""
    rng = np.random.default_rng(50 + k)
    return {
        "amplitude": rng.uniform(0.03, 0.08),
        "frequency": rng.uniform(0.6, 1.6),
        "lift": rng.uniform(0.2, 0.9),
    }


def robot(attrs: dict[str, Any], edges: int = EDGES) -> rn.Robot:
    """The rod; E is what a calibration fits."""
    fig = rn.StickFigure()
    fig.rod(
        "rod", [(0, 0, 0), (LENGTH, 0, 0)], edges=edges, material=rn.Material(E=2e6, rho=1200.0), radius=4e-3
    )
    shake = Shake(*(float(attrs[name]) for name in ("amplitude", "frequency", "lift")))
    held = rn.PrescribedMotion(at="rod.start", position=shake, orientation=upright)
    drag = rn.ResistiveForce(eta_t=1.0, eta_n=2.0)
    return rn.Robot(fig.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), drag, held])


def upright(t: float) -> np.ndarray:
    """No rotation."""
    return np.eye(3)


def with_effect(plain: rn.Robot, candidate: str, values: dict[str, float]) -> rn.Robot:
    """The robot with what a candidate is about."""
    one = candidates(plain, [], [candidate])[0]
    built = one.build(plain)
    assert built is not None
    return built.with_parameters({f"{one.id}.{name}": value for name, value in values.items()})


def record(
    k: int, candidate: str = "", values: dict[str, float] | None = None,
    change: Callable[[rn.Robot], rn.Robot] | None = None, share: float = 1.0, **eye: Any,
) -> rn.Recording:  # fmt: skip
    """A trial of the true rod, on a mesh twice as fine and with half the time step, changed in what way is asked.

    Its root moves by a ``share`` of what it does otherwise.
    ``eye`` says in what its markers differ from what the case takes them for.
    """
    attrs = drive(k)
    attrs["amplitude"] *= share
    true = robot(attrs, 2 * EDGES)
    if change is not None:
        true = change(true)
    if candidate:
        true = with_effect(true, candidate, values or {})
    traj = rn.Simulation(true, dt=DT / 2, stepper="sdirk2").run(DURATION)
    t = np.arange(0.0, DURATION, 1.0 / RATE)
    seen = rn.observe([rn.Markers(true, POINTS, **eye)], traj, t)[0]
    seen = seen + SIGMA * np.random.default_rng(k).standard_normal(seen.shape)
    return rn.Recording(t, seen, names=[f"m{i}" for i in range(len(POINTS))], name=f"trial{k}", attrs=attrs)


def build(rec: rn.Recording) -> rn.Robot:
    return robot(dict(rec.attrs))


def observe(rec: rn.Recording, robot: rn.Robot) -> rn.Markers:
    return rn.Markers(robot, POINTS)


def options(rec: rn.Recording, robot: rn.Robot) -> dict[str, Any]:
    return {"dt": DT, "stepper": "sdirk2"}


free = ["rod.E"]
CASE = rn.Case(build, observe, free=free, options=options, name="shaken")


def leaving(model: Fitted, residuals: list[np.ndarray]) -> Fitted:
    """A model of trials with one instrument that leaves other residuals."""
    fits = []
    for f, r in zip(model.fits, residuals, strict=True):
        white = np.zeros_like(f.whitened[0])
        white[f.seen[0]] = r.reshape(-1, white.shape[2])
        fits.append(replace(f, residual=r, whitened=[white]))
    return replace(model, fits=fits)


def soft_and_heavy() -> list[rn.Recording]:
    """A rod with a soft spot in a medium that weighs it down."""
    recs = []
    for k in range(3):
        one = robot(drive(k))
        one = with_effect(one, "stiffness-defect", {"loss": 0.6, "place": 0.37, "width": 0.06})
        one = one.with_terms(rn.Gravity(g=0.15))
        traj = rn.Simulation(one, dt=DT, stepper="sdirk2").run(DURATION)
        t = np.arange(0.0, DURATION, 1.0 / RATE)
        seen = rn.observe([rn.Markers(one, POINTS)], traj, t)[0]
        seen = seen + SIGMA * np.random.default_rng(k).standard_normal(seen.shape)
        recs.append(rn.Recording(t, seen, names=list("abcd"), name=f"trial{k}", attrs=drive(k)))
    return recs


def left_with(base: Fitted, size: float) -> Fitted:
    """The same model, with more samples, of unit noise and a slow wave of some size."""
    rng, fits, more = np.random.default_rng(1), [], 12
    for f in base.fits:
        shape = more * len(f.whitened[0]), *f.whitened[0].shape[1:]
        white = rng.standard_normal(shape) + size * np.sin(np.linspace(0.0, 6.0, shape[0]))[:, None, None]
        long = replace(f, whitened=[white], seen=[np.ones(shape[:2], bool)], residual=white.ravel())
        long = replace(long, t=np.linspace(f.t[0], f.t[-1], shape[0]))
        fits.append(replace(long, jacobian=np.tile(f.jacobian, (more, 1))))
    return replace(base, fits=fits)
