"""Shapes of known axes and radii, in mm, as triangle meshes."""

from __future__ import annotations

import numpy as np
import trimesh

from rodnet.kinematics.frames import any_normal, carry_director


def tube(points, radii, sections: int = 32) -> trimesh.Trimesh:
    """Closed tube of round cross-sections along a polyline; radii may be one number, or one per point."""
    points = np.asarray(points, dtype=float)
    radii = np.broadcast_to(radii, len(points))
    slope = np.gradient(points, axis=0, edge_order=min(2, len(points) - 1))
    t = slope / np.linalg.norm(slope, axis=1, keepdims=True)
    first = carry_director(t, any_normal(t[0]))
    second = np.cross(t, first)
    angle = 2.0 * np.pi * np.arange(sections) / sections
    ring = np.cos(angle)[:, None] * first[:, None] + np.sin(angle)[:, None] * second[:, None]
    vertices = (points[:, None] + radii[:, None, None] * ring).reshape(-1, 3)
    k, n = len(points), sections
    i, j = np.arange(n), (np.arange(n) + 1) % n
    faces = []
    for row in range(k - 1):
        a, b = row * n, (row + 1) * n
        faces += [np.stack([a + i, a + j, b + j], axis=1), np.stack([a + i, b + j, b + i], axis=1)]
    faces += [np.stack([j, i, np.full(n, k * n)], axis=1)]
    faces += [np.stack([(k - 1) * n + i, (k - 1) * n + j, np.full(n, k * n + 1)], axis=1)]
    mesh = trimesh.Trimesh(np.vstack([vertices, points[:1], points[-1:]]), np.vstack(faces), process=False)
    assert mesh.is_watertight and mesh.volume > 0
    return mesh


def star(directions, lengths, radii, sections: int = 32) -> trimesh.Trimesh:
    """Round limbs from the origin, united; radii one number per limb or (root, tip)."""
    limbs = []
    for direction, length, radius in zip(directions, lengths, radii, strict=True):
        direction = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
        line = np.linspace(0.0, length, 9)[:, None] * direction
        limbs.append(tube(line, np.linspace(*np.broadcast_to(radius, 2), 9), sections))
    return trimesh.boolean.union(limbs)


def y_directions(degrees=(90.0, 210.0, 330.0)) -> np.ndarray:
    angle = np.radians(degrees)
    return np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)


def random_star(seed: int) -> tuple[trimesh.Trimesh, np.ndarray, np.ndarray]:
    """Three to five tapering limbs at 50 degrees or more; the mesh, its tips and its radii (root, tip)."""
    rng = np.random.default_rng(seed)
    count = rng.integers(3, 6)
    while True:
        arms = rng.normal(size=(count, 3))
        arms /= np.linalg.norm(arms, axis=1, keepdims=True)
        if (arms @ arms.T)[np.triu_indices(count, 1)].max() < np.cos(np.radians(50.0)):
            break
    length, root = rng.uniform(60.0, 120.0, count), rng.uniform(4.0, 9.0, count)
    radii = np.stack([root, root * rng.uniform(0.5, 1.0, count)], axis=1)
    return star(arms, length, radii, int(rng.integers(10, 50))), arms * length[:, None], radii


def turned(mesh: trimesh.Trimesh, seed: int) -> tuple[trimesh.Trimesh, np.ndarray]:
    """The mesh turned and moved, its vertices and faces shuffled; and the 4 x 4 transform."""
    rng = np.random.default_rng(seed)
    transform = trimesh.transformations.random_rotation_matrix(rng.random(3))
    transform[:3, 3] = rng.uniform(-300.0, 300.0, 3)
    order = rng.permutation(len(mesh.vertices))
    place = np.argsort(order)
    faces = place[mesh.faces][rng.permutation(len(mesh.faces))]
    faces = np.stack([np.roll(f, k) for f, k in zip(faces, rng.integers(0, 3, len(faces)), strict=True)])
    vertices = trimesh.transform_points(mesh.vertices[order], transform)
    return trimesh.Trimesh(vertices, faces, process=False), transform
