"""What the paper's own fit conceals: a medium that yields, and one that jams between four tails.

    python examples/paper_concealed.py [--medium yield | jam] [--out DIR] [--quick]

Du et al. fit a viscosity and two shape factors of the head to steady speeds of the robot with two tails, and the fit
is good. Here the grains do what the paper says of them beside that: (yield) they hold the robot until a threshold is
passed, (jam) they jam between four tails. Seen are the position of the head and the speeds of head and tails, 30
times a second, with noise. First comes the paper's fit, with two tails; then a diagnosis of recordings with changing
speeds and other numbers of tails.

The truth is simulated on a mesh nearly three times as fine, with another stepper and another regularisation of the
law. ``jam`` needs the plug-in (python -m pip install -e plugins/rodnet-jamming).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
import numpy as np

import rodnet as rn
from rodnet.inference.case import load_case

matplotlib.use("Agg")
import matplotlib.pyplot as plt

HERE = Path(__file__).resolve().parent
CASE = load_case(HERE / "recordings" / "paper.py")
robot, Turned = (CASE.build.__globals__[name] for name in ("robot", "Turned"))
RATE, FINE = 30.0, 24  # frames a second; edges of a tail in the truth
WHITE = {"position": 1e-4, "head_speed": 1.0, "tail_speed": 0.5}  # noise of a frame [m], [rpm], [rpm]
SPEEDS = (100.0, 130.0, 160.0, 190.0, 220.0, 250.0)  # of the paper's fit, two tails [rpm]
SPREAD = 0.04  # of a steady speed from one experiment to the next
YIELD = {"stress": 0.12, "bearing": 9.14, "speed": 3e-6}  # [Pa], a smooth rod's, of the creep [m/s]
# number of tails, and speeds of the motor [rpm] after 0, 5, 10 ... s; the last two are held out
TRIALS = {
    "yield": [
        (2, (100.0, 200.0, 0.0)), (2, (240.0, 60.0, 140.0)), (2, (60.0, 160.0, 80.0)), (3, (120.0, 220.0, 0.0)),
        (3, (200.0, 80.0, 160.0)), (2, (180.0, 90.0, 0.0)), (3, (80.0, 240.0, 100.0)),
    ],
    "jam": [
        (2, (208.0, 100.0, 208.0, 0.0)), (2, (120.0, 240.0, 160.0, 80.0)), (4, (208.0, 208.0, 208.0, 208.0)),
        (4, (160.0, 240.0, 240.0, 160.0)), (4, (240.0, 240.0, 160.0, 208.0)), (3, (208.0, 120.0, 208.0, 160.0)),
        (4, (180.0, 220.0, 220.0, 180.0)), (2, (160.0, 220.0, 80.0, 240.0)),
    ],
}  # fmt: skip
PLATEAU, RAMP = 5.0, 0.5  # [s]


class Threshold(rn.DragModel):
    """Grains that yield, f = -sigma r (2 pi v_t + 2 N v_n) / sqrt(v^2 + u^2) per unit length."""

    default_name = "threshold"
    claims = {"dissipative", "objective"}  # noqa: RUF012
    stress = rn.Parameter(0.1, unit="Pa", bounds=(0, None), null=0.0, doc="sigma, at which grains yield")
    bearing = rn.Parameter(9.14, unit="1", bounds=(0, None), kind="shape", doc="N, of a rod pushed across")
    speed = rn.Parameter(1e-6, unit="m/s", bounds=(1e-9, None), kind="shape", doc="u, of creep below it")

    def force(self, site, p):
        """Force per unit length [N/m]."""
        along = rn.dot(site.v, site.tangent) * site.tangent
        size = np.sqrt(rn.dot(site.v, site.v) + p.speed**2)
        both = 2.0 * np.pi * along + 2.0 * p.bearing * (site.v - along)
        return -p.stress * site.radius[:, None] * both / size


def true_robot(medium, n_tails, turned, edges):
    """The robot in grains that yield, or jam."""
    plain = robot(n_tails, turned, edges)
    if medium == "yield":
        return plain.with_terms(Threshold(on=["head", "tail*"], **YIELD))
    from rodnet_jamming import Jamming

    viscosity = plain.parameters["drag.viscosity"]
    return plain.with_terms(
        Jamming(on="tail*", name="jam", viscosity=viscosity, yield_stress=0.0, tangent="edge")
    )


def record(medium, n_tails, speeds, name, rng, edges=FINE):
    """Film the true robot."""
    duration = PLATEAU * len(speeds)
    begin = PLATEAU * np.arange(len(speeds))
    times = np.stack([begin, begin + RAMP], axis=1).ravel()
    rpm = np.stack([(0.0, *speeds[:-1]), speeds], axis=1).ravel()
    true = true_robot(medium, n_tails, Turned(np.append(times, duration), np.append(rpm, rpm[-1])), edges)
    t = np.arange(round(duration * RATE) + 1) / RATE
    # implicit Euler at a quarter of a frame; a law with a memory in the medium takes a frame
    traj = rn.Simulation(true, dt=1.0 / (RATE if medium == "jam" else 4.0 * RATE)).run(duration)
    blank = rn.Recording(t, np.full((len(t), 1, 3), np.nan), names=["head"])
    seen = dict(zip(WHITE, rn.observe(CASE.observe(blank, true), traj, t), strict=True))
    noisy = {key: seen[key] + WHITE[key] * rng.standard_normal(seen[key].shape) for key in WHITE}
    markers = np.full((len(t), 1, 3), np.nan)
    markers[:, 0, 0] = noisy.pop("position")[:, 0, 0]
    channels = {**noisy, "motor": np.interp(t, times, rpm)}
    return rn.Recording(
        t, markers, names=["head"], channels=channels, attrs={"n_tails": n_tails}, name=name,
        noise=rn.NoiseModel(white=WHITE["position"]),
    )  # fmt: skip
