"""What is promised of every term that is installed, plug-ins' included."""

from __future__ import annotations

import pytest

import rodnet as rn
from rodnet import registry

TERMS = registry.terms()
# where the example of the class, made for strong contact, costs hundreds of iterations
GENTLE = {"rod-contact": rn.RodContact(reach=0.03, stiffness=1.0, rod_radius=1e-3, friction=0.4, slip=0.05)}


@pytest.mark.parametrize("name", sorted(TERMS))
def test_it_works_in_a_robot_with_joints(name):
    """With second-order steppers, in a sweep, and through save and restart."""
    report = rn.testing.check_in_robot(GENTLE.get(name, TERMS[name].object))
    assert {"sdirk2: Jacobian by position", "alpha: continued from a file", "sweep: as it was"} <= set(
        report.errors
    )
