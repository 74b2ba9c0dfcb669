"""What recordings cannot tell, and which others would, in sentences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rodnet.diagnosis.library import LAW
from rodnet.diagnosis.verdict import visibly
from rodnet.numbers import number, percent
from rodnet.report.sentences import told as known

if TYPE_CHECKING:
    from rodnet.diagnosis.design import Proposal
    from rodnet.diagnosis.result import Diagnosis
    from rodnet.diagnosis.screen import Score

ALIKE = 0.98  # correlation of effects beyond which they are told as one
HIDDEN = 0.05  # share of an effect that a refit leaves, below which it is told as hidden
TRACE = 1e-4  # likewise, below which nothing is left


def untold(found: Diagnosis) -> list[str]:
    """What these recordings do not show, most important first."""
    told = [
        f"{path} of what was found: {known(value)}, and nothing more is known of it."
        for one in found.findings
        if one.id != LAW  # whose parts mean nothing by themselves
        for path, value in one.parameters.items()
        if any(value.open)
    ]
    if found.location is not None:
        share = float(np.mean([one.blind.mean() for one in found.location.trials]))
        told.append(f"Forces on {percent(share)} of body and time (hatched in the maps) do not show.")
    hidden = sorted(
        (s for s in found.screened if s.survives < HIDDEN or not visibly(s)), key=lambda s: s.survives
    )
    return told + [f"{s.candidate.title}: {_why_hidden(s)}." for s in hidden] + _alike(found)


def _why_hidden(score: Score) -> str:
    """Why an explanation does not show."""
    if score.survives == 0.0:
        return "it does nothing in these recordings, or what it does cannot be told"
    if score.survives < HIDDEN:
        all_but = f" but {percent(score.survives, '.2g')}" if score.survives > TRACE else ""
        return f"refitting the other parameters hides all{all_but} of it"
    return "it would show only at a strength that is hardly plausible (the smallest that would is in the table above)"


def _alike(found: Diagnosis) -> list[str]:
    """Pairs of explanations that look the same to first order, and that no refit has told apart."""
    one_class = [{f.id, *f.equivalents} for f in found.findings]
    refitted = {t.id for t in found.tried}
    pairs = [
        (float(found.isolability[i, j]), a.candidate, b.candidate)
        for i, a in enumerate(found.screened)
        for j, b in enumerate(found.screened[:i])
        if found.isolability[i, j] > ALIKE
        and (
            not {a.candidate.id, b.candidate.id} <= refitted
            or any({a.candidate.id, b.candidate.id} <= some for some in one_class)
        )
    ]
    return [
        f"{a.title}, and {b.title}: nearly the same effect here (correlation {number(r, '.3f')}, to first order)."
        for r, a, b in sorted(pairs, key=lambda one: -one[0])
    ]


def titled(proposal: Proposal, titles: Mapping[str, str]) -> Proposal:
    """A proposal with the titles of explanations in the place of their ids; trials are named as in the menu."""

    def name(told: str) -> str:
        """The title of ``ID`` or, of one in several places, of ``ID at PLACE``."""
        id, at, place = told.partition(" at ")
        return f"“{titles[id]}”{at}{place}" if id in titles else told

    between, left = (name(one) for one in proposal.between), ((name(a), name(b)) for a, b in proposal.left)
    return replace(proposal, between=tuple(between), left=tuple(left))
