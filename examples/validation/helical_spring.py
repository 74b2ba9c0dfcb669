"""A coil spring pulled along its axis: torsion and bending of the wire."""

import matplotlib.pyplot as plt
import numpy as np
from gallery import Case, Check, show

import rodnet as rn

COIL, WIRE, TURNS = 0.01, 5e-4, 4  # m: radius of the coil, radius of the wire; whole turns
MATERIAL = rn.Material(E=2e9, nu=0.3)
EI = MATERIAL.E * np.pi / 4 * WIRE**4
GJ = MATERIAL.G * np.pi / 2 * WIRE**4
EA = MATERIAL.E * np.pi * WIRE**2
ANGLES = [5.0, 15.0, 30.0, 45.0]  # pitch angle of the helix [degrees]
PULL = 1e-4 * EI / COIL**2


def spring(angle, edges_per_turn):
    """A helix about z whose ends are joined to its axis by stiff arms: hinged below, pulled above."""
    turn = np.linspace(0, 2 * np.pi * TURNS, edges_per_turn * TURNS + 1)
    rise = COIL * np.tan(np.radians(angle))  # per radian
    # corners outside by as much as middles are inside: the same turns of wire
    out = COIL / np.sqrt(np.sinc(1 / edges_per_turn))
    points = np.stack([out * np.cos(turn), out * np.sin(turn), rise * turn], axis=1)
    fig = rn.StickFigure()
    fig.rod("wire", list(points), material=MATERIAL, radius=WIRE)
    fig.rigid("foot", ["wire.start", (0, 0, 0)])
    fig.rigid("top", ["wire.end", (0, 0, points[-1, 2])])
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Hinge(at="foot.end")]
    terms.append(rn.PointForce(at="top.end", force=(0, 0, PULL)))
    return rn.Robot(fig.build(), terms)


def stiffness(angle, edges_per_turn):
    robot = spring(angle, edges_per_turn)
    top = robot.graph.node("top.end")
    return PULL / (rn.equilibrium(robot, residual=1e-9).x[-1, top, 2] - robot.graph.x0[top, 2])


def theory(angle):
    """N/m; the wire carries the force and its moment about the wire, PULL x COIL, at the pitch angle."""
    a = np.radians(angle)
    length = 2 * np.pi * COIL * TURNS / np.cos(a)
    give = COIL**2 * (np.cos(a) ** 2 / GJ + np.sin(a) ** 2 / EI) + np.sin(a) ** 2 / EA
    return 1 / (length * give)


def main():
    sizes = [16, 32, 64]
    found = {a: [stiffness(a, n) for n in sizes] for a in ANGLES}
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
    fine = np.linspace(0, 60, 121)
    left.plot(fine, [theory(a) for a in fine], "k", label="theory")
    left.plot(ANGLES, [k[-1] for k in found.values()], "o", label="rodnet")
    left.set(xlabel="pitch angle [degrees]", ylabel="stiffness [N/m]", ylim=(0, None))
    left.legend()
    for a, those in found.items():
        errors = np.abs(np.array(those) / theory(a) - 1)
        right.loglog(sizes, errors, "o-", label=f"{a:g}°")
    right.set(xlabel="edges per turn", title="relative error")
    right.legend()
    checks = [Check(f"stiffness at a pitch of {a:g}° [N/m]", theory(a), k[-1]) for a, k in found.items()]
    return Case("Helical spring", checks, figure, "Love 1927, art. 271; Timoshenko, Strength of Materials II")


if __name__ == "__main__":
    show(main)
