"""A clamped beam under a small force at its end, and under its own weight: Euler and Bernoulli."""

import matplotlib.pyplot as plt
import numpy as np
from gallery import Case, Check, show

import rodnet as rn

L, R, G = 0.2, 2e-3, 9.81  # m, m, m/s^2
MATERIAL = rn.Material(E=1e9, rho=1000.0)
EI = MATERIAL.E * np.pi / 4 * R**4
WEIGHT = MATERIAL.rho * np.pi * R**2 * G  # N/m
FORCE = 1e-3 * EI / L**2  # N, bends the end by L / 3000


def beam(edges, load):
    fig = rn.StickFigure()
    fig.rod("beam", [(0, 0, 0), (L, 0, 0)], edges=edges, material=MATERIAL, radius=R)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Clamp(at="beam.start"), load]
    return rn.equilibrium(rn.Robot(fig.build(), terms), residual=1e-10)


def sag(edges, load):
    return -beam(edges, load).x[-1, -1, 2]


def main():
    force, weight = rn.PointForce(at="beam.end", force=(0, 0, -FORCE)), rn.Gravity(g=G)
    by_force, by_weight = FORCE * L**3 / (3 * EI), WEIGHT * L**4 / (8 * EI)
    sizes = [8, 16, 32, 64]
    forced, heavy = [sag(n, force) for n in sizes], [sag(n, weight) for n in sizes]

    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
    x = np.linspace(0, L, 101)
    left.plot(1e3 * x, -1e6 * FORCE * x**2 * (3 * L - x) / (6 * EI), "k", label="theory")
    left.plot(*(beam(8, force).x[-1, :, ::2] * (1e3, 1e6)).T, "o", label="rodnet, 8 edges")
    left.set(xlabel="x [mm]", ylabel="z [µm]", title="force at the end")
    left.legend()
    right.loglog(sizes, np.abs(np.array(forced) / by_force - 1), "o-", label="force at the end")
    right.loglog(sizes, np.abs(np.array(heavy) / by_weight - 1), "s-", label="own weight")
    right.loglog(sizes, 0.5 / np.square(sizes, dtype=float), "k:", label="second order")
    right.set(xlabel="edges", title="relative error of the sag")
    right.legend()
    checks = [
        Check("sag under the force [µm]", 1e6 * by_force, 1e6 * forced[-1]),
        Check("sag under its weight [µm]", 1e6 * by_weight, 1e6 * heavy[-1]),
    ]
    return Case("Cantilever", checks, figure, "Euler-Bernoulli beam, linear")


if __name__ == "__main__":
    show(main)
