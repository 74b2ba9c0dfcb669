"""A rigid helix in resistive force theory: thrust, torque and drag in closed form, and its speed of swimming."""

import matplotlib.pyplot as plt
import numpy as np
from gallery import Case, Check, order, show

import rodnet as rn

RADIUS, PITCH, TURNS, R = 0.01, 0.04, 3, 5e-4  # of the helix [m]; whole turns; of the rod [m]
ALONG, ACROSS = 1.3, 2.1  # drag coefficients [Pa s]
SPEED, SPIN = 0.02, 3.0  # m/s, rad/s


def helix(edges_per_turn, pitch=PITCH):
    """A helix about x with whole turns, nodes on the curve."""
    turn = np.linspace(0, 2 * np.pi * TURNS, edges_per_turn * TURNS + 1)
    points = np.stack([pitch * turn / 2 / np.pi, RADIUS * np.cos(turn), RADIUS * np.sin(turn)], axis=1)
    fig = rn.StickFigure()
    fig.rod("helix", list(points), material=rn.Material(E=1e9), radius=R)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.ResistiveForce(eta_t=ALONG, eta_n=ACROSS)]
    return rn.Robot(fig.build(), terms)


def drag(robot, speed, spin):
    """Force and moment of the drag along x at a velocity along x and a spin about it."""
    x = robot.graph.x0
    velocity = speed * np.eye(3)[0] + spin * np.cross(np.eye(3)[0], x)
    traj = rn.Simulation(robot, 1e-6, velocity=velocity).run(1e-6)
    forces = traj.term_forces("drag", [0])[0]
    return forces.sum(axis=0)[0], np.cross(x, forces).sum(axis=0)[0]


def theory(pitch):
    """Resistances A, B, D: force -A speed + B spin and moment B speed - D spin (Lauga & Powers 2009, eq. 62 f.)."""
    angle = np.arctan2(2 * np.pi * RADIUS, pitch)  # of the helix against its axis
    length = TURNS * pitch / np.cos(angle)
    c, s = np.cos(angle), np.sin(angle)
    return (
        length * (ALONG * c**2 + ACROSS * s**2),
        length * (ACROSS - ALONG) * RADIUS * s * c,
        length * RADIUS**2 * (ALONG * s**2 + ACROSS * c**2),
    )


def main():
    sizes = [12, 24, 48]
    A, B, D = theory(PITCH)
    found = []
    for n in sizes:
        robot = helix(n)
        (pull, _), (thrust, torque) = drag(robot, SPEED, 0.0), drag(robot, 0.0, SPIN)
        found.append((-pull / SPEED, abs(thrust) / SPIN, -torque / SPIN))
    pitches = np.linspace(0.01, 0.2, 12)
    swims = []
    for pitch in pitches:
        robot = helix(24, pitch)
        swims.append(abs(drag(robot, 0.0, SPIN)[0] / drag(robot, SPEED, 0.0)[0] * SPEED))

    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
    fine = np.linspace(0.005, 0.2, 200)
    left.plot(fine / RADIUS, [theory(p)[1] / theory(p)[0] / RADIUS for p in fine], "k", label="theory")
    left.plot(pitches / RADIUS, np.array(swims) / (SPIN * RADIUS), "o", label="rodnet")
    left.set(xlabel="pitch / radius", ylabel="speed of swimming / (spin × radius)")
    left.legend()
    for k, name in enumerate(("drag", "thrust", "torque")):
        errors = np.abs(np.array(found)[:, k] / (A, B, D)[k] - 1)
        right.loglog(sizes, errors, "o-", label=f"{name}, order {order(sizes, errors):.2f}")
    right.set(xlabel="edges per turn", title="relative error")
    right.legend()
    checks = [
        Check("drag [mN] at 20 mm/s", 1e3 * A * SPEED, 1e3 * found[-1][0] * SPEED),
        Check("thrust [mN] at 3 rad/s", 1e3 * B * SPIN, 1e3 * found[-1][1] * SPIN),
        Check("torque [µN m] at 3 rad/s", 1e6 * D * SPIN, 1e6 * found[-1][2] * SPIN),
        Check(
            "speed of swimming [mm/s] at 3 rad/s",
            1e3 * B / A * SPIN,
            1e3 * found[-1][1] / found[-1][0] * SPIN,
        ),
    ]
    return Case(
        "Rigid helix", checks, figure, "Lighthill 1976; Lauga & Powers 2009, Rep. Prog. Phys. 72, 096601"
    )


if __name__ == "__main__":
    show(main)
