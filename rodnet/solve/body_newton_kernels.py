"""Compiled vector work of a Newton iteration for robots with rigid bodies: each in one call, for calls cost time."""

from __future__ import annotations

from rodnet.compiled import kernel
from rodnet.packed import unpack
from rodnet.solve import newton_kernels as newton_work
from rodnet.solve.body_kernels import follow, spread

# degrees of freedom that are free and that bodies carry, and room for updates of all and of these
ROOM = "free:i1 carried:i1 full:d1 extended:d1"

_move, _measure = newton_work.move, newton_work.measure


@kernel
def move(newton, bodies, twist0, update, scale, q_old, cv, ca, v0, a0):
    """Move free degrees of freedom, and what bodies carry; return the largest square of a rotation vector."""
    _move(newton, update, scale, q_old, cv, ca, v0, a0)
    return follow(bodies, twist0, q_old, cv, ca, v0, a0)


@kernel
def measure(newton, bodies, room, twist0, size, update, begins):
    """Size of an update and the largest factor on it, that of what bodies carry included."""
    free, carried, full, extended = unpack(room, ROOM)
    full[:] = 0.0
    for k in range(free.shape[0]):
        full[free[k]] = extended[k] = update[k]
    spread(bodies, twist0, full)
    for k in range(carried.shape[0]):
        extended[free.shape[0] + k] = full[carried[k]]
    return _measure(newton, twist0, size, extended, begins)
