"""Named, unit-bearing parameters, and how the terms of a robot declare and share them."""

from __future__ import annotations

import copy
import difflib
import inspect
import math
from collections.abc import Iterator
from numbers import Real
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np

from rodnet.errors import ParameterError


def is_number(value: object) -> bool:
    """Whether something is one finite number, and not a text, a list or None."""
    return isinstance(value, Real) and math.isfinite(value)


class Parameter:
    """A physical quantity that a term or a rod depends on.

    As a class attribute of a term it *declares* a parameter and its default; every
    instance of the term then has a copy of its own, unless one ``Parameter`` object is
    passed to several terms, which share it.

    Parameters
    ----------
    value : float or array_like
        Value in SI units; a scalar, or one value per site.
    unit : str
        SI unit, e.g. ``"Pa s"``; ``"1"`` for a ratio, ``"rad"`` for an angle.
    bounds : tuple
        Lower and upper bound; ``None`` stands for no bound.
    null : float, optional
        The value at which the effect is absent (used when a term is a candidate explanation).
    kind : {"strength", "shape"}
        Whether the parameter scales the effect or shapes it.
    prior : object, optional
        A frozen ``scipy.stats`` distribution, if something is known beforehand.
    doc : str
        One line that says what it is.

    Raises
    ------
    ParameterError
        If the value is not finite or lies outside the bounds.
    """

    def __init__(
        self,
        value: Any,
        unit: str = "1",
        *,
        bounds: tuple[float | None, float | None] = (None, None),
        null: float | None = None,
        kind: str = "strength",
        prior: Any = None,
        doc: str = "",
        name: str = "",
    ) -> None:
        try:
            low, high = (
                s if b is None else float(b) for s, b in zip((-math.inf, math.inf), bounds, strict=True)
            )
        except (TypeError, ValueError):
            low = high = math.nan
        if not low <= high:
            who = f" of parameter '{name}'" if name else ""
            raise ParameterError(
                f"the bounds{who} are {bounds!r}; give (low, high) in [{unit}], with None for an open end"
            )
        if kind not in ("strength", "shape"):
            raise ParameterError(f"a parameter's kind is 'strength' or 'shape', not {kind!r}")
        self.unit, self.bounds, self.null, self.kind = unit, (low, high), null, kind
        self.prior, self.doc, self.name = prior, doc, name
        self.value = value

    def __set_name__(self, owner: type, name: str) -> None:
        if not self.name:
            self.name = name

    @property
    def value(self) -> Any:
        """The value, a float or an array, in SI units."""
        return self._value

    @value.setter
    def value(self, value: Any) -> None:
        if value is None:  # an optional parameter that is not in use
            self._value: Any = None
            return
        if type(value) is float and math.isfinite(value) and self.bounds[0] <= value <= self.bounds[1]:
            self._value = value  # as most are, thousands of times when candidates are tried
            return
        try:
            array = np.asarray(value, dtype=float)
        except (TypeError, ValueError):
            raise ParameterError(f"{self._title} must be a number in [{self.unit}], got {value!r}") from None
        low, high = self.bounds
        if not np.all(np.isfinite(array)):
            raise ParameterError(f"{self._title} = {value!r} is not finite; give a number in [{self.unit}]")
        if np.any(array < low) or np.any(array > high):
            raise ParameterError(
                f"{self._title} = {value!r} [{self.unit}] is outside its bounds [{low:g}, {high:g}]"
            )
        self._value = float(array) if array.ndim == 0 else array

    @property
    def _title(self) -> str:
        """What messages call it: by name, once it has one, else by what it is."""
        if self.name:
            return f"parameter '{self.name}'"
        return f"a parameter ({self.doc})" if self.doc else "a parameter"

    def with_value(self, value: Any) -> Parameter:
        """Return a copy of this parameter with another value."""
        other = copy.copy(self)
        other.value = value
        return other

    def __repr__(self) -> str:
        return f"Parameter({self.name or '?'} = {self.value!r} [{self.unit}])"


class Parametrised:
    """Mixin that turns class-level `Parameter` declarations into instance parameters."""

    _declared: ClassVar[dict[str, Parameter]]  # of each class, once it was asked for

    @classmethod
    def declared(cls) -> dict[str, Parameter]:
        """Return the parameters that the class declares, by name, base classes first."""
        if "_declared" not in vars(cls):
            found: dict[str, Parameter] = {}
            for base in reversed(cls.__mro__):
                found.update({k: v for k, v in vars(base).items() if isinstance(v, Parameter)})
            cls._declared = found
        return dict(cls._declared)

    @classmethod
    def arguments(cls) -> list[str]:
        """Return the names of what the constructor takes, parameters last."""
        found: list[str] = []
        for base in cls.__mro__:
            if "__init__" not in vars(base) or not issubclass(base, Parametrised):
                continue
            taken = dict(inspect.signature(base.__init__).parameters)
            del taken[next(iter(taken))]  # self
            found += [k for k, p in taken.items() if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
            if not any(p.kind is p.VAR_KEYWORD and k != "parameters" for k, p in taken.items()):
                break  # what else is given are parameters, and nothing for a base class
        return list(dict.fromkeys([*found, *cls.declared()]))

    def set_parameters(self, given: dict[str, Any]) -> None:
        """Take ``given`` values or shared `Parameter` objects for the declared parameters.

        Raises
        ------
        ParameterError
            For an undeclared name, a value out of bounds, or a shared parameter in another unit.
        """
        declared = self.declared()
        unknown = sorted(set(given) - set(declared))
        if unknown:
            taken = self.arguments()
            close = difflib.get_close_matches(unknown[0], taken, n=1)
            raise ParameterError(
                f"{type(self).__name__} has no parameter {', '.join(map(repr, unknown))}; it has "
                f"{', '.join(declared) or 'none'}, and takes {', '.join(k for k in taken if k not in declared)}"
                + (f" (did you mean {close[0]}?)" if close else "")
            )
        for name, default in declared.items():
            value = given.get(name)
            if isinstance(value, Parameter):
                if value.unit != default.unit:
                    raise ParameterError(
                        f"{type(self).__name__}.{name} is in [{default.unit}], but the parameter passed for it "
                        f"is in [{value.unit}]"
                    )
                low, high = default.bounds
                if value.value is None:
                    raise ParameterError(f"{type(self).__name__}.{name}: the shared parameter has no value")
                if np.any(np.asarray(value.value) < low) or np.any(np.asarray(value.value) > high):
                    raise ParameterError(
                        f"{type(self).__name__}.{name} = {value.value!r} is outside [{low:g}, {high:g}]"
                    )
                value.name = value.name or name
                setattr(self, name, value)
            else:
                setattr(self, name, default.with_value(default.value if value is None else value))

    def parameter_items(self) -> Iterator[tuple[str, Parameter]]:
        """Iterate over ``(name, Parameter)`` of this instance that are in use."""
        for name in self.declared():
            if getattr(self, name).value is not None:
                yield name, getattr(self, name)

    def values(self, sites: int | None = None) -> SimpleNamespace:
        """Return the parameter values as a namespace; arrays get shape ``(n, 1)`` for ``n`` sites."""
        out = SimpleNamespace()
        for name in self.declared():
            value = getattr(self, name).value
            if np.ndim(value) and sites is not None:
                value = np.asarray(value, dtype=float).reshape(-1, 1)
                if len(value) != sites:
                    raise ParameterError(
                        f"parameter '{name}' of {type(self).__name__} has {len(value)} values for {sites} "
                        "sites; give one number, or one per site"
                    )
            setattr(out, name, value)
        return out
