"""Rods whose radius, material and natural shape vary along their length, against beams on paper."""

import numpy as np
import pytest
from scipy.integrate import quad

import rodnet as rn
from tests.mechanics.beams import MATERIAL, NU, RHO, E, L, elastic, end, order, rest

THICK, THIN = 4e-3, 1e-3
CLAMP = rn.Clamp(at="beam.start")


def radius(s):
    return THICK + (THIN - THICK) * s / L


def tapered(n, *terms, r=None, material=MATERIAL, **options):
    figure = rn.StickFigure()
    r = rn.Taper(THICK, THIN) if r is None else r
    figure.rod("beam", [(0, 0, 0), (L, 0, 0)], edges=n, material=material, radius=r, **options)
    return rn.Robot(figure.build(), [*elastic(), CLAMP, *terms])


def test_end_load_on_a_cone():
    """w = 4 P L^3 / (3 pi E R^3 r): integral of P (L - s)^2 / EI(s) over a cone from R to r."""
    P = 1e-7
    theory = 4.0 * P * L**3 / (3.0 * np.pi * E * THICK**3 * THIN)
    exact, _ = quad(lambda s: P * (L - s) ** 2 / (E * np.pi / 4.0 * radius(s) ** 4), 0.0, L)
    assert theory == pytest.approx(exact, rel=1e-9)
    sizes = (16, 32, 64, 128)
    load = rn.PointForce(at="beam.end", force=(0, P, 0))
    errors = [end(rest(tapered(n, load)), "beam.end")[1] / theory - 1.0 for n in sizes]
    assert order(sizes, errors) == pytest.approx(2.0, abs=0.1)
    assert abs(errors[-1]) < 1e-3


def test_end_torque_and_weight_of_a_cone():
    """Twist 2 T L (R^2 + R r + r^2) / (3 pi G R^3 r^3) up to the end; its mass is that of the cone."""
    T = 1e-6
    squares = THICK**2 + THICK * THIN + THIN**2
    rate = lambda s: T / (MATERIAL.G * np.pi / 2.0 * radius(s) ** 4)  # noqa: E731
    whole = 2.0 * T * L * squares / (3.0 * np.pi * MATERIAL.G * (THICK * THIN) ** 3)
    assert quad(rate, 0.0, L)[0] == pytest.approx(whole, rel=1e-9)
    load = rn.PointTorque(on="beam.end", torque=(0, 0, T), follower=True)
    sizes, errors, masses = (16, 32, 64), [], []
    for n in sizes:
        traj = rest(tapered(n, load))
        errors.append(traj.theta[-1, -1] / quad(rate, 0.0, L - L / (2 * n))[0] - 1.0)
        masses.append(traj.robot.graph.node_mass.sum() / (RHO * np.pi * L / 3.0 * squares) - 1.0)
    assert order(sizes, errors) > 1.85 and abs(errors[-1]) < 3e-3
    assert order(sizes, masses) == pytest.approx(2.0, abs=0.01)


def test_a_taper_a_function_and_an_array_are_the_same():
    n = 12
    middles = (np.arange(n) + 0.5) * L / n
    graphs = [tapered(n, r=r).graph for r in (None, radius, radius(middles), list(radius(middles)))]
    for graph in graphs:
        assert graph.radius == pytest.approx(radius(middles), rel=1e-14)
        assert graph.EI1 == pytest.approx(E * np.pi / 4 * radius(middles) ** 4, rel=1e-13)


def test_a_material_that_varies():
    """A cylinder with E(s) like a cone's EI bends like the cone."""
    P, n = 1e-7, 24
    load = rn.PointForce(at="beam.end", force=(0, 0, P))
    graded = tapered(
        n,
        load,
        r=THICK,
        material=lambda s: rn.Material(E=E * (radius(s) / THICK) ** 4, nu=NU, rho=RHO * (1 + s)),
    )
    assert end(rest(graded), "beam.end")[2] == pytest.approx(
        end(rest(tapered(n, load)), "beam.end")[2], rel=1e-5
    )
    middles = (np.arange(n) + 0.5) * L / n
    assert graded.parameters["beam.rho"].value == pytest.approx(RHO * (1 + middles))
    doubled = graded.with_parameters({"beam.E": 2.0 * graded.parameters["beam.E"].value})
    assert doubled.graph.EI1 == pytest.approx(2.0 * graded.graph.EI1)
    even = graded.with_parameters({"beam.E": E})
    assert even.graph.EA == pytest.approx(np.full(n, E * np.pi * THICK**2))
    one = tapered(n, r=THICK).with_parameters({"beam.E": np.linspace(1e6, 2e6, n)})
    assert one.graph.EA == pytest.approx(np.linspace(1e6, 2e6, n) * np.pi * THICK**2)


def test_sections_that_vary():
    n = 8
    strip = [rn.elliptic(2e-3, 1e-3 * (1 + k)) for k in range(n)]
    figure = rn.StickFigure()
    figure.rod("list", [(0, 0, 0), (L, 0, 0)], edges=n, material=MATERIAL, section=strip)
    figure.rod(
        "function",
        [(0, 1, 0), (L, 1, 0)],
        edges=n,
        material=MATERIAL,
        section=lambda s: strip[int(s / L * n)],
    )
    graph = figure.build()
    for rod in graph.rods.values():
        assert graph.EI2[rod.edges] == pytest.approx([E * section.I2 for section in strip])


def test_a_natural_curvature_that_varies():
    """Curvature c s: the rod is a clothoid, to second order."""
    c, errors, sizes = 60.0, [], (16, 32, 64)
    x, y = (quad(lambda s, f=f: f(0.5 * c * s * s), 0.0, L)[0] for f in (np.cos, np.sin))
    for n in sizes:
        options = {"natural_curvature": lambda s: (c * s, 0.0), "natural_twist": lambda s: 0.0}
        traj = rest(tapered(n, r=1e-3, director=(0, 1, 0), **options))
        assert traj.energies["bending"][-1] < 1e-15
        errors.append(np.linalg.norm(end(traj, "beam.end") - (x, y, 0)))
    assert order(sizes, errors) > 1.9
    assert errors[-1] < 1e-3 * L


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"r": [1e-3, 2e-3]}, "radius has 2 values for 8 edges"),
        ({"r": rn.Taper(1e-3, -1e-3)}, "must be a positive"),
        ({"r": lambda s: 0.0 * s}, "must be a positive"),
        ({"material": [MATERIAL]}, "material has 1 values for 8 edges"),
        ({"material": lambda s: 1e6}, "material must be a rodnet.Material, got float"),
        ({"material": rn.Material}, "material must be a rodnet.Material, got type"),
    ],
)
def test_lengthwise_input_that_makes_no_sense(options, message):
    with pytest.raises(rn.GraphError, match=message):
        tapered(8, **options)
