"""Checks for people who write terms and steppers, and the random robots they are run on.

`check_term` and `check_stepper` need nothing but NumPy; ``strategies`` needs hypothesis and is
loaded on first use.
"""

from __future__ import annotations

import importlib
from typing import Any

from rodnet.testing.check_in_robot import branched, check_in_robot
from rodnet.testing.check_stepper import check_stepper
from rodnet.testing.check_term import check_term
from rodnet.testing.figures import Drawing, Sketch, SketchRod, random_sketch
from rodnet.testing.report import ContractError, Report
from rodnet.testing.states import Probe, random_shape
from rodnet.testing.taylor import differences, taylor_slope

__all__ = [
    "ContractError",
    "Drawing",
    "Probe",
    "Report",
    "Sketch",
    "SketchRod",
    "branched",
    "check_in_robot",
    "check_stepper",
    "check_term",
    "differences",
    "random_shape",
    "random_sketch",
    "taylor_slope",
]


def __getattr__(name: str) -> Any:
    if name == "strategies":
        return importlib.import_module("rodnet.testing.strategies")
    raise AttributeError(f"module 'rodnet.testing' has no attribute {name!r}")
