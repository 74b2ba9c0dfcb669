"""Nonlinear media against closed formulas: grains, shear-thinning fluids, yield stresses, currents."""

import numpy as np
import pytest

import rodnet as rn
from rodnet.terms.drag.resistive import gray_hancock, lighthill
from rodnet.testing import Probe, check_term
from tests.mechanics.beams import MATERIAL, WEIGHT, L, R, beam, elastic

G = 9.81
FLAT, UPRIGHT = ((0, 0, 0), (L, 0, 0)), ((0, 0, 0), (0, 0, L))
LAWS = {
    "lighthill": lambda: rn.ResistiveForce(viscosity=1.0, coefficients="lighthill", length=0.3),
    "granular": lambda: rn.GranularForce(surface=0.02, CF=1.8e5, CS=4.2e5, gamma=4.0),
    "power law": lambda: rn.PowerLawForce(viscosity=1.0, rate=5.0, exponent=0.4),
    "power law of Lighthill": lambda: rn.PowerLawForce(
        viscosity=1.0, rate=1.0, exponent=0.5, coefficients="lighthill", length=0.3
    ),
    "bingham": lambda: rn.BinghamForce(viscosity=1.0, yield_stress=10.0, speed=1e-3),
}


@pytest.mark.parametrize("tangent", ["edge", "node"])
@pytest.mark.parametrize("law", sorted(LAWS))
def test_laws_keep_the_contract(law, tangent):
    term = LAWS[law]()
    term.tangent = tangent
    check_term(term)


@pytest.mark.parametrize("law", [rn.GranularForce, rn.PowerLawForce, rn.BinghamForce])
def test_classes_keep_the_contract_with_their_kernels(law):
    report = check_term(law)
    assert {"kernel: force", "kernel: by v", "kernel: by tangent"} <= set(report.errors)


@pytest.mark.parametrize("law", sorted(LAWS))
@pytest.mark.parametrize("speed", [0.0, 1e-9, 1e-6, 1e-4])
def test_jacobians_near_rest(law, speed):
    """Where speeds are about the regularisation speed, far below it, and zero."""
    graph = beam(4).graph
    probe = Probe(rn.Robot(graph, [LAWS[law]()]), np.random.default_rng(3), speed=max(speed, 1e-9))
    if speed == 0.0:
        probe.v = 0.0 * probe.v
    for error, where in probe.jacobian_errors().values():
        assert error < 1e-5, where


def settle(robot, duration=0.5, dt=0.01, **options):
    tight = rn.Tolerance(residual=1e-11, update=1e-14)
    return rn.Simulation(robot, dt, tolerance=tight, **options).run(duration)


def pulled(law, load, points=FLAT, direction=(0, 0, -1.0), **options):
    """Velocity along a uniform load per unit length [N/m], in the end."""
    direction = np.array(direction)
    robot = beam(4, rn.Gravity(g=load / WEIGHT, direction=direction), law, points=points)
    v = settle(robot, **options).v[-1]
    assert np.ptp(v, axis=0) == pytest.approx(0.0, abs=1e-6 * np.abs(v).max())
    return float(v[0] @ direction)


# -- viscous -------------------------------------------------------------------------------------
def test_lighthill_coefficients_sink_by_their_formula():
    eta_t, eta_n = lighthill(3.0, 0.3, R)
    assert (eta_t, eta_n) == pytest.approx((6 * np.pi / np.log(27.0), 12 * np.pi / (np.log(27.0) + 0.5)))
    law = LAWS["lighthill"]
    assert pulled(law(), 0.5) == pytest.approx(0.5 / (eta_n / 3), rel=1e-8)
    assert pulled(law(), 0.5, UPRIGHT) == pytest.approx(0.5 / (eta_t / 3), rel=1e-8)


def helix(turns=12, per_turn=40, radius=0.01, pitch=0.04):
    angle = np.linspace(0.0, 2 * np.pi * turns, turns * per_turn + 1)
    points = np.stack([pitch * angle / (2 * np.pi), radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    figure = rn.StickFigure()
    figure.rod("helix", list(points), material=rn.Material(E=1e9), radius=5e-4)
    return figure.build(), radius, pitch


@pytest.mark.parametrize("coefficients", ["gray-hancock", "lighthill", "given"])
def test_a_rigid_helix_swims_at_the_closed_form_speed(coefficients):
    """U / (omega a) = (eta_n - eta_t) sin c / (eta_t c^2 + eta_n s^2): no force along the axis is left."""
    graph, a, pitch = helix()
    c, s = np.array([pitch, 2 * np.pi * a]) / np.hypot(pitch, 2 * np.pi * a)
    wavelength = pitch / c
    if coefficients == "given":
        eta_t, eta_n, drag = 1.0, 3.0, rn.ResistiveForce(eta_t=1.0, eta_n=3.0)
    else:
        formula = {"gray-hancock": gray_hancock, "lighthill": lighthill}[coefficients]
        eta_t, eta_n = formula(2.0, wavelength, 5e-4)
        drag = rn.ResistiveForce(viscosity=2.0, coefficients=coefficients, length=wavelength)
    omega = 4.0
    speed = omega * a * (eta_n - eta_t) * s * c / (eta_t * c**2 + eta_n * s**2)
    spin = np.cross((omega, 0, 0), graph.x0)

    def thrust(U):
        traj = rn.Simulation(rn.Robot(graph, [drag]), 1e-6, velocity=spin + np.array((U, 0, 0))).run(1e-6)
        return traj.term_forces("drag", 0).sum(axis=0)[0]

    assert abs(thrust(speed)) < 3e-3 * abs(thrust(0.0))  # polygons of 40 edges
    assert thrust(0.0) > 0.0 > thrust(2.0 * speed)


# -- grains --------------------------------------------------------------------------------------
def granular(**options):
    return rn.GranularForce(**{"CF": 2e5, "CS": 5e5, "gamma": 10.0, "surface": 0.3, "speed": 1e-4} | options)


def drag_of(law, v, points=FLAT):
    """Total force on a rod that moves with the velocity v [N], shape (3,)."""
    robot = rn.Robot(beam(4, points=points).graph, [law])
    velocity = np.tile(v, (5, 1))
    return rn.Simulation(robot, 1e-6, velocity=velocity).run(1e-6).term_forces(law.name, 0).sum(axis=0)


def test_grains_resist_at_any_speed_alike():
    """Above the regularisation speed twice the speed changes nothing; along, across, and obliquely."""
    for v in ((0.1, 0, 0), (0, 0.1, 0), (0.08, 0.06, 0)):
        slow, fast = drag_of(granular(), np.array(v)), drag_of(granular(), 2 * np.array(v))
        assert fast == pytest.approx(slow, rel=2e-6, abs=1e-9 * np.abs(slow).max())


def test_grains_resist_along_and_across_by_the_formula():
    """2 r z l (CF cos, CF sin + CS sin(atan(gamma sin)))."""
    area = 2 * R * 0.3 * L
    for angle in (0.0, 0.05, 0.3, 1.0, np.pi / 2):
        c, s = np.cos(angle), np.sin(angle)
        force = drag_of(granular(), np.array((0.1 * c, 0.1 * s, 0.0)))
        wanted = -area * np.array((2e5 * c, 2e5 * s + 5e5 * np.sin(np.arctan(10.0 * s)), 0.0))
        assert force == pytest.approx(wanted, rel=1e-5, abs=1e-4)


def test_grains_resist_in_proportion_to_depth_and_not_above_the_surface():
    v = np.array((0.0, 0.1, 0.0))
    at = {z: drag_of(granular(surface=z), v)[1] for z in (0.1, 0.2, 0.4, R, 0.0, -R, -0.1)}
    assert at[0.2] == pytest.approx(2 * at[0.1]) and at[0.4] == pytest.approx(4 * at[0.1])
    assert at[R] / at[0.1] == pytest.approx(R / 0.1)
    assert at[0.0] / at[R] == pytest.approx(0.25)  # half of the rod's height, on average at a quarter of R
    assert at[-R] == 0.0 and at[-0.1] == 0.0


def test_a_rod_stands_in_grains_until_it_is_pulled_hard_enough():
    """It creeps no faster than the regularisation speed below the threshold, and accelerates above."""
    threshold = 2 * R * 0.3 * (2e5 + 5e5 * 10.0 / np.sqrt(101.0))
    below = pulled(granular(), 0.5 * threshold, direction=(0, -1.0, 0), duration=0.2)
    assert 0.0 < below < 1e-4
    robot = beam(4, rn.Gravity(g=1.5 * threshold / WEIGHT, direction=(0, -1.0, 0)), granular())
    traj = settle(robot, 0.2, stepper="sdirk2")
    assert -traj.v[-1, 0, 1] == pytest.approx(0.5 * threshold / WEIGHT * 0.2, rel=1e-3)


# -- shear-thinning ------------------------------------------------------------------------------
@pytest.mark.parametrize("exponent", [0.5, 0.7, 1.0, 1.4])
def test_power_law_slope_and_terminal_velocity(exponent):
    """Far above the rate v = (f / (zeta K))^(1/n) r^(1 - 1/n) with the consistency K; far below v = f / eta."""
    law = rn.PowerLawForce(viscosity=20.0, rate=2e-3, exponent=exponent)
    _, zeta_n = gray_hancock(1.0, L, R)
    loads = np.array([0.02, 0.05, 0.1])
    speeds = np.array([pulled(law, f, duration=3.0, dt=0.05) for f in loads])
    consistency = 20.0 * 2e-3 ** (1.0 - exponent)
    wanted = (loads / (zeta_n * consistency * R ** (1.0 - exponent))) ** (1.0 / exponent)
    assert speeds == pytest.approx(wanted, rel=1e-3)
    assert np.diff(np.log(speeds)) / np.diff(np.log(loads)) == pytest.approx(1.0 / exponent, rel=1e-3)
    slow = rn.PowerLawForce(viscosity=2.0, rate=1e6, exponent=exponent)
    assert pulled(slow, 0.1) == pytest.approx(0.1 / (2.0 * zeta_n), rel=1e-6)


def test_without_thinning_it_is_resistive_force_theory():
    for tangent in ("edge", "node"):
        probes = [
            Probe(rn.Robot(beam(4).graph, [law]), np.random.default_rng(1))
            for law in (
                rn.PowerLawForce(viscosity=2.0, rate=1.0, exponent=1.0, tangent=tangent),
                rn.BinghamForce(viscosity=2.0, yield_stress=0.0, tangent=tangent),
                rn.ResistiveForce(viscosity=2.0, tangent=tangent),
            )
        ]
        power_law, bingham, viscous = (p.forces() for p in probes)
        assert power_law == pytest.approx(viscous, rel=1e-12, abs=1e-15)
        assert bingham == pytest.approx(viscous, rel=1e-12, abs=1e-15)


# -- yield ---------------------------------------------------------------------------------------
@pytest.mark.parametrize(("points", "share"), [(FLAT, 2 * 11.94), (UPRIGHT, 2 * np.pi)])
def test_below_the_yield_load_a_rod_stays_above_it_moves(points, share):
    """Yield forces 2 N r tau across and 2 pi r tau along; above, v = (f - f_y) / eta."""
    speed, stress, viscosity = 1e-6, 20.0, 0.5
    law = rn.BinghamForce(viscosity=viscosity, yield_stress=stress, bearing=11.94, speed=speed)
    eta_t, eta_n = gray_hancock(viscosity, L, R)
    eta, threshold = eta_n if points == FLAT else eta_t, share * R * stress
    v = pulled(law, 0.5 * threshold, points)
    assert v == pytest.approx(-speed * np.log(0.5), rel=1e-3)  # 1 - exp(-v/speed) = 1/2
    assert pulled(law, 0.98 * threshold, points) < 5 * speed
    for load in (1.02, 1.5, 4.0):
        assert pulled(law, load * threshold, points) == pytest.approx(
            (load - 1.0) * threshold / eta, rel=1e-6
        )


# -- currents ------------------------------------------------------------------------------------
FLOWS = {
    "current": rn.UniformFlow((0.1, -0.05, 0.02)),
    "shear": rn.ShearFlow(2.0, along=(1, 0, 0), across=(0, 1, 1), origin=(0, 0.01, 0)),
    "vortex": rn.VortexFlow(0.02, core=0.03, axis=(0.1, 0, 1), centre=(0.02, 0.01, 0)),
    "function": lambda x, t: 0.1 * np.sin(30.0 * x[:, [1, 2, 0]] + t),
}


@pytest.mark.parametrize("flow", sorted(FLOWS))
def test_flows_have_the_gradients_they_say(flow):
    from rodnet.terms.drag.flow import as_flow

    field, x, h = as_flow(FLOWS[flow], "test"), np.random.default_rng(0).normal(size=(8, 3)) * 0.03, 1e-6
    x[0] = (0.02, 0.01, 0.0)  # the vortex' axis
    for k in range(3):
        step = h * np.eye(3)[k]
        slope = (field.velocity(x + step, 0.3) - field.velocity(x - step, 0.3)) / (2 * h)
        assert field.gradient(x, 0.3)[:, :, k] == pytest.approx(slope, abs=1e-7)
    assert np.trace(field.gradient(x, 0.3), axis1=1, axis2=2) == pytest.approx(0.0, abs=1e-12)


class Bristles(rn.DragModel):
    """Friction with pre-sliding, a law with memory."""

    memory_size = 3
    k = rn.Parameter(2e3, unit="N/m^2", bounds=(0, None), null=0.0)
    claims = {"dissipative", "objective"}

    def update(self, site, p, m_old):
        bristle = m_old + site.v * site.dt
        bristle = bristle / np.maximum(1.0, rn.norm(bristle) / 1e-3)
        return -p.k * bristle, bristle


@pytest.mark.parametrize("flow", sorted(FLOWS))
def test_any_drag_law_takes_a_flow(flow):
    laws = [LAWS[k]() for k in ("granular", "power law", "bingham")]
    laws += [type(law)(**{**law._given[1], "flow": FLOWS[flow]}) for law in laws] + [
        Bristles(flow=FLOWS[flow])
    ]
    for law in [*laws, rn.ResistiveForce(viscosity=2.0, flow=FLOWS[flow])]:
        check_term(law)


def test_a_free_rod_goes_with_the_current_and_turns_with_the_vortex():
    """In a current it takes its velocity; in a vortex' core it turns like the core."""
    current = np.array((0.1, -0.05, 0.02))
    drag = rn.ResistiveForce(viscosity=3.0, flow=current)
    assert settle(beam(4, drag)).v[-1] == pytest.approx(np.tile(current, (5, 1)), abs=1e-7)
    vortex = rn.VortexFlow(0.5, core=2.0, centre=(0.5 * L, 0.0, 0.0))
    spin = 0.5 / (2 * np.pi * 2.0**2)
    drag = rn.ResistiveForce(viscosity=3.0, flow=vortex)
    sim = rn.Simulation(beam(4, drag), 0.05, stepper="sdirk2")
    tangent = np.diff(sim.run(5.0).x[-1], axis=0)[0]
    assert np.arctan2(tangent[1], tangent[0]) == pytest.approx(spin * 5.0, rel=3e-3)


def test_a_rod_across_a_shear_turns_like_jeffery_slender():
    """Slender rods in a shear turn at -rate sin^2 of the angle to the flow (Jeffery 1922)."""
    drag = rn.ResistiveForce(viscosity=3.0, flow=rn.ShearFlow(2.0, along=(1, 0, 0), across=(0, 0, 1.0)))
    traj = rn.Simulation(beam(4, drag, points=((0, 0, -L / 2), (0, 0, L / 2))), 0.01, stepper="sdirk2").run(
        1.0
    )
    e = traj.x[-1, -1] - traj.x[-1, 0]
    # cot(angle) grows at the shear rate
    assert e[0] / e[2] == pytest.approx(2.0, rel=2e-3)


def test_flow_that_holds_a_rod_in_place_drags_it_like_motion_through_rest():
    """Only the relative velocity counts: the clamp feels the same in a current as when it is led through."""
    u = np.array((0.0, 0.02, 0.0))
    held = rn.PrescribedMotion(at="beam:0-1", position=lambda t: 0.0 * u, orientation=lambda t: np.eye(3))
    led = rn.PrescribedMotion(at="beam:0-1", position=lambda t: -u * t, orientation=lambda t: np.eye(3))
    still = settle(beam(6, held, rn.ResistiveForce(viscosity=0.3, flow=u)), 10.0, 0.05)
    moving = settle(beam(6, led, rn.ResistiveForce(viscosity=0.3)), 10.0, 0.05)
    assert still.reactions["motion"].force[-1] == pytest.approx(
        moving.reactions["motion"].force[-1], rel=1e-5, abs=1e-9
    )


# -- mistakes ------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: rn.ResistiveForce(viscosity=1.0, coefficients="lighthil"), "gray-hancock"),
        (lambda: rn.ResistiveForce(viscosity=1.0, coefficients="lighthill"), "wavelength"),
        (lambda: rn.ResistiveForce(viscosity=1.0, axial_torque=True, flow=(1, 0, 0)), "axial_torque"),
        (lambda: rn.ResistiveForce(viscosity=1.0, flow="north"), "flow = 'north'"),
        (lambda: rn.ResistiveForce(viscosity=1.0, flow=rn.ShearFlow), "flow = "),
        (lambda: rn.ShearFlow(1.0, along=(1, 0, 0), across=(1, 0, 1)), "right angles"),
        (lambda: rn.VortexFlow(1.0, core=0.0), "core"),
        (lambda: rn.UniformFlow((1, 2)), "current"),
        (lambda: rn.PowerLawForce(viscosity=1.0, rate=1.0, exponent=0.5, zeta_t=1.0), "zeta_n"),
        (lambda: rn.BinghamForce(viscosity=1.0, yield_stress=1.0, speed=0.0), "speed"),
        (lambda: rn.BinghamForce(viscosity=1.0), r"give yield_stress= \(yield stress, Pa\)"),
        (lambda: rn.GranularForce(CF=1e5, CS=1e5), r"give gamma= .*media differ"),
        (lambda: rn.TubeForce(), r"TubeForce: give viscosity="),
    ],
)
def test_mistakes_are_named(make, match):
    with pytest.raises(rn.RodnetError, match=match):
        make()


def test_a_flow_of_the_wrong_shape_and_a_rod_that_is_not_slender():
    with pytest.raises(rn.TermError, match=r"shape of x"):
        robot = beam(4, rn.ResistiveForce(viscosity=1.0, flow=lambda x, t: np.zeros(3)))
        rn.Simulation(robot, 0.01).step()
    stub = rn.StickFigure().rod("stub", [(0, 0, 0), (4 * R, 0, 0)], edges=2, material=MATERIAL, radius=R)
    law = rn.ResistiveForce(viscosity=1.0, coefficients="lighthill", length=4 * R)
    with pytest.raises(rn.TermError, match="not slender"):
        rn.Robot(stub.build(), [*elastic(), law])
    with pytest.raises(rn.TermError, match=r"PowerLawForce: .*not slender.*zeta_t="):
        rn.Robot(
            stub.build(),
            [*elastic(), rn.PowerLawForce(viscosity=1.0, rate=1.0, exponent=0.5, length=0.5 * R)],
        )
