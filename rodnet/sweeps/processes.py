"""Processes of this machine that compute, as a `concurrent.futures.Executor` that survives their death.

`concurrent.futures.ProcessPoolExecutor` breaks down with everything under way when one of its processes is
killed. Here every process is handed one call at a time by a thread of its own: the call that kills it is known.
They are forked from a process that has imported rodnet and does nothing else ("forkserver"; where there is
none, each starts on its own).
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import queue
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError, Executor, Future
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from rodnet.errors import SweepError

TRIES = 2  # the process of a call may be killed for what another one needs
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "NUMBA_NUM_THREADS"),
    "1",
)  # fmt: skip


def get_ready() -> Any:
    """Return how processes start; the one that they are forked from gets ready from now on, in the background."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    from multiprocessing import forkserver

    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["rodnet.sweeps.warm"])
    before = dict(os.environ)
    os.environ.update(ONE_THREAD)
    masked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # Ctrl-C is for the first process
    try:
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, masked)
        for name in ONE_THREAD:
            os.environ.pop(name, None)
        os.environ.update({name: before[name] for name in ONE_THREAD if name in before})
    return context


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


class ProcessDied(RuntimeError):
    """The process of a call ended without a word."""


class Processes(Executor):
    """So many processes; functions and arguments are pickled.

    Parameters
    ----------
    count : int
        Number of processes, each with one thread for linear algebra.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._context = get_ready()
        self._calls: queue.SimpleQueue[tuple[Future[Any], bytes] | None] = queue.SimpleQueue()
        self._lock = threading.Lock()  # no process is started while all are being ended
        self._closing = False
        self._workers: list[_Worker] = []
        self._threads: list[threading.Thread] = []

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call the function in the next process that is free."""
        future: Future[Any] = Future()
        self._calls.put((future, pickle.dumps((function, args, kwargs))))
        while (
            len(self._threads) < self.count
        ):  # the first time: what they are forked from had time to get ready
            self._workers.append(_Worker(self._context))
            self._threads.append(threading.Thread(target=self._hand, args=(self._workers[-1],), daemon=True))
            self._threads[-1].start()
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
                answer = worker.call(message)
            except (OSError, EOFError):
                ready, how = worker.ready, worker.end()
                with self._lock:
                    if self._closing:
                        raise CancelledError from None
                    worker.start()
                if not ready:
                    raise SweepError(f"the worker processes do not start ({how})") from None
            else:
                return pickle.loads(answer)
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
    """A process at the other end of a pipe."""

    process: BaseProcess

    def __init__(self, context: Any) -> None:
        self._context = context
        self.start()

    def start(self) -> None:
        self.ready = False
        self._pipe, there = self._context.Pipe()
        self.process = self._context.Process(target=serve, args=(there, os.getcwd(), dict(os.environ)))
        with _script_stays_here():
            self.process.start()
        there.close()

    def call(self, message: bytes) -> bytes:
        """Send a call; return what comes back."""
        if not self.ready:
            self.ready = bool(self._pipe.recv_bytes())
        self._pipe.send_bytes(message)
        return self._pipe.recv_bytes()

    def end(self) -> str:
        """End the process; return how it ended."""
        self._pipe.close()  # it ends by itself then, unless it has ended
        self.process.join()
        code = self.process.exitcode or 0
        return f"exit code {code}" if code >= 0 else signal.Signals(-code).name


def serve(pipe: Connection, folder: str, environment: Mapping[str, str]) -> None:
    """Compute what comes, until the process at the other end has gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.chdir(folder)  # these are of now, not of when processes began to be forked
    os.environ.clear()
    os.environ.update(environment)
    waiting: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def listen() -> None:
        try:
            while True:
                waiting.put(pipe.recv_bytes())
        except (EOFError, OSError):
            os._exit(1)  # whatever is being computed, nobody wants it any more

    threading.Thread(target=listen, daemon=True).start()
    pipe.send_bytes(b"ready")
    while True:
        try:
            function, args, kwargs = pickle.loads(waiting.get())
            found = True, function(*args, **kwargs)
        except Exception as error:
            found = False, error
        try:
            answer = pickle.dumps(found)
        except Exception as error:
            answer = pickle.dumps((False, RuntimeError(f"{found[1]!r:.200} cannot be sent back ({error})")))
        pipe.send_bytes(answer)
