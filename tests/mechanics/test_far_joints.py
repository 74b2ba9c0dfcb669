"""Elastic joints far from rest, about axes that are no principal ones: energy and moment in closed form."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rodnet.testing.states import random_rotation
from tests.mechanics.beams import EI, L
from tests.mechanics.linkages import beams, turned

K = 1e-5 * np.array([1.0, 2.0, 3.5]) * EI / L


def left_jacobian(phi):
    """Rate of rotation in space over the rate of the rotation vector: w = J phi'."""
    angle = np.linalg.norm(phi)
    X = np.array([[0, -phi[2], phi[1]], [phi[2], 0, -phi[0]], [-phi[1], phi[0], 0]])
    return np.eye(3) + (1 - np.cos(angle)) / angle**2 * X + (angle - np.sin(angle)) / angle**3 * X @ X


@pytest.mark.parametrize("angle", [150.0, 175.0, -150.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_an_elastic_joint_turned_far_about_a_skew_axis(angle, seed):
    """E = phi.K phi / 2 of the rotation vector phi, and by virtual work the moment J(phi)^-T K phi."""
    rng = np.random.default_rng(seed)
    axes = random_rotation(rng)
    skew = rng.normal(size=3)
    skew /= np.linalg.norm(skew)
    stiffness = axes.T @ np.diag(K) @ axes  # rows are the joint's axes
    phi = np.radians(angle) * skew
    wanted = np.linalg.solve(left_jacobian(phi).T, stiffness @ phi)
    # along a principal axis the moment is K phi; here it is far from that
    assert np.linalg.norm(wanted - stiffness @ phi) > 0.1 * np.linalg.norm(wanted)
    traj = turned(beams(4, "elastic", [], axes=axes, stiffness=K), skew, np.radians(angle))[-1]
    assert traj.energies["joints"][-1] == pytest.approx(0.5 * phi @ stiffness @ phi, rel=1e-4)
    moment = traj.reactions["motion"].moment[-1]
    assert moment == pytest.approx(wanted, abs=1e-4 * np.linalg.norm(wanted))


def test_the_moment_is_the_slope_of_the_energy():
    """A further small turn about any axis in space costs the moment times its angle."""
    axes, skew = random_rotation(np.random.default_rng(5)), np.array([0.6, 0.0, 0.8])
    stiffness, phi, h = axes.T @ np.diag(K) @ axes, np.radians(150.0) * np.array([0.6, 0.0, 0.8]), 1e-5

    def energy(vector):
        return 0.5 * vector @ stiffness @ vector

    slope = [
        (
            energy((Rotation.from_rotvec(h * e) * Rotation.from_rotvec(phi)).as_rotvec())
            - energy((Rotation.from_rotvec(-h * e) * Rotation.from_rotvec(phi)).as_rotvec())
        )
        / (2 * h)
        for e in np.eye(3)
    ]
    traj = turned(beams(4, "elastic", [], axes=axes, stiffness=K), skew, np.radians(150.0))[-1]
    assert traj.reactions["motion"].moment[-1] == pytest.approx(slope, abs=1e-4 * np.linalg.norm(slope))
