"""The paper's robot in grains: a head with a motor and n soft tails, of which only the head is filmed.

    rodnet diagnose examples/recordings/paper.py --recordings "paper_concealed/yield/*.npz" --out found

A recording has what Du et al. had: where the head is along the tube, how fast head and tails turn, 30 times a
second, the command of the motor, and how many tails there are. The model is theirs, too: resistive force theory for
the tails, Stokes' law with two shape factors for the head. These and the viscosity are free.
"""

from dataclasses import dataclass

import numpy as np

import rodnet as rn

EDGES, DT = 8, 1.0 / 30.0  # of a tail; a frame [s]
CHOICES = (60.0, 130.0, 240.0)  # speeds of the motor that could be tried next [rpm]

free = ["drag.viscosity", "head.C1", "head.C2"]


@dataclass(frozen=True)
class Turned:
    """The angle that a motor has turned by [rad], its speed [rpm] being linear between given times [s]."""

    t: np.ndarray
    rpm: np.ndarray

    def __call__(self, t):
        k = int(np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 2))
        width, mean = np.diff(self.t), 0.5 * (self.rpm[1:] + self.rpm[:-1])
        since = min(t, self.t[-1]) - self.t[k]
        slope = (self.rpm[k + 1] - self.rpm[k]) / width[k]
        turned = (width[:k] * mean[:k]).sum() + self.rpm[k] * since + 0.5 * slope * since**2
        return float(turned + max(t - self.t[-1], 0.0) * self.rpm[-1]) * 2.0 * np.pi / 60.0


def robot(n_tails, turned, edges, **given):
    """The robot whose motor has turned by a function of time; its tails' roots are clamps, which converges."""
    made = rn.robots.flagellated(n_tails, 1.0, edges=edges, root="clamped", tangent="edge", **given)
    others = [term for term in made.terms if term.name != "motor"]
    return rn.Robot(made.graph, [*others, rn.Motor(at="head:1", angle=turned)])


def build(rec):
    """Return the robot with the number of tails and the command of a recording."""
    turned = Turned(rec.t - rec.t[0], np.array(rec.channels["motor"]))
    return robot(int(rec.attrs["n_tails"]), turned, EDGES)


def observe(rec, robot):
    """The head along the tube, and two counters: on the head and on the tails."""
    return [
        rn.Markers(robot, {"head": "head:1"}, plane="x", name="position"),
        rn.HeadSpeed(robot, "head_speed"),
        rn.HeadSpeed(robot, "tail_speed", on="head:1-2", name="tail_speed"),
    ]


def options(rec, robot):
    """Every frame is a step, of second order."""
    return {"dt": DT, "stepper": "sdirk2"}


def drives(rec):
    """What could be tried next: one of three speeds with two to four tails, then the motor off."""
    found = []
    for n in (2, 3, 4):
        for rpm in CHOICES:
            motor = np.interp(rec.t - rec.t[0], [0.0, 0.5, 8.0, 8.5], [0.0, rpm, rpm, 0.0])
            told = f"{rpm:g} rpm for 8 s, then off, with {n} tails"
            channels = {**rec.channels, "motor": motor}
            found.append((told, rec.replace(channels=channels, attrs={**rec.attrs, "n_tails": n})))
    return found
