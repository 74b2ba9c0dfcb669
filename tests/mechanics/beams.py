"""Beams of one material to compare with theory, and what theory says where it has no formula."""

import numpy as np
from scipy.integrate import solve_bvp

import rodnet as rn

E, NU, RHO, R = 1e7, 0.5, 1000.0, 2e-3  # Pa, -, kg/m^3, m
L = 0.2  # m
MATERIAL = rn.Material(E=E, nu=NU, rho=RHO)
AREA = np.pi * R**2
EA = E * AREA
EI = E * np.pi / 4.0 * R**4
GJ = MATERIAL.G * np.pi / 2.0 * R**4
WEIGHT = RHO * AREA  # kg/m; times g it is the load per unit length


def elastic():
    return [rn.Stretching(), rn.Bending(), rn.Twisting()]


def beam(edges, *terms, points=((0.0, 0.0, 0.0), (L, 0.0, 0.0)), radius=R, **options):
    """A robot of one rod, "beam", with its elasticity and more terms."""
    if "section" not in options:
        options["radius"] = radius
    figure = rn.StickFigure()
    figure.rod("beam", points, edges=edges, material=MATERIAL, **options)
    return rn.Robot(figure.build(), [*elastic(), *terms])


def rest(robot, **options):
    """Equilibrium far below the discretisation error.

    Unbalanced nodal forces are measured against moments over edge lengths, so a beam of n edges
    amplifies them by about n^2.
    """
    return rn.equilibrium(robot, residual=1e-11, **options)


def end(traj, selector):
    """Last position of a node, shape (3,)."""
    return traj.x[-1, traj.robot.graph.node(selector)]


def order(sizes, errors):
    """Fitted exponent p of errors that fall as sizes^-p."""
    return -np.polyfit(np.log(sizes), np.log(np.abs(errors)), 1)[0]


def elastica(load, length=L):
    """Large deflection of a clamped extensible beam in a plane.

    ``load(s)`` is the downward force on what is beyond s [N], shape (n,). Returns the tip (x, z)
    and the bending moment at the clamp.
    """

    def slopes(s, y):
        angle, curvature = y[0], y[1]  # the angle is measured downward from the x axis
        stretch = 1.0 + load(s) * np.sin(angle) / EA
        return np.vstack(
            [
                curvature,
                -load(s) * np.cos(angle) * stretch / EI,
                np.cos(angle) * stretch,
                np.sin(angle) * stretch,
            ]
        )

    def ends(a, b):
        return np.array([a[0], b[1], a[2], a[3]])

    s = np.linspace(0.0, length, 201)
    guess = np.vstack([s / length, 0 * s, s, 0 * s])
    solution = solve_bvp(slopes, ends, s, guess, tol=1e-10, max_nodes=50_000)
    assert solution.success
    return solution.y[2, -1], -solution.y[3, -1], EI * solution.y[1, 0]
