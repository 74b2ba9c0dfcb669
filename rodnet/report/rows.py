"""Rows of the tables of explanations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.numbers import chance
from rodnet.report.sentences import MANY

if TYPE_CHECKING:
    from rodnet.diagnosis.result import Diagnosis
    from rodnet.diagnosis.screen import Score


def smallest(score: Score, units: dict[str, str]) -> list[tuple[str, str, Any, str]]:
    """Rows for an explanation; of one with many strengths that which shows best."""
    title, seen = score.candidate.title, score.detectable
    if len(seen) > MANY:
        best = min(seen, key=lambda p: seen[p] / score.scales[p])
        shown = (
            (seen[best], unit_of(units.get(best, "1"))) if np.isfinite(seen[best]) else ("would not show", "")
        )
        return [(title, f"{len(seen)} strengths, the clearest", *shown)]
    own = f"{score.candidate.id}."
    return [
        (
            title,
            p.removeprefix(own),
            *((v, unit_of(units.get(p, "1"))) if np.isfinite(v) else ("would not show", "")),
        )
        for p, v in seen.items()
    ]


def ranked(found: Diagnosis, score: Score) -> tuple[Any, ...]:
    """An explanation: what it scores, what it gained, and what became of it."""
    hits = [t for t in found.tried if t.id == score.candidate.id]
    first = hits[0] if hits else None
    named = next((f for f in found.findings if f.id == score.candidate.id), None)
    same = [f.id for f in found.findings if score.candidate.id in f.equivalents]
    gain, crossed = (None, None) if first is None else (first.gain, first.cross_gain)
    if named is not None:  # beside the other effects
        word, gain, crossed = named.status, named.gain, named.cross_gain
    elif same:
        word = f"as good as {same[0]}"
    else:
        refused = bool(hits) and not any(t.accepted for t in hits)
        word = "refused" if refused else "not needed" if hits else "not refitted"
    return (
        score.candidate.title, score.chi2, chance(score.p, ".3g"), None if gain is None else 0.5 * gain,
        None if crossed is None else 0.5 * crossed, word,
    )  # fmt: skip


def unit_of(unit: str) -> str:
    """A unit as a table has it: shares have none."""
    return "" if unit == "1" else unit
