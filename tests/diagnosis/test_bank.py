"""Every candidate is the identity at its null value, has a derivative there, and can be stored."""

from __future__ import annotations

import functools
import json
import pickle

import numpy as np
import pytest

import rodnet as rn
from rodnet import built_in, registry
from rodnet.diagnosis.candidate import as_family, candidates
from tests.diagnosis.bank_robots import ROBOTS, instruments
from tests.tangent import whole_runs as wr

DURATION = 0.06
OURS = [name for name in built_in.CANDIDATES]
# a law of drag is replaced, and computes in another order of operations
TO_ROUND_OFF = {"neighbours"}
# where the quotient is of a law that is far from linear within its step
LOOSE = {"joint-compliance": 1e-3, "axial-drag": 1e-3}
SHORT = {"joint-compliance": 1e-4}  # beside a rigid part the spring is gone at once


@functools.cache
def bank(name):
    """Candidates of a robot by family."""
    robot, _ = ROBOTS[name]()
    found = {}
    for one in candidates(robot, instruments(robot)):
        found.setdefault(one.family, []).append(one)
    return found


@functools.cache
def plain_run(name):
    robot, options = ROBOTS[name]()
    return rn.Simulation(robot, **options).run(DURATION)


def having(family):
    """Robots that can have a candidate, with the first of them."""
    return [(name, bank(name)[family][0]) for name in ROBOTS if family in bank(name)]


@pytest.mark.parametrize("family", OURS)
def test_it_is_the_identity_at_its_null_value(family):
    cases = having(family)
    assert cases, "no robot of the tests can have it"
    for name, one in cases[-2:]:
        robot, options = ROBOTS[name]()
        built = one.build(robot)
        nulls = one.nulls(built, instruments(robot))
        for path, null in nulls.items():
            if not one.observe:
                assert built.parameters[path].value == null, path
                assert built.parameters[path].doc and built.parameters[path].unit
        edited, plain = rn.Simulation(built, **options).run(DURATION), plain_run(name)
        for a, b in ((edited.x, plain.x), (edited.v, plain.v), (edited.theta, plain.theta)):
            if family in TO_ROUND_OFF:
                assert np.abs(a - b).max() <= 1e-9 * np.abs(b).max()
            else:
                np.testing.assert_array_equal(a, b)
        if not one.observe and one.build(robot) is not robot:
            again = one.build(built)
            assert again is None or again.parameters.keys() == built.parameters.keys(), "it is added once"


def quotient(robot, paths, null, step, bounds, options):
    """Difference quotient of whole runs by one strength, on the side that its bounds allow."""

    def run(change):
        return wr.last(robot.with_parameters(dict.fromkeys(paths, null + change)), DURATION, **options)

    if null - 2.0 * step >= bounds[0] and null + 2.0 * step <= bounds[1]:
        return wr.quotient(run, step)
    if null + 4.0 * step > bounds[1]:
        step = -step
    f = [run(k * step) for k in range(5)]
    return (-25.0 * f[0] + 48.0 * f[1] - 36.0 * f[2] + 16.0 * f[3] - 3.0 * f[4]) / (12.0 * step)


@pytest.mark.parametrize(
    "family",
    [name for name in OURS if registry.candidates()[name].object.group not in ("observation", "marker")],
)
def test_its_derivative_at_the_null_value_is_that_of_whole_runs(family):
    moves = 0.0
    for name, one in having(family):
        robot, options = ROBOTS[name]()
        built = one.build(robot)
        scales = one.scales(built, DURATION)
        found = rn.sensitivities(
            built, DURATION, parameters=scales, save_every=10**6, tolerance=wr.ROUND_OFF, **options
        )
        end = wr.at_end(found)
        for c, (path, scale) in enumerate(scales.items()):
            p = built.parameters[path]
            assert scale > 0.0
            step = SHORT.get(family, 1e-3) * scale
            expected = quotient(built, [path], p.null, step, p.bounds, options)
            size = np.abs(expected).max()
            if size * scale < 1e-12:  # nothing but round-off: it moves another robot
                assert np.abs(end[:, c]).max() * scale < 1e-10
                continue
            moves = max(moves, size * scale)
            assert wr.error(end[:, c], expected, wr.parts(robot)) < LOOSE.get(family, 1e-5), (name, path)
        if moves:
            break
    assert moves > 0.0, "it moves none of the robots"


@pytest.mark.parametrize("family", OURS)
def test_it_can_be_stored_and_sent(family, tmp_path):
    name, one = having(family)[0]
    robot, options = ROBOTS[name]()
    sent = pickle.loads(pickle.dumps(one))
    assert (sent.id, sent.paths, sent.falsifier) == (one.id, one.paths, one.falsifier)
    built = sent.build(robot)
    assert sent.values(built, 5.0) == one.values(built, 5.0) and sent.scales(built, 5.0, instruments(robot))
    for path, values in one.values(built, 5.0).items():
        assert (
            path in one.shape
            and built.with_parameters({path: values[0]})
            and built.with_parameters({path: values[-1]})
        )
    if one.observe:
        return
    strong = built.with_parameters({k: p.null + s for (k, p), s in zip(
        ((k, built.parameters[k]) for k in one.strength), one.scales(built, 5.0).values(), strict=True)})  # fmt: skip
    loaded = rn.Robot.load(strong.save(tmp_path / "robot.toml"))
    assert list(loaded.parameters) == list(strong.parameters)
    a, b = (rn.Simulation(r, **options).run(0.03) for r in (strong, loaded))
    np.testing.assert_array_equal(a.x, b.x)
    changed, plain = pickle.loads(pickle.dumps(strong)), rn.Simulation(robot, **options).run(0.03)
    np.testing.assert_array_equal(rn.Simulation(changed, **options).run(0.03).x, a.x)
    assert plain.x.shape == a.x.shape


def test_the_command_lists_them_with_parameters(tmp_path):
    from typer.testing import CliRunner

    from rodnet.cli import app

    out = CliRunner().invoke(app, ["terms", "--candidates"]).output
    for name in OURS:
        record = registry.candidates()[name]
        assert record.summary in out and record.object.falsifier
        for p in record.parameters:
            assert f"- {p.name} [{p.unit}]" in out, (name, p)
    machine = json.loads(CliRunner().invoke(app, ["terms", "--candidates", "--json"]).stdout)["terms"]
    (defect,) = [t for t in machine if t["id"] == "stiffness-defect"]
    assert (defect["kind"], defect["group"]) == ("candidate", "rod")
    assert [p["name"] for p in defect["parameters"]] == ["loss", "place", "width", "twist"]
    assert defect["parameters"][0]["null"] == 0.0


def test_every_installed_term_that_vanishes_is_one(tmp_path):
    """Of plug-ins, with parameters that stand at their null values; what needs arguments is not."""
    records = registry.candidates()
    assert {"quadratic", "jamming", "grain-yield"} <= set(records)
    assert not {"granular-force", "point-force", "consistent-mass", "curvature-wave", "clamp"} & set(records)
    robot, _ = ROBOTS["swimmer"]()
    (one,) = candidates(robot, only=["quadratic"])
    assert one.nulls(one.build(robot)) == {"quadratic.c": 0.0}


def test_what_was_accepted_is_not_offered_again():
    robot, _ = ROBOTS["swimmer"]()
    (one,) = candidates(robot, only=["yield"])
    assert one.id == "yield" and candidates(one.build(robot), only=["yield"]) == []
    names = [c.id for c in candidates(robot, only=["stiffness-defect"])]
    assert names == ["stiffness-defect@tail0", "stiffness-defect@tail1"]
    assert [c.id for c in candidates(robot, only=["stiffness-defect@tail1"])] == names[1:]


def test_bad_candidates_are_named():
    from rodnet.diagnosis.candidate import Candidate

    robot, _ = ROBOTS["swimmer"]()
    with pytest.raises(rn.CaseError, match="no candidate is called 'yeild'; did you mean"):
        candidates(robot, only=["yeild"])
    with pytest.raises(rn.CaseError, match="its group is 'magic'; groups are medium"):
        Candidate("x", "x", "magic", lambda r: r, ("a.b",), "x")
    with pytest.raises(rn.CaseError, match="'x' has no strength"):
        Candidate("x", "x", "rod", lambda r: r, (), "x")
    with pytest.raises(rn.CaseError, match="'x' is no candidate: give a Candidate"):
        as_family("x", 3)
    lost = Candidate("x", "x", "medium", lambda r: r, ("drag.tangent",), "x")
    with pytest.raises(rn.ParameterError, match=r"no parameter 'drag\.tangent'"):
        lost.nulls(robot)


def test_damping_by_mass_is_no_explanation_of_its_own_in_a_viscous_medium():
    """There it is another ratio of the drag along rods to that across them."""
    assert "mass-damping" in bank("cable") and "mass-damping" not in bank("arm")
    fig = rn.StickFigure()
    material = rn.Material(E=1e6, nu=0.4, rho=1000.0)
    fig.rod("rod", [(0, 0, 0), (0.2, 0.0, 0.1)], edges=8, material=material, radius=4e-3)
    graph, line = fig.build(), 1000.0 * np.pi * 4e-3**2
    elastic = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), rn.Clamp(at="rod.start")]
    ends = [
        rn.Simulation(rn.Robot(graph, [*elastic, *terms]), 0.01, stepper="sdirk2").run(0.3).x[-1]
        for terms in (
            [rn.ResistiveForce(eta_t=1.0, eta_n=2.0), rn.MassDamping(rate=20.0)],
            [rn.ResistiveForce(eta_t=1.0 + 20.0 * line, eta_n=2.0 + 20.0 * line)],
            [rn.ResistiveForce(eta_t=1.0, eta_n=2.0)],
        )
    ]
    assert np.abs(ends[0] - ends[1]).max() < 1e-2 * np.abs(ends[0] - ends[2]).max()


class Wind(rn.DragModel):
    """A wind from somewhere, and grains that hold."""

    default_name = "wind"
    claims = frozenset()
    speed = rn.Parameter(np.array([1.0, 0.0, 0.0]), unit="m/s", null=0.0, doc="of the wind")
    strength = rn.Parameter(2.0, unit="Pa s", bounds=(0, None), null=0.0, doc="of the grains")

    def force(self, site, p):
        return -p.strength * (site.v - p.speed)


def test_of_a_law_with_a_strength_of_many_values_the_others_are_tried():
    """A vector is not one number to fit: it stays at its null value; a candidate of its own may say what to fit."""
    robot, _ = ROBOTS["held"]()
    (one, *_) = as_family("wind", Wind)(robot, [])
    assert one.strength == ("wind.strength",)
    built = one.build(robot)
    np.testing.assert_array_equal(built.parameters["wind.speed"].value, np.zeros(3))
    assert one.scales(built, 1.0)["wind.strength"] == pytest.approx(0.2)
