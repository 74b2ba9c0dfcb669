"""Internal and mass-proportional damping, linear in the rates."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rodnet.parameters import Parameter
from rodnet.terms.actuators import _BoundTwist
from rodnet.terms.base import BoundTerm, Term
from rodnet.terms.drag.line import edge_dofs
from rodnet.terms.driven_curvature import _BoundCurvature

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
    torsion : float or Parameter
        Share of the time of bending that twisting has besides its own: 1 of one viscosity, none of strands along the
        rod.
    """

    kind = "drag"
    default_name = "damping"
    source = "Kelvin-Voigt solid; Linn, Lang & Tuganov 2013 (for Cosserat rods)"
    claims: ClassVar[set[str]] = {"dissipative", "objective"}
    example: ClassVar[dict[str, float]] = {"stretch": 0.01, "bend": 0.02, "twist": 0.03}

    stretch = Parameter(0.0, unit="s", bounds=(0, None), null=0.0, doc="retardation time of stretching")
    bend = Parameter(0.0, unit="s", bounds=(0, None), null=0.0, doc="retardation time of bending")
    twist = Parameter(0.0, unit="s", bounds=(0, None), null=0.0, doc="retardation time of twisting")
    torsion = Parameter(0.0, unit="1", bounds=(0, None), doc="share of bending's time that twisting has, too")

    def bind(self, model: Model) -> BoundTerm:
        """Bind to the edges and springs that ``on`` names."""
        self.check_numbers()
        return _BoundKelvinVoigt(self, model)


class _BoundKelvinVoigt(BoundTerm):
    def __init__(self, term: KelvinVoigt, model: Model) -> None:
        super().__init__(term)
        p = term.values()
        edges = model.graph.edge_indices(term.on)
        edges = edges[np.isfinite(model.graph.EA[edges])]  # those of rigid bodies do not stretch
        self.edges = edges if p.stretch else edges[:0]
        self.stretching = p.stretch * model.graph.EA[self.edges]  # N s
        # symmetric, and the rates of one mode where springs couple bending and twisting
        self.roots = np.sqrt([p.bend, p.bend, p.twist + p.torsion * p.bend])
        self.model, self.springs = model, model.springs_on(term.on)
        self.ends = np.ascontiguousarray(model.stretch_dofs[self.edges])
        self.dofs = np.ascontiguousarray(model.spring_dofs[self.springs])
        # rates of natural frames about both edges of a spring, and of natural strains, driven by actuators
        self.turned, self.natural = np.zeros((len(self.springs), 2)), np.zeros((len(self.springs), 3))
        self.loose = np.zeros(
            len(self.springs), dtype=np.int64
        )  # whose motor gives way, and is what damps them
        self.drives: list[tuple[BoundTerm, Any]] | None = None
        self.stencils = [self.ends, self.dofs]

    def find_slots(self, pattern: Pattern, stencils: list[np.ndarray]) -> None:
        from rodnet.packed import Packed
        from rodnet.terms import damping_kernels as kernels

        m, s = self.model, self.springs
        super().find_slots(pattern, stencils[:1])
        self.length = np.ascontiguousarray(m.rest_length[self.edges])
        e1, e2, sign1, sign2 = (np.ascontiguousarray(a[s]) for a in (m.edge1, m.edge2, m.sign1, m.sign2))
        self.packed = Packed(
            kernels.DAMPED, self.edges, self.ends, self.slots[0], self.stretching, self.length, s, m.Q1, m.Q2,
            self.dofs, np.ascontiguousarray(m.spring_slots[s]), self.loose, self.roots, self.turned, self.natural, e1,
            e2, sign1, sign2,
        )  # fmt: skip
        self.kernel = kernels.damp
        self.acts = bool(len(self.edges)) or bool(len(s) and self.roots.any())

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        if self.at_rest or not self.acts:
            return 0.0
        if self.drives is None:
            self._find_drives(ev.model)
        if self.drives:
            self._take_rates()
        K = ev.model.spring_stiffness
        return self.kernel(self.packed.table, ev._quadratic.table, ev.state, K, ev.cv, F, data, jac)

    def _find_drives(self, model: Model) -> None:
        """Find the actuators that drive natural shapes of these springs."""
        place = np.full(model.spring_count, -1)
        place[self.springs] = np.arange(len(self.springs))
        bound = [b for b in model.bound if isinstance(b, _BoundTwist | _BoundCurvature)]
        mine = [place[b.spring if isinstance(b, _BoundTwist) else b.springs] for b in bound]
        self.drives = [(b, k) for b, k in zip(bound, mine, strict=True) if np.any(k >= 0)]
        self.loose[[int(k) for b, k in self.drives if getattr(b, "yielding", False)]] = 1

    def _take_rates(self) -> None:
        """Take the rates at which actuators turn natural frames and change natural strains."""
        self.turned[:], self.natural[:] = 0.0, 0.0
        for b, k in self.drives or ():
            if isinstance(b, _BoundTwist):
                # turning the natural frame is turning the rotor back about its own axis
                second = b.sign > 0
                forward = self.model.sign2[b.spring] if second else -self.model.sign1[b.spring]
                self.turned[k, int(second)] += forward * b.rate
            elif isinstance(b, _BoundCurvature):
                self.natural[k[k >= 0], :2] += b.rate[k >= 0]


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
        from rodnet.terms.damping_kernels import resist
        from rodnet.terms.drag import kernels

        super().find_slots(pattern, stencils)
        self.diagonal = np.ascontiguousarray(self.slots[0].ravel())
        self.packed = Packed(kernels.SPUN, self.spin, self.edges, self.spun, self.slots[1])
        self.kernel, self.resist = kernels.spin_drag, resist

    def add(self, ev: Evaluation, F: np.ndarray, data: np.ndarray, jac: bool) -> float:
        largest = self.resist(self.weight, self.dofs, self.diagonal, ev.rates, ev.cv, F, data, jac)
        self.kernel(self.packed.table, ev.state, ev.cv, F, data, jac)
        return largest
