"""Terms that differ along a rod, and changes of a medium, against beam theory and other laws."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rodnet as rn
from rodnet.terms.local.joints import NEAR, beyond
from rodnet.terms.local.stations import bump, spring_cells

L, R, E = 0.2, 2e-3, 1e7
EI = E * np.pi * R**4 / 4
ELASTIC = rn.Stretching, rn.Bending, rn.Twisting
S = np.linspace(0.0, 1.0, 2001)


def beam(*terms, edges=40, clamped=True):
    fig = rn.StickFigure()
    fig.rod(
        "beam", [(0, 0, 0), (L, 0, 0)], edges=edges, material=rn.Material(E=E, nu=0.5, rho=1000.0), radius=R
    )
    wall = [rn.Clamp(at="beam.start")] if clamped else []
    return rn.Robot(fig.build(), [*(law() for law in ELASTIC), *wall, *terms])


def at_rest(*terms, **options):
    return rn.equilibrium(beam(*terms, **options))


def sag(x):
    return -x[-1, -1, 2] if x.ndim == 3 else -x[-1, 2]


LOAD = rn.PointForce(at="beam.end", force=(0, 0, -1e-4))  # small: 0.02 rad


def deflection(change):
    """Of the tip of a slightly bent cantilever of stiffness EI (1 + change(s))."""
    curvature = 1e-4 * L * (1.0 - S) / (EI * (1.0 + change(S)))
    return np.trapezoid(curvature * L * (1.0 - S), S) * L


@pytest.mark.parametrize(
    ("term", "change"),
    [
        (rn.StiffnessDefect(loss=0.6, place=0.3, width=0.08), lambda s: -0.6 * np.exp(-((s - 0.3) ** 2) / 0.0128)),
        (rn.StiffnessDefect(loss=-2.0, place=0.0, width=0.1), lambda s: 2.0 * np.exp(-(s**2) / 0.02)),
        (rn.StiffnessGradient(slope=1.2), lambda s: 1.2 * (s - 0.5)),
        (rn.StiffnessProfile(half=-0.7, whole=0.4, twice=0.3), lambda s: np.expm1(
            -0.7 * np.cos(np.pi * s) + 0.4 * np.cos(2 * np.pi * s) + 0.3 * np.cos(4 * np.pi * s))),
    ],
)  # fmt: skip
def test_a_cantilever_of_varying_stiffness_sags_as_beam_theory_says(term, change):
    assert sag(at_rest(LOAD, term).x) == pytest.approx(deflection(change), rel=3e-3)


def test_a_section_that_is_not_round_sags_by_its_stiffness_along_the_load():
    """One of both bendings carries the load; of the other, and of twisting, it knows nothing."""
    plain = sag(at_rest(LOAD).x)
    sags = [sag(at_rest(LOAD, rn.SectionStiffness(**{name: 0.5})).x) for name in ("first", "second", "twist")]
    assert sorted(s / plain for s in sags) == pytest.approx([np.exp(-0.5), 1.0, 1.0], rel=1e-3)


def test_a_section_with_skew_axes_goes_sideways():
    """The compliances along and across the load are the hyperbolic cosine and sine of the coupling."""
    plain, tip = sag(at_rest(LOAD).x), at_rest(LOAD, rn.SectionStiffness(skew=0.6)).x[-1, -1]
    assert -tip[2] / plain == pytest.approx(np.cosh(0.6), rel=1e-3)
    assert abs(tip[1]) / plain == pytest.approx(np.sinh(0.6), rel=1e-3)


def test_a_narrow_defect_does_as_much_on_every_mesh():
    """Also where it is narrower than an edge, and between nodes; to first order in the loss."""
    more = []
    for edges in (10, 23, 80):
        plain, soft = (
            sag(at_rest(LOAD, *t, edges=edges).x)
            for t in ([], [rn.StiffnessDefect(loss=0.02, place=0.37, width=0.01)])
        )
        more.append(soft - plain)
    assert np.ptp(more) < 0.1 * more[-1]  # a coarse mesh has it at the nearest node
    cells = spring_cells(beam(edges=10).graph and rn.Simulation(beam(edges=10), 0.01).model, np.arange(10))
    assert np.sum(bump(cells, 0.37, 0.01) * np.diff(cells)[:, 0]) == pytest.approx(
        0.01 * np.sqrt(2 * np.pi), rel=1e-9
    )


@pytest.mark.parametrize(("loss", "width"), [(0.9, 0.01), (0.6, 0.05), (0.98, 0.003), (-5.0, 0.02)])
def test_a_soft_spot_turns_under_a_moment_by_its_compliance_on_every_mesh(loss, width):
    """By M over the integral of 1 / EI(s), bent, and with its share of the loss, twisted."""
    moment, nu = 0.05 * EI / L, 0.5
    s = 0.37 + width * np.linspace(-9.0, 9.0, 200001)
    w = np.exp(-0.5 * ((s - 0.37) / width) ** 2)
    bent, twisted = (np.trapezoid(a * w / (1.0 - a * w), s) for a in (loss, nu * loss))
    for edges in (10, 23, 80):
        spot = rn.StiffnessDefect(loss=loss, place=0.37, width=width, twist=nu)
        ends = [
            at_rest(rn.PointTorque(on="beam.end", torque=torque), *some, edges=edges)
            for torque in ((0, moment, 0), (moment, 0, 0)) for some in ([], [spot])
        ]  # fmt: skip
        angles = [np.arctan2(-d[2], d[0]) for d in (one.x[-1, -1] - one.x[-1, -2] for one in ends[:2])]
        assert angles[1] - angles[0] == pytest.approx(moment * L / EI * bent, rel=2e-3)
        turns = [one.theta[-1, -1] for one in ends[2:]]
        # GJ = EI / (1 + nu) = 2 EI / 3 of a round section at Poisson's ratio of a half
        assert turns[1] - turns[0] == pytest.approx(1.5 * moment * L / EI * twisted, rel=2e-3)


def test_a_root_that_gives_turns_by_the_moment_over_its_stiffness():
    more = sag(at_rest(LOAD, rn.JointCompliance(at="beam.start", length=0.03)).x) - sag(at_rest(LOAD).x)
    assert more == pytest.approx(1e-4 * L * 0.03 / EI * L, rel=2e-3)


@pytest.mark.parametrize(("length", "edges", "bend"), [(0.3, 40, 4.0), (0.3, 4, 4.0), (0.03, 4, 7.0)])
def test_a_joint_turns_in_proportion_to_its_moment_however_far(length, edges, bend):
    """Under a moment, beside the spring of half an edge: joints that are softer than it, and as soft."""
    moment = bend * EI
    torque = rn.PointTorque(on="beam.end", torque=(0, moment, 0))
    x = at_rest(torque, rn.JointCompliance(at="beam.start", length=length), edges=edges).x[-1]
    first = x[1] - x[0]
    k = EI / (0.5 * L / edges)
    own = np.linspace(0.0, 0.5, 20001)
    rod = np.interp(moment, 2.0 * k * np.tan(0.5 * own) / np.cos(0.5 * own) ** 2, own)
    angle = np.arctan2(-first[2], first[0])
    assert angle == pytest.approx(moment * length / EI + rod, rel=2e-3)


def test_what_a_joint_has_beyond_a_quadratic_energy():
    """Its factors join where a series takes over, and each is the derivative of the one before."""
    give = np.array([1e-3, 0.4, 30.0])
    for s in (0.999 * NEAR, 1.001 * NEAR, 0.3, 4.0):
        h = 1e-4 * s
        up, down, here = (beyond(np.full(3, v), give) for v in (s + h, s - h, s))
        for k in (0, 1):
            np.testing.assert_allclose((up[k] - down[k]) / (2.0 * h), here[k + 1], rtol=1e-5, atol=1e-7)
    below, above = (beyond(np.full(3, v), give) for v in (NEAR * (1 - 1e-12), NEAR))
    np.testing.assert_allclose(below[:2], above[:2], rtol=1e-7)
    np.testing.assert_allclose(below[2], above[2], rtol=1e-4)  # where the series ends
    assert not beyond(np.array([0.0, 0.5 * NEAR]), np.zeros(2)).any()


def test_natural_shapes_are_taken_without_a_load():
    x = at_rest(rn.NaturalAngle(at="beam.start", bend2=-0.3)).x[-1]
    ends = x[-1] / L
    assert np.hypot(*ends[[0, 2]]) == pytest.approx(1.0) and abs(ends[1]) < 1e-9
    assert abs(np.arctan2(ends[2], ends[0])) == pytest.approx(2 * np.arctan(0.15), rel=1e-6)
    arc = at_rest(rn.NaturalCurvature(kappa1=4.0)).x[-1]
    chord = 2.0 / 4.0 * np.sin(4.0 * L / 2.0)
    assert np.linalg.norm(arc[-1]) == pytest.approx(chord, rel=1e-3)
    rubber, line = rn.Material(E=E, nu=0.5, rho=1000.0), [(0, 0, 0), (L, 0, 0)]
    drawn = rn.StickFigure()
    drawn = drawn.rod("beam", line, edges=40, material=rubber, radius=R, natural_curvature=(4.0, 0.0)).build()
    other = rn.equilibrium(rn.Robot(drawn, [*(law() for law in ELASTIC), rn.Clamp(at="beam.start")])).x[-1]
    assert np.abs(arc - other).max() < 1e-5  # 2 tan(phi/2) or phi
    twisted = rn.equilibrium(beam(rn.NaturalCurvature(twist=5.0)))
    assert twisted.theta[-1, -1] == pytest.approx(5.0 * (L - 0.5 * L / 40), rel=1e-6)


def test_a_rod_that_took_on_its_shape_stays_in_it():
    """A straight rod drawn as a helix rests there if all of it is natural; half of an arc is an arc half as bent."""
    material = rn.Material(E=E, nu=0.5, rho=1000.0)
    turn = np.linspace(0.0, 4.0, 25)
    helix = np.stack([0.02 * np.cos(turn), 0.02 * np.sin(turn), 0.01 * turn], axis=1)
    fig = rn.StickFigure()
    fig.rod("beam", list(helix), material=material, radius=R, natural="straight", director=(0.2, 0.5, 1.0))
    laws = [*(law() for law in ELASTIC), rn.EarlierSet(share=1.0)]
    np.testing.assert_allclose(rn.equilibrium(rn.Robot(fig.build(), laws)).x[-1], helix, atol=1e-12)
    angle = np.linspace(0.0, 1.2, 61)
    arc = L / 1.2 * np.stack([np.sin(angle), 0.0 * angle, 1.0 - np.cos(angle)], axis=1)
    half = L / 0.6 * np.stack([np.sin(angle / 2), 0.0 * angle, 1.0 - np.cos(angle / 2)], axis=1)
    fig = rn.StickFigure()
    fig.rod("beam", list(arc), material=material, radius=R, natural="straight")
    laws = [*(law() for law in ELASTIC), rn.Clamp(at="beam.start"), rn.EarlierSet(share=0.5)]
    x = rn.equilibrium(rn.Robot(fig.build(), laws)).x[-1]
    first = np.array([np.cos(0.01), 0.0, np.sin(0.01)])  # a wall holds the first edge's direction
    ends = [p[-1] - p[0] for p in (x, half)]
    assert np.linalg.norm(ends[0]) == pytest.approx(np.linalg.norm(ends[1]), rel=1e-3)
    angles = [np.arccos(d @ e / np.linalg.norm(d)) for d, e in zip(ends, (first, np.eye(3)[0]), strict=True)]
    assert angles[0] == pytest.approx(angles[1], rel=0.03)


def test_a_moment_bends_a_cubic_rod_to_an_arc():
    h, moment = 5e-3, 4e-3
    torque = rn.PointTorque(on="beam.end", torque=(0, moment, 0))
    kappa = np.roots([EI * h, 0.0, EI, -moment])
    kappa = float(kappa[np.abs(kappa.imag) < 1e-9].real[0])
    x = at_rest(torque, rn.CubicBending(hardening=h), edges=40).x[-1]
    angle = 1.0 - 0.5 / 40  # the torque acts on the last edge
    assert np.arctan2(-x[-1, 2] + x[-2, 2], x[-1, 0] - x[-2, 0]) == pytest.approx(kappa * L * angle, rel=2e-3)


def test_a_set_creeps_to_its_share():
    """Deflection under a constant load: that of K at first, that of (1 - share) K at last, on an exponential."""
    share, time = 0.4, 0.5
    damped = rn.MassDamping(rate=20.0)
    start = beam(LOAD, damped, rn.PlasticSet(share=share, time=time), edges=8)
    traj = rn.Simulation(start, 0.01, stepper="sdirk2").run(4.0)
    final = sag(at_rest(LOAD, edges=8).x)
    tip = -traj.x[:, -1, 2] / final
    assert tip[-1] == pytest.approx(1.0 / (1.0 - share), rel=0.02)


@pytest.mark.parametrize(
    "soft",
    [rn.StiffnessDefect(loss=0.8, place=0.3, width=0.1), rn.SectionStiffness(first=-1.5, second=-1.0)],
    ids=["spot", "section"],
)
def test_a_set_is_a_share_of_what_the_rod_has_left(soft):
    """However soft it has become, it keeps 1 - share of it in the end, and sags as if it bore that much more."""
    share, damped = 0.6, rn.MassDamping(rate=4.0)
    more = rn.PointForce(at="beam.end", force=(0, 0, -1e-4 / (1.0 - share)))
    start = beam(LOAD, damped, soft, rn.PlasticSet(share=share, time=0.1), edges=8)
    tip = -rn.Simulation(start, 0.01, stepper="sdirk2").run(3.0).x[-1, -1, 2]
    assert tip == pytest.approx(sag(at_rest(more, soft, edges=8).x), rel=1e-3)


def test_a_set_is_replayed_with_its_memory():
    robot = beam(rn.Gravity(), rn.PlasticSet(share=0.4, time=0.05), edges=8)
    traj = rn.Simulation(robot, 5e-3, stepper="sdirk2", tolerance=rn.Tolerance(residual=1e-11)).run(0.1)
    powers = dict(traj.powers)
    kinetic = powers.pop("kinetic")
    assert np.abs(sum(powers.values()) - kinetic)[2:].max() < 5e-6 * max(
        np.abs(p).max() for p in powers.values()
    )


def test_masses_weigh():
    """A cantilever sags under a lump, or a weight that varies along it, as beam theory says."""
    plain, lumped, graded = (
        at_rest(rn.Gravity(g=0.1), *more)
        for more in ([], [rn.LocalMass(mass=1e-3, place=0.7, width=0.02)], [rn.MassGradient(slope=0.6)])
    )
    mass = 1000.0 * np.pi * R**2 * L
    x = L * S
    weight = 0.1 * mass / L * (1.0 + 0.6 * (S - 0.5))
    sagged = np.trapezoid(weight * x**2 * (3 * L - x) / (6 * EI), x)
    assert sag(graded.x) == pytest.approx(sagged, rel=2e-3)
    a = 0.7 * L
    assert sag(lumped.x) - sag(plain.x) == pytest.approx(1e-4 * a**2 * (3 * L - a) / (6 * EI), rel=5e-3)


def test_a_late_grip_is_where_it_was_before():
    t = np.linspace(0.0, 1.0, 21)
    path = rn.smooth_motion(t, np.stack([0.0 * t, 0.01 * t**2, 0.03 * np.sin(3.0 * t)], axis=1), 0.0)
    made = {"at": "beam.start", "position": path, "orientation": lambda t: np.eye(3), "name": "hand"}
    late = beam(rn.ImperfectMotion(lag=0.1, gain=0.5, **made), clamped=False, edges=6)
    x = rn.Simulation(late, 0.01, stepper="sdirk2").run(0.5).x[:, 0]
    t = np.linspace(0, 0.5, 51)
    np.testing.assert_allclose(x[1:], np.array([1.5 * path(s - 0.1) for s in t[1:]]), atol=1e-12)
    grasp = rn.ImperfectGrasp(
        at="beam:0-1",
        position=path,
        tangent=lambda t: np.array([1.0, 0.0, 0.0]),
        twist="no-spin",
        duration=1.0,
        shift_y=2e-3,
    )
    x = rn.Simulation(beam(grasp, clamped=False, edges=6), 0.01, stepper="sdirk2").run(0.1).x[-1]
    np.testing.assert_allclose(x[0], path(0.1) + np.array([0.0, 2e-3, 0.0]), atol=1e-12)


def test_a_grip_that_turns_too_far_turns_about_the_same_axis():
    axis, angle = np.array([2.0, -1.0, 2.0]) / 3.0, lambda t: 0.8 * np.sin(3.0 * t) ** 2
    made = {
        "at": "beam.start",
        "position": lambda t: np.zeros(3),
        "orientation": lambda t: Rotation.from_rotvec(angle(t) * axis).as_matrix(),
    }
    wide = rn.ImperfectMotion(turning=0.25, **made)
    for t in (0.1, 0.4, 0.7):
        R = wide.orientation(t, wide.values())
        np.testing.assert_allclose(Rotation.from_matrix(R).as_rotvec(), 1.25 * angle(t) * axis, atol=1e-14)


def test_what_hangs_on_a_shifted_grip_begins_shifted_and_at_rest():
    made = {"at": "beam.start", "orientation": lambda t: np.eye(3)}
    here = rn.Simulation(beam(rn.PrescribedMotion(**made), clamped=False, edges=6), 0.01)
    there = rn.Simulation(beam(rn.ImperfectMotion(shift_y=0.03, **made), clamped=False, edges=6), 0.01)
    moved = there.run(0.1).x - here.run(0.1).x
    np.testing.assert_allclose(moved, np.broadcast_to([0.0, 0.03, 0.0], moved.shape), atol=1e-13)
    # held at the other end, too, it is bent: only the grip is elsewhere
    both = beam(rn.ImperfectMotion(shift_y=0.003, **made), rn.Hinge(at="beam.end"), clamped=False, edges=6)
    x = rn.Simulation(both, 0.01).run(0.01).x[0] - beam(edges=6).graph.x0
    np.testing.assert_allclose(x[1:], 0.0, atol=1e-15)
    with pytest.raises(rn.errors.DisplacedStartError):
        rn.Simulation(
            beam(rn.ImperfectMotion(shift_y=0.03, **made), rn.Hinge(at="beam.end"), clamped=False, edges=6),
            0.01,
        )


@pytest.mark.parametrize("part", [0.4, 0.2])
def test_delays_that_are_spread_are_a_lag_of_first_order_up_to_the_third_power(part):
    # of a tow at frequency w a lag T of first order leaves 1 / (1 + i w T), and one delay exp(-i w T)
    T, w = 0.1, part
    times, weights = [], []
    for spread in (0.0, 1.0):
        bound = rn.ImperfectMotion(at="beam.start", position=lambda t: np.zeros(3), lag=T, spread=spread)
        pairs = bound.followed(0.0, bound.values())
        weights.append([weight for weight, _ in pairs])
        times.append([-t for _, t in pairs])
    assert times[0] == [T] and weights[0] == [1.0]
    moments = [np.dot(weights[1], np.power(times[1], n)) for n in range(4)]
    np.testing.assert_allclose(moments, [1.0, T, 2.0 * T**2, 6.0 * T**3], rtol=1e-12)  # n! T^n
    found = np.dot(weights[1], np.exp(-1j * w * np.array(times[1]) / T))
    assert abs(found - 1.0 / (1.0 + 1j * w)) < 0.2 * w**4  # fourth moments: 20 for 24, over 4!


def test_a_late_gripper_keeps_its_turn_and_its_edge():
    def turning(t):
        return Rotation.from_rotvec([0.0, 0.0, 2.0 * t]).as_matrix()

    made = {"at": "beam.start", "orientation": turning, "lag": 0.05, "spread": 1.0}
    late = rn.ImperfectMotion(**made)
    p = late.values()
    R = late.orientation(0.4, p)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    # of steady turning the mean of the directions; its angle is that of the weighted sum
    sums = sum(weight * np.exp(2j * t) for weight, t in late.followed(0.4, p))
    np.testing.assert_allclose(R, Rotation.from_rotvec([0.0, 0.0, np.angle(sums)]).as_matrix(), atol=1e-14)
    grasp = rn.ImperfectGrasp(
        at="beam:0-1", position=lambda t: np.array([0.0, 0.0, t]), tangent=lambda t: turning(t)[:, 0],
        twist="no-spin", duration=1.0, lag=0.05, spread=1.0,
    )  # fmt: skip
    start, end = grasp.position(0.4, np.array([[0.0, 0, 0], [0.3, 0, 0]]), grasp.values())
    np.testing.assert_allclose(start, [0.0, 0.0, 0.35], atol=1e-14)  # a steady tow: the mean delay
    assert np.linalg.norm(end - start) == pytest.approx(0.3, abs=1e-14)


def test_bad_input_is_named():
    with pytest.raises(rn.TermError, match="give both place= and width="):
        rn.NaturalCurvature(kappa1=1.0, place=0.5)
    with pytest.raises(rn.TermError, match="there is no bend-twist spring there"):
        beam(rn.JointCompliance(at="beam.end", length=0.1))
    with pytest.raises(rn.TermError, match="must not be zero"):
        rn.WallDrag(normal=(0, 0, 0))
    with pytest.raises(rn.ParameterError, match="outside its bounds"):
        rn.StiffnessDefect(loss=1.5)


def test_what_two_changes_leave_nothing_of_is_refused():
    """Each is a share of the rod's own stiffness; together they would make a spring that pushes."""
    spot = {"loss": 0.6, "place": 0.5, "width": 0.2}
    with pytest.raises(rn.TermError, match="'one', 'two' together take off more than all of the stiffness"):
        rn.Simulation(beam(*(rn.StiffnessDefect(**spot, name=n) for n in ("one", "two"))))


@pytest.mark.parametrize("term", [rn.LocalMass, rn.Tether])
def test_a_place_that_is_not_on_the_part_is_refused(term):
    strength = {"mass": 1e-3} if term is rn.LocalMass else {"fz": 1.0}
    with pytest.raises(rn.TermError, match=r"nothing of .* is near place = 0.95"):
        rn.Simulation(beam(term("beam:0-1", place=0.95, width=0.01, **strength)))
