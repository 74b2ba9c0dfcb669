"""What the viewer shows of forces, memories and several robots, read back from the file, is the physics."""

from __future__ import annotations

import numpy as np
import pytest

import rodnet as rn
from rodnet.viz.colours import COLD, HOT
from rodnet.viz.forces import arrow_scale, forces_of
from tests.test_viz import chunks, column, strips, text, verified


@pytest.fixture(scope="module")
def traj() -> rn.Trajectory:
    return rn.Simulation(rn.robots.flagellated(2, 100.0, edges=8), dt=1e-2).run(0.2, save_every=4)


def vectors(found: dict, entity: str, row: int = -1) -> np.ndarray:
    return column(found[entity], "Arrows3D:vectors")[row].reshape(-1, 3)


def colors(found: dict, entity: str, row: int) -> np.ndarray:
    """Colours (n, 3) of a frame, from 32-bit RGBA."""
    rgba = column(found[entity], "Points3D:colors")[row].astype(np.uint32)
    return np.stack([rgba >> shift & 255 for shift in (24, 16, 8)], axis=1).astype(int)


# -- forces ---------------------------------------------------------------------------------
def test_arrows_are_the_forces_of_each_term_and_share_a_scale(traj, tmp_path):
    found = chunks(rn.viz.log_rerun(traj, tmp_path / "run.rrd"))
    ratios = []
    for name in ("drag", "head"):
        arrows, force = vectors(found, f"/robot/forces/{name}"), traj.term_forces(name)[-1]
        longest = np.linalg.norm(traj.term_forces(name), axis=2).max()
        force = force[np.linalg.norm(force, axis=1) > 1e-3 * longest]
        ratios.append(np.linalg.norm(arrows) / np.linalg.norm(force))
        assert np.allclose(arrows, ratios[-1] * force, rtol=1e-5, atol=1e-6 * np.abs(arrows).max())
    assert ratios[0] == pytest.approx(ratios[1], rel=1e-5)
    size = np.linalg.norm(np.ptp(traj.x[0], axis=0))
    assert np.linalg.norm(arrows, axis=1).max() < 0.5 * size


@pytest.fixture(scope="module")
def resting() -> rn.Trajectory:
    """A bar that lies on a plane."""
    fig = rn.StickFigure()
    fig.rigid("bar", [(-0.03, 0, 0.0043), (0, 0, 0.0043), (0.03, 0, 0.0043)], radius=4e-3)
    fig.body("bar", name="toy", mass=0.02)
    terms = [rn.Gravity(), rn.PlaneContact((0, 0, 0), stiffness=1e4, friction=0.3, damping=20.0)]
    return rn.Simulation(rn.Robot(fig.build(), terms), dt=2e-3).run(0.6, save_every=20)


def test_contact_arrows_carry_the_weight_and_begin_on_the_surface(resting, tmp_path):
    found = chunks(rn.viz.log_rerun(resting, tmp_path / "rest.rrd"))
    size = np.linalg.norm(np.ptp(resting.x[0], axis=0))
    scale = arrow_scale(forces_of(resting, np.arange(len(resting))), size)
    weight = np.array([0.0, 0.0, -0.02 * 9.81]) * scale
    carried = vectors(found, "/robot/forces/plane").sum(axis=0)
    assert np.allclose(carried, -weight, rtol=0.0, atol=2e-3 * abs(weight[2]))
    points = column(found["/robot/forces/plane"], "Arrows3D:origins")[-1].reshape(-1, 3)
    assert len(points) >= 3 and np.all(np.abs(points[:, 2]) < 0.1 * 4e-3)


def test_contacts_between_rods_are_shown_where_they_touch(tmp_path):
    from rodnet.terms.contact.points import contact_points

    fig, r = rn.StickFigure(), 0.01
    rubber = rn.Material(E=1e6)
    fig.rod("low", [(-0.2, 0, 0), (0.2, 0, 0)], edges=5, material=rubber, radius=r)
    fig.rod("high", [(0, -0.2, 2.02 * r), (0, 0.2, 2.02 * r)], edges=5, material=rubber, radius=r)
    robot = rn.Robot(fig.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.RodContact(friction=0.0)])
    traj = rn.Simulation(robot, dt=1e-4).run(2e-4)
    replay = traj._replay
    bound = next(b for b in replay.model.bound if b.term.kind == "contact")
    for _, _, ev in replay.states([0]):
        points, forces = contact_points(bound, ev)
        nodal = bound.forces(ev)[: ev.model.twist0].reshape(-1, 3)
    # the gap is from z = r to 1.02 r, and the second edge's surface is on either side of it
    assert points.shape == (1, 3) and np.allclose(points[0, :2], 0.0, atol=1e-9)
    assert 0.999 * r < points[0, 2] < 1.021 * r
    high = nodal[robot.graph.rods["high"].nodes].sum(axis=0)
    assert high[2] > 0.0 and np.allclose(np.abs(forces[0]), np.abs(high), rtol=1e-9, atol=1e-9 * high[2])
    found = chunks(rn.viz.log_rerun(traj, tmp_path / "touch.rrd"))
    assert len(vectors(found, "/robot/forces/contact", 0)) == 1


# -- colours --------------------------------------------------------------------------------
class Worn(rn.DragModel):
    """Remembers the way that it has gone."""

    memory_size = 1
    memory_names = ("way",)
    eta = rn.Parameter(1.0, unit="Pa s", bounds=(0, None))

    def update(self, site, p, m_old):
        return -p.eta * site.v, m_old + rn.norm(site.v) * site.dt


class Wake(Worn):
    """The same, left behind in the medium."""

    memory_frame = "medium"


@pytest.mark.parametrize("law", [Worn(), Wake(cell=0.05)], ids=["body", "medium"])
def test_colours_follow_the_memory(law, tmp_path):
    fig = rn.StickFigure()
    fig.rod("arm", [(0, 0, 0), (1, 0, 0)], edges=8, material=rn.Material(E=1e6), radius=0.01)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Clamp(at="arm.start"), rn.Gravity(), law]
    traj = rn.Simulation(rn.Robot(fig.build(), terms), dt=1e-2).run(0.3, save_every=3)
    path = rn.viz.log_rerun(traj, tmp_path / "worn.rrd")
    found = chunks(path)
    entity = f"/robot/memory/{law.name}/way"
    assert np.all(colors(found, entity, 0) == COLD)  # nothing is remembered at the start
    last = colors(found, entity, -1)
    assert (
        np.allclose(last[0], COLD, rtol=0.0, atol=5) and last[1:, 0].min() > last[0, 0]
    )  # all but the clamp has moved
    if law.memory_frame == "body":
        i = [t.name for t in traj.robot.terms].index(law.name)
        memory, sites = traj._memory(i, -1)[:, 0], traj._replay.model.bound[i].sites.node
        way = np.array([memory[sites == n].mean() for n in range(9)])
        assert np.all(np.diff(last[np.argsort(way), 0]) >= 0) and np.argmax(way) == np.argmax(last[:, 0])
        assert np.all(last[np.argmax(way)] == HOT)  # a way only grows: the largest is at the end
        assert f"blue 0, red {way.max():.3g}" in text(path)
    else:
        x, memory = traj.medium(law.name)
        shown = column(found[f"/robot/medium/{law.name}/way"], "Points3D:positions")[-1].reshape(-1, 3)
        hottest = shown[np.argmax(colors(found, f"/robot/medium/{law.name}/way", -1)[:, 0])]
        strong = memory[:, 0] > 0.9 * memory[:, 0].max()
        assert np.linalg.norm(x[strong] - hottest, axis=1).min() < 1e-6
        assert 0 < len(shown) <= len(x)
    assert verified(path)


def test_internal_forces_are_coloured_and_plotted(tmp_path):
    fig = rn.StickFigure()
    fig.rod("arm", [(0, 0, 0), (0, 0, -1)], edges=8, material=rn.Material(E=1e6), radius=0.01)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Clamp(at="arm.start"), rn.Gravity()]
    traj = rn.Simulation(rn.Robot(fig.build(), terms), dt=1e-2).run(2.0, save_every=20)
    path = rn.viz.log_rerun(traj, tmp_path / "hung.rrd")
    found = chunks(path)
    plotted = np.concatenate(column(found["/internal_forces/tension"], "Scalars:scalars"))
    # the first of 8 edges carries what hangs below its middle: 15/16 of the weight
    weight = 1000.0 * np.pi * 0.01**2 * 9.81
    assert plotted[-1] == pytest.approx(15 / 16 * weight, rel=1e-2)
    rgba = column(found["/robot/internal/tension"], "LineStrips3D:colors")[-1]
    red = np.asarray(rgba).astype(np.uint32) >> 24
    assert len(red) == 8 and np.all(np.diff(red.astype(int)) <= 0) and red[0] > red[-1]


# -- several robots -------------------------------------------------------------------------
def test_several_robots_share_a_recording(traj, resting, tmp_path):
    path = rn.viz.log_rerun({"swimmer": traj, "bar": resting}, tmp_path / "two.rrd")
    assert verified(path)
    found = chunks(path)
    for name, run, rod in (("swimmer", traj, "rods/tail0"), ("bar", resting, "rigid/bar")):
        nodes = run.rods[rod.split("/")[1]].nodes
        shown = strips(found[f"/robot/{name}/{rod}"], len(nodes))
        assert np.array_equal(shown, run.x[:, nodes].astype(np.float32))
    assert "/robot/bar/bodies/toy" in found and "/energies/bar/kinetic" in found
    # one scale for all: arrows compare as forces do
    drag, contact = (
        np.linalg.norm(vectors(found, e), axis=1).max()
        for e in ("/robot/swimmer/forces/head", "/robot/bar/forces/plane")
    )
    forces = [run.term_forces(n)[-1] for run, n in ((traj, "head"), (resting, "plane"))]
    true = [np.linalg.norm(f, axis=1).max() for f in forces]
    assert drag / contact == pytest.approx(true[0] / true[1], rel=1e-4)
    found = chunks(rn.viz.log_rerun([resting, resting], tmp_path / "twins.rrd"))
    assert "/robot/0/rigid/bar" in found and "/robot/1/rigid/bar" in found


def test_names_and_meshes_that_fit_no_robot_are_refused(resting, tmp_path):
    with pytest.raises(rn.ParameterError, match="a/b"):
        rn.viz.log_rerun({"a/b": resting, "c": resting}, tmp_path / "no.rrd")
    with pytest.raises(rn.ParameterError, match="no trajectory"):
        rn.viz.log_rerun([], tmp_path / "no.rrd")
    with pytest.raises(rn.ParameterError, match="no rigid body 'hub'; there are toy"):
        rn.viz.log_rerun([resting], tmp_path / "no.rrd", meshes={"hub": (np.eye(3), [[0, 1, 2]])})


def test_a_picture_of_nothing_is_refused(tmp_path):
    with pytest.raises(rn.OutputError, match=r"no recording '.*none\.rrd'"):
        rn.viz.snapshot(tmp_path / "none.rrd", tmp_path / "none.png")
