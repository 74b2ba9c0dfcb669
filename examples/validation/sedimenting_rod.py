"""A rod that sinks in a viscous fluid: faster along itself than across, and sideways where it is inclined."""

import matplotlib.pyplot as plt
import numpy as np
from gallery import Case, Check, show

import rodnet as rn

L, R, MU, G = 0.1, 1e-3, 5.0, 9.81  # m, m, Pa s, m/s^2
MATERIAL = rn.Material(E=1e9, rho=3000.0)
FLUID = 1000.0  # kg/m^3
TILTS = [0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0]  # from the vertical [degrees]


def sink(tilt):
    """Velocity (3,) once it is steady, and how much the rod has turned."""
    direction = np.array([np.sin(np.radians(tilt)), 0, np.cos(np.radians(tilt))])
    fig = rn.StickFigure()
    fig.rod("rod", [(0, 0, 0), tuple(L * direction)], edges=8, material=MATERIAL, radius=R)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.ResistiveForce(viscosity=MU)]
    robot = rn.Robot(fig.build(), [*terms, rn.Gravity(g=G, fluid_density=FLUID)])
    return rn.Simulation(robot, dt=5e-3).run(0.1).v[-1].mean(axis=0)


def main():
    # Gray and Hancock's coefficients per length
    log = np.log(2 * L / R)
    along, across = 2 * np.pi * MU / (log - 0.5), 4 * np.pi * MU / (log + 0.5)
    weight = (MATERIAL.rho - FLUID) * np.pi * R**2 * G
    found = np.array([sink(tilt) for tilt in TILTS])

    def theory(tilt):
        s, c = np.sin(np.radians(tilt)), np.cos(np.radians(tilt))
        return weight * np.stack([-s * c * (1 / along - 1 / across), -(c**2 / along + s**2 / across)])

    figure, axes = plt.subplots(figsize=(5, 3.4), layout="constrained")
    fine = np.linspace(0, 90, 181)
    for k, label in enumerate(("sideways", "downward")):
        axes.plot(fine, -1e3 * theory(fine)[k], "k")
        axes.plot(TILTS, -1e3 * found[:, 2 * k], "o", label=label)
    axes.set(xlabel="tilt from the vertical [degrees]", ylabel="speed [mm/s]")
    axes.legend()
    drift = np.degrees(np.arctan2(*found[3, [0, 2]]) % np.pi)
    expected = np.degrees(np.arctan2(*theory(45.0)) % np.pi)
    checks = [
        Check("speed along over speed across", across / along, found[0, 2] / found[-1, 2]),
        Check("speed upright [mm/s]", 1e3 * weight / along, -1e3 * found[0, 2]),
        Check(
            "drift of a rod at 45° from the vertical [degrees]",
            expected,
            drift,
        ),
    ]
    return Case("Sedimenting rod", checks, figure, "Gray & Hancock 1955, J. Exp. Biol. 32, 802")


if __name__ == "__main__":
    show(main)
