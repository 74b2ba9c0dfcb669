"""A snake in sand: waves of curvature swim through grains as granular resistive force theory says."""

from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
from gallery import Case, Check, show
from scipy.optimize import brentq, fsolve

import rodnet as rn

LENGTH, EDGES = 0.12, 80  # m, one wave long
RADIUS, DEPTH, FREQUENCY, STEPS = 1e-3, 0.05, 2.0, 40  # m, m, Hz, steps per period
ANGLES = [0.5, 0.8, 1.1]  # largest angle of the body against its way [rad]
GRAINS = {"CF": 1.8e5, "CS": 4.2e5, "gamma": 4.0, "surface": DEPTH, "speed": 1e-4}  # of no particular medium


def heading(angle, s):
    return -angle * np.sin(2 * np.pi * s / LENGTH)


def swim(angle):
    """Let it swim for two periods."""
    s = LENGTH / EDGES * (np.arange(EDGES) + 0.5)
    turn = heading(angle, s)
    steps = -LENGTH / EDGES * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    fig = rn.StickFigure()
    fig.rod(
        "body", list(np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])), radius=RADIUS, natural="straight",
        material=rn.Material(E=5e11, nu=0.45, rho=100.0), director=(0, -1, 0),
    )  # fmt: skip
    wave = rn.CurvatureWave(
        amplitude=angle * 2 * np.pi / LENGTH, wavelength=LENGTH, frequency=FREQUENCY, phase=-np.pi / 2
    )
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), wave, rn.GranularForce(**GRAINS)]
    robot = rn.Robot(fig.build(), terms)
    return rn.Simulation(robot, 1 / (FREQUENCY * STEPS), stepper="sdirk2").run(2 / FREQUENCY)


def endless(angle):
    """Efficiency of an endless snake: the force along its way vanishes on average over the wave."""
    law, s = rn.GranularForce(**GRAINS), np.linspace(0, LENGTH, 401)[:-1]
    turn = heading(angle, s)
    t = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)

    def thrust(e):
        # seen from the wave the body runs along itself, and the wave goes back through the sand
        v = FREQUENCY * LENGTH * (t - (1 - e) * np.array([np.cos(turn).mean(), 0, 0]))
        site = SimpleNamespace(v=v, tangent=t, x=0 * t, radius=np.full(len(t), RADIUS))
        return law.force(site, law.values())[:, 0].mean()

    return brentq(thrust, 0, 1)


def theory(angle, points=200, steps=80):
    """Middle of a body that is bent exactly as the wave says, without inertia: no net force, no net moment."""
    law = rn.GranularForce(**GRAINS)
    p, s = law.values(), LENGTH * (np.arange(points) + 0.5) / points
    radius, middle, velocity = np.full(points, RADIUS), [], np.array([-0.1, 0.0, 0.0])
    place, way = np.zeros(2), 0.0  # of the head, and the turn of the body
    h = 1 / (FREQUENCY * steps)

    def shape(t):
        """Points of the body from its head, and tangents, in axes that turn with it."""
        phi = angle * np.sin(2 * np.pi * (FREQUENCY * t - s / LENGTH))
        tangent = -np.stack([np.cos(phi), np.sin(phi)], axis=1)
        line = LENGTH / points * (np.cumsum(tangent, axis=0) - 0.5 * tangent)
        return line, tangent

    def balance(u, line, tangent, rate):
        v = u[:2] + rate + u[2] * np.stack([-line[:, 1], line[:, 0]], axis=1)
        flat = lambda a: np.column_stack([a, np.zeros(points)])  # noqa: E731
        f = law.force(SimpleNamespace(v=flat(v), tangent=flat(tangent), x=flat(0 * v), radius=radius), p)[
            :, :2
        ]
        moment = line[:, 0] * f[:, 1] - line[:, 1] * f[:, 0]
        return np.array([*f.mean(axis=0), moment.mean() / LENGTH])

    def turned(a):
        return np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])

    for k in range(2 * steps + 1):
        t = k * h
        middle.append(place + turned(way) @ shape(t)[0].mean(axis=0))
        line, tangent = shape(t + h / 2)
        rate = (shape(t + h)[0] - shape(t)[0]) / h
        velocity = fsolve(balance, velocity, args=(line, tangent, rate), xtol=1e-10)
        place = place + h * turned(way + h / 2 * velocity[2]) @ velocity[:2]
        way += h * velocity[2]
    return np.array(middle)


def main():
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.2), layout="constrained")
    checks = []
    for k, angle in enumerate(ANGLES):
        traj = swim(angle)
        middle, expected = traj.x.mean(axis=1), theory(angle)
        way = np.linalg.norm(middle[2 * STEPS] - middle[STEPS])
        half = len(expected) // 2
        exact = np.linalg.norm(expected[-1] - expected[half])
        wave = LENGTH * np.cos(heading(angle, np.linspace(0, LENGTH, 1001)))[:-1].mean()
        for j in (STEPS, 2 * STEPS):
            left.plot(
                *(1e3 * traj.x[j, :, :2]).T - np.array([[0], [120 * k]]),
                f"C{k}",
                alpha=0.3 + 0.35 * j / STEPS,
            )
        right.plot(angle, way / wave, f"C{k}o")
        right.plot(angle, exact / wave, "k+", ms=12, label="force and moment in balance" if k == 0 else None)
        checks.append(Check(f"way per period [mm], waves of {angle:g} rad", 1e3 * exact, 1e3 * way))
    fine = np.linspace(0.2, 1.3, 23)
    right.plot(fine, [endless(a) for a in fine], "k:", label="endless snake")
    left.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", title="before and after one period")
    right.set(xlabel="largest angle of the body [rad]", title="speed / speed of the wave", ylim=(0, 1))
    right.legend()
    return Case(
        "Snake in sand",
        checks,
        figure,
        "Maladen et al. 2009, Science 325, 314; granular resistive force theory",
    )


if __name__ == "__main__":
    show(main)
