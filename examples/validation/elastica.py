"""A clamped beam under a large force at its end: the elastica, against Mattiasson's tables."""

import matplotlib.pyplot as plt
import numpy as np
from gallery import Case, Check, show

import rodnet as rn

L, R = 0.2, 2e-4  # m; so slender that it does not stretch
MATERIAL = rn.Material(E=1e9)
EI = MATERIAL.E * np.pi / 4 * R**4
# P L^2 / EI -> shortfall (L - x) / L and sag -z / L of the end (Mattiasson 1981, table 1)
TABLE = {1.0: (0.05643, 0.30172), 2.0: (0.16064, 0.49346), 5.0: (0.38763, 0.71379), 10.0: (0.55500, 0.81061)}


def bent(load, edges=64):
    """Shape (edges + 1, 3) under the force load EI / L^2 at the end."""
    fig = rn.StickFigure()
    fig.rod("beam", [(0, 0, 0), (L, 0, 0)], edges=edges, material=MATERIAL, radius=R)
    force = rn.PointForce(at="beam.end", force=(0, 0, -load * EI / L**2))
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Clamp(at="beam.start"), force]
    return rn.equilibrium(rn.Robot(fig.build(), terms)).x[-1]


def main():
    figure, axes = plt.subplots(figsize=(5, 4), layout="constrained")
    checks = []
    for load, (short, sag) in TABLE.items():
        x = bent(load) / L
        axes.plot(x[:, 0], x[:, 2], label=f"$PL^2/EI={load:g}$")
        axes.plot(1 - short, -sag, "k+", ms=12)
        checks.append(Check(f"(L - x)/L of the end at P L²/EI = {load:g}", short, 1 - x[-1, 0]))
        checks.append(Check(f"-z/L of the end at P L²/EI = {load:g}", sag, -x[-1, 2]))
    axes.set(xlabel="x / L", ylabel="z / L", aspect="equal", title="crosses: Mattiasson's tables")
    axes.legend()
    return Case("Elastica", checks, figure, "Mattiasson 1981, Int. J. Numer. Meth. Eng. 17, 145")


if __name__ == "__main__":
    show(main)
