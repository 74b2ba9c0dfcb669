"""Whether two robots are equal to the last bit."""

from dataclasses import fields

import numpy as np

import rodnet as rn


def through_a_file(robot, folder):
    return rn.Robot.load(robot.save(folder / "robot.toml"))


def same(a, b, what=""):
    """Two objects of arrays, numbers and text are equal to the last bit."""
    assert type(a) is type(b), what
    if isinstance(a, np.ndarray):
        assert a.dtype == b.dtype and np.array_equal(a, b), what
    elif hasattr(a, "__dataclass_fields__"):
        for f in fields(a):
            if f.name != "figure":
                same(getattr(a, f.name), getattr(b, f.name), f"{what}.{f.name}")
    elif isinstance(a, dict):
        assert list(a) == list(b), what
        for key in a:
            same(a[key], b[key], f"{what}[{key}]")
    elif isinstance(a, tuple | list):
        assert len(a) == len(b), what
        for k, (x, y) in enumerate(zip(a, b, strict=True)):
            same(x, y, f"{what}[{k}]")
    else:
        assert a == b, what


def same_robots(a, b):
    same(a.graph, b.graph, "graph")
    assert [type(t) for t in a.terms] == [type(t) for t in b.terms]
    assert [t.name for t in a.terms] == [t.name for t in b.terms]
    assert list(a.parameters) == list(b.parameters)
    for p, q in zip(a.parameters.values(), b.parameters.values(), strict=True):
        same(np.asarray(p.value), np.asarray(q.value), p.name)
        assert (p.unit, p.bounds, p.null, p.kind, p.doc, p.name) == (
            q.unit,
            q.bounds,
            q.null,
            q.kind,
            q.doc,
            q.name,
        )
    sharing = [[[x is y for x in r.parameters.values()] for y in r.parameters.values()] for r in (a, b)]
    assert sharing[0] == sharing[1]
