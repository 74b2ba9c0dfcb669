"""The truth by rodnet in another formulation, where PyElastica cannot express an effect.

Four times as many nodes as the case under test or more, and an eighth of its time step or less; pieces count as
neighbours at once, where a case counts them by degrees. The laws themselves are those of rodnet.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

import rodnet as rn
from benchmarks.blind.drives import AnyDrive, Pull, Spin
from benchmarks.blind.robots import Machine, rotations

Effects = Mapping[str, Mapping[str, Any]]
EDGES, DT = 80, 1.25e-3
TENDON = 4e-3  # beside the axis [m]
EYELETS = 20  # of a tendon along the rod, as many as the robot has, whatever the mesh
SHARP = 0.1  # softness of neighbours
LOCKED = 1e-4  # of a rod's length: a clamped edge so short that bending begins at the gripper


def robot(machine: Machine, drive: AnyDrive, effects: Effects, start: float, edges: int = EDGES) -> rn.Robot:
    """The machine with its effects; time zero is ``start``."""
    material = rn.Material(E=machine.young, nu=0.5, rho=machine.density)
    figure = rn.StickFigure()
    size = machine.arms[0].length
    for k, arm in enumerate(machine.arms):
        count = max(8, round(edges * arm.length / size))
        points = arm.shape(np.linspace(0.0, arm.length, count + 1))[0]
        nodes: list[Any] = [points[0], *points[1:]]
        if arm.parent is None:
            nodes.insert(1, arm.shape(np.array([0.0, LOCKED * arm.length]))[0][1])
        else:
            nodes[0] = f"arm{arm.parent}:{round(edges * arm.at) + 1}"
        figure.rod(f"arm{k}", nodes, material=material, radius=machine.radius)
    eta_t, eta_n = machine.drag()
    terms: list[Any] = [rn.Stretching(), rn.Bending(), rn.Twisting()]
    medium: dict[str, Any] = {"eta_t": eta_t, "eta_n": eta_n, "name": "medium"}
    if crowd := effects.get("neighbours"):
        terms.append(
            rn.term("crowded-force")(
                crowding=crowd["crowding"], range=crowd["range"], softness=SHARP, **medium
            )
        )
    else:
        terms.append(rn.ResistiveForce(**medium))
    if late := effects.get("kelvin-voigt"):
        terms.append(rn.KelvinVoigt(bend=late["bend"]))
    if rub := effects.get("dry-friction"):
        terms.append(rn.term("dry-friction")(moment=rub["moment"], curvature=rub["curvature"]))
    if creep := effects.get("plastic-set"):
        terms.append(rn.term("plastic-set")(share=creep["share"], time=creep["time"]))
    if fluid := effects.get("added-mass"):
        terms.append(rn.AddedMass(density=fluid["density"]))
    if soft := effects.get("joint-compliance"):
        terms.append(rn.term("joint-compliance")(at="arm1.start", length=soft["length"]))
    return rn.Robot(figure.build(), [*terms, *_driven(drive, effects, start, max(8, edges))])


def _driven(drive: AnyDrive, effects: Effects, start: float, edges: int) -> list[Any]:
    """What holds and drives the root; the first rod has so many edges beyond the gripper's."""
    if isinstance(drive, Spin):
        droop = effects.get("motor-droop", {}).get("droop", 0.0)
        lag = effects.get("motor-lag", {}).get("lag", 0.0)
        motor = rn.DCMotor(at="arm0:1", rpm=drive.rpm, stall_torque=1.0, no_load_rpm=droop, lag=lag)
        return [rn.Clamp(at="arm0:0-1"), motor]
    if isinstance(drive, Pull):
        rub = effects.get("tendon-friction", {}).get("friction", 0.0)
        eyelets = sorted({1 + round(k * edges / EYELETS) for k in range(1, EYELETS + 1)} - {1})
        tendon = rn.Tendon(
            route=[(f"arm0:{k}", (TENDON, 0.0)) for k in (0, *eyelets)],  # not over the locked edge
            tension=drive.tension, schedule=drive.share, friction=rub,
        )  # fmt: skip
        return [rn.Clamp(at="arm0:0-1"), tendon]
    return [
        rn.PrescribedMotion(
            at="arm0:0-1", name="gripper",
            position=lambda t: drive.motion(np.array([t + start]))[0][0],
            orientation=lambda t: rotations(drive.motion(np.array([t + start]))[1])[0],
        )
    ]  # fmt: skip


def simulate(
    machine: Machine, drive: AnyDrive, effects: Effects, t: np.ndarray, markers: Sequence[tuple[int, float]],
    *, elements: int = EDGES, start: float = -1.0,
) -> np.ndarray:  # fmt: skip
    """Return the markers' true positions at the frames [m], shape (T, M, 3); as `elastica.simulate`."""
    if not hasattr(drive, "motion"):
        start = 0.0  # at rest, and told from then on
    there = robot(machine, drive, effects, start, elements)
    frame = float(t[1] - t[0])
    dt = frame / round(frame / DT)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rn.errors.PlausibilityWarning)  # edges as short as the rod is thick
        traj = rn.Simulation(there, dt=dt, stepper="sdirk2").run(
            float(t[-1]) - start, save_every=round(frame / dt)
        )
    points = [f"arm{k}@{100.0 * s:.6g}%" for k, s in markers]
    (seen,) = rn.observe(rn.Markers(there, points), traj, t - start)
    return np.asarray(seen)


converged = simulate
