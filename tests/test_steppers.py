"""Every stepper keeps the contract, one of a user's own too, and steppers that do not are told why."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.solve.steppers import STEPPERS


class Newmark(rn.Stepper):
    """Constant mean acceleration, as in the how-to."""

    name, order, needs_acceleration, error_constant = "newmark", 2, True, 1.0 / 12.0

    def coefficients(self, dt):
        return 2.0 / dt, 4.0 / dt**2

    def offsets(self, state, dt, done):
        return -state.v, -4.0 * state.v / dt - state.a

    def predict(self, state, dt, done):
        return state.q + dt * state.v + 0.5 * dt * dt * state.a


OTHERS = [rn.GeneralizedAlpha(0.0), rn.GeneralizedAlpha(0.6), Newmark, Newmark()]


def title(stepper) -> str:
    """A name that is the same in every process."""
    if isinstance(stepper, str):
        return stepper
    return (
        stepper.__name__ if isinstance(stepper, type) else f"{type(stepper).__name__}{OTHERS.index(stepper)}"
    )


@pytest.mark.parametrize("stepper", [*STEPPERS, *OTHERS], ids=title)
def test_steppers_keep_the_contract(stepper):
    report = rn.testing.check_stepper(stepper)
    assert {
        "order, swinging rod", "order, overdamped rod", "energy", "linear momentum", "angular momentum by dt",
        "restart", "restart from a file", "restart of chosen steps", "no state of its own",
    } <= set(report.errors)  # fmt: skip


class Late(Newmark):
    """Says that it is of second order, and takes the acceleration of the old time for that of the new."""

    def offsets(self, state, dt, done):
        return -state.v, -4.0 * state.v / dt - 1.2 * state.a


class Braking(rn.ImplicitEuler):
    """Takes some of the velocity away."""

    def offsets(self, state, dt, done):
        return None, -0.999 * state.v / dt


class Whirling(rn.ImplicitEuler):
    """Turns velocities about z by 2 degrees per step: free rods keep the sum of none, and spin up others."""

    def offsets(self, state, dt, done):
        v = state.v.copy()
        n = 3 * (len(v) // 4)
        v[0:n:3], v[1:n:3] = v[0:n:3] - 0.035 * v[1:n:3], v[1:n:3] + 0.035 * v[0:n:3]
        return None, -v / dt


class Hoarding(rn.ImplicitEuler):
    """Keeps what it saw in a list."""

    def __init__(self):
        self.seen = []

    def predict(self, state, dt, done):
        self.seen.append(float(np.abs(state.v).max()))
        return super().predict(state, dt, done)


@pytest.mark.parametrize(
    ("stepper", "message"),
    [
        (Late, "order, swinging rod|energy"),
        (Braking, "order, swinging rod|linear momentum"),
        (Whirling, "order, swinging rod|energy|momentum"),
        (Hoarding, "no state of its own"),
    ],
)
def test_broken_steppers_fail(stepper, message):
    with pytest.raises(rn.testing.ContractError, match=message):
        rn.testing.check_stepper(stepper)
