"""A chain that hangs from one end swings at Bernoulli's frequencies, the zeros of a Bessel function."""

import matplotlib.pyplot as plt
import numpy as np
from gallery import Case, Check, show
from scipy.special import j0, jn_zeros

import rodnet as rn

LENGTH, RADIUS, G = 0.5, 1e-4, 9.81  # m, m, m/s^2
MATERIAL = rn.Material(E=1e7, rho=4000.0)  # a thread without stiffness to speak of


def chain(edges):
    fig = rn.StickFigure()
    fig.rod("chain", [(0, 0, 0), (0, 0, -LENGTH)], edges=edges, material=MATERIAL, radius=RADIUS)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(g=G), rn.Hinge(at="chain.start")]
    return rn.Robot(fig.build(), terms)


def swings(edges, count=3):
    """The first modes in one plane; the chain also turns about itself for nothing."""
    robot = chain(edges)
    found = rn.modes(robot, rn.equilibrium(robot).state(), count=2 * count + 1)
    return found.frequency[~found.free][::2], found.x[~found.free][::2].real


def main():
    zeros = jn_zeros(0, 3)
    theory = zeros * np.sqrt(G / LENGTH) / 2 / (2 * np.pi)
    sizes = [16, 32, 64]
    found = [swings(n) for n in sizes]
    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 4), layout="constrained")
    depth = np.linspace(0, 1, 65)
    for k in range(3):
        shape = found[-1][1][k]
        along = shape @ np.linalg.svd(shape, full_matrices=False)[2][0]
        left.plot(along / along[-1], -depth, f"C{k}.-", ms=3, label=f"{found[-1][0][k]:.3f} Hz")
        left.plot(j0(zeros[k] * np.sqrt(1 - depth)), -depth, "k:", lw=1)
    left.set(ylabel="z / L", title="modes; dotted: $J_0$")
    left.legend()
    errors = np.abs(np.array([f for f, _ in found]) / theory - 1)
    for k in range(3):
        right.loglog(sizes, errors[:, k], "o-", label=f"mode {k + 1}")
    right.set(xlabel="edges", title="relative error of the frequency")
    right.legend()
    checks = [Check(f"frequency {k + 1} [Hz]", theory[k], found[-1][0][k]) for k in range(3)]
    return Case("Swinging chain", checks, figure, "Daniel Bernoulli 1733; Lamb, Higher Mechanics")


if __name__ == "__main__":
    show(main)
