"""A heavy chain between two hinges: the catenary."""

import matplotlib.pyplot as plt
import numpy as np
from gallery import Case, Check, show
from scipy.optimize import brentq

import rodnet as rn

LENGTH, SPAN, G = 1.0, 0.6, 9.81  # m, m, m/s^2
RADIUS = 1e-4  # m
# so thin that neither bending nor stretching counts
MATERIAL = rn.Material(E=1e8, rho=8000.0)
WEIGHT = MATERIAL.rho * np.pi * RADIUS**2 * G  # N/m


def hang(edges):
    """Let a chain, drawn as two straight pieces, hang; return its equilibrium."""
    fig = rn.StickFigure()
    depth = 0.5 * np.sqrt(LENGTH**2 - SPAN**2)
    corners = [(-SPAN / 2, 0, 0), (0, 0, -depth), (SPAN / 2, 0, 0)]
    fig.rod("chain", corners, edges=edges, material=MATERIAL, radius=RADIUS, natural="straight")
    hinges = rn.Hinge(at=["chain.start", "chain.end"], name="hinges")
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(g=G), hinges]
    return rn.equilibrium(rn.Robot(fig.build(), terms))


def main():
    # z = a cosh(x / a): its length over half the span is a sinh(SPAN / 2a)
    a = brentq(lambda a: 2 * a * np.sinh(SPAN / (2 * a)) - LENGTH, 0.05, 5.0)
    sag = a * (np.cosh(SPAN / (2 * a)) - 1)
    pull = WEIGHT * a  # horizontal, the same everywhere

    sizes = [16, 32, 64, 128]
    found = [hang(n) for n in sizes]
    sags = [-traj.x[-1, :, 2].min() for traj in found]
    held = found[-1].reactions["hinges"].nodal[-1, -1]  # of the right hinge

    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
    x = np.linspace(-SPAN / 2, SPAN / 2, 201)
    left.plot(x, a * (np.cosh(x / a) - np.cosh(SPAN / (2 * a))), "k", label="catenary")
    left.plot(*found[0].x[-1, :, ::2].T, "o", label="rodnet, 16 edges")
    left.set(xlabel="x [m]", ylabel="z [m]", aspect="equal")
    left.legend()
    errors = np.abs(np.array(sags) / sag - 1)
    right.loglog(sizes, errors, "o-", label="sag")
    right.set(xlabel="edges", title="relative error")
    right.legend()
    checks = [
        Check("sag [m]", sag, sags[-1]),
        Check("horizontal pull [µN]", 1e6 * pull, 1e6 * held[0]),
        Check("vertical pull on a hinge [µN]", 1e6 * WEIGHT * LENGTH / 2, 1e6 * held[2]),
    ]
    return Case("Hanging chain", checks, figure, "the catenary; Bernoulli, Leibniz and Huygens 1691")


if __name__ == "__main__":
    show(main)
