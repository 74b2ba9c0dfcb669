"""Where points are computed: processes of our own, or any `concurrent.futures.Executor`."""

from __future__ import annotations

import multiprocessing
import os
import queue
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any

from rodnet.errors import ParameterError, SweepError

AHEAD = 1000  # points handed to a foreign executor at once
DIED = "its process died without a word: killed for want of memory, or crashed in compiled code"
TICK = 0.5  # seconds between looks at the clock
Job = tuple[str, Mapping[str, Any]]  # key, parameters


@contextmanager
def _script_stays_here() -> Iterator[None]:
    """Start processes that do not import the script that is running: its functions are sent to them by value.

    So a script needs no guard, and no process of ours ever runs one.
    """
    main: dict[str, Any] = vars(sys.modules["__main__"])
    kept: dict[str, Any] = {name: main[name] for name in ("__file__", "__spec__") if name in main}
    main.pop("__file__", None)
    main["__spec__"] = None
    try:
        yield
    finally:
        main.update(kept)


def _begin_worker() -> None:
    """Leave Ctrl-C to the first process, and end when that one is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


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


class Workers:
    """An executor under watch.

    Parameters
    ----------
    executor : Executor, optional
        Somebody else's, which is left running; processes of our own without it.
    count : int
        Number of our own processes; 0 computes in this one.
    """

    def __init__(self, executor: Executor | None, count: int) -> None:
        self.own = executor is None
        self.count = count
        self._executor = executor
        if executor is None:
            self._start()

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _start(self) -> None:
        self._executor = (
            ProcessPoolExecutor(
                self.count, mp_context=multiprocessing.get_context("spawn"), initializer=_begin_worker
            )
            if self.count
            else Serial()
        )

    @property
    def ahead(self) -> int:
        """How many points may be under way at once; one for `Serial`, so that Ctrl-C loses one."""
        return max(2 * self.count, 1) if self.own else AHEAD

    def greet(self, function: Callable[..., Any], *args: Any) -> Any:
        """Call a function there, to see whether they work.

        Raises
        ------
        ParameterError
            If the executor has been shut down, or cannot call the function.
        SweepError
            If the processes do not start.
        """
        assert self._executor is not None
        try:
            with _script_stays_here():
                futures = [self._executor.submit(function, *args) for _ in range(max(self.count, 1))]
            return [future.result() for future in futures][-1]
        except BrokenExecutor as error:
            whose = "the worker processes" if self.own else "the processes of the executor"
            raise SweepError(f"{whose} ended before they computed anything: {error}") from None
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

    def results(
        self,
        function: Callable[..., Any],
        jobs: Iterable[Job],
        tick: Callable[[], None],
    ) -> Generator[tuple[Job, Any], None, None]:
        """Call ``function(*job)`` for every job, and yield jobs and results as they come.

        In place of a result comes the exception of a job that could not be computed. When a process of our
        own dies, what was under way is computed one at a time, to find the job that kills it.

        Raises
        ------
        SweepError
            If somebody else's executor stops.
        """
        waiting, suspects = deque(jobs), deque[Job]()
        flying: dict[Future[Any], Job] = {}
        done: queue.SimpleQueue[Future[Any]] = queue.SimpleQueue()
        alone = False
        try:
            while waiting or suspects or flying:
                broken = False
                if not flying:
                    alone = bool(suspects)
                source, limit = (suspects, 1) if alone else (waiting, self.ahead)
                while source and len(flying) < limit and not broken and (alone or not suspects):
                    try:
                        future = self._submit(function, source[0])
                    except BrokenExecutor:
                        broken = True
                    else:
                        flying[future] = source.popleft()
                        future.add_done_callback(done.put)
                ended = None if not flying else done.get() if broken else _next(done)
                tick()
                while ended is not None:
                    job, error = flying.pop(ended), self._error(ended)
                    if not isinstance(error, BrokenExecutor):
                        yield job, ended.result() if error is None else error
                    else:  # then all that was under way is lost, and ends
                        broken = True
                        if alone:
                            yield job, SweepError(DIED)
                        else:
                            suspects.append(job)
                    ended = done.get() if broken and flying else None
                if broken:
                    self._start()
        finally:
            for future in flying:
                future.cancel()

    def _error(self, ended: Future[Any]) -> BaseException | None:
        """Return why a future has no result; raise what ends the sweep."""
        error = CancelledError() if ended.cancelled() else ended.exception()
        if isinstance(error, KeyboardInterrupt):  # Ctrl-C reaches somebody's processes, too
            raise error
        if isinstance(error, CancelledError) or (isinstance(error, BrokenExecutor) and not self.own):
            raise SweepError(
                f"the executor stopped ({type(error).__name__}: {error}); call the sweep again with one that works: "
                "with out= it goes on where this one ended"
            )
        return error

    def _submit(self, function: Callable[..., Any], job: Job) -> Future[Any]:
        assert self._executor is not None
        try:
            with _script_stays_here():
                return self._executor.submit(function, *job)
        except BrokenExecutor:
            if self.own:
                raise
            raise SweepError("the executor stopped; call the sweep again with one that works") from None
        except RuntimeError as error:
            raise SweepError(
                f"the executor stopped ({error}); call the sweep again with one that works"
            ) from None

    def close(self) -> None:
        """End our own processes, at once; leave somebody else's executor alone."""
        if not self.own:
            return
        executor = self._executor
        if isinstance(executor, ProcessPoolExecutor):
            processes = list((getattr(executor, "_processes", None) or {}).values())
            executor.shutdown(wait=False, cancel_futures=True)
            for process in processes:
                process.terminate()
            for process in processes:
                process.join()


def _next(done: queue.SimpleQueue[Future[Any]]) -> Future[Any] | None:
    """Return a future that has ended; None if there is none for a while."""
    try:
        return done.get(timeout=TICK)
    except queue.Empty:
        return None
