"""A drag law of the user's own on the paper's robot: plain NumPy, with derivatives, and compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit

import rodnet as rn
from benchmarks import modes, scenes
from benchmarks.cases import Demand, Options, Result, Table
from benchmarks.timing import Work, interleave, ratio, spread

TITLE = "A drag law of one's own"
DT = 0.01


class Plain(rn.DragModel):
    """The paper's drag as a user would write it; rodnet differences it."""

    default_name = "drag"
    along = rn.Parameter(1.0, unit="Pa s", bounds=(0, None), null=0.0)
    across = rn.Parameter(1.0, unit="Pa s", bounds=(0, None), null=0.0)

    def force(self, site: Any, p: Any) -> np.ndarray:
        """Force per unit length [N/m]."""
        along = rn.dot(site.v, site.tangent) * site.tangent
        return -p.across * site.v - (p.along - p.across) * along


class Derived(Plain):
    """The same with its derivatives."""

    def jacobian(self, site: Any, p: Any) -> dict[str, np.ndarray]:
        """Derivatives by velocity, tangent and position."""
        v, t = site.v, site.tangent
        excess = np.asarray(p.along - p.across)[..., None]
        eye = np.eye(3)
        by_v = -np.asarray(p.across)[..., None] * eye - excess * t[:, :, None] * t[:, None, :]
        by_t = -excess * (rn.dot(v, t)[:, :, None] * eye + t[:, :, None] * v[:, None, :])
        return {"v": by_v, "tangent": by_t, "x": np.zeros_like(by_v)}


@njit(cache=True, error_model="numpy")
def _resistive(v, x, tangent, radius, t, p, f, dfdv, dfdtangent):
    """Fill force per length and derivatives at one site; ``p = (along, across)``."""
    across, excess = p[1], p[0] - p[1]
    vt = v[0] * tangent[0] + v[1] * tangent[1] + v[2] * tangent[2]
    for i in range(3):
        f[i] = -across * v[i] - excess * vt * tangent[i]
        for j in range(3):
            dfdv[i, j] = -excess * tangent[i] * tangent[j]
            dfdtangent[i, j] = -excess * tangent[i] * v[j]
        dfdv[i, i] -= across
        dfdtangent[i, i] -= excess * vt


class Compiled(Derived):
    """The same with a compiled kernel."""

    kernel = _resistive


LAWS = {"NumPy, differenced": Plain, "NumPy, with derivatives": Derived, "compiled": Compiled}


def robots() -> dict[str, rn.Robot]:
    """The two-tailed robot with the built-in law and with each of the user's."""
    along, across = scenes.tail_drag()
    laws = {name: law(on="tail*", tangent="node", along=along, across=across) for name, law in LAWS.items()}
    return {"built in": scenes.swimmer(2)} | {name: scenes.swimmer(2, law) for name, law in laws.items()}


def measure(options: Options) -> Result:
    """Time the robot with each law, from its steady state on."""
    duration = 1.0 if options.quick else 6.0
    sims = {name: modes.simulate(robot, DT) for name, robot in robots().items()}
    contenders: dict[str, Callable[[], Work]] = {}
    for name, sim in sims.items():
        modes.advance(sim, 0.2 if options.quick else 2.0)
        contenders[name] = lambda sim=sim: lambda: modes.advance(sim, duration)
    rounds = interleave(contenders, 2 * options.repeats, options.clock)
    reference = rounds["built in"].seconds
    table = Table(
        f"Two tails, 100 rpm, implicit Euler, dt = {DT} s",
        ["law", "x real time", "ms per step", "iterations per step", "time over built in"],
    )
    for name, own in rounds.items():
        steps, iterations, _ = own.returned[-1]
        table.rows.append(
            [
                name, spread([duration / t for t in own.seconds]), spread(own.per(steps), 1e3),
                iterations / steps, ratio(own.seconds, reference),
            ]
        )  # fmt: skip
    speed = table.rows[1][1]["median"]
    extra = 100.0 * (ratio(rounds["compiled"].seconds, reference)["median"] - 1.0)
    text = (
        "The same linear drag on the tails, once built in and three times written by a user: three lines of NumPy "
        "(which rodnet differences), these with their derivatives, and a compiled kernel."
    )
    demands = [
        Demand("plain NumPy law", 8.0, speed, "times real time", least=True),
        Demand("compiled law, extra time", 5.0, extra, "%"),
    ]
    return Result(TITLE, text, [table], demands)
