"""The paper's robot in grains that jam, and how steadily it advances."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import rodnet as rn
from rodnet_jamming.law import Jamming, Yielding


def jamming_robot(n_tails: int = 4, rpm: float = 208.0, *, jam: bool = True, **options: Any) -> rn.Robot:
    """Return the robot of Du et al. in grains that jam between its tails and have a yield stress.

    Parameters
    ----------
    n_tails : int
        Number of tails.
    rpm : float
        Speed of the motor [rpm].
    jam : bool
        Without, stiffening and yield stress are zero: resistive force theory, bit for bit.
    **options
        Parameters of `rodnet.robots.flagellated` and of `Jamming`.

    Returns
    -------
    Robot
        That of `rodnet.robots.flagellated` with two more terms: ``jam`` on the tails, and ``ahead``, the
        yield stress of the grains that the head pushes aside.
    """
    law = {
        k: options.pop(k) for k in list(options) if k in Jamming.declared() or k in ("cell", "slenderness")
    }
    if not jam:
        law.update(stiffening=0.0, yield_stress=0.0)
    robot = rn.robots.flagellated(n_tails, rpm, **options)
    law.setdefault("viscosity", robot.parameters["drag.viscosity"])
    stress = law.pop("yield_stress", Jamming.declared()["yield_stress"].value)
    law["yield_stress"] = rn.Parameter(
        stress, unit="Pa", bounds=(0, None), null=0.0, doc="yield stress of the grains"
    )
    head = {name: law[name] for name in Yielding.declared() if name in law}
    return robot.with_terms(
        Jamming(on="tail*", name="jam", tangent=options.get("tangent", "node"), **law),
        Yielding(on="head", name="ahead", **head),
    )


@dataclass(frozen=True)
class Intermittency:
    """How steadily a robot advances.

    Attributes
    ----------
    speed : float
        Mean speed [m/s].
    variation : float
        Coefficient of variation: standard deviation of the speed over its mean [1].
    stopped : float
        Fraction of the time at less than a fifth of the mean speed [1].
    """

    speed: float
    variation: float
    stopped: float


def intermittency(traj: rn.Trajectory, start: float = 0.0) -> Intermittency:
    """Evaluate the head's advance along its mean direction from time ``start`` [s] on.

    The speed is the mean from one recorded state to the next.
    """
    robot = traj.robot
    if robot is None or "head" not in traj.rods:
        raise rn.ParameterError(
            "intermittency needs a trajectory of a robot with a rod 'head' (loaded with its robot)"
        )
    late = traj.t >= start
    if late.sum() < 10:
        raise rn.ParameterError(f"only {late.sum()} states are later than start = {start:g} s; run longer")
    t, x = traj.t[late], traj.x[late][:, traj.rods["head"].nodes[1]]
    path = x[-1] - x[0]
    s = (x - x[0]) @ path / max(float(np.linalg.norm(path)), 1e-300)
    v = np.diff(s) / np.diff(t)
    mean = float((s[-1] - s[0]) / (t[-1] - t[0]))
    if mean == 0.0:
        return Intermittency(0.0, 0.0, 1.0)
    return Intermittency(mean, float(v.std() / mean), float((v < 0.2 * mean).mean()))


def _measured(traj: rn.Trajectory) -> dict[str, float]:
    """What `rodnet run` and `rodnet sweep` report: how it advances after the first quarter of the run."""
    found = intermittency(traj, start=0.25 * float(traj.t[-1]))
    return {"speed_mm_s": 1e3 * found.speed, "variation": found.variation, "stopped": found.stopped}


jamming_robot.metrics = _measured  # type: ignore[attr-defined]
