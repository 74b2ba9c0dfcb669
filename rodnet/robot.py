"""A robot: a rod graph and the terms that act on it, with all their parameters under one roof."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from rodnet.errors import ParameterError, TermError
from rodnet.graph.rod_graph import RodGraph
from rodnet.graph.rod_spec import UNITS
from rodnet.names import Named, listed, meant
from rodnet.parameters import Parameter
from rodnet.terms.base import Term
from rodnet.terms.constraints import Constraint
from rodnet.terms.joints import JointElasticity


class Robot:
    """A rod graph with energies, drag, loads, actuators and constraints.

    Parameters
    ----------
    graph : RodGraph
        From `StickFigure.build`.
    terms : sequence of Term
        The physics. Terms of the same name get numbers: ``drag``, ``drag2``, as does one that is named after
        a rod and has a parameter of the same name as it (``radius``). Gravity and the linear
        energies of a rod count once: a second one that is meant needs a name of its own.
    sensors : dict, optional
        Named functions of an `rodnet.Observer` view of the state, e.g.
        ``{"speed": lambda s: s.velocity("head:1")[0]}``; actuators and controllers read them.

    Raises
    ------
    TermError, GraphError
        If a term cannot act on this graph: unknown rods, a motor without a spring, and so on.
    """

    def __init__(
        self,
        graph: RodGraph,
        terms: Sequence[Term],
        sensors: Mapping[str, Callable[[Any], Any]] | None = None,
    ) -> None:
        if not isinstance(graph, RodGraph):
            raise TermError(f"Robot needs a RodGraph (fig.build()), got {type(graph).__name__}")
        if isinstance(terms, str | Mapping | Term) or not isinstance(terms, Iterable):
            one = f"[{type(terms).__name__}(...)]" if isinstance(terms, Term) else "[rodnet.Bending(), ...]"
            raise TermError(f"Robot needs a list of terms, also of one: Robot(graph, {one}), got {terms!r}")
        self.graph = graph
        terms = list(terms)
        own = {int(n) for t in terms if isinstance(t, JointElasticity) for n in graph.nodes(t.on)}
        pivots = [joint for t in terms if isinstance(t, Constraint) for joint in t.pivots(graph)]
        rest = [joint.at for joint in (*graph.joints, *pivots) if joint.node not in own]
        if rest:  # as a weld's stiffness, that of a joint belongs to what is drawn
            terms.append(JointElasticity(rest if own else "*"))
        self.terms: tuple[Term, ...] = tuple(self._named(terms))
        if not isinstance(sensors, Mapping | None):
            raise TermError(f"sensors are functions by name, {{'speed': lambda s: ...}}, not {sensors!r}")
        self.sensors = Named(sensors or {}, what="sensor")
        for name, sensor in self.sensors.items():
            if not callable(sensor):
                raise TermError(f"sensor '{name}' must be a function of the state, got {sensor!r}")
        self._check()

    def _named(self, terms: Sequence[Term]) -> list[Term]:
        seen: dict[str, list[Term]] = {}
        out = []
        for term in terms:
            if not isinstance(term, Term):
                hint = " (an instance, with brackets?)" if isinstance(term, type) else ""
                raise TermError(f"terms must be rodnet terms, got {term!r}{hint}")
            others = seen.setdefault(term.name, [])
            for other in others:
                self._check_once(term, other)
            others.append(term)
            number = len(others) + self._hides(term)
            if number > 1:
                term = copy.copy(term)
                term.name = f"{term.name}{number}"
            out.append(term)
        return out

    def _hides(self, term: Term) -> bool:
        """Whether a term that is named after a rod has a parameter of the same path as that rod."""
        rod = self.graph.rods.get(term.name)
        if rod is None or rod.material is None:
            return False
        return bool(
            set(self.graph.figure.specs[rod.name].properties) & {k for k, _ in term.parameter_items()}
        )

    def _check_once(self, term: Term, other: Term) -> None:
        """Refuse what acts a second time where it must count once."""
        if not term.once or type(term) is not type(other):
            return
        find, name = (
            (self.graph.nodes, self.graph.node_name)
            if term.kind == "load" or isinstance(term, JointElasticity)
            else (self.graph.edge_indices, self.graph.edge_name)
        )
        common = np.intersect1d(find(term.on), find(other.on))
        if len(common):
            kind = type(term).__name__
            raise TermError(
                f"{kind} acts twice on '{name(int(common[0]))}', where it would count double: keep one of them, which "
                f"may name several rods, on=['a', 'b']. If it is meant, name one: {kind}(..., name='second')"
            )

    def _check(self) -> None:
        """Bind once, so that a mistake shows here and not in the middle of a computation."""
        from rodnet.solve.model import Model

        Model(self)

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """All parameters by path: ``"drag.viscosity"``, ``"tail0.E"``; shared ones appear once per path."""
        found = Named(what="parameter")
        for rod in self.graph.rods.values():
            if rod.material is not None:
                spec = self.graph.figure.specs[rod.name]
                for name in spec.properties:
                    path, (unit, bounds) = f"{rod.name}.{name}", UNITS[name]
                    found[path] = Parameter(spec.property(name), unit=unit, bounds=bounds, name=path)
        for term in self.terms:
            found.update({f"{term.name}.{name}": p for name, p in term.parameter_items()})
        return MappingProxyType(found)

    def with_parameters(self, values: Mapping[str, Any]) -> Robot:
        """Return a robot with other parameter values; a shared parameter changes wherever it is used.

        Raises
        ------
        ParameterError
            For an unknown path or a value out of bounds.
        """
        changed = self._changed(values)
        changed._check()
        return changed

    def _changed(self, values: Mapping[str, Any]) -> Robot:
        """Like `with_parameters`, but whether the terms can act then shows only when they are bound."""
        known = self.parameters
        unknown = sorted(set(values) - set(known))
        if unknown:
            raise ParameterError(
                f"no parameter {', '.join(map(repr, unknown))}; {meant(unknown[0], known)}{listed(known)}"
            )
        from rodnet.graph.refine import named_as

        replaced: dict[int, Parameter] = {}
        figure = self.graph.figure
        for path, value in values.items():
            owner, name = path.rsplit(".", 1)
            rod = self.graph.rods.get(owner)
            if rod is not None and rod.material is not None and name in UNITS:
                figure = figure.with_material(owner, **{name: known[path].with_value(value).value})
            else:
                replaced[id(known[path])] = known[path].with_value(value)
        terms = []
        for term in self.terms:
            new = {name: replaced[id(p)] for name, p in term.parameter_items() if id(p) in replaced}
            if new:
                term = copy.copy(term)
                for name, p in new.items():
                    setattr(term, name, p)
            terms.append(term)
        changed = copy.copy(self)
        changed.terms = tuple(terms)
        if figure is not self.graph.figure:
            made = named_as(figure.build(), self.graph).with_positions(self.graph.x0)
            turned = not np.array_equal(made.d1, self.graph.d1)  # rods that begin twisted
            changed.graph = made.with_directors(self.graph.d1) if turned else made
        return changed

    def with_terms(self, *terms: Term) -> Robot:
        """Return a robot with more terms."""
        return Robot(self.graph, [*self.terms, *terms], self.sensors)

    def extended(self, terms: Sequence[Term]) -> Robot:
        """Return a robot with more terms, whose mistakes show when it is simulated: for many that are much alike."""
        longer = copy.copy(self)
        longer.terms = tuple(self._named([*self.terms, *terms]))
        return longer

    def refined(self) -> Robot:
        """Return the same robot on a finer mesh: every edge in two, but for stiff parts and what is held.

        Selectors name the same places as before. To see what the mesh does to a result, compare the two.

        Raises
        ------
        ParameterError
            For parameters with one value per site, which another mesh has not.
        """
        from rodnet.graph.refine import halved

        return Robot(halved(self.graph, self._whole())[0], self.terms, self.sensors)

    def mesh_parents(self) -> np.ndarray:
        """Nodes of this robot between which each node of the refined one lies, shape (N, 2)."""
        from rodnet.graph.refine import halved

        return halved(self.graph, self._whole())[1]

    def _whole(self) -> np.ndarray:
        """Edges that refinement does not divide."""
        whole = self.graph.rigid.copy()
        for body in self.graph.bodies:
            whole[body.edges] = True
        for term in self.terms:
            if isinstance(term, Constraint):
                whole[term.held_edges(self.graph)] = True
        return whole

    def save(self, path: str | Path) -> Path:
        """Write the robot to a text file (TOML) that people can read and `Robot.load` reads back.

        Parameters
        ----------
        path : path
            The file, e.g. ``"robot.toml"``; ``rodnet run robot.toml`` simulates it.

        Raises
        ------
        RobotFileError
            For what a file cannot hold: functions of a script (splines can be written), classes of
            terms that no installed package announces.
        OutputError
            If the file cannot be written.
        """
        from rodnet.files.robot_file import save

        return save(self, path)

    @classmethod
    def load(cls, path: str | Path) -> Robot:
        """Read a robot from a file, the same to the last bit as the one that was saved.

        Raises
        ------
        RobotFileError
            If the file does not describe a robot; names the table and the key, or the missing package.
        OutputError
            If the file cannot be read.
        """
        from rodnet.files.robot_file import load

        return load(path)

    def __repr__(self) -> str:
        return f"Robot({self.graph!r}, {len(self.terms)} terms: {', '.join(t.name for t in self.terms)})"


def check_robot(robot: object, who: str) -> None:
    """Raise `TermError` for what is not a robot.

    Parameters
    ----------
    robot : object
        What was given.
    who : str
        Who needs one.
    """
    if not isinstance(robot, Robot):
        raise TermError(
            f"{who} needs a Robot, got {type(robot).__name__}: rodnet.Robot(fig.build(), [rodnet.Stretching(), ...])"
        )
