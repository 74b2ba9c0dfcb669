"""What a medium's drag may depend on beside the model's law: speed, place, direction, time, and its own flow."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from rodnet.errors import TermError
from rodnet.parameters import Parameter
from rodnet.terms.drag.change import Current, DragChange, ScaledDrag
from rodnet.terms.drag.changed import Laws, Slopes
from rodnet.terms.drag.flow import direction_of
from rodnet.terms.drag.line import LineSites
from rodnet.terms.local.stations import bump

SOURCE = "docs, theory: changes of a medium"
MEDIUM = {"eta_t": 1.0, "eta_n": 1.6}  # of examples
Factor = tuple[np.ndarray, np.ndarray | None, np.ndarray | None]


class PowerLawChange(ScaledDrag):
    """Drag that thins or thickens with the speed, (1 + (v/speed)^2)^((exponent - 1)/2) times the model's.

    The exponent is that of the force against the speed, where this is well above ``speed``: 1 is the
    model's law, less thins, more thickens. With a speed ``at`` it is the model's drag at that speed, not that at
    rest, that does not change: then what begins far below all speeds there are changes the exponent alone.

    Parameters
    ----------
    exponent : float or Parameter
        Exponent of the power law, over that of the model's law [1].
    speed : float or Parameter
        Where the power law begins [m/s].
    at : float, optional
        Speed at which the drag is that of the model [m/s]; by default at rest.

    Raises
    ------
    TermError
        If that is no speed.
    """

    default_name = "thinning"
    source = "Carreau 1972, as a function of the speed; docs, theory: changes of a medium"
    claims: ClassVar[set[str]] = {"objective"}
    example: ClassVar[dict[str, float]] = {"exponent": 0.6, "speed": 0.05, **MEDIUM}
    exponent = Parameter(1.0, unit="1", bounds=(0, 3), null=1.0, doc="exponent over the model's")
    speed = Parameter(1e-2, unit="m/s", bounds=(1e-12, None), kind="shape", doc="speed where it begins")

    def __init__(self, on: Any = "*", *, at: float = 0.0, **options: Any) -> None:
        super().__init__(on, **options)
        if not (np.isfinite(at) and at >= 0.0):
            raise TermError(f"PowerLawChange: at = {at!r} must be a speed [m/s], zero or more")
        self.at = float(at)

    def factor(self, site: LineSites, cells: np.ndarray, p: Any) -> Factor:
        """Relative change of the drag and its derivatives."""
        base = p.speed**2 + np.sum(site.v**2, axis=1, keepdims=True)
        power = 0.5 * (p.exponent - 1.0)
        g = (base / (p.speed**2 + self.at**2)) ** power
        return g - 1.0, 2.0 * power * g / base * site.v, None


class DragRegion(ScaledDrag):
    """Drag that is 1 + gain exp(-(s - place)^2 / (2 width^2)) times the model's: a rough, thick or clogged part.

    s runs from 0 to 1 along each rod.

    Parameters
    ----------
    gain : float or Parameter
        Relative change in the middle [1].
    place, width : float or Parameter
        Place and half width, over the rod's length [1].
    """

    default_name = "drag_region"
    source = SOURCE
    example: ClassVar[dict[str, float]] = {"gain": 0.7, "place": 0.4, "width": 0.2, **MEDIUM}
    gain = Parameter(0.0, unit="1", bounds=(-1, None), null=0.0, doc="relative change in the middle")
    place = Parameter(0.5, unit="1", bounds=(0.0, 1.0), kind="shape", doc="middle, over the rod's length")
    width = Parameter(
        0.1, unit="1", bounds=(1e-3, 1.0), kind="shape", doc="half width, over the rod's length"
    )

    def factor(self, site: LineSites, cells: np.ndarray, p: Any) -> Factor:
        """Relative change of the drag and its derivatives."""
        return p.gain * bump(cells, p.place, p.width)[:, None], None, None


class DragGradient(ScaledDrag):
    """Drag that changes through space, 1 + gradient (direction . x - level) times the model's: with depth, as a rule.

    So does the pressure among grains; where it would be below zero, there is no medium and no drag.

    Parameters
    ----------
    direction : (3,)
        In which it grows; by default down.
    gradient : float or Parameter
        Relative change per length [1/m].
    level : float or Parameter
        Where, along the direction, the drag is the model's [m].
    """

    default_name = "depth"
    source = SOURCE
    claims: ClassVar[set[str]] = set()
    example: ClassVar[dict[str, float]] = {"gradient": 8.0, "level": 0.01, **MEDIUM}
    gradient = Parameter(0.0, unit="1/m", null=0.0, doc="relative change per length")
    level = Parameter(0.0, unit="m", kind="shape", doc="where the drag is the model's")

    def __init__(self, on: Any = "*", *, direction: Any = (0.0, 0.0, -1.0), **options: Any) -> None:
        super().__init__(on, **options)
        self.direction = direction_of("DragGradient: direction", direction)

    def factor(self, site: LineSites, cells: np.ndarray, p: Any) -> Factor:
        """Relative change of the drag and its derivatives."""
        g = p.gradient * (site.x @ self.direction - p.level)[:, None]
        return np.maximum(g, -1.0), None, np.where(g > -1.0, p.gradient, 0.0) * self.direction


class WallDrag(ScaledDrag):
    """Drag that grows towards a plane wall, 1 + reach / gap times the model's, where gap = normal . x - position.

    That is how drag of anything falls off with its distance from a wall that a viscous fluid sticks to, farther away
    from it than its own size; nearer, `PlaneWallForce` is a theory. Next to the wall, and behind it, ``near`` stands
    instead of the gap: near + (u + (u^2 + near^2)^0.5) / 2 with u = gap - near, which far away is the gap.

    Parameters
    ----------
    normal : (3,)
        Direction away from the wall; by default up, from a floor.
    reach : float or Parameter
        Distance at which the wall doubles the drag [m].
    position : float or Parameter
        Where the wall is along the normal [m].
    near : float or Parameter
        Distance from it within which the drag grows no more [m].
    """

    default_name = "wall_drag"
    source = "Brenner 1962, J. Fluid Mech. 12, 35 (far from walls); docs, theory: changes of a medium"
    claims: ClassVar[set[str]] = set()
    example: ClassVar[dict[str, float]] = {"reach": 0.02, "position": -0.03, "near": 0.001, **MEDIUM}
    reach = Parameter(
        0.0, unit="m", bounds=(0, None), null=0.0, doc="distance at which the wall doubles the drag"
    )
    position = Parameter(0.0, unit="m", kind="shape", doc="place of the wall along its normal")
    near = Parameter(
        1e-3, unit="m", bounds=(1e-9, None), kind="shape", doc="distance that the gap does not go below"
    )

    def __init__(self, on: Any = "*", *, normal: Any = (0.0, 0.0, 1.0), **options: Any) -> None:
        super().__init__(on, **options)
        self.normal = direction_of("WallDrag: normal", normal)

    def factor(self, site: LineSites, cells: np.ndarray, p: Any) -> Factor:
        """Relative change of the drag and its derivatives."""
        u = (site.x @ self.normal - p.position)[:, None] - p.near
        root = np.hypot(u, p.near)
        h = p.near + 0.5 * (u + root)
        return p.reach / h, None, -0.5 * p.reach / h**2 * (1.0 + u / root) * self.normal


class SwitchedDrag(ScaledDrag):
    """Drag that changes at a time, 1 + gain / (1 + exp(-(t - onset)/ramp)) times the model's: a medium that jams.

    Parameters
    ----------
    gain : float or Parameter
        Relative change afterwards [1].
    onset, ramp : float or Parameter
        When, and how gradually [s].
    """

    default_name = "switched"
    source = SOURCE
    example: ClassVar[dict[str, float]] = {"gain": 1.5, "onset": 0.0, "ramp": 0.1, **MEDIUM}
    gain = Parameter(0.0, unit="1", bounds=(-1, None), null=0.0, doc="relative change afterwards")
    onset = Parameter(1.0, unit="s", kind="shape", doc="when")
    ramp = Parameter(0.1, unit="s", bounds=(1e-6, None), kind="shape", doc="how gradually")

    def factor(self, site: LineSites, cells: np.ndarray, p: Any) -> Factor:
        """Relative change of the drag and its derivatives."""
        share = 0.5 * (1.0 + np.tanh(0.5 * (site.t - p.onset) / p.ramp))
        return np.full((len(site.v), 1), p.gain * share), None, None


class DragAnisotropy(DragChange):
    """Drag along rods that is 1 + along times the model's, while that across them stays.

    Parameters
    ----------
    along : float or Parameter
        Relative change of the drag along [1].
    """

    default_name = "anisotropy"
    source = SOURCE
    claims: ClassVar[set[str]] = {"dissipative", "objective"}
    example: ClassVar[dict[str, float]] = {"along": 0.6, **MEDIUM}
    along = Parameter(0.0, unit="1", bounds=(-1, None), null=0.0, doc="relative change of the drag along")

    def change(
        self, laws: Laws, site: LineSites, cells: np.ndarray, p: Any, slopes: bool
    ) -> tuple[np.ndarray, Slopes]:
        """Force per length [N/m] that comes on top, shape (n, 3), and its derivatives."""
        force, t = laws.force(site), site.tangent
        size = np.sum(force * t, axis=1, keepdims=True)
        if not slopes:
            return p.along * size * t, {}
        project = t[:, :, None] * t[:, None, :]
        found = {key: p.along * project @ slope for key, slope in laws.slopes(site).items()}
        turned = size[:, :, None] * np.eye(3) + t[:, :, None] * force[:, None, :]
        found["tangent"] = found["tangent"] + p.along * turned
        return p.along * size * t, found


class BackgroundFlow(Current):
    """A current of the medium: the model's laws at the velocity against it, less those at rest.

    Parameters
    ----------
    u_x, u_y, u_z : float or Parameter
        Velocity of the medium [m/s].
    """

    default_name = "flow"
    source = SOURCE
    claims: ClassVar[set[str]] = set()
    example: ClassVar[dict[str, float]] = {"u_x": 0.05, "u_y": -0.1, "u_z": 0.08, **MEDIUM}
    u_x = Parameter(0.0, unit="m/s", null=0.0, doc="current along x")
    u_y = Parameter(0.0, unit="m/s", null=0.0, doc="current along y")
    u_z = Parameter(0.0, unit="m/s", null=0.0, doc="current along z")

    def coefficients(self, p: Any) -> np.ndarray:
        """Values of U, and zeros, shape (24,)."""
        return np.array([p.u_x, p.u_y, p.u_z] + 21 * [0.0])
