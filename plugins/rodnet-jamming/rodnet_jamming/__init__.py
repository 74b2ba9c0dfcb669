"""Grains that jam between rods: a drag law for rodnet."""

from rodnet_jamming.law import Jamming, confinement
from rodnet_jamming.robot import Intermittency, intermittency, jamming_robot

__all__ = ["Intermittency", "Jamming", "confinement", "intermittency", "jamming_robot"]
