"""The tangent agrees with differences of whole computed runs."""

import numpy as np
import pytest

import rodnet as rn
from tests.tangent import whole_runs as wr

STEPPERS = ["euler", "sdirk2", "alpha"]


def check(robot, duration, parameters, limit, initial=None, relative=1e-3, tolerance=wr.ROUND_OFF, **options):
    options["tolerance"] = tolerance
    found = rn.sensitivities(
        robot, duration, parameters=list(parameters), initial=initial, save_every=10**6, **options
    )  # fmt: skip
    end, split = wr.at_end(found), wr.parts(robot)
    for c, (name, paths) in enumerate(parameters.items()):
        expected = wr.by_parameter(robot, paths, duration, relative, **options)
        assert wr.error(end[:, c], expected, split) < limit, name
    for c, (name, change) in enumerate((initial or {}).items(), start=len(parameters)):

        def run(step, change=change):
            other = robot
            if "x" in change:
                graph = robot.graph.with_positions(robot.graph.x0 + step * np.asarray(change["x"]))
                other = rn.Robot(graph, robot.terms, robot.sensors)
            start = options.get("velocity", 0.0) + step * np.asarray(
                change.get("v", np.zeros_like(robot.graph.x0))
            )
            return wr.last(other, duration, **{**options, "velocity": start})

        assert wr.error(end[:, c], wr.quotient(run, relative), split) < limit, name


def test_the_papers_robot_over_five_seconds():
    robot = rn.robots.flagellated(n_tails=2, rpm=100.0)
    parameters = {
        "drag.viscosity": ["drag.viscosity"],
        "tail*.E": ["tail0.E", "tail1.E"],
        "motor.rpm": ["motor.rpm"],
    }
    check(robot, 5.0, parameters, 1e-5, dt=0.01)


def cable(law=None):
    """A branched cable with a clamped end that swings under gravity."""
    fig = rn.StickFigure()
    soft = rn.Material(E=2e6, nu=0.4, rho=1100.0)
    fig.rod("stem", [(0, 0, 0), (0.3, 0, 0)], edges=7, material=soft, radius=4e-3)
    fig.rod("left", ["stem.end", (0.4, 0.15, 0.0)], edges=4, material=soft, radius=3e-3)
    fig.rod("right", ["stem.end", (0.42, -0.1, 0.05)], edges=4, material=soft, radius=3e-3)
    terms = [rn.Stretching(), rn.Bending(), rn.Twisting(), rn.Gravity(), rn.Clamp(at="stem.start")]
    terms += [rn.KelvinVoigt(bend=0.01, stretch=1e-4, twist=0.01), rn.MassDamping(rate=0.3)]
    return rn.Robot(fig.build(), terms if law is None else [*terms, law])


@pytest.mark.parametrize("stepper", STEPPERS)
def test_a_swinging_branched_cable_over_a_second(stepper):
    robot = cable()
    parameters = {name: [name] for name in ("stem.E", "left.rho", "damping.bend")}
    rng = np.random.default_rng(3)
    push = rng.standard_normal(robot.graph.x0.shape) * (robot.graph.x0[:, :1] > 0.0)
    velocity = 0.3 * robot.graph.x0 * np.array([0.0, 1.0, 1.0])
    check(
        robot, 1.0, parameters, 1e-5, {"push": {"v": 0.1 * push}}, relative=2e-4, dt=0.02, stepper=stepper,
        velocity=velocity,
    )  # fmt: skip


class Softening(rn.DragModel):
    """A medium that is worn by what passes through it, and recovers: smooth, with memory."""

    memory_size = 1
    c = rn.Parameter(0.8, unit="Pa s", bounds=(0, None))
    rate = rn.Parameter(3.0, unit="1/m", bounds=(0, None))
    recovery = rn.Parameter(0.5, unit="s", bounds=(1e-9, None))

    def update(self, site, p, m_old):
        speed = np.sqrt(np.sum(site.v**2, axis=1, keepdims=True) + 1e-4)
        worn = (m_old + site.dt * p.rate * speed) / (1.0 + site.dt / p.recovery)
        return -p.c * (1.0 + np.exp(-worn)) * site.v, worn


@pytest.mark.parametrize("stepper", STEPPERS)
def test_a_smooth_law_with_memory(stepper):
    robot = cable(Softening(on="left"))
    parameters = {name: [name] for name in ("drag.rate", "stem.E")}
    check(robot, 0.3, parameters, 1e-5, dt=0.02, stepper=stepper)


def test_the_run_itself_is_not_changed():
    robot = rn.robots.flagellated(n_tails=2, rpm=100.0)
    found = rn.sensitivities(robot, 0.1, parameters=["drag.viscosity"])
    plain = rn.Simulation(robot).run(0.1)
    assert np.array_equal(found.trajectory.x, plain.x)
    assert np.array_equal(found.trajectory.theta, plain.theta)


CHANGES = {
    "elastic_wall": (rn.ElasticWall(stiffness=5.0, position=-0.02, layer=0.02), ["stiffness", "position", "layer"]),
    "flow": (rn.BackgroundFlow(u_x=0.05, u_y=-0.1, u_z=0.08), ["u_y"]),
    "uneven_flow": (rn.UnevenFlow(ux=0.05, axz=0.8, ayx=-0.5, vy=0.04, frequency=0.7), ["ayx", "vy", "frequency"]),
    "local_flow": (rn.LocalFlow(ux=0.05, axz=0.8, azx=-0.8, x=0.2, z=-0.03, width=0.1), ["ux", "azx", "x", "width"]),
    "local_patch": (
        rn.LocalPatch(linear=-0.4, gz=0.2, kxz=2.0, x=0.2, z=-0.03, width=0.1),
        ["linear", "gz", "kxz", "x", "width"],
    ),
    "tether": (
        rn.Tether(on="stem", stiffness=0.8, fx=0.01, fz=-0.02, place=0.6, width=0.1),
        ["stiffness", "fz", "place", "width"],
    ),
    "wall_drag": (rn.WallDrag(reach=0.04, position=-0.05, near=0.02), ["reach", "position", "near"]),
    "drag_region": (rn.DragRegion(gain=0.7, place=0.4, width=0.2), ["gain", "place"]),
    "thinning": (rn.PowerLawChange(exponent=0.6, speed=0.05), ["exponent"]),
}  # fmt: skip


@pytest.mark.parametrize("name", CHANGES)
@pytest.mark.parametrize("given", ["coefficients", "viscosity"])
def test_changes_of_a_medium_and_what_they_change(name, given):
    """By strengths and shapes, by the medium's own viscosity, and by the thickness that its coefficients depend on."""
    change, own = CHANGES[name]
    law = (
        rn.ResistiveForce(eta_t=0.3, eta_n=0.7)
        if given == "coefficients"
        else rn.ResistiveForce(viscosity=0.1)
    )
    robot = cable(law).with_terms(change)
    paths = [f"{name}.{p}" for p in own]
    paths += ["drag.eta_n"] if given == "coefficients" else ["drag.viscosity", "stem.radius"]
    check(robot, 0.2, {p: [p] for p in paths}, 2e-5, dt=0.01, stepper="sdirk2")
