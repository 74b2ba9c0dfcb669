"""Numbers of a medium that no default can stand for."""

from __future__ import annotations

from rodnet.errors import TermError
from rodnet.terms.base import Term


def require(term: Term, *names: str) -> None:
    """Raise `TermError` unless these parameters of a term are given: a default would pass for a measurement."""
    declared = term.declared()
    missing = [n for n in names if getattr(term, n).value is None]
    if missing:
        wanted = ", ".join(f"{n}= ({declared[n].doc}, {declared[n].unit})" for n in missing)
        raise TermError(f"{type(term).__name__}: give {wanted}; media differ too much for a default")
