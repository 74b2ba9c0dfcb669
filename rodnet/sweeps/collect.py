"""Results from any `concurrent.futures.Executor`, as they come."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from itertools import islice
from typing import Any

from rodnet.errors import ParameterError, SweepError

AHEAD = 1000  # calls handed to an executor at once
TICK = 0.5  # seconds between looks at the clock
REMEDY = (
    "call the sweep again with one that works: with out= it goes on where this one ended. Without executor=, in "
    "processes of its own, a robot that kills its process is recorded, and the others go on"
)


class Serial(Executor):
    """Computes in this process, at once."""

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call the function; an error is kept in the future."""
        future: Future[Any] = Future()
        try:
            future.set_result(function(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def greet(executor: Executor, function: Callable[..., Any], *args: Any) -> Any:
    """Call a function there, to see whether the workers work.

    Raises
    ------
    ParameterError
        If the executor has been shut down, or cannot call the function.
    SweepError
        If its workers do not start.
    """
    try:
        return executor.submit(function, *args).result()
    except (BrokenExecutor, CancelledError) as error:
        raise SweepError(
            f"the workers of the executor ended before they computed anything: {error}"
        ) from None
    except (ImportError, AttributeError) as error:
        raise ParameterError(
            f"the workers cannot load the functions of the sweep: {type(error).__name__}: {error}. Define them "
            "in the script or notebook that calls the sweep, or in a module that the workers can import"
        ) from None
    except RuntimeError as error:
        if "shutdown" in str(error):
            raise ParameterError(
                "the executor has been shut down; call the sweep inside of its with statement, or give a new one"
            ) from None
        raise


def collect(
    executor: Executor,
    function: Callable[..., Any],
    jobs: Iterable[tuple[Any, ...]],
    tick: Callable[[], None],
) -> Generator[tuple[tuple[Any, ...], Any], None, None]:
    """Call ``function(*job)`` for every job; yield jobs and results, or exceptions in their place, as they come.

    Raises
    ------
    SweepError
        If the executor stops.
    """
    waiting = iter(jobs)
    ahead = 1 if isinstance(executor, Serial) else AHEAD  # one, so that Ctrl-C loses one
    flying: dict[Future[Any], tuple[Any, ...]] = {}
    try:
        while True:
            for job in islice(waiting, ahead - len(flying)):
                try:
                    flying[executor.submit(function, *job)] = job
                except RuntimeError as error:  # broken, or shut down
                    raise SweepError(f"the executor stopped ({error}); {REMEDY}") from None
            if not flying:
                return
            ended = wait(flying, TICK, FIRST_COMPLETED).done
            tick()
            stopped = None
            for future in ended:
                job = flying.pop(future)
                failed = CancelledError() if future.cancelled() else future.exception()
                if isinstance(failed, KeyboardInterrupt | BrokenExecutor | CancelledError | SweepError):
                    stopped = failed  # Ctrl-C reaches other processes, too
                else:
                    yield job, future.result() if failed is None else failed
            if isinstance(stopped, BrokenExecutor | CancelledError):
                raise SweepError(f"the executor stopped ({type(stopped).__name__}: {stopped}); {REMEDY}")
            if stopped is not None:
                raise stopped
    finally:
        for future in flying:
            future.cancel()
