"""The contract of terms: a user's law as the design writes it, wrong laws, and every built-in."""

import math
import subprocess
import sys

import numpy as np
import pytest
from numba import njit

import rodnet as rn
from rodnet.terms.base import Term


class Quadratic(rn.DragModel):
    """Form drag per unit length, f = -c |v| v  [N/m]."""

    site = "line"  # half edges: node velocity, the edge's own tangent, weight l/2
    c = rn.Parameter(1.0, unit="N s^2/m^3", bounds=(0, None), null=0.0)
    claims = {"dissipative", "objective"}  # switch on the checks that must then hold

    def force(self, site, p):  # pure
        return -p.c * rn.norm(site.v) * site.v


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
class WrongJacobian(Quadratic):
    def jacobian(self, site, p):
        return {"v": -p.c * rn.norm(site.v)[:, :, None] * np.eye(3)}


class JacobianNotAtRest(Quadratic):
    def jacobian(self, site, p):
        v, speed = site.v, rn.norm(site.v)[:, :, None]
        with np.errstate(invalid="ignore"):
            return {"v": -p.c * (speed * np.eye(3) + v[:, :, None] * v[:, None, :] / speed)}


class Propulsive(Quadratic):
    def force(self, site, p):
        return p.c * rn.norm(site.v) * site.v


class Counting(Quadratic):
    calls = 0

    def force(self, site, p):
        self.calls += 1
        return -p.c * self.calls * site.v


class Drifting(Quadratic):
    """Varies without any attribute to be seen."""

    rng = np.random.default_rng(0)

    def force(self, site, p):
        return -p.c * self.rng.uniform(1.0, 2.0) * site.v


class Writing(Quadratic):
    def force(self, site, p):
        site.v[:, 2] = 0.0
        return -p.c * site.v


class ReadsSelf(Quadratic):
    def force(self, site, p):
        return -self.c.value * site.v


class WrongShape(Quadratic):
    def force(self, site, p):
        return -p.c * rn.norm(site.v)


class Coupled(Quadratic):
    def force(self, site, p):
        return -p.c * np.mean(rn.norm(site.v)) * site.v


class WrongBroadcast(Quadratic):
    def force(self, site, p):
        return -(p.c * site.radius)[:, None] * site.v  # wrong for p.c of shape (n, 1)


class NotAtRest(Quadratic):
    claims = set()

    def force(self, site, p):
        with np.errstate(invalid="ignore"):
            return -p.c * site.v / rn.norm(site.v)


class Deep(Quadratic):
    """Drag that grows with depth, claimed to be the same everywhere."""

    def force(self, site, p):
        return -p.c * np.exp(-site.x[:, 2:]) * site.v


class Anisotropic(Quadratic):
    def force(self, site, p):
        return -p.c * site.v * np.array([1.0, 2.0, 3.0])


class NoUnit(Quadratic):
    c = rn.Parameter(1.0, unit="")


class HidesAttribute(Quadratic):
    bind = rn.Parameter(1.0, unit="1")


class UnknownClaim(Quadratic):
    claims = {"passive"}


class LeavesSomething(Quadratic):
    offset = rn.Parameter(1.0, unit="1", null=0.0)

    def force(self, site, p):
        return -(p.c + 1.0) * p.offset**0 * site.v


class BadBend(rn.EnergyModel):
    strain = "curvature"
    k = rn.Parameter(1e-4, unit="N m^2", bounds=(0, None), null=0.0)

    def psi(self, strain, p):
        k = np.ravel(p.k)
        kappa = strain.kappa
        return 0.5 * k * np.sum(kappa**2, axis=1), 1.1 * k[:, None] * kappa, k[:, None] * np.ones_like(kappa)


class BadModulus(BadBend):
    def psi(self, strain, p):
        k = np.ravel(p.k)
        kappa = strain.kappa
        return 0.5 * k * np.sum(kappa**2, axis=1), k[:, None] * kappa, 2.0 * k[:, None] * np.ones_like(kappa)


class Forgetful(rn.DragModel):
    """Changes its memory in place: a rejected step would leave traces."""

    memory_size = 3

    def update(self, site, p, m_old):
        m_old += site.v * site.dt
        return -m_old, m_old


class Generous(rn.DragModel):
    """Gives out more work than was put in."""

    memory_size = 3
    claims = {"dissipative"}

    def update(self, site, p, m_old):
        m_new = m_old + site.v * site.dt
        return 10.0 * m_new, m_new


class FollowsX(rn.LoadModel):
    dead = True

    def force(self, site, p):
        return -site.x


class NoCommand(rn.Actuator):
    drives = "curvature"

    def command(self, t, sensors, p):
        return np.zeros(3)


class InfiniteCommand(rn.Actuator):
    drives = "twist_rate"

    def command(self, t, sensors, p):
        return np.inf if t > 0.3 else 1.0


class NeedsSensor(rn.Actuator):
    drives = "twist"

    def command(self, t, sensors, p):
        return sensors["speed"]


class Jerk(rn.Constraint):
    def position(self, t, x0, p):
        return x0 + abs(t - 0.37) - 0.37


class Shear(rn.Constraint):
    holds = {"position", "orientation"}

    def orientation(self, t, p):
        R = np.eye(3)
        R[0, 1] = t
        return R


class WithoutExample(rn.LoadModel):
    def __init__(self, *, at, direction, name=None, **parameters):
        super().__init__(at, name=name, **parameters)
        self.direction = direction


WRONG = {
    WrongJacobian: r"'jacobian by v': jacobian\(\)\['v'\] is not the derivative",
    JacobianNotAtRest: r"'finite at rest': jacobian\(\)\['v'\] is not finite at v = 0",
    Propulsive: r"'dissipative: law': force\(\) \. v is positive at site",
    Counting: r"'purity': force\(\) changes self.calls",
    Drifting: r"'purity': force\(\) gives another value the second time",
    Writing: r"'purity': force\(\) writes to its arguments",
    ReadsSelf: r"'purity': force\(\) depends on a parameter of self",
    WrongShape: r"'shapes': force\(\) has the shape \(7, 1\), not \(7, 3\)",
    Coupled: r"'sites: one by one': site 0 alone gives another result",
    WrongBroadcast: r"'sites: permutation': sites in another order, or p of shape \(n, 1\)",
    NotAtRest: r"'finite at rest': force\(\) is not finite at v = 0",
    Deep: r"'objective: law': force\(\) does not turn with v, x and tangent, or depends on the place",
    Anisotropic: r"'objective: law'",
    NoUnit: r"'declarations': parameter 'c' has no unit",
    HidesAttribute: r"'declarations': parameter 'bind' hides an attribute of DragModel",
    UnknownClaim: r"'declarations': it claims 'passive'",
    LeavesSomething: r"'null value': with c = 0, offset = 0 forces remain",
    BadBend: r"'psi: first derivative': psi\(\)\[1\] is not the derivative",
    BadModulus: r"'psi: second derivative'",
    Forgetful: r"'purity': update\(\) writes to its arguments",
    Generous: r"'dissipative: law': along a path from the initial memory",
    FollowsX: r"'dead load'",
    NoCommand: r"command must return finite curvatures",
    InfiniteCommand: r"'finite': command\(\) is not finite at t = 0.37 s",
    NeedsSensor: r"'sensors'.*reads the sensor 'speed'",
    Jerk: r"'smooth position': the acceleration of position\(\) grows without bound",
    Shear: r"'rotation': orientation\(.*\) is no rotation",
    WithoutExample: r"'placement'.*WithoutExample.example",
}


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
