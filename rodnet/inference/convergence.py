"""What the time step does to a prediction: halved, and beside the damping that was fitted (docs, theory: steppers)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg import eigh

from rodnet.errors import CaseError, ConvergenceError, EquilibriumError
from rodnet.inference.naive import prescribed
from rodnet.recordings.observation import Markers
from rodnet.simulation import Simulation
from rodnet.solve.modes import linearised
from rodnet.solve.statics import equilibrium
from rodnet.solve.steppers import State, Stepper, make_stepper

if TYPE_CHECKING:
    from rodnet.inference.trial import Trial
    from rodnet.trajectory import Trajectory

SHARE = 0.01  # of the kinetic energy, from which on a mode counts
OWN = 0.5  # of a mode's frequency, from which on its motion is vibration; below, it follows the others
FLOOR = 1e-9  # of the largest inertia of its kind, where there is none


@dataclass(frozen=True)
class SwingingMode:
    """A vibration of the robot about its equilibrium, and what one period takes of its amplitude.

    Attributes
    ----------
    frequency : float
        Of the undamped vibration [Hz].
    share : float
        Of the kinetic energy of the predicted motion, mean over time: its motion from half its frequency on.
    fitted, numerical : float
        What the model's damping, and the time step, take of the amplitude in one period [1].
    """

    frequency: float
    share: float
    fitted: float
    numerical: float


@dataclass(frozen=True)
class Convergence:
    """How far a prediction depends on its time step.

    Attributes
    ----------
    dt : float
        The time step [s].
    rms_mm, max_mm : float
        Change of the free markers' positions when the step is halved [mm].
    modes : list of SwingingMode
        Those with more than a hundredth of the kinetic energy, the slowest first. Not those that are overdamped:
        they have no period.
    told : str
        Why there are no modes, or no finer run; else empty.
    """

    dt: float
    rms_mm: float | None
    max_mm: float | None
    modes: list[SwingingMode]
    told: str = ""

    @property
    def worst(self) -> float | None:
        """Largest numerical loss over the fitted one of all these modes [1]."""
        return max((m.numerical / max(m.fitted, 1e-300) for m in self.modes), default=None)

    def to_dict(self) -> dict[str, Any]:
        """Everything, for machines."""
        return {**asdict(self), "numerical_over_fitted": self.worst}


def convergence(trial: Trial, traj: Trajectory, predicted: list[np.ndarray]) -> Convergence:
    """Halve the time step of a prediction, and find what it takes of the vibrations.

    Parameters
    ----------
    trial : Trial
        The trial.
    traj : Trajectory
        Its motion.
    predicted : list of ndarray
        What instruments would have read of it.

    Raises
    ------
    CaseError
        If the step is adaptive.
    """
    if trial.options.get("adaptive") is not None:
        raise CaseError(
            "a step that adapts itself cannot be halved: leave out 'adaptive' of the case's options"
        )
    dt, told = float(trial.options["dt"]), []
    finer, failure = replace(trial, options={**trial.options, "dt": 0.5 * dt}).predict()
    off = _changes(trial, predicted, finer)
    if failure:
        told.append(f"half the time step {failure}")
    try:
        modes = _modes(trial, traj, make_stepper(trial.options.get("stepper", "sdirk2")), dt)
    except (EquilibriumError, ConvergenceError) as error:
        path = getattr(error, "debug_path", None)
        if path is not None:
            Path(path).unlink(missing_ok=True)
        modes = []
        told.append(f"no modes, for there is no equilibrium to vibrate about: {error}")
    rms = 1e3 * float(np.sqrt(np.mean(off**2))) if len(off) and not failure else None
    most = 1e3 * float(off.max()) if len(off) and not failure else None
    return Convergence(dt, rms, most, modes, "; ".join(told))


def _changes(trial: Trial, one: list[np.ndarray], two: list[np.ndarray]) -> np.ndarray:
    """Distances between two predictions of the free markers [m]."""
    found = [np.zeros(0)]
    for eye, a, b in zip(trial.observations, one, two, strict=True):
        if isinstance(eye, Markers):
            found.append(np.linalg.norm(a - b, axis=2)[:, ~prescribed(trial.rec, eye)].ravel())
    return np.concatenate(found)


def _modes(trial: Trial, traj: Trajectory, stepper: Stepper, dt: float) -> list[SwingingMode]:
    """Vibrations about the equilibrium of what is held as in the middle of the trial.

    All modes of K and M; the damping C is small, and a mode's own rate of decay phi' C phi / 2.
    """
    middle = len(traj) // 2
    rest = equilibrium(trial.robot, t=float(traj.t[middle]), start=traj.state(middle))
    sim = Simulation(trial.robot, 1.0)
    state = rest.state()
    sim.restore(state)
    system = linearised(sim, state, float(traj.t[middle]))
    K, C, M = (np.asarray(a.toarray(), dtype=float) for a in system[:3])
    free, own = system.free, np.diag(M).copy()
    for kind in (free < sim.model.twist0, free >= sim.model.twist0):
        if kind.any():
            own[kind] = np.maximum(own[kind], FLOOR * own[kind].max())
    M[np.diag_indices(len(own))] = own
    squares, shapes = eigh(0.5 * (K + K.T), 0.5 * (M + M.T))
    v = np.array([traj.state(k).v[free] for k in range(len(traj))]) @ M @ shapes
    energy = _vibrating(v, dt, np.sqrt(np.maximum(squares, 0.0)) / (2.0 * np.pi))
    decay = 0.5 * np.einsum("im,ij,jm->m", shapes, C, shapes)
    found = []
    for square, rate, part in zip(squares, decay, energy, strict=True):
        if part > SHARE and square > rate**2:
            omega = float(np.sqrt(square))
            period = 2.0 * np.pi / omega
            lost = 1.0 - float(np.exp(-rate * period))
            found.append(SwingingMode(1.0 / period, float(part), lost, numerical_loss(stepper, omega, dt)))
    return found


def _vibrating(v: np.ndarray, dt: float, frequency: np.ndarray) -> np.ndarray:
    """Shares of the kinetic energy, (m,), of modal velocities (frames, m) from half their mode's frequency on.

    A robot that moves far is not where its modes are of: what turns there stretches here. Such motion is slow, and
    no vibration of a stiff mode.
    """
    power = np.abs(np.fft.rfft(v, axis=0)) ** 2
    power[1 : (len(v) + 1) // 2] *= 2.0  # both signs
    own = np.fft.rfftfreq(len(v), dt)[:, None] >= OWN * frequency
    return np.asarray((power * own).sum(axis=0) / power.sum())


def numerical_loss(stepper: Stepper, omega: float, dt: float) -> float:
    """What a stepper takes of the amplitude of an undamped oscillation in one period [1].

    From the eigenvalues of its step of a'' = -omega^2 a, a linear map of position, velocity and accelerations.

    Parameters
    ----------
    stepper : Stepper
        The stepper.
    omega : float
        Of the oscillation [rad/s].
    dt : float
        Time step [s].
    """
    step = np.array([_oscillate(stepper, column, omega, dt) for column in np.eye(4)]).T
    values = np.linalg.eigvals(step)
    nearest = values[np.argmin(np.abs(values - np.exp(1j * omega * dt)))]
    return float(1.0 - np.abs(nearest) ** (2.0 * np.pi / (omega * dt)))


def _oscillate(stepper: Stepper, start: np.ndarray, omega: float, dt: float) -> np.ndarray:
    """One step of position, velocity, acceleration and algorithmic acceleration."""
    q, v, a, acc = start[:, None]
    none = np.zeros((0, 3))
    state = State(0.0, 0, q, v, a, acc, none, none, np.zeros(0), (), np.zeros(0, dtype=int))
    done: list[tuple[np.ndarray, np.ndarray]] = []
    new = q
    cv, ca = stepper.coefficients(dt)
    for _ in stepper.nodes:
        v0, a0 = stepper.offsets(state, dt, done)
        new = (ca * q - a0) / (ca + omega**2)
        rate = cv * (new - q) + (0.0 if v0 is None else v0)
        done.append((rate, ca * (new - q) + a0))
    v, a = done[-1]
    return np.array([new, v, a, stepper.acceleration(state, v, new, a, dt)])[:, 0]


def summed(found: list[Mapping[str, Any]]) -> dict[str, Any] | None:
    """Sum up recordings: rms over them, the largest change, and the largest loss over the fitted one."""
    if not found:
        return None
    rms = [one["rms_mm"] for one in found if one["rms_mm"] is not None]
    most = [one["max_mm"] for one in found if one["max_mm"] is not None]
    losses = [one["numerical_over_fitted"] for one in found if one["numerical_over_fitted"] is not None]
    return {
        "dt": found[0]["dt"],
        "rms_mm": float(np.sqrt(np.mean(np.square(rms)))) if rms else None,
        "max_mm": max(most, default=None),
        "numerical_over_fitted": max(losses, default=None),
    }
