"""The errors that rodnet raises: each names the culprit and the remedy."""

from __future__ import annotations

from typing import Any


class RodnetError(Exception):
    """Base class of every error that rodnet raises on purpose."""


class PlausibilityWarning(UserWarning):
    """A number is more likely in another unit than meant."""


class PathDependenceWarning(UserWarning):
    """A static equilibrium is one of many: which one is reached depends on the way, and that was the solver's."""


class GraphError(RodnetError, ValueError):
    """A stick figure, a graph or a selector is not well formed."""


class MeshError(RodnetError, ValueError):
    """A mesh or a drawing cannot become rods."""


class ParameterError(RodnetError, ValueError):
    """A parameter value, unit or bound is not admissible."""


class TermError(RodnetError, ValueError):
    """A term cannot be bound to the graph, or breaks its contract."""


class DisplacedStartError(TermError):
    """A prescribed motion begins elsewhere than the robot was drawn."""


class StepTooLongError(TermError):
    """A term cannot follow in so long a time step.

    Attributes
    ----------
    limit : float
        Step that it needs at most [s].
    """

    def __init__(self, message: str, limit: float) -> None:
        super().__init__(message)
        self.limit = limit


class NotCopyableError(RodnetError, TypeError):
    """An object of the moment cannot be copied or pickled; the message says what can."""


class UnknownNameError(RodnetError, KeyError):
    """Nothing goes by that name; the message lists what there is."""

    __str__ = Exception.__str__  # a KeyError shows its message in quotes


class OutputError(RodnetError, OSError):
    """A result cannot be written, or a file cannot be read."""


class RobotFileError(RodnetError, ValueError):
    """A robot cannot be written to a file, or a file does not describe one."""


class RecordingError(RodnetError, ValueError):
    """A recording cannot be read, or cannot be what was measured."""


class CaseError(RodnetError, ValueError):
    """A case cannot be loaded, or doesn't say what it must."""


class SweepError(RodnetError, RuntimeError):
    """A sweep cannot go on: its worker processes do not start, or its executor stopped."""


class SingularMatrixError(RodnetError, ArithmeticError):
    """The Jacobian is singular to working precision.

    Attributes
    ----------
    dof : int or None
        Index of the reduced degree of freedom without a pivot, where it is known.
    """

    def __init__(self, message: str, dof: int | None = None) -> None:
        super().__init__(message)
        self.dof = dof


class DerivativeError(RodnetError, ArithmeticError):
    """What is asked for has no derivative: a law has a corner, or a jump, where it is evaluated."""


class EquilibriumError(RodnetError, RuntimeError):
    """No static equilibrium was found; free rigid modes are named in the message."""


class ConvergenceError(RodnetError, RuntimeError):
    """A time step did not converge at the smallest admissible time step.

    Attributes
    ----------
    trajectory : Trajectory or None
        Everything computed before the failing step.
    time : float
        Time of the last accepted state [s].
    worst : str
        The degree of freedom with the largest scaled residual, by rod name.
    debug_path : str or None
        The ``.rrd`` file with the failing step's Newton iterates, if it was written.
    """

    def __init__(
        self,
        message: str,
        *,
        trajectory: Any = None,
        time: float = float("nan"),
        worst: str = "",
        debug_path: str | None = None,
    ) -> None:
        super().__init__(message)
        self.trajectory = trajectory
        self.time = time
        self.worst = worst
        self.debug_path = debug_path


class FoldedStateError(ConvergenceError):
    """Two edges of a spring fold back on each other (relative turning angle near pi)."""
