"""Time steppers: how velocity and acceleration follow from the new position.

A stepper is stateless. Over a step of length dt it imposes v = cv (q - q_old) + v0 and
a = ca (q - q_old) + a0, and the new q solves M a = F(q, v, t_new): the balance of forces holds
exactly at the end of the step, whatever the order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np

from rodnet.errors import ParameterError

# velocities and accelerations of the stages of a step
Rates = list[tuple[np.ndarray, np.ndarray]]


class Pace(NamedTuple):
    """What step size control remembers from step to step.

    Attributes
    ----------
    step : float
        Size of the next step to try [s].
    lengths : ndarray, shape (2,)
        Sizes of the last step and of the one before [s]; 0 where there was none.
    mean, bend : ndarray, shape (dof_count,)
        Mean velocity of the last step, and the acceleration that the mean velocities of the last two
        imply. Positions alone tell them: where something is stiff, velocities at the ends of steps and
        still more so accelerations are rough.
    """

    step: float
    lengths: np.ndarray
    mean: np.ndarray
    bend: np.ndarray


@dataclass(frozen=True)
class State:
    """An accepted state; all arrays are copies that nothing else changes.

    Attributes
    ----------
    t : float
        Time [s].
    index : int
        Number of full steps taken.
    q, v, a : ndarray, shape (dof_count,)
        Degrees of freedom, their rates and accelerations ([m], [rad] and per s, s^2).
    acc : ndarray, shape (dof_count,)
        The stepper's algorithmic acceleration (equal to ``a`` where it has none).
    tangents, directors : ndarray, shape (edge_count, 3)
        Tangents and first reference directors: the source of the next step's parallel transport.
    tau : ndarray, shape (spring_count,)
        Twist of every spring, with its full turns [rad].
    memories : tuple of (ndarray or None)
        Memory of every term.
    turns : ndarray of int, shape (edge_count,)
        Full turns taken out of the twist angles in ``q``, which stay small so that nothing is lost
        to round-off in long runs: the whole angle is theta + 2 pi turns.
    pace : Pace or None
        What step size control remembers.
    """

    t: float
    index: int
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    acc: np.ndarray
    tangents: np.ndarray
    directors: np.ndarray
    tau: np.ndarray
    memories: tuple[np.ndarray | None, ...]
    turns: np.ndarray
    pace: Pace | None = None

    def at(self, t: float, index: int) -> State:
        """Return the state with another clock reading."""
        return replace(self, t=t, index=index)


class Stepper:
    """Base class of time steppers; see the module's note.

    A step has one or more stages, at fractions ``nodes`` of dt, the last one at its end. Every stage
    solves for its own q with the same ``coefficients``.

    Attributes
    ----------
    name : str
        Name on the command line and in files.
    order : int
        Order of accuracy.
    exact_rates : bool
        Whether prescribed degrees of freedom take the rates of the prescribed motion itself.
    nodes : tuple of float
        Times of the stages as fractions of the step.
    needs_acceleration : bool
        Whether the first step needs a consistent acceleration to start from.
    error_constant : float
        The step's local error over dt^(order + 1) times as high a derivative of q, smooth motion supposed.
    """

    name: ClassVar[str] = ""
    order: ClassVar[int] = 1
    exact_rates: ClassVar[bool] = True
    nodes: tuple[float, ...] = (1.0,)
    needs_acceleration: ClassVar[bool] = False
    error_constant: float = 0.5

    def coefficients(self, dt: float) -> tuple[float, float]:
        """Return cv [1/s] and ca [1/s^2]."""
        raise NotImplementedError

    def offsets(self, state: State, dt: float, done: Rates) -> tuple[np.ndarray | None, np.ndarray]:
        """Return v0 and a0, shape (dof_count,), given the rates (v, a) of the stages that are done.

        None stands for zeros.
        """
        raise NotImplementedError

    def acceleration(
        self, state: State, v: np.ndarray, q: np.ndarray, a: np.ndarray, dt: float
    ) -> np.ndarray:
        """Algorithmic acceleration at the end of a step, shape (dof_count,)."""
        return a

    def predict(self, state: State, dt: float, done: Rates) -> np.ndarray:
        """Extrapolated guess of the stage's q."""
        raise NotImplementedError


class ImplicitEuler(Stepper):
    """Backward Euler (paper, equations of motion): robust, first order, damps oscillations.

    A 3 Hz swing at dt = 0.01 s loses 44 % of its amplitude per period: use `SDIRK2` there.
    """

    name = "euler"
    order = 1
    exact_rates = False

    def coefficients(self, dt: float) -> tuple[float, float]:
        """Return cv = 1/dt and ca = 1/dt^2."""
        return 1.0 / dt, 1.0 / dt**2

    def offsets(self, state: State, dt: float, done: Rates) -> tuple[np.ndarray | None, np.ndarray]:
        """Return v0 = 0 and a0 = -v/dt."""
        return None, state.v / -dt

    def predict(self, state: State, dt: float, done: Rates) -> np.ndarray:
        """Extrapolate with the velocity that the last acceleration predicts."""
        return state.q + dt * (state.v + dt * state.a)


class GeneralizedAlpha(Stepper):
    """Generalised-alpha (Chung & Hulbert 1993) in the form of Arnold & Bruels 2007.

    (1 - am) A_new + am A_old = (1 - af) a_new + af a_old with Newmark's q, v by A; M a = F holds at
    the end of every step. Second order; ``rho`` is the spectral radius at infinite frequency.

    Parameters
    ----------
    rho : float
        0 (strongest damping of high frequencies) to 1 (none).
    """

    name = "alpha"
    order = 2
    needs_acceleration = True

    def __init__(self, rho: float = 0.9) -> None:
        if not 0.0 <= rho <= 1.0:
            raise ParameterError(f"GeneralizedAlpha: rho = {rho!r} must lie in [0, 1]")
        self.rho = rho
        self.am, self.af = (2.0 * rho - 1.0) / (rho + 1.0), rho / (rho + 1.0)
        self.gamma = 0.5 - self.am + self.af
        self.beta = 0.25 * (self.gamma + 0.5) ** 2
        # the algorithmic acceleration is that of a time am - af steps later
        self.error_constant = self.beta + 0.5 * (self.am - self.af) - 1.0 / 6.0

    def coefficients(self, dt: float) -> tuple[float, float]:
        """Return cv and ca."""
        ca = (1.0 - self.am) / ((1.0 - self.af) * self.beta * dt**2)
        return self.gamma / (self.beta * dt), ca

    def offsets(self, state: State, dt: float, done: Rates) -> tuple[np.ndarray, np.ndarray]:
        """Return v0 and a0."""
        constant = -(state.v / dt + (0.5 - self.beta) * state.acc) / self.beta
        v0 = state.v + dt * ((1.0 - self.gamma) * state.acc + self.gamma * constant)
        a0 = ((1.0 - self.am) * constant + self.am * state.acc - self.af * state.a) / (1.0 - self.af)
        return v0, a0

    def predict(self, state: State, dt: float, done: Rates) -> np.ndarray:
        """Extrapolate with constant algorithmic acceleration."""
        return state.q + dt * state.v + 0.5 * dt * dt * state.acc

    def acceleration(
        self, state: State, v: np.ndarray, q: np.ndarray, a: np.ndarray, dt: float
    ) -> np.ndarray:
        """Newmark's acceleration from the displacement."""
        return ((q - state.q) / dt - state.v) / (self.beta * dt) - (0.5 - self.beta) / self.beta * state.acc


class SDIRK2(Stepper):
    """Two-stage diagonally implicit Runge-Kutta method, second order, L-stable, stiffly accurate.

    Alexander 1977, gamma = 1 - 1/sqrt(2). It needs no acceleration to start from and damps what dt
    does not resolve (the axial waves of a nearly inextensible cable), where generalised-alpha with
    rho near 1 lets a rough start grow. A resolved swing keeps its energy: the amplitude loses about
    0.0037 (omega dt)^4 per step, 0.02 % per period at 3 Hz and dt = 0.01 s. Two solves per step.
    """

    name = "sdirk2"
    order = 2
    gamma = 1.0 - 1.0 / math.sqrt(2.0)
    error_constant = 3.0 * gamma**2 - 2.0 * gamma**3 - 1.0 / 6.0
    nodes = (gamma, 1.0)

    def coefficients(self, dt: float) -> tuple[float, float]:
        """Return cv = 1/(gamma dt) and ca = cv^2."""
        cv = 1.0 / (self.gamma * dt)
        return cv, cv * cv

    def offsets(self, state: State, dt: float, done: Rates) -> tuple[np.ndarray | None, np.ndarray]:
        """Return v0 and a0 of the first or second stage."""
        if not done:
            return None, state.v / -(self.gamma * dt)
        v0 = -(1.0 - self.gamma) / self.gamma * done[0][0]
        a0 = v0 - (state.v + (1.0 - self.gamma) * dt * done[0][1])
        a0 /= self.gamma * dt
        return v0, a0

    def predict(self, state: State, dt: float, done: Rates) -> np.ndarray:
        """Extrapolate with the acceleration that velocities imply, of the last step or the first stage.

        The stages' own accelerations, by which an overdamped motion's velocities follow, may be far off.
        """
        step = dt if done else self.gamma * dt
        acc = (done[0][0] - state.v) / (self.gamma * dt) if done else state.acc
        return state.q + step * state.v + 0.5 * step * step * acc

    def acceleration(
        self, state: State, v: np.ndarray, q: np.ndarray, a: np.ndarray, dt: float
    ) -> np.ndarray:
        """Mean acceleration of the step."""
        return (v - state.v) / dt


STEPPERS: dict[str, type[Stepper]] = {s.name: s for s in (ImplicitEuler, SDIRK2, GeneralizedAlpha)}


def make_stepper(stepper: str | Stepper) -> Stepper:
    """Return a stepper by name or as given.

    Raises
    ------
    ParameterError
        For an unknown name.
    """
    if isinstance(stepper, Stepper):
        return stepper
    if stepper not in STEPPERS:
        raise ParameterError(f"unknown stepper {stepper!r}; known are {', '.join(STEPPERS)}")
    return STEPPERS[stepper]()
