"""A snake in sand: a long wave swims through grains as fast as an endless one in granular resistive force theory."""

from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
from gallery import Case, Check, show
from scipy.optimize import brentq

import rodnet as rn

WAVELENGTH, WAVES, EDGES = 0.12, 4, 24  # m along the body; waves in the body; edges per wave
RADIUS, DEPTH, FREQUENCY, STEPS = 6e-3, 0.05, 2.0, 40  # m, m, Hz, steps per period
ANGLES = [0.5, 0.8, 1.1]  # largest angle of the body against its way [rad]
GRAINS = {"surface": DEPTH, "speed": 1e-4}


def heading(angle, s):
    return -angle * np.sin(2 * np.pi * s / WAVELENGTH)


def swim(angle):
    """Way of every node over one period, once the start is forgotten; and the body at its end."""
    s = WAVELENGTH / EDGES * (np.arange(WAVES * EDGES) + 0.5)
    turn = heading(angle, s)
    steps = -WAVELENGTH / EDGES * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    fig = rn.StickFigure()
    fig.rod(
        "body", list(np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])), radius=RADIUS, natural="straight",
        material=rn.Material(E=2e9, nu=0.45, rho=100.0), director=(0, -1, 0),
    )  # fmt: skip
    wave = rn.CurvatureWave(
        amplitude=angle * 2 * np.pi / WAVELENGTH, wavelength=WAVELENGTH, frequency=FREQUENCY, phase=-np.pi / 2
    )
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), wave, rn.GranularForce(**GRAINS)]
    robot = rn.Robot(fig.build(), terms)
    return rn.Simulation(robot, 1 / (FREQUENCY * STEPS), stepper="sdirk2").run(2 / FREQUENCY)


def efficiency(traj, angle):
    """Speed over that of the wave."""
    middle = traj.x.mean(axis=1)
    way = np.linalg.norm(middle[-1] - middle[STEPS])
    s = np.linspace(0, WAVELENGTH, 2001)
    return way / np.trapezoid(np.cos(heading(angle, s)), s)


def theory(angle):
    """Efficiency of an endless snake: the force along its way vanishes on average over the wave."""
    law, s = rn.GranularForce(**GRAINS), np.linspace(0, WAVELENGTH, 401)[:-1]
    turn = heading(angle, s)
    t = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)

    def thrust(e):
        # seen from the wave the body runs along itself, and the wave goes back through the sand
        v = FREQUENCY * WAVELENGTH * (t - (1 - e) * np.array([np.cos(turn).mean(), 0, 0]))
        site = SimpleNamespace(v=v, tangent=t, x=0 * t, radius=np.full(len(t), RADIUS))
        return law.force(site, law.values())[:, 0].mean()

    return brentq(thrust, 0, 1)


def main():
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.2), layout="constrained")
    checks = []
    for k, angle in enumerate(ANGLES):
        traj = swim(angle)
        found = efficiency(traj, angle)
        for j in (STEPS, 2 * STEPS):
            left.plot(*(1e3 * traj.x[j, :, :2]).T - np.array([[0], [120 * k]]), f"C{k}", alpha=0.3 + 0.35 * j / STEPS)
        right.plot(angle, found, f"C{k}o")
        checks.append(Check(f"wave efficiency at {angle:g} rad", theory(angle), found))
    fine = np.linspace(0.2, 1.3, 23)
    right.plot(fine, [theory(a) for a in fine], "k", label="endless snake")
    left.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", title="before and after one period")
    right.set(xlabel="largest angle of the body [rad]", title="speed / speed of the wave", ylim=(0, 1))
    right.legend()
    return Case(
        "Snake in sand", checks, figure, "Maladen et al. 2009, Science 325, 314; granular resistive force theory"
    )


if __name__ == "__main__":
    show(main)
