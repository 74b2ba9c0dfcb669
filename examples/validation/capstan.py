"""A cord drawn round a post is held by a force that is exp(friction times angle) smaller: the capstan."""

import matplotlib.pyplot as plt
import numpy as np
from gallery import Case, Check, show

import rodnet as rn

POST, R = 0.05, 5e-4  # radii of post and cord [m]
HOLD, FRICTIONS = 10.0, [0.1, 0.2, 0.3]  # N, 1
LEG, ARC = 0.06, 48  # m of cord on each side of the half turn; edges on it


def draw(friction):
    """Tension along a cord that is drawn slowly over the top of a post, against a weight at its other end."""
    radius = (POST + 1.02 * R) / np.cos(0.5 * np.pi / ARC)  # the middles of edges touch
    arc = np.linspace(np.pi, 0, ARC + 1)
    over = radius * np.stack([np.cos(arc), 0 * arc, np.sin(arc)], axis=1)
    legs = np.linspace(LEG, 0, 9)[:-1, None] * (0, 0, -1)
    fig = rn.StickFigure()
    fig.rod(
        "cord", [*(over[0] + legs), *over, *(over[-1] + legs[::-1])], material=rn.Material(E=1e9, rho=1000.0),
        radius=R, natural="straight",
    )  # fmt: skip
    post = rn.TubeContact(((0, 0, 0), (0, 1, 0)), POST, inside=False, friction=friction)
    pull = rn.PrescribedMotion(at="cord.end", position=lambda t: np.array([0, 0, -0.05 * t]))
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), post, pull]
    terms.append(rn.PointForce(at="cord.start", force=(0, 0, -HOLD)))
    traj = rn.Simulation(rn.Robot(fig.build(), terms), 5e-3).run(0.3)
    middle = 0.5 * (traj.x[-1, 1:] + traj.x[-1, :-1])
    return np.arctan2(middle[:, 2], -middle[:, 0]), traj.internal.tension[-1]


def main():
    figure, axes = plt.subplots(figsize=(5.5, 3.4), layout="constrained")
    checks = []
    for k, friction in enumerate(FRICTIONS):
        angle, tension = draw(friction)
        on = (angle > 0) & (angle < np.pi)
        axes.semilogy(
            np.degrees(angle[on]), tension[on], "o", ms=3, color=f"C{k}", label=f"friction {friction:g}"
        )
        # friction acts at the surface of the cord, a radius from its axis: see the theory of contact
        exponent = friction * POST / (POST + R)
        fine = np.linspace(0, np.pi, 50)
        axes.semilogy(np.degrees(fine), HOLD * np.exp(exponent * fine), "k", lw=0.8)
        checks.append(
            Check(
                f"ratio of tensions at friction {friction:g}",
                np.exp(exponent * np.pi),
                tension[-1] / tension[0],
            )
        )
    axes.set(xlabel="angle round the post [degrees]", ylabel="tension [N]")
    axes.legend()
    return Case("Capstan", checks, figure, "Euler 1769; Eytelwein 1808")


if __name__ == "__main__":
    show(main)
