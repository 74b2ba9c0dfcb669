"""The benchmarks measure what they say: no times are asserted here, but that all codes fall alike is."""

import json
import platform
from types import SimpleNamespace

import numpy as np
import pytest

import rodnet as rn
from benchmarks import cases, figures, modes, process, report, rivals, run, scenes, timing, yardstick
from benchmarks.cases import accuracy, drafted, iteration, laws


@pytest.fixture
def clock():
    return timing.Clock()


def test_yardstick_solves_its_system():
    banded = yardstick.Banded(37)
    dense = np.zeros((37, 37))
    for i in range(37):
        for j in range(max(0, i - yardstick.BAND), min(37, i + yardstick.BAND + 1)):
            dense[i, j] = banded.bands[i, j - i + yardstick.BAND]
    np.testing.assert_allclose(dense @ banded.solution(), banded.b, atol=1e-12)


def test_contenders_take_turns(clock):
    order = []
    contenders = {name: lambda name=name: lambda: order.append(name) for name in "abc"}
    rounds = timing.interleave(contenders, 3, clock)
    assert "".join(order) == "abc" + "abc" + "cba" + "abc"
    assert all(len(r.seconds) == 3 for r in rounds.values())


def test_ratios_are_formed_within_rounds():
    assert timing.ratio([1.0, 4.0, 9.0], [1.0, 2.0, 3.0]) == {"median": 2.0, "min": 1.0, "max": 3.0}


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"),
        (0.012345, "0.0123"),
        (123.4, "123"),
        (3.0, "3"),
        (2.5e-6, "2.5e-6"),
        ("none", "none"),
        ({"median": 2.0, "min": 1.0, "max": 3.0}, "2 (1–3)"),
    ],
)
def test_cells(value, text):
    assert report.cell(value) == text


def test_demands_know_their_direction():
    assert cases.Demand("speed", 8.0, 9.0, least=True).met
    assert not cases.Demand("time", 8.0, 9.0).met
    assert not cases.Demand("time", 8.0, None).met
    assert not cases.Demand("time", 8.0, float("nan")).met


# -- what is simulated -----------------------------------------------------------------------
def test_users_laws_are_the_built_in_one():
    ends = {}
    for name, robot in laws.robots().items():
        sim = modes.simulate(robot, 0.01)
        modes.advance(sim, 0.2)
        ends[name] = sim.state.q
    for name in laws.LAWS:
        np.testing.assert_allclose(ends[name], ends["built in"], atol=1e-7)
    rn.testing.check_term(laws.Compiled)


def test_tree_and_net_are_what_they_are_called():
    tree = scenes.tree(500).graph
    assert tree.edge_count == tree.node_count - 1
    assert np.bincount(tree.edges.ravel()).max() == 3
    net = scenes.grid(4)
    assert (net.graph.node_count, net.graph.edge_count) == (16, 24)
    assert rn.equilibrium(net).x[-1][:, 2].min() < -1e-6


@pytest.mark.parametrize("mode", modes.MODES, ids=lambda mode: mode.name)
def test_modes_reach_the_same_tip(mode):
    sim = modes.simulate(scenes.cantilever(20), 1e-3, mode)
    done = modes.advance(sim, 0.1)
    assert sim.t == pytest.approx(0.1)
    assert min(done) > 0
    fallen = 0.5 * scenes.GRAVITY * sim.t**2  # the clamp is not felt at the tip yet
    assert scenes.tip(sim)[2] == pytest.approx(-fallen, abs=1e-3)


def _rival(name):
    found, missing = rivals.load((name,))
    if missing:
        pytest.skip(": ".join(*missing.items()))
    return found[0]


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("name", "mode", "dt", "difference"),
    [
        ("pyelastica", modes.SDIRK2, 1e-3, 1e-3),
        ("mujoco_cable", modes.SDIRK2, 1e-3, 2e-3),  # semi-implicit Euler, and its links do not stretch
        ("dismech", modes.EULER, 1e-2, 5e-4),  # single precision
    ],
)
def test_rivals_fall_like_rodnet(name, mode, dt, difference):
    adapter = _rival(name)
    edges, duration = 50, 0.2
    sim = modes.simulate(scenes.cantilever(edges), dt, mode)
    modes.advance(sim, duration)
    rod = adapter.Cantilever(edges)
    rod.advance(duration)
    assert np.linalg.norm(rod.tip() - scenes.tip(sim)) < difference


def test_error_falls_with_the_order_of_the_stepper():
    young = accuracy.RODS["E = 10 MPa"]
    exact = accuracy.fall(20, young, modes.SDIRK2, 5e-4)
    for mode, least in ((modes.EULER, 1.6), (modes.SDIRK2, 3.0)):
        coarse, fine = (accuracy.error(accuracy.fall(20, young, mode, dt), exact) for dt in (1e-2, 5e-3))
        assert coarse / fine > least


# -- the breakdown ---------------------------------------------------------------------------
def test_breakdown_finds_the_kernels_of_a_step(clock, monkeypatch):
    monkeypatch.setattr(iteration, "best_loop", lambda work, clock, **options: clock.time(work))
    anatomy = iteration.dissect(scenes.swimmer(2), clock, 0.05)
    inside = {k["name"] for k in anatomy.kernels if k["inside"]}
    assert len(inside) > 4 and anatomy.iterations >= 1.0
    assert 0.0 < anatomy.loop <= anatomy.step
    assert sum(anatomy.share(inside=True)) == pytest.approx(anatomy.loop)
    sim = modes.simulate(scenes.swimmer(2), 0.01)  # the kernels are themselves again
    assert sim.step().ok


# -- the command -----------------------------------------------------------------------------
def test_command_writes_results_that_name_no_place(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(cases.Options, "repeats", 1)
    path = tmp_path / "results.json"
    arguments = ["--quick", "--no-rivals", "--cases", "cantilever", "sweep", "--json", str(path)]
    assert run.main(arguments) == 0
    assert "ms per step" in capsys.readouterr().out
    text = path.read_text()
    results = json.loads(text)
    assert results["machine"]["versions"]["numpy"] == np.__version__
    for private in (str(process.ROOT), str(tmp_path), platform.node()):
        assert not private or private not in text
    page = report.markdown(results["cases"]["cantilever"])
    assert "| nodes |" in page and "101 nodes" in page


def test_failing_case_does_not_lose_the_others(tmp_path, monkeypatch, capsys):
    def measure(name, options):
        if name == "grid":
            raise RuntimeError("no")
        return cases.Result(name, "fine")

    monkeypatch.setattr(cases, "measure", measure)
    assert run.main(["--cases", "grid", "sweep", "--json", str(tmp_path / "r.json")]) == 1
    out = capsys.readouterr().out
    assert "RuntimeError: no" in out and "fine" in out


def test_cases_measured_again_say_so():
    """A case in the place of that of a whole run does not pass for a part of it."""
    case = {"title": "Grid", "text": "", "tables": [], "demands": [], "notes": ["a note"]}
    machine = {"commit": "abc", "date": "2026-01-02"}
    old = {"machine": {"commit": "old"}, "cases": {"grid": case | {"text": "old"}, "laws": case}}
    new = report.replaced(old, {"machine": machine, "disturbance": 1.0, "cases": {"grid": case}})
    assert new["machine"] == old["machine"] and new["cases"]["laws"] == case
    assert new["cases"]["grid"]["notes"][0] == "a note"
    assert "commit abc, 2026-01-02" in report.markdown(new["cases"]["grid"])


def test_committed_results_are_shown_by_the_documentation():
    results = report.load()
    assert set(results["cases"]) == set(cases.NAMES)
    assert not any("failed" in case for case in results["cases"].values())
    for name, draw in figures.DRAWN.items():
        assert figures.svg(draw(results["cases"][name])).startswith("<?xml")
    assert all(report.markdown(case) for case in results["cases"].values())


def test_regression_finds_the_law_of_a_force_that_is_known():
    pytest.importorskip("pysindy", reason="PySINDy comes with the dependency group bench")
    rng, creep, law = np.random.default_rng(1), 0.01, {"gz": -0.2, "square": -5.0, "kxz": 0.7}

    def trial():
        hats = SimpleNamespace(places=np.linspace(0.0, 1.0, 7), times=np.linspace(0.0, 2.0, 5))
        t = np.linspace(0.0, 2.0, 41)
        motion = SimpleNamespace(t=t, x=rng.standard_normal((41, 13, 3)))
        one = SimpleNamespace(hats=hats, motion=motion, velocity=rng.standard_normal((7, 5, 3)))
        found = drafted.features(one, creep)
        one.sd = np.full((7, 5, 3), 0.01)
        one.mean = sum(v * found[name] for name, v in law.items()) + one.sd * rng.standard_normal((7, 5, 3))
        one.blind = np.zeros((7, 5), dtype=bool)
        one.mean[3, 2], one.blind[3, 2] = 1e3, True  # what is not seen has no say
        return one

    found = drafted.regressed([trial() for _ in range(4)], creep)
    assert set(found) == set(law)
    assert found == pytest.approx(law, rel=0.05)
