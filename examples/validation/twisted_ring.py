"""A ring of a straight, twisted rod writhes out of its plane at Michell's twist."""

import matplotlib.pyplot as plt
import numpy as np
from gallery import Case, Check, order, show

import rodnet as rn

RADIUS, R = 0.1, 2e-3  # of the ring, of the rod [m]
RATIOS = {0.5: 1.5, 0.25: 1.25, 0.0: 1.0}  # Poisson's ratio -> EI / GJ = 1 + nu


def ring(turn, nu, edges):
    """A straight rod bent to a ring and joined after one end has been turned by ``turn`` against the other.

    A round rod that is twisted by some angle per length is one whose natural shape is twisted the other way.
    """
    angles = 2 * np.pi * np.arange(edges) / edges
    points = RADIUS * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    fig = rn.StickFigure()
    fig.rod(
        "ring", list(points), closed=True, natural_twist=turn / (2 * np.pi * RADIUS), radius=R,
        material=rn.Material(E=1e7, nu=nu),
    )  # fmt: skip
    return rn.Robot(fig.build(), [rn.Stretching(), rn.Bending(), rn.Twisting()])


def main():
    sizes = [32, 64, 128]
    figure = plt.figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.add_subplot(1, 2, 1, projection="3d"), figure.add_subplot(1, 2, 2)
    checks = []
    for nu, ratio in RATIOS.items():
        theory = 2 * np.pi * np.sqrt(3) * ratio
        found = [
            rn.critical_load(lambda a, nu=nu, n=n: ring(a, nu, n), 0.8 * theory, 1.1 * theory, steps=1)
            for n in sizes
        ]
        errors = [abs(f.load / theory - 1) for f in found]
        right.loglog(sizes, errors, "o-", label=f"EI/GJ = {ratio:g}, order {order(sizes, errors):.2f}")
        checks.append(Check(f"critical twist at EI/GJ = {ratio:g} [rad]", theory, found[-1].load))
    right.set(xlabel="edges", title="relative error of the twist")
    right.legend()
    start, mode = ring(0, nu, sizes[-1]).graph.x0, found[-1].mode.x[0].real
    for shape, style in ((start, "k:"), (start + 0.25 * RADIUS * mode, "C0-")):
        left.plot(*np.vstack([shape, shape[:1]]).T, style)
    left.set_aspect("equal")
    left.set_title("the mode in which it buckles")
    return Case("Twisted ring", checks, figure, "Michell 1889; Zajac 1962, J. Appl. Mech. 29, 136")


if __name__ == "__main__":
    show(main)
