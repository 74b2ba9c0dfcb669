"""A stretched net under its weight: many loops, in balance by the force density method."""

import matplotlib.pyplot as plt
import numpy as np
from gallery import Case, Check, show

import rodnet as rn

RODS, PITCH, RADIUS, G = 9, 0.05, 3e-4, 9.81  # cords each way with the rim, m, m
MATERIAL = rn.Material(E=1e8, rho=3000.0)
TENSION = 0.2  # N in every cord, for which it is drawn out
EA = MATERIAL.E * np.pi * RADIUS**2


def net():
    """Cords with natural length PITCH / (1 + TENSION / EA) between crossings, drawn out to the pitch by the rim."""
    fig = rn.StickFigure()
    pitch = PITCH / (1 + TENSION / EA)
    at = pitch * np.arange(RODS)
    for k, c in enumerate(at):
        fig.rod(f"x{k}", [(x, c, 0) for x in at], material=MATERIAL, radius=RADIUS)
    for k in range(RODS):
        fig.rod(f"y{k}", [f"x{row}:{k}" for row in range(RODS)], material=MATERIAL, radius=RADIUS)
    return fig.build()


def hang():
    graph = net()
    rim = [f"x{k}" for k in (0, RODS - 1)] + [f"y{k}" for k in (0, RODS - 1)]
    rim = sorted({graph.node_name(int(n)) for n in graph.nodes(rim)})

    class Stretch(rn.Constraint):
        """Holds the rim drawn out in the plane by a factor that comes up from 1 within a second."""

        def position(self, t, x0, p):
            return x0 * (1 + TENSION / EA * min(t, 1.0))

    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(g=G), Stretch(at=rim, name="rim")]
    return rn.equilibrium(rn.Robot(graph, terms), t=1.0)


def force_densities(graph, held):
    """Heights of the nodes where every cord has the force density TENSION / PITCH (Schek 1974), shape (N,)."""
    branch = np.zeros((graph.edge_count, graph.node_count))
    rows = np.arange(graph.edge_count)
    branch[rows, graph.edges[:, 0]], branch[rows, graph.edges[:, 1]] = -1, 1
    balance = TENSION / PITCH * branch.T @ branch
    free = np.setdiff1d(np.arange(graph.node_count), held)
    z = np.zeros(graph.node_count)
    z[free] = np.linalg.solve(balance[np.ix_(free, free)], -G * graph.node_mass[free])
    return z


def main():
    traj = hang()
    graph, z = traj.robot.graph, traj.x[-1, :, 2]
    edge = np.abs(graph.x0[:, :2] - graph.x0[:, :2].mean(axis=0)).max(axis=1)
    held = np.flatnonzero(edge > edge.max() * (1 - 1e-9))
    expected = force_densities(graph, held)

    figure = plt.figure(figsize=(5.5, 4), layout="constrained")
    axes = figure.add_subplot(projection="3d")
    for rod in traj.rods.values():
        axes.plot(*traj.x[-1, rod.nodes, :2].T, 1e3 * z[rod.nodes], "C0", lw=1)
    axes.plot(*traj.x[-1, :, :2].T, 1e3 * expected, "k.", ms=3, label="force density method")
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [mm]")
    axes.legend()
    middle, quarter = graph.node(f"x{RODS // 2}:{RODS // 2}"), graph.node(f"x{RODS // 4}:{RODS // 4}")
    support = traj.reactions["rim"].force[-1, 2]
    checks = [
        Check("sag in the middle [mm]", -1e3 * expected[middle], -1e3 * z[middle]),
        Check("sag at the quarter [mm]", -1e3 * expected[quarter], -1e3 * z[quarter]),
        Check("what the rim carries [N]", G * graph.node_mass.sum(), support),
    ]
    return Case("Stretched net", checks, figure, "force density method; Schek 1974, CMAME 3, 115")


if __name__ == "__main__":
    show(main)
