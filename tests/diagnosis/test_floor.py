"""Places of a profile in a curved valley: on its floor, or not believed."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from rodnet.diagnosis.confirm import RISE, _end, _on_the_floor
from rodnet.diagnosis.findings import Interval, idle_below
from rodnet.report.sentences import told

LITTLE = 1.4
STEEP = 4000.0


class Valley:
    """A product is known to a 4000th, one of its factors is a logarithm w; the other is 1 + g."""

    def residual(self, z):
        g, w = z
        return np.array([STEEP * (np.exp(w) * (1.0 + g) - 1.0), 3.0 * g**2, 2.0 * w])

    def fits(self, z, slopes):
        return [SimpleNamespace(residual=self.residual(z))]

    def priors(self, z):
        return np.zeros(0), np.zeros((0, 2))


J = np.array([[STEEP, STEEP], [0.0, 0.0], [0.0, 2.0]])  # where both are zero, the optimum


def lowest(g, low, high):
    """Deviance on the floor at g, w within its bounds."""
    best = min(max(-np.log1p(g), low), high)
    near = (max(low, best - 1e-3), min(high, best + 1e-3))
    return minimize_scalar(
        lambda w: float(np.sum(Valley().residual((g, w)) ** 2)),
        bounds=near,
        method="bounded",
        options={"xatol": 1e-12},
    ).fun


@pytest.mark.parametrize("g", [-0.7, -0.3, -0.1, 0.05, 0.15, 0.3, 0.8, 3.0, 20.0])
def test_what_is_said_of_a_place_is_its_floor(g):
    """Near the optimum the floor is found; where derivatives from there lead astray, nothing is said."""
    within = np.array([-0.95, -5.0]), np.array([30.0, 5.0])
    found = _on_the_floor(Valley(), np.array([g, -g]), J, 0, within, LITTLE)
    if abs(g) <= 0.3:
        assert found is not None
    assert found is None or found == pytest.approx(lowest(g, -5.0, 5.0), abs=LITTLE)


def test_at_a_bound_of_another_the_deviance_is_what_it_can_be_within_it():
    """The other factor may not follow all the way: the rise is that of the product, which it cannot mend."""
    within = np.array([-0.95, -0.1]), np.array([30.0, 5.0])
    found = _on_the_floor(Valley(), np.array([0.11, -0.1]), J, 0, within, LITTLE)
    assert found == pytest.approx(lowest(0.11, -0.1, 5.0), rel=1e-3)
    assert found > 20.0


def test_an_end_that_could_only_be_looked_for_near_by_is_as_far_as_the_rise_there_says():
    """A quarter of the way out the root of a parabola is a quarter: not flat, and no reason to give the bound."""
    wanted = float(np.sqrt(RISE))
    for share in (0.2, 0.25, 0.3):
        assert _end([0.0, share * 2.0], [0.0, share * wanted], 2.0, np.inf) == pytest.approx(2.0)
    assert _end([0.0, 2.0], [0.0, 0.1 * wanted], 2.0, np.inf) == np.inf
    # farther off on the way out, where the floor is met more exactly: the end lies beyond, not at the value itself
    for side in (-1.0, 1.0):
        places, roots = [0.0, side * 1.0, side * 1.5], [0.0, 0.33 * wanted, 0.25 * wanted]
        assert _end(places, roots, side * 4.0, side * np.inf) == pytest.approx(side * 1.5 / 0.33)
    # of two places beyond it the nearer one, wherever it was looked at first
    assert _end([0.0, 4.0, 2.0], [0.0, 3.0 * wanted, 1.5 * wanted], 2.0, np.inf) == pytest.approx(2.0 / 1.5)


def test_of_a_strength_that_came_to_nothing_is_known_what_would_have_shown():
    """At the end of its logarithm nothing shows; a value that is one, and one of which something is known, stay."""
    torque = Interval(3e-16, 3e-16, 3e-6, "N m", (True, True))
    assert told(idle_below(torque, 3.0)) == "at most 3 N m"
    assert idle_below(torque, 3.0).low == 0.0
    assert idle_below(torque, np.inf) == torque
    for other in (Interval(1.0, 0.1, 10.0, "1", (True, True)), Interval(3e-16, 1e-16, 1e-15, "N m")):
        assert idle_below(other, 3.0) == other
