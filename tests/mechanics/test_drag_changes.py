"""Changes of a medium's drag: they are the laws that they describe, in a flow and on rings, too."""

from dataclasses import replace

import numpy as np
import pytest

import rodnet as rn
from rodnet.terms.drag.changed import Laws
from rodnet.terms.drag.line import LineSites, difference, start_sites
from tests.mechanics.test_local import ELASTIC, E, L, R, beam

VELOCITY = np.random.default_rng(3).normal(size=(9, 3)) * 0.1
MU = 0.7
HALF = [f"beam:{k}-{k + 1}" for k in range(4)]


def motion(*terms):
    robot = beam(*terms, edges=8, clamped=False)
    return rn.Simulation(robot, 5e-3, velocity=VELOCITY).run(0.05).x


def drag(on="*", **options):
    return rn.ResistiveForce(on, viscosity=MU, **options)


SHEAR = rn.ShearFlow(3.0, origin=(0.0, 0.0, 0.02))


def eta():
    log = np.log(2 * L / R)
    return 2 * np.pi * MU / (log - 0.5), 4 * np.pi * MU / (log + 0.5)


def stirred(x, t):
    """A current that pulses."""
    return np.sin(1.4 * np.pi * t) * np.stack([0.0 * x[:, 0], 0.2 + 0.0 * x[:, 0], 0.4 * x[:, 0]], axis=1)


def test_changes_of_drag_are_the_laws_that_they_describe():
    along, across = eta()
    pairs = [
        ([drag(), rn.BackgroundFlow(u_x=0.1, u_z=-0.2)], [drag(flow=(0.1, 0.0, -0.2))]),
        ([drag(), rn.UnevenFlow(axz=0.3, ux=-0.06)], [drag(flow=rn.ShearFlow(0.3, origin=(0.0, 0.0, 0.2)))]),
        ([drag(), rn.UnevenFlow(bzx=0.4, vy=0.2, frequency=0.7)], [drag(flow=stirred)]),
        ([drag(), rn.DragAnisotropy(along=0.5)], [rn.ResistiveForce(eta_t=1.5 * along, eta_n=across)]),
        ([drag(), rn.PowerLawChange(exponent=0.4, speed=0.05)],
         [rn.PowerLawForce(viscosity=MU, rate=0.05 / R, exponent=0.4)]),
        ([drag(flow=SHEAR), rn.PowerLawChange(exponent=0.4, speed=0.05)],  # against the medium
         [rn.PowerLawForce(viscosity=MU, rate=0.05 / R, exponent=0.4, flow=SHEAR)]),
        ([drag(), rn.SwitchedDrag(gain=2.0, onset=-1.0, ramp=1e-3)], [rn.ResistiveForce(viscosity=3.0 * MU)]),
        ([drag(), rn.DragGradient(gradient=1e-9, level=-1e9)], [rn.ResistiveForce(viscosity=2.0 * MU)]),
        ([drag(), rn.DragGradient(gradient=1e3, level=1.0)], []),  # above the surface
        ([drag(), rn.WallDrag(reach=1e10, position=-1e10)], [rn.ResistiveForce(viscosity=2.0 * MU)]),
        ([drag(), *(rn.DragRegion(gain=g, width=1.0, place=0.5) for g in (1.0, -1.0))], [drag()]),
        ([drag(), rn.SpinDrag(viscosity=MU)], [drag(axial_torque=True)]),
        ([rn.DragAnisotropy(along=1.0, eta_t=along, eta_n=across)], [rn.ResistiveForce(eta_t=along, eta_n=0.0)]),
    ]  # fmt: skip
    for changed, law in pairs:
        np.testing.assert_allclose(motion(*changed), motion(*law), rtol=0, atol=2e-10, err_msg=repr(changed))


def test_a_factor_in_a_shear_is_differentiated_by_place():
    """What moves in a flow that changes with the place meets it at another speed."""
    robot = beam(drag(flow=SHEAR), rn.PowerLawChange(exponent=0.4, speed=0.05), edges=8, clamped=False)
    (change,) = (b for b in rn.Simulation(robot).model.bound if isinstance(getattr(b, "laws", None), Laws))
    rng = np.random.default_rng(5)
    n = len(change.cells)
    v, x, tangent = rng.normal(size=(3, n, 3)) * np.array([0.1, 0.1, 1.0])[:, None, None]
    site = LineSites(v, x, tangent, np.full(n, R), np.full(n, L / 8), 0.0, 1e-3)
    _, slopes = change.law.change(change.laws, site, change.cells, change.p, True)
    for key, slope in slopes.items():
        expected = difference(
            lambda at: change.law.change(change.laws, at, change.cells, change.p, False)[0], site, key
        )
        np.testing.assert_allclose(
            slope, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max(), err_msg=key
        )


def test_a_change_acts_on_every_law_and_needs_one():
    """Also on one that moves with a flow, and on the rods that it names only."""
    windy = drag(flow=(0.2, 0.1, 0.0))
    twice = motion(windy, rn.SwitchedDrag(gain=1.0, onset=-1.0, ramp=1e-3))
    np.testing.assert_allclose(
        twice, motion(rn.ResistiveForce(viscosity=2 * MU, flow=(0.2, 0.1, 0.0))), atol=2e-10
    )
    half = motion(drag(), rn.SwitchedDrag(HALF, gain=1.0, onset=-1.0, ramp=1e-3))
    some = motion(
        drag(HALF, length=L, name="a"),
        drag(HALF, length=L, name="b"),
        drag([f"beam:{k}-{k + 1}" for k in range(4, 8)], length=L, name="c"),
    )
    np.testing.assert_allclose(half, some, atol=2e-10)
    with pytest.raises(rn.TermError, match="no drag law without memory acts on"):
        beam(rn.BackgroundFlow(u_x=0.1))
    with pytest.raises(rn.TermError, match="give both eta_t= and eta_n="):
        rn.DragAnisotropy(along=0.5, eta_t=1.0)


@pytest.mark.parametrize("kind", [rn.BinghamForce, rn.PowerLawForce, rn.GranularForce])
def test_a_change_asks_a_compiled_law_for_what_its_arrays_say(kind):
    model = rn.Simulation(beam(kind(**kind.example), edges=8), 5e-3).model
    laws, rng = Laws(rn.SwitchedDrag(), model), np.random.default_rng(4)
    (part,), n = laws.parts, len(laws.sites.node)
    v = np.exp(rng.uniform(-12.0, 0.0, (n, 1))) * rng.normal(size=(n, 3))
    site = replace(start_sites(model, laws.sites), v=v, x=0.1 * rng.normal(size=(n, 3)))
    assert part.vector is not None
    arrays = replace(part, vector=None)
    np.testing.assert_allclose(part.force(site), arrays.force(site), rtol=1e-12, atol=1e-15)
    found, wanted = part.slopes(site), arrays.slopes(site)
    for key, slope in wanted.items():
        np.testing.assert_allclose(found[key], slope, rtol=1e-6, atol=1e-9 * np.abs(slope).max(), err_msg=key)


def test_a_rough_spot_of_a_ring_is_not_felt_where_the_ring_closes():
    """A node there lies at both ends of the rod, and not along all of it."""
    fig = rn.StickFigure()
    angle = 2.0 * np.pi * np.arange(16) / 16
    line = 0.05 * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    fig.rod("ring", line, closed=True, material=rn.Material(E=E), radius=R)
    region = rn.DragRegion(gain=1.0, place=0.5, width=0.05)
    robot = rn.Robot(fig.build(), [*(law() for law in ELASTIC), drag(tangent="node", length=L), region])
    (change,) = (b for b in rn.Simulation(robot).model.bound if isinstance(getattr(b, "laws", None), Laws))
    assert np.diff(change.cells, axis=1).max() < 0.07
