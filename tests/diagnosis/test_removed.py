"""What a repair takes off the errors on files, and explanations with many strengths."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.removed import removed


def files(errors, kinds=None):
    kinds = kinds or ["cable"] * len(errors)
    return [
        {"name": f"f{k}", "kind": kind, "mean_mm_5s": e, "mean_mm_1s": e, "metric": None}
        for k, (e, kind) in enumerate(zip(errors, kinds, strict=True))
    ]


def test_the_interval_over_files_covers_the_share_as_often_as_it_says():
    rng = np.random.default_rng(0)
    hits, count = 0, 150
    for _ in range(count):
        before = rng.uniform(15.0, 25.0, 12)
        one = removed(files(before), files(before * rng.uniform(0.4, 0.8, 12)))[0]
        hits += one.low <= 0.4 <= one.high
    assert 0.8 < hits / count <= 0.97  # few files: a little narrow


def test_kinds_are_told_apart_and_what_is_not_measured_is_left_out():
    kinds = ["decay", "decay", "circle", "circle"]
    found = removed(files([10.0, 10.0, 20.0, 20.0], kinds), files([5.0, 5.0, 20.0, 20.0], kinds))
    assert {(one.measure, one.kind): one.share for one in found} == pytest.approx(
        {("mean_mm_5s", ""): 1 / 6, ("mean_mm_1s", ""): 1 / 6, ("mean_mm_5s", "decay"): 0.5,
         ("mean_mm_1s", "decay"): 0.5, ("mean_mm_5s", "circle"): 0.0, ("mean_mm_1s", "circle"): 0.0}
    )  # fmt: skip
    assert next(one for one in found if one.kind == "decay").low == pytest.approx(0.5)


def test_a_natural_shape_of_many_bends_is_found_where_a_single_one_is_not_enough():
    """A rod with an S-shaped natural curvature, whose ends are held: bends side by side take the place of it."""
    figure = rn.StickFigure()
    figure.rod(
        "rod", [(0, 0, 0), (0.4, 0, 0)], edges=20, material=rn.Material(E=2e6, rho=1200.0), radius=4e-3
    )
    robot = rn.Robot(
        figure.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), rn.Clamp(at="rod.start")]
    )
    (shape,) = rn.candidates(robot, [], ["natural-shape"])
    built = shape.build(robot)
    assert len(shape.strength) == 10 and set(shape.nulls(built).values()) == {0.0}
    places = np.linspace(0.0, 1.0, 5)
    wanted = 3.0 * np.sin(2 * np.pi * places)
    curved = built.with_parameters({p: k for p, k in zip(shape.strength[::2], wanted, strict=True)})
    one = rn.equilibrium(curved).x[-1]
    true = rn.StickFigure()
    s = (np.arange(19) + 1.0) / 20.0
    true.rod("rod", [(0, 0, 0), (0.4, 0, 0)], edges=20, material=rn.Material(E=2e6, rho=1200.0), radius=4e-3,
             natural_curvature=np.stack([3.0 * np.sin(2 * np.pi * s), 0 * s], axis=1))  # fmt: skip
    plain = rn.equilibrium(robot).x[-1]
    other = rn.equilibrium(rn.Robot(true.build(), robot.terms)).x[-1]
    assert np.abs(one - other).max() < 0.25 * np.abs(plain - other).max()
