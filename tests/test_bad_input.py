"""Bad input gets a clear error, naming the culprit and the remedy, before any computing."""

from __future__ import annotations

import numpy as np
import pytest

import rodnet as rn

RUBBER = rn.Material(E=1e6)


def figure(**options) -> rn.StickFigure:
    fig = rn.StickFigure()
    fig.rod("arm", [(0, 0, 0), (1, 0, 0)], edges=10, material=RUBBER, radius=0.01, **options)
    return fig


def robot(*terms: rn.Term) -> rn.Robot:
    return rn.Robot(figure().build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), *terms])


def rod(points, **options):
    options = {"material": RUBBER, "radius": 0.01, **options}
    return lambda: rn.StickFigure().rod("arm", points, **options).build()


CASES = {
    "zero length": (rod([(0, 0, 0), (0, 0, 0), (1, 0, 0)]), "'arm'.*zero length.*remove"),
    "coincident": (
        lambda: figure().rod("leg", [(1, 0, 0), (1, 1, 0)], edges=3, material=RUBBER, radius=0.01).build(),
        "'arm:10' and 'leg:0' coincide.*pass the reference",
    ),
    "unknown rod in on": (lambda: robot(rn.Gravity(on="leg*")), "'leg\\*'.*known are: arm"),
    "unknown rod in at": (lambda: robot(rn.Clamp(at="amr.start")), "'amr'.*did you mean 'arm'"),
    "node beyond": (lambda: robot(rn.Hinge(at="arm:11")), "'arm' has nodes 0 to 10"),
    "negative stiffness": (lambda: rn.Material(E=-1.0), "E = -1.0 must be a positive"),
    "negative radius": (rod([(0, 0, 0), (1, 0, 0)], radius=-0.01), "'arm'.*radius = -0.01"),
    "text for a number": (lambda: rn.Material(E="1e6"), "E = '1e6'"),
    "Poisson": (lambda: rn.Material(E=1.0, nu=0.7), "nu = 0.7"),
    "NaN point": (rod([(0, 0, 0), (np.nan, 0, 0)]), "'arm'.*not a finite point"),
    "NaN parameter": (lambda: rn.Gravity(g=np.nan), "'g' = nan is not finite"),
    "NaN force": (lambda: rn.PointForce(at="arm.end", force=(0, 0, np.nan)), "PointForce: force.*finite"),
    "NaN velocity": (
        lambda: rn.Simulation(robot(), velocity=np.full((11, 3), np.nan)),
        "velocity must be finite",
    ),
    "NaN motor": (lambda: rn.Motor(at="arm:3", rpm=np.nan), "'rpm' = nan"),
    "out of bounds": (lambda: rn.ResistiveForce(viscosity=-1.0), "'viscosity' = -1.0.*outside its bounds"),
    "wrong unit": (
        lambda: rn.Gravity(g=rn.Parameter(1.0, unit="Pa s")),
        r"Gravity\.g is in \[m/s\^2\].*\[Pa s\]",
    ),
    "dt zero": (lambda: rn.Simulation(robot(), dt=0.0), "dt = 0.0 must be a positive"),
    "dt negative": (lambda: rn.Simulation(robot(), dt=-1e-3), "dt = -0.001"),
    "duration": (lambda: rn.Simulation(robot()).run(0.0), "duration = 0.0"),
    "motor at an end": (lambda: robot(rn.Motor(at="arm.end", rpm=1.0)), "no spring to drive.*choose a node"),
    "unwritable": (lambda: rn.Simulation(robot()).run(0.1, out="/proc/nowhere/run.nc"), "cannot write"),
    "unknown parameter": (
        lambda: rn.ResistiveForce(viscosty=1.0),
        "no parameter 'viscosty'; it has viscosity",
    ),
    "class for instance": (lambda: rn.Robot(figure().build(), [rn.Bending]), "with brackets"),
    "figure for graph": (lambda: rn.Robot(figure(), []), r"fig\.build\(\)"),
    "prescribed twice": (
        lambda: robot(rn.Clamp(at="arm.start"), rn.Hinge(at="arm.start")),
        "x of arm:0 is prescribed twice, by 'clamp' and by 'hinge'",
    ),
    "illegal name": (lambda: figure().group("a[0]", []), "not a valid name"),
    "name taken": (
        lambda: figure().rod("arm", [(0, 1, 0), (1, 1, 0)], material=RUBBER, radius=0.01),
        "is taken",
    ),
    "folded": (rod([(0, 0, 0), (1, 0, 0), (0.5, 0, 0)]), "'arm' folds back"),
    "nothing soft": (
        lambda: rn.StickFigure().rigid("a", [(0, 0, 0), (1, 0, 0)]).build(),
        "at least one soft rod",
    ),
    "two directions": (rod([(0, 0, 0), (1, 0, 0)], director=(1, 0, 0)), "'arm'.*parallel"),
    "radius and section": (
        rod([(0, 0, 0), (1, 0, 0)], section=rn.circular(0.01)),
        "either radius= or section=",
    ),
    "input without actuator": (
        lambda: rn.Simulation(robot()).step({"motor.rpm": 1.0}),
        "'motor.rpm'.*no actuators",
    ),
    "unknown stepper": (lambda: rn.Simulation(robot(), stepper="rk4"), "'rk4'; known are euler"),
    "constraint that jumps": (
        lambda: rn.Simulation(robot(rn.PrescribedMotion(at="arm.start", position=lambda t: np.ones(3)))),
        "must start at the robot's initial position",
    ),
    "gravity twice": (
        lambda: robot(rn.Gravity(), rn.Gravity(g=1.0)),
        r"Gravity acts twice on 'arm:0'.*keep one.*name='second'",
    ),
    "bending twice, later": (
        lambda: robot().with_terms(rn.Bending(on="arm")),
        "Bending acts twice on 'arm:0-1'",
    ),
    "motor of two speeds": (
        lambda: robot(rn.Motor(at="arm:3", rpm=[1.0, 2.0])),
        "motor 'motor' turns one joint: rpm must be one number",
    ),
    "angle of two numbers": (
        lambda: robot(rn.Motor(at="arm:3", angle=lambda t: np.array([t, t]))),
        "actuator 'motor' must command one number",
    ),
    "no equilibrium": (lambda: rn.equilibrium(robot(rn.Gravity())), "nothing holds.*translation along z"),
}


@pytest.mark.parametrize("case", CASES)
def test_bad_input_is_named(case):
    act, message = CASES[case]
    with pytest.raises(rn.RodnetError, match=f"(?s){message}"):
        act()


def test_what_is_meant_twice_has_a_name():
    tilted = robot(rn.Gravity(), rn.Gravity(g=1.0, direction=(1, 0, 0), name="tilt"), rn.Bending(name="more"))
    assert {"gravity.g", "tilt.g"} <= set(tilted.parameters)


def test_a_force_that_turns_nan_names_the_node(tmp_path):
    force = rn.PointForce(at="arm.end", force=lambda t: (0.0, 0.0, np.nan if t > 0.05 else 0.0))
    sim = rn.Simulation(robot(rn.Clamp(at="arm.start"), force), dt=1e-2)
    with pytest.raises(rn.ConvergenceError, match=r"not a finite number.*arm:10") as caught:
        sim.run(1.0, out=tmp_path / "run.nc")
    assert caught.value.time == pytest.approx(0.05)
    assert len(caught.value.trajectory) == 6
    kept = rn.Trajectory.load(tmp_path / "run.nc")
    assert kept.status == "failed" and kept.t[-1] == pytest.approx(0.05)


def free_rod(**options):
    return rod([(0, 0, 0), (1, 0, 0)], **options)


def block(**options):
    return lambda: figure().rigid("block", ["arm.end", (2, 0, 0)], **options)


def moved(**options):
    return lambda: robot(rn.PrescribedMotion(at="arm.start", **options))


def held(**options):
    options = {"position": lambda t: np.zeros(3), "tangent": lambda t: np.array([1.0, 0, 0]), **options}
    return lambda: robot(rn.Grasp(**options))


NAN = float("nan")
SAMPLES = np.arange(10.0), np.zeros((10, 3))
MORE = {
    # numbers that are none
    "NaN radius": (free_rod(radius=NAN), "'arm'.*radius = nan"),
    "NaN in radii": (free_rod(edges=2, radius=[0.01, NAN]), "'arm'.*radius = .*nan"),
    "infinite radius": (free_rod(radius=np.inf), "'arm'.*radius = inf"),
    "NaN edges": (free_rod(edges=NAN), "'arm': edges = nan must be a positive integer"),
    "half an edge": (free_rod(edges=2.5), "edges = 2.5"),
    "text for edges": (free_rod(edges="3"), "edges = '3'"),
    "no edges": (free_rod(edges=0), "edges = 0"),
    "NaN director": (free_rod(director=(NAN, 0, 1)), "'arm': director.*finite vector"),
    "NaN natural curvature": (free_rod(edges=3, natural_curvature=(NAN, 0)), "'arm': natural curvature"),
    "NaN Poisson": (lambda: rn.Material(E=1.0, nu=NAN), "nu = nan"),
    "NaN section": (lambda: rn.elliptic(NAN, 1e-3), "a = nan"),
    "hollow inside out": (lambda: rn.hollow(1e-3, 2e-3), "inner radius 0.002 m must be smaller"),
    "NaN mass": (block(mass=NAN), "'block': mass = nan must be positive"),
    "negative mass": (block(mass=-1.0), "'block': mass = -1.0"),
    "NaN stiffening": (block(stiffening=(1e2, NAN)), "'block': stiffening = nan"),
    "one stiffening": (block(stiffening=5.0), "'block': stiffening = 5.0 must be a pair"),
    "NaN dt": (lambda: rn.Simulation(robot(), NAN), "dt = nan"),
    "infinite dt": (lambda: rn.Simulation(robot(), np.inf), "dt = inf"),
    "text for dt": (lambda: rn.Simulation(robot(), "0.01"), "dt = '0.01'"),
    "NaN duration": (lambda: rn.Simulation(robot()).run(NAN), "duration = nan"),
    "NaN tolerance": (lambda: rn.Tolerance(residual=NAN), "Tolerance: residual = nan"),
    "negative tolerance": (lambda: rn.Tolerance(update=-1.0), "Tolerance: update = -1.0"),
    "no iterations": (lambda: rn.Tolerance(iterations=0), "Tolerance: iterations = 0"),
    "NaN rho": (lambda: rn.GeneralizedAlpha(NAN), "rho = nan"),
    "save_every": (lambda: rn.Simulation(robot()).run(0.1, save_every=0), "save_every = 0"),
    "velocity of one node": (lambda: rn.Simulation(robot(), velocity=np.zeros(3)), r"shape \(11, 3\)"),
    "NaN input": (
        lambda: rn.Simulation(robot(rn.Motor(at="arm:3", rpm=1.0))).step({"motor.rpm": NAN}),
        "nan is not finite",
    ),
    "NaN parameter path": (
        lambda: robot(rn.Gravity()).with_parameters({"gravity.g": NAN}),
        "nan is not finite",
    ),
    "NaN motor angle": (
        lambda: robot(rn.Motor(at="arm:3", angle=lambda t: NAN)),
        "'motor' commands nan at t = 0",
    ),
    "NaN direction": (lambda: rn.Gravity(direction=(NAN, 0, 1)), "direction"),
    "NaN resistance": (lambda: rn.StokesHead(at="arm.end", resistance=np.full((6, 6), NAN)), "finite 6 x 6"),
    "NaN statics time": (lambda: rn.equilibrium(robot(rn.Clamp(at="arm.start")), t=NAN), "t = nan"),
    "no residual": (lambda: rn.equilibrium(robot(rn.Clamp(at="arm.start")), residual=-1.0), "residual"),
    "NaN positions": (
        lambda: figure().build().with_positions(np.full((11, 3), NAN)),
        "positions must be finite",
    ),
    "NaN noise": (lambda: rn.smooth_motion(*SAMPLES, noise=NAN), "noise = nan"),
    "negative noise": (lambda: rn.smooth_motion(*SAMPLES, noise=-1e-3), "noise = -0.001"),
    "all samples NaN": (lambda: rn.smooth_motion(SAMPLES[0], SAMPLES[1] * NAN), "got 0"),
    # shapes and geometry
    "flat points": (rod([(0, 0), (1, 0)]), r"'arm': \(0, 0\) is not a finite point"),
    "one point": (rod([(0, 0, 0)]), "'arm' needs at least two points"),
    "there and back": (rod([(0, 0, 0), (1, 0, 0), (0, 0, 0)]), "'arm:0' and 'arm:2' coincide"),
    "tiny edge": (rod([(0, 0, 0), (1e-12, 0, 0), (1, 0, 0)]), "'arm' has an edge of zero length"),
    "crossing at a node": (
        lambda: (
            figure().rod("leg", [(0.5, 0, 0), (0.5, 1, 0)], edges=2, material=RUBBER, radius=0.01).build()
        ),
        "'arm:5' and 'leg:0' coincide",
    ),
    "edge drawn twice": (
        lambda: figure().rod("leg", ["arm:3", "arm:4"], material=RUBBER, radius=0.01).build(),
        "'arm' and 'leg' both have an edge between the same two nodes",
    ),
    "too few radii": (free_rod(edges=4, radius=[0.01, 0.02]), "'arm': radius has 2 values for 4 edges"),
    "steel as text": (free_rod(material="steel"), "'arm': material must be a rodnet.Material, got str"),
    "unknown root": (free_rod(root="soft"), "'arm': root must be 'clamped' or 'rigid'"),
    "unknown reference": (rod(["leg.end", (1, 0, 0)]), "there is no rod 'leg' yet"),
    "unknown hub": (lambda: figure().joint("arm:3", hub="leg:0-1"), "'leg:0-1' names no edge"),
    "unknown member": (lambda: figure().group("all", ["leg"]), "'all': there is no rod 'leg'"),
    "positions on one spot": (
        lambda: figure().build().with_positions(np.zeros((11, 3))),
        "positions leave no length",
    ),
    # terms
    "two motors' worth": (lambda: rn.Motor(at="arm:3", rpm=1.0, angle=lambda t: t), "give rpm= or angle="),
    "motor nowhere": (lambda: robot(rn.Motor(rpm=1.0)), "'motor': say where it is"),
    "motor between strangers": (
        lambda: robot(rn.Motor(between=("arm:0-1", "arm:5-6"), rpm=1.0)),
        "no spring joins arm:0-1 and arm:5-6",
    ),
    "motor angle fixed": (lambda: rn.Motor(at="arm:3", angle=3.0), "angle must be a function of time"),
    "clamp on nothing": (lambda: robot(rn.Clamp(at=[])), "'clamp' at .* holds no node"),
    "torque on a node": (lambda: robot(rn.PointTorque(on="arm:3", torque=(0, 0, 1))), "names no edge"),
    "force too short": (lambda: rn.PointForce(at="arm.end", force=lambda t: (1, 2)), r"vector \(3,\)"),
    "motion of two axes": (moved(position=lambda t: np.zeros(2)), "'motion': position"),
    "motion NaN": (moved(position=lambda t: np.full(3, NAN)), "'motion': position must return finite"),
    "no rotation": (
        moved(orientation=lambda t: 2 * np.eye(3)),
        "'motion': orientation must return a rotation",
    ),
    "reflection": (moved(orientation=lambda t: np.diag([1.0, 1, -1])), "'motion': orientation"),
    "quaternion": (moved(orientation=lambda t: np.array([0, 0, 0, 1.0, 0])), "'motion': orientation"),
    "motion of nothing": (
        lambda: rn.PrescribedMotion(at="arm.start"),
        "give position=, orientation= or both",
    ),
    "grasp of a rod": (held(at="arm", twist="free"), "'grasp' must hold one edge"),
    "grasp of no direction": (held(at="arm:0-1", twist="free", tangent=lambda t: np.zeros(3)), "vanishes"),
    "grasp undecided": (held(at="arm:0-1", twist="maybe"), "twist must be 'free' or 'no-spin'"),
    "grasp without end": (held(at="arm:0-1", twist="no-spin"), "needs duration="),
    "drag of nothing": (lambda: rn.ResistiveForce(), "give viscosity=, or both"),
    "half a drag": (lambda: rn.ResistiveForce(eta_t=1.0), "both eta_t= and eta_n="),
    "stubby": (lambda: robot(rn.ResistiveForce(viscosity=1.0, length=1e-3)), "'arm:0-1' is not slender"),
    "head of no size": (lambda: rn.StokesHead(at="arm.end", viscosity=1.0), "give viscosity= and radius="),
    "head off its edge": (
        lambda: robot(rn.StokesHead(at="arm.end", resistance=np.eye(6), edge="arm:0-1")),
        "'arm:0-1' does not end at 'arm.end'",
    ),
    "clamped twice": (
        lambda: robot(rn.Clamp(at="arm.start"), rn.Clamp(at="arm.start")),
        "'arm:0' is clamped twice",
    ),
    "dead sensor": (
        lambda: rn.Robot(figure().build(), [], {"speed": 3.0}),
        "sensor 'speed' must be a function",
    ),
    "unknown path": (
        lambda: robot(rn.Gravity()).with_parameters({"gravity.h": 1.0}),
        "'gravity.h'; did you mean 'gravity.g'. there are",
    ),
    "stiffness below zero": (lambda: robot().with_parameters({"arm.E": -1.0}), "-1.0"),
    "half a tail": (lambda: rn.robots.flagellated(2.5), "n_tails = 2.5"),
    "tails of no length": (lambda: rn.robots.flagellated(2, L3=0.0), "L3 = 0.0 must be positive"),
    # what beginners write
    "a number for a selector": (lambda: rn.Gravity(9.81), r"9.81 names no part of a robot; write 'arm'"),
    "a vector for g": (
        lambda: robot(rn.Gravity(g=(0, 0, 9.81))),
        "'g' of Gravity has 3 values for 11 sites; give one",
    ),
    "positional": (lambda: rn.Motor("arm:3", rpm=3.0), "Motor: too many positional arguments; it takes at="),
    "law without its own init": (
        lambda: rn.Stretching("arm", 3),
        "Stretching: too many positional arguments",
    ),
    "one term": (
        lambda: rn.Robot(figure().build(), rn.Bending()),
        r"a list of terms, also of one: .*\[Bending",
    ),
    "terms by name": (lambda: rn.Robot(figure().build(), "bending"), "a list of terms"),
    "sensors in a list": (lambda: rn.Robot(figure().build(), [], [len]), "functions by name"),
    "a figure is no robot": (lambda: rn.Simulation(figure()), "Simulation needs a Robot, got StickFigure"),
    "a graph is no robot": (lambda: rn.equilibrium(figure().build()), "needs a Robot, got RodGraph"),
    "dt in a list": (lambda: rn.Simulation(robot(), [0.01]), r"dt = \[0.01\] must be a positive"),
    "duration as text": (lambda: rn.Simulation(robot()).run("5"), "duration = '5' must be a positive time"),
    "inputs without names": (lambda: rn.Simulation(robot()).step(3.0), "inputs are values by name"),
    "one number for points": (rod(3), "'arm' needs at least two points, a list"),
    "words for a point": (rod([("a", "b", "c"), (1, 0, 0)]), "'arm'.*is not a finite point"),
    "radius with a unit": (free_rod(radius="2mm"), "'arm': radius = '2mm' must be a number"),
    "radii in rows": (free_rod(radius=[[0.01]]), r"radius has shape \(1, 1\)"),
    "edges in a list": (free_rod(edges=[3]), r"edges = \[3\] must be a positive integer"),
    "a million edges": (free_rod(edges=2_000_000), "too many; a rod may have 1,000,000"),
    "Poisson as text": (lambda: rn.Material(E=1.0, nu="0.5"), "nu = '0.5' must lie"),
    "mass as text": (lambda: rn.StickFigure().rigid("h", [(0, 0, 0), (1, 0, 0)], mass="1"), "mass = '1'"),
    "curvature of one number": (
        free_rod(edges=3, natural_curvature=[[1.0]]),
        "natural_curvature needs shape",
    ),
    "at without its name": (lambda: rn.Clamp("arm.start"), "Clamp: too many positional.*it takes at="),
    "at misspelt": (lambda: rn.Clamp(att="arm.start"), r"required argument: 'at'.*did you mean at=\?"),
    "no force": (lambda: rn.PointForce(at="arm.end"), "PointForce: missing a required argument: 'force'"),
    "parameter misspelt": (
        lambda: rn.Gravity(gee=1.0),
        r"no parameter 'gee'; it has g, .* takes on, direction",
    ),
    "path misspelt": (
        lambda: robot().with_parameters({"arm.e": 1.0}),
        r"no parameter 'arm.e'; did you mean 'arm.E'\? there are arm.E",
    ),
    "unknown rod": (lambda: robot().graph.rods["leg"], "there is no rod 'leg'; there are arm"),
    "unknown parameter path": (
        lambda: robot().parameters["arm.e"],
        "no parameter 'arm.e'; did you mean 'arm.E'",
    ),
    "unknown sensor": (
        lambda: rn.Simulation(robot()).observe().sensors["v"],
        "no sensor 'v'; there are none",
    ),
    "bounds of one number": (lambda: rn.Parameter(1.0, bounds=(3,)), r"give \(low, high\)"),
    "bounds the wrong way": (lambda: rn.Parameter(1.0, name="c", bounds=(2, 1)), "bounds of parameter 'c'"),
    "a parameter without a name": (
        lambda: rn.Parameter("x", unit="Pa"),
        r"^a parameter must be a number in \[Pa\]",
    ),
    # files
    "output is a directory": (
        lambda: rn.Simulation(robot()).run(0.1, out="/tmp"),
        "'/tmp': it is a directory",
    ),
    "output below a file": (
        lambda: rn.Simulation(robot()).run(0.1, out="/etc/hostname/run.nc"),
        "cannot write '/etc/hostname/run.nc'",
    ),
}


@pytest.mark.parametrize("case", MORE)
def test_more_bad_input_is_named(case):
    act, message = MORE[case]
    with pytest.raises(rn.RodnetError, match=f"(?s){message}"):
        act()


def test_nothing_is_computed_before_the_output_is_known_to_be_writable(tmp_path):
    steps = []
    watched = rn.Robot(figure().build(), [rn.Bending()], sensors={"t": lambda s: steps.append(s.t)})
    with pytest.raises(rn.OutputError):
        rn.Simulation(watched).run(1.0, out=tmp_path)
    assert not steps


def test_wrong_names_in_results_list_the_right_ones():
    traj = rn.Simulation(robot(rn.Clamp(at="arm.start"))).run(0.02)
    for table, name, message in (
        (traj.rods, "leg", "no rod 'leg'; there are arm"),
        (traj.energies, "bend", r"no term 'bend'; did you mean 'bending'\?"),
        (traj.powers, "drag", "no term 'drag'; there are "),
        (traj.reactions, "clam", r"did you mean 'clamp'\?"),
        (traj.events, "turn", "no event 'turn'; there are none"),
    ):
        with pytest.raises(KeyError, match=message) as caught:
            table[name]
        assert isinstance(caught.value, rn.RodnetError)
        assert name not in table and table.get(name) is None


def test_a_figure_says_what_is_drawn():
    fig = figure().rigid("head", ["arm.start", (-0.1, 0, 0)])
    assert repr(fig) == "StickFigure(rod arm; stiff part head; 12 nodes; build() makes the graph)"
    assert repr(rn.StickFigure()) == "StickFigure(empty; 0 nodes; build() makes the graph)"
