"""The examples of the page on writing laws run, and show what the page says."""

import re
from pathlib import Path

import matplotlib
import numpy as np
import pytest

import rodnet as rn

PAGE = Path(__file__).parents[1] / "docs" / "howto" / "write-a-law.md"


@pytest.fixture(scope="module")
def page():
    """The names that the page's code defines, and the trajectory that each of its cells leaves behind."""
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    names, trajectories = {}, []
    for cell in re.findall(r"```{code-cell} ipython3\n(.*?)```", PAGE.read_text(), flags=re.S):
        before = names.get("traj")
        exec(compile(cell, str(PAGE), "exec"), names)
        if names.get("traj") is not before:
            trajectories.append(names["traj"])
    plt.close("all")
    return names, trajectories


def test_the_page_has_an_example_of_each_kind(page):
    import rodnet as rn

    names, _ = page
    laws = [v for v in names.values() if isinstance(v, type) and issubclass(v, rn.Term)]
    assert {law.kind for law in laws} == {"energy", "drag", "load", "actuator", "constraint"}
    assert any(law.kind == "drag" and law.memory_size for law in laws)
    assert any(law.kind == "drag" and law.kernel is not None for law in laws)


def test_what_the_page_shows_is_true(page):
    names, (_, friction, _, servo, floor, crank) = page
    assert names["speed"][-1] == pytest.approx(names["terminal"], rel=1e-3)
    # friction: within a quarter period the cable gives way and slides; it does not come back
    x = friction.at("cable.start")[:, 0]
    assert 1e-3 < x.max() < 0.05
    assert len(np.unique(np.sign(np.diff(x)))) >= 2
    assert servo.theta[-1, -1] == pytest.approx(2.0, abs=0.02)
    assert np.abs(floor.x[-1, :, 2]).max() < 2e-3
    assert np.abs(crank.x[:, 0]).max() < 1e-12  # the wall turns in place
    assert np.abs(crank.x[:, -1, 0]).max() > 0.05
    tips = np.array(names["tips"])  # the last curve is that of the stiffening rod
    assert np.all(np.diff(tips) < 0.0) and tips[-1] > -0.2


def test_derivatives_by_a_tangent_count_across_it_only():
    """Off the unit sphere |v.t t| and |v.t| go different ways: no motion goes there, and neither is wrong."""

    class Along(rn.DragModel):
        """Drag along the rod, quadratic in the speed along it."""

        c = rn.Parameter(2.0, unit="N s^2/m^3", bounds=(0, None), null=0.0)
        claims = {"dissipative", "objective"}

        def force(self, site, p):
            along = rn.dot(site.v, site.tangent) * site.tangent
            return -p.c * rn.norm(along) * along

        def jacobian(self, site, p):
            t, v = site.tangent, site.v
            s = np.sum(v * t, axis=1)[:, None, None]
            tt, tv = t[:, :, None] * t[:, None, :], t[:, :, None] * v[:, None, :]
            c = np.reshape(p.c, (-1, 1, 1))
            # of -c |s| s t with s = v.t, the length of t left alone
            return {"v": -2.0 * c * np.abs(s) * tt, "tangent": -c * np.abs(s) * (2.0 * tv + s * np.eye(3))}

    rn.testing.check_term(Along)
