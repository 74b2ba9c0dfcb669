"""The paper's flagellated robot: speed, head speed and efficiency against the motor's speed for n = 2, 3, 4, 5.

The full curves are in ``examples/paper_figures.py``; here are enough points to see them.
"""

import matplotlib.pyplot as plt
from gallery import Case, Check, show

import rodnet as rn

TAILS, SPEEDS = [2, 3, 4, 5], [50.0, 100.0, 150.0, 200.0, 250.0, 300.0]  # rpm
# what the paper's text says of (n, rpm) in numbers
SPEED = {(2, 100.0): 0.22, (3, 100.0): 0.13}  # mm/s
HEAD = {(2, 100.0): 95.47, (3, 100.0): 97.49}  # rpm


def measure(n, rpm):
    """Metrics over the last ten turns of the motor, at the paper's mesh and time step."""
    robot = rn.robots.flagellated(n, rpm)
    duration = 24.0 if rpm <= 150 else 40.0
    return rn.robots.flagellated_metrics(rn.Simulation(robot, dt=0.01).run(duration, save_every=10))


def main():
    found = {(n, rpm): measure(n, rpm) for n in TAILS for rpm in SPEEDS}
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.4), layout="constrained")
    curves = (
        (lambda m: 1e3 * m.speed, "speed [mm/s] (figure 5a)"),
        (lambda m: m.head_rpm, "speed of the head [rpm] (figure 5b)"),
        (lambda m: m.efficiency, "efficiency (figure 6)"),
    )
    for ax, (value, title) in zip(axes, curves, strict=True):
        for k, n in enumerate(TAILS):
            ax.plot(SPEEDS, [value(found[n, rpm]) for rpm in SPEEDS], f"C{k}o-", label=f"n = {n}")
        ax.set(xlabel="motor [rpm]", title=title)
    for ax, said in zip(axes, (SPEED, HEAD), strict=False):
        for (_, rpm), value in said.items():
            ax.plot(rpm, value, "kx", ms=9)
    axes[0].legend()
    checks = [
        Check(f"speed [mm/s], n = {n}, {rpm:g} rpm", said, 1e3 * found[n, rpm].speed)
        for (n, rpm), said in SPEED.items()
    ]
    checks += [
        Check(f"head [rpm], n = {n}, {rpm:g} rpm", said, found[n, rpm].head_rpm)
        for (n, rpm), said in HEAD.items()
    ]
    return Case("The paper's robot", checks, figure, "Du, Lam, Sachanandani & Jawed, figures 5a, 5b and 6")


if __name__ == "__main__":
    show(main)
