"""Coulomb's friction on a plane: how far a rod slides that was thrown, and how it goes down a slope."""

import matplotlib.pyplot as plt
import numpy as np
from gallery import Case, Check, show

import rodnet as rn

LENGTH, R, G = 0.1, 2e-3, 9.81  # m, m, m/s^2
FRICTION, SPEED = 0.3, 1.0  # 1, m/s
SLOPES = [10.0, 16.0, 18.0, 25.0, 35.0]  # degrees; it slides above arctan 0.3 = 16.7


def rod(angle):
    """The rod along the line of fall of a plane, at the height where the plane carries it."""
    a = np.radians(angle)
    normal, down = np.array([np.sin(a), 0, np.cos(a)]), np.array([np.cos(a), 0, -np.sin(a)])
    start = 1.0999 * R * normal
    fig = rn.StickFigure()
    fig.rod("rod", [start, start + LENGTH * down], edges=4, material=rn.Material(E=1e7), radius=R)
    plane = rn.PlaneContact((0, 0, 0), normal, friction=FRICTION, slip=1e-4)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(g=G), plane]
    return rn.Robot(fig.build(), terms), down


def throw():
    robot, _ = rod(0.0)
    velocity = np.tile([SPEED, 0, 0], (robot.graph.node_count, 1))
    return rn.Simulation(robot, 1e-3, stepper="sdirk2", velocity=velocity).run(0.4)


def slide(angle):
    """Acceleration down the slope over the second half of 0.2 s."""
    robot, down = rod(angle)
    traj = rn.Simulation(robot, 2e-3, stepper="sdirk2").run(0.2)
    speed = (traj.v @ down).mean(axis=1)
    half = len(traj) // 2
    return (speed[-1] - speed[half]) / (traj.t[-1] - traj.t[half])


def main():
    thrown = throw()
    way = (thrown.x[:, :, 0] - thrown.x[0, :, 0]).mean(axis=1)
    slides = [slide(a) for a in SLOPES]
    slopes = np.linspace(0, 40, 161)
    theory = lambda a: G * np.maximum(np.sin(np.radians(a)) - FRICTION * np.cos(np.radians(a)), 0)  # noqa: E731

    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
    t = np.minimum(thrown.t, SPEED / (FRICTION * G))
    left.plot(thrown.t, SPEED * t - FRICTION * G * t**2 / 2, "k", label="theory")
    left.plot(thrown.t[::20], way[::20], "o", label="rodnet")
    left.set(xlabel="t [s]", ylabel="way [m]", title="thrown at 1 m/s")
    left.legend()
    right.plot(slopes, theory(slopes), "k")
    right.plot(SLOPES, slides, "o")
    right.set(xlabel="slope [degrees]", ylabel="acceleration [m/s²]")
    checks = [Check("way to rest [m]", SPEED**2 / (2 * FRICTION * G), way[-1])]
    checks += [
        Check(f"acceleration on a slope of {a:g}° [m/s²]", float(theory(a)), found)
        for a, found in zip(SLOPES, slides, strict=True)
    ]
    return Case("Coulomb's friction", checks, figure, "Coulomb 1785")


if __name__ == "__main__":
    show(main)
