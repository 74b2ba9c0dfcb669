"""Place, time and regime in a diagnosis: found once it is there, and told with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from threadpoolctl import threadpool_limits

from rodnet.diagnosis.library import LAW
from rodnet.diagnosis.locate import Location, locate, strongest, with_repair
from rodnet.diagnosis.regimes import Regime, find_regime
from rodnet.diagnosis.stage_files import FAILURES

if TYPE_CHECKING:
    from rodnet.diagnosis.findings import Finding
    from rodnet.diagnosis.result import Diagnosis
    from rodnet.diagnosis.screen import Score
    from rodnet.diagnosis.stage_files import Stages
    from rodnet.diagnosis.workbench import Fitted, Workbench

# what the laws of the bank depend on, by family
LAWS = {
    "yield": "speed", "medium-friction": "speed", "power-law": "speed", "dry-friction": "speed",
    "depth": "depth", "wall": "depth", "obstacle": "depth", "jam-onset": "time", "neighbours": "spacing",
    "nonlinear-elasticity": "curvature", "plastic-set": "curvature",
}  # fmt: skip
UP_OR_DOWN = ("+z", "-z")
WORDS = {
    "place": "it depends on how near that side is",
    "speed": "its law depends on the speed", "depth": "its law depends on the depth",
    "time": "it begins at a time", "spacing": "its law depends on how near other parts are",
    "curvature": "its law depends on the curvature",
}  # fmt: skip


def located(bench: Workbench, found: Diagnosis, stage: Stages, anew: bool = False) -> Diagnosis:
    """Return the diagnosis with place, time and regime of what the model as it is leaves.

    ``anew`` if it is one beside another numerical error than when the bank was scored: its scores are not of it.
    """
    try:
        location, regime = stage("location", _find, bench, found.base, found.screened, found.model, anew)
    except FAILURES as error:  # the verdict stands without it
        bench.tell(f"the force on the body cannot be located: {error}")
        return found
    return replace(found, location=location, regime=regime)


def _find(
    bench: Workbench, base: Fitted, scores: list[Score], model: Fitted, anew: bool
) -> tuple[Location | None, Regime | None]:
    with threadpool_limits(1):  # of small matrices
        location = locate(bench, base, scores, anew=anew)
        regime = None if location is None else find_regime(location)
    if location is not None and model.candidates:
        location = with_repair(bench, location, model)
    return location, regime


def regime_of(finding: Finding, regime: Regime | None) -> tuple[str | None, str]:
    """The regime of a finding, and how it is known: from its own law, else from the force that was missing."""
    if finding.when is not None:
        return "time", WORDS["time"]
    if finding.id == LAW:
        return None, "as its parts say"
    kind = LAWS.get(finding.family) or _declared(finding.family)
    if kind == "depth" and finding.on and finding.on not in UP_OR_DOWN:  # a wall or an obstacle at a side
        kind = "place"
    if kind:
        return kind, WORDS[kind]
    if regime is not None and regime.variable and finding.at is None:
        return regime.variable, regime.words
    return None, "at any speed and time"


def _declared(family: str) -> str:
    """What the law of a plug-in says that it depends on; empty if it says nothing."""
    from rodnet import registry

    record = registry.terms().get(family)
    regime = str(getattr(record.object, "regime", "")) if record is not None else ""
    return regime if regime in WORDS else ""


def tell(told: dict[str, Any], found: Diagnosis) -> dict[str, Any]:
    """Add place, time and regime to what ``diagnosis.json`` holds."""
    for term, finding in zip(told["terms"], found.findings, strict=False):
        term["regime"], term["regime_words"] = regime_of(finding, found.regime)
        if term["when"] is None and found.regime is not None and term["regime"] == "time":
            term["when"] = found.regime.onset
    told["regime"] = None if found.regime is None else vars(found.regime)
    told["location"] = None if found.location is None else _location(found.location)
    return told


def _location(location: Location) -> Mapping[str, Any]:
    return {
        "channels": {
            name: {"nats": nats, "share": location.shares[name]} for name, nats in location.evidence.items()
        },
        "explained": location.explained, "prior": location.prior, "unit": "N/m",
        "trials": [
            {
                "name": one.name, "rod": one.hats.rods[b], "place": one.hats.places[b],
                "time": one.hats.times[t], "force": one.mean[b, t].tolist(), "sd": one.sd[b, t].tolist(),
                "score": float(one.score[b, t]), "blind": float(one.blind.mean()),
                "own": {path: list(pair) for path, pair in one.own.items()},
            }
            for one, b, t in strongest(location)
        ],
    }  # fmt: skip
