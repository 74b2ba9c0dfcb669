"""A snake in sand: waves of curvature that travel down a rod swim through grains.

Its drag is granular resistive force theory, which does not depend on the rate: the distance that the
snake swims in one period does not either, only on the shape of the wave. The sandfish lizard swims
with an amplitude of about 0.2 wavelengths, where it is fastest, and a wave efficiency, its speed over
that of the wave, of about 0.5 (Maladen et al. 2011). Where the optimum lies follows from the
theory; the efficiency hangs on how steeply the stress across the body comes up, gamma, which is not known
here. So it is shown for several, not fitted.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from scipy.optimize import brentq

import rodnet as rn

LENGTH, RADIUS, DEPTH = 0.12, 6e-3, 0.05  # m: about a sandfish, as deep as in the experiments
CF, CS = 1.8e5, 4.2e5  # N/m^3, illustrative: drag rods through your own grains
GAMMAS = (2.0, 4.0, 14.0)  # steepness of the stress across the body
SANDFISH = 0.2, 0.5  # amplitude over wavelength and wave efficiency of the animal, observed
ANGLES = (0.3, 0.6, 0.9, 1.1, 1.3, 1.5)  # largest angle between the body and its way [rad]


def heading(angle: float, s: np.ndarray) -> np.ndarray:
    """Angle of the body against its way at t = 0, over the length from the head [rad]."""
    return -angle * np.sin(2 * np.pi * s / LENGTH)


def snake(angle: float, frequency: float = 2.0, gamma: float = 4.0, edges: int = 24) -> rn.Robot:
    """Return a rod, one wave long, whose heading is ``angle sin(2 pi (f t - s / L))``, the head at s = 0."""
    s = LENGTH * (np.arange(edges) + 0.5) / edges
    turn = heading(angle, s)
    steps = -(LENGTH / edges) * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    figure = rn.StickFigure()
    figure.rod(
        "body", list(np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])), radius=RADIUS, natural="straight",
        material=rn.Material(E=2e8, nu=0.45, rho=1500.0), director=(0, -1, 0),
    )  # fmt: skip
    wave = rn.CurvatureWave(
        amplitude=angle * 2 * np.pi / LENGTH, wavelength=LENGTH, frequency=frequency, phase=-np.pi / 2
    )
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), wave]
    terms.append(rn.GranularForce(surface=DEPTH, CF=CF, CS=CS, gamma=gamma))
    return rn.Robot(figure.build(), terms)


@dataclass(frozen=True)
class Swim:
    """What came out: amplitude over wavelength, distance per period over the wavelength, and the track."""

    amplitude: float
    efficiency: float
    speed: float  # body lengths per period
    x: np.ndarray


def swim(angle: float, frequency: float = 2.0, gamma: float = 4.0, periods: int = 4, steps: int = 40) -> Swim:
    """Let the snake swim, and measure it over all periods but the first two."""
    robot = snake(angle, frequency, gamma)
    traj = rn.Simulation(robot, 1.0 / (frequency * steps), stepper="sdirk2").run(periods / frequency)
    s = np.linspace(0.0, LENGTH, 2001)
    wavelength = np.trapezoid(np.cos(heading(angle, s)), s)
    across = np.cumsum(np.sin(heading(angle, s))) * (s[1] - s[0])
    way = traj.x.mean(axis=1)
    distance = np.linalg.norm(way[-1] - way[2 * steps]) / (periods - 2)
    return Swim(
        np.ptp(across) / 2 / wavelength, float(distance / wavelength), float(distance / LENGTH), traj.x
    )


def endless(angle: float, gamma: float = 4.0) -> float:
    """Wave efficiency of an endless snake, whose track is straight: no force along it on average."""
    law, s = rn.GranularForce(surface=DEPTH, CF=CF, CS=CS, gamma=gamma), np.linspace(0.0, LENGTH, 401)[:-1]
    turn = heading(angle, s)
    t = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    speed = 2.0 * LENGTH
    wavelength = np.cos(turn).mean()  # over its length along the body; the wave's speed is 1 along that

    def thrust(efficiency: float) -> float:
        # seen from the wave the body runs along itself, and the wave goes back through the sand
        v = t - (1.0 - efficiency) * np.array([wavelength, 0.0, 0.0])
        site = SimpleNamespace(v=speed * v, tangent=t, x=0.0 * t, radius=np.full(len(t), RADIUS))
        return float(law.force(site, law.values())[:, 0].mean())

    return brentq(thrust, 0.0, 1.0)


def draw(swims: dict[float, list[Swim]], path: Path) -> None:
    """Draw the track of one snake, and efficiency and speed over the amplitude."""
    import matplotlib.pyplot as plt

    fig, (left, middle, right) = plt.subplots(1, 3, figsize=(13, 3.6), constrained_layout=True)
    shown = swims[4.0][ANGLES.index(1.1)]
    for k in range(0, len(shown.x), 20):
        left.plot(*(1e3 * shown.x[k, :, :2].T), color=plt.cm.viridis(0.9 * k / len(shown.x)))
    left.plot(*(1e3 * shown.x[:, 0, :2].T), "k:", lw=0.8)
    left.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", title="body, and way of the head")
    for k, (gamma, those) in enumerate(swims.items()):
        amplitude, style = [s.amplitude for s in those], {"color": f"C{k}", "label": f"gamma = {gamma:g}"}
        middle.plot(amplitude, [s.efficiency for s in those], "o-", **style)
        middle.plot(amplitude, [endless(a, gamma) for a in ANGLES], ":", color=f"C{k}")
        right.plot(amplitude, [s.speed for s in those], "o-", **style)
    middle.plot(*SANDFISH, "k*", ms=12, label="sandfish, observed")
    right.axvline(SANDFISH[0], color="0.7", lw=0.8)
    label = "amplitude / wavelength"
    middle.set(xlabel=label, ylim=(0, 1), title="wave efficiency (dotted: endless snake)")
    right.set(xlabel=label, ylim=(0, None), title="body lengths per period")
    middle.legend()
    fig.savefig(path, dpi=150)
    plt.close(fig)


def main(argv: list[str] | None = None) -> dict[float, list[Swim]]:
    """Swim with waves of several amplitudes in several media; return what came out, by gamma."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("snake_in_sand.png"))
    options = parser.parse_args(argv)
    swims = {gamma: [swim(angle, gamma=gamma) for angle in ANGLES] for gamma in GAMMAS}
    print("gamma  amplitude/wavelength  wave efficiency (endless)  body lengths per period")
    for gamma, those in swims.items():
        for angle, s in zip(ANGLES, those, strict=True):
            free, bound = s.efficiency, endless(angle, gamma)
            print(f"{gamma:5g}  {s.amplitude:20.3f}  {free:15.3f}  {bound:8.3f}  {s.speed:23.3f}")
    print(f"sandfish, observed: amplitude {SANDFISH[0]} wavelengths, wave efficiency about {SANDFISH[1]}")
    draw(swims, options.out)
    return swims


if __name__ == "__main__":
    main()
