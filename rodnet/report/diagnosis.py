"""The page of a diagnosis: what is missing, where, how sure; before and after; what else explains it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.diagnosis.told import regime_of
from rodnet.errors import RodnetError
from rodnet.report.figures import before_after, force_maps
from rodnet.report.page import Page

if TYPE_CHECKING:
    from rodnet.diagnosis.findings import Diagnosis, Finding, Interval
    from rodnet.diagnosis.locate import Location
    from rodnet.diagnosis.screen import Score

SHOWN = 12  # rows of rankings
STANDS_OUT = 3.0  # [sd] of a force beyond which it is told
NATS = 3.0  # of a channel, likewise
ALIKE = 0.98  # correlation of effects beyond which they are told as one
HIDDEN = 0.05  # share of an effect that a refit leaves, below which it is told as hidden
VERDICTS = {
    "none": "Nothing is missing that these recordings could show.",
    "named": "The model leaves out:",
    "partial": "The model leaves out what is named here, and something else that is not:",
    "class": "The model leaves something out; these explanations cannot be told apart by these recordings:",
    "surrogate": "Something is missing. What is found here stands in for it; it is not its name.",
    "unresolved-numerics": "The time step or the mesh is too coarse to say anything: refine them first.",
    "unidentifiable": "These recordings cannot tell.",
}
CHANNELS = {
    "force": "a force on the body", "drive": "what drives or holds it", "camera": "the camera or the clock",
}  # fmt: skip


def diagnosis_page(found: Diagnosis) -> Page:
    """Return the page of a diagnosis."""
    page = Page(f"Diagnosis of '{found.case.name}'")
    page.text(summary(found), "verdict")
    _missing(page, found)
    _where(page, found)
    _what(page, found)
    _alike(page, found)
    _proof(page, found)
    _left(page, found)
    _unknown(page, found)
    return page


def summary(found: Diagnosis) -> str:
    """The verdict in a few sentences."""
    text = [VERDICTS[found.verdict]]
    text += [f"{one.title}{_place(one)}, {_strengths(one)};" for one in found.findings]
    if found.held is not None and found.findings:
        share = found.explained_fraction
        removed = (
            "" if share is None else f", which removes {100 * min(share, 1.0):.0f} % of what is not noise"
        )
        before, after = found.held.before.error, found.held.after.error
        text.append(
            f"on trials held out the error falls from {_length(before)} to {_length(after)}{removed}."
        )
    elif found.findings:
        text[-1] = text[-1].removesuffix(";") + "."
    if found.verdict == "none":
        text.append(f"What the model leaves is what the noise would leave (p = {found.remainder.p:.2g}).")
    return " ".join(text)


def _strengths(one: Finding) -> str:
    return ", ".join(f"{p.rsplit('.', 1)[1]} {_value(one.parameters[p])}" for p in one.strength)


def _value(v: Interval) -> str:
    unit = "" if v.unit == "1" else f" {v.unit}"
    return f"{v.value:.3g} ({v.low:.3g} to {v.high:.3g}){unit}"


def _place(one: Finding) -> str:
    text = f" on {one.on}" if one.on and one.on not in one.title else ""
    if one.at is not None:
        text += f" at {one.at.value:.2f} of its length ({one.at.low:.2f} to {one.at.high:.2f})"
    if one.when is not None:
        text += f", from {one.when.value:.2f} s on ({one.when.low:.2f} to {one.when.high:.2f})"
    return text


def _length(value: float) -> str:
    return f"{1e3 * value:.3g} mm" if value < 0.1 else f"{value:.3g} m"


def _chance(p: float) -> str:
    return "less than one in a billion" if p < 1e-9 else f"{p:.2g}"


# -- is anything missing ----------------------------------------------------------------------------
def _missing(page: Page, found: Diagnosis) -> None:
    page.heading("Is anything missing?")
    page.text(_sure(found), "lead")
    base = found.base
    rms = np.sqrt(sum(float(f.residual @ f.residual) for f in base.fits) / base.samples)
    page.text(
        f"The calibrated model as it is leaves {rms:.3g} times the noise, over {base.samples} numbers of "
        f"{len(base.fits)} trials. {len(found.screened)} explanations were scored at "
        f"{sum(s.tried for s in found.screened)} places, {len(found.tried)} refitted; every probability here counts "
        "all that was tried."
    )
    units = _units(found)
    page.text("The smallest effect of each kind that these recordings would have shown:")
    page.table(
        ("explanation", "parameter", "smallest", "unit"),
        [
            (s.candidate.title, p.removeprefix(f"{s.candidate.id}."), v, units.get(p, ""))
            for s in found.screened[:SHOWN] for p, v in s.detectable.items()
        ],
    )  # fmt: skip


def _units(found: Diagnosis) -> dict[str, str]:
    """Units of what the explanations are described by, where there are any."""
    rec = found.case.part(found.recordings[0])
    robot = found.case.robot(rec)
    instruments = found.case.observations(rec, robot)
    units: dict[str, str] = {}
    for score in found.screened[:SHOWN]:
        try:
            built = score.candidate.build(robot)
            known = {} if built is None else score.candidate.parameters(built, instruments)
        except RodnetError:
            continue
        units |= {path: "" if p.unit == "1" else p.unit for path, p in known.items()}
    return units


def _sure(found: Diagnosis) -> str:
    """Whether anything is missing, and how sure that is."""
    if found.verdict == "unresolved-numerics":
        worst = found.numerics.worst
        return (
            f"It cannot be said: the time step and the mesh alone change the prediction by {worst:.2g} sigma."
        )
    chance = min([s.p for s in found.screened], default=1.0)
    if found.verdict == "none":
        return f"No. The best explanation of all would look as good by chance with a probability of {_chance(chance)}."
    if found.findings:
        best = found.findings[0]
        trials = sum(g > 0.0 for g in best.gains)
        return (
            f"Yes. The probability that chance alone would gain as much is {_chance(best.p)}, and "
            f"{trials} of {len(best.gains)} trials, each left out in turn, are predicted better with it than without."
        )
    left = found.remainder
    return (
        f"Yes: what is left is too smooth for noise (probability {_chance(left.p)}), but nothing that was tried "
        "explains it."
    )


# -- where and when ---------------------------------------------------------------------------------
def _where(page: Page, found: Diagnosis) -> None:
    page.heading("Where, when, and in which regime?")
    if found.findings:
        page.items(f"{one.title}{_place(one)}: {regime_of(one, found.regime)[1]}." for one in found.findings)
    if found.location is None:
        page.text("The force that is missing could not be located over body and time.")
        return
    location = found.location
    page.text(_channels(location))
    if found.regime is not None:
        page.text(f"Its regime: {found.regime.words}.")
    if location.evidence["force"] > NATS:
        page.items(_spots(location))
    page.figures(
        force_maps(location),
        "The force per length that the model as it is lacks, over its posterior standard deviation: beyond 3 it is "
        "not chance. Hatched: a force that matters would not be seen there. Blue arrows: markers. A map shows where "
        "to look; a soft spot shows as forces beside it, and the place with an interval is that of the refitted "
        "explanation.",
    )


def _channels(location: Location) -> str:
    """Whether it is a force on the body, or an error of what drives or films it."""
    loud = {name: nats for name, nats in location.evidence.items() if nats > NATS}
    if not loud:
        return (
            "A force without a law, free over body and time, does not stand out of the noise, nor does an error of "
            "drive or camera: with so many freedoms it takes a larger mismatch than a single explanation does."
        )
    parts = [
        f"{CHANNELS[name]} ({100.0 * location.shares[name]:.0f} %, {nats:.3g} nats)"
        for name, nats in sorted(loud.items(), key=lambda item: -location.shares[item[0]])
    ]
    text = f"To first order, what the model leaves looks like {' and '.join(parts)}"
    quiet = [CHANNELS[name] for name in location.evidence if name not in loud]
    return text + (f", not like {' or '.join(quiet)}." if quiet else ".")


def _spots(location: Location) -> list[str]:
    """The strongest force of each trial, if it stands out."""
    from rodnet.diagnosis.locate import strongest

    found = []
    most = max(float(one.score.max()) for one in location.trials)
    if most < STANDS_OUT:
        return [
            f"No single place and time stands out: it is spread over both ({most:.1f} standard deviations at most)."
        ]
    for one, b, t in strongest(location):
        if one.score[b, t] < STANDS_OUT:
            found.append(
                f"{one.name}: no single place stands out ({one.score[b, t]:.1f} standard deviations at most)."
            )
            continue
        size, sd = np.linalg.norm(one.mean[b, t]), float(np.linalg.norm(one.mean[b, t]) / one.score[b, t])
        found.append(
            f"{one.name}: strongest at {one.hats.places[b]:.2f} of {one.hats.rods[b]}, about "
            f"{one.hats.times[t]:.2g} s: {size:.2g} ± {sd:.1g} N/m, {one.score[b, t]:.1f} standard deviations."
        )
    return found


# -- what -------------------------------------------------------------------------------------------
def _what(page: Page, found: Diagnosis) -> None:
    from rodnet.diagnosis import findings

    page.heading("What is it?")
    if not found.findings:
        page.text("Nothing that was tried was accepted.", "lead")
    for one in found.findings:
        page.text(f"{one.title}{_place(one)}.", "lead")
        page.table(
            ("parameter", "value", f"{100 * findings.LEVEL:.0f} % from", "to", "unit"),
            [(p.rpartition(".")[2], v.value, v.low, v.high, v.unit) for p, v in one.parameters.items()],
        )
        page.text(
            f"It changes the prediction by {one.effect_sigma:.2g} sigma after the other parameters are refitted, and "
            f"gains {0.5 * one.cross_gain:.3g} nats on trials left out. If it is so: {one.falsifier}."
        )
    page.text("How the explanations rank:")
    page.table(
        ("explanation", "score (chi²)", "chance", "gain of a refit", "on trials left out", "verdict"),
        [_ranked(found, s) for s in found.screened[:SHOWN]],
    )
    page.folded(
        "Why others were not accepted",
        (f"{t.id}, round {t.round + 1}: {'; '.join(t.reasons)}." for t in found.tried if not t.accepted),
    )


def _ranked(found: Diagnosis, score: Score) -> tuple[Any, ...]:
    hits = [t for t in found.tried if t.id == score.candidate.id]
    first = hits[0] if hits else None
    named = next((f for f in found.findings if f.id == score.candidate.id), None)
    same = [f.id for f in found.findings if score.candidate.id in f.equivalents]
    if named is not None:
        word = named.status
    elif same:
        word = f"as good as {same[0]}"
    else:
        word = "refused" if hits else "–"
    return (
        score.candidate.title, score.chi2, score.p, None if first is None else first.gain,
        None if first is None else first.cross_gain, word,
    )  # fmt: skip


def _alike(page: Page, found: Diagnosis) -> None:
    page.heading("What explains it as well, and which experiment would tell?")
    classes = [one for one in found.findings if one.equivalents]
    titles = {s.candidate.id: s.candidate.title for s in found.screened}
    if classes:
        page.items(
            f"{one.title} is explained as well by: {', '.join(titles.get(e, e) for e in one.equivalents)}."
            for one in classes
        )
        page.items(f"{p.sentence[0].upper()}{p.sentence[1:]}." for p in found.proposals)
        if not found.proposals:
            page.text("The case has no menu of drives (drives) to choose the next trial from.", "note")
    elif found.findings:
        page.text("Nothing else that was tried explains these recordings as well.", "lead")
    else:
        page.text("There is no explanation that others would have to be told from.")
    count = min(len(found.screened), SHOWN)
    if count > 1:
        page.matrix(
            [s.candidate.title for s in found.screened[:count]], found.isolability[:count, :count],
            "How much alike two effects look on these recordings once the other parameters are refitted: 1 is the "
            "same, 0 has nothing in common.",
        )  # fmt: skip


# -- proof ------------------------------------------------------------------------------------------
def _proof(page: Page, found: Diagnosis) -> None:
    page.heading("Before and after, on trials held out")
    if found.held is None:
        page.text("No trials were held out, so nothing is shown here.")
        return
    placebo, share = found.placebo_after(), found.explained_fraction
    if found.findings and share is not None:
        page.text(
            f"The repaired model removes {100 * min(share, 1.0):.0f} % of the squared error beyond the noise.",
            "lead",
        )
    rows = [
        ("model as it is", 1e3 * found.held.before.error, found.held.before.sigma),
        ("repaired model", 1e3 * found.held.after.error, found.held.after.sigma),
        ("placebo", *((1e3 * placebo[0], placebo[1]) if placebo else (None, None))),
        ("noise alone", None if found.floor is None else 1e3 * found.floor, 1.0),
    ]
    page.table(("model", "rms distance [mm]", "in sigma"), rows)
    page.text(
        "The placebo is the best of as many random smooth forces as explanations were tried, with as many free "
        f"parameters, fitted by the same rule. "
        f"Trials held out were opened {found.openings} times in this run.",
        "note",
    )
    page.figures(before_after(found), "Distance between measured and predicted, over time")


def _left(page: Page, found: Diagnosis) -> None:
    page.heading("What remains unexplained?")
    left = found.remainder
    page.text(
        "Nothing that noise would not leave." if left.p > 1e-3 else
        f"{left.excess:.2g} sigma that are smooth over the body and time, as no noise is.", "lead",
    )  # fmt: skip
    page.text(
        f"Of what the final model leaves, the part that is smooth over the body and time has {left.ratio:.3g} times "
        f"the variance of the rest (p = {left.p:.2g}), {left.excess:.2g} sigma in all."
    )
    kept = ", ".join(f"{kind} {value:.2g}" for kind, value in found.numerics.kept.items())
    page.text(f"Numerical error that a refit leaves, in sigma, carried along as a nuisance: {kept}.")
    for kind, why in found.numerics.failed.items():
        page.text(f"The error of the {kind} could not be measured: {why}", "note")


def _unknown(page: Page, found: Diagnosis) -> None:
    page.heading("What these recordings cannot tell")
    told = [
        f"{s.candidate.title}: refitting the other parameters hides all but {100 * s.survives:.2g} % of it."
        for s in found.screened if s.survives < HIDDEN
    ]  # fmt: skip
    told += [
        f"{a.candidate.title}, and {b.candidate.title}: nearly the same effect here "
        f"(correlation {found.isolability[i, j]:.3f})."
        for i, a in enumerate(found.screened)
        for j, b in enumerate(found.screened[:i])
        if found.isolability[i, j] > ALIKE
    ]
    if found.location is not None:
        share = float(np.mean([one.blind.mean() for one in found.location.trials]))
        told.append(f"Forces on {100 * share:.0f} % of body and time (hatched in the maps) do not show.")
    page.items(told or ["Every explanation that was tried would show, and none is the same as another."])
