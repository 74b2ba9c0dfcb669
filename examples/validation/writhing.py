"""A long twisted rod whose ends approach writhes in one place: Coyne's relation of slack, torque and tension."""

import matplotlib.pyplot as plt
import numpy as np
from gallery import Case, Check, show

import rodnet as rn

L, R, EDGES = 1.0, 1e-3, 320  # m
MATERIAL = rn.Material(E=1e8, nu=0.3)
EI = MATERIAL.E * np.pi / 4 * R**4
GJ = MATERIAL.G * np.pi / 2 * R**4
PULL = (20.0 / L) ** 2 * EI  # N: the rod is 20 times as long as sqrt(EI / PULL)
RATIOS = [0.75, 0.6, 0.4]  # T^2 / (4 EI PULL)


def localised(ratio):
    """Coyne's shape of an endless rod, cut to the length L, shape (EDGES + 1, 3)."""
    s = L * (np.arange(20 * EDGES) + 0.5) / (20 * EDGES) - L / 2
    scale, rest = np.sqrt(EI / PULL), np.sqrt(1 - ratio)
    cosine = 1 - 2 * rest**2 / np.cosh(s * rest / scale) ** 2  # of the angle against the axis
    turn = np.cumsum(2 * np.sqrt(ratio) / scale / (1 + cosine)) * L / (20 * EDGES)
    sine = np.sqrt(1 - cosine**2)
    tangents = np.stack([cosine, sine * np.cos(turn), sine * np.sin(turn)], axis=1)
    steps = tangents.reshape(EDGES, 20, 3).sum(axis=1)
    return np.vstack(
        [np.zeros(3), np.cumsum(L / EDGES * steps / np.linalg.norm(steps, axis=1)[:, None], axis=0)]
    )


def writhed(ratio):
    """Equilibrium of a straight rod with a natural twist, for a round rod the same as a turned end."""
    torque = np.sqrt(4 * ratio * EI * PULL)
    fig = rn.StickFigure()
    fig.rod("cable", list(localised(ratio)), material=MATERIAL, radius=R, natural_twist=-torque / GJ)
    walls = [rn.Clamp(at="cable.start", name="left"), rn.Clamp(at="cable.end", name="right")]
    return rn.equilibrium(rn.Robot(fig.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), *walls]))


def main():
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
    checks, points = [], []
    for start in RATIOS:
        rest = writhed(start)
        pull, torque = rest.reactions["right"].force[-1, 0], rest.reactions["right"].moment[-1, 0]
        lengths = np.linalg.norm(np.diff(rest.x[-1], axis=0), axis=1).sum()
        slack = lengths - (rest.x[-1, -1, 0] - rest.x[-1, 0, 0])
        # the localised helix of an endless rod (Coyne 1990)
        ratio = torque**2 / (4 * EI * pull)
        theory = 4 * np.sqrt(EI / pull) * np.sqrt(1 - ratio)
        checks.append(Check(f"slack at T²/(4 EI P) = {ratio:.3f} [mm]", 1e3 * theory, 1e3 * slack))
        points.append((ratio, slack * np.sqrt(pull / EI)))
        left.plot(*rest.x[-1, :, :2].T, label=f"{1e3 * slack:.0f} mm")
    left.set(xlabel="x [m]", ylabel="y [m]", title="ends approached by")
    left.legend()
    fine = np.linspace(0, 1, 201)
    right.plot(fine, 4 * np.sqrt(1 - fine), "k", label="Coyne")
    right.plot(*np.array(points).T, "o", label="rodnet")
    right.set(xlabel=r"$T^2/(4\,EI\,P)$", ylabel=r"slack $\sqrt{P/EI}$")
    right.legend()
    return Case("Writhing", checks, figure, "Coyne 1990, IEEE J. Oceanic Eng. 15, 72")


if __name__ == "__main__":
    show(main)
