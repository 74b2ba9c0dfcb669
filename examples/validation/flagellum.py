"""A flexible flagellum whose root is waved up and down: its shape and thrust by its sperm number."""

import matplotlib.pyplot as plt
import numpy as np
from gallery import Case, Check, show

import rodnet as rn

L, R, EDGES = 0.1, 5e-4, 48  # m
MATERIAL = rn.Material(E=1e8, rho=1.0)  # so light that inertia does not count
EI = MATERIAL.E * np.pi / 4 * R**4
ALONG, ACROSS = 1.0, 1.8  # drag coefficients [Pa s]
WAVE = 0.01 * L  # amplitude of the root: small, as the theory is linear
NUMBERS = [1.5, 2.5, 3.5]  # sperm numbers L (omega ACROSS / EI)^(1/4)
STEPS = 50  # per period


def theory(number, s):
    """Complex shape y(s) of y = Re(y exp(i omega t)) and mean thrust: EI y'''' = -i omega ACROSS y (Machin 1958)."""
    roots = number * (-1j) ** 0.25 * 1j ** np.arange(4)  # times L
    # the root is moved and held level; at the end neither moment nor force
    system = np.stack([roots**0, roots, roots**2 * np.exp(roots), roots**3 * np.exp(roots)])
    c = np.linalg.solve(system, [WAVE, 0, 0, 0])
    y = np.exp(np.outer(s / L, roots)) @ c
    slope = np.exp(np.outer(s / L, roots)) @ (c * roots) / L
    omega = number**4 * EI / ACROSS / L**4
    mean = 0.5 * np.real(1j * omega * y * np.conj(slope))  # of y_t y_x
    return y, (ACROSS - ALONG) * np.trapezoid(mean, s)


def wave(number):
    """The last period of a flagellum whose root goes as cos, with a smooth start: shapes and thrust."""
    omega = number**4 * EI / ACROSS / L**4
    period = 2 * np.pi / omega
    # what the start has set off decays like the slowest mode, as exp(-12.36 (omega t) / number^4)
    periods = int(np.ceil(2 + 9 * number**4 / 12.36 / (2 * np.pi)))

    def root(t):
        rise = min(t / period, 1.0)
        return np.array([0, WAVE * rise**3 * (10 - 15 * rise + 6 * rise**2) * np.cos(omega * t), 0])

    fig = rn.StickFigure()
    fig.rod("tail", [(0, 0, 0), (L, 0, 0)], edges=EDGES, material=MATERIAL, radius=R)
    hand = rn.PrescribedMotion(at="tail.start", position=root, orientation=lambda t: np.eye(3), name="hand")
    drag = rn.ResistiveForce(eta_t=ALONG, eta_n=ACROSS)
    robot = rn.Robot(fig.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), drag, hand])
    sim = rn.Simulation(robot, period / STEPS, stepper="alpha")
    sim.run((periods - 1) * period, save_every=10**6)
    last = sim.run(period)
    return last.x[1:, :, 1], last.term_forces("drag")[1:, :, 0].sum(axis=1).mean()


def main():
    figure, axes = plt.subplots(1, 4, figsize=(13, 2.8), layout="constrained")
    s, fine = np.linspace(0, L, EDGES + 1), np.linspace(0, L, 401)
    turning = np.exp(-2j * np.pi * (np.arange(STEPS) + 1) / STEPS)
    checks = []
    for k, number in enumerate(NUMBERS):
        shapes, thrust = wave(number)
        y, expected = theory(number, fine)
        found = 2 * turning @ shapes / STEPS
        for j in range(0, STEPS, 10):
            axes[k].plot(s / L, shapes[j] / WAVE, "o", ms=2, color=plt.cm.viridis(j / STEPS))
            axes[k].plot(fine / L, np.real(y / turning[j]) / WAVE, "k", lw=0.5)
        axes[k].set(title=f"Sp = {number:g}", xlabel="s / L", ylabel="y / amplitude" if k == 0 else "")
        axes[3].plot(number, 1e6 * thrust, "o")
        checks.append(
            Check(f"swing of the end / amplitude, Sp = {number:g}", abs(y[-1]) / WAVE, abs(found[-1]) / WAVE)
        )
        lag = np.degrees(-np.angle([y[-1], found[-1]]) % (2 * np.pi))
        checks.append(Check(f"lag of the end [degrees], Sp = {number:g}", *lag))
        checks.append(Check(f"mean thrust [µN], Sp = {number:g}", 1e6 * expected, 1e6 * thrust))
    numbers = np.linspace(1, 4.5, 60)
    axes[3].plot(numbers, [1e6 * theory(n, fine)[1] for n in numbers], "k", zorder=0)
    axes[3].set(xlabel="Sp", title="mean thrust [µN]")
    return Case("Flexible flagellum", checks, figure, "Machin 1958; Wiggins & Goldstein 1998, PRL 80, 3879")


if __name__ == "__main__":
    show(main)
