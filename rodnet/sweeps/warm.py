"""What worker processes are forked from: imported there once, with the kernels that every robot needs."""

from __future__ import annotations

import contextlib
import gc

import rodnet

with contextlib.suppress(Exception):  # a robot without these finds out itself
    rodnet.Simulation(rodnet.robots.flagellated(edges=4), dt=0.01).step()

gc.freeze()  # what is here stays: shared with those that are forked, and not searched for rubbish at the end
