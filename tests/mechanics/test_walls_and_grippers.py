"""Walls anywhere on a rod, grippers that lead it about, and what they feel."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rodnet as rn
from tests.mechanics.beams import EI, GJ, MATERIAL, WEIGHT, L, R, beam, elastic, end, order, rest

G = 9.81
TIGHT = rn.Tolerance(residual=1e-11, update=1e-14)


def cone(angle):
    """A gripper whose axis has gone round a 30 degree cone by ``angle``, without net spin over a turn."""
    axis = np.array([np.cos(np.radians(30.0)), 0.0, np.sin(np.radians(30.0))])
    return (Rotation.from_rotvec(angle * axis) * Rotation.from_rotvec([-angle, 0.0, 0.0])).as_matrix()


# -- walls ---------------------------------------------------------------------------------------
def test_a_wall_in_the_middle_of_a_rod_makes_two_cantilevers():
    robot = beam(20, rn.Gravity(g=G), rn.Clamp(at="beam:8"))
    traj = rest(robot)
    for length, tip, edges in ((0.4 * L, "beam.start", 8), (0.6 * L, "beam.end", 12)):
        alone = rest(
            beam(edges, rn.Gravity(g=G), rn.Clamp(at="beam.start"), points=[(0, 0, 0), (length, 0, 0)])
        )
        assert end(traj, tip)[2] == pytest.approx(alone.x[-1, -1, 2], rel=1e-8)
    assert traj.reactions["clamp"].force[-1, 2] == pytest.approx(WEIGHT * G * L, rel=1e-9)
    arms = traj.x[-1] - end(traj, "beam:8")
    weights = -G * robot.graph.node_mass[:, None] * np.array([0, 0, 1.0])
    moment = np.cross(arms, weights).sum(axis=0)
    assert traj.reactions["clamp"].moment[-1] == pytest.approx(-moment, abs=1e-8 * np.abs(moment).max())


def test_one_clamp_may_hold_edges_and_single_nodes():
    """Of an edge it holds the frame; a single node is a wall."""
    figure = rn.StickFigure()
    for k in range(2):
        figure.rod(f"rod{k}", [(0, k, 0), (L, k, 0)], edges=10, material=MATERIAL, radius=R)
    together = rn.Robot(
        figure.build(), [*elastic(), rn.Gravity(g=G), rn.Clamp(at=["rod0:0-1", "rod1.start"])]
    )
    traj = rest(together)
    alone = rest(beam(10, rn.Gravity(g=G), rn.Clamp(at="beam.start")))
    assert end(traj, "rod1.end") - (0, 1, 0) == pytest.approx(alone.x[-1, -1], abs=1e-9)
    shorter = rest(beam(10, rn.Gravity(g=G), rn.Clamp(at="beam:0-1")))
    assert end(traj, "rod0.end") == pytest.approx(shorter.x[-1, -1], abs=1e-9)
    assert alone.x[-1, -1, 2] < shorter.x[-1, -1, 2] < 0.0


def test_holding_two_nodes_instead_of_a_wall_loses_half_an_edge():
    """The wall is second order; holding the first edge costs 3 / (2 N) of the deflection."""
    P = 1e-4 * EI / L**2
    theory, sizes = P * L**3 / (3 * EI), (10, 20, 40)
    wall, edge = (
        [
            end(rest(beam(n, rn.PointForce(at="beam.end", force=(0, 0, P)), rn.Clamp(at=at))), "beam.end")[2]
            / theory
            - 1.0
            for n in sizes
        ]
        for at in ("beam.start", "beam:0-1")
    )
    assert order(sizes, wall) == pytest.approx(2.0, abs=0.02)
    assert order(sizes, edge) == pytest.approx(1.0, abs=0.05)
    assert edge[-1] == pytest.approx(-1.5 / 40, rel=0.05)


class Bend(rn.Actuator):
    """A constant natural curvature."""

    drives = "curvature"

    def __init__(self, kappa, **options):
        super().__init__("beam", **options)
        self.kappa, self.stations = kappa, None

    def command(self, t, sensors, p):
        self.stations = np.array(sensors["s"])
        return np.array(self.kappa)


@pytest.mark.parametrize("held", ["start", "end"])
@pytest.mark.parametrize("kappa", [(2.0, 0.0), (0.0, 2.0), (1.0, -1.5)])
def test_actuated_curvature_reaches_the_wall(held, kappa):
    """It bends the half edge at the wall, too: an arc, as of a rod that was made curved."""
    wall, frame = rn.Clamp(at=f"beam.{held}"), {"director": (0, 0, 1.0)}
    bend = Bend(kappa)
    actuated = rest(beam(20, wall, bend, **frame))
    grown = rest(beam(20, wall, natural_curvature=kappa, **frame))
    # the actuator's angles are kappa l, a made curvature's 2 tan(kappa l / 2)
    assert actuated.x[-1] == pytest.approx(grown.x[-1], abs=1e-5 * L)
    inner = np.arange(1, 20) * L / 20
    assert np.sort(bend.stations) == pytest.approx(
        np.sort([*inner, 0.0 if held == "start" else L]), abs=1e-12
    )


class Odd(rn.EnergyModel):
    """A law that tells kappa2 from -kappa2, quadratic about a curvature of its own."""

    strain = "curvature"

    def psi(self, strain, p):
        off = strain.kappa - np.array([0.5, 2.0])
        stiffness = np.stack([strain.EI1, strain.EI2], axis=1)
        return 0.5 * np.sum(stiffness * off**2, axis=1), stiffness * off, stiffness


@pytest.mark.parametrize("held", ["start", "end"])
def test_a_users_bending_law_acts_alike_at_both_walls(held):
    figure = rn.StickFigure()
    figure.rod("beam", [(0, 0, 0), (L, 0, 0)], edges=20, material=MATERIAL, radius=R, director=(0, 0, 1.0))
    wall = rn.Clamp(at=f"beam.{held}")
    law = rest(rn.Robot(figure.build(), [rn.Stretching(), rn.Twisting(), Odd(), wall]))
    grown = rest(beam(20, wall, natural_curvature=(0.5, 2.0), director=(0, 0, 1.0)))
    assert law.x[-1] == pytest.approx(grown.x[-1], abs=1e-5 * L)


# -- grippers ------------------------------------------------------------------------------------
def light(*terms):
    """A rod without inertia to speak of: twist inertia is all that a free end can lean on."""
    figure = rn.StickFigure()
    figure.rod("beam", [(0, 0, 0), (L, 0, 0)], edges=8, material=rn.Material(E=1e7, rho=1e-2), radius=R)
    return rn.Robot(figure.build(), [*elastic(), *terms])


@pytest.mark.parametrize("stepper", ["euler", "sdirk2"])
def test_a_slow_round_of_a_closed_cone_leaves_a_free_rod_untwisted(stepper):
    """Dynamically, in a viscous medium, from rest to rest; prescribing the angle would leave 48 degrees."""
    smooth = lambda t: cone(2.0 * np.pi * (s := min(t / 4.0, 1.0)) ** 3 * (10 - 15 * s + 6 * s * s))  # noqa: E731
    grip = rn.PrescribedMotion(at="beam:0-1", orientation=smooth)
    robot = light(grip, rn.ResistiveForce(viscosity=0.05))
    sim = rn.Simulation(robot, 0.04, stepper=stepper, tolerance=TIGHT)
    while sim.t < 6.0 - 1e-9:
        assert sim.step().ok
        assert np.abs(sim.state.tau).max() < 1e-10
    held = sim.observe().x[:2]  # the gripper is back; the rest still creeps through the medium
    assert held == pytest.approx(robot.graph.x0[:2], abs=1e-12)


@pytest.mark.parametrize("at", ["beam:0-1", "beam.start"])
@pytest.mark.parametrize("form", ["matrix", "quaternion", "Rotation"])
def test_orientations_come_in_three_forms(at, form):
    """Also a quaternion of either sign and any length; a closed cone then leaves no twist."""
    turns = 0

    def smooth(t):
        nonlocal turns
        turns += 1
        s = min(t / 2.0, 1.0)
        R = cone(2.0 * np.pi * s**3 * (10 - 15 * s + 6 * s * s))
        return {
            "matrix": R,
            "quaternion": (-1.0) ** turns * 3.0 * Rotation.from_matrix(R).as_quat(),
            "Rotation": Rotation.from_matrix(R),
        }[form]

    robot = light(rn.PrescribedMotion(at=at, orientation=smooth), rn.ResistiveForce(viscosity=0.05))
    sim = rn.Simulation(robot, 0.04, tolerance=TIGHT)
    while sim.t < 2.5 - 1e-9:
        assert sim.step().ok
    assert np.abs(sim.state.tau).max() < 1e-10


def test_orientations_that_are_none():
    for bad in (np.zeros(4), np.eye(2), 2.0 * np.eye(3)):
        with pytest.raises(rn.TermError, match="orientation"):
            beam(4, rn.PrescribedMotion(at="beam:0-1", orientation=lambda t, bad=bad: bad))


def test_a_turn_of_one_end_twists_evenly():
    """One full turn against a clamp: 2 pi / L everywhere, torque 2 pi GJ / L, and its work as energy."""
    grip = rn.PrescribedMotion(
        at="beam.start",
        orientation=lambda t: Rotation.from_rotvec([2.0 * np.pi * t, 0, 0]).as_matrix(),
    )
    pull = 4.0 * (2.0 * np.pi * GJ / L) ** 2 / (4.0 * EI)  # well below writhing
    far = rn.PrescribedMotion(
        at="beam.end",
        position=lambda t: np.array([pull / (MATERIAL.E * np.pi * R**2) * L * t, 0, 0]),
        orientation=lambda t: np.eye(3),
        name="far",
    )
    robot, state = beam(10, grip, far), None
    for t in np.linspace(0.0, 1.0, 9)[1:]:
        traj = rest(robot, t=t, start=state)
        state = traj.state()
    springs = traj.internal.torque[-1]
    assert springs == pytest.approx(-GJ * 2.0 * np.pi / L, rel=1e-9)
    assert np.sum(state.tau) == pytest.approx(-2.0 * np.pi, abs=1e-12)
    assert traj.reactions["motion"].moment[-1, 0] == pytest.approx(GJ * 2.0 * np.pi / L, rel=1e-9)
    assert traj.energies["twisting"][-1] == pytest.approx(0.5 * GJ * (2.0 * np.pi) ** 2 / L, rel=1e-9)


@pytest.mark.parametrize("at", ["beam.start", "beam:0-1"])
def test_prescribed_orientation_is_exact(at):
    """The held frame is R(t) times the initial one, at every step and whatever it went through."""
    turn = lambda t: Rotation.from_rotvec([3.0 * t, np.sin(2 * t), 0.5 * t * t]).as_matrix()  # noqa: E731
    path = lambda t: np.array([0.02 * np.sin(3 * t), 0.01 * t, 0.0])  # noqa: E731
    robot = beam(
        6, rn.PrescribedMotion(at=at, position=path, orientation=turn), rn.ResistiveForce(viscosity=1.0)
    )
    sim = rn.Simulation(robot, 0.01, stepper="sdirk2")
    edge = robot.graph.edge_count if at == "beam.start" else 0
    first = sim.model.frames0[edge]
    for _ in range(100):
        assert sim.step().ok
        state, k = sim.state, sim.model.twist0
        angle = state.q[k + edge]
        d2 = np.cross(state.tangents[edge], state.directors[edge])
        m1 = np.cos(angle) * state.directors[edge] + np.sin(angle) * d2
        assert m1 == pytest.approx(turn(sim.t) @ first[:, 0], abs=1e-13)
        assert state.tangents[edge] == pytest.approx(turn(sim.t) @ first[:, 2], abs=1e-13)
        assert sim.observe().x[0] == pytest.approx(path(sim.t), abs=0.0)


def test_work_of_a_moving_wall_is_the_energy_that_appears():
    """A wall that moves and turns a swinging rod: reaction power integrated against energies, at O(dt^2)."""
    turn = lambda t: Rotation.from_rotvec([0, 0.5 * np.sin(6 * t) ** 2, 0.3 * np.sin(4 * t) ** 2]).as_matrix()  # noqa: E731
    path = lambda t: np.array([0, 0.02 * np.sin(5 * t) ** 2, 0.03 * (1 - np.cos(7 * t))])  # noqa: E731
    gaps = []
    for dt in (4e-3, 2e-3):
        wall = rn.PrescribedMotion(at="beam.start", position=path, orientation=turn)
        traj = rn.Simulation(beam(8, wall), dt, stepper="sdirk2", tolerance=TIGHT).run(0.6)
        energy, power = sum(traj.energies.values()), traj.powers["motion"]
        work = 0.5 * dt * np.sum(power[:-1] + power[1:])
        gaps.append(abs(energy[-1] - energy[0] - work) / np.abs(power).mean())
    assert gaps[-1] < 0.05
    assert gaps[0] / gaps[1] > 2.5


def test_a_swivel_leaves_the_twist_free_and_the_tangent_held():
    direction = lambda t: cone(2.0 * np.pi * t)[:, 0]  # noqa: E731
    grip = rn.Grasp(at="beam:0-1", position=lambda t: np.zeros(3), tangent=direction, twist="free")
    traj = rn.Simulation(light(grip, rn.ResistiveForce(viscosity=1.0)), 0.02).run(1.0)
    edge = traj.x[:, 1] - traj.x[:, 0]
    assert np.linalg.norm(edge, axis=1) == pytest.approx(L / 8, abs=1e-15)
    held = np.array([direction(t) for t in traj.t])
    assert edge / (L / 8) == pytest.approx(held, abs=1e-13)
    assert np.abs(traj.internal.torque).max() < 1e-9 * EI / L


def test_offset_of_a_no_spin_grasp_turns_the_rod():
    """The calibratable offset is a turn of the rod in the gripper."""
    grip = lambda offset: rn.Grasp(  # noqa: E731
        at="beam:0-1", position=lambda t: np.zeros(3), tangent=lambda t: np.array([1.0, 0, 0]),
        twist="no-spin", duration=1.0, offset=offset,
    )  # fmt: skip
    still = rn.PrescribedMotion(at="beam.end", orientation=lambda t: np.eye(3), name="far")
    traj = rest(beam(8, grip(0.4), still), t=0.5)
    # from the middle of the held edge to the far wall
    assert traj.internal.torque[-1] == pytest.approx(-GJ * 0.4 / (L * 7.5 / 8), rel=1e-6)


def test_a_no_spin_grasp_goes_on_beyond_its_duration():
    """The frame is carried along the path however long the run is."""
    direction = lambda t: cone(2.0 * np.pi * t)[:, 0]  # noqa: E731
    grips = [
        rn.Grasp(
            at="beam:0-1",
            position=lambda t: np.zeros(3),
            tangent=direction,
            twist="no-spin",
            duration=duration,
        )
        for duration in (0.1, 1.3)
    ]
    turned = [[grip.orientation(t, grip.values()) for t in np.linspace(0.0, 1.3, 27)] for grip in grips]
    assert np.array_equal(turned[0], turned[1])
    # once round the cone: the holonomy, seen along the axis
    solid = 2.0 * np.pi * (1.0 - np.cos(np.radians(30.0)))
    back = turned[0][20]
    assert back[:, 0] == pytest.approx((1.0, 0, 0), abs=1e-5)
    assert abs(np.arctan2(back[2, 1], back[1, 1])) == pytest.approx(solid, abs=1e-5)
