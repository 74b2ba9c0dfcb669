"""A tendon-driven trunk with a payload, held aside and released: rods, disks and what hangs from them.

    rodnet calibrate examples/recordings/trunk.py --recordings DECAYS/*.npz --out fit
    rodnet evaluate examples/recordings/trunk.py --model fit --recordings OTHERS/*.npz

The hose is clamped at the top, straight down; three disks divide it, the payload (``payload_kg``) hangs from the
last. Tendons have bent and compressed the hose into the shape of the first frame; once the motors let go, which
takes them a moment, the tendons do nothing. How stiff, lossy and long the hose is, how it is bent by nature and how
late the motors are is to be found. The payload is known, so all of these are in SI units. Where the recording has the
motors' commands (``u_before_release``), the robot knows which tendons were tight: they may rub.
"""

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.stats import norm

import rodnet as rn

BASE, UP = np.array([0.10, -0.105, 0.0]), np.array([0.0, 0.0, 1.0])  # of the hose, not recorded [m]
DISKS, PARTS = ("disk1", "disk2", "disk3"), 3  # edges of a hose
LENGTHS = (0.1065, 0.0965, 0.121)  # from base to disk, from disk to disk [m]
RADIUS, DISK, DISK_MASS = 0.016, 0.012, 0.01  # hose [m]; length of a stiff disk [m], mass [kg]
STIFFNESS, DENSITY, RATE, RETARDATION = 2.7e6, 100.0, 7.5, 0.033  # E [Pa], [kg/m^3], [1/s], [s]
LAG = 0.045  # of the motors after the command [s]
# of the motors: hose that their tendons end at, and azimuth that a positive command bends the trunk to, as postures
# held by single ones say; neighbours among the twelve tendons are 30 degrees apart [deg]
MOTORS = ((3, 197.0), (2, 317.0), (1, 167.0), (1, 257.0), (2, 47.0), (3, 107.0))
TIGHT = 0.1  # command from which on a tendon is tight
CURVATURE = 2.0  # that a hose usually has by nature [1/m]
DT, MOVES, SPAN = 1e-2, 0.02, 2.0  # [s]; tip speed at release [m/s]; what is predicted [s]
# [m] about what a plain model leaves, not the hundredths of millimetres of the cameras
noise = 1e-2
free = [
    "hose*.E", "hose1.length", "hose2.length", "hose3.length", "mass_damping.rate", "damping.bend",
    "markers.lag", *(f"bent{k}.kappa{a}" for k in (1, 2, 3) for a in (1, 2)),
]  # fmt: skip
metric_name = "tip error over 2 s (mm)"


def cut(rec):
    """Two seconds from the release: the last frame before the tip moves."""
    speed = np.linalg.norm(np.diff(rec.markers[:, 2], axis=0), axis=1) * rec.rate
    first = int(np.argmax(speed > MOVES)) if (speed > MOVES).any() else 0
    return rec.cut(rec.t[first], rec.t[first] + SPAN)


def kind(rec):
    """Decays and circles apart, by the names of the files."""
    return rec.name.split("_")[0]


def build(rec):
    """Return the trunk in the posture of the first frame."""
    ends = BASE[2] - np.cumsum(LENGTHS)
    material = rn.Material(E=STIFFNESS, nu=0.4, rho=DENSITY)
    figure, start = rn.StickFigure(), "mount.end"
    # what holds the hose points down, however the hose is bent at first
    figure.rigid("mount", [BASE + DISK * UP, BASE], mass=DISK_MASS)
    stations, top = [0.0], BASE[2]
    for k, (disk, end) in enumerate(zip(DISKS, ends, strict=True)):
        heights = np.linspace(top, end + DISK, PARTS + 1)[1:]
        nodes = [(BASE[0], BASE[1], z) for z in heights]
        figure.rod(f"hose{k + 1}", [start, *nodes], material=material, radius=RADIUS)
        mass = DISK_MASS + (float(rec.attrs["payload_kg"]) if k == 2 else 0.0)
        figure.rigid(disk, [f"hose{k + 1}.end", (BASE[0], BASE[1], end)], mass=mass)
        start, top = f"{disk}.end", end
        stations += [*(BASE[2] - heights), BASE[2] - end]
    graph = figure.build()
    hose = posture(rec.first_frames()[0], np.array(stations))
    graph = graph.with_positions(np.vstack([graph.x0[:1], hose]))
    bends = [
        rn.NaturalCurvature(on=f"hose{k}", name=f"bent{k}", kappa1=bend(), kappa2=bend()) for k in (1, 2, 3)
    ]
    return rn.Robot(
        graph,
        [
            rn.Stretching(),
            rn.Bending(),
            rn.Twisting(),
            rn.Gravity(g=9.81),
            rn.MassDamping(rate=RATE),
            rn.KelvinVoigt(stretch=RETARDATION, bend=RETARDATION, twist=RETARDATION),
            rn.Clamp(at="mount:0-1"),
            *bends,
            rn.DryFriction(name="tendons", pull=pulls(rec), rubs=False),  # no friction in the plain model
        ],
    )


def bend():
    """A natural curvature, unknown."""
    return rn.Parameter(0.0, unit="1/m", null=0.0, prior=norm(0.0, CURVATURE))


def pulls(rec):
    """Where tendons that were tight have bent each hose to, in its directors: m1 is along x, m2 against y."""
    commands = np.nan_to_num(rec.attrs.get("u_before_release", np.zeros(len(MOTORS))))
    found = {f"hose{k}": np.zeros(2) for k in (1, 2, 3)}
    for (last, azimuth), tight in zip(MOTORS, np.tanh(commands / TIGHT), strict=True):
        for k in range(1, last + 1):
            found[f"hose{k}"] += tight * np.array([np.cos(np.radians(azimuth)), -np.sin(np.radians(azimuth))])
    return found


def posture(disks, stations):
    """Positions at stations: a smooth line through base and disks that leaves the base straight down."""
    knots = np.vstack([BASE, disks])
    at = np.concatenate([[0.0], np.cumsum(LENGTHS)])
    x = CubicSpline(at, knots, bc_type=((1, -UP), (2, np.zeros(3))))(stations)
    for end in np.arange(1, 4) * (PARTS + 1):  # disks are rigid
        step = x[end] - x[end - 1]
        x[end - 1] = x[end] - DISK * step / np.linalg.norm(step)
    return x


def observe(rec, robot):
    """The disks."""
    return rn.Markers(robot, [f"{disk}.end" for disk in DISKS], lag=LAG)


def options(rec, robot):
    """It starts at rest."""
    return {"dt": DT, "stepper": "sdirk2"}


def metric(rec, predicted):
    """Mean distance of the tip from release on [mm]."""
    return 1e3 * np.nanmean(np.linalg.norm(predicted[0][:, 2] - rec.markers[:, 2], axis=1))


def baselines(train):
    """Two models without physics."""
    return {
        "rest pose held": rn.RestPose.fit(train),
        "linear model of second order": rn.LinearMotion.fit(train),
    }
