"""A tendon-driven trunk with a payload, held aside and released: rods, disks and what hangs from them.

    rodnet evaluate examples/recordings/trunk.py --recordings DECAYS/*.npz --train OTHERS/*.npz

The hose is clamped at the top, straight down; three disks divide it, the payload (``payload_kg``) hangs from the last.
The tendons are slack from the moment of release on. Where the hose hangs at rest with a known payload says how it
is curved by nature; how stiff, heavy and lossy it is, is to be found.
"""

from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

import rodnet as rn

BASE = np.array([0.10, -0.105, 0.0])  # of the hose, not recorded [m]
RADIUS, DISK, DISK_MASS = 0.01, 0.015, 0.03  # hose [m]; length of a stiff disk [m], mass [kg]
STIFFNESS, DENSITY, RATE, RETARDATION = 3.9e6, 300.0, 3.3, 0.076  # E [Pa], [kg/m^3], [1/s], [s]
REST_LOAD, GRAVITY = 0.2, 9.81  # payload at which the set gives the rest pose [kg], [m/s^2]
PARTS, DT, MOVES, SPAN = (
    6,
    5e-3,
    0.02,
    2.0,
)  # edges of a hose; [s]; tip speed at release [m/s]; what is predicted [s]
STRIDE = 5  # frames between samples of the linear model

free = ["hose1.E", "hose1.rho", "mass_damping.rate", "damping.bend"]
tied = {f"hose{k}.{p}": (lambda values, p=p: values[f"hose1.{p}"]) for k in (2, 3) for p in ("E", "rho")}
metric_name = "tip error over 2 s (mm)"


def cut(rec):
    """Two seconds from the release: the last frame before the tip moves."""
    speed = np.linalg.norm(np.diff(rec.markers[:, 2], axis=0), axis=1) * rec.rate
    first = int(np.argmax(speed > MOVES)) if (speed > MOVES).any() else 0
    return rec.cut(rec.t[first], rec.t[first] + SPAN)


def kind(rec):
    """Decays and circles apart, by the names of the files."""
    return rec.name.split("_")[0]


@lru_cache(maxsize=8)
def nature(rest):
    """Stations [m], tangents, lengths of the undeformed hose from the rest pose of its disks."""
    knots = np.vstack([BASE, np.reshape(rest, (-1, 3))])
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(knots, axis=0), axis=1))])
    s = [0.0]
    for a, b in pairwise(at):
        s += [*np.linspace(a, b - DISK, PARTS + 1)[1:], b]
    s = np.array(s)
    x = posture(at, knots, s)
    steps = np.diff(x, axis=0)
    length = np.linalg.norm(steps, axis=1)
    tangent = steps / length[:, None]
    # rest is where the moment of the weights bends it to: undo that, joint by joint
    mass = np.zeros(len(s))
    half = 0.5 * DENSITY * np.pi * RADIUS**2 * length
    mass[:-1] += half
    mass[1:] += half
    ends = np.arange(1, 4) * (PARTS + 1)
    mass[ends] += DISK_MASS
    mass[-1] += REST_LOAD
    weight = mass[:, None] * np.array([0.0, 0.0, -GRAVITY])
    bending = STIFFNESS * 0.25 * np.pi * RADIUS**4
    turned, total = [tangent[0]], Rotation.identity()
    for i in range(1, len(s) - 1):
        moment = np.cross(x[i + 1 :] - x[i], weight[i + 1 :]).sum(axis=0)
        stiff = i in ends or i + 1 in ends
        span = 0.5 * (length[i - 1] + length[i]) * (0.5 if stiff else 1.0)
        total = total * Rotation.from_rotvec(-moment / bending * span)
        turned.append(total.apply(tangent[i]))
    return at, s, np.array(turned), length


def posture(at, knots, s):
    """Positions at stations: a smooth line through base and disks that leaves the base straight down."""
    down = np.array([0.0, 0.0, -1.0])
    x = CubicSpline(at, knots, bc_type=((1, down), (2, np.zeros(3))))(s)
    x[1] = x[0] + (s[1] - s[0]) * down
    return x


def build(rec):
    """Return the trunk in the posture of the first frame."""
    rest = rec.meta["markers"]["rest_200g"]
    at, s, tangents, length = nature(tuple(map(tuple, rest)))
    x = np.vstack([BASE, BASE + np.cumsum(length[:, None] * tangents, axis=0)])
    material = rn.Material(E=STIFFNESS, nu=0.4, rho=DENSITY)
    figure = rn.StickFigure()
    start: str | np.ndarray = x[0]
    for k in range(3):
        i = k * (PARTS + 1)
        hose, disk = f"hose{k + 1}", f"disk{k + 1}"
        figure.rod(hose, [start, *x[i + 1 : i + PARTS + 1]], material=material, radius=RADIUS)
        mass = DISK_MASS + (float(rec.attrs["payload_kg"]) if k == 2 else 0.0)
        figure.rigid(disk, [f"{hose}.end", x[i + PARTS + 1]], mass=mass)
        start = f"{disk}.end"
    graph = figure.build()
    first = rec.first_frames()[0]
    graph = graph.with_positions(posture(at, np.vstack([BASE, first]), s))
    retardation = rn.Parameter(RETARDATION, unit="s", bounds=(0.0, 10.0), null=0.0)
    return rn.Robot(
        graph,
        [
            rn.Stretching(),
            rn.Bending(),
            rn.Twisting(),
            rn.Gravity(g=GRAVITY),
            rn.MassDamping(rate=RATE),
            rn.KelvinVoigt(stretch=retardation, bend=retardation, twist=retardation),
            rn.Clamp(at="hose1:0-1"),
        ],
    )


def observe(rec, robot):
    """The disks."""
    return rn.Markers(robot, [f"disk{k}.end" for k in (1, 2, 3)])


def options(rec, robot):
    """It starts at rest."""
    return {"dt": DT, "stepper": "sdirk2"}


def metric(rec, predicted):
    """Mean distance of the tip from release on [mm]."""
    return 1e3 * np.nanmean(np.linalg.norm(predicted[0][:, 2] - rec.markers[:, 2], axis=1))


def baselines(train):
    """Two models without physics: the median rest pose, and a linear one of second order of the three disks."""
    rests = np.array([rec.markers[-1] for rec in train])
    rest = np.median(rests, axis=0)
    rows = [rec.markers - rest for rec in train]
    past, now, following = (
        np.vstack([y[k : len(y) - 2 * STRIDE + k].reshape(-1, 9) for y in rows])
        for k in (0, STRIDE, 2 * STRIDE)
    )
    known = np.hstack([now, past, np.ones((len(now), 1))])
    now_by, past_by, drift = np.split(np.linalg.lstsq(known, following, rcond=None)[0], [9, 18])

    def linear(rec):
        y = (rec.markers[0] - rest).ravel()
        # at rest in the beginning: what comes a moment later is what would have been a moment before
        after = np.linalg.solve((np.eye(9) - past_by).T, y @ now_by + drift[0])
        states = [after, y, after]
        while len(states) < len(rec.t) // STRIDE + 6:
            states.append(states[-1] @ now_by + states[-2] @ past_by + drift[0])
        times = STRIDE * (np.arange(len(states)) - 1) / rec.rate
        return [rest + CubicSpline(times, states)(rec.t - rec.t[0]).reshape(-1, 3, 3)]

    return {
        "rest pose held": lambda rec: [np.broadcast_to(rest, rec.markers.shape)],
        "linear model of second order": linear,
    }
