"""One rod, or two rods joined end to end, one of them drawn backwards: the joint must not show."""

import matplotlib.pyplot as plt
from gallery import Case, Check, show

import rodnet as rn

L, R, EDGES = 0.2, 2e-3, 24
MATERIAL = rn.Material(E=1e7)
FORCE, TORQUE = (0.0, 2e-3, -5e-3), (1e-3, 0, 0)  # N, N m: large, out of the plane


def one():
    fig = rn.StickFigure()
    fig.rod("beam", [(0, 0, 0), (L, 0, 0)], edges=EDGES, material=MATERIAL, radius=R)
    return fig


def two():
    """The same beam drawn as a third and two thirds, the latter from its free end."""
    fig = rn.StickFigure()
    fig.rod("beam", [(0, 0, 0), (L / 3, 0, 0)], edges=EDGES // 3, material=MATERIAL, radius=R)
    fig.rod("rest", [(L, 0, 0), "beam.end"], edges=EDGES - EDGES // 3, material=MATERIAL, radius=R)
    return fig


def robot(fig, tip, edge):
    loads = [rn.PointForce(at=tip, force=FORCE), rn.PointTorque(on=edge, torque=TORQUE)]
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Clamp(at="beam.start"), *loads]
    return rn.Robot(fig.build(), terms)


def main():
    single = robot(one(), "beam.end", f"beam:{EDGES - 1}-{EDGES}")
    double = robot(two(), "rest.start", "rest:0-1")
    rests = [rn.equilibrium(r, residual=1e-10) for r in (single, double)]
    tips = [
        traj.x[-1, traj.robot.graph.node(tip)]
        for traj, tip in zip(rests, ("beam.end", "rest.start"), strict=True)
    ]
    swings = [rn.modes(traj.robot, traj.state(), count=3).frequency for traj in rests]

    figure = plt.figure(figsize=(5.5, 4), layout="constrained")
    axes = figure.add_subplot(projection="3d")
    axes.plot(*rests[0].x[-1].T, "k", lw=4, alpha=0.3, label="one rod")
    for name, rod in rests[1].rods.items():
        axes.plot(*rests[1].x[-1, rod.nodes].T, "o-", ms=3, label=f"two rods: {name}")
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axes.set_aspect("equal")
    axes.legend()
    checks = [
        Check(f"{axis} of the end [mm]", 1e3 * a, 1e3 * b) for axis, a, b in zip("xyz", *tips, strict=True)
    ]
    checks += [
        Check(f"frequency {k + 1} about it [Hz]", a, b) for k, (a, b) in enumerate(zip(*swings, strict=True))
    ]
    return Case("Two rods joined", checks, figure, "the same beam drawn as one rod")


if __name__ == "__main__":
    show(main)
