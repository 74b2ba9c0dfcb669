"""rodnet: robots and structures made of thin rods, simulated, calibrated and diagnosed."""

from __future__ import annotations

import importlib
import sys
from typing import Any

# public name -> module; loaded on first use, so that `import rodnet` stays light
_HOME = {
    "Parameter": "parameters",
    "Material": "graph.material",
    "Section": "graph.material",
    "circular": "graph.material",
    "hollow": "graph.material",
    "elliptic": "graph.material",
    "Taper": "graph.rod_spec",
    "StickFigure": "graph.stick_figure",
    "RodGraph": "graph.rod_graph",
    "from_mesh": "importing.mesh",
    "from_lines": "importing.lines",
    "ImportedFigure": "importing.report",
    "ImportReport": "importing.report",
    "Robot": "robot",
    "Observer": "observer",
    "Simulation": "simulation",
    "StepResult": "steps",
    "Event": "events",
    "Trajectory": "trajectory",
    "State": "solve.steppers",
    "Stepper": "solve.steppers",
    "ImplicitEuler": "solve.steppers",
    "GeneralizedAlpha": "solve.steppers",
    "SDIRK2": "solve.steppers",
    "Tolerance": "solve.newton",
    "Adaptive": "solve.adaptive",
    "equilibrium": "solve.statics",
    "modes": "solve.modes",
    "Modes": "solve.modes",
    "critical_load": "solve.stability",
    "CriticalLoad": "solve.stability",
    "Term": "terms.base",
    "BoundTerm": "terms.base",
    "EnergyModel": "terms.energies",
    "Stretching": "terms.energies",
    "Bending": "terms.energies",
    "MidframeBending": "terms.midframe",
    "Twisting": "terms.energies",
    "JointElasticity": "terms.joints",
    "DragModel": "terms.drag.line",
    "kernel": "compiled",
    "ResistiveForce": "terms.drag.resistive",
    "StokesHead": "terms.drag.stokes",
    "GranularForce": "terms.drag.granular",
    "PowerLawForce": "terms.drag.nonlinear",
    "BinghamForce": "terms.drag.nonlinear",
    "PlaneWallForce": "terms.drag.walls",
    "TubeForce": "terms.drag.walls",
    "CrowdedForce": "terms.drag.crowding",
    "UniformFlow": "terms.drag.flow",
    "ShearFlow": "terms.drag.flow",
    "VortexFlow": "terms.drag.flow",
    "KelvinVoigt": "terms.dissipation",
    "MassDamping": "terms.dissipation",
    "DryFriction": "terms.friction",
    "stokes_resistance": "terms.drag.surface",
    "LoadModel": "terms.loads",
    "Gravity": "terms.loads",
    "PointForce": "terms.loads",
    "PointTorque": "terms.loads",
    "AddedMass": "terms.added_mass",
    "ConsistentMass": "terms.consistent_mass",
    "PlaneContact": "terms.contact.walls",
    "TubeContact": "terms.contact.walls",
    "RodContact": "terms.contact.rods",
    "FollowerForce": "terms.follower",
    "Actuator": "terms.actuators",
    "Motor": "terms.actuators",
    "DCMotor": "terms.drives",
    "SlowCurvature": "terms.drives",
    "CurvatureWave": "terms.actuators",
    "Tendon": "terms.tendons",
    "Constraint": "terms.constraints",
    "Clamp": "terms.constraints",
    "Hinge": "terms.constraints",
    "PrescribedMotion": "terms.constraints",
    "Grasp": "terms.constraints",
    "Slider": "terms.slider",
    "smooth_motion": "terms.motion",
    "smooth_rotation": "terms.motion",
    "term": "registry",
    "norm": "algebra",
    "dot": "algebra",
    "sensitivities": "tangent.sensitivities",
    "Sensitivities": "tangent.sensitivities",
    "sweep": "sweeps.driver",
    "SweepProgress": "sweeps.meter",
    "Recording": "recordings.recording",
    "read_recording": "recordings.files",
    "read_recordings": "recordings.files",
    "NoiseModel": "recordings.noise",
    "estimate_noise": "recordings.estimate",
    "Observation": "recordings.observation",
    "Markers": "recordings.observation",
    "HeadSpeed": "recordings.observation",
    "HeadAngle": "recordings.observation",
    "Reading": "recordings.observation",
    "EndForce": "recordings.end_force",
    "observe": "recordings.prediction",
    "inspect": "recordings.inspection",
    "Inspection": "recordings.inspection",
    "Case": "inference.case",
    "load_case": "inference.case",
    "calibrate": "inference.calibration",
    "CalibrationResult": "inference.result",
    "Fitted": "inference.fitted",
    "FittedValue": "inference.fitted",
    "evaluate": "inference.evaluate",
    "Evaluation": "inference.evaluate",
    "RodnetError": "errors",
    "GraphError": "errors",
    "MeshError": "errors",
    "ParameterError": "errors",
    "TermError": "errors",
    "OutputError": "errors",
    "RobotFileError": "errors",
    "SweepError": "errors",
    "NotCopyableError": "errors",
    "UnknownNameError": "errors",
    "PlausibilityWarning": "errors",
    "RecordingError": "errors",
    "CaseError": "errors",
    "StepTooLongError": "errors",
    "ConvergenceError": "errors",
    "FoldedStateError": "errors",
    "EquilibriumError": "errors",
    "SingularMatrixError": "errors",
    "RegistryError": "registry",
}
_MODULES = ("registry", "robots", "testing", "viz")

__version__ = "0.1.0"
__all__ = sorted([*_HOME, *_MODULES, "__version__"])


def __getattr__(name: str) -> Any:
    if name in _HOME:
        value = getattr(importlib.import_module(f"rodnet.{_HOME[name]}"), name)
    elif name in _MODULES:
        value = importlib.import_module(f"rodnet.{name}")
    else:
        # with these two, Python asks "did you mean ...?"
        raise AttributeError(
            f"module 'rodnet' has no attribute {name!r}", name=name, obj=sys.modules[__name__]
        )
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
