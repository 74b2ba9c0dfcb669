"""What is promised of every term that is installed, plug-ins' included."""

from __future__ import annotations

import pytest

import rodnet as rn
from rodnet import registry

TERMS = registry.terms()


@pytest.mark.parametrize("name", sorted(TERMS))
def test_it_works_in_a_robot_with_joints(name):
    """With second-order steppers, in a sweep, and through save and restart."""
    report = rn.testing.check_in_robot(TERMS[name].object)
    assert {"sdirk2: Jacobian by position", "alpha: continued from a file", "sweep: as it was"} <= set(
        report.errors
    )
