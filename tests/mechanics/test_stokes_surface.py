"""Resistance of closed surfaces against exact solutions, and its use as a head."""

import numpy as np
import pytest
import trimesh
from scipy.integrate import quad

import rodnet as rn
from rodnet.terms.drag.surface_kernels import averaged_layer, single_layer


def ellipsoid(*axes, subdivisions=4):
    """A fine mesh of an ellipsoid with these half axes [m]."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    mesh.vertices = mesh.vertices * axes
    return mesh


def exact(*axes):
    """Resistance of an ellipsoid in its axes, unit viscosity (Jeffery 1922; Happel & Brenner 1983), shape (6, 6)."""
    a = np.array(axes) / max(axes)
    delta = lambda s: np.sqrt(np.prod(a**2 + s))  # noqa: E731
    integral = lambda f: quad(lambda u: f(np.exp(u)) * np.exp(u), -40.0, 60.0, limit=500)[0]  # noqa: E731
    chi = integral(lambda s: 1.0 / delta(s))
    alpha = np.array([integral(lambda s, k=k: 1.0 / ((a[k] ** 2 + s) * delta(s))) for k in range(3)])
    force = 16.0 * np.pi / (chi + alpha * a**2)
    square, weighted = a**2, a**2 * alpha
    torque = [
        16.0 * np.pi / 3.0 * (square[j] + square[k]) / (weighted[j] + weighted[k])
        for j, k in ((1, 2), (2, 0), (0, 1))
    ]
    return np.diag([*(force * max(axes)), *(np.array(torque) * max(axes) ** 3)])


@pytest.mark.parametrize(
    "axes",
    [(0.02, 0.02, 0.02), (0.06, 0.02, 0.02), (0.02, 0.02, 0.008), (0.03, 0.02, 0.01)],
    ids=["sphere", "prolate", "oblate", "triaxial"],
)
def test_ellipsoids(axes):
    """Within 1 % of the exact resistances, here 0.4 %; no coupling about the centre."""
    R = rn.stokes_resistance(ellipsoid(*axes), faces=600)
    unit = np.sqrt(np.diag(exact(*axes)))
    assert np.abs((R - exact(*axes)) / np.outer(unit, unit)).max() < 4e-3


@pytest.mark.parametrize(
    "axes",
    [(0.02, 0.02, 0.0004), (0.02, 0.02, 0.0001), (0.6, 0.006, 0.006), (0.6, 0.002, 0.002)],
    ids=["lens 1:50", "lens 1:200", "needle 100:1", "needle 300:1"],
)
def test_lenses_and_needles(axes):
    """However thin: within 1 %."""
    R = rn.stokes_resistance(ellipsoid(*axes), faces=360)
    unit = np.sqrt(np.diag(exact(*axes)))
    assert np.abs((R - exact(*axes)) / np.outer(unit, unit)).max() < 0.01


@pytest.mark.parametrize("thickness", [1e-3, 1e-6])
def test_discs(thickness):
    """A thin disc: 32/3, 32/3 and 16 for the force, 32/3 about any axis (Oberbeck 1876; Happel & Brenner 1983)."""
    disc = trimesh.creation.cylinder(radius=1.0, height=thickness, sections=48)
    R = rn.stokes_resistance(disc, faces=800, scale=0.1)
    known = np.array([32 / 3, 32 / 3, 16, *[32 / 3] * 3]) * np.repeat([0.1, 1e-3], 3)
    assert np.diag(R) == pytest.approx(known, rel=0.01)
    assert np.linalg.eigvalsh(R).min() > 0.0


def test_thin_plates_tend_to_one_without_thickness():
    """A square plate thinner and thinner: resistances fall, by less and less, and stay above its incircle's."""
    plates = [
        np.diag(rn.stokes_resistance(trimesh.creation.box((0.02, 0.02, h)), faces=320))
        / np.repeat([0.01, 1e-6], 3)
        for h in (2e-3, 2e-4, 2e-5)
    ]
    steps = -np.diff(plates, axis=0)
    assert (steps > 0).all() and (steps[1:] < steps[:-1]).all()
    assert (plates[-1] > [32 / 3, 32 / 3, 16, 32 / 3, 32 / 3, 32 / 3]).all()


def test_the_integral_over_two_triangles():
    """Outer integrals next to, above and far from a triangle, against averages over many small parts."""
    first = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.2, 0.8, 0.0)])
    others = [
        first[[1, 0, 2]] * [1, -1, 1],
        first + np.array([0.1, 0.05, 0.02]),
        first * [0.5, 0.01, 1.0] + [0, 0, 1e-3],
        first + np.array([0, 0, 3]),
    ]
    for other in others:
        corners = np.array([first, other])
        area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        size = np.linalg.norm(area, axis=1)
        A = np.empty((6, 6))
        averaged_layer(corners, area / size[:, None], size, A)
        n = 200
        i, j = (k.ravel() for k in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
        up = i + j < n
        mirrored = i + j < n - 1
        u = np.concatenate([(i[up] + 1 / 3) / n, (i[mirrored] + 2 / 3) / n])
        v = np.concatenate([(j[up] + 1 / 3) / n, (j[mirrored] + 2 / 3) / n])
        points = other[0] + u[:, None] * (other[1] - other[0]) + v[:, None] * (other[2] - other[0])
        fine = np.empty((3 * len(points), 3))
        single_layer(corners[:1], (area / size[:, None])[:1], points, fine)
        mean = size[1] * fine.reshape(-1, 3, 3).mean(axis=0)
        assert A[3:, :3] == pytest.approx(mean, rel=2e-3, abs=2e-3 * np.abs(mean).max())
        assert A == pytest.approx(A.T, abs=1e-14)


def test_the_integral_over_a_triangle():
    """Against a fine product rule, from points above, beside and in the plane of a triangle."""
    corners = np.array([[[0.1, 0.0, 0.2], [1.3, 0.2, 0.0], [0.3, 0.9, -0.4]]])
    a, b, c = corners[0]
    area = np.cross(b - a, c - a)
    double = np.linalg.norm(area)
    points = np.array(
        [[0.3, 0.4, 0.9], [2.0, -1.0, 0.3], a + 1.5 * (b - a) + 0.4 * (c - a), [0.5, 0.3, -0.8]]
    )
    A = np.empty((12, 3))
    single_layer(corners, area[None] / double, points, A)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    s, w = 0.5 * (nodes + 1.0), 0.5 * weights
    u, v = s[:, None], s[None, :] * (1.0 - s[:, None])
    w = (w[:, None] * w * (1.0 - u) * double)[..., None, None]
    y = a + u[..., None] * (b - a) + v[..., None] * (c - a)
    for k, point in enumerate(points):
        r = y - point
        d = np.linalg.norm(r, axis=-1)[..., None, None]
        kernel = np.eye(3) / d + r[..., :, None] * r[..., None, :] / d**3
        assert A[3 * k : 3 * k + 3] == pytest.approx((w * kernel).sum(axis=(0, 1)), rel=1e-9, abs=1e-12)


def test_a_cuboid_converges():
    """Finer triangles change the resistances of a cube less and less; its faces are alike."""
    cube = trimesh.creation.box((1.0, 1.0, 1.0))
    first, coarse, fine = (rn.stokes_resistance(cube, faces=n) for n in (160, 400, 800))
    change, last = (np.abs(np.diag(b) / np.diag(a) - 1.0).max() for a, b in ((first, coarse), (coarse, fine)))
    assert last < 0.4 * change and last < 3e-3
    assert np.diag(fine)[:3] == pytest.approx(np.full(3, fine[0, 0]), rel=1e-3)
    assert np.abs(fine - np.diag(np.diag(fine))).max() < 5e-3 * fine[0, 0]
    # between the spheres inside and around it (Hill & Power 1956), and near that of as much volume
    radius, torque = fine[0, 0] / (6.0 * np.pi), (fine[3, 3] / (8.0 * np.pi)) ** (1.0 / 3.0)
    for value in (radius, torque):
        assert (3.0 / (4.0 * np.pi)) ** (1.0 / 3.0) < value < np.sqrt(0.75)


def test_place_and_pose_only_change_the_frame():
    """R about another point is that of the moved velocity; a turned and moved mesh has the turned matrix."""
    mesh = ellipsoid(0.03, 0.02, 0.01, subdivisions=2)
    R = rn.stokes_resistance(mesh, about=(0, 0, 0), faces=400)
    p = np.array([0.01, -0.02, 0.005])
    shift = np.eye(6)
    shift[:3, 3:] = np.stack([np.cross(e, -p) for e in np.eye(3)], axis=1)
    about = rn.stokes_resistance(mesh, about=p, faces=400)
    assert about == pytest.approx(shift.T @ R @ shift, rel=1e-9, abs=1e-12)
    turn = trimesh.transformations.rotation_matrix(1.1, (0.3, -0.5, 0.8))
    moved = mesh.copy().apply_transform(trimesh.transformations.translation_matrix((1.0, 2.0, 3.0)) @ turn)
    both = np.kron(np.eye(2), turn[:3, :3])
    turned = rn.stokes_resistance(moved, about=(1.0, 2.0, 3.0), faces=400)
    # where the outer integrals are refined is decided by comparisons, in which rounding has a say
    unit = np.sqrt(np.diag(R))
    assert np.abs((turned - both @ R @ both.T) / np.outer(unit, unit)).max() < 1e-5


def test_units_of_the_mesh_and_of_the_medium():
    mesh = ellipsoid(30.0, 20.0, 10.0, subdivisions=2)
    with pytest.warns(UserWarning, match="scale=1e-3"):
        huge = rn.stokes_resistance(mesh, faces=400)
    R = rn.stokes_resistance(mesh, 2.0, scale=1e-3, faces=400)
    units = np.outer(*[np.repeat([1.0, 1e-3], 3)] * 2)
    assert R == pytest.approx(2.0 * 1e-3 * units * huge, rel=1e-9, abs=1e-15)


def box(extent=0.02):
    return trimesh.creation.box((extent,) * 3)


def opened():
    mesh = box()
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    return mesh


BROKEN = {
    "open": (opened, "is open"),
    "two": (lambda: trimesh.util.concatenate([box(), box().apply_translation((0.1, 0, 0))]), "2 pieces"),
    "flat": (lambda: trimesh.creation.box((0.02, 0.02, 1e-14)), "flat|open"),
    "missing": (lambda: "nowhere.stl", "no mesh file"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken_surfaces_are_refused(case):
    mesh, message = BROKEN[case]
    with pytest.raises(rn.GraphError, match=message):
        rn.stokes_resistance(mesh())


@pytest.mark.parametrize("bad", [{"viscosity": -1.0}, {"scale": 0.0}, {"faces": np.nan}, {"about": (0, 1)}])
def test_bad_numbers_are_refused(bad):
    with pytest.raises(rn.ParameterError, match=next(iter(bad))):
        rn.stokes_resistance(box(), **bad)


def test_a_head_of_any_shape_sinks_as_stokes_says(tmp_path):
    """An ellipsoid held at 45 degrees drifts sideways by its anisotropy; its shape is kept in a file."""
    path = tmp_path / "head.stl"
    ellipsoid(0.06, 0.02, 0.02, subdivisions=3).apply_transform(
        trimesh.transformations.rotation_matrix(np.pi / 4, (0, 1, 0))
    ).export(path)
    mu = rn.Parameter(5.0, unit="Pa s", bounds=(0, None))
    shape = rn.stokes_resistance(path, faces=400)
    fig = rn.StickFigure()
    points = [(-0.01, 0, 0), (0, 0, 0), (0.01, 0, 0)]
    fig.rod("head", points, material=rn.Material(E=1e7, nu=0.5, rho=1000.0), radius=3e-3)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.PointForce(at="head:1", force=(0, 0, -0.1))]
    robot = rn.Robot(fig.build(), [*terms, rn.StokesHead(at="head:1", viscosity=mu, shape=shape)])
    traj = rn.Simulation(robot, 1e-2).run(0.2)
    along = np.array([1.0, 0.0, -1.0]) / np.sqrt(2.0)
    known = np.diag(exact(0.06, 0.02, 0.02))
    mobility = np.eye(3) / known[1] + (1.0 / known[0] - 1.0 / known[1]) * np.outer(along, along)
    assert traj.v[-1, 1] == pytest.approx(mobility @ (0, 0, -0.1) / 5.0, rel=2e-2, abs=1e-5)
    assert robot.parameters["head.viscosity"] is mu


def test_a_closed_mesh_becomes_a_rigid_head_that_sinks():
    """Mass, inertia and resistance of one mesh: a box falls as its weight over its drag says, the way it lies."""
    mesh = trimesh.creation.box((0.04, 0.025, 0.02))
    mesh.density = 1200.0
    R = rn.stokes_resistance(mesh, about=(0, 0, 0), faces=300)
    fig = rn.StickFigure()
    fig.rigid("head", [(0.02, 0, 0), (0, 0, 0), (-0.02, 0, 0)], radius=0.01)
    fig.body("head", mass=mesh.mass, com=mesh.center_mass, inertia=mesh.moment_inertia)
    robot = rn.Robot(fig.build(), [rn.Gravity(), rn.StokesHead(at="head:1", viscosity=5.0, shape=R)])
    traj = rn.Simulation(robot, 1e-3).run(0.2)
    assert traj.v[-1, 1] == pytest.approx([0.0, 0.0, -9.81 * mesh.mass / (5.0 * R[2, 2])], rel=1e-3, abs=1e-5)


@pytest.mark.parametrize(
    "options",
    [
        {"shape": np.eye(6)},
        {"shape": np.eye(6), "viscosity": 1.0, "resistance": np.eye(6)},
        {"viscosity": 1.0},
    ],
)
def test_a_head_is_told_its_shape_in_one_way(options):
    with pytest.raises(rn.TermError, match="StokesHead: "):
        rn.StokesHead(at="head:1", **options)


@pytest.mark.parametrize("radius", [1e-6, 1e-3])
def test_meshes_of_micrometres_and_millimetres(radius):
    """A fine mesh in metres of a tiny ball is neither open nor flat, and as good as that of a ball of a metre."""
    ball = trimesh.creation.icosphere(subdivisions=5)
    tiny = trimesh.Trimesh(radius * ball.vertices, ball.faces, process=False)
    R = np.diag(rn.stokes_resistance(tiny, faces=200))
    assert R == pytest.approx(np.repeat([6 * np.pi * radius, 8 * np.pi * radius**3], 3), rel=0.01)
