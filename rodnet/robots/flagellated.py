"""The robot of Du, Lam, Sachanandani and Jawed: a head with a motor and n soft tails in grains."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from rodnet.errors import ParameterError
from rodnet.graph.material import Material
from rodnet.graph.stick_figure import StickFigure
from rodnet.parameters import Parameter, is_number
from rodnet.robot import Robot
from rodnet.terms.actuators import Motor
from rodnet.terms.drag.resistive import ResistiveForce
from rodnet.terms.drag.stokes import StokesHead
from rodnet.terms.energies import Bending, Stretching, Twisting

if TYPE_CHECKING:
    from rodnet.observer import Observer
    from rodnet.trajectory import Trajectory


def flagellated(
    n_tails: int = 2,
    rpm: float = 100.0,
    *,
    root: str = "rigid",
    edges: int = 27,
    tangent: str = "node",
    mu: float = 6.828,
    C1: float = 2.420,
    C2: float = 0.039,
    E: float = 1.2e6,
    nu: float = 0.5,
    rho: float = 1000.0,
    r0: float = 3.2e-3,
    a: float = 0.02,
    L2: float = 0.04,
    L3: float = 0.111,
    mass: float = 0.035,
    axial_torque: bool = False,
    rigid: str = "stiff",
) -> Robot:
    """Return the paper's robot; its parameters are the defaults.

    Parameters
    ----------
    n_tails : int
        Number of tails.
    rpm : float
        Speed of the motor, omega_T [rpm].
    root : {"rigid", "clamped"}
        Stiff rim as in the paper, or the converged clamp of the tail.
    edges : int
        Edges per tail (27 of 4.11 mm in the paper).
    tangent : {"node", "edge"}
        Tangent of the tails' drag: the paper's averaged one, or half edges.
    mu : float
        Viscosity of the medium [Pa s].
    C1, C2 : float
        Shape factors of the head's drag force and torque [1].
    E, nu, rho : float
        Young's modulus [Pa], Poisson's ratio [1] and density [kg/m^3] of the tails.
    r0, a, L2, L3 : float
        Radius of the tails, radius of the head, diameter of the disc, length of the tails [m].
    mass : float
        Mass of the head [kg].
    axial_torque : bool
        Add the torque on spinning tails that the paper leaves out.
    rigid : {"stiff", "body"}
        Rigid parts as very stiff rods, as in the paper, or as true rigid bodies: the front of the head with its
        mass, and the disc. The motor's ``shaft`` between them stays a stiff rod.

    Returns
    -------
    Robot
        Rods ``head`` (nodes x_0, x_h, x_a), ``disc0``..., ``tail0``...; terms named stretching,
        bending, twisting, drag, head, motor.

    Raises
    ------
    ParameterError
        If there are no tails, or a length or the mass is not positive.
    """
    if isinstance(n_tails, bool) or not is_number(n_tails) or n_tails % 1 or n_tails < 1:
        raise ParameterError(f"n_tails = {n_tails!r} must be a positive integer")
    for label, value in (("a", a), ("L2", L2), ("L3", L3), ("r0", r0), ("mass", mass)):
        if not (is_number(value) and value > 0):
            raise ParameterError(f"flagellated: {label} = {value!r} must be positive and finite, in SI units")
    if rigid not in ("stiff", "body"):
        raise ParameterError(f"flagellated: rigid must be 'stiff' or 'body', not {rigid!r}")
    fig = StickFigure()
    if rigid == "body":
        fig.rigid("head", [(2.0 * a, 0.0, 0.0), (a, 0.0, 0.0)], radius=a)
        fig.rigid("shaft", ["head.end", (0.0, 0.0, 0.0)])
        cylinder = mass * a**2 * np.array([1.0 / 2.0, 7.0 / 12.0, 7.0 / 12.0])
        fig.body("head", mass=mass, com=(a, 0.0, 0.0), inertia=cylinder)
    else:
        fig.rigid("head", [(2.0 * a, 0.0, 0.0), (a, 0.0, 0.0), (0.0, 0.0, 0.0)], mass=mass, radius=a)
    centre = "shaft.end" if rigid == "body" else "head.end"
    material = Material(E=E, nu=nu, rho=rho)
    for k in range(int(n_tails)):
        angle = 2.0 * np.pi * k / n_tails
        rim = 0.5 * L2 * np.array([0.0, np.cos(angle), np.sin(angle)])
        fig.rigid(f"disc{k}", [centre, rim])
        fig.rod(
            f"tail{k}",
            [f"disc{k}.end", rim - np.array([L3, 0.0, 0.0])],
            edges=edges,
            root=root,
            material=material,
            radius=r0,
        )
    if rigid == "body":
        fig.body([f"disc{k}" for k in range(int(n_tails))], name="disc")
    else:
        fig.joint(centre, hub="head:1-2")
    viscosity = Parameter(mu, unit="Pa s", bounds=(0, None), doc="viscosity of the medium")
    return Robot(
        fig.build(),
        [
            Stretching(),
            Bending(),
            Twisting(),
            ResistiveForce(viscosity=viscosity, on="tail*", tangent=tangent, axial_torque=axial_torque),
            StokesHead(viscosity=viscosity, radius=a, C1=C1, C2=C2, at="head:1"),
            Motor(at="head:1", rpm=rpm),
        ],
        sensors={"head_rpm": head_rpm, "speed": forward_speed},
    )


def head_rpm(s: Observer) -> float:
    """Speed of rotation of the head [rpm], a sensor."""
    return abs(s.rpm("head:0-1"))


def forward_speed(s: Observer) -> float:
    """Velocity of the head along x [m/s], a sensor."""
    return float(s.velocity("head:1")[0])


@dataclass(frozen=True)
class FlagellatedMetrics:
    """What the paper reports of its robot.

    Attributes
    ----------
    speed : float
        Forward speed v [m/s]: mean velocity of the head along its displacement, over whole motor turns.
    head_rpm, tail_rpm : float
        Speeds of rotation of head and tails [rpm], both positive.
    efficiency : float
        eta = 6 pi C1 mu a^2 v / (8 pi C2 mu a^3 omega_h) (paper, efficiency) [1].
    converged : bool
        Whether the last 10 motor turns drift by less than 0.1 %.
    drift : float
        Relative difference of the mean speed between the two halves of that window [1].
    turns : int
        Motor turns in the window.
    """

    speed: float = field(metadata={"unit": "m/s"})
    head_rpm: float = field(metadata={"unit": "rpm"})
    tail_rpm: float = field(metadata={"unit": "rpm"})
    efficiency: float = field(metadata={"unit": "1"})
    converged: bool
    drift: float = field(metadata={"unit": "1"})
    turns: int = field(metadata={"unit": "1"})


def flagellated_metrics(traj: Trajectory) -> FlagellatedMetrics:
    """Evaluate the last 10 motor turns (fewer if the run is shorter) of the paper's robot.

    Raises
    ------
    ParameterError
        If the trajectory is of another robot, or shorter than two motor turns, or the motor stands still.
    """
    robot = traj.robot
    names = set() if robot is None else {t.name for t in robot.terms}
    if robot is not None and "motor" in names and "head.C1" not in robot.parameters:
        raise ParameterError(
            "flagellated_metrics needs the drag of the head, a StokesHead with C1, C2 and radius called 'head', for "
            "the efficiency"
        )
    if robot is None or "head" not in traj.rods or "motor" not in names:
        raise ParameterError(
            "flagellated_metrics needs a trajectory of robots.flagellated (loaded with its robot)"
        )
    parameters = robot.parameters
    rpm = float(parameters["motor.rpm"].value) if "motor.rpm" in parameters else 0.0
    if rpm == 0.0:
        raise ParameterError("flagellated_metrics needs a motor that turns at a constant speed, motor.rpm")
    head = traj.rods["head"]
    position = traj.x[:, head.nodes[1]]
    rotor = traj.rods["shaft"].edges[0] if "shaft" in traj.rods else head.edges[1]
    shaft = traj.theta[:, head.edges[0]], traj.theta[:, rotor]
    period = 60.0 / abs(rpm)
    available = int((traj.t[-1] - traj.t[0]) / period + 1e-9)
    turns = min(10, available - available % 2)
    if turns < 2:
        raise ParameterError(f"the run is shorter than two motor turns of {period:g} s; run longer")
    # the middle of the window, so that both halves hold whole turns
    stop, start = traj.t[-1], traj.t[-1] - turns * period
    middle = 0.5 * (start + stop)
    at = lambda values, t: np.array([np.interp(t, traj.t, c) for c in np.atleast_2d(values.T)])  # noqa: E731
    first, half, last = (at(position, t) for t in (start, middle, stop))
    displacement = last - first
    distance = float(np.linalg.norm(displacement))
    axis = displacement / distance if distance > 0 else np.zeros(3)
    early, late = (float((b - a) @ axis) / (0.5 * (stop - start)) for a, b in ((first, half), (half, last)))
    speed = float(0.5 * (early + late))
    drift = float(abs(late - early) / abs(speed)) if speed else 0.0
    head_rpm, tail_rpm = (
        float(abs((at(a, stop) - at(a, start))[0]) / (stop - start) * 60.0 / (2.0 * np.pi)) for a in shaft
    )
    C1, C2, a = (parameters[f"head.{k}"].value for k in ("C1", "C2", "radius"))
    omega = head_rpm * 2.0 * np.pi / 60.0
    efficiency = 6.0 * C1 * speed / (8.0 * C2 * a * omega) if omega else 0.0
    return FlagellatedMetrics(
        speed, head_rpm, tail_rpm, float(efficiency), bool(turns >= 10 and drift < 1e-3), drift, turns
    )
