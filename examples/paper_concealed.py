"""What the paper's own fit conceals: a medium that yields, and one that jams between four tails.

    python examples/paper_concealed.py [--medium yield | jam] [--out DIR] [--quick | --all]

Du et al. fit a viscosity and two shape factors of the head to steady speeds of the robot with two tails, and the fit
is good. Here the grains do what the paper says of them beside that: (yield) they hold the robot until a threshold is
passed, (jam) they jam between four tails. Seen are the position of the head and the speeds of head and tails, 30
times a second, with noise. First comes the paper's fit, with two tails; then a diagnosis of recordings with changing
speeds and other numbers of tails.

The truth is simulated on a finer mesh, with another stepper and smaller steps; where grains yield, with another
formula of the threshold, too. ``jam`` needs the plug-in (python -m pip install -e plugins/rodnet-jamming).
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from functools import partial
from pathlib import Path

import matplotlib
import numpy as np

import rodnet as rn
from rodnet.report import sentences

matplotlib.use("Agg")
import matplotlib.pyplot as plt

HERE = Path(__file__).resolve().parent
CASE = rn.load_case(HERE / "recordings" / "paper.py")
robot, Turned = (CASE.build.__globals__[name] for name in ("robot", "Turned"))
RATE = 30.0  # frames a second
FINE = {"yield": 24, "jam": 32}  # edges of a tail in the truth
WHITE = {"position": 1e-4, "head_speed": 3.0, "tail_speed": 3.0}  # noise of a frame [m], [rpm], [rpm]
SPEEDS = (100.0, 130.0, 160.0, 190.0, 220.0, 250.0)  # of the paper's fit, two tails [rpm]
SPREAD = 0.04  # of a steady speed from one experiment to the next
YIELD = {"stress": 0.12, "bearing": 9.14, "speed": 3e-6}  # [Pa], a smooth rod's, of the creep [m/s]
# number of tails, and speeds of the motor [rpm] after 0, 4, 8 ... s
TRIALS = {
    "yield": [
        (2, (100.0, 200.0, 0.0)), (2, (240.0, 60.0, 140.0)), (2, (60.0, 160.0, 80.0)), (3, (120.0, 220.0, 0.0)),
        (3, (200.0, 80.0, 160.0)), (2, (180.0, 90.0, 0.0)), (3, (80.0, 240.0, 100.0)),
    ],
    "jam": [
        (2, (208.0, 120.0)), (4, (208.0, 208.0)), (3, (160.0, 240.0)), (4, (240.0, 180.0)), (4, (140.0, 210.0)),
        (4, (180.0, 220.0)), (3, (220.0, 150.0)),
    ],
}  # fmt: skip
HELD = 2  # the last of them are held out
PLATEAU, RAMP, SEED = 4.0, 0.5, 0  # [s], [s]
MINUTES = 180.0  # that a diagnosis may take: a medium that remembers has derivatives by differences
TITLES = {"yield": "grains that yield", "jam": "grains that jam between four tails"}
# what is tried unless --all is given
TRIED = {
    "yield": ["yield", "medium-friction", "power-law", "anisotropy", "jam-onset", "kelvin-voigt"],
    "jam": ["neighbours", "yield", "power-law", "jam-onset", "jamming"],
}
# of the model: edges of a tail (jams are remembered in cells of 9.4 mm, so two of them), time step [s]
COARSE = {"yield": (8, 1.0 / 30.0), "jam": (16, 1.0 / 15.0)}


@rn.kernel
def _threshold(v, x, tangent, radius, t, p, f, dfdv, dfdtangent):
    """Fill force per length and its derivatives at one site; ``p = (stress, bearing, speed)``."""
    size = np.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2 + p[2] ** 2)
    along = v[0] * tangent[0] + v[1] * tangent[1] + v[2] * tangent[2]
    across, skew = 2.0 * p[1], 2.0 * np.pi - 2.0 * p[1]
    strength = p[0] * radius / size
    for i in range(3):
        f[i] = -strength * (across * v[i] + skew * along * tangent[i])
        for j in range(3):
            dfdv[i, j] = -strength * skew * tangent[i] * tangent[j] - f[i] * v[j] / size**2
            dfdtangent[i, j] = -strength * skew * v[j] * tangent[i]
        dfdv[i, i] -= strength * across
        dfdtangent[i, i] -= strength * skew * along


class Threshold(rn.DragModel):
    """Grains that yield, f = -sigma r (2 pi v_t + 2 N v_n) / sqrt(v^2 + u^2) per unit length."""

    default_name = "threshold"
    claims = {"dissipative", "objective"}
    stress = rn.Parameter(0.1, unit="Pa", bounds=(0, None), null=0.0, doc="sigma, at which grains yield")
    bearing = rn.Parameter(9.14, unit="1", bounds=(0, None), kind="shape", doc="N, of a rod pushed across")
    speed = rn.Parameter(1e-6, unit="m/s", bounds=(1e-9, None), kind="shape", doc="u, of creep below it")
    kernel = _threshold

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


def record(medium, n_tails, speeds, name, rng, edges=None, plateau=PLATEAU):
    """Film the true robot."""
    duration = plateau * len(speeds)
    begin = plateau * np.arange(len(speeds))
    times = np.stack([begin, begin + RAMP], axis=1).ravel()
    rpm = np.stack([(0.0, *speeds[:-1]), speeds], axis=1).ravel()
    true = true_robot(
        medium, n_tails, Turned(np.append(times, duration), np.append(rpm, rpm[-1])), edges or FINE[medium]
    )
    t = np.arange(round(duration * RATE) + 1) / RATE
    # implicit Euler at a quarter of a frame, or half of one where the medium has a memory
    traj = rn.Simulation(true, dt=1.0 / RATE / (2.0 if medium == "jam" else 4.0)).run(duration)
    blank = rn.Recording(t, np.zeros((len(t), 1, 3)), names=["head"])
    seen = dict(zip(WHITE, rn.observe(CASE.observe(blank, true), traj, t), strict=True))
    noisy = {key: seen[key] + WHITE[key] * rng.standard_normal(seen[key].shape) for key in WHITE}
    markers = np.zeros((len(t), 1, 3))  # the camera sees the distance along the tube alone
    markers[:, 0, 0] = noisy.pop("position")[:, 0, 0]
    channels = {**noisy, "motor": np.interp(t, times, rpm)}
    return rn.Recording(
        t, markers, names=["head"], channels=channels, attrs={"n_tails": n_tails}, name=name,
        noise=rn.NoiseModel(white=WHITE["position"]),
    )  # fmt: skip


# -- the paper's fit --------------------------------------------------------------------------------
def steady(medium, speeds, rng, edges=None, until=8.0):
    """Steady speed [m/s] and head speed [rpm] of two tails, as read from an experiment at each speed of the motor."""
    found = []
    for rpm in speeds:
        t = np.array([0.0, 0.5, 1.0]) * until
        blank = rn.Recording(
            t,
            np.zeros((3, 1, 3)),
            channels={"motor": np.full(3, rpm)},
            attrs={"n_tails": 2},
            name=f"{rpm:g} rpm",
        )
        true = true_robot(medium, 2, Turned(t, blank.channels["motor"]), edges or FINE[medium])
        traj = rn.Simulation(true, dt=1.0 / RATE).run(until)
        read = [seen[-1] for seen in rn.observe(gauges(blank, true), traj, t)]
        speed = read[0] * (1.0 + SPREAD * rng.standard_normal())
        head_speed = read[1] + WHITE["head_speed"] * rng.standard_normal()
        once = {"speed": [np.nan, np.nan, speed], "head_speed": [np.nan, np.nan, head_speed]}
        found.append(blank.replace(channels={**blank.channels, **{k: np.array(v) for k, v in once.items()}}))
    return found


def gauges(rec, robot):
    """A ruler and a clock, and a counter on the head."""
    return [
        rn.Reading(robot, "speed", lambda state: state.velocity("head:1")[0], unit="m/s"),
        rn.HeadSpeed(robot, "head_speed"),
    ]


def paper_fit(medium, rng, edges=None):
    """Fit resistive force theory to steady speeds of two tails; return the fit, and the readings."""
    readings = steady(medium, SPEEDS, rng, edges)
    case = replace(
        CASE, observe=gauges, options=lambda rec, robot: {"dt": 0.05, "stepper": "euler"}, name="paper's fit"
    )
    sizes = lambda rec: {  # noqa: E731
        "speed": SPREAD * abs(float(rec.channels["speed"][-1])), "head_speed": WHITE["head_speed"],
    }  # fmt: skip
    return rn.calibrate(case, readings, noise=sizes, outliers=None, workers=0), readings


# -- the diagnosis ----------------------------------------------------------------------------------
def recordings(medium, folder, quick=False):
    """Film the trials of a medium, or read what an earlier run has filmed; return those to train, and held out."""
    found = []
    for k, (n, speeds) in enumerate(TRIALS[medium][1:-1] if quick else TRIALS[medium]):
        path = folder / f"{k}_{n}_tails.npz"
        if not path.is_file():
            path.parent.mkdir(parents=True, exist_ok=True)
            some = {"speeds": speeds[-2:], "plateau": 3.0} if quick else {"speeds": speeds}
            record(medium, n, name=path.stem, rng=np.random.default_rng([SEED, k]), **some).save(path)
        found.append(rn.read_recording(path))
    count = 1 if quick else HELD
    return found[:-count], found[-count:]


def coarse(rec, edges):
    """The robot of a recording as the model has it."""
    turned = Turned(rec.t - rec.t[0], np.array(rec.channels["motor"]))
    return robot(int(rec.attrs["n_tails"]), turned, edges)


def predicted(rec, values):
    """Where the head of the model is [m], with given values of its parameters."""
    swimmer = CASE.robot(rec).with_parameters(values)
    traj = rn.Simulation(swimmer, **CASE.simulation(rec, swimmer)).run(rec.t[-1] - rec.t[0])
    return rn.observe(CASE.observe(rec, swimmer), traj, rec.t)[0][:, 0, 0]


def study(medium, out, only, workers=0, quick=False, progress=True):
    """Fit as the paper did, then diagnose; print what is found, and return all that a figure needs."""
    print(f"\n== {TITLES[medium]}")
    fit, readings = paper_fit(medium, np.random.default_rng(SEED))
    values = {path: fit.parameters[path].value for path in CASE.free}
    off = [fit.predicted[rec.name][0][-1] / float(rec.channels["speed"][-1]) - 1.0 for rec in readings]
    print(f"the paper's fit, two tails from {SPEEDS[0]:g} to {SPEEDS[-1]:g} rpm:")
    print("  " + ", ".join(f"{path} = {value:.3g}" for path, value in values.items()))
    rms = float(np.sqrt(np.mean(np.square(off))))
    print(f"  speeds off by {100 * rms:.1f} % rms, where experiments scatter by {100 * SPREAD:g} %")
    train, held = recordings(medium, out / medium, quick)
    edges, dt = COARSE[medium]
    case = replace(
        CASE, build=partial(coarse, edges=edges), options=lambda rec, robot: {"dt": dt, "stepper": "sdirk2"}
    )
    found = rn.diagnose(
        case, train, hold_out=held, noise=WHITE, start=values, candidates=only, workers=workers, progress=progress,
        resume=out / medium, ledger=out / f"{medium}.ledger.jsonl", minutes=MINUTES,
    )  # fmt: skip
    tell(found)
    return values, fit, readings, held[0], found


def tell(found):
    """Print verdict, terms, ranking, and errors on held-out trials."""
    told = found.to_dict()
    print(f"verdict: {found.verdict}")
    for one, term in zip(found.findings, told["terms"], strict=True):
        print(f"  {one.title} [{one.status}], regime: {term['regime']}; {one.effect_sigma:.2g} sigma")
        for path, value in one.parameters.items():
            print(f"    {path}: {sentences.told(value)}")
        if one.equivalents:
            print(f"    as good: {', '.join(one.equivalents)}")
    for one in found.tried:
        why = "" if one.accepted else f": {one.reasons[0]}"
        print(f"  tried {one.id}: {0.5 * one.cross_gain:.3g} nats on trials left out{why}")
    for proposal in found.proposals:
        print(f"  next: {proposal.sentence}")
    print(f"  what is left: p = {found.remainder.p:.2g}, {found.remainder.excess:.2g} sigma")
    errors = [found.held.before.error, found.held.after.error, found.floor]
    names = ("resistive force theory", "repaired", "noise alone")
    print("on trials held out, rms error of the position:")
    for name, error in zip(names, errors, strict=True):
        print(f"  {name:24}{1e3 * error:.3f} mm")


def draw(medium, values, fit, readings, rec, found, path):
    """Draw the fit that hid it, a trial held out, and how explanations rank."""
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(12, 3.4), layout="constrained")
    measured = [1e3 * float(rec.channels["speed"][-1]) for rec in readings]
    left.plot(SPEEDS, measured, "o", color="k", label="measured")
    left.plot(SPEEDS, [1e3 * fit.predicted[rec.name][0][-1] for rec in readings], "tab:red", label="fitted")
    left.set(
        xlabel="motor [rpm]", ylabel="steady speed, n = 2 [mm/s]", title=f"{TITLES[medium]}: the paper's fit"
    )
    left.set_ylim(bottom=0.0)
    left.legend()
    begin = rec.markers[:10, 0, 0].mean()  # it hardly moves yet
    lines = {
        "the paper's fit": (predicted(rec, values), "tab:red"),
        "fitted to all trials": (found.held.before.fitted.fits[0].predicted[0][:, 0, 0], "tab:orange"),
        "repaired": (found.held.after.fitted.fits[0].predicted[0][:, 0, 0], "tab:blue"),
    }
    middle.plot(rec.t, 1e3 * (rec.markers[:, 0, 0] - begin), ".", ms=3, color="0.6", label="measured")
    for label, (x, color) in lines.items():
        middle.plot(rec.t, 1e3 * (x - begin), color=color, label=label)
    title = f"a trial held out, n = {rec.attrs['n_tails']:.0f}"
    middle.set(xlabel="time [s]", ylabel="position [mm]", title=title)
    middle.legend()
    first = found.screened[::-1]
    right.barh([s.candidate.id for s in first], [s.chi2 for s in first], color="tab:blue")
    right.set(xlabel="score (fall of deviance to first order)", title=f"verdict: {found.verdict}")
    figure.savefig(path, dpi=120)
    plt.close(figure)


def main(arguments=None):
    """Fit, film, diagnose, draw; return the diagnosis of each medium."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--medium", choices=list(TITLES), action="append", help="one of the two alone")
    parser.add_argument(
        "--out", type=Path, default=Path("paper_concealed"), help="directory of recordings and results"
    )
    parser.add_argument("--all", action="store_true", help="try every explanation that is installed")
    parser.add_argument(
        "--quick", action="store_true", help="four trials of 6 s, one held out, three explanations"
    )
    parser.add_argument("--workers", type=int, default=0, help="processes beside this one")
    given = parser.parse_args(arguments)
    results = {}
    for medium in given.medium or list(TITLES):
        only = None if given.all else TRIED[medium][: 3 if given.quick else None]
        *fitted, found = study(medium, given.out, only, given.workers, given.quick)
        draw(medium, *fitted, found, given.out / f"{medium}.png")
        found.save(given.out / medium)
        results[medium] = found
    print(f"written: {given.out}")
    return results


if __name__ == "__main__":
    main()
