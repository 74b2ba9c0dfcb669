"""The jobs of a sweep, on any executor: what a worker does, and who collects it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor, as_completed
from functools import lru_cache
from itertools import islice
from typing import Any

from rodnet.errors import ConvergenceError
from rodnet.progress import meter

Result = dict[str, Any]


def run_jobs(
    functions: tuple[Callable[..., Any], ...],
    points: Mapping[str, Mapping[str, Any]],
    keep: Callable[[str, Result], None],
    executor: Executor | None,
    workers: int | None,
    progress: bool,
    total: int,
) -> None:
    """Run a job for every point, and ``keep(key, result)`` each as it comes.

    Parameters
    ----------
    functions : (build, metrics, simulate)
        Sent by value, so that they may come from a script or a notebook.
    points : mapping
        Parameters by key.
    total : int
        Number of points of the whole sweep, finished ones included.
    """
    if not points:
        return
    import cloudpickle

    payload = cloudpickle.dumps(functions)
    begun = total - len(points)
    results = (
        _processes(payload, points, workers) if executor is None else _collect(executor, payload, points)
    )
    first = next(results)  # processes are forked before the progress bar starts a thread
    with meter(progress, "sweeping", begun / total) as show:
        for count, (key, result) in enumerate(_with(first, results), begun + 1):
            keep(key, result)
            show(count / total)


def _with(first: Any, rest: Iterator[Any]) -> Iterator[Any]:
    yield first
    yield from rest


def _collect(
    executor: Executor, payload: bytes, points: Mapping[str, Mapping[str, Any]]
) -> Iterator[tuple[str, Result]]:
    futures = {executor.submit(work, payload, dict(point)): key for key, point in points.items()}
    try:
        for future in as_completed(futures):
            try:
                yield futures[future], future.result()
            except BrokenExecutor:
                raise
            except Exception as error:  # of the executor: a lost worker, something that cannot be sent
                yield futures[future], failure(error)
    finally:
        for future in futures:
            future.cancel()


def _processes(
    payload: bytes, points: Mapping[str, Mapping[str, Any]], workers: int | None
) -> Iterator[tuple[str, Result]]:
    """Collect from processes of our own; find out which job kills its process, and go on without it."""
    left = dict(points)
    suspects: dict[str, Mapping[str, Any]] = {}
    while left:
        batch = dict(islice(suspects.items(), 1)) or left
        with ProcessPoolExecutor(1 if suspects else workers) as pool:
            try:
                for key, result in _collect(pool, payload, batch):
                    left.pop(key)
                    suspects.pop(key, None)
                    yield key, result
            except BrokenExecutor:
                if suspects:
                    key = next(iter(suspects))
                    left.pop(key)
                    suspects.pop(key)
                    yield key, {"error": "ProcessDied: its process was killed, perhaps for want of memory"}
                else:  # among those that were sent out first: try these one by one
                    count = 2 * pool._max_workers + 1  # type: ignore[attr-defined]
                    suspects = dict(islice(left.items(), count))


@lru_cache(maxsize=4)
def _functions(payload: bytes) -> tuple[Callable[..., Any], ...]:
    import cloudpickle

    return cloudpickle.loads(payload)


def work(payload: bytes, point: dict[str, Any]) -> Result:
    """Build, simulate and measure one robot; what goes wrong is the result, too."""
    from threadpoolctl import threadpool_limits

    from rodnet.sweeps import numbers

    start = time.perf_counter()
    try:
        with threadpool_limits(1):  # the jobs themselves are what runs side by side
            build, metrics, simulate = _functions(payload)
            result: Result = {"values": numbers(metrics(simulate(build(**point))), point)}
    except (Exception, SystemExit) as error:
        result = failure(error)
    return {**result, "seconds": time.perf_counter() - start}


def failure(error: BaseException) -> Result:
    """Return an error as a result."""
    when = f" (at t = {error.time:g} s)" if isinstance(error, ConvergenceError) else ""
    return {"error": f"{type(error).__name__}: {error}{when}"}
