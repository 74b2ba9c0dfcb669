"""What the compiled blocks leave out, and that both ways agree."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.tangent import follow
from rodnet.tangent.columns import make_columns
from rodnet.tangent.follow import Tangent
from tests.tangent import whole_runs as wr
from tests.tangent.test_whole_runs import cable, check

RUBBER = rn.Material(E=1e6, nu=0.4, rho=1000.0)


def twirl(**options):
    """A rod that whirls about: its frames turn by large angles in every step."""
    fig = rn.StickFigure()
    fig.rod("rod", [(0, 0, 0), (0.1, 0.02, 0), (0.2, 0.0, 0.06)], edges=9, material=RUBBER, radius=3e-3)
    terms = [
        rn.Stretching(),
        rn.Bending(),
        rn.Twisting(),
        rn.ResistiveForce(viscosity=0.5, axial_torque=True),
    ]
    return rn.Robot(fig.build(), [*terms, rn.Hinge(at="rod.start"), *options.get("terms", [])])


@pytest.mark.parametrize("stepper", ["euler", "sdirk2", "alpha"])
def test_compiled_blocks_are_what_differences_of_stages_are(stepper, monkeypatch):
    robot = twirl()
    velocity = 8.0 * np.cross([0.3, 0.5, 1.0], robot.graph.x0)
    options = dict(dt=0.02, stepper=stepper, velocity=velocity, tolerance=wr.ROUND_OFF)
    rng = np.random.default_rng(1)
    push = {"push": {"v": rng.standard_normal(robot.graph.x0.shape)}}
    tangents = []
    for quick in (True, False):
        with monkeypatch.context() as patch:
            if not quick:
                patch.setattr(follow, "fits", lambda model: False)
            sim = rn.Simulation(robot, **options)
            columns = make_columns(robot, ["rod.E", "rod.rho", "drag.viscosity"], push, options)
            with Tangent(sim, columns) as tangent:
                assert (tangent.fast is not None) == quick
                for _ in range(6):
                    sim.step()
                tangents.append(tangent.current)
    for name in ("q", "v", "a", "acc", "spin"):
        a, b = (getattr(t, name) for t in tangents)
        assert np.abs(a - b).max(axis=0) == pytest.approx(0.0, abs=2e-7 * np.abs(b).max()), name


def test_rigid_bodies():
    robot = rn.robots.flagellated(n_tails=2, rpm=100.0, rigid="body", edges=4)
    check(robot, 0.05, {"drag.viscosity": ["drag.viscosity"], "motor.rpm": ["motor.rpm"]}, 1e-5, dt=0.01)


def test_a_gripper_whose_motion_depends_on_the_parameter():
    fig = rn.StickFigure()
    fig.rod("cable", [(0, 0, 0), (0.2, 0, 0)], edges=6, material=RUBBER, radius=3e-3)
    grasp = rn.Grasp(
        at="cable:0-1", position=lambda t: np.array([0.0, 0.0, 0.02 * np.sin(3.0 * t)]),
        tangent=lambda t: np.array([1.0, 0.3 * np.sin(2.0 * t), 0.0]), twist="no-spin", duration=1.0, offset=0.4,
    )  # fmt: skip
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.MassDamping(rate=5.0), grasp]
    robot = rn.Robot(fig.build(), terms)
    check(
        robot,
        0.2,
        {"grasp.offset": ["grasp.offset"], "cable.E": ["cable.E"]},
        1e-5,
        dt=0.01,
        stepper="sdirk2",
    )


def test_a_motor_that_answers_to_a_sensor():
    class Governor(rn.Motor):
        gain = rn.Parameter(0.5, unit="1")

        def command(self, t, sensors, p):
            return float(super().command(t, sensors, p) - p.gain * sensors["spin"])

    robot = rn.robots.flagellated(n_tails=1, rpm=60.0, edges=6)
    terms = [t for t in robot.terms if t.name != "motor"]
    governed = rn.Robot(
        robot.graph,
        [*terms, Governor(at="head:1", rpm=60.0, name="motor")],
        {"spin": lambda s: s.spin("head:0-1")},
    )
    check(governed, 0.2, {"motor.gain": ["motor.gain"], "head.C2": ["head.C2"]}, 1e-5, dt=0.01)


def test_an_initial_displacement_and_a_wave():
    robot = twirl(terms=[rn.CurvatureWave(amplitude=15.0, wavelength=0.2, frequency=2.0)])
    x = 0.01 * np.sin(9.0 * robot.graph.x0[:, :1]) * np.array([0.0, 1.0, 1.0])
    parameters = {"wave.amplitude": ["wave.amplitude"]}
    check(robot, 0.2, parameters, 1e-5, {"lift": {"x": x}}, dt=0.02, stepper="sdirk2")


def test_a_law_without_derivatives_and_a_ring():
    class Cubic(rn.DragModel):
        c = rn.Parameter(3.0, unit="N s^3/m^4", bounds=(0, None))

        def force(self, site, p):
            return -p.c * np.sum(site.v**2, axis=1, keepdims=True) * site.v

    angles = np.linspace(0.0, 2.0 * np.pi, 9)[:-1]
    fig = rn.StickFigure()
    points = [(0.1 * np.cos(a), 0.1 * np.sin(a), 0.0) for a in angles]
    fig.rod("ring", points, material=RUBBER, radius=4e-3, closed=True)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), Cubic(), rn.Clamp(at="ring:0-1")]
    check(rn.Robot(fig.build(), terms), 0.2, {"drag.c": ["drag.c"], "ring.E": ["ring.E"]}, 1e-5, dt=0.02)


def test_a_parameter_at_its_bound_and_one_that_is_zero():
    robot = cable()
    found = rn.sensitivities(
        robot, 0.1, parameters={"damping.twist": 0.01, "gravity.fluid_density": 1000.0}, tolerance=wr.ROUND_OFF,
    )  # fmt: skip
    robot = robot.with_parameters({"damping.twist": 0.0})
    at_zero = rn.sensitivities(
        robot, 0.1, parameters={"gravity.fluid_density": 1000.0}, tolerance=wr.ROUND_OFF
    )
    split, step = wr.parts(robot), 20.0

    def run(change):
        return wr.last(robot.with_parameters({"gravity.fluid_density": change}), 0.1)

    expected = (-3.0 * run(0.0) + 4.0 * run(step) - run(2.0 * step)) / (2.0 * step)
    assert wr.error(wr.at_end(at_zero)[:, 0], expected, split) < 1e-4
    assert np.all(np.isfinite(found.x))


def test_observations_and_names():
    robot = cable()
    found = rn.sensitivities(
        robot, 0.1, parameters=["*.E"], save_every=5,
        observe={"tip": lambda s: s.position("left.end"), "height": lambda s: float(np.mean(s.x[:, 2]))},
    )  # fmt: skip
    tip = robot.graph.node("left.end")
    assert found.outputs["tip"] == pytest.approx(found.x[:, tip], abs=1e-7 * np.abs(found.x).max())
    data = found.to_xarray()
    assert data["d_tip"].dims == ("time", "tip_0", "parameter")
    assert data["d_height"].shape == (3, 1)
    assert list(data["parameter"].values) == ["*.E"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"parameters": ["stem.Q"]}, "no parameter 'stem.Q'"),
        ({"parameters": ["*.rho", "*.rho"]}, "given twice"),
        ({}, "nothing to take sensitivities by"),
        ({"initial": {"push": {"w": 1.0}}}, "give 'x'"),
        ({"initial": {"push": {"v": [1.0]}}}, "one row per node"),
        ({"parameters": ["stem.E"], "adaptive": 1e-3}, "fixed time step"),
        ({"parameters": ["stem.E"], "observe": {"tip": 3}}, "must be a function"),
    ],
)
def test_bad_input_is_refused(arguments, message):
    with pytest.raises(rn.ParameterError, match=message):
        rn.sensitivities(cable(), 0.1, **arguments)


def test_sections_and_natural_shapes():
    fig = rn.StickFigure()
    options = dict(edges=6, material=RUBBER, natural_curvature=(4.0, 0.0))
    fig.rod("hook", [(0, 0, 0), (0.2, 0, 0)], section=rn.elliptic(4e-3, 2e-3), **options)
    fig.rod("tip", ["hook.end", (0.3, 0.05, 0)], edges=3, material=RUBBER, radius=2e-3, natural="straight")
    drag = rn.ResistiveForce(viscosity=0.5, on="hook")
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), drag, rn.Clamp(at="hook.start")]
    robot = rn.Robot(fig.build(), terms)
    assert "tip.twist" in robot.parameters
    assert robot.parameters["hook.curvature1"].value == 4.0
    paths = {name: [name] for name in ("hook.radius", "hook.curvature1", "tip.curvature2", "hook.twist")}
    check(robot, 0.2, paths, 1e-5, dt=0.02, relative=2e-4)


def test_a_section_scales_as_it_is_drawn():
    fig = rn.StickFigure()
    fig.rod("rod", [(0, 0, 0), (0.1, 0, 0)], edges=2, material=RUBBER, radius=2e-3)
    thick = rn.StickFigure()
    thick.rod("rod", [(0, 0, 0), (0.1, 0, 0)], edges=2, material=RUBBER, radius=3e-3)
    robot = rn.Robot(fig.build(), [rn.Stretching()]).with_parameters({"rod.radius": 3e-3})
    for name in ("EA", "EI1", "GJ", "radius", "node_mass", "edge_inertia"):
        assert getattr(robot.graph, name) == pytest.approx(getattr(thick.build(), name), rel=1e-14)


def test_a_natural_length_is_not_what_is_drawn(tmp_path):
    fig = rn.StickFigure()
    fig.rod("stem", [(0, 0, 0), (0.2, 0, 0)], edges=5, material=RUBBER, radius=4e-3)
    fig.rod("arm", ["stem.end", (0.25, 0.1, 0)], edges=3, material=RUBBER, radius=3e-3, length=0.112)
    terms = [
        rn.Stretching(),
        rn.Bending(),
        rn.Twisting(),
        rn.Gravity(),
        rn.KelvinVoigt(stretch=2e-3, bend=2e-3),
    ]
    robot = rn.Robot(fig.build(), [*terms, rn.Clamp(at="stem.start")])
    assert robot.parameters["stem.length"].value == pytest.approx(0.2, rel=1e-14)
    same = robot.with_parameters({"stem.length": robot.parameters["stem.length"].value})
    assert np.array_equal(same.graph.rest_length, robot.graph.rest_length)
    longer = robot.with_parameters({"stem.length": 0.21, "stem.rho": 800.0})
    # as a rod that is drawn so long and thereafter put to where it was
    drawn = rn.StickFigure()
    drawn.rod(
        "stem",
        [(0, 0, 0), (0.21, 0, 0)],
        edges=5,
        material=rn.Material(E=1e6, nu=0.4, rho=800.0),
        radius=4e-3,
    )
    other = drawn.build()
    edges = robot.graph.rods["stem"].edges
    for name in ("rest_length", "edge_mass", "edge_inertia", "EA", "EI1"):
        assert getattr(longer.graph, name)[edges] == pytest.approx(getattr(other, name), rel=1e-12), name
    assert longer.graph.springs.stiffness[:4] == pytest.approx(other.springs.stiffness, rel=1e-12)
    assert np.array_equal(longer.graph.x0, robot.graph.x0)
    again = rn.Robot.load(longer.save(tmp_path / "robot.toml"))
    assert [again.parameters[f"{rod}.length"].value for rod in ("stem", "arm")] == [0.21, 0.112]
    check(
        robot, 0.1, {name: [name] for name in ("stem.length", "arm.length")}, 1e-5, dt=0.01, stepper="sdirk2"
    )


def test_a_rod_needs_a_length():
    with pytest.raises(rn.GraphError, match="natural length, a positive number"):
        rn.StickFigure().rod("rod", [(0, 0, 0), (1, 0, 0)], material=RUBBER, radius=1e-2, length=-1.0)


class Shaker(rn.Constraint):
    """A clamp that is shaken and tilted."""

    holds = {"position", "orientation"}
    amplitude = rn.Parameter(0.01, unit="m")
    rate = rn.Parameter(9.0, unit="rad/s")
    tilt = rn.Parameter(0.3, unit="rad")

    def position(self, t, x0, p):
        return super().position(t, x0, p) + p.amplitude * (1.0 - np.cos(p.rate * t)) * np.array(
            [0.2, 0.0, 1.0]
        )

    def orientation(self, t, p):
        angle = p.tilt * np.sin(p.rate * t) ** 2
        c, s = np.cos(angle), np.sin(angle)
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("stepper", ["euler", "sdirk2", "alpha"])
def test_a_clamp_whose_motion_has_parameters(stepper):
    fig = rn.StickFigure()
    fig.rod("cable", [(0, 0, 0), (0.2, 0, 0)], edges=5, material=RUBBER, radius=3e-3)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), rn.MassDamping(rate=2.0)]
    shaker = Shaker(at="cable.start" if stepper == "euler" else "cable:0-1", name="shaker")
    robot = rn.Robot(fig.build(), [*terms, shaker])
    paths = {name: [name] for name in ("shaker.amplitude", "shaker.rate", "shaker.tilt", "cable.length")}
    check(robot, 0.1, paths, 1e-5, relative=1e-4, dt=0.01, stepper=stepper)


def test_rigid_bodies_on_a_hinge():
    fig = rn.StickFigure()
    fig.rod("arm", [(0, 0, 0), (0.1, 0, 0)], edges=3, material=RUBBER, radius=4e-3)
    fig.rigid("hub", ["arm.end", (0.13, 0, 0), (0.13, 0.02, 0.01)], mass=0.01, radius=5e-3)
    fig.rod("tail", ["hub:1", (0.2, -0.02, 0)], edges=3, material=RUBBER, radius=3e-3)
    fig.body("hub")
    fig.joint("hub:1", kind="hinge", axis=(0, 1, 0.2), of="tail", stiffness=1e-3)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), rn.ResistiveForce(viscosity=0.5)]
    robot = rn.Robot(fig.build(), [*terms, rn.Clamp(at="arm.start")])
    paths = {name: [name] for name in ("arm.E", "tail.rho", "joints.scale")}
    rng = np.random.default_rng(5)
    velocity = 0.05 * rng.standard_normal(robot.graph.x0.shape)
    check(robot, 0.06, paths, 1e-5, dt=0.01, stepper="sdirk2", velocity=velocity)


@pytest.mark.parametrize("stepper", ["euler", "sdirk2", "alpha"])
def test_a_body_with_two_radii_of_gyration_alike(stepper):
    fig = rn.StickFigure()
    fig.rod("cable", [(0, 0, 0), (0.2, 0, -0.1)], edges=3, material=RUBBER, radius=4e-3)
    fig.rigid("block", ["cable.end", (0.24, 0, -0.1), (0.24, 0.03, -0.1)])
    fig.body("block", mass=0.02)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), rn.Clamp(at="cable.start")]
    robot = rn.Robot(fig.build(), terms)
    check(robot, 0.1, {name: [name] for name in ("cable.E", "cable.rho")}, 1e-5, dt=0.01, stepper=stepper)
