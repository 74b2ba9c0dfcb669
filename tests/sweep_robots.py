"""Robots and metrics that tests of sweeps share."""

import numpy as np

import rodnet as rn

EI = 1e6 * np.pi * (2e-3) ** 4 / 4.0


def cantilever(load=1.0, edges=8, E=1e6):
    """A clamped rod with a load at its tip, [mN]."""
    if load < 0.0:
        raise ValueError(f"load = {load} pulls the wrong way")
    fig = rn.StickFigure()
    fig.rod("arm", [(0, 0, 0), (0.1, 0, 0)], edges=edges, material=rn.Material(E=E), radius=2e-3)
    force = rn.PointForce(at="arm.end", force=(0, 0, -1e-3 * load))
    return rn.Robot(
        fig.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), force, rn.Clamp(at="arm.start")]
    )


def sag(traj):
    return {"sag": -traj.at("arm.end")[-1, 2], "tip": traj.at("arm.end")[-1]}


def rest(robot):
    return rn.equilibrium(robot)


def here(grid, metrics=sag, build=cantilever, **options):
    """A sweep in this process, of equilibria unless there is a duration."""
    if "duration" not in options:
        options = {"simulate": rest, **options}
    return rn.sweep(build, grid, metrics, **{"workers": 0, **options})
