"""The paper's own fit: the head's C1 and C2 and the viscosity from speeds of the robot with two tails.

    python examples/paper_fit.py [--noise 0.03] [--out DIR] [--quick]

Du et al. measured the robot's speed v and its head's speed of rotation at several speeds of the motor and fitted
three numbers to them. Here the robot that they ended with is the truth and is "measured" with 3 % noise at six speeds;
the fit begins with other values, says which of them such data determine, and predicts the robot with three tails.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
import numpy as np

import rodnet as rn

matplotlib.use("Agg")
import matplotlib.pyplot as plt

SPEEDS = (40.0, 80.0, 120.0, 160.0, 200.0, 240.0)  # of the motor [rpm]
TRUTH = {"drag.viscosity": 6.828, "head.C1": 2.420, "head.C2": 0.039}
BEGIN = {"drag.viscosity": 4.0, "head.C1": 1.5, "head.C2": 0.06}
DURATION, DT = 20.0, 0.05  # until it swims steadily [s]


def robot(rec, edges):
    """Return the robot of a recording, with the values that the fit begins with."""
    return rn.robots.flagellated(
        n_tails=int(rec.attrs["n_tails"]), rpm=float(rec.attrs["rpm"]), edges=edges,
        mu=BEGIN["drag.viscosity"], C1=BEGIN["head.C1"], C2=BEGIN["head.C2"],
    )  # fmt: skip


def instruments(rec, swimmer):
    """A ruler and a clock, and a counter on the head."""
    return [
        rn.Reading(swimmer, "speed", lambda state: state.velocity("head:1")[0], unit="m/s"),
        rn.HeadSpeed(swimmer, "head_speed"),
    ]


def make_case(edges):
    """Return how recordings become robots."""
    return rn.Case(
        lambda rec: robot(rec, edges), instruments, free=list(TRUTH),
        options=lambda rec, swimmer: {"dt": DT, "stepper": "euler"}, name="paper_fit",
    )  # fmt: skip


def measure(case, n_tails, rpm, noise, rng):
    """Return a recording of the true robot: two numbers, once it swims steadily."""
    t = np.array([0.0, 0.5 * DURATION, DURATION])
    blank = rn.Recording(t, np.zeros((3, 1, 3)), attrs={"n_tails": n_tails, "rpm": rpm}, name=f"{rpm:g} rpm")
    true = case.build(blank).with_parameters(TRUTH)
    traj = rn.Simulation(true, dt=DT).run(DURATION, save_every=200)
    speed, turning = (seen[-1] for seen in rn.observe(instruments(blank, true), traj, t))
    once = lambda value: np.array([np.nan, np.nan, value * (1.0 + noise * rng.standard_normal())])  # noqa: E731
    return blank.replace(channels={"speed": once(speed), "head_speed": once(turning)})


def main(arguments=None):
    """Measure, fit, predict; return the calibration, and predicted over true speeds of three tails."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--noise", type=float, default=0.03, help="relative error of a measurement")
    parser.add_argument(
        "--out", type=Path, default=Path("paper_fit"), help="directory of the figure and the fit"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="a coarse mesh")
    given = parser.parse_args(arguments)
    if not 0.0 < given.noise < 0.3:
        parser.error("--noise must be between 0 and 0.3")
    rng, case = np.random.default_rng(given.seed), make_case(9 if given.quick else 27)
    two, three = ([measure(case, n, rpm, given.noise, rng) for rpm in SPEEDS] for n in (2, 3))
    sizes = lambda rec: {  # noqa: E731
        name: given.noise * abs(float(rec.channels[name][-1])) for name in ("speed", "head_speed")
    }
    found = rn.calibrate(case, two, noise=sizes, outliers=None, workers=0)
    print("from two tails, with 95 % intervals:")
    for path, one in found.parameters.items():
        print(f"  {path:15} {one}   (true: {TRUTH[path]:g})")
    print(*found.identifiability.sentences, found.message, sep="\n")
    predictions = found.predictions(three)
    print("three tails, predicted and measured:")
    ratios = []
    for rec in three:
        speed, turning = (abs(float(p[-1])) for p in predictions[rec.name].predicted)
        told = [abs(float(rec.channels[c][-1])) for c in ("speed", "head_speed")]
        ratios.append((speed / told[0], turning / told[1]))
        print(
            f"  {rec.attrs['rpm']:4g} rpm: v = {1e3 * speed:.3f} ({1e3 * told[0]:.3f}) mm/s, head "
            f"{turning:.1f} ({told[1]:.1f}) rpm"
        )
    given.out.mkdir(parents=True, exist_ok=True)
    found.save(given.out)
    draw(found, two, three, predictions, given.out / "paper_fit.png")
    print(f"written: {given.out}")
    return found, np.array(ratios)


def draw(found, two, three, predictions, path):
    """Draw both speeds over the motor's: measured (dots), fitted and predicted (lines)."""
    figure, axes = plt.subplots(1, 2, figsize=(8, 3.2))
    for n, recs, said in (
        (2, two, [found.predicted[rec.name] for rec in two]),
        (3, three, [predictions[rec.name].predicted for rec in three]),
    ):
        for ax, k, channel, factor in ((axes[0], 0, "speed", 1e3), (axes[1], 1, "head_speed", 1.0)):
            (line,) = ax.plot(SPEEDS, [factor * abs(p[k][-1]) for p in said], label=f"{n} tails")
            ax.plot(
                SPEEDS, [factor * abs(rec.channels[channel][-1]) for rec in recs], "o", color=line.get_color()
            )
    axes[0].set(xlabel="motor [rpm]", ylabel="v [mm/s]")
    axes[1].set(xlabel="motor [rpm]", ylabel="head [rpm]")
    axes[1].legend(title="fitted (2), predicted (3)", loc="upper left")
    figure.tight_layout()
    figure.savefig(path, dpi=120)
    plt.close(figure)


if __name__ == "__main__":
    main()
