"""Candidates about instruments: markers beside their places, cameras that are off, records that run late."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from rodnet.diagnosis.bank.making import soft_rods, unchanged
from rodnet.diagnosis.candidate import Candidate, Family
from rodnet.inference.naive import prescribed
from rodnet.parameters import Parameter
from rodnet.recordings.observation import Markers, Observation
from rodnet.recordings.recording import Recording
from rodnet.robot import Robot


def _paths(one: Observation, name: str) -> Iterator[str]:
    """Paths of all numbers of an instrument's parameter."""
    parameter: Parameter = getattr(one, name)
    if np.ndim(parameter.value):
        yield from (f"{one.name}.{name}[{k}]" for k in range(np.size(parameter.value)))
    else:
        yield f"{one.name}.{name}"


def _family(
    id: str, title: str, falsifier: str, cls: type[Observation], names: tuple[str, ...], whole: bool = True
) -> Family:  # fmt: skip
    """A family with one candidate for each instrument of a class."""

    def make(robot: Robot, instruments: Sequence[Observation]) -> Iterator[Candidate]:
        for one in instruments:
            if isinstance(one, cls):
                yield Candidate(
                    id=f"{id}@{one.name}",
                    title=f"{title} ({one.name})",
                    group="observation",
                    build=unchanged,
                    strength=tuple(path for name in names for path in _paths(one, name)),
                    falsifier=falsifier,
                    observe=True,
                    whole=whole,
                )

    return Family(id, title, "observation", falsifier, make, tuple(cls.declared()[name] for name in names))


_beside = _family(
    "marker-offset",
    "markers that sit beside the rod's axis",
    "where the rod turns about its axis the markers go round it; where it only bends they stay on one side",
    Markers,
    ("offset1", "offset2"),
    whole=False,
)


def _offsets(robot: Robot, instruments: Sequence[Observation]) -> Iterator[Candidate]:
    """Offsets of all markers alike, by their rods' directors; and of those of each rod, for directors are chosen."""
    for one in _beside.make(robot, instruments):
        yield one
        (eye,) = (i for i in instruments if one.id == f"{_beside.id}@{i.name}")
        if isinstance(eye, Markers) and len(eye.rods) > 1:
            yield replace(
                one,
                id=f"{one.id}:each",
                title=f"{one.title}, on each rod on a side of its own",
                strength=tuple(path for name in ("aside1", "aside2") for path in _paths(eye, name)),
            )


marker_offset = replace(_beside, make=_offsets)


def _each(id: str, title: str, falsifier: str, name: str) -> Family:
    """A family with one candidate for each marker on a rod that bends: one number of a parameter of `Markers`."""

    def make(robot: Robot, instruments: Sequence[Observation]) -> Iterator[Candidate]:
        soft = np.concatenate([rod.edges for rod in soft_rods(robot, 1)] or [np.zeros(0, dtype=int)])
        for one in instruments:
            if isinstance(one, Markers):
                for k in np.flatnonzero(np.isin(one.edge, soft)):
                    yield Candidate(
                        id=f"{id}@{one.name}:{one.markers[k]}",
                        title=f"{title} (marker {one.markers[k]} of {one.name})",
                        group="marker",
                        build=unchanged,
                        strength=(f"{one.name}.{name}[{k}]",),
                        falsifier=falsifier,
                        observe=True,
                    )

    return Family(id, title, "marker", falsifier, make, (Markers.declared()[name],))


marker_place = _each(
    "marker-place",
    "a marker that sits elsewhere along its rod",
    "the others are where they should be, and the distance to them is the same in every trial",
    "misplaced",
)
marker_slip = _each(
    "marker-slip",
    "a marker that slips along its rod",
    "the others are where they should be, and the distance to them grows with time, at rest as well",
    "drift",
)


def possible(
    found: Sequence[Candidate],
    instruments_of: Callable[[Recording], Sequence[Observation]],
    recs: Sequence[Recording],
) -> list[Candidate]:
    """Those candidates that can be about the instruments of recordings.

    What markers that drive the model show is what it does, and a marker is known by its number: where trials have
    unlike ones, none is tried by itself.
    """
    seen = [instruments_of(rec) for rec in recs]
    names = lambda rec, one: [rec.names[rec.marker(m)] for m in one.markers]  # noqa: E731
    drive, unlike = set(), set()
    saw = {one.name for one in seen[0] if prescribed(recs[0], one).any()}
    for rec, instruments in zip(recs, seen, strict=True):
        for one, first in zip(instruments, seen[0], strict=False):
            if not (isinstance(one, Markers) and isinstance(first, Markers)):
                continue
            if names(rec, one) != names(recs[0], first):
                unlike.add(one.name)
                continue
            driving = prescribed(rec, one)
            drive |= {f"{one.name}:{name}" for name, yes in zip(one.markers, driving, strict=True) if yes}
    return [
        c for c in found
        if not (c.whole and c.on in saw)
        and not (c.group == "marker" and (c.on in drive or c.on.partition(":")[0] in unlike))
    ]  # fmt: skip


camera_scale = _family(
    "camera-scale",
    "a camera whose scale is off",
    "all distances between markers are off by one factor, in rigid motion, too",
    Markers,
    ("scale",),
)
camera_rotation = _family(
    "camera-rotation",
    "a camera that is turned against the model's axes",
    "the whole picture is turned by one angle, which does not depend on what the robot does",
    Markers,
    ("rotation",),
)
camera_shift = _family(
    "camera-shift",
    "a camera whose origin is off",
    "the whole picture is shifted by one vector, which does not depend on what the robot does",
    Markers,
    ("shift",),
)
record_lag = _family(
    "record-lag",
    "a record that runs late",
    "everything that an instrument reads comes late by one time, the robot's rest included",
    Observation,
    ("lag",),
)
