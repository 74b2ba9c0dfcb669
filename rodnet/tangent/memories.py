"""Which memories of laws the tangent follows by itself, and what follows each."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rodnet.tangent.crowds import CrowdTangent
from rodnet.tangent.droop import motor_tangent
from rodnet.tangent.motors import MotorTangent
from rodnet.tangent.remembered import SpringMemoryTangent
from rodnet.tangent.remembered_media import MediumTangent
from rodnet.tangent.remembered_places import PlaceMemoryTangent
from rodnet.tangent.tendons import TendonTangent
from rodnet.terms.drag.crowding import _BoundCrowded
from rodnet.terms.driven_curvature import _BoundCurvature
from rodnet.terms.joints import _BoundJoints

if TYPE_CHECKING:
    from rodnet.solve.model import Model
    from rodnet.tangent.variation import Variation

Memory = (
    MotorTangent | SpringMemoryTangent | PlaceMemoryTangent | MediumTangent | TendonTangent | CrowdTangent
)


def memories(model: Model, columns: list[Variation]) -> dict[int, Memory]:
    """By number of the bound term what knows how its memory changes, motors first: others ask what these turn."""
    bound = list(enumerate(model.bound))
    found: dict[int, Memory] = {
        k: kind(model, k) for k, b in bound if (kind := motor_tangent(model, b)) is not None
    }
    motors = [m for m in found.values() if isinstance(m, MotorTangent)]
    for k, b in bound:
        if SpringMemoryTangent.knows(model, b):
            found[k] = SpringMemoryTangent(model, k, motors)
        elif PlaceMemoryTangent.knows(b):
            found[k] = PlaceMemoryTangent(model, k)
        elif MediumTangent.knows(b):
            found[k] = MediumTangent(model, k, columns)
        elif TendonTangent.knows(model, b):
            found[k] = TendonTangent(model, k)
        elif isinstance(b, _BoundCrowded):
            found[k] = CrowdTangent(model, k, columns)
    return found


def followed(model: Model) -> set[int]:
    """Numbers of the bound terms that remember something, of which it is known here how it changes, that it acts on
    nothing, or that it hears of no motion.
    """
    return {
        k
        for k, b in enumerate(model.bound)
        if motor_tangent(model, b) is not None
        or SpringMemoryTangent.knows(model, b)
        or PlaceMemoryTangent.knows(b)
        or MediumTangent.knows(b)
        or TendonTangent.knows(model, b)
        or isinstance(b, _BoundCrowded | _BoundJoints | _BoundCurvature)
    }
