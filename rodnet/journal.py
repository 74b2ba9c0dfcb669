"""A crash-safe journal of finished jobs: one line of JSON each, flushed to the disk."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from rodnet.errors import OutputError

FORMAT = "rodnet-sweep-1"


class Journal:
    """Results of jobs by key, kept in a file that survives being killed at any moment.

    Parameters
    ----------
    path : Path or None
        The file; None keeps results in memory only.
    identity : dict
        What makes results comparable, of plain values; a file of another identity is refused.

    Raises
    ------
    OutputError
        If the file is of another study, of another kind, or cannot be written.
    """

    def __init__(self, path: Path | None, identity: dict[str, Any]) -> None:
        self.path, self.results = path, {}
        self._file: Any = None
        if path is None:
            return
        kept = self._read(path, identity) if path.exists() else 0
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("ab")
            self._file.truncate(kept)  # a line that was being written when the process died
        except OSError as error:
            raise OutputError(f"cannot write '{path}': {error.strerror}; choose another place") from None
        if not kept:
            self._write({"format": FORMAT, "identity": identity})

    results: dict[str, dict[str, Any]]

    def _read(self, path: Path, identity: dict[str, Any]) -> int:
        """Read whole lines; return how many bytes they take."""
        try:
            text = path.read_bytes()
        except OSError as error:
            raise OutputError(f"cannot read '{path}': {error.strerror}") from None
        kept = text.rfind(b"\n") + 1
        if not kept and b'{"format"'.startswith(text[:9]):  # killed while the first line was being written
            return 0
        try:
            head, *lines = (json.loads(line) for line in text[:kept].splitlines())
            if head["format"] != FORMAT:
                raise ValueError("another format")
            before = head["identity"]
            self.results = {line["key"]: line["result"] for line in lines}
        except (ValueError, KeyError, TypeError):
            raise OutputError(
                f"'{path}' is no journal of a sweep; move it away or choose another out="
            ) from None
        changed = [k for k in {**before, **identity} if before.get(k) != identity.get(k)]
        if changed:
            raise OutputError(
                f"'{path}' holds results of another sweep: {', '.join(changed)} changed since. Choose another out=, "
                "or remove that file to compute everything anew"
            )
        return kept

    def add(self, key: str, result: dict[str, Any]) -> None:
        """Keep the result of a job."""
        self.results[key] = result
        if self._file is not None:
            self._write({"key": key, "result": result})

    def _write(self, line: dict[str, Any]) -> None:
        self._file.write(json.dumps(line).encode() + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
