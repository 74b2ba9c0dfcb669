"""The contract of terms: a user's law as the design writes it, wrong laws, and every built-in."""

import math
import subprocess
import sys

import numpy as np
import pytest
from numba import njit

import rodnet as rn
from rodnet.terms.base import Term
from tests.wrong_laws import WRONG, Quadratic


def tail(edges=6, **options):
    fig = rn.StickFigure()
    points = [(0, 0, 0), (0.1, 0, 0)]
    return fig.rod("tail", points, edges=edges, material=rn.Material(E=1e6), radius=2e-3, **options).build()


def elastic():
    return [rn.Stretching(), rn.Bending(), rn.Twisting()]


# -- the design's example ------------------------------------------------------------------


def test_the_law_of_the_design_passes():
    report = rn.testing.check_term(Quadratic)
    assert {
        "purity",
        "sites: permutation",
        "Jacobian by velocity",
        "dissipative: law",
        "objective: robot",
    } <= set(report.errors)
    assert "Quadratic" in repr(report)
    rn.testing.check_term(Quadratic(c=rn.Parameter(3.0, unit="N s^2/m^3"), on="tail*", tangent="node"))


def test_the_law_of_the_design_runs_as_theory_says():
    """A rod that drifts sideways: m dv/dt = -c v^2 per unit length."""
    graph, c, v0 = tail(), 5.0, 0.4
    velocity = np.zeros((graph.node_count, 3))
    velocity[:, 1] = v0
    robot = rn.Robot(graph, [*elastic(), Quadratic(c=c)])
    traj = rn.Simulation(robot, 1e-3, stepper="sdirk2", velocity=velocity).run(0.1)
    mass = graph.node_mass.sum() / 0.1
    expected = v0 / (1.0 + c * v0 * 0.1 / mass)
    assert traj.state(-1).v[1 : 3 * graph.node_count : 3] == pytest.approx(expected, rel=1e-3)
    assert robot.parameters["drag.c"].unit == "N s^2/m^3"


def test_testing_needs_no_test_tools():
    code = (
        "import sys; from rodnet.testing import check_term, check_stepper; "
        "assert 'pytest' not in sys.modules and 'hypothesis' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


# -- laws that break the contract ----------------------------------------------------------


@pytest.mark.parametrize("law", WRONG, ids=lambda law: law.__name__)
def test_a_wrong_law_fails_with_the_right_message(law):
    with pytest.raises(rn.TermError, match=WRONG[law]) as error:
        rn.testing.check_term(law)
    assert isinstance(error.value, AssertionError)
    assert law.__name__ in str(error.value)


@njit
def _half(v, x, tangent, radius, t, p, f, dfdv, dfdtangent):
    for i in range(3):
        f[i] = -p[0] * v[i]
        dfdv[i, i] = -0.5 * p[0]


@njit
def _falling(v, x, tangent, radius, t, p, f, dfdv, dfdtangent):
    for i in range(3):
        f[i] = -p[0] * math.exp(-x[2]) * v[i]
        dfdv[i, i] = -p[0] * math.exp(-x[2])


def test_wrong_compiled_twins_fail():
    class Linear(Quadratic):
        kernel = _half

        def force(self, site, p):
            return -p.c * site.v

    class Layered(Quadratic):
        kernel, claims = _falling, set()

        def force(self, site, p):
            return -p.c * np.exp(-site.x[:, 2:]) * site.v

    class Other(Quadratic):
        kernel = _half

    for law, message in (
        (Linear, "'kernel: by v': the kernel's dfdv is not the derivative"),
        (Layered, "'kernel: position': the law depends on x"),
        (Other, "'kernel: force': the compiled twin gives other forces"),
    ):
        with pytest.raises(rn.TermError, match=message):
            rn.testing.check_term(law)


class _WrongSlope(rn.BoundTerm):
    """A spring to the origin whose Jacobian has the wrong sign for some axes."""

    sign, add_only = (1.0, 1.0, -1.0), True

    def __init__(self, term, model):
        super().__init__(term)
        self.dofs = np.arange(3)[None]
        self.stencils = [self.dofs]

    def add(self, ev, F, data, jac):
        force = -1.0 * ev.x[0]
        F[self.dofs[0]] = force if not self.add_only else F[self.dofs[0]] + force
        if jac:
            for k in range(3):
                data[self.slots[0][0, k, k]] += self.sign[k]
        return float(np.abs(force).max())


class _Overwriting(_WrongSlope):
    sign, add_only = (1.0, 1.0, 1.0), False


@pytest.mark.parametrize(
    ("bound", "message"),
    [(_WrongSlope, "'Jacobian by position'.*force along z"), (_Overwriting, "'forces are added'")],
)
def test_a_wrong_whole_state_term_fails(bound, message):
    class Tether(rn.Term):
        kind = "load"

        def bind(self, model):
            return bound(self, model)

    with pytest.raises(rn.TermError, match=message):
        rn.testing.check_term(Tether)


# -- the built-ins keep the contract that users keep ---------------------------------------
def built_ins():
    found = {}
    for name in (n for n in rn.__all__ if n[0].isupper()):
        thing = getattr(rn, name)
        if isinstance(thing, type) and issubclass(thing, Term) and thing.__module__.startswith("rodnet."):
            found[name] = thing
    for base in ("Term", "EnergyModel", "DragModel", "LoadModel", "Actuator", "Constraint"):
        del found[base]
    return found


@pytest.mark.parametrize("name", built_ins())
def test_every_built_in_passes(name):
    rn.testing.check_term(built_ins()[name])
    assert built_ins()[name].source, "say where it comes from"


OPTIONS = {
    "node tangents": lambda: rn.ResistiveForce(viscosity=2.0, tangent="node", axial_torque=True),
    "coefficients": lambda: rn.ResistiveForce(eta_t=1.0, eta_n=2.0, on="tail*"),
    "6 x 6": lambda: rn.StokesHead(at="head:1", resistance=np.diag([1.0, 1.0, 2.0, 1e-3, 1e-3, 1e-3])),
    "follower": lambda: rn.PointTorque(on="tail.end", torque=(0.0, 1e-3, 2e-3), follower=True),
    "angle": lambda: rn.Motor(at="head:1", angle=lambda t: 0.3 * np.sin(t)),
    "force of time": lambda: rn.PointForce(at="tail.end", force=lambda t: np.array([0.0, 0.0, np.sin(t)])),
    "swivel": lambda: rn.Grasp(
        at="cable:0-1",
        position=lambda t: np.zeros(3),
        tangent=lambda t: np.array([1.0, 0.2 * np.sin(t), 0.0]),
        twist="free",
    ),
    "turning": lambda: rn.PrescribedMotion(
        at="cable:0-1", orientation=lambda t: rn.kinematics.frames.rotation(np.array([t, 0.0, 0.2 * t]))
    ),
}


@pytest.mark.parametrize("option", OPTIONS)
def test_the_options_of_built_ins_pass(option):
    rn.testing.check_term(OPTIONS[option](), states=4)


@pytest.mark.parametrize("stepper", ["euler", "sdirk2", "alpha", rn.ImplicitEuler, rn.GeneralizedAlpha(0.6)])
def test_every_stepper_passes(stepper):
    rn.testing.check_stepper(stepper)


def test_wrong_steppers_fail():
    class Boastful(rn.ImplicitEuler):
        order = 2

    class Explosive(rn.ImplicitEuler):
        def offsets(self, state, dt, done):
            v0, a0 = super().offsets(state, dt, done)
            return v0, 1.01 * a0

    class Remembering(rn.ImplicitEuler):
        def predict(self, state, dt, done):
            self.last = state.q
            return super().predict(state, dt, done)

    for stepper, message in (
        (Boastful, "not as dt\\^2"),
        (Explosive, "fails the check"),
        (Remembering, "'no state"),
    ):
        with pytest.raises(rn.TermError, match=message):
            rn.testing.check_stepper(stepper)


# -- parameters ----------------------------------------------------------------------------
def test_one_parameter_in_two_terms_is_one_object():
    fig = rn.StickFigure()
    fig.rigid("head", [(0.04, 0, 0), (0.02, 0, 0), (0, 0, 0)], mass=0.035)
    fig.rod("tail", ["head.end", (-0.1, 0, 0)], edges=5, material=rn.Material(E=1.2e6), radius=3.2e-3)
    mu = rn.Parameter(6.828, unit="Pa s", bounds=(0, None))
    drag = rn.ResistiveForce(viscosity=mu, on="tail")
    robot = rn.Robot(fig.build(), [*elastic(), drag, rn.StokesHead(viscosity=mu, radius=0.02, at="head:1")])
    paths = robot.parameters
    assert paths["drag.viscosity"] is paths["head.viscosity"] is mu
    other = robot.with_parameters({"drag.viscosity": 2.0})
    assert other.parameters["drag.viscosity"] is other.parameters["head.viscosity"]
    assert other.parameters["head.viscosity"].value == 2.0 and mu.value == 6.828
    forces = []
    for one in (robot, other):
        model = rn.Simulation(one).model
        ev = rn.solve.evaluation.Evaluation(model)
        q = np.concatenate([model.x0.ravel(), np.zeros(model.edge_count)])
        assert ev.update(q, np.ones(model.dof_count), 0.0, 1.0, 0.0, False)
        forces.append(ev.F.copy())
    assert forces[1] == pytest.approx(forces[0] * 2.0 / 6.828)
    for unit in ("Pa", "1"):
        with pytest.raises(rn.ParameterError, match="Pa s"):
            rn.ResistiveForce(viscosity=rn.Parameter(1.0, unit=unit))


def test_terms_of_one_class_do_not_share_their_defaults():
    a, b = Quadratic(), Quadratic()
    a.c.value = 7.0
    assert b.c.value == 1.0 and Quadratic.c.value == 1.0
