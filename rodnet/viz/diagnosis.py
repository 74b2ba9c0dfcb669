"""A diagnosis for the rerun viewer: measured and predicted shapes, before and after, and the missing force."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import ParameterError
from rodnet.recordings.observation import Markers
from rodnet.viz.file_names import file_names
from rodnet.viz.forces import LONGEST, scale_text
from rodnet.viz.rerun_log import FORCE, MEASURED, SERIES, SOFT, Log

if TYPE_CHECKING:
    from rodnet.diagnosis.locate import TrialLocation
    from rodnet.diagnosis.motion import Motion
    from rodnet.diagnosis.result import Diagnosis
    from rodnet.graph.rod_graph import RodGraph

FILE = "diagnosis.rrd"
AFTER = SERIES[3]


def log_diagnosis(found: Diagnosis, path: str | Path) -> Path:
    """Write the trials of a diagnosis for the rerun viewer (``rodnet view FILE.rrd``).

    Of every trial that was looked at, in its own branch ``robot/TRIAL``: the markers as measured
    (``measured``) and as predicted by the model as it is and by the repaired one (``predicted_before``,
    ``predicted_after``), the body of either (``before``, ``after``), and the force per length that the model as it
    is lacks, as arrows on its body (``residual_force``). Distances of the markers over time are plots. The first
    trial is shown at the start.

    Raises
    ------
    ParameterError
        If the force was not located.
    OutputError
        If the file cannot be written.
    """
    if found.location is None:
        raise ParameterError(
            "log_diagnosis: the force on the body was not located, so there is nothing to show"
        )
    trials = found.location.trials
    case = found.case
    rec = case.part(found.recordings[trials[0].number])
    graph = case.robot(rec).graph
    size = float(graph.size)
    strongest = max(float(np.linalg.norm(one.mean, axis=2).max()) for one in trials)
    scale = LONGEST * size / strongest if strongest > 0.0 else 0.0
    hidden: list[str] = []
    plots: dict[str, str] = {}
    with Log(path, "diagnosis") as log:
        for name, one in zip(file_names(one.name for one in trials), trials, strict=True):
            shown = _log_trial(log, found, one, graph, name, size, scale)
            plots[f"{one.name}: distance [mm]"] = f"/distance/{name}"
            if one is not trials[0]:
                hidden += shown
        arrows = f", {scale_text(scale, size)} per metre of body" if scale else ""
        log.about(
            f"**Diagnosis of '{found.case.name}'**: {found.verdict}\n\n**Blue**: measured. **Orange**: the model as it "
            "is. **Purple**: the repaired model. **Green arrows**: the force that the model as it is lacks"
            f"{arrows}.\n\n"
            f"Trials: {', '.join(one.name for one in trials)}; all but the first are there to be switched on."
        )
        log.blueprint(
            plots, trials[0].motion.x.reshape(-1, 3), title="measured, before, after", hidden=hidden
        )
    return log.path


def _log_trial(
    log: Log, found: Diagnosis, one: TrialLocation, graph: RodGraph, name: str, size: float, scale: float
) -> list[str]:
    """One trial; return its entities."""
    root = f"robot/{name}"
    shown = _log_markers(log, found, one, name, size)
    for label, motion, color in (("before", one.motion, SOFT), ("after", one.after, AFTER)):
        if motion is None:
            continue
        columns = log.times(motion.t)
        for rod in graph.rods.values():
            radius = min(float(np.median(graph.radius[rod.edges])), size / 60)
            shown.append(f"{root}/{label}/{rod.name}")
            log.strips(shown[-1], columns, motion.x[:, rod.nodes], radius, color)
    if scale:
        shown.append(f"{root}/residual_force")
        at, force = _arrows(one, one.motion, graph)
        log.arrows(shown[-1], log.times(one.motion.t), at, scale * force, FORCE, size / 350)
    return shown


def _arrows(one: TrialLocation, motion: Motion, graph: RodGraph) -> tuple[np.ndarray, np.ndarray]:
    """Places on the moving body, and forces per length there, shapes (F, B, 3)."""
    places = []
    for name, place in zip(one.hats.rods, one.hats.places, strict=True):
        nodes = graph.rods[name].nodes
        at = place * (len(nodes) - 1)
        k = min(int(at), len(nodes) - 2)
        places.append((1.0 - at + k) * motion.x[:, nodes[k]] + (at - k) * motion.x[:, nodes[k + 1]])
    over = np.stack([one.hats.at(t) for t in motion.t])
    return np.stack(places, axis=1), np.einsum("ft,bta->fba", over, one.mean)


def _log_markers(log: Log, found: Diagnosis, one: TrialLocation, name: str, size: float) -> list[str]:
    rec = found.case.part(found.recordings[one.number])
    eyes = found.case.observations(rec, found.case.robot(rec))
    number = next((k for k, eye in enumerate(eyes) if isinstance(eye, Markers)), None)
    if number is None:
        return []
    eye: Any = eyes[number]
    before, after = found.base.fits[one.number], found.model.fits[one.number]
    columns = log.times(rec.t - rec.t[0])
    shown = []
    for label, values, color in (
        ("measured", before.measured[number], MEASURED),
        ("predicted_before", before.predicted[number], SOFT),
        ("predicted_after", after.predicted[number], AFTER),
    ):
        places = np.zeros((*values.shape[:2], 3))
        places[:, :, eye.axes] = values
        shown.append(f"robot/{name}/{label}")
        log.points(shown[-1], columns, places, size / 150, color)
    for label, fit, color in (("before", before, SOFT), ("after", after, AFTER)):
        far = 1e3 * np.linalg.norm(fit.predicted[number] - fit.measured[number], axis=2)
        seen = np.isfinite(far)
        mean = np.where(seen, far, 0.0).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
        mean = np.where(seen.any(axis=1), mean, np.nan)
        log.series(f"distance/{name}/{label}", columns, mean, f"{one.name}, {label}", color)
    return shown
