"""Drag beside walls and beside other rods, against exact solutions and closed formulas."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import rodnet as rn
from rodnet.terms.drag.resistive import gray_hancock
from rodnet.testing import Probe, check_term
from tests.mechanics.beams import MATERIAL, WEIGHT, L, R, beam, elastic

SMOOTH = 1e-9  # roughness of walls that are compared with formulas for smooth ones


@pytest.mark.parametrize("law", [rn.PlaneWallForce, rn.TubeForce, rn.CrowdedForce])
@pytest.mark.parametrize("tangent", ["edge", "node"])
def test_laws_keep_the_contract(law, tangent):
    check_term(law(**law.example, tangent=tangent))
    check_term(law(**law.example, tangent=tangent, flow=rn.ShearFlow(2.0)))


NEAR = {
    "above a wall": lambda: rn.PlaneWallForce(viscosity=1.0, point=(0, 0, -0.01), normal=(0.1, 0.2, 1.0)),
    "on a wall": lambda: rn.PlaneWallForce(viscosity=1.0, point=(0, 0, -0.5 * R), roughness=0.5),
    "in a tube": lambda: rn.TubeForce(viscosity=1.0, tube_radius=0.03),
    "in a wide tube": lambda: rn.TubeForce(viscosity=1.0, tube_radius=0.4, point=(0, 0.01, 0)),
    "at a tube's wall": lambda: rn.TubeForce(
        viscosity=1.0, tube_radius=0.03, point=(0, 0.028, 0), roughness=0.5
    ),
}


@pytest.mark.parametrize("law", sorted(NEAR))
@pytest.mark.parametrize("speed", [0.1, 1e-9])
def test_jacobians_near_walls(law, speed):
    robot = rn.Robot(beam(4).graph, [NEAR[law]()])
    probe = Probe(robot, np.random.default_rng(1), speed=speed, turn=0.3, stretch=(0.9, 1.1))
    for error, where in probe.jacobian_errors().values():
        assert error < 1e-6, where


def drag_of(law, direction):
    """Resistance per unit length and viscosity of a straight rod along x, (force / velocity / length) [1]."""
    robot = rn.Robot(beam(2).graph, [law])
    v = np.tile(np.array(direction, dtype=float), (3, 1))
    force = rn.Simulation(robot, 1e-9, velocity=v).run(1e-9).term_forces(law.name, 0).sum(axis=0)
    return -force @ np.array(direction) / L


AXES = {"along": (1, 0, 0), "across": (0, 1, 0), "towards": (0, 0, 1)}


# -- a plane wall --------------------------------------------------------------------------------
def plane(height, length=None):
    return rn.PlaneWallForce(viscosity=1.0, point=(0, 0, -height), roughness=SMOOTH, length=length)


@pytest.mark.parametrize("axis", sorted(AXES))
def test_far_from_a_wall_drag_is_gray_and_hancock(axis):
    """The excess falls like 1/h: twice as far, half as much."""
    free = gray_hancock(1.0, L, R)[axis != "along"]
    excess = [drag_of(plane(h), AXES[axis]) / free - 1.0 for h in (20 * L, 40 * L)]
    assert 0.0 < excess[1] < 0.02
    assert excess[0] / excess[1] == pytest.approx(2.0, rel=0.03)


@pytest.mark.parametrize("axis", sorted(AXES))
def test_a_change_of_drag_by_a_wall_falls_off_as_the_theory_does(axis):
    """With the reach of far away it is right to 16 % down to a fifth of the rod's length."""

    def changed(height, reach):
        law = rn.WallDrag(position=-height, reach=reach, eta_t=1.0, eta_n=1.0)
        return drag_of(law, AXES[axis])

    free = gray_hancock(1.0, L, R)[axis != "along"]
    theory = {h: drag_of(plane(h * L), AXES[axis]) / free - 1.0 for h in (0.2, 1.0, 10.0, 40.0)}
    reach = 40 * L * theory[40.0]
    assert changed(10.0 * L, reach) == pytest.approx(theory[10.0], rel=0.03)
    assert changed(1.0 * L, reach) == pytest.approx(theory[1.0], rel=0.16)
    assert changed(0.2 * L, reach) == pytest.approx(theory[0.2], rel=0.16)


@pytest.mark.parametrize("height", [20 * R, 100 * R])
def test_a_long_rod_above_a_wall_is_that_of_brennen_and_winet(height):
    """2 pi / ln(2h/r), 4 pi / ln(2h/r), 4 pi / (ln(2h/r) - 1) for r << h << L."""
    log = np.log(2 * height / R)
    wanted = {"along": 2 * np.pi / log, "across": 4 * np.pi / log, "towards": 4 * np.pi / (log - 1.0)}
    for axis, value in wanted.items():
        assert drag_of(plane(height, 1e3), AXES[axis]) == pytest.approx(value, rel=3e-3)


def test_a_rod_that_nearly_touches_a_wall_is_lubricated():
    """2 pi sqrt(r/2d) and 4 pi sqrt(r/2d) along the wall, 12 pi (r/2d)^(3/2) towards it, for a gap d << r."""
    for gap in (1e-4 * R, 1e-3 * R):
        root = np.sqrt(R / (2 * gap))
        wanted = {"along": 2 * np.pi * root, "across": 4 * np.pi * root, "towards": 12 * np.pi * root**3}
        for axis, value in wanted.items():
            assert drag_of(plane(R + gap, 1e3), AXES[axis]) == pytest.approx(value, rel=2e-3)


def stokeslet_above_wall(x, h):
    """Velocity 8 pi mu u_i due to a unit point force j at (0, 0, h) above a wall, by its images (Blake 1971)."""
    one, flip = np.eye(3), np.diag([1.0, 1.0, -1.0])
    r, S = x - np.array([0, 0, h]), x + np.array([0, 0, h])
    point = lambda y: one / np.linalg.norm(y) + np.outer(y, y) / np.linalg.norm(y) ** 3  # noqa: E731

    def dipoles(y):  # h y_i / Y^3 - (delta_i3 / Y + y_i y_3 / Y^3)
        Y = np.linalg.norm(y)
        return h * y / Y**3 - (one[2] / Y + y * y[2] / Y**3)

    gradient = np.stack(
        [(dipoles(S + 1e-6 * one[k]) - dipoles(S - 1e-6 * one[k])) / 2e-6 for k in range(3)], axis=1
    )
    return point(r) - point(S) + 2 * h * gradient @ flip


@pytest.mark.parametrize("ratio", [0.2, 1.0, 5.0])
def test_images_in_the_wall_are_those_of_a_line_of_stokeslets(ratio):
    """The line's mobility drops by what its images do to its middle, integrated numerically."""
    height, length = 1.0, 1.0 / ratio
    s, w = np.polynomial.legendre.leggauss(60)
    wall = np.zeros((3, 3))
    for s_k, w_k in zip(length * s, length * w, strict=True):
        x = np.array([s_k, 0.0, height])
        r = x - np.array([0, 0, height])
        free = np.eye(3) / np.linalg.norm(r) + np.outer(r, r) / np.linalg.norm(r) ** 3
        wall += w_k * (stokeslet_above_wall(x, height) - free)
    radius = 1e-3
    free = np.array(gray_hancock(1.0, length, radius))[[0, 1, 1]]
    mobility = 8 * np.pi / free + np.diag(wall)
    law = rn.PlaneWallForce(viscosity=1.0, roughness=SMOOTH)
    eta, _ = law.resistances(np.full((1, 1), height), np.full((1, 1), radius), length, law.values())
    assert 8 * np.pi / eta[:, 0, 0] == pytest.approx(mobility, rel=1e-5)


def stokes_above_wall(height, velocity, terms=40):
    """Force per length and viscosity on a cylinder of unit radius above a wall, the real axis, by collocation.

    u + i v = phi - z conj(phi') - conj(psi) vanishes there if phi and psi, singular inside the cylinder, have the
    mirror images z F' + G and F - z (z F' + G)' added, where F(z) = conj(phi(conj z)) and G likewise.
    """
    z = 1j * height + np.exp(1j * np.linspace(0, 2 * np.pi, 4 * terms, endpoint=False))

    def powers(w):  # and two derivatives
        k = np.arange(1, terms)[:, None]
        return w**-k, -k * w ** (-k - 1), k * (k + 1) * w ** (-k - 2)

    logs = lambda w: (np.log(w), 1 / w, -1 / w**2)  # noqa: E731

    def flow(phi, psi):  # of functions of z - i height, with mirror images of z + i height
        (f, df, _), (g, _, _) = (h(z - 1j * height) for h in (phi, psi))
        (F, dF, ddF), (G, dG, _) = (np.conj(h(np.conj(z) - 1j * height)) for h in (phi, psi))
        direct = f - z * np.conj(df) - np.conj(g)
        return direct + z * dF + G - np.conj(F) - 2j * z.imag * np.conj(dF + z * ddF + dG)

    columns = []
    for c in (1.0, 1j):
        times = lambda h, c: lambda w: np.array([c * part for part in h(w)])  # noqa: E731
        zero = lambda w: np.zeros((3, 1, 1))  # noqa: E731
        columns += [*flow(times(powers, c), zero), *flow(zero, times(powers, c))]
        columns += [flow(times(logs, c), times(logs, -np.conj(c)))]
    A = np.array(columns).T
    wanted = np.full(len(z), velocity, dtype=complex)
    solution, *_ = np.linalg.lstsq(
        np.vstack([A.real, A.imag]), np.concatenate([wanted.real, wanted.imag]), rcond=1e-14
    )
    half = len(columns) // 2
    return 8 * np.pi * complex(solution[half - 1], solution[-1]) / velocity


@pytest.mark.parametrize("height", [1.1, 1.5, 4.0])
def test_drag_of_a_cylinder_beside_a_plane_is_that_of_stokes_flow(height):
    """Where it neither touches nor is far: Jeffrey and Onishi's closed forms against a solution of the equations."""
    law = rn.PlaneWallForce(viscosity=1.0, roughness=SMOOTH)
    (_, across, towards), _ = law.resistances(np.full((1, 1), height), np.ones((1, 1)), 1e9, law.values())
    assert across.item() == pytest.approx(-stokes_above_wall(height, 1.0), rel=1e-6)
    assert towards.item() == pytest.approx(-stokes_above_wall(height, 1j), rel=1e-6)


# -- a tube --------------------------------------------------------------------------------------
def stokes_in_annulus(tube, radius, eccentricity, velocity, terms=20):
    """Force per length and viscosity on a cylinder that moves in a tube, by collocation of Goursat's functions.

    u + i v = phi - z conj(phi') - conj(psi); the circle is centred on the real axis.
    """
    angle = np.exp(1j * np.linspace(0, 2 * np.pi, 4 * terms, endpoint=False))
    z = np.concatenate([tube * angle, eccentricity + radius * angle])
    w = z - eccentricity
    k = np.arange(1, terms)[:, None]
    powers = np.concatenate([np.ones((1, len(z))), (z / tube) ** k, (radius / w) ** k])
    slopes = np.concatenate([np.zeros((1, len(z))), k * (z / tube) ** k / z, -k * (radius / w) ** k / w])
    columns = []
    for c in (1.0, 1j):
        columns += [*(c * powers - z * np.conj(c * slopes)), *(-np.conj(c * powers[1:]))]
    columns += [2 * c * np.log(abs(w)) - z * np.conj(c / w) for c in (1.0, 1j)]  # a point force
    wanted = np.concatenate([0 * angle, velocity + 0 * angle])
    A, b = np.array(columns).T, wanted
    solution, *_ = np.linalg.lstsq(np.vstack([A.real, A.imag]), np.concatenate([b.real, b.imag]), rcond=1e-14)
    return 8 * np.pi * complex(solution[-2], solution[-1]) / velocity


@pytest.mark.parametrize(
    ("tube", "radius", "eccentricity"), [(0.053, 0.0032, 0.0), (0.053, 0.0032, 0.02), (1.0, 0.3, 0.4)]
)
def test_drag_in_a_tube_is_that_of_stokes_flow_between_eccentric_cylinders(tube, radius, eccentricity):
    law = rn.TubeForce(viscosity=1.0, tube_radius=tube, roughness=SMOOTH)
    d, r = np.full((1, 1), eccentricity), np.full((1, 1), radius)
    (_, around, towards), _ = law.resistances(d, r, 1e9, law.values())
    assert towards.item() == pytest.approx(-stokes_in_annulus(tube, radius, eccentricity, 1.0), rel=1e-9)
    assert around.item() == pytest.approx(-stokes_in_annulus(tube, radius, eccentricity, 1j), rel=1e-9)


def test_a_tube_that_is_wide_is_no_tube_and_one_that_is_near_is_a_wall():
    for axis, direction in AXES.items():
        free = gray_hancock(1.0, L, R)[axis != "along"]
        assert drag_of(rn.TubeForce(viscosity=1.0, tube_radius=1e4 * L), direction) == pytest.approx(
            free, rel=1e-6
        )
        wide = rn.TubeForce(
            viscosity=1.0, tube_radius=1e3 * R, point=(0, 0, 990 * R), roughness=SMOOTH, length=1e6
        )
        assert drag_of(wide, direction) == pytest.approx(drag_of(plane(10 * R, 1e6), direction), rel=0.02)


def test_drag_on_the_axis_of_a_tube():
    """2 pi / ln(R/r) along, 4 pi / (ln(R/r) - (R^2 - r^2)/(R^2 + r^2)) across."""
    tube = 0.0265
    law = rn.TubeForce(viscosity=1.0, tube_radius=tube, roughness=SMOOTH, length=1e6)
    log = np.log(tube / R)
    assert drag_of(law, AXES["along"]) == pytest.approx(2 * np.pi / log)
    across = 4 * np.pi / (log - (tube**2 - R**2) / (tube**2 + R**2))
    assert drag_of(law, AXES["across"]) == pytest.approx(across)
    assert drag_of(law, AXES["towards"]) == pytest.approx(across)


def test_a_rod_sinks_towards_a_wall_ever_slower():
    """The gap follows the exact law of a cylinder beside a wall; it never closes."""
    load, mu = 50.0, 1.0
    wall = rn.PlaneWallForce(viscosity=mu, point=(0, 0, -1.2 * R), roughness=SMOOTH, length=1e3)
    traj = rn.Simulation(beam(4, rn.Gravity(g=load / WEIGHT), wall), 5e-5, stepper="sdirk2").run(0.02)
    gap = traj.x[:, 2, 2] + 0.2 * R
    assert np.all(gap > 0.0) and np.all(np.diff(gap) < 0.0) and gap[-1] < 5e-3 * R

    def speed(t, g):
        X = 1.0 + g / R
        return -load / (4 * np.pi * mu) * (np.arccosh(X) - np.sqrt(X**2 - 1.0) / X)

    exact = solve_ivp(speed, (0.0, 0.02), [0.2 * R], rtol=1e-9, atol=1e-15, t_eval=[0.01, 0.02]).y[0]
    assert gap[[200, 400]] == pytest.approx(exact, rel=1e-2)


def test_rods_that_start_in_a_wall_are_named():
    with pytest.raises(rn.TermError, match=r"beam:0.*behind the wall"):
        beam(4, rn.PlaneWallForce(viscosity=1.0, point=(0, 0, 0.01)))
    with pytest.raises(rn.TermError, match=r"'beam:\d'.*outside the tube"):
        beam(4, rn.TubeForce(viscosity=1.0, tube_radius=0.01, point=(0, 0.02, 0)))
    with pytest.raises(rn.TermError, match="not slender"):
        beam(4, rn.PlaneWallForce(viscosity=1.0, point=(0, 0, -1), length=2 * R))
    with pytest.raises(rn.TermError, match="normal must not be zero"):
        rn.PlaneWallForce(viscosity=1.0, normal=(0, 0, 0))


# -- neighbours ----------------------------------------------------------------------------------
def pair(distance, *terms, edges=40):
    """Two parallel rods along x, a distance apart along y."""
    figure = rn.StickFigure()
    for name, y in (("a", 0.0), ("b", distance)):
        figure.rod(name, [(0, y, 0), (L, y, 0)], edges=edges, material=MATERIAL, radius=R)
    return rn.Robot(figure.build(), [*elastic(), *terms])


def beside_a_long_rod(d):
    """Crowd at a distance over the range, of a soft one: the integral of what pieces count."""
    q = max(1.0 - d**2, 0.0)
    return 6.6 * q**3.5 - 8.8 * q**4.5 + 3.2 * q**5.5


@pytest.mark.parametrize("crowding", [1.0, -0.7])
@pytest.mark.parametrize("distance", [2 * R, 0.01, 0.019, 0.021])
def test_drag_beside_a_parallel_rod(crowding, distance):
    """exp(crowding n) times as large in the middle, half of that logarithm at the ends."""
    reach = 0.02
    law = rn.CrowdedForce(viscosity=1.0, crowding=crowding, range=reach)
    robot = pair(distance, law, edges=80)
    velocity = np.tile((0, 0, 1.0), (robot.graph.node_count, 1))
    force = rn.Simulation(robot, 1e-9, velocity=velocity).run(1e-9).term_forces("drag", 0)[:, 2]
    alone = -gray_hancock(1.0, L, R)[1] * L / 80
    crowd = beside_a_long_rod(distance / reach)
    assert force[40] / alone == pytest.approx(np.exp(crowding * crowd), rel=2e-3)
    assert force[0] / (0.5 * alone) == pytest.approx(np.exp(0.5 * crowding * crowd), rel=2e-3)


def test_neither_a_straight_rod_nor_one_that_goes_on_crowds_itself_but_a_fold_does():
    law = rn.CrowdedForce(viscosity=1.0, crowding=1.0, range=0.02)
    figure = rn.StickFigure()
    figure.rod("a", [(0, 0, 0), (0.1, 0, 0)], edges=20, material=MATERIAL, radius=R)
    figure.rod("b", ["a.end", (0.2, 0, 0)], edges=20, material=MATERIAL, radius=R)
    drags = []
    for terms in ([law], [rn.ResistiveForce(viscosity=1.0)]):
        robot = rn.Robot(figure.build(), [*elastic(), *terms])
        velocity = np.tile((0, 0, 1.0), (robot.graph.node_count, 1))
        drags.append(rn.Simulation(robot, 1e-9, velocity=velocity).run(1e-9).term_forces("drag", 0))
    assert drags[0] == pytest.approx(drags[1], rel=1e-12)
    fold = rn.StickFigure()
    points = [(0, 0, 0), (0.1, 0, 0), (0.1, 0.01, 0), (0, 0.01, 0)]
    fold.rod("fold", points, edges=40, material=MATERIAL, radius=R)
    bound = rn.Simulation(rn.Robot(fold.build(), [*elastic(), law]), 0.01).model.bound[-1]
    assert bound.memory[0, 0] == pytest.approx(0.5 * beside_a_long_rod(0.5), rel=0.01)


@pytest.mark.parametrize("angle", [30.0, 60.0, 120.0])
def test_rods_that_meet_crowd_each_other_by_what_is_not_next_along_them(angle):
    """At a distance s from the joint: the integral over the other rod at that angle, from the range along them on."""
    a, edges, turn = 0.02, 200, np.radians(angle)
    figure = rn.StickFigure()
    figure.rod("one", [(0, 0, 0), (0.1, 0, 0)], edges=edges, material=MATERIAL, radius=R)
    end = (0.1 * np.cos(turn), 0.1 * np.sin(turn), 0.0)
    figure.rod("other", ["one.start", end], edges=edges, material=MATERIAL, radius=R)
    law = rn.CrowdedForce(viscosity=1.0, crowding=1.0, range=a)
    bound = rn.Simulation(rn.Robot(figure.build(), [*elastic(), law]), 0.01).model.bound[-1]
    t = (np.arange(40000) + 0.5) * 0.1 / 40000

    def step(u):
        u = np.clip(u, 0.0, 1.0)
        return 10.0 * u**3 - 15.0 * u**4 + 6.0 * u**5

    for k in (0, 8, 20, 39, 60):
        s = 0.1 * k / edges
        square = s**2 + t**2 - 2.0 * s * t * np.cos(turn)
        crowd = 231.0 / 320.0 / a * np.sum(step(1.0 - square / a**2) * step((s + t) / a - 1.0)) * 0.1 / 40000
        assert bound.memory[list(bound.node).index(k), 0] == pytest.approx(crowd, abs=2e-3)


@pytest.mark.parametrize("length", [0.02, 0.2])
def test_a_hard_crowd_is_a_step_in_the_distance(length):
    """One neighbour or a piece of one, at once as near as it has to be, raises the drag by the whole factor."""
    law = rn.CrowdedForce(viscosity=1.0, crowding=1.0, range=0.04, softness=0.1)
    logarithms = []
    for distance in (0.01, 0.034, 0.041):
        figure = rn.StickFigure()
        figure.rod("a", [(0, 0, 0), (0.2, 0, 0)], edges=40, material=MATERIAL, radius=R)
        middle = 0.1
        ends = [(middle - 0.5 * length, distance, 0), (middle + 0.5 * length, distance, 0)]
        figure.rod("b", ends, edges=round(200 * length), material=MATERIAL, radius=R)
        robot = rn.Robot(figure.build(), [*elastic(), law])
        velocity = np.tile((0, 0, 1.0), (robot.graph.node_count, 1))
        force = rn.Simulation(robot, 1e-9, velocity=velocity).run(1e-9).term_forces("drag", 0)[20, 2]
        logarithms.append(np.log(-force / (gray_hancock(1.0, 0.2, R)[1] * 0.2 / 40)))
    drag_of_its_own = logarithms[-1]
    assert logarithms[0] - drag_of_its_own == pytest.approx(1.0, abs=0.02)
    assert logarithms[1] - drag_of_its_own == pytest.approx(1.0, abs=0.05)


def test_a_mesh_that_is_too_coarse_for_a_crowd_is_refused():
    """Else a neighbour between two nodes is not felt; half the range is enough, to a few per cent, wherever it is."""
    law = rn.CrowdedForce(viscosity=1.0, crowding=1.0, range=0.02)
    with pytest.raises(
        rn.TermError, match=r"rod 'a' is 0\.025 m .* edges=20 or more, or .* range of 0\.05 m"
    ):
        rn.Simulation(pair(0.01, law, edges=8), 0.01)
    for shift in (0.0, 0.0025, 0.005):
        figure = rn.StickFigure()
        for name, x, y in (("a", 0.0, 0.0), ("b", shift, 0.01)):
            figure.rod(name, [(x, y, 0), (x + L, y, 0)], edges=20, material=MATERIAL, radius=R)
        bound = rn.Simulation(rn.Robot(figure.build(), [*elastic(), law]), 0.01).model.bound[-1]
        assert bound.memory[10, 0] == pytest.approx(beside_a_long_rod(0.5), rel=0.05)


def test_crowds_are_second_order_in_time():
    """Two rods are driven together while they are pulled along: with sdirk2 errors fall as dt^2."""

    def run(dt):
        law = rn.CrowdedForce(viscosity=1.0, crowding=1.5, range=0.1, length=L)
        push = rn.PointForce(at=["a:0", "a:2", "a:4"], force=(0.01, 0.06, 0))
        pull = rn.PointForce(at=["b:0", "b:2", "b:4"], force=(0, -0.06, 0), name="other")
        return rn.Simulation(pair(0.1, law, push, pull, edges=4), dt, stepper="sdirk2").run(0.32).x[-1]

    fine = run(0.00125)
    errors = [np.abs(run(dt) - fine).max() for dt in (0.02, 0.01, 0.005)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(orders > 1.6), (errors, orders)


def test_crowds_survive_restart_bit_for_bit(tmp_path):
    law = rn.CrowdedForce(viscosity=1.0, crowding=1.5, range=0.1)
    pull = rn.PointForce(at="b:1", force=(0.01, -0.05, 0))
    robot = pair(0.02, law, pull, edges=4)
    whole = rn.Simulation(robot, 0.01, stepper="sdirk2").run(0.2)
    half = rn.Simulation(robot, 0.01, stepper="sdirk2").run(0.1)
    half.save(tmp_path / "half.nc")
    sim = rn.Simulation(robot, 0.01, stepper="sdirk2")
    sim.restore(rn.Trajectory.load(tmp_path / "half.nc", robot).state(-1))
    assert np.array_equal(sim.run(0.1).x[-1], whole.x[-1])
    # a recorded state is evaluated again with the crowd that its step had
    power = whole.powers["drag"] + whole.powers["force"] + whole.powers["elastic"]
    assert power[5:] == pytest.approx(
        whole.powers["kinetic"][5:], abs=1e-6 * np.abs(whole.powers["force"]).max()
    )
