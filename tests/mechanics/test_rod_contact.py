"""Contact between rods: derivatives, collisions, friction, knots; nothing ever passes through anything."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import rodnet as rn
from rodnet.solve.evaluation import Evaluation
from rodnet.solve.model import Model
from rodnet.testing import check_term

G, R = 9.81, 2e-3
HARD = rn.Material(E=1e9, rho=1000.0)
SOFT = rn.Material(E=1e6, rho=1000.0)
STEPPERS = ("euler", "sdirk2")


def elastic():
    return [rn.Stretching(), rn.Bending(), rn.Twisting()]


def cross(height, *terms, tilt=0.3, edges=7):
    """Two crossed rods, one above the other by ``height`` between their surfaces."""
    figure = rn.StickFigure()
    z, c, s = 2 * R + height, np.cos(tilt), np.sin(tilt)
    figure.rod("low", [(-0.05, 0.003, 0), (0.05, 0.003, 0)], edges=edges, material=SOFT, radius=R)
    figure.rod(
        "high", [(-0.04 * s, -0.04 * c, z), (0.05 * s, 0.05 * c, z)], edges=edges, material=SOFT, radius=R
    )
    return rn.Robot(figure.build(), [*elastic(), *terms])


def throw(robot, velocity, rods="high"):
    v = np.zeros((robot.graph.node_count, 3))
    v[robot.graph.nodes(rods)] = velocity
    return v


def axis_distances(x, edges, pairs, samples=33):
    """Distance of the axes of pairs of edges by brute force, shape (n,) [m]."""
    s = np.linspace(0.0, 1.0, samples)[:, None]
    a = x[edges[pairs[:, 0], 0]][:, None] * (1 - s) + x[edges[pairs[:, 0], 1]][:, None] * s
    # exact point-segment distances from the samples of one edge to the other
    y0, e = x[edges[pairs[:, 1], 0]][:, None], (x[edges[pairs[:, 1], 1]] - x[edges[pairs[:, 1], 0]])[:, None]
    t = np.clip(np.sum((a - y0) * e, axis=2) / np.sum(e * e, axis=2), 0, 1)[..., None]
    return np.linalg.norm(a - y0 - t * e, axis=2).min(axis=1)


def nearest(traj, apart=3):
    """Least distance of the axes of edges that are not neighbours, over all states, over their diameter."""
    edges, least = traj.edges, np.inf
    first, second = np.triu_indices(len(edges), 1)
    rod = np.empty(len(edges), dtype=int)
    for k, r in enumerate(traj.rods.values()):
        rod[r.edges] = k
    chosen = (rod[first] != rod[second]) | (second - first > apart)
    pairs = np.stack([first[chosen], second[chosen]], axis=1)
    for x in traj.x:
        least = min(least, axis_distances(x, edges, pairs).min())
    return least / (2.0 * traj.robot.graph.radius[0])


def test_contract():
    check_term(rn.RodContact, states=4)


@pytest.mark.parametrize("tilt", [0.0, 0.7, 0.5 * np.pi - 1e-2, 0.5 * np.pi])
def test_derivatives_of_rods_within_reach(tilt):
    """Crossing, nearly parallel and parallel edges, that slide and stick, differenced over a nanometre."""
    robot = cross(2e-3, tilt=tilt)
    robot = rn.Robot(
        robot.graph, [rn.RodContact(reach=3e-3, stiffness=1e3, friction=0.4, slip=0.1, damping=0.5)]
    )
    rng = np.random.default_rng(1)
    model, n = Model(robot), robot.graph.x0.size
    ev, cv = Evaluation(model), 30.0
    q = np.concatenate(
        [robot.graph.x0.ravel() + 2e-5 * rng.normal(size=n), rng.normal(size=model.edge_count)]
    )
    v = 0.1 * rng.normal(size=len(q))
    assert len(model.bound[0].gaps(np.ascontiguousarray(q[:n].reshape(-1, 3)))[0]) >= 1

    def force(q, v, jac=False):
        assert ev.update(q, v, 0.0, 1e-3, cv, jac)
        return ev.F.copy()

    force(q, v, True)
    J = model.jacobian().toarray()
    for _ in range(5):
        d = 1e-9 * rng.normal(size=len(q))
        d[n:] *= 1e3
        difference = 0.5 * (force(q - d, v - cv * d) - force(q + d, v + cv * d))
        assert np.abs(J @ d - difference).max() < 2e-5 * np.abs(difference).max()


@pytest.mark.parametrize("stepper", STEPPERS)
@pytest.mark.parametrize("speed", [0.0, 1.0, 10.0])
def test_crossed_rods_never_penetrate(speed, stepper):
    """Dropped, and thrown at 10 m/s, 0.1 m in one step of 0.01 s, which is 25 diameters."""
    robot = cross(5e-3, rn.Gravity(), rn.Hinge(at=["low.start", "low.end"]), rn.RodContact(friction=0.3))
    traj = rn.Simulation(robot, 1e-2, stepper=stepper, velocity=throw(robot, (0, 0, -speed))).run(0.15)
    assert nearest(traj) > 1.0
    # what was above is still above where they cross, or has slipped off
    assert np.abs(traj.v[-1]).max() < max(5.0, speed)


def momenta(robot, traj):
    m = robot.graph.node_mass[:, None]
    return (m * traj.v).sum(axis=1), np.cross(traj.x, m * traj.v).sum(axis=1)


def test_free_collision_keeps_momentum():
    """Two free rods exchange momentum and angular momentum, friction included, and lose energy."""
    robot = cross(1e-3, rn.RodContact(friction=0.3))
    velocity = throw(robot, (0.3, 0.2, -1.0)) + throw(robot, (0, 0, 0.5), "low")
    traj = rn.Simulation(robot, 2e-4, velocity=velocity).run(0.02)
    linear, angular = momenta(robot, traj)
    scale = robot.graph.node_mass @ np.linalg.norm(velocity, axis=1)
    assert np.abs(linear - linear[0]).max() < 1e-7 * scale
    assert np.abs(traj.v[-1] - velocity).max() > 0.5
    stored = sum(traj.energies[k] for k in traj.energies)
    assert stored[-1] < 0.95 * stored[0]
    # angular momentum is kept to the first order of implicit Euler's own error
    assert np.abs(angular - angular[0]).max() < 2e-2 * scale * 0.05


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_free_collision_keeps_angular_momentum(friction):
    """Spin about the axes counted; what remains is the time stepper's own error, of second order."""
    robot = cross(1e-3, rn.RodContact(friction=friction))
    velocity = throw(robot, (0.3, 0.2, -1.0)) + throw(robot, (0, 0, 0.5), "low")
    errors = []
    for dt in (4e-4, 1e-4):
        traj = rn.Simulation(robot, dt, stepper="sdirk2", velocity=velocity).run(0.004)
        tangent = traj.x[:, traj.edges[:, 1]] - traj.x[:, traj.edges[:, 0]]
        tangent /= np.linalg.norm(tangent, axis=2, keepdims=True)
        spin = np.einsum("e,te,tek->tk", robot.graph.edge_inertia, traj.w, tangent)
        angular = momenta(robot, traj)[1] + spin
        errors.append(np.abs(angular - angular[0]).max() / np.abs(angular[0]).max())
    assert errors[0] < 2e-3 and errors[1] < 0.5 * errors[0]


def rails(slope, friction, **options):
    """A rod along a slope on two level rails, clamped: held by their positions alone they would be rollers."""
    figure = rn.StickFigure()
    c, s = np.cos(slope), np.sin(slope)
    down, across, normal = np.array([c, 0, -s]), np.array([0, 0.02, 0]), np.array([s, 0, c])
    for k, at in enumerate((0.03, 0.08)):
        middle = at * down - (2.0 * R + 3.99e-4) * normal
        figure.rod(f"rail{k}", [middle - across, middle + across], edges=3, material=HARD, radius=R)
    figure.rod("rod", [(0, 0, 0), 0.11 * down], edges=16, material=HARD, radius=R)
    held = rn.Clamp(at=[f"rail{k}.{end}" for k in (0, 1) for end in ("start", "end")])
    contact = rn.RodContact(friction=friction, **options)
    return rn.Robot(figure.build(), [*elastic(), rn.Gravity(), held, contact]), down


@pytest.mark.parametrize("slope", [20.0, 30.0])
def test_rod_on_rails_slides_by_coulombs_law(slope):
    """It sticks below the angle of friction, 25 degrees, and accelerates by g (sin a - mu cos a) above."""
    angle, friction = np.radians(slope), np.tan(np.radians(25.0))
    robot, down = rails(angle, friction, damping=2.0)
    nodes = robot.graph.nodes("rod")
    mass = robot.graph.node_mass[nodes]
    traj = rn.Simulation(robot, 2e-3).run(0.2)
    speed = (traj.v[:, nodes] @ down) @ mass / mass.sum()
    if slope < 25.0:
        assert np.abs(speed[len(traj) // 2 :]).max() < 1e-3
    else:
        half = len(traj) // 2
        found = (speed[-1] - speed[half]) / (traj.t[-1] - traj.t[half])
        assert found == pytest.approx(9.81 * (np.sin(angle) - friction * np.cos(angle)), rel=0.01)


def test_rod_lies_in_a_groove():
    """Two parallel rods carry a third one between them, each with half its weight at 45 degrees."""
    figure = rn.StickFigure()
    apart = np.sqrt(2.0) * (R + 1.9e-4)
    for name, y, z in (("left", -apart, 0.0), ("right", apart, 0.0), ("rod", 0.0, apart)):
        figure.rod(name, [(-0.03, y, z), (0.03, y, z)], edges=5, material=SOFT, radius=R)
    held = rn.Hinge(at=["left", "right"])
    robot = rn.Robot(figure.build(), [*elastic(), rn.Gravity(), held, rn.RodContact()])
    traj = rn.equilibrium(robot)
    nodes = robot.graph.nodes("rod")
    force = traj.term_forces("contact")[-1]
    weight = G * robot.graph.node_mass[nodes].sum()
    assert force[nodes].sum(axis=0) == pytest.approx([0, 0, weight], rel=1e-6, abs=1e-7 * weight)
    assert force[robot.graph.nodes("left")].sum(axis=0)[1:] == pytest.approx([-0.5 * weight] * 2, rel=0.02)
    assert nearest(traj) > 1.0


def knot(edges=64, size=0.01):
    """An open trefoil, (t^3 - 3t, t^4 - 4t^2, (t^5 - 10t)/5) (Shastri 1992), in edges of equal length."""
    t = np.linspace(-2.1, 2.1, 2001)
    x = size * np.stack([t**3 - 3.0 * t, t**4 - 4.0 * t**2, 0.2 * (t**5 - 10.0 * t)], axis=1)
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(x, axis=0), axis=1))])
    at = np.linspace(0.0, s[-1], edges + 1)
    return np.stack([np.interp(at, s, x[:, k]) for k in range(3)], axis=1)


def pulled_knot(friction, pull=0.08):
    points = knot()
    figure = rn.StickFigure()
    figure.rod("rod", points, material=rn.Material(E=2e6, rho=1000.0), radius=1.2e-3)
    way = pull * np.array([0.6, 0.0, 0.8])
    grips = [
        rn.PrescribedMotion(at=f"rod.{end}", position=lambda t, s=sign: s * t * way, name=end)
        for end, sign in (("start", -1.0), ("end", 1.0))
    ]
    medium = rn.ResistiveForce(eta_t=0.2, eta_n=0.2)
    robot = rn.Robot(figure.build(), [*elastic(), medium, rn.RodContact(friction=friction), *grips])
    return rn.Simulation(robot, 1e-2).run(0.75)


def test_knot_pulled_tight():
    """It jams instead of passing through itself, and friction holds it the more."""
    pull = []
    for friction in (0.0, 0.2):
        traj = pulled_knot(friction)
        assert nearest(traj, apart=4) > 1.0
        tension = traj.internal.tension[:, 0]
        assert tension[-1] > 5.0 * tension[len(traj) // 4] > 0.0
        pull.append(tension[-1])
    assert pull[1] > 1.3 * pull[0]


def test_damping_takes_the_bounce():
    """Without damping a stiff rod bounces with nearly its speed; with it, with less."""
    left = []
    for damping in (0.0, 1.0):
        robot = cross(1e-3, rn.RodContact(damping=damping), tilt=0.0, edges=2)
        stiff = rn.Robot(
            robot.graph.figure.with_material("low", E=1e10).with_material("high", E=1e10).build(), robot.terms
        )
        v = throw(stiff, (0, 0, -0.5)) + throw(stiff, (0, 0, 0.5), "low")
        traj = rn.Simulation(stiff, 2e-5, stepper="sdirk2", velocity=v).run(0.003)
        energy = sum(traj.energies.values())
        left.append(energy[-1] / energy[0])
    assert left[0] > 0.9 and left[1] < 0.7


def test_restart_and_step_control(tmp_path):
    """A run continued from a file equals the uninterrupted one bit for bit; step control works with contact."""
    robot = cross(1e-3, rn.Gravity(), rn.Hinge(at=["low.start", "low.end"]), rn.RodContact(friction=0.3))
    options = {"stepper": "sdirk2", "velocity": throw(robot, (0, 0, -1.0)), "adaptive": 0.05}
    sim = rn.Simulation(robot, 1e-3, **options)
    sim.run(0.01, out=tmp_path / "half.nc")
    whole = sim.run(0.01)
    other = rn.Simulation(robot, 1e-3, **options)
    other.restore(rn.Trajectory.load(tmp_path / "half.nc", robot).state(-1))
    again = other.run(0.01)
    assert np.array_equal(again.x[-1], whole.x[-1]) and np.array_equal(again.t, whole.t)
    assert np.ptp(np.diff(whole.t)) > 0.0
    assert nearest(whole) > 1.0


def test_contact_in_files_and_processes(tmp_path):
    """A robot with contact is the same from a text file and in another process."""
    walls = (
        rn.PlaneContact((0, 0, -0.01), (0, 0.1, 1), friction=0.2),
        rn.TubeContact(((0, 0, -0.1), (1, 0, -0.1)), 0.05, inside=False),
        rn.TubeContact(((0, 0, 0), (1, 0, 0)), 0.3),
    )
    robot = cross(2e-3, rn.RodContact(friction=0.3), *walls)
    ends = []
    for made in (
        robot,
        rn.Robot.load(robot.save(tmp_path / "robot.toml")),
        pickle.loads(pickle.dumps(robot)),
    ):
        ends.append(rn.Simulation(made, 5e-3, velocity=throw(made, (0, 0, -1.0))).run(0.03).x[-1])
    assert np.array_equal(ends[0], ends[1]) and np.array_equal(ends[0], ends[2])


def test_overlapping_drawings():
    """Rods drawn through each other are refused by name; those of an acute joint are one part."""
    figure = rn.StickFigure()
    figure.rod("a", [(-0.05, 0, 0), (0.05, 0, 0)], edges=5, material=SOFT, radius=R)
    figure.rod("b", [(0, -0.05, 1e-3), (0, 0.05, 1e-3)], edges=5, material=SOFT, radius=R)
    with pytest.raises(rn.TermError, match=r"'a:2-3' and 'b:2-3' overlap in the initial shape, by 0.00302 m"):
        rn.Robot(figure.build(), [*elastic(), rn.RodContact()])
    figure = rn.StickFigure()
    figure.rod("a", [(0, 0, 0), (0.05, 0, 0)], edges=12, material=SOFT, radius=R)
    figure.rod("b", ["a.start", (0.05, 0.02, 0)], edges=12, material=SOFT, radius=R)
    robot = rn.Robot(figure.build(), [*elastic(), rn.RodContact()])
    assert np.abs(rn.Simulation(robot).step().state.x - robot.graph.x0).max() < 1e-12
