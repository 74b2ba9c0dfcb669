"""The journal of a sweep: one line per robot, on disk as soon as it is done.

A file of JSON lines that is only appended to: the sweep's identity first, then a record per robot. A
process that is killed while it writes leaves at most a torn last line, which is cut off when the sweep
is taken up again.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rodnet.errors import OutputError

try:
    import fcntl
except ImportError:  # Windows: no lock
    fcntl = None  # type: ignore[assignment]

FORMAT = "rodnet-sweep-2"
SUFFIX = ".jsonl"
_OPEN: set[tuple[int, int]] = set()  # journals of this process, which its own locks do not keep apart

BUSY = "another sweep is under way that writes '{}'; wait for it, or write elsewhere"


def _place(status: os.stat_result) -> tuple[int, int]:
    return status.st_dev, status.st_ino


class Journal:
    """An open journal.

    Parameters
    ----------
    path : Path
        The file; it is made if it is missing.
    identity : mapping
        What every result depends on besides its parameters, as plain values by name.

    Attributes
    ----------
    records : dict
        The newest record by key.

    Raises
    ------
    OutputError
        If the file is of a sweep with another identity (tells what differs), is damaged or something
        else, cannot be written, or another process writes it.
    """

    def __init__(self, path: Path, identity: Mapping[str, Any]) -> None:
        self.path = path
        self.records: dict[str, dict[str, Any]] = {}
        self._opened: tuple[int, int] | None = None
        if path.exists() and _place(path.stat()) in _OPEN:  # to open and close it again would end its lock
            raise OutputError(BUSY.format(path))
        try:
            mode = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0)  # Windows knows text
            self._file = os.open(path, mode, 0o666)
        except OSError as error:
            raise OutputError(f"cannot write '{path}': {error.strerror}; choose another place") from None
        try:
            self._lock()
            self._read(identity)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _lock(self) -> None:
        if fcntl is not None:
            try:  # a record lock: it ends with this process, and no child keeps it
                fcntl.lockf(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except (BlockingIOError, PermissionError):
                raise OutputError(BUSY.format(self.path)) from None
            except OSError:  # a file system without locks
                pass
        self._opened = _place(os.fstat(self._file))
        _OPEN.add(self._opened)

    def _read(self, identity: Mapping[str, Any]) -> None:
        os.lseek(self._file, 0, os.SEEK_SET)
        chunks = iter(lambda: os.read(self._file, 1 << 20), b"")
        whole, newline, torn = b"".join(chunks).rpartition(b"\n")
        lines = whole.split(b"\n") if newline else []
        if torn:
            beginning = b'{"format"'
            if not lines and not beginning.startswith(torn[: len(beginning)]):
                raise OutputError(f"'{self.path}' is not the journal of a sweep; write elsewhere")
            os.ftruncate(self._file, len(whole) + len(newline))
        if not lines:
            self._write({"format": FORMAT, "identity": dict(identity)})
            return
        parsed = []
        for number, line in enumerate(lines, 1):
            try:
                value = json.loads(line)
                if not isinstance(value, dict) or (number > 1 and "key" not in value):
                    raise ValueError
            except ValueError:
                raise OutputError(
                    f"line {number} of '{self.path}' is damaged; delete that line to compute its robot again"
                    if number > 1
                    else f"'{self.path}' is not the journal of a sweep; write elsewhere"
                ) from None
            parsed.append(value)
        head, *records = parsed
        if head.get("format") != FORMAT:
            raise OutputError(f"'{self.path}' is not the journal of a sweep; write elsewhere")
        if not records:  # a sweep that never got to a result binds nobody
            os.ftruncate(self._file, 0)
            self._write({"format": FORMAT, "identity": dict(identity)})
        else:
            self._compare(head.get("identity", {}), json.loads(json.dumps(dict(identity))))
        self.records = {record["key"]: record for record in records}

    def _compare(self, then: Mapping[str, Any], now: Mapping[str, Any]) -> None:
        differing = [k for k in {**then, **now} if then.get(k) != now.get(k)]
        if differing:
            told = "; ".join(_difference(k, then.get(k), now.get(k)) for k in differing)
            raise OutputError(
                f"'{self.path}' holds results of another sweep, not to be mixed with these: {told}. "
                f"Choose another file for this one, or delete that one to compute everything anew"
            )

    def add(self, record: dict[str, Any]) -> None:
        """Append a record, which has a ``key``; it is on disk when this returns."""
        self._write(record)
        self.records[record["key"]] = record

    def _write(self, value: Mapping[str, Any]) -> None:
        data = json.dumps(value).encode() + b"\n"
        try:
            while data:
                data = data[os.write(self._file, data) :]
            os.fsync(self._file)
        except OSError as error:
            raise OutputError(f"cannot write '{self.path}': {error.strerror}") from None

    def close(self) -> None:
        """Close the file, which releases it to other sweeps."""
        if self._opened is not None:
            _OPEN.discard(self._opened)
        os.close(self._file)


def _difference(name: str, then: Any, now: Any) -> str:
    if isinstance(then, dict) and isinstance(now, dict) and then.get("name") == now.get("name"):
        return f"the code or the values of {name} ({now['name']}) have changed"
    show = lambda v: v["name"] if isinstance(v, dict) and "name" in v else v  # noqa: E731
    return f"{name} was {show(then)} and is now {show(now)}"
