"""Damping, friction, drives and tendons in a network: every stepper, restart, replay, sweep."""

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest

import rodnet as rn

TERMS = {
    "kelvin-voigt": lambda: [rn.KelvinVoigt(stretch=1e-3, bend=2e-2, twist=1e-2)],
    "mass-damping": lambda: [rn.MassDamping(rate=4.0)],
    "dry-friction": lambda: [rn.DryFriction(moment=2e-4, torque=1e-4, curvature=2.0, twist=2.0)],
    "buoyancy": lambda: [rn.Gravity(fluid_density=700.0, name="buoyancy")],
    "follower": lambda: [rn.FollowerForce(at="twig.end", force=(2e-3, 1e-3, -3e-3))],
    "dc-motor": lambda: [
        rn.DCMotor(at="arm:3", rpm=30.0, stall_torque=2e-3, no_load_rpm=90.0, lag=0.04),
    ],
    "slow-curvature": lambda: [rn.SlowCurvature("twig", curvature=6.0, time_constant=0.05)],
    "tendon": lambda: [rn.Tendon(route=ROUTE, tension=0.03, friction=0.3, reach=1e-4, schedule=ramp)],
    "pulled tendon": lambda: [rn.Tendon(route=ROUTE, pull=5e-4, stiffness=5.0, schedule=ramp)],
    "all": lambda: [
        t for name, make in TERMS.items() if name not in ("all", "pulled tendon") for t in make()
    ],
}
ROUTE = [
    (0.0, 0.0, 5e-3),
    ("arm:2", (5e-3, 0.0)),
    ("arm:4", (4e-3, 1e-3)),
    ("twig:1", (3e-3, 0.0)),
    "twig.end",
]


def ramp(t):
    return min(t / 0.1, 1.0) ** 2


def network(terms):
    """A clamped arm with a hub, two twigs, a ring on one of them."""
    figure, soft = rn.StickFigure(), rn.Material(E=3e6, rho=1000.0)
    figure.rod("arm", [(0, 0, 0), (0.1, 0, 0.01)], edges=5, material=soft, radius=3e-3)
    figure.rod("twig", ["arm.end", (0.14, 0.05, 0.0)], edges=3, material=soft, radius=2e-3)
    figure.rod(
        "other", ["arm.end", (0.14, -0.05, 0.02)], edges=3, material=soft, section=rn.elliptic(3e-3, 2e-3)
    )
    figure.rod("loop", ["other:1", (0.16, 0.0, 0.04), "twig:2"], edges=4, material=soft, radius=2e-3)
    extra = TERMS[terms]()
    elastic = [rn.Stretching(), rn.Bending(), rn.Twisting()]
    return rn.Robot(figure.build(), [*elastic, rn.Gravity(g=3.0), rn.Clamp(at="arm.start"), *extra])


@pytest.mark.parametrize("stepper", ["euler", "sdirk2", "alpha"])
@pytest.mark.parametrize("name", TERMS)
def test_runs_restarts_and_replays(name, stepper, tmp_path):
    """Bit-equal after a restart from a file; the powers of the replay add up at every state."""
    robot, tight = network(name), rn.Tolerance(residual=1e-11)
    file = tmp_path / "run.nc"
    whole = rn.Simulation(robot, 5e-3, stepper=stepper, tolerance=tight).run(0.12)
    assert whole.stats["substeps"] == whole.stats["steps"]
    rn.Simulation(robot, 5e-3, stepper=stepper, tolerance=tight).run(0.06, out=file)
    again = rn.Simulation(robot, 5e-3, stepper=stepper, tolerance=tight)
    again.restore(rn.Trajectory.load(file, robot).state())
    end, state = again.run(0.06).state(), whole.state()
    for key in ("q", "v", "a", "tau"):
        assert np.array_equal(getattr(end, key), getattr(state, key)), key
    for one, two in zip(end.memories, state.memories, strict=True):
        assert one is two is None or np.array_equal(one, two)
    powers = dict(whole.powers)
    kinetic = powers.pop("kinetic")
    size = max(np.abs(p).max() for p in powers.values())
    # a replay takes the frames of each state for its source: the turn of a step, squared
    assert np.abs(sum(powers.values()) - kinetic)[2:].max() < 5e-6 * size


def tip(traj):
    return {"tip": traj.at("twig.end")[-1]}


def build(tension):
    return network("all").with_parameters({"tendon.tension": tension})


def test_in_a_sweep_of_processes():
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        found = rn.sweep(build, {"tension": [0.0, 0.1]}, tip, pool, duration=0.05, dt=5e-3)
    here = [rn.Simulation(build(v), 5e-3).run(0.05).at("twig.end")[-1] for v in (0.0, 0.1)]
    assert np.array_equal(found["tip"].values, np.array(here))
    assert np.abs(here[1] - here[0]).max() > 1e-5


def test_twisting_may_share_the_damping_of_bending():
    """A shaft wrung and let go: half the time of bending by a share is half of it, and none is no damping."""

    def wrung(**options):
        figure, soft = rn.StickFigure(), rn.Material(E=1e6, rho=1000.0)
        figure.rod("shaft", [(0, 0, 0), (0.2, 0, 0)], edges=8, material=soft, radius=2e-3)
        torque = rn.PointTorque(on="shaft:7-8", torque=(2e-5, 0.0, 0.0))
        elastic = [rn.Stretching(), rn.Bending(), rn.Twisting()]
        robot = rn.Robot(
            figure.build(), [*elastic, rn.KelvinVoigt(**options), torque, rn.Clamp(at="shaft.start")]
        )
        return rn.Simulation(robot, 1e-3, stepper="sdirk2").run(0.05)

    share, own, none = (wrung(bend=0.02, **more) for more in ({"torsion": 0.5}, {"twist": 0.01}, {}))
    assert np.array_equal(share.theta, own.theta)
    assert np.abs(share.theta[-1] - none.theta[-1]).max() > 0.1 * np.abs(none.theta[-1]).max()


def test_a_motor_that_gives_way_drives_a_hinge():
    """On a hinge with a shaft of its own, as on a weld: an idle rotor follows, a loaded one droops."""
    figure, soft = rn.StickFigure(), rn.Material(E=1e9, rho=1000.0)
    figure.rod("stator", [(0, 0, 0), (0.1, 0, 0)], edges=3, material=soft, radius=2e-3)
    figure.rod("rotor", ["stator.end", (0.2, 0, 0)], edges=3, material=soft, radius=2e-3)
    figure.joint("stator.end", kind="hinge", axis=(1.0, 0, 0), stiffness=5.0)
    drag = rn.ResistiveForce("rotor", viscosity=50.0, axial_torque=True)
    motor = rn.DCMotor(at="stator.end", rpm=60.0, stall_torque=2e-3, no_load_rpm=120.0)
    damping = [rn.KelvinVoigt(bend=1e-3, twist=1e-3), rn.DryFriction(torque=1e-6), rn.MassDamping()]
    elastic = [rn.Stretching(), rn.Bending(), rn.Twisting()]
    robot = rn.Robot(figure.build(), [*elastic, drag, motor, *damping, rn.Clamp(at="stator.start")])
    traj = rn.Simulation(robot, 0.01, stepper="sdirk2").run(0.8)
    load = 4.0 * np.pi * 50.0 * 2e-3**2 * 0.1 * 120.0 / 2e-3 * 2.0 * np.pi / 60.0
    speed = 60.0 * 2.0 * np.pi / 60.0 / (1.0 + load)
    assert abs(traj.w[-1, robot.graph.rods["rotor"].edges]) == pytest.approx(speed, rel=2e-3)


def test_robots_with_these_terms_as_files(tmp_path):
    """A file brings the same robot back; what is a function of a script is refused."""
    terms = [t for name in TERMS if name not in ("all", "tendon", "pulled tendon") for t in TERMS[name]()]
    offsets = np.array([[5e-3, 0.0], [4e-3, 1e-3]] * 3)
    tendon = rn.Tendon(route=[(0.0, 0.0, 5e-3), ("arm", offsets), "twig.end"], pull=1e-3, stiffness=50.0)
    graph = network("mass-damping").graph
    elastic = [rn.Stretching(), rn.Bending(), rn.Twisting()]
    robot = rn.Robot(graph, [*elastic, rn.Clamp(at="arm.start"), *terms, tendon])
    again = rn.Robot.load(robot.save(tmp_path / "robot.toml"))
    ends = [rn.Simulation(r, 5e-3).run(0.05).state() for r in (robot, again)]
    assert np.array_equal(ends[0].q, ends[1].q)
    with pytest.raises(rn.RodnetError, match="schedule"):
        network("tendon").save(tmp_path / "other.toml")


@pytest.mark.parametrize(
    "term",
    [
        rn.KelvinVoigt(bend=[1.0, 2.0]),
        rn.MassDamping(rate=[1.0, 2.0]),
        rn.DryFriction(moment=[1.0, 2.0]),
        rn.FollowerForce(at="arm:1", force=(0, 0, 1), scale=[1.0, 2.0]),
        rn.DCMotor(at="arm:3", rpm=[1.0, 2.0]),
        rn.SlowCurvature(curvature=[1.0, 2.0]),
        rn.Tendon(route=["arm:1", "arm:2"], tension=[1.0, 2.0]),
    ],
    ids=lambda t: t.name,
)
def test_parameters_that_must_be_one_number(term):
    with pytest.raises(rn.TermError, match=r"'.*': \w+ must be one number, not \[1. 2.\]"):
        network("mass-damping").with_terms(term)
