"""Any installed term that vanishes at a null value, as a candidate: added everywhere."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from rodnet.diagnosis.candidate import Candidate, Family, add_terms
from rodnet.parameters import Parameter
from rodnet.recordings.observation import Observation
from rodnet.robot import Robot
from rodnet.terms.base import Term

SHAPES = (
    3  # parameters beside strengths that are fitted; a law with more is many laws, and fits what it isn't
)
GROUP = {"drag": "medium", "load": "load", "contact": "medium", "energy": "rod", "actuator": "actuator"}


@dataclass(frozen=True)
class Everywhere:
    """Makes the candidate "add this term everywhere".

    Its strengths are the parameters with a null value, all at it; a tenth of what they are by default is a change worth
    considering. The others stay at their defaults, and those of the kind ``"shape"`` are its shape, if they are few. A
    candidate of its own says which of many are to be fitted.
    """

    id: str
    cls: type[Term]

    def __call__(self, robot: Robot, instruments: Sequence[Observation] = ()) -> Iterator[Candidate]:
        own = self.cls.declared()
        every, strength = [k for k in own if _vanishes(own[k])], _strengths(self.cls)
        shape = [p.name for p in _shape(self.cls) if p.name not in every]
        if not strength:
            return
        options = {"name": self.id, **{k: _null(own[k]) for k in every}}
        yield Candidate(
            id=self.id,
            title=_title(self.cls),
            group=GROUP.get(self.cls.kind, "medium"),
            build=partial(add_terms, parts=((self.cls, options),)),
            strength=tuple(f"{self.id}.{k}" for k in strength),
            shape=tuple(f"{self.id}.{k}" for k in shape),
            scale=partial(_tenths, of={f"{self.id}.{k}": _tenth(own[k]) for k in strength}),
            usual=True,
            falsifier=f"what the law says: {_title(self.cls)}",
        )


def _tenth(p: Parameter) -> float:
    """A tenth of the way from the null value to the value that a term has where nobody gives one; 0 if that is it."""
    return 0.1 * abs(float(p.value) - float(p.null or 0.0))


def _tenths(robot: Robot, duration: float, of: Mapping[str, float]) -> dict[str, float]:
    """Changes worth considering of strengths whose author says what they are like."""
    return {path: change for path, change in of.items() if change > 0.0}


def _vanishes(p: Parameter) -> bool:
    return p.null is not None and p.kind == "strength" and p.value is not None


def _null(p: Parameter) -> Any:
    """The null value, of many values as many times."""
    return np.full(np.shape(p.value), p.null) if np.ndim(p.value) else p.null


def _strengths(cls: type[Term]) -> list[str]:
    """Names of single numbers: which of many values to fit a candidate of its own must say."""
    return [k for k, p in cls.declared().items() if _vanishes(p) and np.ndim(p.value) == 0]


def _shape(cls: type[Term]) -> tuple[Parameter, ...]:
    found = tuple(p for p in cls.declared().values() if p.kind == "shape" and p.value is not None)
    return found if len(found) <= SHAPES else ()


def _title(cls: type[Term]) -> str:
    """The first line of its docstring, as titles are written: without a formula, and with a small letter."""
    import inspect

    words = (inspect.getdoc(cls) or cls.__name__).partition("\n")[0].rstrip(".")
    words = re.split(r",? \w+ = ", words)[0]
    return words[0].lower() + words[1:] if words[1:2].islower() and " " in words else words


def term_family(name: str, cls: type[Term]) -> Family:
    """Return the family of a class of terms, whose one candidate adds it everywhere."""
    strength = tuple(cls.declared()[name] for name in _strengths(cls))
    title = _title(cls)
    return Family(
        name, title, GROUP.get(cls.kind, "medium"), f"what the law says: {title}", Everywhere(name, cls), strength,
        _shape(cls), (cls,),
    )  # fmt: skip
