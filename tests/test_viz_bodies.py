"""Pictures of rigid bodies: a mesh each, which goes where the body goes."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import rodnet as rn
from rodnet.viz.solids import cylinders, poses


@pytest.fixture(scope="module")
def traj() -> rn.Trajectory:
    figure = rn.StickFigure()
    figure.rigid("bar", [(0, 0, 0), (0.04, 0, 0)], radius=4e-3)
    figure.rigid("arm", ["bar.end", (0.04, 0.03, 0.01)], radius=3e-3)
    figure.rod("tail", ["arm.end", (0.1, 0.03, 0.01)], edges=4, material=rn.Material(E=1e6), radius=1e-3)
    figure.body(["bar", "arm"], name="key", mass=0.01)
    robot = rn.Robot(figure.build(), [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity()])
    return rn.Simulation(robot, 5e-3, spin={"key": (20.0, 5.0, 30.0)}).run(0.3)


def rows(path, entity, component):
    import rerun as rr

    reader = rr.chunk.RrdReader(path)
    (recording,) = reader.recordings()
    found = []
    for chunk in reader.stream(store=recording):
        batch = chunk.to_record_batch()
        if chunk.entity_path == entity and component in batch.schema.names:
            for row in batch.column(component):
                values = row.values
                while hasattr(values, "flatten") and values.type.num_fields:
                    values = values.flatten()
                found.append(np.asarray(values))
    return found


def test_poses_carry_the_drawing_to_the_nodes(traj):
    body = traj.robot.graph.bodies[0]
    places, turns = poses(traj, body)
    moved = np.einsum("tij,nj->tni", turns, traj.robot.graph.x0[body.nodes]) + places[:, None]
    assert np.abs(moved - traj.x[:, body.nodes]).max() < 1e-12
    assert np.linalg.det(turns) == pytest.approx(1.0)
    assert np.abs(turns[-1] - np.eye(3)).max() > 0.3


def test_cylinders_are_closed_and_round(traj):
    graph = traj.robot.graph
    mesh = trimesh.Trimesh(*cylinders(graph, graph.bodies[0]))
    parts = mesh.split()
    assert len(parts) == 2 and all(part.is_watertight for part in parts)
    e = graph.bodies[0].edges
    volume = (np.pi * graph.radius[e] ** 2 * graph.rest_length[e]).sum()
    assert mesh.volume == pytest.approx(volume, rel=0.02)  # polygons of 24 sides, faces outwards


@pytest.mark.parametrize("shape", ["cylinders", "mesh", "arrays"])
def test_a_mesh_follows_its_body(traj, tmp_path, shape):
    graph, body = traj.robot.graph, traj.robot.graph.bodies[0]
    box = trimesh.creation.box((0.05, 0.02, 0.02))
    box.apply_translation((0.02, 0.0, 0.0))
    given = {"cylinders": {}, "mesh": {"key": box}, "arrays": {"key": (box.vertices, box.faces)}}[shape]
    path = rn.viz.log_rerun(traj, tmp_path / "run.rrd", meshes=given, every=10)
    vertices, faces = cylinders(graph, body) if shape == "cylinders" else (box.vertices, box.faces)
    logged = rows(path, "/robot/bodies/key", "Mesh3D:vertex_positions")[0].reshape(-1, 3)
    assert logged == pytest.approx(vertices[faces].reshape(-1, 3), abs=1e-6)
    places = np.concatenate(rows(path, "/robot/bodies/key", "Transform3D:translation")).reshape(-1, 3)
    columns = np.concatenate(rows(path, "/robot/bodies/key", "Transform3D:mat3x3")).reshape(-1, 3, 3)
    turns = np.swapaxes(columns, 1, 2)  # the viewer's matrices are stored by columns
    moved = np.einsum("tij,nj->tni", turns, graph.x0[body.nodes]) + places[:, None]
    assert moved == pytest.approx(traj.x[::10, body.nodes], abs=1e-6)


def test_wrong_meshes(traj, tmp_path):
    with pytest.raises(rn.ParameterError, match="there is no rigid body 'head'; there are key"):
        rn.viz.log_rerun(traj, tmp_path / "a.rrd", meshes={"head": trimesh.creation.box()})
    with pytest.raises(rn.ParameterError, match=r"that of 'key' must be a trimesh.Trimesh"):
        rn.viz.log_rerun(traj, tmp_path / "b.rrd", meshes={"key": np.zeros((3, 3))})
