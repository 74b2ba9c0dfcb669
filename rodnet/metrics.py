"""What can be measured on any robot's trajectory: its way, its largest strain, its energy balance."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.terms.base import Term

if TYPE_CHECKING:
    from rodnet.graph.rod_graph import RodGraph
    from rodnet.simulation import Simulation
    from rodnet.trajectory import Trajectory

REST = 1e-10  # of the rods' axial stiffness: forces below it move nothing


def centre_of_mass(graph: RodGraph, x: np.ndarray) -> np.ndarray:
    """Centre of mass of a robot at node positions x (T, N, 3), rigid bodies included, shape (T, 3) [m]."""
    mass = graph.node_mass
    moment, total = np.einsum("n,tnc->tc", mass, x), float(mass.sum())
    for body in graph.bodies:
        moment += body.mass * np.array([body.moved(graph.x0, now, graph.edges)[0].com for now in x])
        total += body.mass
    return moment / total


def travel(traj: Trajectory) -> dict[str, Any]:
    """Displacement and way of the centre of mass [mm], and its mean speed along the displacement [mm/s]."""
    centre = 1e3 * centre_of_mass(traj.robot.graph, traj.x)  # type: ignore[union-attr]
    moved, elapsed = float(np.linalg.norm(centre[-1] - centre[0])), float(traj.t[-1] - traj.t[0])
    way = float(np.linalg.norm(np.diff(centre, axis=0), axis=1).sum())
    return {"displacement_mm": moved, "path_mm": way, "speed_mm_s": moved / elapsed if elapsed else math.nan}


def effort(traj: Trajectory) -> dict[str, Any]:
    """Largest bending strain of the rods and the energy balance; evaluates all recorded states again.

    Returns
    -------
    dict
        ``bending_strain``: largest elastic strain r |kappa - kappa_0| in the rods [1]. ``work_mJ``: work of
        actuators, loads and moving constraints; ``dissipated_mJ``: what drag, friction and contact took;
        ``stored_mJ``: change of elastic and kinetic energy [mJ]. ``energy_gap``: what is missing between
        them, relative to the largest: damping by the time stepper, and what happened between recorded states [1].
    """
    robot = traj.robot
    assert robot is not None
    found = {"bending_strain": largest_bending_strain(traj)}
    kinds = {term.name: term.kind for term in robot.terms}
    work = dissipated = 0.0
    for name, power in traj.powers.items():
        if name in kinds:
            put_in = 1e3 * float(np.trapezoid(power, traj.t))
            if kinds[name] in ("drag", "contact"):
                dissipated -= put_in
            else:
                work += put_in
    energy = sum(traj.energies.values(), np.zeros(len(traj)))
    stored = 1e3 * float(energy[-1] - energy[0])
    largest = max(abs(work), abs(dissipated), abs(stored))
    gap = abs(work - dissipated - stored) / largest if largest > 0.0 else 0.0
    return found | {"work_mJ": work, "dissipated_mJ": dissipated, "stored_mJ": stored, "energy_gap": gap}


def largest_bending_strain(traj: Trajectory) -> float:
    """Largest r |kappa - kappa_0| over all springs inside soft rods and all recorded states [1]."""
    replay = traj._replay
    model, graph = replay.model, replay.model.graph
    one, two, soft = model.edge1, model.edge2, ~graph.rigid
    inner = np.flatnonzero((one < graph.edge_count) & (two < graph.edge_count))
    inner = inner[soft[one[inner]] & soft[two[inner]]]
    radius = np.maximum(graph.radius[one[inner]], graph.radius[two[inner]]) / model.spring_length[inner]
    largest = 0.0
    for _, _, ev in replay.states(range(len(traj))):
        kappa = np.linalg.norm(ev.eps[inner, :2] - model.eps0[inner, :2], axis=1)
        largest = max(largest, float((radius * kappa).max(initial=0.0)))
    return largest


def why_at_rest(sim: Simulation) -> str | None:
    """Return a sentence on a robot that nothing drives; None if something does, or might."""
    model, terms = sim.model, sim.robot.terms
    passive = all(
        term.kind in ("energy", "drag", "contact", "constraint") and not _moves(term) for term in terms
    )
    stiffness = float(np.max(model.graph.EA[np.isfinite(model.graph.EA)], initial=0.0))
    at_rest = (
        not sim.state.v.any() and np.abs(sim.newton.ev.F[model.free]).max(initial=0.0) <= REST * stiffness
    )
    if not (passive and at_rest) or model.moving:
        return None
    return (
        "nothing drives this robot: it has neither a load nor an actuator, and begins at rest and without stress; "
        'add one, e.g. [[term]] id = "gravity" (rodnet terms lists them)'
    )


def _moves(term: Term) -> bool:
    return getattr(term, "flow", None) is not None
