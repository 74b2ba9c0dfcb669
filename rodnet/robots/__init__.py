"""Ready-made robots."""

from rodnet.robots.cables import Cables
from rodnet.robots.flagellated import flagellated, flagellated_metrics

__all__ = ["Cables", "flagellated", "flagellated_metrics"]
