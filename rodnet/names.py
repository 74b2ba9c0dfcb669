"""Things by name, which answer a wrong name with those that there are."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from typing import Any, NoReturn

from rodnet.errors import UnknownNameError


class Named(dict[str, Any]):
    """A dict of things of one kind.

    Parameters
    ----------
    items : mapping or iterable of pairs
        The things by name.
    what : str
        What one of them is, for messages: ``"rod"``.

    Raises
    ------
    UnknownNameError
        A KeyError, for a name that is not there; lists those that are.
    """

    def __init__(
        self, items: Mapping[str, Any] | Iterable[tuple[str, Any]] = (), *, what: str = "name"
    ) -> None:
        super().__init__(items)
        self.what = what

    def __missing__(self, name: Any) -> NoReturn:
        raise UnknownNameError(f"there is no {self.what} {name!r}; {meant(name, self)}{listed(self)}")


def meant(name: Any, known: Iterable[str]) -> str:
    """Return a question for somebody who may have meant another name; empty if none is close."""
    close = difflib.get_close_matches(str(name), list(known), n=1, cutoff=0.6)
    return f"did you mean {close[0]!r}? " if close else ""


def listed(known: Iterable[str]) -> str:
    """Return the names that there are as the end of a sentence."""
    return f"there are {', '.join(map(str, known)) or 'none'}"
