"""Arrays handed to kernels by address: what goes in comes out, and what does not fit is refused."""

import os
import subprocess
import sys

import numpy as np
import pytest

from rodnet.compiled import kernel
from rodnet.packed import Packed, unpack

LAYOUT = "values:d3 places:i1 counts:l2 empty:d2"


@kernel
def _sums(table, factor):
    values, places, counts, empty = unpack(table, LAYOUT)
    total = 0.0
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            for k in range(values.shape[2]):
                total += factor * values[i, j, k] * places[k] * counts[j, i]
    values[0, 0, 0] = empty.shape[0] + 10 * empty.shape[1]
    return total


def arrays():
    rng = np.random.default_rng(0)
    counts = rng.integers(0, 9, (3, 2))
    return rng.normal(size=(2, 3, 4)), np.arange(4, dtype=np.int32), counts.astype(np.int64), np.zeros((0, 5))


def test_a_kernel_reads_and_writes_the_arrays_themselves():
    values, places, counts, empty = arrays()
    packed = Packed(LAYOUT, values, places, counts, empty)
    expected = 2.0 * np.einsum("ijk,k,ji", values, places, counts)
    assert _sums(packed.table, 2.0) == pytest.approx(expected, rel=1e-12)
    assert values[0, 0, 0] == 50.0
    values[:] = 0.0  # no copies
    assert _sums(packed.table, 2.0) == 0.0


@pytest.mark.parametrize(
    ("which", "wrong"),
    [
        (0, np.zeros((2, 3))),
        (0, np.zeros((2, 3, 4), dtype=np.float32)),
        (0, np.zeros((4, 3, 2)).T),
        (1, np.arange(4)),
        (2, np.zeros((3, 4), dtype=np.int64)[:, ::2]),
    ],
    ids=["dimensions", "precision", "order", "integers", "gaps"],
)
def test_other_arrays_are_refused(which, wrong):
    given = list(arrays())
    given[which] = wrong
    with pytest.raises(
        TypeError, match=f"{LAYOUT.split()[which].split(':')[0]} must be a C-contiguous array"
    ):
        Packed(LAYOUT, *given)


def test_kernels_run_as_python_for_debugging():
    """With numba's compiler switched off a step gives the same state."""
    code = (
        "import rodnet as rn; sim = rn.Simulation(rn.robots.flagellated(n_tails=2, rpm=100.0, edges=3), 1e-2); "
        "sim.step(); print(repr(sim.state.q.sum()), repr(abs(sim.state.v).max()))"
    )
    found = []
    for off in ("0", "1"):
        environment = {**os.environ, "NUMBA_DISABLE_JIT": off}
        command = [sys.executable, "-c", code]
        out = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
        found.append([float(value.removeprefix("np.float64(").rstrip(")")) for value in out.split()])
    assert found[1] == pytest.approx(found[0], rel=1e-9)
