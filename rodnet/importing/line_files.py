"""Reading lines: points, the segments between them, and radii where the format has them."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rodnet.errors import MeshError

if TYPE_CHECKING:
    import trimesh

DRAWINGS = (".ply", ".obj", ".swc", ".dxf", ".svg")
DOWNWARD = (
    "the y axis of SVG points down on the screen; y is kept as it is in the file, so with y up the rods are the mirror "
    "image of what a browser shows"
)


class LineData(NamedTuple):
    """Lines as they are in a file.

    Attributes
    ----------
    vertices : ndarray, shape (n, 3)
        Points, in the file's unit.
    segments : ndarray, shape (m, 2)
        Points that are joined.
    radii : ndarray, shape (m, 2), or None
        Radii at both ends of each segment, in the file's unit.
    unit : str or None
        The file's unit, where it says it.
    notes : tuple of str
        What is worth knowing.
    """

    vertices: np.ndarray
    segments: np.ndarray
    radii: np.ndarray | None = None
    unit: str | None = None
    notes: tuple[str, ...] = ()


def read_lines(source: Any) -> tuple[LineData, str]:
    """Read lines from a file, a trimesh path, or (vertices, segments).

    Returns
    -------
    lines : LineData
        What was read.
    name : str
        What messages call it.

    Raises
    ------
    MeshError
        If there is no such file or no line in it, or it is not of its format.
    """
    if isinstance(source, str | Path):
        path = Path(source)
        name, suffix = f"'{path.name}'", path.suffix.lower()
        if not path.is_file():
            raise MeshError(f"there is no file '{path}'")
        if suffix not in DRAWINGS:
            raise MeshError(
                f"{name}: lines are read from {', '.join(DRAWINGS)}; surfaces by rodnet.from_mesh"
            )
        if suffix in (".obj", ".swc"):
            text = path.read_text(errors="replace")
            data = _read_obj(name, text) if suffix == ".obj" else _read_swc(name, text)
        else:
            data = _from_path(name, _load(name, path))
            if suffix == ".svg":
                data = data._replace(notes=(DOWNWARD,))
    elif isinstance(source, tuple) and len(source) == 2:
        name, data = "the drawing", LineData(*_arrays(*source))
    else:
        name, data = "the drawing", _from_path("the drawing", source)
    if not len(data.segments):
        raise MeshError(f"{name} holds no lines; surfaces are read by rodnet.from_mesh")
    if not np.all(np.isfinite(data.vertices[data.segments])):
        raise MeshError(f"{name} has points that are not finite numbers")
    return data, name


def _load(name: str, path: Path) -> Any:
    import trimesh

    try:
        return trimesh.load(path, process=False)
    except Exception as error:  # trimesh's readers raise whatever their formats bring about
        raise MeshError(f"{name} cannot be read as {path.suffix[1:].upper()}: {error}") from error


def _from_path(name: str, path: trimesh.path.path.Path) -> LineData:
    import trimesh

    if isinstance(path, trimesh.Trimesh):
        raise MeshError(f"{name} holds a surface; surfaces are read by rodnet.from_mesh")
    if not isinstance(path, trimesh.path.path.Path):
        raise MeshError(
            f"{name}: lines are a path, a trimesh path or (vertices, segments), not {type(path).__name__}"
        )
    points: list[np.ndarray] = []
    segments: list[np.ndarray] = []
    count = 0
    for entity in path.entities:  # curves become polylines, as fine as trimesh draws them
        try:
            line = entity.discrete(path.vertices)
        except IndexError as error:
            raise MeshError(f"{name}: a line names a point that is not there: {error}") from None
        if len(line) > 1:
            points.append(line)
            segments.append(np.column_stack([np.arange(len(line) - 1), np.arange(1, len(line))]) + count)
            count += len(line)
    if not points:
        raise MeshError(f"{name} holds no lines")
    vertices = np.vstack(points)
    flat = np.zeros((len(vertices), 3 - vertices.shape[1]))
    return LineData(np.hstack([vertices, flat]), np.vstack(segments), None, path.units)


def _arrays(vertices: Any, segments: Any) -> tuple[np.ndarray, np.ndarray]:
    try:
        points, pairs = np.array(vertices, dtype=float), np.array(segments)
    except (TypeError, ValueError) as error:
        raise MeshError(f"lines are (vertices, segments): {error}") from error
    if (
        points.ndim != 2
        or points.shape[1] != 3
        or pairs.ndim != 2
        or pairs.shape[1] != 2
        or pairs.dtype.kind not in "iu"
    ):
        raise MeshError(
            f"lines are (vertices, segments) of shapes (n, 3) and integer (m, 2), not {points.shape} and {pairs.shape}"
        )
    if len(pairs) and not (0 <= pairs.min() and pairs.max() < len(points)):
        raise MeshError(f"a segment names point {pairs.max()}, and there are {len(points)}")
    return points, pairs.astype(np.int64)


def _read_obj(name: str, text: str) -> LineData:
    """Read the `v` and `l` records of a Wavefront file."""
    points: list[list[float]] = []
    pairs: list[tuple[int, int]] = []
    faces = False
    for number, line in enumerate(text.replace("\\\n", " ").splitlines(), 1):
        key, *words = line.partition("#")[0].split() or [""]
        faces |= key == "f"
        try:
            if key == "v":
                points.append([float(w) for w in words[:3]])
                if len(words) < 3:
                    raise ValueError("a point needs three coordinates")
            elif key == "l":
                ids = [int(w.partition("/")[0]) for w in words]
                ids = [k - 1 if k > 0 else len(points) + k for k in ids]
                if min(ids) < 0 or len(ids) < 2:
                    raise ValueError("a line needs two points or more, counted from 1, or back from -1")
                pairs += itertools.pairwise(ids)
        except ValueError as error:
            raise MeshError(f"{name}, line {number}: {line.strip()!r}: {error}") from None
    if not pairs:
        remedy = "its faces are read by rodnet.from_mesh" if faces else "export the lines, not their points"
        raise MeshError(f"{name} has no line records ('l 1 2 3'); {remedy}")
    if max(map(max, pairs)) >= len(points):
        raise MeshError(f"{name}: a line names point {max(map(max, pairs)) + 1}, and there are {len(points)}")
    notes = ("its faces are left out; rodnet.from_mesh reads them",) if faces else ()
    return LineData(np.array(points), np.array(pairs, dtype=np.int64), None, None, notes)


def _read_swc(name: str, text: str) -> LineData:
    """Read an SWC file (Cannon et al. 1998): index, type, x, y, z, radius, parent; in micrometres."""
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        try:
            if len(words) < 7:
                raise ValueError("seven columns are needed: index, type, x, y, z, radius, parent")
            rows.append([float(w) for w in words[:7]])
            if not (rows[-1][0].is_integer() and rows[-1][6].is_integer()):
                raise ValueError("index and parent must be whole numbers")
        except ValueError as error:
            raise MeshError(f"{name}, line {number}: {line.strip()!r}: {error}") from None
    if not rows:
        raise MeshError(f"{name} has no points")
    table = np.array(rows)
    index = {int(k): row for row, k in enumerate(table[:, 0])}
    if len(index) < len(table):
        raise MeshError(f"{name}: two points have the same index")
    child = np.flatnonzero(table[:, 6] >= 0)
    for row in child:
        if table[row, 6] == table[row, 0]:
            raise MeshError(f"{name}: point {int(table[row, 0])} is its own parent; a root has the parent -1")
        if int(table[row, 6]) not in index:
            raise MeshError(
                f"{name}: point {int(table[row, 0])} has the parent {int(table[row, 6])}, which is not there"
            )
    if len(table) and len(child) == len(table):
        raise MeshError(f"{name}: no point is a root, with the parent -1; its lines run in circles")
    segments = np.array([(index[int(table[row, 6])], row) for row in child], dtype=np.int64).reshape(-1, 2)
    bad = np.flatnonzero(~((table[:, 5] > 0) & np.isfinite(table[:, 5])))
    if len(bad):
        raise MeshError(
            f"{name}: point {int(table[bad[0], 0])} has the radius {table[bad[0], 5]:g}; it must be positive and finite"
        )
    radii = table[:, 5][segments]
    # a cell body is no limb: what leaves it is as thick as its first point outside
    soma = table[:, 1][segments] == 1
    radii = np.where(soma & ~soma[:, ::-1], radii[:, ::-1], radii)
    notes: tuple[str, ...] = ()
    if soma.any():
        notes = (
            "the cell body (type 1) is drawn by its lines alone; a stiff part (fig.rigid) may stand for it",
        )
    return LineData(table[:, 2:5], segments, radii, "um", notes)
