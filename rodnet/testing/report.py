"""What checks report: a table of the largest errors, or an error that says what to do."""

from __future__ import annotations

from rodnet.errors import TermError


class ContractError(TermError, AssertionError):
    """A term or stepper breaks its contract; names the check, the culprit, the error and the remedy."""


class Report:
    """The checks that a term or stepper passed, with the largest error of each.

    Attributes
    ----------
    subject : str
        What was checked.
    errors : dict
        ``(largest error, allowed error)`` by name of check; ``(0, 0)`` for a plain yes or no.
    """

    def __init__(self, subject: str) -> None:
        self.subject = subject
        self.errors: dict[str, tuple[float, float]] = {}

    def require(self, check: str, error: float, allowed: float, problem: str, remedy: str) -> None:
        """Record an error; raise `ContractError` if it is larger than allowed (or not a number)."""
        error = float(error)
        before = self.errors.get(check, (0.0, 0.0))[0]
        if not error <= allowed:
            raise ContractError(
                f"{self.subject} fails the check '{check}': {problem}; the largest error is {error:.2g}, "
                f"allowed is {allowed:.0g}. {remedy}"
            )
        self.errors[check] = (max(before, error), allowed)

    def demand(self, check: str, ok: bool, problem: str, remedy: str) -> None:
        """Record a check that holds or does not; raise `ContractError` if it does not."""
        if not ok:
            raise ContractError(f"{self.subject} fails the check '{check}': {problem}. {remedy}")
        self.errors.setdefault(check, (0.0, 0.0))

    def __repr__(self) -> str:
        width = max(map(len, self.errors), default=0)
        lines = [f"{self.subject}: {len(self.errors)} checks passed"]
        for check, (error, allowed) in self.errors.items():
            lines.append(
                f"  {check:{width}}  " + (f"{error:8.1e}  (allowed {allowed:.0e})" if allowed else "ok")
            )
        return "\n".join(lines)
