"""Laws with one mistake each, and the message that `rodnet.testing.check_term` must give for it."""

import numpy as np

import rodnet as rn


class Quadratic(rn.DragModel):
    """Form drag per unit length, f = -c |v| v  [N/m]."""

    site = "line"  # half edges: node velocity, the edge's own tangent, weight l/2
    c = rn.Parameter(1.0, unit="N s^2/m^3", bounds=(0, None), null=0.0)
    claims = {"dissipative", "objective"}  # switch on the checks that must then hold

    def force(self, site, p):  # pure
        return -p.c * rn.norm(site.v) * site.v


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
