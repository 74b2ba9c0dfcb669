"""Ready-made robots."""

from rodnet.robots.flagellated import flagellated, flagellated_metrics

__all__ = ["flagellated", "flagellated_metrics"]
