"""The page of a diagnosis: what is missing, where, how sure; before and after; what else explains it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.report.page import Page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rodnet.diagnosis.findings import Diagnosis, Finding, Interval
    from rodnet.diagnosis.screen import Score

SHOWN = 12  # rows of rankings
VERDICTS = {
    "none": "Nothing is missing that these recordings could show.",
    "named": "The model leaves out:",
    "partial": "The model leaves out what is named here, and something else that is not:",
    "class": "The model leaves something out; these explanations cannot be told apart by these recordings:",
    "surrogate": "Something is missing. What is found here stands in for it; it is not its name.",
    "unresolved-numerics": "The time step or the mesh is too coarse to say anything: refine them first.",
    "unidentifiable": "These recordings cannot tell.",
}


def diagnosis_page(found: Diagnosis) -> Page:
    """Return the page of a diagnosis."""
    page = Page(f"Diagnosis of '{found.case.name}'")
    page.text(summary(found), "verdict")
    _missing(page, found)
    _where(page, found)
    _what(page, found)
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


def _missing(page: Page, found: Diagnosis) -> None:
    page.heading("Is anything missing?")
    base = found.base
    rms = np.sqrt(sum(float(f.residual @ f.residual) for f in base.fits) / base.samples)
    page.text(
        f"The calibrated model as it is leaves {rms:.3g} times the noise, over {base.samples} numbers of "
        f"{len(base.fits)} trials. {len(found.screened)} explanations were scored at "
        f"{sum(s.tried for s in found.screened)} places, {len(found.tried)} refitted."
    )
    page.text("The smallest strength of each that would have been seen:")
    page.table(
        ("explanation", "parameter", "smallest"),
        [(s.candidate.title, p, v) for s in found.screened[:SHOWN] for p, v in s.detectable.items()],
    )


def _where(page: Page, found: Diagnosis) -> None:
    page.heading("Where and when?")
    if found.findings:
        page.items([f"{one.title}{_place(one)}" for one in found.findings])
    page.figure(
        _map(found), "Rms of the whitened residual of the model as it is, over the body and time: 1 is noise"
    )


def _map(found: Diagnosis) -> Figure:
    """Residuals over markers and time, one panel for each of the first trials."""
    import matplotlib.pyplot as plt

    fits = found.base.fits[:4]
    figure, axes = plt.subplots(
        1, len(fits), figsize=(3.2 * len(fits) + 1.0, 3.0), squeeze=False, sharey=True
    )
    for ax, fit, rec in zip(axes[0], fits, found.recordings, strict=False):
        white = fit.whitened[0]
        bins = min(len(white), 24)
        rows = np.array_split(np.sqrt((white**2).mean(axis=2)), bins)
        grid = np.array([np.sqrt((row**2).mean(axis=0)) for row in rows]).T
        drawn = ax.pcolormesh(
            np.linspace(0.0, rec.duration, bins + 1), np.arange(len(grid) + 1) - 0.5, grid, vmin=0.0,
            vmax=max(2.0, float(np.quantile(grid, 0.98))), cmap="magma",
        )  # fmt: skip
        ax.set(xlabel="time [s]", title=rec.name)
    axes[0, 0].set_ylabel("marker")
    figure.colorbar(drawn, ax=axes[0].tolist(), label="sigma")
    return figure


def _what(page: Page, found: Diagnosis) -> None:
    page.heading("What is it?")
    rows = [
        (one.title, p, v.value, v.low, v.high, v.unit)
        for one in found.findings
        for p, v in one.parameters.items()
    ]
    if rows:
        page.table(("explanation", "parameter", "value", "90 % from", "to", "unit"), rows)
        for one in found.findings:
            page.text(
                f"{one.title}: changes the prediction by {one.effect_sigma:.2g} sigma after the other parameters are "
                f"refitted; gains {0.5 * one.cross_gain:.3g} nats on trials left out. If it were so: {one.falsifier}."
            )
    page.table(
        ("explanation", "score (chi2)", "p", "gain of a refit", "left out", "accepted"),
        [_ranked(found, s) for s in found.screened[:SHOWN]],
    )
    for tried in found.tried:
        if not tried.accepted:
            page.text(
                f"{tried.id}, round {tried.round + 1}: not accepted, for {'; '.join(tried.reasons)}.", "note"
            )
    page.heading("What explains it as well, and which experiment would tell?")
    classes = [one for one in found.findings if one.equivalents]
    if classes:
        page.items([f"{one.id}: {', '.join(one.equivalents)}" for one in classes])
        page.items([p.sentence for p in found.proposals])
    else:
        page.text("Nothing else that was tried explains these recordings as well.")
    page.figure(
        _isolability(found),
        "How much alike the effects are after a refit of the other parameters: 1 is the same",
    )


def _ranked(found: Diagnosis, score: Score) -> tuple[Any, ...]:
    hits = [t for t in found.tried if t.id == score.candidate.id]
    first = hits[0] if hits else None
    return (
        score.candidate.title, score.chi2, score.p, None if first is None else first.gain,
        None if first is None else first.cross_gain, "yes" if any(t.accepted for t in hits) else "",
    )  # fmt: skip


def _isolability(found: Diagnosis) -> Figure:
    import matplotlib.pyplot as plt

    ids = [s.candidate.id for s in found.screened][:SHOWN]
    size = 1.5 + 0.4 * len(ids)
    figure, ax = plt.subplots(figsize=(size + 1.5, size))
    drawn = ax.imshow(found.isolability[: len(ids), : len(ids)], vmin=0.0, vmax=1.0, cmap="viridis")
    ax.set_xticks(range(len(ids)), ids, rotation=90)
    ax.set_yticks(range(len(ids)), ids)
    figure.colorbar(drawn, ax=ax, shrink=0.8)
    return figure


def _proof(page: Page, found: Diagnosis) -> None:
    page.heading("Before and after, on trials held out")
    if found.held is None:
        page.text("No trials were held out, so nothing is shown here.")
        return
    placebo = found.placebo_after()
    rows = [
        ("model as it is", found.held.before.error, found.held.before.sigma),
        ("repaired model", found.held.after.error, found.held.after.sigma),
        ("placebo: the best of random forces", *(placebo or (None, None))),
        ("noise alone", found.floor, 1.0),
    ]
    page.table(("model", "rms distance [m]", "in sigma"), rows)
    page.text(f"Held-out trials were opened {found.openings} times in this run.", "note")
    page.figure(_before_after(found), "Distance between measured and predicted on held-out trials, over time")


def _before_after(found: Diagnosis) -> Figure:
    import matplotlib.pyplot as plt

    from rodnet.inference.readings import by_samples

    held = found.held
    assert held is not None
    shown = min(len(held.before.fitted.fits), 4)
    figure, axes = plt.subplots(1, shown, figsize=(3.4 * shown + 0.6, 2.8), squeeze=False, sharey=True)
    for k, ax in enumerate(axes[0]):
        rec = held.bench.recordings[k]
        for opened, label in ((held.before, "as it is"), (held.after, "repaired")):
            fit = opened.fitted.fits[k]
            far = np.linalg.norm(by_samples(fit.measured[0] - fit.predicted[0]), axis=2)
            ax.plot(np.linspace(0.0, rec.duration, len(far)), 1e3 * np.nanmean(far, axis=1), label=label)
        ax.set(xlabel="time [s]", title=rec.name)
    axes[0, 0].set_ylabel("mean distance [mm]")
    axes[0, 0].legend()
    return figure


def _left(page: Page, found: Diagnosis) -> None:
    page.heading("What remains unexplained?")
    left = found.remainder
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
    blind = [s for s in found.screened if s.survives < 0.05]
    if blind:
        hidden = "refitting the other parameters hides all but"
        page.items(f"{s.candidate.title}: {hidden} {100 * s.survives:.2g} % of it" for s in blind)
    alike = [
        f"{a.candidate.title} and {b.candidate.title} (correlation {found.isolability[i, j]:.3f})"
        for i, a in enumerate(found.screened)
        for j, b in enumerate(found.screened[:i])
        if found.isolability[i, j] > 0.98
    ]
    if alike:
        page.text("Nearly the same effect on these recordings:")
        page.items(alike)
    if not blind and not alike:
        page.text("Every explanation that was tried would show, and none is the same as another.")
