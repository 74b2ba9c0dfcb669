"""The page of an evaluation: scores beside those of no model, errors over time, measured beside predicted."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.numbers import number
from rodnet.report.calibration import measured_and_predicted
from rodnet.report.page import Page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rodnet.inference.evaluate import Evaluation

SHOWN = 6  # recordings


def evaluation_page(found: Evaluation, model: str = "") -> Page:
    """Return the page of an evaluation; ``model`` says in words what was evaluated."""
    page = Page(f"Predictions of '{found.case}'")
    total = found.total()
    value, mean = (shown_number(total[key]) for key in ("metric", "mean_mm_5s"))
    page.text(
        f"{total['recordings']} recordings predicted open loop: {found.metric_name} {value}, mean distance of free "
        f"markers over 5 s {mean} mm.",
        "verdict",
    )
    if model:
        page.text(model, "note")
    page.heading("Scores")
    head = ("recording", found.metric_name, "mm, 5 s", "mm, 1 s", "what went wrong")
    row = lambda name, s, told="": (name, s["metric"], s["mean_mm_5s"], s["mean_mm_1s"], told)  # noqa: E731
    rows = [row(f"{f['kind']}/{f['name']}", f, f["failure"]) for f in found.files]
    for kind in [None] if len(found.kinds) == 1 else [*found.kinds, None]:
        part = found.total(kind)
        rows.append(row(f"mean of {part['recordings']} {kind or ''}", part))
        rows += [row(f"without the model: {name}", s) for name, s in part["baselines"].items()]
    page.table(head, rows)
    if "convergence" in total:
        _convergence(page, found, total["convergence"])
    page.heading("Measured and predicted")
    known = [(f, t) for f, t in zip(found.files, found.traces, strict=True) if t is not None]
    if known:
        page.figure(_errors(known), "Distance of predicted from measured, mean over what was free, over time")
    for file, trace in known[:SHOWN]:
        page.figure(
            measured_and_predicted(trace.instruments, trace.t, trace.measured, trace.predicted),
            f"{file['name']}: measured (dots) and predicted (lines)",
        )
    return page


def shown_number(value: float | None) -> str:
    """A number with four digits."""
    return "-" if value is None else number(value, ".4g")


def convergence_in_words(total: Mapping[str, Any]) -> str:
    """Say what the time step does."""
    parts = [f"time step {1e3 * total['dt']:.3g} ms"]
    if total["rms_mm"] is not None:
        parts.append(
            f"halved it changes trajectories by {total['rms_mm']:.2g} mm rms, at most {total['max_mm']:.2g} mm"
        )
    if total["numerical_over_fitted"] is not None:
        parts.append(
            f"it takes at most {100.0 * total['numerical_over_fitted']:.2g} % of what the model's damping takes of a "
            "vibration in a period"
        )
    return "; ".join(parts)


def _convergence(page: Page, found: Evaluation, total: Mapping[str, Any]) -> None:
    page.heading("The time step")
    page.text(convergence_in_words(total))
    head = ("recording", "mode [Hz]", "share of energy", "fitted loss a period", "numerical loss a period")
    rows = [
        (f["name"], m["frequency"], m["share"], m["fitted"], m["numerical"])
        for f in found.files
        for m in f.get("convergence", {}).get("modes", [])
    ]
    page.table(head, rows)
    page.items(f"{f['name']}: {f['convergence']['told']}" for f in found.files
               if f.get("convergence", {}).get("told"))  # fmt: skip


def _errors(known: list[tuple[dict[str, Any], Any]]) -> Figure:
    """Mean error over time of each instrument, a line for each recording that has it."""
    import matplotlib.pyplot as plt

    instruments = list(dict.fromkeys(one for _, trace in known for one in trace.instruments))
    figure, axes = plt.subplots(
        len(instruments), figsize=(7.0, 0.8 + 2.6 * len(instruments)), squeeze=False, layout="constrained"
    )
    for row, (name, unit) in enumerate(instruments):
        ax = axes[row, 0]
        for file, trace in known:
            if (name, unit) not in trace.instruments:
                continue
            k = trace.instruments.index((name, unit))
            off = trace.predicted[k] - trace.measured[k]
            size = np.linalg.norm(off, axis=-1) if off.ndim == 3 else np.abs(off.reshape(len(off), -1))
            size = size[:, ~trace.prescribed[k]] if size.shape[1] == len(trace.prescribed[k]) else size
            seen = np.isfinite(size)
            mean = np.where(seen, size, 0.0).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
            ax.plot(trace.t, np.where(seen.any(axis=1), mean, np.nan), lw=1, label=file["name"])
        ax.set(xlabel="t [s]", ylabel=f"{name} [{unit}]", ylim=(0.0, None))
        ax.legend(fontsize="x-small", ncols=2)
    return figure
