"""Fingerprints of functions: what makes them differ, and what doesn't."""

from __future__ import annotations

import functools
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

import rodnet as rn
from rodnet.sweeps.fingerprint import fingerprint
from tests.inference.swings import cable


def test_fingerprints_tell_code_and_values_apart_but_not_layout():
    def made(text, **names):
        space = {"__name__": "made", **names}
        exec(text, space)
        return space["f"]

    same = made("def f(x):\n    return x + k", k=1)
    assert fingerprint(same) == fingerprint(made("def f(x):  # sum\n\n    return (x\n       + k)", k=1, z=5))
    others = [
        made("def f(x):\n    return x - k", k=1),
        made("def f(x):\n    return x + k", k=2),
        made("def f(x, y=1):\n    return x + k", k=1),
        made("def g(x):\n    return x + 1\ndef f(x):\n    return g(x)"),
        made("def g(x):\n    return x + 2\ndef f(x):\n    return g(x)"),
        made("def h(a):\n    return lambda x: x + a\nf = h(1)"),
        made("def h(a):\n    return lambda x: x + a\nf = h(2)"),
        made("class C:\n    def __init__(self, a):\n        self.a = a\n    def __call__(self, x): return x\nf = C(1)"),
        made("class C:\n    def __init__(self, a):\n        self.a = a\n    def __call__(self, x): return x\nf = C(2)"),
        made("def f(x):\n    return x + k[0]", k=np.array([1.0])),
        made("def f(x):\n    return x + k[0]", k=np.array([2.0])),
    ]  # fmt: skip
    assert len({fingerprint(f) for f in [same, *others]}) == len(others) + 1
    path = Path("a/b")
    before = fingerprint(lambda: path)
    assert (str(path), hash(path)) and fingerprint(lambda: path) == before  # what it has cached doesn't count


def test_everything_that_a_robot_consists_of_counts_and_nothing_that_it_has_cached():
    """What is described on the way is made and thrown away: its address may be that of what comes later."""

    class Kept:
        def __init__(self, length):
            self.length = length

        @functools.cached_property
        def square(self):
            return self.length**2

    class Fresh:
        def __init__(self, value):
            self.value = value

        def __getstate__(self):
            return {"made": [[self.value]]}

    many = [[Fresh(0.0) for _ in range(5)] for _ in range(6)]
    for k in range(5):
        many[k][k].value = 1.0
    assert len({fingerprint(row) for row in many}) == 6

    one = Kept(2.0)
    before = fingerprint(lambda: one)
    assert one.square == 4.0 and fingerprint(lambda: one) == before != fingerprint(lambda: Kept(2.0).square)

    robot = cable(E=3e6, rate=0.8)
    found = {fingerprint(lambda: robot), fingerprint(lambda: rn.robots.flagellated(2))}
    for path, one in robot.parameters.items():
        other = robot.with_parameters({path: 0.9 * np.asarray(one.value) + 1e-4})
        found.add(fingerprint(lambda other=other: other))
    assert len(found) == 2 + len(robot.parameters)


def test_fingerprints_are_the_same_in_every_process():
    code = """
import functools, rodnet as rn
from rodnet.sweeps.fingerprint import fingerprint
names = {"head", "tail0", "tail1"}
f = functools.partial(rn.robots.flagellated, rpm=50.0)
print(fingerprint(f), fingerprint(lambda x: x in {"a", "b", "c"} or x in names), fingerprint(rn.SDIRK2()))
"""
    seen = {
        subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("0", "1", "2")
    }
    assert len(seen) == 1 and len(set(seen.pop().split())) == 3


def test_a_prior_counts_but_not_the_random_numbers_that_scipy_would_draw_from_it():
    """Each process begins with a state of its own of numpy's generator, which each distribution refers to."""
    from scipy.stats import norm

    def prior(sd):
        return lambda: norm(0.0, sd)

    np.random.seed(0)  # noqa: NPY002
    before = fingerprint(prior(2.0))
    np.random.seed(1)  # noqa: NPY002
    assert fingerprint(prior(2.0)) == before
    assert fingerprint(norm(0.0, 2.0)) != fingerprint(norm(0.0, 3.0))


def test_the_sources_of_plug_ins_count(tmp_path, monkeypatch):
    """All modules of the package that a law comes from, whatever of it was imported; not rodnet, nor what runs."""
    package = tmp_path / "granular"
    (package / "laws").mkdir(parents=True)
    for file, text in (("__init__.py", "from granular.laws.jam import Jam"), ("laws/__init__.py", ""),
                       ("laws/jam.py", "class Jam:\n    strength = 1.0\n"), ("tables.py", "rows = 3\n")):  # fmt: skip
        (package / file).write_text(text)
    code = (
        "import rodnet as rn, granular; from rodnet.sweeps.fingerprint import packages\n"
        "print(packages(t.__module__ for t in (granular.Jam, granular.Jam(), rn.Gravity, rn.Gravity())))\n"
    )

    def told():
        env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
        return subprocess.run(
            [sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True
        ).stdout

    before = told()
    assert told() == before and before.startswith("[('granular', '") and before.count("('") == 1
    (package / "tables.py").write_text("rows = 4\n")
    assert told() != before
