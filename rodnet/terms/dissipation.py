"""Internal and mass-proportional damping, linear in the rates."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.parameters import Parameter
from rodnet.terms.actuators import _BoundTwist
from rodnet.terms.base import BoundTerm, Term
from rodnet.terms.drag.line import edge_dofs
from rodnet.terms.driven_curvature import _BoundCurvature
from rodnet.terms.spring_moments import SpringMoments

if TYPE_CHECKING:
    from rodnet.solve.evaluation import Evaluation
    from rodnet.solve.model import Model
    from rodnet.solve.pattern import Pattern


class KelvinVoigt(Term):
    """Viscous damping of a rod's own deformation, stress = E (strain + time * strain rate).

    The retardation times are those of a Kelvin-Voigt solid, viscosity over modulus, one per mode: a
    standing wave of angular frequency w decays at the rate time * w^2 / 2. Rigid motion costs nothing.
    Springs whose natural shape an actuator drives are damped against that shape, except the joint of a
    motor that gives way under load (`DCMotor`), which is not damped otherwise.

    It acts in rods and welds. The springs of joints that turn (hinges, ball and elastic joints) are not of
    the rods' material and have no part in it.

    Parameters
    ----------
    on : str or sequence of str
        The rods.
    stretch, bend, twist : float or Parameter
        Retardation times [s]; for a material with one viscosity all three are viscosity / E.
    """

    kind = "drag"
    default_name = "damping"
    source = "Kelvin-Voigt solid; Linn, Lang & Tuganov 2013 (for Cosserat rods)"
    claims: ClassVar[set[str]] = {"dissipative", "objective"}
    example: ClassVar[dict[str, float]] = {"stretch": 0.01, "bend": 0.02, "twist": 0.03}

    stretch = Parameter(0.0, unit="s", bounds=(0, None), null=0.0, doc="retardation time of stretching")
    bend = Parameter(0.0, unit="s", bounds=(0, None), null=0.0, doc="retardation time of bending")
    twist = Parameter(0.0, unit="s", bounds=(0, None), null=0.0, doc="retardation time of twisting")

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the edges and springs that ``on`` names."""
        self.check_numbers()
        return _BoundKelvinVoigt(self, model)


class _BoundKelvinVoigt(BoundTerm):
    def __init__(self, term: KelvinVoigt, model: Model) -> None:
        super().__init__(term)
        p = term.values()
        edges = model.graph.edge_indices(term.on)
        self.edges = edges[np.isfinite(model.graph.EA[edges])]  # those of rigid bodies do not stretch
        self.stretching = p.stretch * model.graph.EA[self.edges]  # N s
        self.moments = SpringMoments(model, model.springs_on(term.on))
        # symmetric, and the rates of one mode where springs couple bending and twisting
        self.roots = np.sqrt([p.bend, p.bend, p.twist])
        axes, ends = np.arange(3), model.edges[self.edges]
        self.ends = np.concatenate([3 * ends[:, :1] + axes, 3 * ends[:, 1:] + axes], axis=1)
        self.length = model.rest_length[self.edges]
        self._none = np.zeros((0, 3, 11, 11))
        self.drives: list[tuple[BoundTerm, Any]] | None = None
        self.loose: list[int] = []  # springs whose motor gives way, and is what damps them
        self.stencils = [self.ends, self.moments.dofs]

    def find_slots(self, pattern: Pattern, stencils: list[np.ndarray]) -> None:
        super().find_slots(pattern, stencils[:1])
        self.moments.find_slots(pattern, stencils[1])

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        if self.at_rest:
            return 0.0
        largest = self._add_stretching(ev, F, data, jac) if self.stretching.any() else 0.0
        return max(largest, self._add_springs(ev, F, data, jac)) if self.roots.any() else largest

    def _add_stretching(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        """Tension c dl/dt / l0 along each edge."""
        v = ev.rates[self.ends]
        t, across = ev.T[self.edges], v[:, 3:] - v[:, :3]
        rate = np.sum(t * across, axis=1)
        c = self.stretching / self.length
        pull = (c * rate)[:, None] * t
        np.add.at(F, self.ends, np.concatenate([pull, -pull], axis=1))
        if jac:
            across = (across - rate[:, None] * t) / ev.L[self.edges][:, None]
            by_edge = (c[:, None] * t)[:, :, None] * (ev.cv * t + across)[:, None, :]
            turned = np.eye(3) - t[:, :, None] * t[:, None, :]
            by_edge += (c * rate / ev.L[self.edges])[:, None, None] * turned
            np.add.at(
                data,
                self.slots[0],
                np.tile(by_edge, (1, 2, 2)) * np.kron([[1, -1], [-1, 1]], np.ones((3, 3))),
            )
        return float(np.abs(pull).max(initial=0.0))

    def _add_springs(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        from rodnet.terms.damping_kernels import damp

        moments = self.moments
        B, H = moments.gradient(ev, hessian=jac)
        v, natural = self._rates(ev)
        C = self.roots[:, None] * ev.model.spring_stiffness[moments.springs] * self.roots
        C[self.loose] = 0.0
        sigma = np.empty_like(natural)
        damp(B, self._none if H is None else H, v, natural, C, ev.cv, sigma, moments.slots, data, jac)
        return moments.add_forces(ev, sigma, F, data, jac)

    def _rates(self, ev: Evaluation) -> tuple[np.ndarray, np.ndarray]:
        """Rates of the springs' stencils, a driven rotor's relative to its natural angle, and of natural strains."""
        springs = self.moments.springs
        v, natural = ev.rates[self.moments.dofs], np.zeros((len(springs), 3))
        if self.drives is None:
            place = np.full(ev.model.spring_count, -1)
            place[springs] = np.arange(len(springs))
            bound = [b for b in ev.model.bound if isinstance(b, _BoundTwist | _BoundCurvature)]
            mine = [place[b.spring if isinstance(b, _BoundTwist) else b.springs] for b in bound]
            self.drives = [(b, k) for b, k in zip(bound, mine, strict=True) if np.any(k >= 0)]
            self.loose = [int(k) for b, k in self.drives if getattr(b, "yielding", False)]
        for b, k in self.drives:
            if isinstance(b, _BoundTwist):
                # turning the natural frame is turning the rotor back about its own axis
                forward = self.moments.sign2[k] if b.sign > 0 else -self.moments.sign1[k]
                v[k, 7 if b.sign > 0 else 3] -= forward * b.rate
            elif isinstance(b, _BoundCurvature):
                natural[k[k >= 0], :2] += b.rate[k >= 0]
        return v, natural


class MassDamping(Term):
    """Damping in proportion to mass, f = -rate m v, of positions and of spin about the rods' own axes.

    Every vibration decays at rate / 2, whatever its frequency; so does rigid motion, at the full rate. Of a
    rigid body it takes mass and moments of inertia, if all its nodes are named.

    Parameters
    ----------
    on : str or sequence of str
        The rods.
    rate : float or Parameter
        Rate [1/s].
    """

    kind = "drag"
    default_name = "mass_damping"
    source = "Rayleigh 1877, mass-proportional part"
    claims: ClassVar[set[str]] = {"dissipative", "objective"}
    example: ClassVar[dict[str, float]] = {"rate": 2.0}
    rate = Parameter(0.0, unit="1/s", bounds=(0, None), null=0.0, doc="damping rate")

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the nodes and edges that ``on`` names."""
        self.check_numbers()
        return _BoundMassDamping(self, model)


class _BoundMassDamping(BoundTerm):
    def __init__(self, term: MassDamping, model: Model) -> None:
        super().__init__(term)
        rate = float(term.values().rate)
        nodes, edges = model.nodes_with_masses(term.on), model.graph.edge_indices(term.on)
        self.dofs = (3 * nodes[:, None] + np.arange(3)).ravel()
        self.weight = rate * np.repeat(model.node_mass[nodes], 3)
        self.spin = np.ascontiguousarray(rate * model.edge_inertia[edges])
        self.edges = np.ascontiguousarray(edges, dtype=np.int64)
        self.spun = np.ascontiguousarray(edge_dofs(model, edges))
        self.stencils = [self.dofs[:, None], self.spun]

    def find_slots(self, pattern: Pattern, stencils: list[np.ndarray]) -> None:
        from rodnet.packed import Packed
        from rodnet.terms.drag import kernels

        super().find_slots(pattern, stencils)
        self.diagonal = self.slots[0].ravel()
        self.packed = Packed(kernels.SPUN, self.spin, self.edges, self.spun, self.slots[1])
        self.kernel = kernels.spin_drag

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        force = self.weight * ev.rates[self.dofs]
        F[self.dofs] -= force
        if jac:
            np.add.at(data, self.diagonal, ev.cv * self.weight)
        self.kernel(self.packed.table, ev.state, ev.cv, F, data, jac)
        return float(np.abs(force).max(initial=0.0))
