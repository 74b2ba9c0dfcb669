"""Trajectory files: NetCDF-4 (HDF5), written in chunks, readable by anything that reads NetCDF.

The root group holds what people look at (position, velocity, twist); the group ``state`` holds what
a restart needs to be bit-equal.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import OutputError

if TYPE_CHECKING:
    from rodnet.graph.rod_graph import RodGraph

FORMAT = "rodnet-trajectory-1"
# what every file holds, with time as the first axis
WRITTEN = {
    "time", "position", "velocity", "twist", "twist_rate", "state/index", "state/dof", "state/rate",
    "state/acceleration", "state/algorithmic", "state/tangent", "state/director", "state/tau", "state/turns",
}  # fmt: skip
CHUNK_BYTES = 1 << 17  # of a variable in the file
UNITS = {
    "time": "s",
    "position": "m",
    "velocity": "m/s",
    "twist": "rad",
    "twist_rate": "rad/s",
}


def check_writable(path: str | Path) -> Path:
    """Return the path if a file can be created there.

    Raises
    ------
    OutputError
        Naming the directory or file that cannot be written.
    """
    path = Path(path)
    folder = path.parent
    if path.is_dir():
        raise OutputError(
            f"cannot write '{path}': it is a directory; give a file name such as '{path / 'run.nc'}'"
        )
    if not folder.exists():
        try:
            folder.mkdir(parents=True)
        except OSError as error:
            raise OutputError(f"cannot write '{path}': its directory cannot be made ({error})") from None
    try:
        handle = os.open(path, os.O_WRONLY | os.O_CREAT)
    except OSError as error:
        raise OutputError(f"cannot write '{path}': {error.strerror}; choose another place") from None
    os.close(handle)
    if path.stat().st_size == 0:
        path.unlink()
    return path


def check_free(path: Path) -> None:
    """Raise if another process is writing a file.

    Raises
    ------
    OutputError
        If so.
    """
    import h5py

    if not path.exists() or not path.stat().st_size:
        return
    try:
        with h5py.File(path, "r"):
            pass
    except BlockingIOError:
        raise OutputError(f"another process is writing '{path}'; wait for it, or write elsewhere") from None
    except OSError:  # damaged: then nobody writes it
        pass


def graph_attributes(graph: RodGraph) -> dict[str, Any]:
    """Return the graph as plain values, enough to draw it."""
    return {
        "rods": [
            {
                "name": rod.name,
                "kind": rod.kind,
                "nodes": rod.nodes.tolist(),
                "edges": rod.edges.tolist(),
                "radius": graph.radius[rod.edges].tolist(),
            }
            for rod in graph.rods.values()
        ],
        "edges": graph.edges.tolist(),
    }


def growing(name: str) -> bool:
    """Whether an array of a trajectory has a second axis that grows from frame to frame."""
    return name.startswith("state/field")


def stack_rows(arrays: list[Any]) -> np.ndarray:
    """Stack arrays of unlike numbers of rows, filled up with rows of NaN."""
    out = np.full((len(arrays), max(map(len, arrays)), *arrays[0].shape[1:]), np.nan)
    for k, array in enumerate(arrays):
        out[k, : len(array)] = array
    return out


def unstacked(array: np.ndarray) -> np.ndarray:
    """Return a copy of one of the arrays that `stack_rows` has stacked."""
    return array[~np.isnan(array[:, 0])].copy()


def join(chunks: list[np.ndarray]) -> np.ndarray:
    """Join arrays along time; where they have unlike numbers of rows, they are stacked by `stack_rows`."""
    if chunks[0].ndim > 1 and any(c.shape[1] != chunks[0].shape[1] for c in chunks):
        return stack_rows([frame for chunk in chunks for frame in chunk])
    return np.concatenate(chunks)


class TrajectoryFile:
    """An open trajectory file that frames are appended to.

    Parameters
    ----------
    path : Path
        The file; an existing one is replaced, unless ``append``.
    header : dict
        Global attributes; a nested value is stored as JSON.
    append : bool
        Continue the file.
    """

    def __init__(self, path: Path, header: dict[str, Any], append: bool) -> None:
        import h5netcdf

        self.path, attributes = path, _attributes(header)  # what cannot be written costs no file
        try:
            self.file = h5netcdf.File(path, "a" if append else "w")
        except OSError as error:
            raise OutputError(f"cannot open '{path}' for writing: {error}") from None
        if not append:
            self.file.dimensions["time"] = None
            self.file.attrs.update(attributes)
        self.length = int(self.file.dimensions["time"].size)

    def append(self, frames: dict[str, np.ndarray]) -> None:
        """Append arrays with time as their first axis; names with a slash go into that group."""
        count = len(frames["time"])
        stop = self.length + count
        self.file.resize_dimension("time", stop)
        for name, variable in self.file.variables.items():
            if ":" in name:  # energies and powers, which are known once the run has finished
                variable[self.length : stop] = np.nan
        for name, values in frames.items():
            variable = self._variable(name, values)
            if growing(name):
                self._grow(variable, values.shape[1])
                variable[self.length : stop, : values.shape[1]] = values
            else:
                variable[self.length : stop] = values
        self.file._h5file.flush()  # h5netcdf's own flush does not reach the disk
        self.length = stop

    @staticmethod
    def _grow(variable: Any, rows: int) -> None:
        """Make room for so many rows."""
        label = variable.dimensions[1]
        if variable._parent.dimensions[label].size < rows:
            variable._parent.resize_dimension(label, rows)

    def _variable(self, name: str, values: np.ndarray) -> Any:
        group_name, _, short = name.rpartition("/")
        group = self.file
        if group_name:
            group = (
                self.file.groups[group_name]
                if group_name in self.file.groups
                else self.file.create_group(group_name)
            )
        if short in group.variables:
            return group.variables[short]
        axes = ["time"]
        for k, size in enumerate(values.shape[1:]):
            label = _AXES.get((short, k), f"{short}_{k}")
            if label not in group.dimensions:
                group.dimensions[label] = None if growing(name) and k == 0 else size
            axes.append(label)
        row = values.dtype.itemsize * max(int(np.prod(values.shape[1:])), 1)
        rows = min(max(CHUNK_BYTES // row, 1), 256)
        shape, options = (rows, *values.shape[1:]), {}
        if growing(name):  # what is not written is not a number
            shape, options = (1, 256, *values.shape[2:]), {"fillvalue": np.nan, "compression": "gzip"}
        variable = group.create_variable(short, tuple(axes), values.dtype, chunks=shape, **options)
        if short in UNITS:
            variable.attrs["units"] = UNITS[short]
        return variable

    def put(self, name: str, axes: tuple[str, ...], values: np.ndarray, unit: str) -> None:
        """Add one variable that is known for the whole run."""
        if name in self.file.variables:
            self.file.variables[name][...] = values
            return
        for label, size in zip(axes, values.shape, strict=True):
            if label not in self.file.dimensions:
                self.file.dimensions[label] = size
        self.file.create_variable(name, axes, values.dtype, data=values).attrs["units"] = unit

    def set(self, **attributes: Any) -> None:
        """Set global attributes."""
        self.file.attrs.update(_attributes(attributes))

    def close(self) -> None:
        """Flush and close."""
        self.file.close()


def _attributes(values: dict[str, Any]) -> dict[str, Any]:
    """Attributes as a file takes them: numbers and words, what is nested as JSON."""
    plain = {k: v.item() if isinstance(v, np.generic) else v for k, v in values.items()}
    return {k: v if isinstance(v, str | int | float) else json.dumps(v) for k, v in plain.items()}


_AXES = {
    ("position", 0): "node",
    ("position", 1): "axis",
    ("velocity", 0): "node",
    ("velocity", 1): "axis",
    ("twist", 0): "edge",
    ("twist_rate", 0): "edge",
    ("rate", 0): "dof",
    ("dof", 0): "dof",
    ("acceleration", 0): "dof",
    ("algorithmic", 0): "dof",
    ("tangent", 0): "all_edges",
    ("tangent", 1): "axis",
    ("director", 0): "all_edges",
    ("director", 1): "axis",
    ("turns", 0): "all_edges",
}


def mend(path: Path, header: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
    """Write a file anew, from what was read of it, if its last frames could not be: nothing can be appended to it."""
    import h5netcdf

    with h5netcdf.File(path, "r") as file:
        if _frames(file) == len(arrays["time"]):
            return
    beside = path.with_name(path.name + ".mended")
    whole = TrajectoryFile(beside, header, append=False)
    try:
        whole.append({name: values for name, values in arrays.items() if ":" not in name})
    finally:
        whole.close()
    os.replace(beside, path)


def read(path: str | Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Read a trajectory file: attributes and arrays by name (``state/...`` for the state group).

    Raises
    ------
    OutputError
        If the file is missing, cut off or of another kind.
    """
    import h5netcdf
    import h5py

    if not Path(path).exists():
        raise OutputError(f"cannot read '{path}': there is no such file")
    try:
        with open(path, "rb"):
            pass
        # first by h5py: h5netcdf leaves a broken object behind where it cannot open a file
        with h5py.File(path, "r") as raw:
            raw.attrs.get("format")
        with h5netcdf.File(path, "r") as file:
            return _contents(file, path)
    except OutputError:
        raise
    except (IsADirectoryError, PermissionError) as error:
        raise OutputError(f"cannot read '{path}': {error.strerror}") from None
    except BlockingIOError:
        raise OutputError(f"cannot read '{path}': another process is writing it") from None
    except (OSError, ValueError, KeyError, RuntimeError) as error:  # in the words of the HDF5 library
        broken = "it is cut off or damaged" if h5py.is_hdf5(path) else "it is not a NetCDF-4 file"
        raise OutputError(f"cannot read '{path}': {broken}") from error


def _variables(file: Any) -> dict[str, Any]:
    """Variables of an open file by name, ``state/...`` for the state group."""
    inner = file.groups["state"].variables if "state" in file.groups else {}
    return {**file.variables, **{f"state/{n}": v for n, v in inner.items()}}


def _in_time(variable: Any) -> bool:
    return variable.dimensions[:1] == ("time",)


def _frames(file: Any) -> int:
    """Number of frames that an open file says it holds of everything."""
    return min((v.shape[0] for v in _variables(file).values() if _in_time(v)), default=0)


def _arrays(file: Any) -> dict[str, np.ndarray]:
    """Arrays of an open file, without its last frames if these cannot be read: its run was killed as it wrote them."""

    def first(count: int) -> dict[str, np.ndarray] | None:
        try:
            return {n: v[:count] if _in_time(v) else v[...] for n, v in _variables(file).items()}
        except OSError:
            return None

    low, high = 0, _frames(file)
    found = first(high)
    if found is not None:
        return found
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if first(middle) is not None else (low, middle)
    found = first(low)
    if not low or found is None:
        raise OSError("no frame can be read")
    return found


def _contents(file: Any, path: str | Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    if file.attrs.get("format") != FORMAT:
        raise OutputError(
            f"'{path}' is not a rodnet trajectory (format attribute {file.attrs.get('format')!r})"
        )
    arrays = _arrays(file)
    if not (len(arrays.get("time", ())) and arrays.keys() >= WRITTEN):
        raise OutputError(f"'{path}' is cut off: its run was killed before it had written the first state")
    attributes = {}
    for key, value in file.attrs.items():
        try:
            attributes[key] = json.loads(value) if isinstance(value, str) and value[:1] in "[{" else value
        except json.JSONDecodeError:
            attributes[key] = value
    return attributes, arrays
