"""What one diagnosis costs: five trials of five seconds, in the plane, with thirteen candidates."""

from __future__ import annotations

import numpy as np

import rodnet as rn
from benchmarks.cases import Demand, Options, Result, Table
from rodnet.diagnosis.candidate import candidates

TITLE = "Diagnosis"
LIMIT = 60.0  # s of one core
LENGTH, EDGES, DT, RATE, SIGMA = 0.5, 20, 0.01, 20.0, 1e-3
POINTS = [f"rod@{k}%" for k in (20, 40, 60, 80, 100)]
TRIED = [
    "yield", "medium-friction", "power-law", "anisotropy", "gravity", "kelvin-voigt", "mass-damping",
    "stiffness-defect", "natural-curvature", "dry-friction", "added-mass", "grasp-offset", "camera-scale",
]  # fmt: skip
EFFECT = {"loss": 0.5, "place": 0.33, "width": 0.05}


class _Shaken:
    """Motion of the held end in the plane: a displacement, and a turn."""

    def __init__(self, k: int) -> None:
        f, a, g, b, phase = np.random.default_rng(100 + k).random(5)
        self.fast, self.slow = 2.0 * np.pi * (0.5 + 0.5 * f), 2.0 * np.pi * (0.3 + 0.6 * g)
        self.far, self.turn, self.phase = 0.03 + 0.05 * a, 0.3 * b, 6.0 * phase

    def position(self, t: float) -> np.ndarray:
        """Displacement [m]."""
        x, z = self.far * np.sin(self.fast * t), 0.5 * self.far * np.sin(self.slow * t)
        return (1.0 - np.exp(-((t / 0.3) ** 2))) * np.array([x, 0.0, z])

    def orientation(self, t: float) -> np.ndarray:
        """Rotation."""
        angle = (1.0 - np.exp(-((t / 0.3) ** 2))) * self.turn * np.sin(self.slow * t + self.phase)
        c, s = np.cos(angle), np.sin(angle)
        return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def case_robot(k: int, edges: int = EDGES) -> rn.Robot:
    """A rod in a viscous medium, shaken in the plane as in trial ``k``."""
    fig = rn.StickFigure().rod(
        "rod", [(0, 0, 0), (LENGTH, 0, 0)], edges=edges, material=rn.Material(E=2e6, rho=1200.0), radius=4e-3
    )
    shaken = _Shaken(k)
    held = rn.PrescribedMotion(at="rod.start", position=shaken.position, orientation=shaken.orientation)
    drag = rn.ResistiveForce(eta_t=1.0, eta_n=2.0)
    return rn.Robot(fig.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), drag, held])


def _recording(k: int, duration: float) -> rn.Recording:
    """A trial of a rod with a soft spot, on a mesh twice as fine and with half the time step."""
    true = case_robot(k, 2 * EDGES)
    (one,) = candidates(true, [], ["stiffness-defect"])
    built = one.build(true)
    assert built is not None
    true = built.with_parameters({f"{one.id}.{name}": value for name, value in EFFECT.items()})
    traj = rn.Simulation(true, dt=DT / 2, stepper="sdirk2").run(duration)
    t = np.arange(0.0, duration, 1.0 / RATE)
    seen = rn.observe([rn.Markers(true, POINTS)], traj, t)[0]
    seen = seen + SIGMA * np.random.default_rng(k).standard_normal(seen.shape)
    return rn.Recording(
        t, seen, names=[p.replace("@", "_") for p in POINTS], name=f"trial{k}", attrs={"k": k}
    )


CASE = rn.Case(
    lambda rec: case_robot(int(rec.attrs["k"])),
    lambda rec, robot: rn.Markers(robot, POINTS),
    free=("rod.E",),
    options=lambda rec, robot: {"dt": DT, "stepper": "sdirk2"},
    name="shaken",
)


def measure(options: Options) -> Result:
    """Diagnose once to compile kernels, then once for the figures."""
    duration = 0.5 if options.quick else 5.0
    trials = [_recording(k, duration) for k in range(7)]

    def work(some: list[rn.Recording], tried: list[str]) -> rn.Diagnosis:
        return rn.diagnose(CASE, some[:-2], hold_out=some[-2:], candidates=tried, noise=SIGMA, workers=0)

    work([_recording(k, 0.5) for k in range(7)], TRIED)
    found: list[rn.Diagnosis] = []
    seconds = options.clock.time(lambda: found.append(work(trials, TRIED)))
    (one,) = found
    named = ", ".join(f.id for f in one.findings) or "nothing"
    table = Table(
        f"Five trials of {duration:g} s, two more held out; {EDGES + 1} nodes in the plane, dt = {DT} s",
        ["candidates", "verdict", "found", "processor time [s]"],
        [[len(TRIED), one.verdict, named, seconds]],
    )
    text = (
        "All of a diagnosis but the bootstrap of the whole pipeline, kernels being compiled: calibration, numerical "
        "error, scores, refits, held-out trials, intervals, placebos, and the force over body and time. The "
        "recordings are those of a rod with a soft spot, on a mesh twice as fine."
    )
    demand = Demand("a diagnosis of five trials, one core", LIMIT, seconds, "s")
    return Result(TITLE, text, [table], [demand])
