"""Contact with walls and between rods: a smooth barrier on the gap, and Coulomb friction."""
