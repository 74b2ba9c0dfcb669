"""A shaft between hinges under torque and thrust or pull buckles into a helix on Greenhill's parabola."""

import matplotlib.pyplot as plt
import numpy as np
from gallery import Case, Check, show

import rodnet as rn

L, R = 0.2, 1e-3  # m
MATERIAL = rn.Material(E=1e7)
EI = MATERIAL.E * np.pi / 4 * R**4
EULER = np.pi**2 * EI / L**2  # N, without torque
PULLS = [-0.75, 0.0, 2.0]  # tension over Euler's load


def shaft(torque, pull, edges=96):
    """The shaft under ``torque`` in units of EI / L and ``pull`` in units of Euler's load, both along x."""
    fig = rn.StickFigure()
    fig.rod("shaft", [(0, 0, 0), (L, 0, 0)], edges=edges, material=MATERIAL, radius=R)
    stretch = pull * EULER / (MATERIAL.E * np.pi * R**2)
    twist = torque * EI / L
    ends = rn.PrescribedMotion(at="shaft.end", position=lambda t: np.array([stretch * L, 0, 0]), name="slide")
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Hinge(at="shaft.start"), ends]
    terms += [
        rn.PointTorque(on="shaft:0-1", torque=(-twist, 0, 0), name="left"),
        rn.PointTorque(on=f"shaft:{edges - 1}-{edges}", torque=(twist, 0, 0), name="right"),
    ]
    return rn.Robot(fig.build(), terms)


def main():
    found = []
    for pull in PULLS:
        theory = 2 * np.pi * np.sqrt(1 + pull)
        buckled = rn.critical_load(lambda m, p=pull: shaft(m, p), 0.6 * theory, 1.2 * theory, steps=2)
        found.append((pull, theory, buckled))

    figure = plt.figure(figsize=(9, 3.4), layout="constrained")
    left, right = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2, projection="3d")
    fine = np.linspace(-1, 2.2, 200)
    left.plot(fine, 2 * np.pi * np.sqrt(1 + fine), "k", label="Greenhill")
    left.plot(PULLS, [b.load for _, _, b in found], "o", label="rodnet")
    left.set(xlabel="tension / Euler's load", ylabel="torque at buckling [EI / L]")
    left.legend()
    pull, _, buckled = found[1]
    shape = shaft(0.0, pull).graph.x0 + 0.1 * L * buckled.mode.x[0].real
    right.plot(*shape.T)
    right.set_title("buckling mode without tension")
    right.set_box_aspect((3, 1, 1))
    checks = [Check(f"torque L/EI at a tension of {p:g} P_Euler", theory, b.load) for p, theory, b in found]
    return Case("Greenhill's shaft", checks, figure, "Greenhill 1883; Love 1927, art. 272")


if __name__ == "__main__":
    show(main)
