"""What data determine, and what only in combination: the eigen-directions of the information, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rodnet.inference.quantities import Quantity

DETERMINED, UNDETERMINED = 0.1, 1.0  # standard deviation of a logarithm
SMALL = 0.2  # share of the largest component below which one is not mentioned
WHOLE = 0.15  # how far from one an exponent counts as one
FLOOR = 1e-14  # of the largest eigenvalue: none at all
MANY = 1e3  # a standard deviation that is as good as infinite


@dataclass(frozen=True)
class Direction:
    """A combination of parameters and how well it is known.

    Attributes
    ----------
    sd : float
        Standard deviation along it: of a logarithm, relative.
    weights : dict
        Components by path, of a unit vector.
    words : str
        The combination, as a product of powers.
    """

    sd: float
    weights: dict[str, float]
    words: str


@dataclass(frozen=True)
class Identifiability:
    """Which parameters the data determine.

    Attributes
    ----------
    directions : list of Direction
        From the best known to the least known.
    sd : dict
        Relative standard deviation of each parameter by itself, the others unknown.
    correlation : ndarray, shape (k, k)
        Between the parameters, in the order of ``sd``.
    sentences : list of str
        The same in words.
    """

    directions: list[Direction]
    sd: dict[str, float]
    correlation: np.ndarray
    sentences: list[str]

    def __str__(self) -> str:
        return "\n".join(self.sentences)


def invert(information: np.ndarray) -> np.ndarray:
    """Covariance of an information matrix; directions without information get a huge variance, not an error."""
    values, vectors = np.linalg.eigh(0.5 * (information + information.T))
    largest = max(float(values.max(initial=0.0)), 1e-300)
    return np.asarray((vectors / np.maximum(values, FLOOR * largest)) @ vectors.T)


def identify(
    quantities: Sequence[Quantity], information: np.ndarray, factor: float = 1.0,
    most: Mapping[str, float] | None = None, least: Mapping[str, float] | None = None,
) -> Identifiability:  # fmt: skip
    """Explain an information matrix.

    Parameters
    ----------
    quantities : sequence of Quantity
        The unknowns; those of single trials are nuisances, and are averaged over.
    information : ndarray, shape (k, k)
        In their coordinates.
    factor : float
        By which variances are larger than it says.
    most : mapping, optional
        Upper ends of the intervals of what has vanished, by path.
    least : mapping, optional
        Lower ends of the intervals of what has grown as far as it is searched.
    """
    shared = [k for k, q in enumerate(quantities) if q.trial is None]
    if not shared:
        return Identifiability([], {}, np.zeros((0, 0)), ["there are no common parameters"])
    rest = [k for k in range(len(quantities)) if k not in shared]
    own = information[np.ix_(shared, shared)]
    if rest:
        cross = information[np.ix_(shared, rest)]
        own = own - cross @ invert(information[np.ix_(rest, rest)]) @ cross.T
    values, vectors = np.linalg.eigh(0.5 * (own + own.T))
    floor = FLOOR * max(float(values.max(initial=0.0)), 1e-300)
    sds = np.sqrt(factor / np.maximum(values, floor))
    listed = [quantities[k] for k in shared]
    directions = [
        Direction(float(sd), {q.path: float(w) for q, w in zip(listed, v, strict=True)}, words(listed, v))
        for sd, v in zip(sds[::-1], vectors.T[::-1], strict=True)
    ]
    covariance = factor * (vectors / np.maximum(values, floor)) @ vectors.T
    sd = np.sqrt(np.diag(covariance))
    by_path = {q.path: float(s) for q, s in zip(listed, sd, strict=True)}
    correlation = covariance / np.outer(sd, sd)
    gone = {
        q.path: f"not needed: {q.path} (0 fits as well as anything below {most[q.path]:.2g} {q.unit})"
        for q in listed
        if most and q.path in most
    }
    gone |= {
        q.path: f"known to one side: {q.path} is at least {least[q.path]:.2g} {q.unit}, whatever is larger fits as well"
        for q in listed
        if least and q.path in least
    }
    return Identifiability(directions, by_path, correlation, _sentences(directions, by_path, gone))


def words(quantities: Sequence[Quantity], vector: np.ndarray) -> str:
    """A direction as a product of powers, the largest exponent being one: ``"drag.viscosity / tail0.E"``.

    What is not searched by its logarithm appears as a change against its scale, ``"[markers.lag]"``.
    """
    largest = vector[int(np.argmax(np.abs(vector)))]
    above: list[str] = []
    below: list[str] = []
    for k in np.argsort(-np.abs(vector), kind="stable"):
        power = vector[k] / largest
        if abs(power) < SMALL:
            continue
        name = quantities[k].path if quantities[k].log else f"[{quantities[k].path}]"
        size = abs(power)
        text = name if abs(size - 1.0) <= WHOLE else f"{name}^{size:.2g}"
        (above if power > 0 else below).append(text)
    return " × ".join(above) + "".join(f" / {name}" for name in below)


def percent(sd: float) -> str:
    """A relative standard deviation as people read it, two of them."""
    return f"± {200 * sd:.2g} %" if sd < 0.5 else f"within a factor of {np.exp(min(2 * sd, 50)):.2g}"


def _sentences(directions: list[Direction], sd: dict[str, float], gone: Mapping[str, str]) -> list[str]:
    good = {path: s for path, s in sd.items() if s <= DETERMINED}
    found = []
    if good:
        found.append("determined: " + ", ".join(f"{path} ({percent(s)})" for path, s in good.items()))
    found += gone.values()
    bad = [path for path in sd if path not in good and path not in gone]
    directions = [d for d in directions if not set(_mentioned(d)) <= set(gone)]
    for direction in directions:
        involved = _mentioned(direction)
        if direction.sd <= DETERMINED and len(involved) > 1 and any(path in bad for path in involved):
            found.append(f"only in combination: {direction.words} ({percent(direction.sd)})")
    for direction in reversed(directions):
        if direction.sd > DETERMINED:
            degree = "undetermined" if direction.sd > UNDETERMINED else "poorly determined"
            known = "any value fits" if direction.sd > MANY else percent(direction.sd)
            found.append(f"{degree}: {direction.words} ({known})")
    for path in bad:
        if not any(d.sd > DETERMINED and path in _mentioned(d) for d in directions):
            found.append(f"poorly determined: {path} ({percent(sd[path])})")
    return found


def _mentioned(direction: Direction) -> list[str]:
    largest = max(abs(w) for w in direction.weights.values())
    return [path for path, w in direction.weights.items() if abs(w) >= SMALL * largest]
