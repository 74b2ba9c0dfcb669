"""What an instrument sees of a state: markers through a camera."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.errors import RecordingError
from rodnet.parameters import Parameter, Parametrised
from rodnet.recordings.noise import NoiseModel

if TYPE_CHECKING:
    from rodnet.observer import Observer
    from rodnet.recordings.recording import Recording
    from rodnet.robot import Robot


class Observation(Parametrised):
    """An instrument: a function of a state, and which part of a recording holds what it read.

    Subclasses give `read` and `measured`, and `written`, if recordings are to be drawn anew. Parameters declared on
    the class can be calibrated like those of a term; a lag, which every instrument may have, is one of them.

    Parameters
    ----------
    robot : Robot
        What is observed.
    name : str, optional
        For parameter paths such as ``"markers.lag"``.
    **parameters
        Values of declared parameters.
    """

    default_name: ClassVar[str] = "observation"
    unit: ClassVar[str] = "m"
    explicit: ClassVar[bool] = (
        False  # whether what is read depends on the robot's parameters, not on its state alone
    )
    lag = Parameter(0.0, unit="s", bounds=(-1.0, 1.0), null=0.0, doc="by how much the record runs behind")
    # a scheme of first order lacks 2 times what a step half as long changes: much more is something else
    numerics = Parameter(
        np.zeros(2),
        unit="1",
        bounds=(-2.0, 4.0),
        null=0.0,
        doc="shares of ``corrections`` that are added to a prediction",
    )
    records = Parameter(
        np.zeros(0),
        unit="1",
        null=0.0,
        doc="errors of the drives' records, in standard deviations, whose ``misread`` are added to predictions",
    )
    left_out: np.ndarray | None = None  # samples that count as not read, shape (frames, samples)
    corrections: tuple[np.ndarray, ...] = ()  # what a finer time step and a finer mesh change, at the frames
    misread: tuple[np.ndarray, ...] = ()  # what each error of the drives' records changes, at the frames

    def __init__(self, robot: Robot, *, name: str | None = None, **parameters: Any) -> None:
        self.robot, self.name = robot, name or self.default_name
        self.set_parameters(parameters)

    def read(self, view: Observer) -> np.ndarray:
        """Return what the instrument reads in a state."""
        raise NotImplementedError

    def measured(self, rec: Recording) -> np.ndarray:
        """Return what it did read, one row for each frame; NaN where nothing was read.

        Raises
        ------
        RecordingError
            If the recording lacks it.
        """
        raise NotImplementedError

    def written(self, rec: Recording, readings: np.ndarray) -> Recording:
        """Return the recording with other readings in the place of what was `measured`, of the same shape."""
        raise NotImplementedError

    def noise(self, sigma: float) -> NoiseModel:
        """Return the noise of what is `measured`, from a standard deviation of single readings: white, as a rule."""
        return NoiseModel(white=sigma)

    def check(self, rec: Recording) -> None:
        """Raise if recording and robot do not fit."""
        self.measured(rec)


class Markers(Observation):
    """Material points of a robot, as a camera or a motion capture system sees them.

    A marker may sit beside the axis (``offset1``, ``offset2``, along the material directors) or elsewhere along its
    rod (``misplaced``), or slip along it (``drift``), and the camera's scale, rotation, shift and lens may be off;
    all but the middle of the picture have a null value, and can be calibrated.

    Parameters
    ----------
    robot : Robot
        What is observed.
    points : mapping, or sequence of str
        Material point of each marker by name: ``{"tip": "tail0.end", "t0": "tail0@50%", "head": "head:1"}``, of as
        many as are to be seen; a sequence goes with all of the recording's markers in order. Stations lie between nodes
        where they fall.
    plane : sequence of str, optional
        Axes that the camera sees, e.g. ``"xz"``; by default all three.
    offset1, offset2 : float or array_like, optional
        Offsets [m].
    aside1, aside2 : float or array_like, shape (R,), optional
        Further offsets, one for all markers of each rod that has some (``rods``), for directors of different rods have
        nothing to do with each other [m].
    misplaced : float or array_like, shape (M,), optional
        By how much markers sit farther along their rods than their points, from start to end [m].
    drift : float or array_like, shape (M,), optional
        Speed at which they slip along their rods from the start of a trial [m/s].
    scale : float
        Seen over true length.
    rotation, shift : array_like, shape (3,)
        Rotation vector of what is seen about the origin [rad], and its shift [m].
    lens : float
        Of what is seen at u from the middle of the picture, ``|u|^2 u`` is added so many times [1/m^2]: a cushion, or a
        barrel if negative.
    keystone, bow : array_like, shape (3,)
        As many times ``(keystone . u) u``, for what is tilted against the picture, and ``bow |u|^2`` [1/m].
    middle : array_like, shape (3,)
        Middle of the picture [m].
    lag : float
        By how much the record runs behind [s].

    Raises
    ------
    GraphError
        If a point is not on the robot.
    RecordingError
        If there is none, or the plane has other axes.
    """

    default_name = "markers"
    offset1 = Parameter(
        0.0, unit="m", bounds=(-0.1, 0.1), null=0.0, doc="beside the axis, along the first director"
    )
    offset2 = Parameter(0.0, unit="m", bounds=(-0.1, 0.1), null=0.0, doc="along the second director")
    aside1 = Parameter(
        0.0,
        unit="m",
        bounds=(-0.1, 0.1),
        null=0.0,
        doc="beside the axis of each rod, along the first director",
    )
    aside2 = Parameter(0.0, unit="m", bounds=(-0.1, 0.1), null=0.0, doc="along the second director")
    misplaced = Parameter(
        0.0, unit="m", bounds=(-1.0, 1.0), null=0.0, doc="farther along the rod than its point"
    )
    drift = Parameter(
        0.0, unit="m/s", bounds=(-10.0, 10.0), null=0.0, doc="speed at which it slips along the rod"
    )
    scale = Parameter(1.0, unit="1", bounds=(0.1, 10.0), null=1.0, doc="seen over true length")
    rotation = Parameter(np.zeros(3), unit="rad", bounds=(-3.2, 3.2), null=0.0, doc="of what is seen")
    shift = Parameter(np.zeros(3), unit="m", bounds=(-10.0, 10.0), null=0.0, doc="of what is seen")
    lens = Parameter(
        0.0,
        unit="1/m^2",
        null=0.0,
        doc="how much farther off what is far is seen, as its square",
    )
    keystone = Parameter(
        np.zeros(3),
        unit="1/m",
        null=0.0,
        doc="how much farther off what is on a side is seen",
    )
    bow = Parameter(np.zeros(3), unit="1/m", null=0.0, doc="by how much straight lines are seen bent")
    middle = Parameter(np.zeros(3), unit="m", bounds=(-10.0, 10.0), doc="middle of the picture")

    def __init__(
        self,
        robot: Robot,
        points: Mapping[str, str] | Sequence[str],
        *,
        plane: str = "xyz",
        name: str | None = None,
        **parameters: Any,
    ) -> None:
        super().__init__(robot, name=name, **parameters)
        named = isinstance(points, Mapping)
        self.markers: tuple[str | int, ...] = tuple(points) if named else tuple(range(len(points)))
        places = list(points.values()) if isinstance(points, Mapping) else list(points)
        if not places:
            raise RecordingError("Markers needs at least one point")
        if not plane or set(plane) - set("xyz") or len(set(plane)) != len(plane):
            raise RecordingError(f"Markers: plane = {plane!r} must be some of the axes x, y, z")
        self.axes = ["xyz".index(a) for a in plane]
        self.edge, self.along = (
            np.array(v) for v in zip(*(robot.graph.station(p) for p in places), strict=True)
        )
        on = [next(rod.name for rod in robot.graph.rods.values() if e in rod.edges) for e in self.edge]
        self.rods = tuple(dict.fromkeys(on))
        self.rod = np.array([self.rods.index(name) for name in on])
        each = {"misplaced": "markers", "drift": "markers", "aside1": "rods", "aside2": "rods"}
        for parameter, what in each.items():  # numbers that can be calibrated by themselves
            own: Parameter = getattr(self, parameter)
            count = len(places) if what == "markers" else len(self.rods)
            if np.shape(own.value) not in ((), (count,)):
                raise RecordingError(
                    f"Markers: {parameter} has shape {np.shape(own.value)}; give one number, or one for each of the "
                    f"{count} {what}"
                )
            setattr(self, parameter, own.with_value(np.array(np.broadcast_to(own.value, count))))

    def read(self, view: Observer) -> np.ndarray:
        """Return positions as seen [m], shape (M, axes)."""
        A, b = self.camera
        return self.bent(self.places(view) @ A + b)

    def bent(self, seen: np.ndarray) -> np.ndarray:
        """What the lens makes of positions in an even picture [m], shape (M, axes)."""
        if not self.bends:
            return np.asarray(seen)
        lens, keystone, bow, u = self._picture(seen)
        square = np.sum(u**2, axis=-1, keepdims=True)
        return np.asarray(seen + (lens * square + u @ keystone[:, None]) * u + square * bow)

    def bending(self, seen: np.ndarray) -> np.ndarray:
        """Derivative of `bent`, shape (M, axes, axes)."""
        lens, keystone, bow, u = self._picture(seen)
        wider = 1.0 + lens * np.sum(u**2, axis=-1) + u @ keystone
        outer = lambda a, b: a[:, :, None] * b[:, None, :]  # noqa: E731
        aside = np.broadcast_to(keystone, u.shape), np.broadcast_to(bow, u.shape)
        return np.asarray(
            wider[:, None, None] * np.eye(len(self.axes))
            + 2.0 * lens * outer(u, u) + outer(u, aside[0]) + 2.0 * outer(aside[1], u)
        )  # fmt: skip

    @property
    def bends(self) -> bool:
        """Whether the picture is not even."""
        return any(np.any(one.value) for one in (self.lens, self.keystone, self.bow))

    def _picture(self, seen: np.ndarray) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
        """What the lens does, and how far from the middle of the picture positions are."""
        keystone, bow, middle = (
            np.broadcast_to(one.value, 3)[self.axes] for one in (self.keystone, self.bow, self.middle)
        )
        return float(self.lens.value), keystone, bow, seen - middle

    def places(self, view: Observer) -> np.ndarray:
        """Where the markers are [m], shape (M, 3)."""
        edge, along = self.stations(view.t)
        i, j = self.robot.graph.edges[edge].T
        s = along[:, None]
        x = (1.0 - s) * view.x[i] + s * view.x[j]
        if self.offset:
            first, second = self.beside(view)
            one, two = self.offsets
            x = x + one * first + two * second
        return np.asarray(x)

    def stations(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Edges, and fractions along them, where the markers sit at a time [s]; beyond the ends of an open rod too."""
        moved = self.misplaced.value + self.drift.value * t
        if not moved.any():
            return self.edge, self.along
        edge, along = self.edge.copy(), self.along.copy()
        for m in np.flatnonzero(moved):
            edges, starts, length, closed = self._rod(int(self.edge[m]))
            here = int(np.flatnonzero(edges == self.edge[m])[0])
            s = starts[here] + self.along[m] * length[here] + moved[m]
            if closed:
                s %= starts[-1] + length[-1]
            k = int(np.clip(np.searchsorted(starts, s, side="right") - 1, 0, len(edges) - 1))
            edge[m], along[m] = edges[k], (s - starts[k]) / length[k]
        return edge, along

    def _rod(self, edge: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool]:
        """Edges of the rod of an edge, where each begins, how long each is [m], and whether the rod is closed."""
        graph = self.robot.graph
        rod = next(rod for rod in graph.rods.values() if edge in rod.edges)
        length = graph.rest_length[rod.edges]
        return rod.edges, np.cumsum(length) - length, length, rod.closed

    def beside(self, view: Observer) -> tuple[np.ndarray, np.ndarray]:
        """Material directors at the markers, shape (M, 3) each."""
        edge, _ = self.stations(view.t)
        t, d1 = view.state.tangents[edge], view.state.directors[edge]
        c, n = (f(view.theta[edge])[:, None] for f in (np.cos, np.sin))
        d2 = np.cross(t, d1)
        return c * d1 + n * d2, c * d2 - n * d1

    def onward(self, view: Observer) -> np.ndarray:
        """How the markers' places change as they move along their rods, shape (M, 3)."""
        edge, _ = self.stations(view.t)
        i, j = self.robot.graph.edges[edge].T
        return np.asarray((view.x[j] - view.x[i]) / self.robot.graph.rest_length[edge, None])

    @property
    def offsets(self) -> tuple[np.ndarray, np.ndarray]:
        """Offsets along them [m], shape (M, 1) each."""
        one, two = (
            (np.broadcast_to(o.value, len(self.edge)) + a.value[self.rod])[:, None]
            for o, a in ((self.offset1, self.aside1), (self.offset2, self.aside2))
        )
        return one, two

    @property
    def camera(self) -> tuple[np.ndarray, np.ndarray]:
        """What a place x is seen at, ``x @ A + b``, shapes (3, axes) and (axes,)."""
        turn = self.turn.T if np.any(self.rotation.value) else np.eye(3)
        return (self.scale.value * turn)[:, self.axes], np.broadcast_to(self.shift.value, 3)[self.axes]

    @property
    def offset(self) -> bool:
        """Whether any marker lies beside the centreline."""
        every = self.offset1, self.offset2, self.aside1, self.aside2
        return any(np.any(one.value) for one in every)

    @property
    def turn(self) -> np.ndarray:
        """Rotation of what is seen against the robot, shape (3, 3)."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_rotvec(np.array(np.broadcast_to(self.rotation.value, 3))).as_matrix()

    def measured(self, rec: Recording) -> np.ndarray:
        """Return positions of these markers [m], shape (T, M, axes); suspect ones are NaN."""
        if len(self.markers) != len(rec.names) and isinstance(self.markers[0], int):
            raise rec.error(
                f"has {len(rec.names)} markers, but {len(self.markers)} points are listed, one for each in order; "
                f"where only some are observed give their points by name: {{'{rec.names[0]}': ...}}"
            )
        return rec.trusted[:, [rec.marker(m) for m in self.markers]][:, :, self.axes]

    def written(self, rec: Recording, readings: np.ndarray) -> Recording:
        """Return the recording with other positions of these markers; axes that are not seen stay as they were."""
        markers = np.array(rec.markers, dtype=float)
        markers[:, np.array([rec.marker(m) for m in self.markers])[:, None], self.axes] = readings
        return rec.replace(markers=markers)

    def check(self, rec: Recording) -> None:
        """Raise if markers begin farther from their points than the robot is large."""
        first = self.measured(rec)
        if not np.isfinite(first).all(axis=2).any():
            raise rec.error(f"nothing of '{self.name}' was recorded: all its samples are lost or suspect")
        graph = self.robot.graph
        i, j = graph.edges[self.edge].T
        s = self.along[:, None]
        A, b = self.camera
        x = ((1.0 - s) * graph.x0[i] + s * graph.x0[j]) @ A + b
        k = int(np.argmax(np.isfinite(first).all(axis=2).sum(axis=1)))
        far = np.linalg.norm(first[k] - x, axis=1)
        if np.nanmin(far) > 3.0 * graph.size:
            raise rec.error(
                f"its markers are at least {np.nanmin(far):.3g} m from where the robot of {graph.size:.3g} m has them: "
                "units in millimetres (units='mm'), or another frame?"
            )
