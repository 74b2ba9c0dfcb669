"""A clamped cable that swings, and recordings of it."""

import numpy as np

import rodnet as rn

POINTS = {"mid": "cable@50%", "tip": "cable.end"}
DT = 0.01


def cable(E=2e6, rate=1.5, edges=4):
    figure = rn.StickFigure()
    material = rn.Material(E=E, nu=0.5, rho=1200.0)
    figure.rod("cable", [(0, 0, 0), (0.2, 0, -0.1)], edges=edges, material=material, radius=4e-3)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), rn.Clamp(at="cable.start")]
    return rn.Robot(figure.build(), [*terms, rn.MassDamping(rate=rate)])


def eyes(rec, robot):
    return rn.Markers(robot, POINTS)


def record(robot, noise, seed=0, duration=0.3, lag=0.0, **options):
    """A trial with noise; every step is a frame."""
    traj = rn.Simulation(robot, dt=DT, stepper="sdirk2", **options).run(duration)
    (seen,) = rn.observe(rn.Markers(robot, POINTS, lag=lag), traj, traj.t)
    error = noise.sample(traj.t, len(POINTS), np.random.default_rng(seed))
    return rn.Recording(traj.t, seen + error, names=list(POINTS), noise=noise, name=f"trial{seed}")
