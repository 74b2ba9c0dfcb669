"""The page of a diagnosis: what is missing, where, how sure; before and after; what else explains it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rodnet.diagnosis.findings import interval
from rodnet.diagnosis.library import LAW
from rodnet.diagnosis.scales import ALPHA
from rodnet.diagnosis.told import regime_of
from rodnet.diagnosis.verdict import complete
from rodnet.numbers import number, p_value, percent, times
from rodnet.report.figures import before_after, force_maps, measure
from rodnet.report.law_words import SIGN, parts_in_words
from rodnet.report.limits import titled, untold
from rodnet.report.page import Page
from rodnet.report.proof import lead_of, removals, resampled
from rodnet.report.rows import ranked, smallest, unit_of
from rodnet.report.sentences import (
    SHOWN,
    about_law,
    about_remainder,
    beside,
    channels,
    ends,
    gained,
    leaves,
    place,
    short,
    spots,
    summary,
    sure,
    takes,
    unit_of_residuals,
    was,
)

if TYPE_CHECKING:
    from rodnet.diagnosis.findings import Finding
    from rodnet.diagnosis.result import Diagnosis
    from rodnet.diagnosis.workbench import Fitted

FEW = 4  # things that cannot be told, before the rest is folded


def diagnosis_page(found: Diagnosis, runs: bool = True) -> Page:
    """Return the page of a diagnosis; ``runs`` if there is a file of the repaired robot that does."""
    page = Page(f"Diagnosis of '{found.case.name}'")
    page.text(summary(found), "verdict")
    _missing(page, found)
    _where(page, found)
    _what(page, found)
    _alike(page, found)
    _proof(page, found)
    _left(page, found)
    _unknown(page, found)
    _whence(page, found, runs)
    return page


# -- is anything missing ----------------------------------------------------------------------------
def _missing(page: Page, found: Diagnosis) -> None:
    page.heading("Is anything missing?")
    page.text(sure(found), "lead")
    base = found.base
    page.text(
        f"The calibrated model as it is leaves {number(leaves(found))} times {unit_of_residuals(found)}, over "
        f"{base.samples} numbers of {len(base.fits)} trials. {len(found.screened)} explanations were scored at "
        f"{sum(s.tried for s in found.screened)} places, {len(found.tried)} refitted; every probability here counts "
        "all that was tried."
    )
    units = {path: p.unit for path, p in found.described().items()}
    if found.preflight is not None and found.preflight.remarks:
        page.text("Before physics is blamed, look at these:")
        page.items(found.preflight.remarks)
    page.text("The smallest effect of each kind that these recordings would have shown:")
    page.table(
        ("explanation", "parameter", "smallest", "unit"),
        [row for s in found.screened for row in smallest(s, units)],
        SHOWN,
    )


# -- where and when ---------------------------------------------------------------------------------
def _where(page: Page, found: Diagnosis) -> None:
    page.heading("Where, when, and in which regime?")
    if found.findings:
        page.items(f"{one.title}{place(one)}: {regime_of(one, found.regime)[1]}." for one in found.findings)
    if found.location is None:
        page.text("The force that is missing could not be located over body and time.")
        return
    location = found.location
    page.text(channels(location))
    if found.regime is not None:
        page.text(f"The regime of the force that the model as it is lacks: {found.regime.words}.")
    if location.loud("force"):
        page.items(spots(location))
    page.figures(
        force_maps(location),
        "The force per length that the model as it is lacks, over its posterior standard deviation: beyond 3 it is "
        "not chance. Hatched: a force that matters would not be seen there. Blue arrows: markers. A map shows where "
        "to look; a soft spot shows as forces beside it, and the place with an interval is that of the refitted "
        "explanation.",
    )


# -- what -------------------------------------------------------------------------------------------
def _what(page: Page, found: Diagnosis) -> None:
    from rodnet.diagnosis import findings

    page.heading("What is it?")
    if not found.findings:
        page.text("Nothing that was tried was accepted.", "lead")
    for one in found.findings:
        page.text(f"{one.title}{place(one)}.", "lead")
        words = _words(found, one)
        page.table(
            (
                "part" if one.id == LAW else "parameter",
                "value",
                f"{percent(findings.LEVEL)} interval",
                "unit",
            ),
            [
                (
                    words[p],
                    v.value,
                    ends(v),
                    unit_of(v.unit),
                )
                for p, v in one.parameters.items()
            ],
        )
        if one.id == LAW:
            page.text(SIGN, "note")
        page.text(
            f"It changes the prediction by {number(one.effect_sigma, '.2g')} sigma after the other parameters are "
            f"refitted, and gains {gained(one.gain, one.cross_gain, one.relief)}. If it is so: {one.falsifier}."
        )
        if one.beside is not None:
            page.text(beside(one))
    page.text("What was free beside it:" if found.findings else "What was calibrated:")
    page.table(
        (
            "parameter",
            "model as it is, 90 % interval",
            *(["repaired model"] if found.findings else []),
            "unit",
        ),
        _nominal(found),
    )
    if own := dict.fromkeys(
        p.partition("[")[0] for one in found.base.own for p in one if ".records[" not in p
    ):
        page.text(f"Each trial has its own {', '.join(own)}.", "note")
    page.text("How the explanations rank:")
    head = ("explanation", "score (chi²)", "chance", "gain [nats]", "on trials left out [nats]", "verdict")
    count = len(head) if found.tried else 3  # without a refit there is nothing in the others
    page.table(head[:count], [ranked(found, s)[:count] for s in found.screened], SHOWN)
    page.text(
        "Chance is that of so large a score at any place that was tried, where residuals vary as the model leaves them "
        "and not as the noise would.",
        "note",
    )
    page.folded(
        "Why others were not accepted",
        (f"{t.id}, round {t.round + 1}: {'; '.join(t.reasons)}." for t in found.tried if not t.accepted),
    )


def _words(found: Diagnosis, one: Finding) -> dict[str, str]:
    """What the parameters of an effect are called; those of a drafted law, whose names mean nothing, in words."""
    if one.id == LAW and found.law is not None:
        return parts_in_words(found.law.pieces)
    known = found.described()
    docs = {path: known[path].doc for path in one.parameters if path in known}
    return {
        path: f"{name}: {docs[path]}" if docs.get(path) else name
        for path, name in short(one.parameters).items()
    }


def _nominal(found: Diagnosis) -> list[tuple[Any, ...]]:
    """Rows of what is free in the case, without and with what was found."""
    common = [q for q in found.base.quantities if q.trial is None and ".numerics[" not in q.path]
    models = [found.base, *([found.model] if found.findings else [])]
    return [(q.path, *(_known(model, q.path) for model in models), unit_of(q.unit)) for q in common]


def _known(model: Fitted, path: str) -> str:
    """A value with its interval; without where something took its place."""
    if path not in model.values:
        return "–"
    one = interval(model, path)
    return f"{number(one.value)} ({ends(one)})"


def _alike(page: Page, found: Diagnosis) -> None:
    some = "What explains it as well, and which experiment would tell?"
    page.heading(some if found.findings else "Which explanations would look alike?")
    classes = [one for one in found.findings if one.equivalents]
    apart = [
        one for one in found.findings if any(where is not None and where.also for where in (one.at, one.when))
    ]
    titles = {s.candidate.id: s.candidate.title for s in found.screened}
    if classes:
        page.items(
            f"{one.title} is explained as well by: {', '.join(titles.get(e, e) for e in one.equivalents)}."
            for one in classes
        )
    if apart:
        page.items(f"{one.title} explains as much in more than one place:{place(one)}." for one in apart)
    if classes or apart:
        if found.proposals:
            page.text("What would tell them apart:")
            page.items(f"{titled(one, titles).sentence}." for one in found.proposals)
        elif found.case.drives is not None:
            page.text("No trial of the case's menu was found that would tell.", "note")
        if found.case.drives is None:
            page.text("The case has no menu of drives (drives) to choose the next trial from.", "note")
    elif found.findings:
        page.text("Nothing else that was tried explains these recordings as well.", "lead")
    count = min(len(found.screened), SHOWN)
    if count > 1:
        page.matrix(
            [s.candidate.title for s in found.screened[:count]], found.isolability[:count, :count],
            "How much alike two effects look on these recordings to first order, once the other parameters are "
            "refitted: 1 is the same, 0 has nothing in common; refits tell apart what looks alike here. The first "
            f"{count} of {len(found.screened)} explanations; all of them are in diagnosis.json.",
        )  # fmt: skip


# -- proof ------------------------------------------------------------------------------------------
def _proof(page: Page, found: Diagnosis) -> None:
    before = "Before and after" if found.findings else "The model as it is"
    page.heading(f"{before}, on trials {found.shown or 'held out'}")
    if found.held is None:
        page.text(
            f"Nothing is shown here: {', '.join(found.lost)} {was(found.lost)} not searched, and cannot be simulated "
            "with every model."
            if found.lost
            else "No trials were held out, so nothing is shown here."
        )
        if text := resampled(found):
            page.text(text)
        return
    placebo, share = found.placebo_after(), found.explained_fraction
    unit, factor = measure(found)
    if found.findings and share is not None:
        page.text(
            f"The repaired model {takes(share)} the squared error beyond the noise.",
            "lead",
        )
    if text := resampled(found):
        page.text(text)
    if found.findings and (by_file := removals(found)):
        page.text(lead_of(found))
        page.table(
            ("mean over files of", "files", "model as it is", "repaired model", "removed", "90 % interval"),
            by_file,
        )
    rows: list[tuple[Any, ...]] = [
        ("model as it is", factor * found.held.before.error, found.held.before.sigma)
    ]
    if found.findings:
        rows.append(("repaired model", factor * found.held.after.error, found.held.after.sigma))
    if placebo:
        rows.append(("placebo", factor * placebo[0], placebo[1]))
    rows += [
        ("noise alone", None if found.floor is None else factor * found.floor, found.floor_sigma),
    ]
    page.table(("model", f"rms error [{unit}]", "in sigma"), rows)
    few = (
        " They are too short to tell their noise: it is that of the training trials."
        if found.held.borrowed
        else ""
    )
    if found.held.failed:
        page.text(f"Not shown, for not every model can be simulated there: {', '.join(found.held.failed)}.")
    ever = (
        "" if found.openings_ever is None else f", {times(found.openings_ever)} in all by the case's ledger"
    )
    drawn = (
        "The placebo is the best of as many random smooth forces as explanations were tried, with as many free "
        "parameters, chosen by the same rule, and taken back where trials not seen speak against it. "
        if placebo
        else ""
    )
    page.text(
        f"{drawn}Trials that the search had not seen were opened {times(found.openings)} in this run{ever}.{few}",
        "note",
    )
    if any(".numerics[" in path for path in found.model.values):
        page.text(
            "What a finer mesh and a shorter time step would change, as measured, is in these predictions; "
            "`rodnet evaluate` and `rodnet run` have the mesh and step of the case, and errors larger by that.",
            "note",
        )
    if any(".records[" in path for own in found.model.own for path in own):
        page.text(
            "Each trial is held where its motion fits best, beside the record of its drive by about the noise of that.",
            "note",
        )
    page.figures(before_after(found), "Distance between measured and predicted, over time")


def _left(page: Page, found: Diagnosis) -> None:
    page.heading("What remains unexplained?")
    left = found.left
    page.text(
        "There are too few samples to test what is left." if not left.tested else
        "Nothing that noise would not leave." if left.p > ALPHA else
        f"{number(left.excess, '.2g')} sigma that noise would not leave: too little to name." if complete(left) else
        f"{number(left.excess, '.2g')} sigma that are smooth over the body and time, as no noise is.", "lead",
    )  # fmt: skip
    page.text(
        f"Of what the final model leaves, the part that is smooth over the body and time has {number(left.ratio)} "
        f"times the variance of the rest ({p_value(left.p)}), {number(left.excess, '.2g')} sigma in all. "
        f"{about_remainder(found)}"
    )
    if found.law is not None:
        page.text(about_law(found, found.law))
    known = {k: v for k, v in found.numerics.kept.items() if k not in found.numerics.failed}
    if known:
        kept = ", ".join(f"{kind} {number(value, '.2g')}" for kind, value in known.items())
        carried = any(".numerics[" in q.path for q in found.base.quantities)
        way = "carried along as a nuisance" if carried else "not carried along"
        page.text(f"Numerical error that a refit leaves, in sigma, {way}: {kept}.")
    if coarser := found.numerics.coarser:
        was_so = ", ".join(f"{kind} {number(value, '.2g')}" for kind, value in coarser.items())
        page.text(f"That is after refining; with those of the case itself it is: {was_so}.")
    for kind, why in found.numerics.failed.items():
        page.text(f"The error of the {kind} could not be measured: {why}", "note")


def _unknown(page: Page, found: Diagnosis) -> None:
    page.heading("What these recordings cannot tell")
    page.items(
        untold(found) or ["Every explanation that was tried would show, and none looks the same as another."],
        FEW,
    )


def _whence(page: Page, found: Diagnosis, runs: bool) -> None:
    from rodnet import __version__

    page.heading("What this is about")
    parts = [("fitted", [rec.name for rec in found.training])]
    parts += [
        (word, [rec.name for rec in held.bench.recordings])
        for word, held in (("held out", found.tested), ("left alone to confirm", found.held))
        if held is not None and (word == "held out" or held is not found.tested)
    ]
    lost = [*found.lost, *(found.tested.failed if found.tested else [])]
    parts += [("not searched, and not simulated with every model", lost)] if lost else []
    page.items(f"{word}: {', '.join(names)}" for word, names in parts)
    if found.findings:
        nowhere = "The repaired robot cannot be written to a file, as repaired.txt says"
        python = "." if found.case.path is None else "; repaired.py has it in Python."
        page.text(_run(found) if runs else nowhere + python)
    page.text(f"rodnet {__version__}, case '{found.case.name}', {found.seconds:.0f} s.", "note")


def _run(found: Diagnosis) -> str:
    """How the repaired robot is run as long, and with the same steps, as the recording that it is driven as in."""
    rec = found.case.part(found.recordings[0])
    options = found.case.simulation(rec, found.case.robot(rec))
    text = f"rodnet run repaired.toml --duration {number(rec.duration, '.4g')} --dt {number(options['dt'], '.4g')}"
    if isinstance(options["stepper"], str):
        text += f" --stepper {options['stepper']}"
    return f"The repaired robot, driven as in {rec.name}, is run by: {text}"
