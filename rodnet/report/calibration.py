"""The page of a calibration: parameters, what they rest on, measured beside predicted."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from rodnet.report.page import Page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rodnet.inference.predictions import Prediction
    from rodnet.inference.result import CalibrationResult

SHOWN = 6  # trials
LINES = 4  # samples of an instrument


def calibration_page(
    found: CalibrationResult, held: Mapping[str, Prediction] | None = None, split: str = ""
) -> Page:
    """Return the page of a calibration, and of predictions of recordings held out (``split``: how they were chosen)."""
    page = Page(f"Calibration of '{found.case.name}'")
    page.text(found.message, "verdict")
    if split:
        page.text(split, "note")
    page.heading("Parameters")
    page.table(
        ("parameter", "value", "95 % from", "to", "unit"),
        [(path, e.value, e.low, e.high, e.unit) for path, e in found.parameters.items()],
    )
    page.heading("What the recordings determine")
    page.items(found.identifiability.sentences)
    page.table(
        ("combination", "relative standard deviation"),
        [(d.words, d.sd) for d in found.identifiability.directions],
    )
    page.heading("What is left")
    page.table(
        ("instrument", "rms", "unit"), [(name, rms, found.units[name]) for name, rms in found.rms.items()]
    )
    page.text(
        f"{found.samples} numbers, of which the prewhitened residual has the mean square "
        f"{found.chi2 / found.samples:.3g} (1 is the noise); {found.outliers} outliers were left out."
    )
    if held:
        page.heading("Held out")
        if found.case.per_trial:
            page.text(f"In each, its own {', '.join(found.case.per_trial)} was fitted; nothing else.", "note")
        page.table(
            ("recording", "instrument", "rms", "unit"),
            [(n, k, v, dict(p.instruments)[k]) for n, p in held.items() for k, v in p.rms.items()]
            + [(n, p.failure, None, "") for n, p in held.items() if p.failure],
        )
    page.heading("Measured and predicted")
    for name in list(found.measured)[:SHOWN]:
        page.figure(
            measured_and_predicted(
                found.instruments[name], found.times[name], found.measured[name], found.predicted[name]
            ),
            f"{name}: measured (dots) and predicted (lines)",
        )
    for name, one in list((held or {}).items())[:SHOWN]:
        if not one.failure:
            page.figure(
                measured_and_predicted(one.instruments, one.t, one.measured, one.predicted),
                f"{name}, held out: measured (dots) and predicted (lines)",
            )
    return page


def measured_and_predicted(
    names: list[tuple[str, str]], t: np.ndarray, measured: list[np.ndarray], predicted: list[np.ndarray]
) -> Figure:
    """One column for each instrument; of markers one row for each coordinate."""
    import matplotlib.pyplot as plt

    rows = max(m.shape[-1] if m.ndim == 3 else 1 for m in measured)
    figure, axes = plt.subplots(
        rows, len(measured), figsize=(5.0 * len(measured) + 1.0, 1.0 + 1.7 * rows), squeeze=False, sharex=True
    )
    for column, ((name, unit), seen, said) in enumerate(zip(names, measured, predicted, strict=True)):
        for row in range(rows):
            ax = axes[row, column]
            if seen.ndim != 3 and row:
                ax.set_visible(False)
                continue
            a, b = (v[..., row] if v.ndim == 3 else v.reshape(len(v), -1) for v in (seen, said))
            for k in np.unique(np.linspace(0, a.shape[1] - 1, LINES).astype(int)):
                (line,) = ax.plot(t, b[:, k], lw=1)
                ax.plot(t, a[:, k], ".", ms=2, color=line.get_color())
            ax.set_ylabel(f"{name} {'xyz'[row] if seen.ndim == 3 else ''} [{unit}]")
        axes[-1, column].set_xlabel("t [s]")
    return figure
