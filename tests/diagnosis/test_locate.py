"""Where and when a force acts that the model does not know: exact columns, posterior, evidence."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.diagnosis.force_field import Hats, _response, force_response
from rodnet.diagnosis.smoothing import Smoother
from rodnet.diagnosis.workbench import Workbench
from rodnet.inference.comparison import Comparison
from rodnet.recordings.noise import NoiseModel
from rodnet.sweeps.collect import Serial
from rodnet.terms.loads import LoadModel
from tests.diagnosis import bank_robots, shaken


class Pressed(LoadModel):
    """Loads on the nodes that change with time."""

    default_name = "pressed"
    dead = True
    factor = rn.Parameter(1.0, unit="1", null=0.0)

    def __init__(self, weights, course, **options):
        super().__init__("*", **options)
        self.weights, self.course = weights, course  # (N, 3) [N], and its course over time

    def force(self, site, p):
        return p.factor * self.course(site.t) * self.weights


def pressed(k, weights, course, sigma=shaken.SIGMA, seed=0):
    """A trial of the model itself with a load on it."""
    robot = shaken.robot(shaken.drive(k)).with_terms(Pressed(weights, course))
    traj = rn.Simulation(robot, dt=shaken.DT, stepper="sdirk2").run(shaken.DURATION)
    t = np.arange(0.0, shaken.DURATION, 1.0 / shaken.RATE)
    seen = rn.observe([rn.Markers(robot, shaken.POINTS)], traj, t)[0]
    seen = seen + sigma * np.random.default_rng(100 * seed + k).standard_normal(seen.shape)
    names = [f"m{i}" for i in range(len(shaken.POINTS))]
    return rn.Recording(t, seen, names=names, name=f"trial{k}", attrs=shaken.drive(k))


def bench_of(recordings):
    return Workbench.of(shaken.CASE, recordings, Serial(), shaken.SIGMA)


@pytest.fixture(scope="module")
def graph():
    return shaken.robot(shaken.drive(0)).graph


def test_hats_share_out_a_uniform_force(graph):
    """They sum to one everywhere, so that one newton per metre in all of them is the length in newtons."""
    hats = Hats.over(graph, 2.0)
    assert hats.shape == (12, 6, 3)
    assert hats.weights(graph).sum() == pytest.approx(shaken.LENGTH)
    for t in (0.0, 0.31, 1.99):
        assert hats.at(t).sum() == pytest.approx(1.0)


@pytest.mark.parametrize("robot", [rn.robots.flagellated(n_tails=2), rn.robots.flagellated(n_tails=5)])
def test_every_rod_has_a_hat(robot):
    hats = Hats.over(robot.graph, 1.0)
    assert set(hats.rods) == set(robot.graph.rods)
    assert hats.weights(robot.graph).any(axis=1).all()


@pytest.mark.parametrize("where", [(5, 2, 1), (11, 0, 2), (3, 4, 0)])
def test_columns_are_derivatives_of_runs(graph, where):
    body, time, axis = where
    rec = pressed(0, np.zeros((graph.node_count, 3)), np.sin, sigma=0.0)
    hats = Hats.over(graph, shaken.DURATION)
    bench = bench_of([rec])
    problem = bench.problem()
    columns = force_response(problem.packed[0], problem.values(np.zeros(1), 0), hats)
    weights = np.zeros((graph.node_count, 3))
    weights[:, axis] = hats.weights(graph)[:, body]
    course = lambda t: hats.at(t)[time]  # noqa: E731
    up, down = (pressed(0, s * 1e-4 * weights, course, 0.0).markers for s in (1.0, -1.0))
    quotient = -(up - down).reshape(-1) / 2e-4 / shaken.SIGMA
    mine = columns[:, np.ravel_multi_index(where, hats.shape)]
    np.testing.assert_allclose(mine, quotient, atol=1e-6 * np.abs(quotient).max())


# -- the posterior ----------------------------------------------------------------------------------
def drawn(rng, strengths, noise=1.0, n=150, trials=3, free=4):
    """Trials whose coefficients are drawn from the prior; free parameters are anything."""
    channel = np.array([0] * 20 + [1] * 3)
    J = [rng.standard_normal((n, free)) for _ in range(trials)]
    G = [rng.standard_normal((n, len(channel))) * 0.3 for _ in range(trials)]
    a = [rng.standard_normal(len(channel)) * np.array(strengths)[channel] for _ in range(trials)]
    u = 30.0 * rng.standard_normal(free)
    r = [noise * rng.standard_normal(n) - j @ u - g @ x for j, g, x in zip(J, G, a, strict=True)]
    return Smoother(r, J, G, channel), a, (r, J, G)


def test_the_posterior_is_that_of_dense_algebra():
    rng = np.random.default_rng(0)
    smoother, _, (r, J, G) = drawn(rng, (1.0, 0.5))
    found = smoother.at(np.array([0.8, 0.4]))
    prior = np.tile(np.where(np.arange(23) < 20, 0.8, 0.4), 3)
    U = np.linalg.qr(np.concatenate(J))[0]
    P = np.eye(len(U)) - U @ U.T
    block = np.zeros((450, 69))
    for k, g in enumerate(G):
        block[150 * k : 150 * (k + 1), 23 * k : 23 * (k + 1)] = g
    PG, Pr = P @ block, P @ np.concatenate(r)
    S = PG * prior @ (PG * prior).T + np.eye(450)
    C = np.linalg.inv(PG.T @ PG + np.diag(prior**-2))
    np.testing.assert_allclose(np.concatenate(found.mean), -C @ PG.T @ Pr, rtol=1e-7)
    np.testing.assert_allclose(found.covariance[1], found.variance * C[23:46, 23:46], rtol=1e-7, atol=1e-12)
    Q = Pr @ np.linalg.solve(S, Pr)
    variance = max(1.0, Q / (450 - 4))
    assert found.variance == pytest.approx(variance)
    expected = -0.5 * (446 * np.log(variance) + Q / variance + np.linalg.slogdet(S)[1])
    assert found.evidence == pytest.approx(expected)


def test_the_evidence_has_the_slope_that_is_told():
    smoother, _, _ = drawn(np.random.default_rng(1), (1.0, 0.5), noise=1.3)
    z, h = np.log([0.7, 0.2]), 1e-5
    slope = smoother.at(np.exp(z)).slope
    for k in range(2):
        step = h * np.eye(2)[k]
        up, down = (smoother.at(np.exp(z + s * step)).evidence for s in (1.0, -1.0))
        assert slope[k] == pytest.approx((up - down) / (2.0 * h), rel=1e-4)


def test_turned_coefficients_have_the_same_evidence():
    """The search sees the coefficients of the widest channel in other directions: neither evidence nor slope tells."""
    smoother, _, _ = drawn(np.random.default_rng(3), (1.0, 0.5), noise=1.2)
    for prior in ((0.7, 0.2), (3.0, 0.0), (0.0, 1.0)):
        one = smoother.at(np.array(prior))
        evidence, slope, variance, _ = smoother._turned()._solve(np.array(prior))
        assert evidence == pytest.approx(one.evidence, rel=1e-10)
        np.testing.assert_allclose(slope, one.slope, atol=1e-7)
        assert variance == pytest.approx(one.variance, rel=1e-10)


def test_the_evidence_finds_the_strengths_and_the_errors_are_as_large_as_told():
    rng = np.random.default_rng(2)
    errors, priors = [], []
    for _ in range(8):
        smoother, a, _ = drawn(rng, (0.6, 3.0))
        found = smoother.best()
        priors.append(found.prior)
        for mean, C, true in zip(found.mean, found.covariance, a, strict=True):
            errors.append((mean - true) / np.sqrt(np.diag(C)))
    np.testing.assert_allclose(np.median(priors, axis=0), (0.6, 3.0), rtol=0.25)
    assert np.std(errors) == pytest.approx(1.0, abs=0.08)


def test_white_noise_pushes_nothing():
    rng = np.random.default_rng(3)
    for _ in range(5):
        smoother, _, _ = drawn(rng, (0.0, 0.0))
        found = smoother.best()
        loud = smoother.at(smoother.loud)
        assert found.evidence - smoother.at(np.zeros(2)).evidence < 3.0
        z = np.concatenate([m / np.sqrt(np.diag(C)) for m, C in zip(loud.mean, loud.covariance, strict=True)])
        assert np.std(z) == pytest.approx(1.0, abs=0.25)  # told as noise where the prior hides nothing
        assert np.abs(z).max() < 4.5


def _bodied():
    """A stiff plate at the end of a soft rod, which falls: whole evaluations find its columns."""
    fig = rn.StickFigure()
    fig.rod("rod", [(0, 0, 0), (0.2, 0, 0)], edges=5, material=rn.Material(E=1e6, rho=1100.0), radius=4e-3)
    fig.rigid("plate", ["rod.end", (0.23, 0.01, 0)], radius=3e-3)
    fig.body("plate", mass=2e-3, inertia=(1e-7, 2e-7, 2e-7))
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), rn.Clamp(at="rod.start")]
    return rn.Robot(fig.build(), [*terms, rn.ResistiveForce(viscosity=0.5)])


@pytest.mark.parametrize("make", [lambda: bank_robots.arm()[0], _bodied], ids=["arm", "body"])
def test_columns_of_joints_and_bodies(make):
    robot = make()
    rod = next(r.name for r in robot.graph.rods.values() if r.kind != "rigid")
    points = [f"{rod}@50%", f"{rod}.end"]
    t = np.linspace(0.0, 0.2, 5)
    rec = rn.Recording(t, np.zeros((5, 2, 3)), names=["a", "b"], name="none")
    case = rn.Case(
        build=lambda rec: make(), observe=lambda rec, robot: rn.Markers(robot, points),
        options=lambda rec, robot: {"dt": 0.02, "stepper": "sdirk2"}, free=[], name="case",
    )  # fmt: skip
    hats = Hats.over(robot.graph, 0.2, 6, 3)
    trial = Comparison(case, rec, {"markers": NoiseModel(white=1.0)})
    columns = _response(trial, {}, hats)
    body = next(k for k, name in enumerate(hats.rods) if name == rod and hats.places[k] > 0.4)
    where = (body, 1, 2)
    weights = np.zeros((robot.graph.node_count, 3))
    weights[:, 2] = hats.weights(robot.graph)[:, body]
    runs = []
    for s in (1e-4, -1e-4):
        pushed = robot.with_terms(Pressed(s * weights, lambda t: hats.at(t)[1]))
        traj = rn.Simulation(pushed, dt=0.02, stepper="sdirk2").run(0.2)
        runs.append(rn.observe([rn.Markers(pushed, points)], traj, t)[0])
    quotient = -(runs[0] - runs[1]).reshape(-1) / 2e-4
    mine = columns[:, np.ravel_multi_index(where, hats.shape)]
    np.testing.assert_allclose(mine, quotient, atol=1e-5 * np.abs(quotient).max())
