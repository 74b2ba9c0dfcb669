"""Processes of this machine that compute, as a `concurrent.futures.Executor` that survives their death.

`concurrent.futures.ProcessPoolExecutor` breaks down with everything under way when one of its processes is
killed, imports the running script in each, and forks with whatever threads there are. Here every process is a
fresh interpreter that a thread of its own hands one call at a time: the call that kills it is known.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import CancelledError, Executor, Future
from typing import Any

from rodnet.errors import SweepError

TRIES = 2  # the process of a call may be killed for what another one needs
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "NUMBA_NUM_THREADS"),
    "1",
)  # fmt: skip
CODE = (
    "import signal, sys; signal.signal(signal.SIGINT, signal.SIG_IGN); sys.path[:] = {path!r}; "
    "from rodnet.sweeps.processes import serve; serve()"
)


class ProcessDied(RuntimeError):
    """The process of a call ended without a word."""


class Processes(Executor):
    """So many processes, which start at once; functions and arguments are pickled.

    Parameters
    ----------
    count : int
        Number of processes, each with one thread for linear algebra.
    """

    def __init__(self, count: int) -> None:
        self._calls: queue.SimpleQueue[tuple[Future[Any], bytes] | None] = queue.SimpleQueue()
        self._lock = threading.Lock()  # no process is started while all are being ended
        self._closing = False
        self._workers = [_Worker() for _ in range(count)]
        self._threads = [threading.Thread(target=self._hand, args=(w,), daemon=True) for w in self._workers]
        for thread in self._threads:
            thread.start()

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call the function in the next process that is free."""
        future: Future[Any] = Future()
        self._calls.put((future, pickle.dumps((function, args, kwargs))))
        return future

    def _hand(self, worker: _Worker) -> None:
        """Hand calls to a process, one after the other."""
        while (call := self._calls.get()) is not None:
            future, message = call
            if future.set_running_or_notify_cancel():
                try:
                    done, value = self._call(worker, message)
                except Exception as error:
                    done, value = False, error
                (future.set_result if done else future.set_exception)(value)
        worker.end()

    def _call(self, worker: _Worker, message: bytes) -> tuple[bool, Any]:
        """Return whether a call has succeeded, and its result or exception; replace a process that dies of it."""
        for _ in range(TRIES):
            try:
                return pickle.loads(worker.call(message))
            except (OSError, EOFError, pickle.UnpicklingError):
                ready, how = worker.ready, worker.end()
                with self._lock:
                    if self._closing:
                        raise CancelledError from None
                    worker.start()
                if not ready:
                    raise SweepError(f"the worker processes do not start ({how})") from None
        raise ProcessDied(
            f"its process died ({how}) {TRIES} times: out of memory, or a crash in compiled code"
        )

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes when everything is done; with ``cancel_futures``, now."""
        if cancel_futures:
            with self._lock:
                self._closing = True
                for worker in self._workers:
                    worker.process.kill()
            with contextlib.suppress(queue.Empty):
                while call := self._calls.get_nowait():
                    call[0].cancel()
        for _ in self._threads:
            self._calls.put(None)
        if wait:
            for thread in self._threads:
                thread.join()


class _Worker:
    """A process at the other end of two pipes."""

    process: subprocess.Popen[bytes]

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        self.ready = False
        self.process = subprocess.Popen(
            [sys.executable, "-c", CODE.format(path=sys.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, **ONE_THREAD},
        )

    def call(self, message: bytes) -> bytes:
        """Send a call; return what comes back."""
        to, back = self.process.stdin, self.process.stdout
        assert to is not None and back is not None
        if not self.ready:
            self.ready = pickle.load(back)
        pickle.dump(message, to)
        to.flush()
        return pickle.load(back)

    def end(self) -> str:
        """End the process; return how it ended."""
        to, back = self.process.stdin, self.process.stdout
        assert to is not None and back is not None
        with contextlib.suppress(OSError):
            to.close()  # it ends by itself then, unless it has ended
        back.close()
        code = self.process.wait()
        return f"exit code {code}" if code >= 0 else signal.Signals(-code).name


def serve() -> None:
    """Compute what comes by standard input, until that ends: with the process at the other end, too."""
    calls, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)  # what functions print must not get among the answers
    waiting: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def listen() -> None:
        try:
            while True:
                waiting.put(pickle.load(calls))
        except (EOFError, OSError):
            os._exit(1)  # whatever is being computed, nobody wants it any more

    threading.Thread(target=listen, daemon=True).start()
    import rodnet.simulation
    import rodnet.sweeps.job  # noqa: F401

    answer: Any = True
    while True:
        pickle.dump(answer, answers)
        answers.flush()
        try:
            function, args, kwargs = pickle.loads(waiting.get())
            found = True, function(*args, **kwargs)
        except Exception as error:
            found = False, error
        try:
            answer = pickle.dumps(found)
        except Exception as error:
            answer = pickle.dumps((False, RuntimeError(f"{found[1]!r:.200} cannot be sent back ({error})")))
