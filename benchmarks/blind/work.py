"""Many cases in parallel: progress, an estimate of time, and what failed."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Any

BATCH = 8  # jobs of a process


def each(function: Callable[..., Any], jobs: Sequence[tuple[Any, ...]], workers: int, label: str) -> int:
    """Call a function for each job and return how many failed; the others go on."""
    began, failed, done = time.monotonic(), 0, 0
    # new processes now and then, for memory; a pool that renews its own hangs when all are due at once (CPython 115634)
    for batch in (jobs[k : k + BATCH * workers] for k in range(0, len(jobs), BATCH * workers)):
        with ProcessPoolExecutor(workers, get_context("spawn"), initializer=_alone) as pool:
            running = {pool.submit(function, *job): job for job in batch}
            for future in as_completed(running):
                done += 1
                if error := future.exception():
                    failed += 1
                    print(f"\n{label}: {type(error).__name__}: {error}", file=sys.stderr)
                left = (time.monotonic() - began) / done * (len(jobs) - done)
                print(
                    f"\r{label} {done}/{len(jobs)}, about {left / 60:.0f} min left", end="  ", file=sys.stderr
                )
    if jobs:
        print(file=sys.stderr)
    return failed


def _alone() -> None:
    """One thread for each process: the cases are what is parallel."""
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ[name] = "1"
