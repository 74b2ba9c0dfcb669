"""Ctrl-C that waits for a good moment: a step is never torn, and no request is lost.

Python raises KeyboardInterrupt wherever the interpreter happens to be. Inside a finaliser or a weak
reference's callback it is printed and forgotten, and a run would go on as if nobody had asked.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any


class Interrupt:
    """Whether somebody asked to stop (SIGINT), and whether that was heeded."""

    def __init__(self) -> None:
        self.requested = False
        self.heeded = False

    def check(self) -> bool:
        """Return True if asked to stop; the caller then does."""
        self.heeded = self.requested
        return self.heeded


@contextmanager
def deferred_interrupt() -> Iterator[Interrupt]:
    """Keep the first Ctrl-C until the loop inside asks for it; the second raises at once.

    A request that the loop never asked for raises KeyboardInterrupt at the end. Only Python's own
    handler is replaced: an application's, or an ignored signal, stays as it is, and so does everything in
    threads, which get no signals.
    """
    interrupt = Interrupt()
    ours = threading.current_thread() is threading.main_thread()
    if not ours or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield interrupt
        return

    def request(number: int, frame: FrameType | None) -> Any:
        if interrupt.requested:
            signal.default_int_handler(number, frame)
        interrupt.requested = True

    signal.signal(signal.SIGINT, request)
    try:
        yield interrupt
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if interrupt.requested and not interrupt.heeded:
        raise KeyboardInterrupt
