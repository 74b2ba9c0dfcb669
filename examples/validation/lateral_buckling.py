"""A strip on edge, clamped and loaded at its end, tips over sideways at the load of Prandtl and Michell."""

import matplotlib.pyplot as plt
import numpy as np
from gallery import Case, Check, show

import rodnet as rn

L, HEIGHT, WIDTH = 0.2, 0.02, 4e-4  # m
MATERIAL = rn.Material(E=1e9, nu=0.4)
SECTION = rn.Section(
    area=HEIGHT * WIDTH,
    I1=WIDTH * HEIGHT**3 / 12,  # bending of the strip on edge, along m1
    I2=HEIGHT * WIDTH**3 / 12,  # bending sideways
    J=HEIGHT * WIDTH**3 / 3,
    radius=0.5 * WIDTH,
)
SOFT, GJ = MATERIAL.E * SECTION.I2, MATERIAL.G * SECTION.J
THEORY = 4.01260 * np.sqrt(SOFT * GJ) / L**2  # N


def strip(load, edges=64, push=0.0):
    fig = rn.StickFigure()
    fig.rod(
        "strip", [(0, 0, 0), (L, 0, 0)], edges=edges, material=MATERIAL, section=SECTION, director=(0, 0, 1)
    )
    force = rn.PointForce(at="strip.end", force=(0, push, -load))
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Clamp(at="strip.start"), force]
    return rn.Robot(fig.build(), terms)


def main():
    found = rn.critical_load(strip, 0.8 * THEORY, 1.2 * THEORY, steps=1)

    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
    mode = found.mode
    left.plot(np.linspace(0, 1, 65), np.abs(mode.x[0, :, 1]), label="sideways")
    turn = mode.theta[0].real * 0.5 * HEIGHT
    left.plot((np.arange(64) + 0.5) / 64, np.abs(turn), label="half height × turn")
    left.set(xlabel="x / L", title="buckling mode")
    left.legend()
    loads = np.linspace(0.5, 1.3, 17)
    state, out = None, []
    for load in loads[::-1]:  # a little push sideways makes the loss of stability gradual
        rest = rn.equilibrium(strip(load * THEORY, 24, push=1e-3 * THEORY), start=state)
        state = rest.state()
        out.append(abs(rest.x[-1, -1, 1]) / L)
    right.plot(loads[::-1], out, "o-")
    right.axvline(1.0, color="0.7")
    right.set(xlabel="load / theory", title="sideways displacement / L")
    checks = [Check("load at buckling [mN]", 1e3 * THEORY, 1e3 * found.load)]
    return Case("Lateral-torsional buckling", checks, figure, "Prandtl 1899; Michell 1899")


if __name__ == "__main__":
    show(main)
