"""What is installed: built-ins, plug-ins, and plug-ins that are broken."""

from __future__ import annotations

import subprocess
import sys
import warnings
from importlib.metadata import EntryPoint

import pytest

import rodnet as rn
from rodnet import built_in, registry

PLUGIN = '''
import rodnet as rn

class Wind(rn.LoadModel):
    """A steady wind."""

    default_name = "wind"
    source = "a test"
    strength = rn.Parameter(0.0, unit="N", null=0.0, doc="force on a node")

    def force(self, site, p):
        return 0.0 * site.x + p.strength

def pendulum(length=0.1):
    """A rod that hangs."""
    fig = rn.StickFigure()
    fig.rod("rod", [(0, 0, 0), (length, 0, 0)], edges=4, material=rn.Material(E=1e6, rho=1000.0), radius=2e-3)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), rn.Clamp(at="rod.start")]
    return rn.Robot(fig.build(), terms)

pendulum.metrics = lambda traj: {"sag_mm": 1e3 * float(-traj.x[-1, -1, 2])}

number = 7
'''
POINTS = {
    "rodnet.terms": {
        "wind": "{module}:Wind",
        "missing": "{module}:Nothing",
        "elsewhere": "no_such_module_of_rodnet:Law",
        "not-a-term": "{module}:pendulum",
        "leaves": "{module}_leaves:Law",
        "gravity": "{module}:Wind",
    },
    "rodnet.robots": {"pendulum": "{module}:pendulum", "number": "{module}:number"},
}
BROKEN = ("missing", "elsewhere", "not-a-term", "leaves")


@pytest.fixture
def installed(tmp_path):
    """A distribution with good and broken entry points, as a folder to put on the path."""
    module = f"plugin_{tmp_path.name}".replace("-", "_")
    (tmp_path / f"{module}.py").write_text(PLUGIN)
    (tmp_path / f"{module}_leaves.py").write_text("raise SystemExit('good bye')\n")
    info = tmp_path / "rodnet_wind-1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: rodnet-wind\nVersion: 1.2\n")
    groups = [
        f"[{group}]\n" + "".join(f"{k} = {v.format(module=module)}\n" for k, v in points.items())
        for group, points in POINTS.items()
    ]
    (info / "entry_points.txt").write_text("\n".join(groups))
    return tmp_path


@pytest.fixture
def found(installed, monkeypatch):
    """The registry of this process with that distribution."""
    caches = (registry._entry_points, registry._load, registry._all)
    monkeypatch.syspath_prepend(installed)
    for cache in caches:
        cache.cache_clear()
    yield registry
    for cache in caches:
        cache.cache_clear()


def quiet(function, *arguments):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return function(*arguments)


def test_built_in_terms_say_what_they_are():
    records = quiet(registry.terms)
    assert {r.kind for r in records.values()} == set(registry.KINDS)
    for name in built_in.TERMS:
        record = records[name]
        assert record.id == name and record.summary and record.source
        assert record.distribution == f"rodnet {rn.__version__}"
        assert rn.term(name) is record.object is getattr(rn, record.object.__name__)
        for p in record.parameters:
            assert p.name and p.unit and p.doc, (name, p)
    assert quiet(registry.robots)["flagellated"].object is rn.robots.flagellated


def test_every_public_term_is_registered():
    public = {getattr(rn, name) for name in rn.__all__ if isinstance(getattr(rn, name), type)}
    public = {c for c in public if issubclass(c, rn.Term) and c.bind is not rn.Term.bind}
    laws = {rn.EnergyModel, rn.DragModel, rn.LoadModel, rn.Actuator, rn.Constraint}
    assert public - laws == {r.object for k, r in quiet(registry.terms).items() if k in built_in.TERMS}


def test_unknown_names_list_what_there_is():
    with pytest.raises(
        rn.RegistryError, match=r"did you mean 'resistive-force'\? Installed are stretching, "
    ):
        rn.term("resistive_forc")
    with pytest.raises(rn.RegistryError, match="no robot is called 'walker'"):
        registry.robot("walker")


def test_a_plugin_is_found_and_broken_ones_are_left_out(found):
    with pytest.warns(RuntimeWarning) as caught:
        records = found.terms()
    record = records["wind"]
    assert (record.kind, record.source, record.distribution) == ("load", "a test", "rodnet-wind 1.2")
    assert record.summary == "A steady wind."
    parameter = record.to_dict()["parameters"][0]
    assert (parameter["name"], parameter["unit"], parameter["bounds"]) == ("strength", "N", [None, None])
    assert "wind" in quiet(found.candidates) and "clamp" not in found.candidates()
    assert not set(BROKEN) & set(records)
    messages = [str(w.message) for w in caught]
    for name in BROKEN:
        assert sum(f"'{name}' of rodnet-wind 1.2 is left out" in m for m in messages) == 1
    assert any("not a subclass of rodnet.Term" in m for m in messages)
    assert any("SystemExit: good bye" in m for m in messages)
    with warnings.catch_warnings():  # said once
        warnings.simplefilter("error")
        assert rn.term("wind") is record.object


def test_a_taken_name_stays_with_its_owner(found):
    with pytest.warns(RuntimeWarning, match="'gravity' of rodnet-wind 1.2 is left out: rodnet has one"):
        assert rn.term("gravity") is rn.Gravity


def test_two_packages_with_one_name(monkeypatch):
    points = [EntryPoint("law", f"package{k}:Law", "rodnet.terms") for k in (2, 1)]
    monkeypatch.setattr(registry, "entry_points", lambda group: points)
    registry._entry_points.cache_clear()
    with pytest.warns(RuntimeWarning, match="'law' of an unknown package is left out"):
        assert registry._entry_points("rodnet.terms")["law"].value == "package1:Law"
    registry._entry_points.cache_clear()


def test_one_term_loads_without_the_others(found):
    with pytest.warns(RuntimeWarning) as caught:  # only of the taken name, found without loading
        assert rn.term("wind").__name__ == "Wind"
    assert len(caught) == 1


def test_robots_of_plugins(found):
    with pytest.warns(RuntimeWarning, match="'number' of rodnet-wind 1.2 is left out"):
        assert set(found.robots()) >= {"flagellated", "pendulum"}
    assert found.robot("pendulum")(length=0.2).graph.node_count == 5


def python(installed, *arguments):
    code = f"import sys; sys.path.insert(0, {str(installed)!r}); " + arguments[0]
    return subprocess.run(
        [sys.executable, "-c", code, *arguments[1:]], cwd=installed, capture_output=True, text=True
    )


def test_broken_plugins_break_neither_import_nor_command_line(installed):
    result = python(installed, "import rodnet; print('fine')")
    assert (result.stdout, result.stderr) == ("fine\n", "")
    result = python(installed, "from rodnet.cli import main; main()", "terms")
    assert result.returncode == 0
    assert "wind" in result.stdout and "rodnet-wind 1.2" in result.stdout
    assert "warning: the term 'elsewhere'" in result.stderr and "no_such_module_of_rodnet" in result.stderr


def test_the_command_line_runs_a_plugins_robot(installed):
    options = ["--set", "length=0.05", "--duration", "0.3", "--stepper", "sdirk2", "--out", "out", "--json"]
    result = python(installed, "from rodnet.cli import main; main()", "run", "pendulum", *options)
    assert result.returncode == 0, result.stderr
    assert '"sag_mm": ' in result.stdout and '"converged": null' in result.stdout
    result = python(installed, "from rodnet.cli import main; main()", "run", "pendulum", "--tails", "2")
    assert result.returncode == 2
    assert "takes no 'n_tails'; it takes length" in result.stderr
