"""Pictures: rerun recordings and matplotlib figures. rerun and matplotlib load on first use."""

from rodnet.viz.debug_step import debug
from rodnet.viz.imports import plot_import
from rodnet.viz.plots import plot_comparison, plot_position, plot_shapes
from rodnet.viz.rerun_log import snapshot
from rodnet.viz.scenes import log_comparison, log_rerun

__all__ = [
    "debug",
    "log_comparison",
    "log_rerun",
    "plot_comparison",
    "plot_import",
    "plot_position",
    "plot_shapes",
    "snapshot",
]
