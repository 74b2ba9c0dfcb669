"""A force of the surroundings that has no name and acts in one place: a thick spot, a pull."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from rodnet.compiled import kernel
from rodnet.terms.drag.local_flow import middle_along, width_of_patch
from rodnet.terms.drag.local_law import AXES, LocalLaw, _local_law


@kernel
def _local_patch(v, x, tangent, radius, t, p, f, dfdv, dfdtangent, dfdx):
    away = np.empty(3)
    for j in range(3):
        away[j] = x[j] - p[24 + j]
    _local_law(v, away, tangent, radius, t, p, f, dfdv, dfdtangent, dfdx)
    narrow = 1.0 / p[27] ** 2
    share = math.exp(-narrow * (away[0] ** 2 + away[1] ** 2 + away[2] ** 2))
    for i in range(3):
        f[i] *= share
        for j in range(3):
            dfdv[i, j] *= share
            dfdtangent[i, j] *= share
            dfdx[i, j] = dfdx[i, j] * share - 2.0 * narrow * away[j] * f[i]


class LocalPatch(LocalLaw):
    """A `LocalLaw` of the place from the middle c of a patch, times ``exp(-|x - c|^2 / width^2)``.

    No law of nature, but what a diagnosis describes by what acts in one place: mud is a negative ``linear``, a magnet a
    load ``gx`` with ``kxx``.

    Parameters
    ----------
    linear, along, ..., mz, creep : float or Parameter
        As of `LocalLaw`; places are counted from the middle.
    x, y, z : float or Parameter
        Middle c of the patch [m].
    width : float or Parameter
        Distance from the middle at which the force has faded to 1/e [m].
    """

    default_name = "local_patch"
    kernel: ClassVar[Any] = _local_patch
    example: ClassVar[dict[str, float]] = {
        **LocalLaw.example, "x": 0.05, "z": 0.02, "width": 0.1,
    }  # fmt: skip
    x, y, z = (middle_along(a) for a in AXES)
    width = width_of_patch()

    def shares(self, site: Any, rest: np.ndarray) -> np.ndarray:
        """As of `LocalLaw`; the ``rest``, creep [m/s], middle and width [m], has shape (n, 5)."""
        away = site.x - rest[:, 1:4]
        share = np.exp(-np.sum(away**2, axis=1) / rest[:, 4] ** 2)
        return share[:, None, None] * super().shares(replace(site, x=away), rest[:, :1])
