"""The adapter: what a scenario becomes, what it scores, and what it refuses."""

import importlib.metadata
from dataclasses import replace

import numpy as np
import pytest

try:
    importlib.metadata.distribution("cosseratbench")
    importlib.metadata.distribution("rodnet-cosseratbench")
except importlib.metadata.PackageNotFoundError as missing:
    pytest.skip(
        f"{missing.name} is not installed: pip install -e plugins/rodnet-cosseratbench",
        allow_module_level=True,
    )

from cosseratbench import registry
from cosseratbench.experiment import run
from cosseratbench.metrics import twist_angles
from cosseratbench.scenario import (
    Cylinder,
    EndCondition,
    Material,
    Motion,
    Plane,
    PointLoad,
    Rod,
    Scenario,
    rotation_matrix,
)
from cosseratbench.solver import Capability, Solver
from rodnet_cosseratbench import RodnetSolver, make_robot
from rodnet_cosseratbench.contacts import corner_cut
from rodnet_cosseratbench.robot import turned, upright

STUFF = Material(youngs_modulus=1e6, shear_modulus=1e6 / 3.0, density=1000.0)
CLAMPED, PINNED = EndCondition.CLAMPED, EndCondition.PINNED
DOWN = (0.0, 0.0, -9.81)


def straight(end=(1.0, 0.0, 0.0), start=(0.0, 0.0, 0.0), radius=0.02, **options):
    return Rod((tuple(start), tuple(end)), radius, STUFF, **options)


def still(*rods, **options):
    return Scenario(tuple(rods), **({"duration": 8.0, "quasi_static": True, "self_contact": False} | options))


def test_the_suite_finds_it():
    solver = registry.load_solver("rodnet", time_step_scale=0.5)
    assert isinstance(solver, RodnetSolver) and isinstance(solver, Solver)
    assert Capability.SHEAR not in solver.capabilities
    experiment = registry.load_experiment("cantilever")
    settings = solver.settings(experiment.scenario, n_elements=20, n_frames=11)
    assert settings["time_step"] == pytest.approx(0.2)  # the next whole fraction of a frame below 0.25 / w


@pytest.mark.parametrize(
    ("name", "score", "floor", "within"),
    [
        ("cantilever", "tip_deflection_error", 4.2e-4, 4.5e-4),
        ("catenary", "shape_error", 4.8e-4, 2e-5),
        ("catenary", "sag_error", 3.8e-4, 2.2e-4),
        ("pendulum", "period_error", 2e-5, 2e-5),
    ],
)
def test_scores_are_near_what_an_exact_rod_would_have(name, score, floor, within):
    """The suite's references neglect something each; the page on the suite says what its floors are."""
    result = run(registry.load_experiment(name), RodnetSolver())
    assert result.outcome == "completed"
    assert result.metrics[score] == pytest.approx(floor, abs=within)


def test_a_swing_keeps_its_size():
    assert abs(run(registry.load_experiment("pendulum"), RodnetSolver()).metrics["amplitude_change"]) < 2e-5


def test_the_first_frame_is_the_initial_shape():
    """Also of a stretched rod along a space curve: positions, directors, and strain."""
    s = np.linspace(0.0, 1.0, 41)
    curve = np.stack([np.sin(2 * s), 1 - np.cos(2 * s), 0.3 * s**2], axis=1)
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    rod = Rod(tuple(map(tuple, curve)), 0.01, STUFF, rest_arc_length=tuple(lengths / 1.02), start=CLAMPED)
    scenario = Scenario((rod,), duration=0.1, self_contact=False)
    shown = RodnetSolver().run(scenario, n_elements=10, n_frames=3)
    assert shown.positions[0][0] == pytest.approx(rod.nodes(10), abs=1e-12)
    assert shown.directors[0][0] == pytest.approx(rod.directors(10), abs=1e-9)
    graph = make_robot(scenario, 10).graph
    assert graph.rest_length == pytest.approx(lengths[-1] / 1.02 / 10, rel=1e-12)
    tangents = np.diff(shown.positions[0][-1], axis=0)
    assert np.abs(np.sum(tangents * shown.directors[0][-1], axis=1)).max() < 1e-12


def test_a_cable_that_starts_as_it_hangs_stays():
    """Stretched by its own weight from the beginning, to the error of the mesh."""
    s = np.linspace(0.0, 1.0, 201)
    strain = STUFF.density * 9.81 / STUFF.youngs_modulus
    z = -(s + strain * (s - 0.5 * s**2))
    cable = Rod(tuple((0.0, 0.0, h) for h in z), 0.002, STUFF, normal=(1.0, 0.0, 0.0),
                start=PINNED, rest_arc_length=tuple(s))  # fmt: skip
    hangs = Scenario((cable,), duration=0.5, gravity=DOWN, self_contact=False)
    shown = RodnetSolver().run(hangs, n_elements=20, n_frames=6)
    assert np.abs(shown.positions[0] - shown.positions[0][0]).max() < 1e-3 * strain


def test_a_driven_clamp_twists_a_rod_by_what_it_turns():
    turn = Motion((0.0, 2.0), ((0.0, 0.0, 0.0),) * 2, ((0.0, 0.0, 0.0), (4.0, 0.0, 0.0)))
    rod = straight(start=(0, 0, 0), end=(1, 0, 0))
    rod = replace(rod, start=CLAMPED, end=CLAMPED, end_motion=turn)
    n = 10
    shown = RodnetSolver().run(still(rod), n_elements=n, n_frames=41)
    twist = twist_angles(shown.positions[0][-1], shown.directors[0][-1])
    assert twist == pytest.approx(4.0 / n, rel=1e-6)  # half an edge at either end


def test_any_shear_modulus_gives_its_torsional_stiffness():
    for shear in (0.1e6, 0.5e6, 3e6):
        rod = replace(straight(), material=replace(STUFF, shear_modulus=shear))
        assert make_robot(still(rod), 4).graph.GJ == pytest.approx(shear * 0.5 * np.pi * 0.02**4, rel=1e-12)


def test_a_tilted_slide_is_the_upright_one_turned():
    """A bent rod whose end slides along an oblique axis, under a pull, with a floor of no effect far below."""
    wave = [(0.05 * k, 0.02 * np.sin(0.7 * k), 0.0) for k in range(21)]
    slide = Motion((0.0, 1.0), ((0.0, 0.0, 0.0), (0.0, 0.0, 0.05)), ((0.0, 0.0, 0.0), (0.5, 0.0, 0.0)),
                   slides_along=(1.0, 0.0, 0.0))  # fmt: skip
    rod = Rod(tuple(wave), 0.01, STUFF, start=CLAMPED, end=CLAMPED, end_motion=slide,
              loads=(PointLoad((0.02, 0.0, 0.0)),))  # fmt: skip
    floor = Plane((0.0, 0.0, -1.0), (0.0, 0.0, 1.0))
    level = still(rod, gravity=(0.0, 0.0, -1.0), obstacles=(floor,), duration=2.0)
    turn = rotation_matrix(np.array([0.4, -0.3, 0.8]))
    tilted_slide = replace(slide, displacement=tuple(tuple(turn @ d) for d in slide.displacement),
                           rotation=tuple(tuple(turn @ r) for r in slide.rotation),
                           slides_along=tuple(turn @ [1.0, 0.0, 0.0]))  # fmt: skip
    v = lambda a: tuple(turn @ np.asarray(a))  # noqa: E731
    tilted = replace(
        level,
        rods=(replace(rod, centerline=tuple(map(v, rod.centerline)), normal=v(rod.normal),
                      end_motion=tilted_slide, loads=(PointLoad(v((0.02, 0.0, 0.0))),)),),
        gravity=v(level.gravity), obstacles=(replace(floor, point=v(floor.point), normal=v(floor.normal)),),
    )  # fmt: skip
    assert upright(level) == pytest.approx(np.eye(3))
    back = turned(tilted, upright(tilted)).rods[0].end_motion
    assert np.count_nonzero(back.slides_along) == 1
    a, b = (RodnetSolver().run(s, n_elements=10, n_frames=21) for s in (level, tilted))
    assert b.positions[0] == pytest.approx(a.positions[0] @ turn.T, abs=1e-7)
    assert b.directors[0] == pytest.approx(a.directors[0] @ turn.T, abs=1e-6)
    end = a.positions[0][:, -1]
    assert end[-1, 1:] == pytest.approx((wave[-1][1], 0.05), abs=1e-12)
    assert abs(end[-1, 0] - end[0, 0]) > 1e-3


def test_a_rod_lies_on_a_floor_and_slides_down_a_steep_one():
    """Rest within the reach of a plane; down a slope with a (sin - mu cos) g, or not at all."""
    for angle, mu, slides in ((0.3, 0.4, False), (0.5, 0.2, True)):
        gravity = (9.81 * np.sin(angle), 0.0, -9.81 * np.cos(angle))
        rod = straight(start=(0, 0, 0.0201), end=(1, 0, 0.0201), friction=mu)
        slope = Plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), friction=0.1)
        scenario = Scenario((rod,), 0.4, gravity, (slope,), self_contact=False)
        x = RodnetSolver().run(scenario, n_elements=6, n_frames=5).positions[0]
        assert 0.02 < x[-1, :, 2].min() and x[-1, :, 2].max() < 0.0202
        way = 0.5 * 9.81 * (np.sin(angle) - mu * np.cos(angle)) * 0.4**2 if slides else 0.0
        assert x[-1, :, 0] - x[0, :, 0] == pytest.approx(way, abs=2e-3)


def test_chords_of_a_circle_are_where_the_formula_says():
    angle = np.linspace(0.0, 1.0, 21)
    circle = 0.1 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    sagitta = 0.1 * (1.0 - np.cos(0.025))
    assert corner_cut(circle) == pytest.approx(sagitta, rel=1e-3)
    assert corner_cut(circle[:3]) == 0.0


def refused(scenario):
    with pytest.raises(NotImplementedError) as error:
        RodnetSolver().run(scenario, n_elements=6, n_frames=3)
    return str(error.value)


def test_what_is_not_covered_is_refused_by_name():
    held = {"start": CLAMPED, "end": CLAMPED}
    still_motion = ((0.0, 0.0, 0.0),) * 2
    slides = [Motion((0.0, 1.0), still_motion, still_motion, slides_along=a) for a in ((1, 0, 0), (1, 1, 0))]
    skew = still(
        replace(straight(), **held, end_motion=slides[0]),
        replace(straight(start=(0, 0, 1), end=(1, 0, 1)), **held, end_motion=slides[1]),
    )
    assert "neither parallel nor normal" in refused(skew)
    apart = straight(), replace(straight(start=(0, 0, 1), end=(1, 0, 1)), friction=0.5)
    assert "different friction" in refused(still(*apart))
    inside = Cylinder((0.5, 0.0, -0.1), (0.0, 1.0, 0.0), 0.095, 1.0)
    assert "begins inside" in refused(still(straight(), obstacles=(inside,)))
    short = Cylinder((0.5, 0.3, -0.05), (0.0, 1.0, 0.0), 0.029, 0.1)
    fell = still(straight(), duration=0.5, gravity=DOWN, obstacles=(short,))
    assert "end of a cylinder" in refused(fell)
