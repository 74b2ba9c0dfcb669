"""Joints of random kinds at nodes of random degree: derivatives, balance, and files."""

import tomllib

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import rodnet as rn
from rodnet.files.robot_file import robot_of, tables_of
from rodnet.files.toml_text import toml_text
from rodnet.testing.states import Probe, random_rotation


@st.composite
def stars(draw, strongest=1.0, widest=3.0):
    """A random joint with arms of random sections, and a further joint along one.

    Stiffnesses [N m/rad] are up to ``strongest``, and rest angles [rad] up to ``widest``.
    """
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    figure, ends, start = rn.StickFigure(), [], (0.0, 0.0, 0.0)
    degree = draw(st.integers(2, 5))
    for k in range(degree):
        direction = rng.normal(size=3)
        line = [start, 0.1 * direction / np.linalg.norm(direction)]
        inward = k > 0 and draw(st.booleans())
        section = rn.elliptic(*rng.uniform(1e-3, 3e-3, 2))
        material = rn.Material(E=10 ** rng.uniform(5, 7), nu=0.3, rho=1000.0)
        figure.rod(f"arm{k}", line[::-1] if inward else line, edges=3, material=material, section=section)
        ends.append(f"arm{k}.{'end' if inward else 'start'}")
        start = ends[0]

    def add(at, around):
        kind = draw(st.sampled_from(["rigid", "hinge", "ball", "elastic"]))
        of = around[: draw(st.integers(1, len(around) - 1))] if kind != "rigid" else []
        options = {"of": of} if of else {}
        if kind == "hinge":
            options["axis"] = rng.normal(size=3)
            if draw(st.booleans()):
                options |= {"stiffness": strongest * 10 ** rng.uniform(-4, 0)}
                options["angle"] = rng.uniform(-widest, widest)
        if kind == "elastic":
            options |= {"stiffness": strongest * 10 ** rng.uniform(-4, 0, 3), "axes": random_rotation(rng)}
        figure.joint(at, kind=kind, **options)

    add(ends[0], [f"arm{k}" for k in range(degree)])
    if draw(st.booleans()):
        add("arm1:1", ["arm1:0-1", "arm1:1-2"])
    return rn.Robot(figure.build(), [rn.Stretching(), rn.Bending(), rn.Twisting()])


@settings(deadline=None, max_examples=25)
@given(stars(), st.integers(0, 2**32 - 1))
def test_any_joint(robot, seed):
    rng = np.random.default_rng(seed)
    probe = Probe(robot, rng, turn=1.5, source_turn=1.5)
    for error, where in probe.jacobian_errors().values():
        assert error < 1e-7, where
    F = probe.forces()
    force, moment = probe.resultant(F)
    assert np.abs(force).max() < 1e-9 * np.abs(F).max()
    assert np.abs(moment).max() < 1e-9 * np.abs(F * probe.units).max()
    again = robot_of(tomllib.loads(toml_text(tables_of(robot))))
    same = Probe(again, np.random.default_rng(seed), turn=1.5, source_turn=1.5)
    assert np.array_equal(same.q, probe.q) and np.array_equal(same.forces(), F)


@settings(deadline=None, max_examples=10)
@given(stars(strongest=1e-4, widest=1.0))
def test_any_joint_falls_and_keeps_its_momentum(robot):
    """Internal forces leave the motion of the centre of mass alone, and no step fails."""
    mass = robot.graph.node_mass
    fallen = rn.Robot(robot.graph, [*robot.terms, rn.Gravity()])
    rng = np.random.default_rng(0)
    velocity = 0.2 * rng.normal(size=(robot.graph.node_count, 3))
    traj = rn.Simulation(fallen, 1e-3, stepper="sdirk2", velocity=velocity).run(0.02)
    centre = np.einsum("n,tni->ti", mass, traj.x) / mass.sum()
    start = mass @ velocity / mass.sum()
    t = traj.t[:, None]
    wanted = centre[0] + start * t - 0.5 * 9.81 * t**2 * [0, 0, 1]
    assert np.abs(centre - wanted).max() < 1e-8
