"""A long twisted rod whose ends approach writhes in one place: Coyne's relation of slack, torque and tension."""

import matplotlib.pyplot as plt
import numpy as np
from gallery import Case, Check, show
from scipy.optimize import brentq

import rodnet as rn

L, R, EDGES = 1.0, 1e-3, 200  # m
MATERIAL = rn.Material(E=1e8, nu=0.3)
EI = MATERIAL.E * np.pi / 4 * R**4
GJ = MATERIAL.G * np.pi / 2 * R**4
TURN = 16 * np.pi  # of one end against the other, put in before the ends approach [rad]
SLACKS = [0.08, 0.11, 0.14]  # m by which the ends approach


def bump(slack):
    """A plane curve of length L whose ends lie in line, L - slack apart, shape (EDGES + 1, 3)."""
    x = np.linspace(0, L - slack, 4001)
    hill = np.exp(-(((x - x[-1] / 2) / (0.1 * L)) ** 2))

    def arc(height):
        steps = np.hypot(np.diff(x), height * np.diff(hill))
        return np.concatenate([[0], np.cumsum(steps)])

    height = brentq(lambda h: arc(h)[-1] - L, 0, L)
    at = np.linspace(0, L, EDGES + 1)
    line = np.stack([x, height * hill, 0 * x], axis=1)
    return np.stack([np.interp(at, arc(height), c) for c in line.T], axis=1)


def writhed(slack):
    """Equilibrium of a straight rod with a natural twist, for a round rod the same as a turned end."""
    fig = rn.StickFigure()
    fig.rod("cable", list(bump(slack)), material=MATERIAL, radius=R, natural_twist=TURN / L)
    walls = [rn.Clamp(at="cable.start", name="left"), rn.Clamp(at="cable.end", name="right")]
    return rn.equilibrium(rn.Robot(fig.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), *walls]))


def main():
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
    checks, ratios = [], []
    for slack in SLACKS:
        rest = writhed(slack)
        pull, torque = rest.reactions["right"].force[-1, 0], rest.reactions["right"].moment[-1, 0]
        stretch = pull / (MATERIAL.E * np.pi * R**2) * L
        # the localised helix of an endless rod (Coyne 1990, eq. 22)
        ratio = torque**2 / (4 * EI * pull)
        theory = 4 * np.sqrt(EI / pull) * np.sqrt(1 - ratio)
        checks.append(Check(f"slack at T²/(4 EI P) = {ratio:.3f} [mm]", 1e3 * theory, 1e3 * (slack + stretch)))
        ratios.append((ratio, theory * np.sqrt(pull / EI), (slack + stretch) * np.sqrt(pull / EI)))
        left.plot(*rest.x[-1, :, :2].T, label=f"{1e3 * slack:g} mm")
    left.set(xlabel="x [m]", ylabel="y [m]", title="ends approached by")
    left.legend()
    fine = np.linspace(0, 1, 201)
    right.plot(fine, 4 * np.sqrt(1 - fine), "k", label="Coyne")
    right.plot(*np.array([(r, f) for r, _, f in ratios]).T, "o", label="rodnet")
    right.set(xlabel=r"$T^2/(4\,EI\,P)$", ylabel=r"slack $\sqrt{P/EI}$")
    right.legend()
    return Case("Writhing", checks, figure, "Coyne 1990, IEEE J. Oceanic Eng. 15, 72")


if __name__ == "__main__":
    show(main)
