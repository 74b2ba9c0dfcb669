"""Robots as text files: the same robot to the last bit, and clear words for what a file cannot hold."""

import inspect
import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings
from scipy.interpolate import CubicSpline, make_interp_spline
from typer.testing import CliRunner

import rodnet as rn
from rodnet import registry
from rodnet.files.robot_file import robot_of, tables_of
from rodnet.files.toml_text import toml_text
from rodnet.testing.check_term import curved_rod, place
from rodnet.testing.report import Report
from rodnet.testing.strategies import sketches
from tests.same_robots import same_robots, through_a_file

RUBBER = rn.Material(E=1e6, nu=0.4, rho=1100.0)
T = np.linspace(0.0, 1.0, 30)


def zoo():
    """Everything that a figure can be told, and shared and unusual parameters."""
    figure = rn.StickFigure()
    figure.rigid(
        "head", [(0.1, 0, 0), (0.05, 0, 0), (0, 0, 0)], mass=0.02, radius=4e-3, stiffening=(50.0, 500.0)
    )
    figure.rod(
        "cone", ["head.end", (-0.1, 0.01, 0.003)], edges=5, material=RUBBER, radius=rn.Taper(3e-3, 1e-3)
    )
    graded = [rn.Material(E=1e6 * (1 + k / 7), nu=0.3, rho=1000.0 + k) for k in range(4)]
    figure.rod("strip", ["head.end", (0, 0.1, 1 / 3)], edges=4, material=graded, section=rn.elliptic(3e-3, 7e-4),
               director=(1, 0.1, 0), root="rigid", natural="straight")  # fmt: skip
    tubes = [rn.hollow(2e-3, 1e-3 + 1e-4 * k) for k in range(3)]
    figure.rod("tube", ["head.start", (0.2, 0, 0.1)], edges=3, material=RUBBER, section=tubes,
               natural_curvature=lambda s: (s, 2.0), natural_twist=0.3)  # fmt: skip
    angles = 2 * np.pi * np.arange(8) / 8
    ring = 0.03 * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1) + (0.3, 0, 0)
    figure.rod("ring", list(ring), closed=True, material=RUBBER, radius=1e-3)
    figure.rod("link", ["tube.end", "ring:3"], edges=2, material=RUBBER, radius=1e-3)
    figure.rod("hand", ["ring:0", (0.35, 0.01, 0.04)], edges=2, material=RUBBER, radius=1e-3)
    figure.joint("head.end", hub="head:1-2")
    figure.joint("tube.end", kind="hinge", axis=(1, 2, 3), of="link", stiffness=0.01, angle=0.2)
    figure.joint("ring:3", kind="elastic", stiffness=(0.1, 0.2), axis=(0, 0.1, 1), of="link")
    figure.joint("ring:0", kind="ball", of=["hand"])
    figure.joint("head:1", kind="rigid")
    figure.group("ends", ["hand", "cone"])
    graph = figure.build()
    rng = np.random.default_rng(0)
    graph = graph.with_positions(graph.x0 + 1e-3 * rng.normal(size=graph.x0.shape))
    prior = scipy.stats.lognorm(0.3, scale=0.5)
    mu = rn.Parameter(
        0.1 + 0.2,
        unit="Pa s",
        bounds=(1e-3, None),
        null=None,
        doc='of "honey"',
        prior=prior,
    )
    g = rn.Parameter(9.80665, unit="m/s^2", null=0.0, kind="shape", doc="here")
    path = rn.smooth_motion(
        T, 0.003 * np.sin(3.0 * T)[:, None] * np.ones(3) + 1e-4 * rng.normal(size=(30, 3))
    )
    turn = rn.smooth_rotation(
        T, scipy.spatial.transform.Rotation.from_rotvec(T[:, None] * [0, 0, 0.2]).as_quat()
    )
    return rn.Robot(
        graph,
        [
            rn.Stretching(),
            rn.Bending(),
            rn.Twisting(),
            rn.ResistiveForce(["cone", "strip"], viscosity=mu),
            rn.ResistiveForce("ring", viscosity=mu, axial_torque=True, length=0.3),
            rn.Gravity(g=g, direction=(0, 0.1, -1)),
            rn.StokesHead(at="head:1", resistance=np.diag([1.0, 1, 2, 0.1, 0.1, 1 / 3])),
            rn.PrescribedMotion(at="cone.end", position=path, orientation=turn),
            rn.Hinge(at=["strip.end"], name="pin"),
            rn.Hinge(at="hand:1", axis=(1, 0, 3), stiffness=0.1, angle=0.3, name="door"),
            rn.CurvatureWave("strip", amplitude=5.0, axis=2),
            rn.PointForce(at="hand.end", force=CubicSpline(T, np.outer(np.sin(T), [0, 0, 1e-4]))),
        ],
        sensors={"speed": rn.robots.flagellated(2, 60.0, edges=2).sensors["speed"]},
    )


def test_a_robot_of_everything_is_the_same_to_the_last_bit(tmp_path):
    robot = zoo()
    again = through_a_file(robot, tmp_path)
    same_robots(robot, again)
    assert again.parameters["drag.viscosity"].prior.mean() == robot.parameters["drag.viscosity"].prior.mean()
    first = (tmp_path / "robot.toml").read_text()
    assert again.save(tmp_path / "again.toml").read_text() == first
    for stepper in ("euler", "sdirk2"):
        runs = [rn.Simulation(r, 5e-3, stepper=stepper).run(0.02) for r in (robot, again)]
        assert np.array_equal(runs[0].state().q, runs[1].state().q)
    assert rn.Simulation(again).observe().sensors["speed"] == 0.0
    changed = robot.with_parameters({"drag.viscosity": 2.0, "strip.E": np.linspace(1e6, 2e6, 4)})
    same_robots(changed, through_a_file(changed, tmp_path))


def test_the_papers_robot(tmp_path):
    robot = rn.robots.flagellated(3, 100.0, edges=4)
    again = through_a_file(robot, tmp_path)
    same_robots(robot, again)
    sim = rn.Simulation(again, 0.01)
    sim.run(0.02)
    assert sim.observe().sensors["head_rpm"] > 0.0


@settings(deadline=None, max_examples=25)
@given(sketches())
def test_random_figures(sketch):
    graph = sketch.draw().graph
    robot = rn.Robot(graph, [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity()])
    same_robots(robot, robot_of(tomllib.loads(toml_text(tables_of(robot)))))


@pytest.mark.parametrize("name", sorted(registry.terms()))
def test_every_term_that_is_installed(name, tmp_path):
    """With its example; functions in it are refused by name, in place of being lost."""
    record = registry.terms()[name]
    graph = curved_rod()
    term = place(record.object, graph, Report(name))
    robot = rn.Robot(graph, [rn.Stretching(name="a"), rn.Bending(name="b"), rn.Twisting(name="c"), term])
    functions = [k for k, v in record.object.example.items() if inspect.isfunction(v)]
    if functions:
        with pytest.raises(rn.RobotFileError, match=f"argument '{functions[0]}'.*which a file cannot hold"):
            robot.save(tmp_path / "robot.toml")
        return
    again = through_a_file(robot, tmp_path)
    same_robots(robot, again)
    runs = [rn.Simulation(r, 1e-3).run(2e-3) for r in (robot, again)]
    assert np.array_equal(runs[0].x, runs[1].x)


def test_splines_are_data(tmp_path):
    graph = curved_rod()
    angle = make_interp_spline(T, np.sin(T), k=5)
    robot = rn.Robot(graph, [rn.Bending(), rn.Twisting(), rn.Stretching(), rn.Motor(at="rod:2", angle=angle)])
    again = through_a_file(robot, tmp_path)
    for t in np.linspace(-0.1, 0.9, 7):
        assert again.terms[-1].angle(t) == angle(t)


HAND = """
format = "rodnet-robot-1"

[[rod]]
name = "arm"
points = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]
edges = 4
material = {E = 1e9}
radius = {start = 2e-3, end = 1e-3}

[[rod]]
name = "fore"
points = ["arm.end", [0.2, 0.0, 0.0]]
edges = 4
material = {E = 1e9, rho = 900}
section = {a = 2e-3, b = 1e-3}

[[joint]]
at = "arm.end"
kind = "hinge"
axis = [0, 1, 0]
stiffness = 1e-3

[[parameter]]
id = "strength"
value = 2
unit = "1"

[[term]]
id = "stretching"
[[term]]
id = "bending"
[[term]]
id = "twisting"
[[term]]
id = "clamp"
at = "arm.start"
[[term]]
id = "point-force"
at = "fore.end"
force = [0, 0, 1e-4]
scale = {shared = "strength"}
"""


def test_a_file_written_by_hand(tmp_path):
    path = tmp_path / "hand.toml"
    path.write_text(HAND)
    robot = rn.Robot.load(path)
    assert robot.graph.radius[:4] == pytest.approx([1.875e-3, 1.625e-3, 1.375e-3, 1.125e-3])
    assert robot.parameters["force.scale"].value == 2.0
    traj = rn.equilibrium(robot)
    assert traj.joint_angle("arm.end")[-1] == pytest.approx(-0.02, rel=1e-2)  # F a / k, upwards


def test_the_files_in_the_documentation(tmp_path):
    """What the page shows is a robot, and its spline a motion."""
    page = (Path(__file__).parents[1] / "docs" / "robot-files.md").read_text()
    first, finger, motion = re.findall(r"```toml\n(.*?)```", page, flags=re.S)
    path = tmp_path / "page.toml"
    path.write_text(first + finger.replace("palm", "hand"))
    assert rn.Robot.load(path).graph.rods["finger"].edges.size == 20
    path.write_text(first)
    robot = rn.Robot.load(path)
    assert robot.parameters["drag.viscosity"].bounds == (0.0, np.inf)
    path.write_text(first.replace("arm.start", "hand.end") + motion)
    moved = rn.Robot.load(path).terms[-2]  # the last is that of the joints
    assert moved.position(1.0, np.zeros((2, 3)), None)[:, 2] == pytest.approx(0.01)
    assert moved.position(2.0, np.zeros((2, 3)), None)[:, 2] == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("rodnet-robot-1", "rodnet-robot-2", "a newer rodnet wrote it"),
        ('format = "rodnet-robot-1"', "", "it should begin with format"),
        ("edges = 4", "edgse = 4", r"\[\[rod\]\] 'arm' has the unknown key edgse \(did you mean edges\?\); known"),
        ('name = "arm"', 'title = "arm"', "unknown key title"),
        ('name = "arm"', "", r"\[\[rod\]\] number 1 has no 'name'; add name = "),
        ("material = {E = 1e9}", "", "'arm' has no material; write"),
        ("material = {E = 1e9}", "material = {Young = 1e6}", "'arm', material has the unknown key Young"),
        ("material = {E = 1e9}", 'material = "steel"', "material = 'steel' must be a table"),
        ("E = 1e9}", "E = -1e6}", "'arm': Material: E = -1000000.0 must be a positive"),
        ("{a = 2e-3, b = 1e-3}", "{a = 2e-3}", "'fore': a section is"),
        ("{a = 2e-3, b = 1e-3}", "{a = 2e-3, b = [1e-3]}", "'fore', section: b = .* must be a number"),
        ("{start = 2e-3, end = 1e-3}", "{from = 2e-3}", "'arm', radius has the unknown key from"),
        ('kind = "hinge"', 'kind = "pin"', "kind must be one of"),
        ('id = "clamp"', 'id = "klamp"', "the id 'klamp' is unknown.*did you mean 'clamp'"),
        ('id = "clamp"', "id = 3", r"\[\[term\]\] number 4: id = 3 must be text"),
        ('id = "clamp"', 'id = "mud"\npackage = "rodnet-mud 0.3"', "pip install rodnet-mud"),
        ('shared = "strength"', 'shared = "strenght"', "id 'strenght'; there are strength"),
        ('shared = "strength"', "shared = [1]", r"no \[\[parameter\]\] with the id \[1\]"),
        ("force = [0, 0, 1e-4]", "", "'point-force': missing a required argument: 'force'; it takes at, force"),
        ("force = [0, 0, 1e-4]", "force = [0, 0]", "'point-force': PointForce: force must be a finite vector"),
        ("scale = {", "scael = {", "no parameter 'scael'.*did you mean scale"),
        ("force = [0, 0, 1e-4]", 'force = {function = "sine"}', "'point-force', force: no function is called 'sine'"),
        ("force = [0, 0, 1e-4]", 'force = {function = ["b-spline"]}', "no function is called"),
        ("force = [0, 0, 1e-4]", 'force = {function = "b-spline", knots = [1]}', "no b-spline: missing"),
        ("[[term]]", "[[term", "not TOML.*line"),
        ("edges = 4", 'edges = "four"', "'arm': edges = 'four' must be a whole number"),
        ("edges = 4", "edges = 1000000000000", "'arm': edges = .* too many"),
        ("radius = {start = 2e-3, end = 1e-3}", 'radius = "thick"', "'arm': radius = 'thick' must be a number, a list"),
        ("radius = {start = 2e-3, end = 1e-3}", 'radius = 2020-01-01', r"rod\[0\].radius = 2020.* is a date"),
        ("edges = 4", 'edges = 4\nclosed = "no"', "'arm': closed = 'no' must be true or false"),
        ("edges = 4", "edges = 4\nnatural_curvature = [[1]]", "'arm': natural_curvature .* shape"),
        ('points = ["arm.end", [0.2, 0.0, 0.0]]', "points = 3", "'fore': points = 3 must be a list of points"),
        ('points = ["arm.end", [0.2, 0.0, 0.0]]', "points = [[0, 1], [2, 3]]", "'fore': points .* must be"),
        ("axis = [0, 1, 0]", 'axis = "y"', r"\[\[joint\]\] 'arm.end': axis = 'y' must be three numbers"),
        ('at = "arm.end"\nkind', "at = 4\nkind", r"\[\[joint\]\] number 1: at = 4 must be text"),
        ("axis = [0, 1, 0]", "axis = [0, 1, 0]\nof = [3]", "of = .* must be text or a list of texts"),
        ("value = 2", 'value = "much"', r"\[\[parameter\]\] 'strength': value = 'much' must be a number"),
        ("value = 2", "value = 2\nbounds = [3]", "'strength': bounds = .* must be a pair"),
        ("value = 2", "value = 2\nbounds = [5, 4]", r"'strength'.*give \(low, high\)"),
        ("value = 2", "value = 2\nkind = 'size'", "'strength'.* kind"),
        ("value = 2", "value = 2\nprior = {args = [1]}", "'strength', prior: distribution = None"),
        ("value = 2", 'value = 2\nprior = {distribution = "norm", args = [1, 2, 3]}', "'strength', prior: norm does"),
        ("[[parameter]]", "[parameter]", "'parameter' must be tables"),
        ("[[rod]]", "[group]\nall = 3\n[[rod]]", r"\[group\]: all = 3 must be a list of texts"),
        ("[[rod]]", '[group]\nall = ["leg"]\n[[rod]]', r"\[group\] 'all': there is no rod 'leg'"),
        ("[[rod]]", '[[body]]\nparts = "arm"\n[[rod]]', r"\[\[body\]\] number 1: .*'arm' is a soft rod"),
        ("[[rod]]", "[shape]\npositions = [[1.0, 2, 3]]\n[[rod]]", "positions must be finite and of shape"),
        ("[[rod]]", "[shape]\npositions = [[1.0], [2.0, 3.0]]\n[[rod]]", "must be rows of three numbers"),
        ("[[rod]]", "[shape]\ndirectors = [[1.0, 0, 0]]\n[[rod]]", "directors needs positions"),
        ("[[rod]]", "[[shape]]\n[[rod]]", "'shape' must be one table"),
        ("[[parameter]]", "[[paramter]]", "the file has the unknown key paramter .did you mean parameter"),
        ("[[rod]]", "[sensor]\ndeep = " + "[" * 5000 + "]" * 5000 + "\n[[rod]]", "nested too deeply"),
        ("[[rod]]", "[sensor]\ndeep = " + "[" * 50 + "]" * 50 + "\n[[rod]]", "'sensor': lists .* nested more than"),
        ("value = 2", "value = 1" + "0" * 400, r"parameter\[0\].value: this whole number is too large"),
        ("value = 2", "value = 1" + "0" * 5000, "a value cannot be read"),
    ],
)  # fmt: skip
def test_files_that_make_no_sense(old, new, message, tmp_path):
    assert old in HAND
    path = tmp_path / "hand.toml"
    path.write_text(HAND.replace(old, new, 1))
    with pytest.raises(rn.RobotFileError, match=message) as caught:
        rn.Robot.load(path)
    assert str(caught.value).startswith(f"'{path}': ")
    assert str(caught.value).count(str(path)) == 1


@pytest.mark.parametrize(
    "function",
    [
        "os:getcwd",
        "os.path:exists",
        ":",
        "rodnet:x",
        "rodnet.cli:main",  # rodnet's own, but of no robot and no term
        "rodnet.files.robot_file:os.system",  # through a module
        "rodnet.terms.loads:np.array",
        "rodnet.terms.loads:as_list",  # of another module than it says
        "rodnet.terms.loads:Gravity",  # not a function
        "rodnet.terms..loads:x",
        "rodnet.terms.loads:",
    ],
)
def test_a_file_calls_no_code_but_that_of_robots_and_terms(function, tmp_path):
    path = tmp_path / "hand.toml"
    path.write_text(HAND + f'\n[sensor]\nx = {{function = "{function}"}}\n')
    with pytest.raises(rn.RobotFileError, match=r"\[sensor\] 'x'"):
        rn.Robot.load(path)
    path.write_text(HAND + '\n[sensor]\nx = {function = "rodnet.robots.flagellated:head_rpm"}\n')
    assert rn.Robot.load(path).sensors["x"] is rn.robots.flagellated(2).sensors["head_rpm"]


def test_a_byte_order_mark_does_no_harm(tmp_path):
    """Editors of Windows write one before the text."""
    path = tmp_path / "hand.toml"
    path.write_text(HAND, encoding="utf-8-sig")
    assert rn.Robot.load(path).graph.rods.keys() == {"arm", "fore"}


class Local(rn.LoadModel):
    """A load of a script's own."""

    def force(self, site, p):
        return 0.0 * site.x


def test_what_a_file_cannot_hold(tmp_path):
    graph = curved_rod()

    def refused(*terms, sensors=None):
        with pytest.raises(rn.RobotFileError) as caught:
            rn.Robot(graph, terms, sensors).save(tmp_path / "robot.toml")
        assert not (tmp_path / "robot.toml").exists()
        return str(caught.value)

    assert "Local is not registered" in refused(Local())
    assert "argument 'force' of term 'force'" in refused(
        rn.PointForce(at="rod.end", force=lambda t: np.ones(3))
    )
    assert "rodnet.smooth_motion" in refused(rn.PointForce(at="rod.end", force=lambda t: np.ones(3)))
    assert "sensor 'height'" in refused(rn.Gravity(), sensors={"height": lambda s: s.x[0, 2]})
    figure = (
        rn.StickFigure().rod("a", [(0, 0, 0), (1, 0, 0)], material=RUBBER, radius=0.01).group("\ud800", ["a"])
    )
    with pytest.raises(rn.RobotFileError, match=r"cannot be written in UTF-8.*ud800"):
        rn.Robot(figure.build(), [rn.Stretching()]).save(tmp_path / "robot.toml")
    odd = rn.Parameter(1.0, unit="m/s^2", prior=object())
    assert "its prior" in refused(rn.Gravity(g=odd))
    with pytest.raises(rn.OutputError, match="cannot read"):
        rn.Robot.load(tmp_path / "nothing.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(rn.RobotFileError, match="not a text file"):
        rn.Robot.load(tmp_path / "binary.toml")


def test_the_command_line_runs_and_sweeps_a_file(tmp_path, monkeypatch):
    from rodnet.cli import app

    monkeypatch.chdir(tmp_path)
    Path("hand.toml").write_text(HAND)

    def call(*arguments):
        done = CliRunner().invoke(app, [*arguments, "--dt", "1e-3", "--json", "--no-progress"])
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            raise done.exception
        return json.loads(done.stdout.splitlines()[-1])

    run = ["run", "hand.toml", "--stepper", "sdirk2", "--set", "arm.E=2e9", "--duration"]
    found = call(*run, "0.02")
    robot = rn.Robot.load("hand.toml").with_parameters({"arm.E": 2e9})
    traj = rn.Trajectory.load("runs/hand/run.nc", robot)
    assert np.array_equal(traj.x[-1], rn.Simulation(robot, 1e-3, stepper="sdirk2").run(0.02).x[-1])
    moved = robot.graph.node_mass @ (traj.x[-1] - traj.x[0]) / robot.graph.node_mass.sum()
    assert found["displacement_mm"] == pytest.approx(1e3 * np.linalg.norm(moved))
    swept = call("sweep", "hand.toml", "--set", "force.scale=1,2", "--duration", "0.005", "--workers", "1")
    moved = [row["displacement_mm"] for row in swept["results"]]
    assert 1.9 < moved[1] / moved[0] < 2.1
    Path("hand.toml").write_text(HAND.replace("rho = 900", "rho = 950"))
    with pytest.raises(rn.ParameterError, match="contents of the file"):
        call(*run, "0.03", "--resume")


def test_numbers_of_numpy_are_numbers_of_the_file(tmp_path):
    fig = rn.StickFigure()
    fig.rod("rod", [(0, 0, 0), (0.1, 0, 0)], edges=4, material=rn.Material(E=1e6, rho=1000.0), radius=1e-3)
    drag = rn.ResistiveForce(viscosity=np.float64(0.5), length=np.float64(0.1), name="drag")
    path = rn.Robot(fig.build(), [rn.Stretching(), rn.Bending(), drag]).save(tmp_path / "robot.toml")
    assert tomllib.loads(path.read_text())
    assert rn.Robot.load(path).parameters["drag.viscosity"].value == 0.5
