"""Torque about the rods' own axes of grains and of thinning and yielding fluids: the slip of the surface."""

import numpy as np
import pytest

import rodnet as rn

LENGTH, RADIUS, DEPTH = 0.2, 3e-3, 0.05
SAND = {"CF": 1.8e5, "CS": 4.2e5, "gamma": 4.0}
LAWS = {
    "grains": lambda **o: rn.GranularForce(**SAND, surface=DEPTH, speed=1e-4, **o),
    "yield stress": lambda **o: rn.BinghamForce(viscosity=2.0, yield_stress=30.0, speed=1e-4, **o),
    "shear thinning": lambda **o: rn.PowerLawForce(viscosity=2.0, rate=1.0, exponent=0.4, **o),
}


def rod(edges=5, E=1e8, **options):
    figure = rn.StickFigure()
    points = [(0, 0, 0), (LENGTH, 0, 0)]
    figure.rod("rod", points, edges=edges, material=rn.Material(E=E), radius=RADIUS, **options)
    return figure.build()


def loads(law, v=(0.0, 0.0, 0.0), spin=0.0):
    """Force [N] and torque [N m] on a straight rod that moves and spins."""
    graph = rod()
    sim = rn.Simulation(rn.Robot(graph, [law]), 1e-9, velocity=np.tile(v, (6, 1)))
    ev, m = sim.newton.ev, sim.model
    rates = sim.state.v.copy()
    rates[m.twist0 : m.turn0] = spin
    ev.set_source(m.t0, m.d10, np.zeros(m.spring_count), sim.state.q)
    assert ev.update(sim.state.q, rates, 0.0, 1e-9, 0.0, False)
    F = m.bound[0].forces(ev)
    return F[: m.twist0].reshape(-1, 3).sum(axis=0), F[m.twist0 : m.turn0].sum()


@pytest.mark.parametrize("name", LAWS)
def test_the_contract_of_terms(name):
    """Derivatives (tangent and place included), dissipation, steps, on a curved rod and a network."""
    law = LAWS[name](axial_torque=True)
    rn.testing.check_term(law)


def test_in_a_network_with_joints_restarted_and_swept():
    rn.testing.check_in_robot(LAWS["grains"](axial_torque=True))


@pytest.mark.parametrize("name", LAWS)
def test_without_spin_it_is_the_law_without_torque(name):
    for v in ((0.01, 0.0, 0.0), (0.004, 0.003, -0.001)):
        plain, spinning = loads(LAWS[name](), v), loads(LAWS[name](axial_torque=True), v)
        assert spinning[0] == pytest.approx(plain[0], rel=1e-12)
        assert spinning[1] == plain[1] == 0.0


def test_the_torque_of_grains_is_the_friction_along_at_the_arm_of_the_radius():
    """Coulomb's friction does not know along from around, whatever the pressure is around the rod."""
    law = LAWS["grains"](axial_torque=True)
    along = -loads(law, (1.0, 0, 0))[0][0]
    assert along == pytest.approx(2 * RADIUS * DEPTH * SAND["CF"] * LENGTH, rel=1e-7)
    assert -loads(law, spin=1.0 / RADIUS)[1] == pytest.approx(RADIUS * along, rel=1e-7)
    assert -loads(law, spin=-7.0 / RADIUS)[1] == pytest.approx(-RADIUS * along, rel=1e-7)


@pytest.mark.parametrize("ratio", [0.3, 1.0, 4.0])
def test_a_rod_that_spins_slides_more_easily(ratio):
    """Relative slip: the friction along is its full value over sqrt(1 + (r w / v)^2) (Jung et al. 2017)."""
    law = LAWS["grains"](axial_torque=True)
    full = -loads(law, (1.0, 0, 0))[0][0]
    force, torque = loads(law, (1.0, 0, 0), ratio / RADIUS)
    assert -force[0] == pytest.approx(full / np.hypot(1.0, ratio), rel=1e-6)
    assert -torque == pytest.approx(RADIUS * full * ratio / np.hypot(1.0, ratio), rel=1e-6)


def test_the_torque_of_a_fluid_with_a_yield_stress():
    """The yield stress on the whole surface, and Stokes' torque of a cylinder with the plastic viscosity."""
    law = LAWS["yield stress"](axial_torque=True)
    w = 5.0
    expected = 2 * np.pi * RADIUS**2 * 30.0 + 4 * np.pi * 2.0 * RADIUS**2 * w
    assert -loads(law, spin=w)[1] == pytest.approx(expected * LENGTH, rel=1e-10)
    plain = loads(rn.BinghamForce(viscosity=2.0, yield_stress=0.0, axial_torque=True), spin=w)[1]
    assert plain == pytest.approx(-4 * np.pi * 2.0 * RADIUS**2 * w * LENGTH, rel=1e-12)


def test_a_newtonian_fluid_of_the_power_law_is_that_of_resistive_force_theory():
    law = rn.PowerLawForce(viscosity=2.0, rate=1.0, exponent=1.0, axial_torque=True)
    ours = loads(law, (0.01, 0.02, 0.0), 3.0)
    theirs = loads(rn.ResistiveForce(viscosity=2.0, axial_torque=True), (0.01, 0.02, 0.0), 3.0)
    assert ours[0] == pytest.approx(theirs[0], rel=1e-12)
    assert ours[1] == pytest.approx(theirs[1], rel=1e-12)


def test_a_motor_turns_against_the_grains():
    """Head and tail turn by the inverse ratio of their torques' slopes; a tail in air would spin alone."""
    figure = rn.StickFigure()
    made = rn.Material(E=1e9)
    figure.rod("head", [(0, 0, 0), (0.05, 0, 0)], edges=3, material=made, radius=5e-3)
    figure.rod("tail", ["head.end", (0.2, 0, 0)], edges=6, material=made, radius=3e-3)
    sand = rn.GranularForce(**SAND, surface=DEPTH, speed=1.0, axial_torque=True)  # slow against it: viscous
    robot = rn.Robot(
        figure.build(),
        [rn.Stretching(), rn.Bending(), rn.Twisting(), sand, rn.Motor(at="head.end", rpm=1.0)],
    )
    sim = rn.Simulation(robot, 1e-2)
    sim.run(0.5)
    w = sim.observe().state.v[sim.model.twist0 : sim.model.turn0]
    head, tail = w[:3].mean(), w[3:].mean()
    # 2 r^3 z CF w l / speed on either side, and the motor's rate between them
    assert tail - head == pytest.approx(2 * np.pi / 60, rel=1e-6)
    assert head * 5e-3**3 * 0.05 == pytest.approx(-tail * 3e-3**3 * 0.15, rel=1e-3)


def test_an_arm_that_bends_and_spins_loses_no_energy_to_its_frames():
    """The spin is that of the frame, transport included: turning a bent rod as a whole about z spins no edge."""
    figure = rn.StickFigure()
    angles = np.linspace(0, 1.5, 9)
    points = 0.1 * np.stack([np.sin(angles), 1 - np.cos(angles), 0 * angles], axis=1)
    graph = figure.rod("rod", list(points), material=rn.Material(E=1e8), radius=RADIUS).build()
    law = LAWS["grains"](axial_torque=True)
    velocity = np.cross([0, 0, 2.0], graph.x0)
    sim = rn.Simulation(rn.Robot(graph, [law]), 1e-9, velocity=velocity)
    traj = sim.run(1e-9)
    assert np.abs(traj.state().v[sim.model.twist0 :]).max() < 1e-6


@pytest.mark.parametrize("stepper", ["euler", "sdirk2"])
def test_it_is_saved_restarted_and_swept(stepper, tmp_path):
    import pickle

    graph = rod()
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), LAWS["grains"](axial_torque=True),
             rn.PointTorque(on="rod.end", torque=(5e-3, 0, 0))]  # fmt: skip
    robot = pickle.loads(pickle.dumps(rn.Robot(graph, terms)))
    again = rn.Robot.load(robot.save(tmp_path / "robot.toml"))
    whole = rn.Simulation(robot, 1e-3, stepper=stepper).run(0.01)
    half = rn.Simulation(again, 1e-3, stepper=stepper)
    half.run(0.005)
    rest = rn.Simulation(again, 1e-3, stepper=stepper)
    rest.restore(half.state)
    assert np.array_equal(rest.run(0.005).state().q, whole.state().q)


def test_what_it_cannot_be_combined_with():
    with pytest.raises(rn.TermError, match=r"axial_torque is that of an edge in a medium at rest.*flow="):
        LAWS["grains"](axial_torque=True, flow=(1, 0, 0))
    with pytest.raises(rn.TermError, match=r'axial_torque is that of an edge.*tangent="node"'):
        LAWS["yield stress"](axial_torque=True, tangent="node")
