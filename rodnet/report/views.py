"""What is written beside the page of a diagnosis: figures, the located force, and a file for the rerun viewer."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rodnet.report.figures import save_figures

if TYPE_CHECKING:
    from rodnet.diagnosis.result import Diagnosis


def write_views(found: Diagnosis, directory: str | Path) -> list[Path]:
    """Write ``figures/``, ``location.npz`` and ``diagnosis.rrd`` into a directory.

    Raises
    ------
    OutputError
        If something cannot be written.
    """
    from rodnet.viz.diagnosis import FILE, log_diagnosis

    written = save_figures(found, Path(directory) / "figures")
    if found.location is not None:
        written += [found.location.save(directory), log_diagnosis(found, Path(directory) / FILE)]
    return written


def clear(out: Path) -> None:
    """Take away what an earlier diagnosis has written there: some of it may not be written again."""
    own = ("repaired.*", "fitted.json", "location.npz", "diagnosis.rrd")
    figures = ("isolability.png", "force-*.png", "held-out-*.png")
    for old in (
        *(p for name in own for p in out.glob(name)),
        *(p for name in figures for p in out.glob(f"figures/{name}")),
    ):
        old.unlink()
