"""What constraints prescribe, time by time: remembered, for one run after another asks for the same times."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple
from weakref import WeakValueDictionary

import numpy as np

from rodnet.parameters import Parameter

if TYPE_CHECKING:
    from rodnet.solve.model import Model
    from rodnet.terms.constraints import BoundConstraint, Constraint

MOST = 100_000  # times that are remembered of one motion
KINDS = 4  # motions that are remembered of one constraint
RUNS = 64  # constraints, of which it is remembered for which times they were asked
FIRST = 64  # times that are asked for at once to begin with


class Asked(NamedTuple):
    """For which times places were asked for, and for which times and steps rates were."""

    places: set[float]
    rates: set[tuple[float, float]]


class Known:
    """What one motion prescribes: places by time, and rates by time and step; and what of it runs have asked for.

    Motions of one ``kind`` follow the same functions of time: they differ in values of parameters and initial shapes.
    """

    def __init__(self, kind: Any = None) -> None:
        self.kind, self.asked = kind, Asked(set(), set())
        self.ahead: list[Asked] = []  # what will be asked for at once, portion by portion
        self.told = -np.inf  # time up to which it was
        self.places: dict[float, np.ndarray] = {}
        self.rates: dict[tuple[float, float], np.ndarray] = {}


# by content, as long as any constraint follows them: the robot of a recording is built again and again
_followed: WeakValueDictionary[Any, Known] = WeakValueDictionary()
# by kind, for which times the motion that was asked for most was, and the one that was begun last
_asked: dict[Any, tuple[Asked, Asked]] = {}


def begun(motion: Known) -> Asked:
    """Return for which times one of its kind was asked, that for most: a run after another asks for the same."""
    most, last = _asked.pop(motion.kind, (motion.asked, motion.asked))
    most = max(most, last, key=lambda one: len(one.places))
    while len(_asked) >= RUNS:
        del _asked[next(iter(_asked))]
    _asked[motion.kind] = most, motion.asked
    return most


def portions(asked: Asked) -> Iterator[Asked]:
    """Cut what was asked for into portions in order of time, each as large as all before it.

    So a short run hears no more than twice of what it asks for, whatever a long one asked.
    """
    places, rates, begin, count = sorted(asked.places), sorted(asked.rates), 0, FIRST
    first = 0
    while begin < len(places):
        last = bisect_right(rates, (places[min(count, len(places)) - 1], np.inf))
        yield Asked(set(places[begin:count]), set(rates[first:last]))
        begin, first, count = count, last, 2 * count


class Motions(list):
    """Motions of a constraint and its copies that are known: of attributes and initial shapes, the values by time."""

    def __reduce__(self) -> Any:  # other processes begin anew
        return Motions, ()

    def of(self, law: Constraint, shape: tuple[np.ndarray, ...]) -> Known:
        """Return what is known of a law with this initial shape: it is pure, so its attributes tell all.

        What another constraint has followed is known to one of the same class with the same attributes: functions count
        by their code, and the values that they enclose or use.
        """
        from rodnet.sweeps.fingerprint import fingerprint

        # how it was drawn is told by what it has become
        others = {k: v for k, v in vars(law).items() if v is not self and k != "_given"}
        values = {k: np.array(v.value) for k, v in others.items() if isinstance(v, Parameter)}
        own = {**others, **values}
        for attributes, arrays, known in self:
            same = attributes.keys() == own.keys() and all(_alike(v, own[k]) for k, v in attributes.items())
            if same and all(np.array_equal(a, b) for a, b in zip(arrays, shape, strict=True)):
                return known
        kind = fingerprint({k: v for k, v in own.items() if k not in values})
        content = (
            type(law),
            kind,
            *(a.tobytes() for a in shape),
            *((k, v.tobytes()) for k, v in values.items()),
        )
        self.append((own, shape, _followed.setdefault(content, Known(kind))))
        del self[:-KINDS]
        return self[-1][2]


def _alike(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return np.array_equal(one, other)
    return one is other


class PrescribedState:
    """Sets the degrees of freedom that one constraint prescribes, and their rates.

    Parameters
    ----------
    bound : BoundConstraint
        The constraint.
    model : Model
        The model.
    """

    def __init__(self, bound: BoundConstraint, model: Model) -> None:
        from rodnet.kinematics import held_kernels
        from rodnet.packed import Packed

        self.bound, self.twist0, self.kernels = bound, model.twist0, held_kernels
        shape = bound.x0, bound.arm, bound.frames0
        self._known = bound.law.motions.of(bound.law, shape)
        as_int = lambda a: np.ascontiguousarray(a, dtype=np.int64)  # noqa: E731
        arrays = bound.nodes, bound.placed, bound.eliminated, bound.edges, model.edges[bound.edges]
        self._held = Packed(held_kernels.HELD, *map(as_int, arrays))

    def _place(self, t: float) -> np.ndarray:
        """Positions and first directors, flat."""
        known = self._known
        if not known.places:
            known.ahead, known.told = list(portions(begun(known))), -np.inf
        _add(known.asked.places, t)
        if t > known.told:
            self._ask_ahead()
        found = known.places.get(t)
        if found is None:
            b = self.bound
            directors = b.directors(t) if len(b.edges) else np.zeros(0)
            found = _keep(known.places, t, np.concatenate([b.positions(t).ravel(), directors.ravel()]))
        return found

    def _ask_ahead(self) -> None:
        """Ask at once for a portion of what was asked for before: one by one it takes ten times as long."""
        known = self._known
        known.told = np.inf
        if not known.ahead:
            return
        before = known.ahead.pop(0)
        found = self.bound.together(np.array(list(before.places)))
        if found is None:
            return
        flat = lambda *parts: np.concatenate([p.reshape(len(p), -1) for p in parts], axis=1)  # noqa: E731
        places = dict(zip(before.places, flat(*found[:2]), strict=True))
        rates = {}
        if before.rates:
            t, h = np.array(list(before.rates)).T
            some = [self.bound.together(asked) for asked in (t, t - h, t + h)]
            if any(one is None for one in some):
                return
            (now, _, R), (start, _, R0), (end, _, R1) = some  # type: ignore[misc]
            h = h[:, None, None]
            rate = (R1 - R0) @ np.swapaxes(R, 1, 2) / (2.0 * h)
            axes = ((2, 1), (0, 2), (1, 0))
            turning = 0.5 * np.stack([rate[:, i, j] - rate[:, j, i] for i, j in axes], axis=1)
            values = flat((end - start) / (2.0 * h), (end - 2.0 * now + start) / h**2, turning)
            if not len(self.bound.edges):
                values[:, -3:] = 0.0
            rates = dict(zip(before.rates, values, strict=True))
        known.told = max(before.places)
        known.places.update(places)
        known.rates.update(rates)

    def place(self, q: np.ndarray, t: float) -> None:
        """Set positions at a time."""
        self.kernels.place(self._held.table, self._place(t), q)

    def orient(
        self, q: np.ndarray, t: float, theta_near: np.ndarray, source: tuple[np.ndarray, np.ndarray]
    ) -> None:
        """Set twist angles at a time, all positions being set; see `Model.prescribe`."""
        if len(self.bound.edges):
            self.kernels.orient(self._held.table, self._place(t), q, self.twist0, theta_near, *source)

    def move(self, q: np.ndarray, t: float, h: float, v: np.ndarray, a: np.ndarray) -> None:
        """Set velocities and accelerations, by central differences of step ``h``."""
        _add(self._known.asked.rates, (t, h))
        found = self._known.rates.get((t, h))
        if found is None:
            b = self.bound
            before, after = b.positions(t - h), b.positions(t + h)
            now = self._place(t)[: before.size].reshape(-1, 3)
            rates = (after - before) / (2.0 * h), (after - 2.0 * now + before) / h**2
            turning = b.turning(t, h) if len(b.edges) else np.zeros(3)
            values = np.concatenate([rates[0].ravel(), rates[1].ravel(), turning])
            found = _keep(self._known.rates, (t, h), values)
        self.kernels.move(self._held.table, found, q, self.twist0, v, a)


def _add(asked: set, key: Any) -> None:
    if len(asked) >= MOST:
        asked.clear()
    asked.add(key)


def _keep(known: dict, key: Any, values: np.ndarray) -> np.ndarray:
    if len(known) >= MOST:
        known.clear()
    known[key] = values
    return values
