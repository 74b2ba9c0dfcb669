"""The contract of a term: declared parameters, a selector, and what it adds to a bound model.

Users write *local laws* (`DragModel`, `EnergyModel`, `LoadModel`, `Actuator`, `Constraint`);
a whole-state `Term` that returns its own `BoundTerm` is the escape hatch underneath, and the
built-in terms use the same interface.
"""

from __future__ import annotations

import difflib
import inspect
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from rodnet.errors import TermError
from rodnet.graph.selectors import as_list
from rodnet.parameters import Parametrised

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.pattern import Pattern


class Term(Parametrised):
    """A piece of physics with named parameters, bound once to a graph.

    Parameters
    ----------
    on : str or sequence of str
        Selector of the rods, edges or nodes that it acts on.
    name : str, optional
        Its name in parameter paths and energy tables (default: the class's).
    **parameters
        Values or shared `Parameter` objects for the declared parameters.

    Attributes
    ----------
    kind : str
        ``"energy"``, ``"drag"``, ``"load"``, ``"contact"``, ``"actuator"`` or ``"constraint"``.
    source : str
        Where the law comes from (paper, equation).
    claims : set of str
        Properties that `rodnet.testing.check_term` must then confirm: ``"dissipative"``,
        ``"objective"``, ``"conservative"``.
    regime : str
        What the law depends on beside its rods, for a diagnosis to tell: ``"speed"``, ``"curvature"``,
        ``"spacing"``, ``"depth"`` or ``"time"``.
    contains : tuple of str
        Ids of candidates (``rodnet terms --candidates``) that are special cases of it, or the same law by another
        name: beside them a diagnosis does not take it for another explanation.
    once : bool
        Whether two of a name on the same rods are taken for a mistake.
    """

    kind: ClassVar[str] = "term"
    source: ClassVar[str] = ""
    claims: ClassVar[set[str]] = set()
    regime: ClassVar[str] = ""
    contains: ClassVar[tuple[str, ...]] = ()
    once: ClassVar[bool] = False
    default_name: ClassVar[str] = ""
    # what `rodnet.testing.check_term` passes to build an example of a term with required arguments
    example: ClassVar[dict[str, Any]] = {}

    # what the constructor was given, so that a robot can be written to a file
    _given: tuple[tuple[Any, ...], dict[str, Any]] = (), {}

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:
        if args or kwargs:  # copies are made without
            try:
                inspect.signature(cls.__init__).bind(None, *args, **kwargs)
            except TypeError as error:
                raise TermError(f"{cls.__name__}: {error}; it takes {_usage(cls, kwargs)}") from None
        term = super().__new__(cls)
        term._given = args, kwargs
        return term

    def __init__(self, on: Any = "*", *, name: str | None = None, **parameters: Any) -> None:
        self.on = as_list(on)
        self.name = name or self.default_name or type(self).__name__.lower()
        self.set_parameters(parameters)

    def bind(self, model: Model) -> BoundTerm:
        """Return what the assembler calls; raise `TermError` or `GraphError` if it cannot act here."""
        raise TermError(
            f"{type(self).__name__} does not say how it acts: implement bind(model), or derive from a local law"
        )

    def add_masses(self, model: Model) -> None:
        """Add to ``model.node_mass`` and ``model.edge_inertia``, before any term is bound; nothing by default."""

    def check_numbers(self) -> None:
        """Raise `TermError` unless every parameter is one number: for terms without sites."""
        for name, p in self.parameter_items():
            if np.ndim(p.value):
                raise TermError(f"{self.kind} '{self.name}': {name} must be one number, not {p.value}")

    def __repr__(self) -> str:
        values = ", ".join(f"{k}={p.value!r} {p.unit}" for k, p in self.parameter_items())
        return f"{type(self).__name__}({values}{', ' if values else ''}on={self.on})"


def _usage(cls: type[Term], given: dict[str, Any]) -> str:
    """What a term's constructor takes, for a message."""
    known = cls.arguments()
    odd = [name for name in given if name not in known]
    close = difflib.get_close_matches(odd[0], known, n=1) if odd else []
    return ", ".join(f"{name}=" for name in known) + (f" (did you mean {close[0]}=?)" if close else "")


class BoundTerm:
    """A term bound to a model: adds its forces and Jacobian at each evaluation.

    Attributes
    ----------
    term : Term
        The term.
    stencils : list of ndarray, shapes (m, k)
        Degrees of freedom of the dense blocks that it adds to the Jacobian; declared at binding, and
        emptied when `slots` are known.
    slots : list of ndarray of int, shapes (m, k, k)
        Where those blocks go in the Jacobian's data; set by the assembler (`find_slots`).
    memory : ndarray or None
        Memory of a law at the last accepted state, of any shape; None without memory.
    replacing : bool
        Whether it puts equations of its own in the place of some rows, the free degrees of freedom ``rows``; it
        is asked last.
    growing : bool
        Whether the number of rows of its memory changes as time goes on.
    axial_stiffness : ndarray or None, shape (edge_count,)
        EA [N] of a quadratic stretching energy: the assembler sums these, and no `stress` is needed.
    inertial : bool
        Whether its forces depend on the accelerations ``ev.a``; then minus their derivative by these,
        times ``ev.ca``, belongs to the Jacobian.
    """

    inertial: ClassVar[bool] = False
    replacing: ClassVar[bool] = False
    rows: np.ndarray
    growing: ClassVar[bool] = False

    def __init__(self, term: Term) -> None:
        self.term = term
        self.stencils: list[np.ndarray] = []
        self.slots: list[np.ndarray] = []
        self.memory: np.ndarray | None = None
        self.axial_stiffness: np.ndarray | None = None
        self.at_rest = False  # in statics, where no time passes

    def find_slots(self, pattern: Pattern, stencils: list[np.ndarray]) -> None:
        """Find the places of the stencils' matrices in the pattern, eliminated degrees of freedom being -1."""
        self.slots = [pattern.places(stencil) for stencil in stencils]

    def begin(self, q: np.ndarray) -> None:
        """Take the degrees of freedom that a run begins with, for a memory of them."""

    def begin_step(self, model: Model, t: float, dt: float, sensors: Any, inputs: dict[str, Any]) -> None:
        """Called before the Newton iterations of a step that ends at ``t``."""

    def spring_stiffness(self, model: Model) -> np.ndarray | None:
        """Stiffness [N m] of a quadratic energy of the springs' strains, shape (spring_count, 3, 3).

        The assembler sums these, whenever ``model.stiffness_version`` has changed; no `stress` is needed.
        """
        return None

    def stress(self, ev: Evaluation) -> None:
        """Add energy derivatives by the strains (energies that are not quadratic)."""

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        """Add forces to ``F`` and, with ``jac``, minus their derivative to ``data``; return the largest force [N].

        Without ``jac``, ``data`` must not be touched.
        """
        return 0.0

    def coupling(self, ev: Evaluation) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Return entries of the Jacobian that no stencil holds because they change from state to state.

        Asked for after `add` with ``jac``. While there are any, the matrix goes to a general solver.

        Returns
        -------
        rows, columns : ndarray of int, shape (n,)
            Degrees of freedom of the model.
        values : ndarray, shape (n,)
            Minus the derivative of the force; those of the same place are summed. None for no entries.
        """
        return None

    def largest_step(self, x: np.ndarray, dx: np.ndarray) -> float:
        """Share in [0, 1] of the displacement ``dx`` of the nodes from ``x`` that leaves the term defined.

        Newton's method goes no further in one update; shapes (node_count, 3) [m].
        """
        return 1.0

    def next_memory(self, ev: Evaluation) -> np.ndarray | None:
        """Memory at the evaluated state, committed when the step is accepted."""
        return self.memory

    def path_dependence(self, memory: np.ndarray | None) -> str:
        """What makes a static equilibrium with this memory one of many, a clause with the term's name; or nothing."""
        return ""

    def accept(self, model: Model, memory: np.ndarray) -> None:
        """Take the memory of the step that has just been accepted, from `next_memory`."""
        self.restore(model, memory)

    def restore(self, model: Model, memory: np.ndarray) -> None:
        """Return to the memory of an accepted state (rollback, restart, replay)."""
        self.memory = memory.copy()

    def rewind(self) -> None:
        """Return from an accepted state to the memory that its step began with, to evaluate it again."""

    def energy(self, ev: Evaluation) -> float:
        """Stored energy [J] at the evaluated state; 0 for what stores none."""
        return 0.0

    def forces(self, ev: Evaluation) -> np.ndarray:
        """Generalised forces of this term alone, shape (dof_count,) of the model."""
        model = ev.model
        F = np.zeros(model.dof_count)
        self.add(ev, F, model.scrap, False)
        return F

    def power(self, ev: Evaluation) -> float:
        """Power put into the robot at the evaluated state [W]; negative for what dissipates."""
        return float(self.forces(ev) @ ev.rates)


class Unmeasured(dict[str, Any]):
    """Sensor readings before the first step: every sensor reads zero."""

    def __missing__(self, key: str) -> float:
        return 0.0
