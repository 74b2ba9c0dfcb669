"""A clamped beam that vibrates: its first three frequencies, and how they decay in a Kelvin-Voigt material."""

import matplotlib.pyplot as plt
import numpy as np
from gallery import Case, Check, order, show

import rodnet as rn

L, R = 0.2, 2e-3  # m
MATERIAL = rn.Material(E=1e7, rho=1000.0)
EI, MASS = MATERIAL.E * np.pi / 4 * R**4, MATERIAL.rho * np.pi * R**2
ROOTS = np.array([1.8751040687, 4.6940911330, 7.8547574382])  # of cos x cosh x = -1
RETARDATION = 2e-3  # s, viscosity of the material over its modulus


def beam(edges, *terms):
    fig = rn.StickFigure()
    fig.rod("beam", [(0, 0, 0), (L, 0, 0)], edges=edges, material=MATERIAL, radius=R)
    return rn.Robot(
        fig.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Clamp(at="beam.start"), *terms]
    )


def ring_down(robot, mode, periods=4, steps=100):
    """Swing of the end in the first mode after a knock: times over the period, and displacement."""
    shape = mode.x[0].real
    shape *= 1e-4 * L / np.abs(shape).max()
    omega, period = abs(mode.rate[0]), 1 / mode.frequency[0]
    sim = rn.Simulation(robot, period / steps, stepper="sdirk2", velocity=omega * shape)
    traj = sim.run(periods * period)
    side = shape[-1] / np.linalg.norm(shape[-1])
    return traj.t / period, (traj.x[:, -1] - robot.graph.x0[-1]) @ side


def main():
    omega = ROOTS**2 * np.sqrt(EI / MASS) / L**2
    sizes = [16, 32, 64]
    # in two planes: every other mode
    found = [rn.modes(beam(n), count=6).frequency[::2] for n in sizes]
    damped = beam(64, rn.KelvinVoigt(bend=RETARDATION))
    decay = rn.modes(damped, count=6).decay[::2]

    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(11, 3.2), layout="constrained")
    shapes = rn.modes(beam(64), count=6)
    for k in range(3):
        shape = shapes.x[2 * k]
        along = shape @ np.linalg.svd(shape, full_matrices=False)[2][0]
        left.plot(np.linspace(0, 1, 65), along / along[-1], label=f"{found[-1][k]:.3f} Hz")
    left.set(xlabel="x / L", title="first three modes")
    left.legend()
    errors = np.abs(np.array(found) / (omega / 2 / np.pi) - 1)
    for k in range(3):
        middle.loglog(
            sizes, errors[:, k], "o-", label=f"mode {k + 1}, order {order(sizes, errors[:, k]):.2f}"
        )
    middle.set(xlabel="edges", title="relative error of the frequency")
    middle.legend()
    mode = rn.modes(damped, count=1)
    t, swing = ring_down(damped, mode)
    right.plot(t, 1e6 * swing)
    envelope = 100e-6 * L * np.exp(-0.5 * RETARDATION * omega[0] ** 2 * t / mode.frequency[0])
    right.plot(t, 1e6 * envelope, "k:", label=r"$e^{-\tau\omega^2t/2}$")
    right.set(xlabel="periods", ylabel="end [µm]", title="after a knock")
    right.legend()
    # a peak every period
    peaks = [swing[np.abs(t - p) < 0.5].max() for p in (0.5, 3.5)]
    measured = np.log(peaks[0] / peaks[1]) / 3 * mode.frequency[0]
    checks = [Check(f"frequency {k + 1} [Hz]", omega[k] / 2 / np.pi, found[-1][k]) for k in range(3)]
    checks += [
        Check(f"decay of mode {k + 1} [1/s]", RETARDATION * omega[k] ** 2 / 2, decay[k]) for k in range(3)
    ]
    checks.append(Check("decay of mode 1 in a simulation [1/s]", RETARDATION * omega[0] ** 2 / 2, measured))
    return Case("Vibrating cantilever", checks, figure, "Euler-Bernoulli beam; Kelvin-Voigt solid")


if __name__ == "__main__":
    show(main)
