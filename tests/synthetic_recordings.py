"""Recordings of simulated cables and trunks, in the formats of the real ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

import rodnet as rn

CABLE_META = {
    "set": "synthetic",
    "metric": "mean of |prediction - measurement| over all markers and coordinates",
}


def shake(t: float) -> np.ndarray:
    """Return how the grippers move [m]."""
    return np.array([0.0, 0.05 * np.sin(4.0 * t) ** 2, 0.03 * (1.0 - np.cos(3.0 * t))])


def swinging_cable(path: Path, E: float, duration: float = 1.5, phase: float = 0.0) -> None:
    """Write a recording of a simulated branched cable whose ends are moved, markers every 0.1 m."""
    material = rn.Material(E=E, nu=0.4, rho=1100.0)
    figure = rn.StickFigure()
    s = np.linspace(0.0, 1.0, 41)
    sag = np.stack([0.8 * s, 0.0 * s, -0.6 * np.sin(np.pi * s) * 0.6], axis=1)
    figure.rod("cable", list(sag), material=material, radius=4e-3, natural="straight")
    branch = sag[16] + np.linspace(0.0, 0.3, 13)[:, None] * np.array([0.0, 0.3, -0.95])
    figure.rod("branch1", ["cable:16", *branch[1:]], material=material, radius=4e-3, natural="straight")
    grips = [
        rn.PrescribedMotion(
            at=at,
            position=lambda t: shake(t + phase) - shake(phase),
            orientation=lambda t: np.eye(3),
            name=name,
        )
        for at, name in (("cable:0-1", "left"), ("cable:39-40", "right"))
    ]
    elastic = [rn.Stretching(), rn.Bending(), rn.Twisting()]
    robot = rn.Robot(figure.build(), [*elastic, rn.Gravity(), rn.MassDamping(rate=1.0), *grips])
    traj = rn.Simulation(robot, dt=5e-3, stepper="sdirk2").run(duration, save_every=2)
    names = ["cable:0", "cable:1", *[f"cable:{k}" for k in range(4, 37, 4)], "cable:39", "cable:40"]
    nodes = [robot.graph.node(n) for n in [*names, "branch1:4", "branch1:8", "branch1:12"]]
    markers = traj.x[:, nodes] + 1e-5 * np.random.default_rng(1).standard_normal((len(traj), len(nodes), 3))
    edges = [*[(k, k + 1) for k in range(12)], (5, 13), (13, 14), (14, 15)]
    write(path, traj.t, markers, CABLE_META, edges=edges, prescribed=[0, 1, 11, 12])


def write(path: Path, t: np.ndarray, markers: np.ndarray, meta: dict, **arrays) -> None:
    """Write a recording in single precision, and what is known of its set beside it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    (path.parent / "meta.json").write_text(json.dumps(meta))
    np.savez(
        path,
        t=np.asarray(t, dtype=np.float32),
        markers=markers.astype(np.float32),
        suspect=np.zeros(markers.shape[:2], dtype=bool),
        **{name: np.asarray(value) for name, value in arrays.items()},
    )
