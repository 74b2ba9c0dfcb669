"""Grains that jam between rods: a drag law for rodnet."""

from rodnet_jamming.law import Jamming, Yielding, confinement
from rodnet_jamming.robot import Intermittency, intermittency, jamming_robot

__all__ = ["Intermittency", "Jamming", "Yielding", "confinement", "intermittency", "jamming_robot"]
