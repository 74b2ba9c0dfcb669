"""Least squares along narrow curved valleys, to the lowest place."""

import numpy as np
import pytest
from scipy.optimize import least_squares, lsq_linear

from rodnet.inference.valley import BACK, along

NOISE = np.random.default_rng(5).standard_normal(500)
FREE = (np.full(2, -np.inf), np.full(2, np.inf))


class Product:
    """A product that is known 2000 times as well as one of its factors, which is a logarithm."""

    def __init__(self, beyond=np.inf):
        self.beyond, self.evaluations, self.runs = beyond, 0, 0

    def residual(self, z):
        self.runs += 1
        if z[0] > self.beyond:
            return None
        known = np.array([4000.0 * (z[0] * np.exp(z[1]) - 0.2), 2.0 * (z[1] + 2.5)])
        return np.concatenate([known, NOISE])

    def joint(self, z):
        self.evaluations += 1
        r = self.residual(z)
        J = np.zeros((2 + len(NOISE), 2))
        J[:2] = [[4000.0 * np.exp(z[1]), 4000.0 * z[0] * np.exp(z[1])], [0.0, 2.0]]
        return None if r is None else (r, J)


def fine(z, size):
    return 1e-8 * size, 1e-8 * size, 0.0


def test_a_curved_valley_is_followed_to_its_lowest_place():
    """Where straight steps must be short, it takes a fraction of them."""
    valley, straight = Product(), Product()
    z, done = along(valley.joint, valley.residual, np.array([0.2, 0.0]), FREE, fine, 60)
    assert done
    np.testing.assert_allclose(z, [0.2 * np.exp(2.5), -2.5], rtol=1e-4)
    found = least_squares(straight.residual, [0.2, 0.0], lambda z: straight.joint(z)[1], xtol=1e-8, ftol=1e-8)
    np.testing.assert_allclose(found.x, z, rtol=1e-3)
    assert valley.evaluations < 0.4 * straight.evaluations


def test_where_the_floor_is_straight_no_place_is_run_twice():
    """Derivatives are taken along with runs that need no correction."""
    slope = np.vstack([np.array([[3.0, 1.0], [0.5, 2.0]]), np.zeros((len(NOISE), 2))])
    offset = np.concatenate([[5.0, -2.0], NOISE])
    places = []

    def joint(z):
        places.append(tuple(z))
        return slope @ z + offset, slope

    def residual(z):
        places.append(tuple(z))
        return slope @ z + offset

    z, done = along(joint, residual, np.array([4.0, 4.0]), FREE, fine, 60)
    assert done
    np.testing.assert_allclose(z, -np.linalg.solve(slope[:2], offset[:2]), rtol=1e-3)
    assert len(places) == len(set(places))


class Level(Product):
    """The same beside a factor that hardly matters however far off it is."""

    def residual(self, z):
        known = super().residual(z)
        known[1] = 0.3 * np.hypot(z[1] + 8.0, 0.5)
        return known

    def joint(self, z):
        r, J = super().joint(z)
        J[1] = [0.0, 0.3 * (z[1] + 8.0) / np.hypot(z[1] + 8.0, 0.5)]
        return r, J


def test_where_steps_in_a_row_gain_less_than_is_uncertain_it_ends():
    """It is no more than about that above the lowest place, and saves a third of the steps there."""
    whole, part, least = Level(), Level(), 0.3
    low, _ = along(whole.joint, whole.residual, np.array([0.2, 0.0]), FREE, fine, 400)
    z, done = along(
        part.joint, part.residual, np.array([0.2, 0.0]), FREE, lambda z, s: (*fine(z, s)[:2], least), 400
    )
    assert done and part.evaluations < 0.7 * whole.evaluations
    above = np.sum(part.residual(z) ** 2) - np.sum(whole.residual(low) ** 2)
    assert 0.0 < above < 2.0 * least


def test_it_ends_where_evaluations_do_and_says_so():
    valley = Product()
    start = np.array([0.2, 0.0])
    z, done = along(valley.joint, valley.residual, start, FREE, fine, 7)
    assert not done and valley.runs <= 7 + BACK
    sizes = [float(np.sum(valley.residual(place) ** 2)) for place in (start, z)]
    assert sizes[1] < sizes[0]


def test_where_nothing_can_be_computed_it_does_not_go():
    """The lowest place that there is lies at the edge of what can be computed, and no place beyond is returned."""
    valley = Product(beyond=1.0)
    z, _ = along(valley.joint, valley.residual, np.array([0.2, 0.0]), FREE, fine, 300)
    assert valley.residual(z) is not None
    assert z[0] == pytest.approx(1.0, abs=0.1)
    assert z[0] * np.exp(z[1]) == pytest.approx(0.2, abs=1e-3)


def test_bounds_hold_and_what_they_need_not_stop_goes_on():
    """One begins at a bound that its own slope pushes it to, but not what it would do together with the others."""
    rng = np.random.default_rng(4)
    J = rng.standard_normal((40, 6)) @ (np.eye(6) + 0.9)
    r = rng.standard_normal(40)
    within = (np.full(6, -0.05), np.full(6, 0.2))
    z, done = along(lambda z: (r + J @ z, J), lambda z: r + J @ z, np.full(6, 0.2), within, fine, 40)
    exact = lsq_linear(J, -r, within, method="bvls").x
    assert done
    assert np.any(np.isclose(exact, within[0])) and np.any((exact > -0.049) & (exact < 0.199))
    np.testing.assert_allclose(z, exact, atol=2e-4)
    assert np.all(z >= within[0]) and np.all(z <= within[1])


def test_what_is_held_stays():
    valley, within = Product(), (np.array([-9.0, -1.0]), np.array([9.0, -1.0]))
    z, _ = along(valley.joint, valley.residual, np.array([0.2, -1.0]), within, fine, 30)
    np.testing.assert_allclose(z, [0.2 * np.exp(1.0), -1.0], rtol=1e-4)
