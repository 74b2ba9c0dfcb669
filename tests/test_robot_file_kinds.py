"""Every kind of thing that a robot can be made of goes through a file unchanged, and runs alike."""

import sys
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import rodnet as rn
from rodnet import registry
from rodnet.files.robot_file import robot_of, tables_of
from rodnet.files.toml_text import toml_text
from rodnet.runs import RunSpec, execute
from tests.same_robots import same_robots, through_a_file

RUBBER = rn.Material(E=1e6, nu=0.4, rho=1100.0)
PARTS = ("weld", "rigid", "hinge", "elastic", "ball", "stiff")
FLOWS = (
    None,
    rn.UniformFlow((0.1, 0.0, 1 / 3)),
    rn.ShearFlow(rate=0.7, along=(1, 0, 0), across=(0, 0, 1)),
    rn.VortexFlow(circulation=0.3, core=0.02, centre=(0.1, 1 / 3, 0)),
)
MU = {"viscosity": 0.1 + 0.2}
MEDIA = (
    lambda flow: rn.ResistiveForce(**MU, flow=flow, axial_torque=flow is None),
    lambda flow: rn.GranularForce(surface=0.3, CF=1e3, CS=3e3, gamma=1 / 7),
    lambda flow: rn.PowerLawForce(zeta_t=1.1, zeta_n=2.2, viscosity=1.7, rate=9.0, exponent=0.6, flow=flow),
    lambda flow: rn.BinghamForce(zeta_t=2.0, zeta_n=3.0, viscosity=0.3, yield_stress=1 / 3),
    lambda flow: rn.PlaneWallForce(point=(0, 0, -0.5), **MU),
    lambda flow: rn.TubeForce(tube_radius=0.9, point=(0, 0, 0.01), axis=(1, 0.1, 0), **MU),
    lambda flow: rn.CrowdedForce(crowding=0.7, range=0.3, **MU),
    lambda flow: rn.AddedMass(),
)
OTHERS = (
    lambda: rn.KelvinVoigt(stretch=0.01, bend=1 / 3, on="arm*"),
    lambda: rn.MassDamping(rate=0.7),
    lambda: rn.DryFriction(moment=0.01, curvature=5.0, on="arm0"),
    lambda: rn.DryFriction(moment=0.01, pull={"arm0": (0.3, -1.0)}, rubs=False, name="strands"),
    lambda: rn.PlaneContact((0, 0, -0.2), (0, 0.1, 1), friction=0.3, on="arm*"),
    lambda: rn.TubeContact(((-1, 0, 0), (1, 0.1, 0)), 0.8, friction=0.2),
    lambda: rn.RodContact("arm*", reach=1e-5),
    lambda: rn.Tendon(route=[("arm0", (0.0, 3e-3)), (0.0, 0.3, 0.4)], tension=1 / 3, friction=0.2),
    lambda: rn.Tendon(route=["arm0.start", ("arm0.end", (1e-3, 2e-3, 0.0))], pull=1e-3, stiffness=9.0),
    lambda: rn.SlowCurvature(on="arm0", curvature=8.0, time_constant=0.01, release=0.03),
    lambda: rn.CurvatureWave("arm0", amplitude=5.0),
    lambda: rn.FollowerForce(at="arm0.end", force=(1e-3, 0, 1e-4)),
    lambda: rn.Gravity(direction=(0, 1, -3), fluid_density=900.0),
)


def mesh_head() -> rn.Term:
    """A head whose resistance comes from its surface."""
    import trimesh

    egg = trimesh.creation.icosphere(subdivisions=1, radius=0.02)
    egg.apply_scale((1.5, 1.0, 0.8))
    return rn.StokesHead(at="head.start", edge="head:0-1", shape=rn.stokes_resistance(egg), viscosity=0.3)


HEAD = mesh_head()


@st.composite
def robots(draw):
    """A head with limbs of every kind, joined in every way, in any of the media."""
    chance = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    roots = draw(st.lists(st.sampled_from(PARTS), min_size=1, max_size=3))
    fig = rn.StickFigure()
    fig.rigid("head", [(0.1, 0, 0), (0.05, 0, 0)], radius=0.01)
    fig.rigid("neck", ["head.end", (0, 0, 0)])
    for k, root in enumerate(roots):
        angle = 2.0 * np.pi * k / len(roots)
        side = np.array([-0.5, np.cos(angle), np.sin(angle)])
        fig.rigid(f"hip{k}", ["neck.end", 0.02 * side])
        size = chance.uniform(1e-3, 4e-3)
        shape = [{"radius": size}, {"radius": rn.Taper(size, 1e-3)}, {"section": rn.elliptic(size, 1e-3)}][k]
        natural = [{}, {"natural": "straight"}, {"natural_curvature": (1 / 3, 2.0), "natural_twist": 0.1}]
        fig.rod(f"arm{k}", [f"hip{k}.end", chance.uniform(0.05, 0.1) * side], edges=draw(st.integers(1, 4)),
                material=RUBBER, **shape, **natural[chance.integers(3)])  # fmt: skip
        about = {
            "hinge": {"axis": chance.normal(size=3), "stiffness": 0.01, "angle": 0.2},
            "ball": {},
            "rigid": {},
        }
        about |= {"elastic": {"stiffness": (0.1, 1 / 3), "axis": chance.normal(size=3)}}
        if root in about:
            fig.joint(f"hip{k}.end", kind=root, **about[root])
    if draw(st.booleans()):
        inertia = Rotation.random(random_state=int(chance.integers(1000))).as_matrix()
        inertia = inertia @ np.diag([1e-5, 2e-5, 2.5e-5]) @ inertia.T
        fig.body("head", mass=0.03, com=(0.07, 1e-3, 0), inertia=0.5 * (inertia + inertia.T))
    fig.group("limbs", [f"arm{k}" for k in range(len(roots))])
    graph = fig.build()
    if draw(st.booleans()):  # bent, or turned as a whole where a rigid body must keep its shape
        turn = Rotation.from_rotvec(chance.normal(size=3)).as_matrix()
        twice = graph.with_positions(graph.x0 @ turn.T)
        graph = twice.with_positions(twice.x0 + np.array([0.1, 1 / 3, 0.0]))
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting()]
    terms += [draw(st.sampled_from(MEDIA))(draw(st.sampled_from(FLOWS)))]
    chosen = draw(st.lists(st.sampled_from(range(len(OTHERS))), max_size=3, unique=True))
    terms += [OTHERS[k]() for k in chosen] + ([HEAD] if draw(st.booleans()) else [])
    shared = rn.Parameter(chance.uniform(), unit="Pa s", bounds=(0, None), doc="shared")
    if draw(st.booleans()):
        terms += [rn.ResistiveForce(f"arm{k}", viscosity=shared, name=f"skin{k}") for k in range(len(roots))]
    try:
        return rn.Robot(graph, terms)
    except rn.RodnetError:  # what does not go together: a term that has no site, rods that would touch
        return rn.Robot(graph, terms[:3])


@settings(deadline=None, max_examples=40)
@given(robots())
def test_robots_of_every_kind(robot):
    text = toml_text(tables_of(robot))
    again = robot_of(tomllib.loads(text))
    same_robots(robot, again)
    assert toml_text(tables_of(again)) == text


def everything(body: bool) -> rn.Robot:
    """Media, tendons, a head from a mesh, a hinge, and a rigid body or contact, which do not go together."""
    fig = rn.StickFigure()
    fig.rigid("head", [(0.1, 0, 0), (0.05, 0, 0)], radius=0.01)
    fig.rigid("neck", ["head.end", (0, 0, 0)])
    if body:
        fig.body("head", mass=0.03, com=(0.08, 0, 0), inertia=(1e-5, 2e-5, 2e-5))
    for k, y in enumerate((0.02, -0.02)):
        fig.rigid(f"hip{k}", ["neck.end", (0, y, 0)])
        fig.rod(f"arm{k}", [f"hip{k}.end", (-0.1, y, 0)], edges=4, material=RUBBER, radius=3e-3)
    fig.joint("hip0.end", kind="hinge", axis=(0, 0, 1), stiffness=1e-3)
    graph = fig.build()
    graph = graph.with_positions(graph.x0 @ Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix().T)
    more = [MEDIA[0](FLOWS[2]), HEAD, *(OTHERS[k]() for k in (0, 2, 6, 11, *(() if body else (3, 5))))]
    return rn.Robot(graph, [rn.Stretching(), rn.Bending(), rn.Twisting(), *more])


@pytest.mark.parametrize("body", [True, False])
def test_the_command_runs_a_file_with_everything(body, tmp_path):
    robot = everything(body)
    same_robots(robot, through_a_file(robot, tmp_path))
    spec = RunSpec(str(tmp_path / "robot.toml"), duration=0.01, dt=2e-3, stepper="sdirk2")
    found = execute(spec, tmp_path / "out", progress=False)
    sim = rn.Simulation(robot, 2e-3, stepper="sdirk2")
    sim.run(until=0.01)
    assert np.array_equal(found.trajectory.state(-1).q, sim.state.q)
    assert not np.array_equal(sim.state.q, rn.Simulation(robot, 2e-3).state.q)


@pytest.fixture
def jamming(monkeypatch):
    """The plug-in of grains that jam, as if it were installed."""
    before = set(sys.modules)
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "plugins" / "rodnet-jamming")
    points = {
        "rodnet.terms": {"jamming": "rodnet_jamming:Jamming", "grain-yield": "rodnet_jamming:Yielding"},
        "rodnet.robots": {"jamming": "rodnet_jamming:jamming_robot"},
    }
    found = lambda group: [EntryPoint(k, v, group) for k, v in points.get(group, {}).items()]  # noqa: E731
    monkeypatch.setattr(registry, "entry_points", found)
    caches = (registry._entry_points, registry._load, registry._all)
    for cache in caches:
        cache.cache_clear()
    yield
    monkeypatch.undo()
    for cache in caches:
        cache.cache_clear()
    for name in set(sys.modules) - before:
        if name.partition(".")[0] == "rodnet_jamming":
            del sys.modules[name]


def test_a_plug_in_with_memory(jamming, tmp_path):
    robot = registry.robot("jamming")(2, edges=3)
    again = through_a_file(robot, tmp_path)
    same_robots(robot, again)
    runs = [rn.Simulation(r, 0.01).run(0.05) for r in (robot, again)]
    assert np.array_equal(runs[0].x, runs[1].x)
    for cache in (registry._entry_points, registry._load, registry._all):
        cache.cache_clear()
    registry.entry_points = lambda group: []
    with pytest.raises(
        rn.RobotFileError, match=r"'jam': the id 'jamming' is unknown.*not installed: pip install"
    ):
        rn.Robot.load(tmp_path / "robot.toml")
