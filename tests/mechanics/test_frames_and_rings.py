"""Corners, joints and loops against beam theory; natural shapes."""

import numpy as np
import pytest

import rodnet as rn
from tests.mechanics.beams import EA, EI, GJ, MATERIAL, L, R, elastic, end, order, rest

ROD = {"material": MATERIAL, "radius": R}
P = 1e-4 * EI / L**2  # deflections of some 1e-5 L: geometry stays linear to 1e-9
SIZES = (4, 8, 16, 32)


def solve(figure, *terms):
    return rest(rn.Robot(figure.build(), [*elastic(), *terms]))


# -- a right angle: a corner must neither be too stiff nor lose the coupling of bending and torsion --
A, B = 0.12, 0.1
ANGLE = {
    "across the leg": ((P, 0, 0), P * B**3 / (3 * EI) + P * A * B**2 / EI + P * A / EA),
    "along the leg": ((0, -P, 0), P * A**3 / (3 * EI) + P * B / EA),
    "out of plane": ((0, 0, P), P * (A**3 + B**3) / (3 * EI) + P * A * B**2 / GJ),
}


@pytest.mark.parametrize("case", ANGLE)
def test_right_angle(case):
    force, theory = ANGLE[case]
    errors = []
    for n in SIZES:
        figure = rn.StickFigure()
        figure.rod("arm", [(0, 0, 0), (A, 0, 0)], edges=n, **ROD)
        figure.rod("leg", ["arm.end", (A, B, 0)], edges=n, **ROD)
        tips = []
        for sign in (1.0, -1.0):  # the difference is linear in the load to second order
            load = rn.PointForce(at="leg.end", force=sign * np.array(force))
            tips.append(end(solve(figure, rn.Clamp(at="arm.start"), load), "leg.end"))
        errors.append(0.5 * (tips[0] - tips[1]) @ np.sign(force) / theory - 1.0)
    assert order(SIZES, errors) == pytest.approx(2.0, abs=0.02)
    assert abs(errors[-1]) < 7e-4


def test_right_angle_of_elliptic_rods():
    """Where one leg is soft the other is stiff: the corner turns their tensors into each other."""
    a, b = 3e-3, 1.5e-3
    section = rn.elliptic(a, b)
    stiff, soft = (MATERIAL.E * i for i in (section.I1, section.I2))
    torsion = MATERIAL.G * section.J
    length, load = 0.1, 1e-4 * EI / L**2
    # m1 of the arm is z (stiff out of plane); m1 of the leg is x (soft out of plane)
    theory = load * (length**3 / (3 * stiff) + length**3 / (3 * soft) + length**3 / torsion)
    errors = []
    for n in SIZES:
        figure = rn.StickFigure()
        figure.rod(
            "arm",
            [(0, 0, 0), (length, 0, 0)],
            edges=n,
            material=MATERIAL,
            section=section,
            director=(0, 0, 1.0),
        )
        figure.rod(
            "leg", ["arm.end", (length, length, 0)], edges=n, material=MATERIAL, section=section,
            director=(1.0, 0, 0),
        )  # fmt: skip
        traj = solve(figure, rn.Clamp(at="arm.start"), rn.PointForce(at="leg.end", force=(0, 0, load)))
        errors.append(end(traj, "leg.end")[2] / theory - 1.0)
    assert order(SIZES, errors) == pytest.approx(2.0, abs=0.02)
    assert abs(errors[-1]) < 7e-4


# -- joints of three rods ------------------------------------------------------------------------
def tee(n, force, hub):
    """A bar clamped at both ends with a stem from its middle; a stub may stand for the weld."""
    a, b = 0.08, 0.1
    figure = rn.StickFigure()
    figure.rod("left", [(0, 0, 0), (a, 0, 0)], edges=n, **ROD)
    figure.rod("right", ["left.end", (2 * a, 0, 0)], edges=n, **ROD)
    figure.rod("stem", ["left.end", (a, b, 0)], edges=n, **ROD)
    if hub:
        figure.rigid("stub", ["left.end", (a, -2e-3, 1e-3)], stiffening=(1e2, 1e6))
        figure.joint("left.end", hub="stub:0-1")
    walls = rn.Clamp(at="left.start"), rn.Clamp(at="right.end")
    traj = solve(figure, *walls, rn.PointForce(at="stem.end", force=force))
    return (end(traj, "stem.end") - (a, b, 0)) @ np.sign(force)


TEE = {
    "out of plane": ((0, 0, P), P * (0.1**3 / 3 + 0.16**3 / 192) / EI + P * 0.1**2 * 0.08 / (2 * GJ)),
    "in plane": ((P, 0, 0), P * (0.1**3 / 3 + 0.1**2 * 0.08 / 8) / EI + P * 0.08 / (2 * EA)),
}


@pytest.mark.parametrize("case", TEE)
def test_tee_with_a_weld_drawn_as_a_stub_is_second_order(case):
    force, theory = TEE[case]
    errors = [tee(n, force, hub=True) / theory - 1.0 for n in SIZES]
    assert order(SIZES, errors) == pytest.approx(2.0, abs=0.02)
    assert abs(errors[-1]) < 1e-3


def test_tee_without_hub():
    """All pairs: exact where the half edges are equally stiff about the axis, else first order."""
    force, theory = TEE["in plane"]
    errors = [tee(n, force, hub=False) / theory - 1.0 for n in SIZES]
    assert order(SIZES, errors) == pytest.approx(2.0, abs=0.02)
    assert abs(errors[-1]) < 1e-3
    force, theory = TEE["out of plane"]
    errors = [tee(n, force, hub=False) / theory - 1.0 for n in SIZES]
    assert order(SIZES, errors) > 1.0
    assert abs(errors[-1]) < 3e-3


@pytest.mark.parametrize("arms", [3, 4, 6])
def test_star(arms):
    """Clamped at the tips, loaded at the weld: each arm is a beam guided at one end, 12 EI / L^3."""
    length, errors = 0.1, []
    for n in (8, 16, 32):
        figure = rn.StickFigure()
        for k in range(arms):
            angle = 2.0 * np.pi * k / arms
            tip = length * np.array([np.cos(angle), np.sin(angle), 0.0])
            figure.rod(f"arm{k}", ["arm0.start" if k else (0, 0, 0), tip], edges=n, **ROD)
        tips = [rn.Clamp(at=f"arm{k}.end") for k in range(arms)]
        traj = solve(figure, *tips, rn.PointForce(at="arm0.start", force=(0, 0, P)))
        sag = end(traj, "arm0.start")
        assert sag[:2] == pytest.approx((0, 0), abs=1e-9)
        errors.append(sag[2] / (P * length**3 / (12.0 * arms * EI)) - 1.0)
    assert order((8, 16, 32), errors) > 1.0
    assert abs(errors[-1]) < 1.2e-2


# -- loops ---------------------------------------------------------------------------------------
def test_square_frame():
    """Pulled apart at the middles of two sides: 5 P S^3 / (192 EI), corners welded."""
    side, errors = 0.1, []
    theory = 5 * P * side**3 / (192 * EI) + P * side / (2 * EA)
    for n in SIZES:
        figure = rn.StickFigure()
        corners = [(0, 0, 0), (side, 0, 0), (side, side, 0), (0, side, 0)]
        figure.rod("frame", corners, edges=4 * n, closed=True, **ROD)
        low, high = f"frame:{n // 2}", f"frame:{2 * n + n // 2}"
        traj = solve(figure, rn.PointForce(at=low, force=(0, -P, 0)), rn.PointForce(at=high, force=(0, P, 0)))
        errors.append(((end(traj, high) - end(traj, low))[1] - side) / theory - 1.0)
    assert order(SIZES, errors) == pytest.approx(2.0, abs=0.02)
    assert abs(errors[-1]) < 4e-3


def ring_figure(n, radius=0.05, **options):
    angles = 2.0 * np.pi * np.arange(n) / n
    points = radius * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    figure = rn.StickFigure()
    figure.rod("ring", list(points), closed=True, **ROD, **options)
    return figure


@pytest.mark.parametrize("natural", ["initial", "straight"])
def test_ring_under_diametral_load(natural):
    """(pi/4 - 2/pi) P R^3 / EI, and the axial part pi/4 P R / EA.

    The uniform moment in a ring made of a straight rod does no work in its plane: the same answer.
    """
    radius, load = 0.05, 30.0 * P
    sizes = (16, 32, 64)
    theory = (np.pi / 4 - 2 / np.pi) * load * radius**3 / EI + np.pi / 4 * load * radius / EA
    errors = []
    for n in sizes:
        figure = ring_figure(n, natural=natural)
        loads = {"ring:0": load, f"ring:{n // 2}": -load}
        traj = solve(figure, *(rn.PointForce(at=node, force=(f, 0, 0)) for node, f in loads.items()))
        errors.append(((end(traj, "ring:0") - end(traj, f"ring:{n // 2}"))[0] - 2 * radius) / theory - 1.0)
    assert order(sizes, errors) == pytest.approx(2.0, abs=0.02)
    assert abs(errors[-1]) < 7e-3


def test_ring_of_a_straight_rod_wants_to_open():
    """Moment EI/R everywhere, energy pi EI/R, and no force: a circle is in balance."""
    radius, sizes = 0.05, (32, 64, 128)
    moments, energies = [], []
    for n in sizes:
        traj = solve(ring_figure(n, natural="straight"))
        moment = np.linalg.norm(traj.internal.moment[-1], axis=1)
        assert np.ptp(moment) < 1e-6 * EI / radius
        assert np.abs(traj.internal.tension[-1]).max() < 1e-6 * EI / radius**2
        moments.append(moment[0] / (EI / radius) - 1.0)
        energies.append(traj.energies["bending"][-1] / (np.pi * EI / radius) - 1.0)
    for errors in (moments, energies):
        assert order(sizes, errors) == pytest.approx(2.0, abs=0.02)
        assert abs(errors[-1]) < 1e-3


def test_a_cut_ring_of_a_straight_rod_opens():
    """Held at one end, released at the other, it becomes straight."""
    n = 24
    angles = np.linspace(0.0, 1.9 * np.pi, n + 1)
    points = 0.05 * np.stack([np.sin(angles), 1.0 - np.cos(angles), 0 * angles], axis=1)
    figure = rn.StickFigure()
    figure.rod("strip", list(points), natural="straight", **ROD)
    traj = solve(figure, rn.Clamp(at="strip.start"))
    line = np.diff(traj.x[-1], axis=0)
    lengths = np.linalg.norm(line, axis=1)
    assert (line / lengths[:, None]) @ line[0] / lengths[0] == pytest.approx(1.0, abs=1e-12)
    assert lengths == pytest.approx(robot_lengths(figure), rel=1e-9)


def robot_lengths(figure):
    return figure.build().rest_length


def test_natural_curvature_and_twist_shape_a_straight_rod():
    """A rod drawn straight with curvature 1/R becomes an arc; with twist as well, a helix.

    The clamp holds the tangent of the end: half an edge of the arc lies between it and the first edge.
    """
    n, kappa, tau = 64, 20.0, 15.0
    # kappa1 > 0 bends toward m1
    tip = np.array([np.sin(kappa * L), 0.0, 1.0 - np.cos(kappa * L)]) / kappa
    for held, free, sign in (("start", "end", 1.0), ("end", "start", -1.0)):
        errors = []
        for size in (16, 32, 64):
            figure = rn.StickFigure()
            line = [(0, 0, 0), (sign * L, 0, 0)][:: int(sign)]
            curved = {"natural_curvature": (kappa, 0.0), "director": (0, 0, 1.0)}
            figure.rod("rod", line, edges=size, **curved, **ROD)
            traj = solve(figure, rn.Clamp(at=f"rod.{held}"))
            assert traj.energies["bending"][-1] < 1e-15
            errors.append(np.abs(end(traj, f"rod.{free}") - tip * (sign, 1.0, 1.0)).max() / L)
        assert order((16, 32, 64), errors) > 1.95 and errors[-1] < 1e-3
    figure = rn.StickFigure()
    figure.rod(
        "rod", [(0, 0, 0), (L, 0, 0)], edges=n, natural_curvature=(kappa, 0.0), natural_twist=tau, **ROD
    )
    traj = solve(figure, rn.Clamp(at="rod.start"))
    assert sum(v[-1] for v in traj.energies.values()) < 1e-15
    # curvature fixed in a frame that twists by tau: a helix of pitch 2 pi tau / (kappa^2 + tau^2)
    tangents = np.diff(traj.x[-1], axis=0) * n / L
    binormal = np.cross(tangents[:-1], tangents[1:])
    binormal /= np.linalg.norm(binormal, axis=1, keepdims=True)
    torsion = np.arccos(np.sum(binormal[:-1] * binormal[1:], axis=1)) * n / L
    assert torsion == pytest.approx(tau, rel=2e-3)
    axis = np.linalg.svd(np.diff(binormal, axis=0))[2][2]
    advance = abs((traj.x[-1, -1] - traj.x[-1, 0]) @ axis) / L
    assert advance == pytest.approx(tau / np.hypot(kappa, tau), rel=1e-2)


def test_a_curved_rod_stays_at_rest():
    """What is drawn is the natural shape: no force, no motion, to round-off, in any drawing."""
    rng = np.random.default_rng(3)
    points = np.cumsum(rng.normal(size=(12, 3)), axis=0) * 0.02
    figure = rn.StickFigure()
    figure.rod("curl", list(points), **ROD)
    figure.rod("twig", ["curl:5", points[5] + (0, 0, 0.05)], edges=3, **ROD)
    robot = rn.Robot(figure.build(), elastic())
    for stepper in ("euler", "sdirk2", "alpha"):
        traj = rn.Simulation(robot, 0.01, stepper=stepper).run(0.2)
        assert np.abs(traj.x - robot.graph.x0).max() < 1e-12
    assert rest(robot).x[-1] == pytest.approx(robot.graph.x0, abs=1e-12)
