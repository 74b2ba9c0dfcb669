"""The rigid bodies of one evaluation: where they are, and what acts on them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import csr_matrix

from rodnet.errors import ParameterError

if TYPE_CHECKING:
    from rodnet.solve.bodies import Bodies
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.terms.base import BoundTerm

ARC = 0.1  # [rad] arcs as short as this are straight, but for 1/800 of their radius
STOPS = 40  # a gap falls to a fifth at each


class BodyMotion:
    """The bodies of one evaluation: where they are, and what acts on them.

    Attributes
    ----------
    too_far : bool
        Whether a body has turned by nearly half a turn from the last accepted state.
    a : ndarray, shape (dof_count,)
        Accelerations of all degrees of freedom.
    ca : float
        Their derivative by the position [1/s^2], for a step; negative where there is no inertia.
    T : ndarray, shape (count, 3, 3)
        Maps from changes of the rotation vectors to rotations in space.
    centre, about_pivot : ndarray, shapes (count, 3) and (count, 3, 3)
        Centres from the bases [m] and moments about the pivots [kg m^2], at the last accepted state.
    """

    def __init__(self, bodies: Bodies, model: Model, ev: Evaluation) -> None:
        from rodnet.packed import Packed
        from rodnet.solve import body_force_kernels as forces
        from rodnet.solve import body_kernels as kernels
        from rodnet.solve import body_newton_kernels as steps

        self._forces, self._steps = forces, steps
        self._kernels, self._twist0 = kernels, model.twist0
        self._room = Packed(
            steps.ROOM,
            model.free,
            bodies.carried,
            np.zeros(model.dof_count),
            np.zeros(len(model.free) + len(bodies.carried)),
            bodies.owner,
        )
        self.too_far, self.ca, self.a = False, -1.0, ev.a
        e = len(bodies.edges)
        E, self.T = (np.tile(np.eye(3), (bodies.count, 1, 1)) for _ in range(2))
        self.centre, self.about_pivot = bodies.centre.copy(), bodies.inertia.copy()
        C = np.hstack([bodies.units, np.zeros((len(bodies.carried), 3))])
        self._ev, self._fixed, self._C = ev, bodies, C
        self._bodies = Packed(
            kernels.BODIES, bodies.base, bodies.turn, bodies.node_ptr, bodies.edge_ptr, bodies.own_places, E, self.T,
            bodies.mass, bodies.floating, bodies.centre_dof, self.centre, self.about_pivot, 3 * bodies.nodes,
            bodies.node_rows, bodies.arms0.copy(), bodies.arms0.copy(), bodies.edges, bodies.edge_rows, np.zeros(e),
            np.zeros((e, 3)), C, ev.q, ev.rates, self.a, ev.F, ev.ts,
        )  # fmt: skip
        self._drawn = Packed(
            kernels.DRAWN, bodies.first, bodies.frames0, bodies.arms0, bodies.centre, bodies.inertia, ev.d1s
        )
        self._fold = Packed(forces.FOLD, *bodies.plan)

    def set_source(self, q: np.ndarray) -> None:
        """Take the orientations of the last accepted state ``q`` from its frames."""
        self._kernels.orient(self._bodies.table, self._drawn.table, self._twist0, q)

    def place(self) -> None:
        """Put what the bodies carry where it belongs."""
        turned = self._kernels.place(self._bodies.table, self._twist0)
        self.too_far = not turned < self._kernels.HALF_TURN

    def kernels(self, newton: Any, size: float, shortest: float) -> tuple[Callable[..., Any], ...]:
        """Return the kernels of `rodnet.solve.newton_kernels` that a robot with bodies has its own of.

        Their first arguments are bound: ``newton``, the table of a solver's arrays, and its lengths [m].
        """
        at = newton, self._bodies.table
        # contact looks at the straight ways of nodes that no body carries
        arcs = not self._ev.model.bounding
        return (
            partial(self._steps.move, *at, self._room.table, self._twist0, arcs),
            partial(self._steps.measure, *at, self._room.table, self._twist0, size),
            partial(self._steps.advance, *at, self._room.table, self._twist0, arcs, size),
            partial(self._steps.residual, *at, self._fold.table, self._twist0, shortest),
        )

    def begin(self, q: np.ndarray, v: np.ndarray, guess: np.ndarray) -> None:
        """Begin at the accepted state ``q`` as `set_source` does, and improve a first guess, in place."""
        at = self._bodies.table, self._drawn.table, self._room.table, self._twist0
        self._steps.begin(*at, q, v, guess)

    def set_rigid(self, v: np.ndarray) -> None:
        """Make rates those of the bodies' motion, in place, at an accepted state.

        What is carried, and with a body that moves freely even the base, has the stepper's rates.
        """
        self._kernels.rebase(self._bodies.table, v)
        self.spread(v)

    def spread(self, full: np.ndarray) -> None:
        """Complete changes or rates of the bodies by those of what they carry, shape (dof_count,)."""
        self._kernels.spread(self._bodies.table, self._twist0, full)

    def reduce(self, cv: float, data: np.ndarray, jac: bool) -> tuple[float, float]:
        """Move the evaluation's forces, and with ``jac`` its Jacobian, to the bodies.

        With ``ca`` set, inertia is taken off; the largest force and moment of it are returned.
        """
        fold = self._fold.table
        return self._forces.reduce(self._bodies.table, fold, self._twist0, cv, self.ca, data, jac)

    def positions(self, q: np.ndarray) -> np.ndarray | None:
        """Where all nodes are with the bodies at ``q`` [m], shape (node_count, 3); None if one turned too far."""
        ev = self._ev
        kept = ev.q.copy()
        ev.q[:] = q
        turned = self._kernels.place(self._bodies.table, self._twist0)
        x = ev.x.copy()
        ev.q[:] = kept
        return x if turned < self._kernels.HALF_TURN else None

    def walk(
        self, x: np.ndarray, q: np.ndarray, dq: np.ndarray, bounding: Sequence[BoundTerm], stops: int = 1
    ) -> float:
        """Share in [0, 1] of the displacement ``dq`` that leaves the ``bounding`` terms defined all the way.

        What a body carries goes round on arcs, which are walked in short pieces: the straight way to where it
        ends may lead past what is on the arc. ``stops`` is how often a term may shorten the way before it ends.
        """
        turned = float(np.sqrt(np.sum(dq[self._fixed.own[:, 3:]] ** 2, axis=1).max()))
        piece = ARC / turned if turned > ARC else 1.0
        done = 0.0
        while done < 1.0 and stops:
            end = share = min(done + piece, 1.0)
            # points leave the straight ways to where a body comes to: a share that is clear moves them elsewhere
            for _ in range(20):
                there = self.positions(q + share * dq)
                part = 0.5 if there is None else min(b.largest_step(x, there - x) for b in bounding)
                if there is not None and part == 1.0:
                    break
                share = done + part * (share - done)
            else:
                return done
            stops -= share < end
            done, x = share, there
        return done

    def reached(self, q: np.ndarray, bounding: Sequence[BoundTerm]) -> bool:
        """Whether the evaluated state can be reached from the accepted state ``q`` without leaving the way."""
        ev = self._ev
        x = q[: self._twist0].reshape(-1, 3)
        done = self.walk(x, q, ev.q - q, bounding, STOPS)
        self.place()
        return done == 1.0

    def fold_entries(self, rows: np.ndarray, columns: np.ndarray, values: np.ndarray) -> csr_matrix:
        """Entries of the Jacobian over all degrees of freedom, given as triplets, over the free ones."""
        model, bodies = self._ev.model, self._fixed
        size = (model.dof_count, len(model.free))
        free = np.flatnonzero(model.reduced >= 0)
        which = [np.column_stack([free, model.reduced[free]])]
        by = [np.ones(len(free))]
        own = model.reduced[bodies.own][bodies.body_of_row]
        for k in range(6):
            used = np.flatnonzero((own[:, k] >= 0) & (self._C[:, k] != 0.0))
            which.append(np.column_stack([bodies.carried[used], own[used, k]]))
            by.append(self._C[used, k])
        C = csr_matrix((np.concatenate(by), np.concatenate(which).T), size)
        return csr_matrix(C.T @ csr_matrix((values, (rows, columns)), (size[0], size[0])) @ C)

    def resist(self, a: np.ndarray) -> None:
        """Take from the forces what accelerations ``a`` of the bodies need, at an accepted state."""
        self._forces.resist(self._bodies.table, a)

    def accept(self, q: np.ndarray, v: np.ndarray, a: np.ndarray, acc: np.ndarray) -> None:
        """Change the evaluated state, in place, to the chart in which its rotation vectors are zero."""
        self._kernels.accept(self._bodies.table, q, v, a, acc)


def check_spin(spin: Mapping[str, Any], names: list[str]) -> dict[str, np.ndarray]:
    """Return angular velocities [rad/s] by the names of bodies.

    Raises
    ------
    ParameterError
        If there is no such body, or a value is no finite vector.
    """
    given = {name: np.asarray(omega, dtype=float) for name, omega in spin.items()}
    for name, omega in given.items():
        if name not in names:
            raise ParameterError(
                f"spin: no rigid body '{name}' is free to move; there are {', '.join(names) or 'none'}"
            )
        if omega.shape != (3,) or not np.all(np.isfinite(omega)):
            raise ParameterError(f"spin of '{name}' must be a finite vector (x, y, z) [rad/s], got {omega}")
    return given
