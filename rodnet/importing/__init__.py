"""Robots from files: surface meshes and line data become stick figures. trimesh loads on first use."""
