"""Columns under pressure buckle at Euler's loads, and go where the elastica says."""

import matplotlib.pyplot as plt
import numpy as np
from gallery import Case, Check, order, show

import rodnet as rn

L, R = 0.2, 1e-3  # m
MATERIAL = rn.Material(E=1e7)
EI = MATERIAL.E * np.pi / 4 * R**4
UNIT = EI / L**2  # N
# supports -> Euler's load in units of EI / L^2
LOADS = {
    "clamped, free": np.pi**2 / 4,
    "hinged, hinged": np.pi**2,
    "clamped, hinged": 20.190729,  # tan x = x
    "clamped, clamped": 4 * np.pi**2,
}


class Slide(rn.Constraint):
    """Holds the end of the column on its axis: the column is shortened by ``way``, and so pressed."""

    way = rn.Parameter(0.0, unit="m")

    def position(self, t, x0, p):
        return x0 - (p.way, 0.0, 0.0)


class Guide(Slide):
    """Holds its direction, too."""

    holds = {"position", "orientation"}


def column(supports, load, edges=32, push=0.0):
    """A column under a load in units of EI / L^2; a free end may be pushed aside."""
    fig = rn.StickFigure()
    fig.rod("beam", [(0, 0, 0), (L, 0, 0)], edges=edges, material=MATERIAL, radius=R)
    lower, upper = supports.split(", ")
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting()]
    terms.append((rn.Clamp if lower == "clamped" else rn.Hinge)(at="beam.start"))
    if upper == "free":
        terms.append(rn.PointForce(at="beam.end", force=(-load * UNIT, 0, push * UNIT)))
    else:
        shorter = load * UNIT * L / (MATERIAL.E * np.pi * R**2)
        terms.append((Guide if upper == "clamped" else Slide)(at="beam.end", way=shorter))
    return rn.Robot(fig.build(), terms)


def critical(supports, edges=32):
    theory = LOADS[supports]
    found = rn.critical_load(lambda p: column(supports, p, edges), 0.5 * theory, 1.5 * theory, steps=2)
    return found.load, found.mode.x[0].real


def main():
    sizes = [16, 32, 64]
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
    checks = []
    for supports, theory in LOADS.items():
        found = [critical(supports, n) for n in sizes]
        errors = [abs(load / theory - 1) for load, _ in found]
        shape = found[-1][1]
        side = np.linalg.svd(shape, full_matrices=False)[2][0]  # the plane in which it buckles
        bulge = shape @ side
        left.plot(np.linspace(0, 1, len(bulge)), bulge * np.sign(bulge.sum()), label=supports)
        right.loglog(sizes, errors, "o-", label=f"order {order(sizes, errors):.2f}")
        checks.append(Check(f"P L²/EI, {supports}", theory, found[-1][0]))
    left.set(xlabel="x / L", title="buckling modes")
    left.legend()
    right.set(xlabel="edges", title="relative error of the load")
    right.legend()
    # beyond its load the clamped column bends over; 40 degrees at the end belong to 1.0637 times Euler's load
    load = 1.0637 * LOADS["clamped, free"]
    pushed = rn.equilibrium(
        column("clamped, free", load, 64, push=0.01)
    ).state()  # so that it knows where to go
    bent = rn.equilibrium(column("clamped, free", load, 64), start=pushed).x[-1]
    last = bent[-1] - bent[-2]
    tip = np.degrees(np.arccos(last[0] / np.linalg.norm(last)))
    checks.append(Check("turn of the end at 1.0637 P [degrees]", 40.0, tip))
    return Case("Euler's columns", checks, figure, "Euler 1744; Timoshenko & Gere 1961, ch. 2")


if __name__ == "__main__":
    show(main)
