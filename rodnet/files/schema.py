"""What the keys of a robot file hold, and how its text becomes plain values: everything that is not so is an error."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rodnet.errors import OutputError, RobotFileError, RodnetError

DEEPEST = 16  # tables and lists within each other; what rodnet writes has 6
LARGEST = 2**53  # whole numbers up to here are exact as floats


# -- kinds of values ------------------------------------------------------------------------
def _shape(value: Any) -> tuple[int, ...] | None:
    """Shape of a number or of nested lists of numbers; None for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float | list):
        return None
    if not isinstance(value, list):
        return ()
    shapes = {_shape(v) for v in value}
    if len(shapes) > 1 or None in shapes:
        return None
    return (len(value), *(shapes.pop() or ())) if shapes else (0,)


def _words(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(v, str) for v in value)


KINDS = {
    "text": lambda v: isinstance(v, str),
    "true or false": lambda v: isinstance(v, bool),
    "a whole number": lambda v: isinstance(v, int) and not isinstance(v, bool),
    "a number": lambda v: _shape(v) == (),
    "a number or a list of numbers": lambda v: (shape := _shape(v)) is not None and len(shape) < 2,
    "a number, or a list of numbers or of rows of numbers": lambda v: _shape(v) is not None,
    "a number, a list with one per edge, or a table {start, end}": lambda v: (
        isinstance(v, dict) or ((shape := _shape(v)) is not None and len(shape) < 2)
    ),
    "a pair of numbers": lambda v: _shape(v) == (2,),
    "three numbers [x, y, z]": lambda v: _shape(v) == (3,),
    "three rows of three numbers": lambda v: _shape(v) == (3, 3),
    "three numbers, or three rows of three": lambda v: _shape(v) in ((3,), (3, 3)),
    "rows of three numbers": lambda v: (shape := _shape(v)) is not None and shape[1:] == (3,),
    "text or a list of texts": lambda v: isinstance(v, str) or _words(v),
    "a list of texts": _words,
    "a list of points, each [x, y, z] or text as 'rod.end'": lambda v: (
        isinstance(v, list) and all(isinstance(p, str) or _shape(p) == (3,) for p in v)
    ),
    "one table": lambda v: isinstance(v, dict),
    "tables": lambda v: isinstance(v, list),
    "a table": lambda v: isinstance(v, dict),
    "a table, or a list of tables": lambda v: (
        isinstance(v, dict) or (isinstance(v, list) and all(isinstance(t, dict) for t in v))
    ),
}


def check_table(
    what: str, table: Mapping[str, Any], known: Mapping[str, str], needed: tuple[str, ...] = ()
) -> None:
    """Raise `RobotFileError` for keys of a table that mean nothing, are missing, or hold something else.

    Parameters
    ----------
    what : str
        The table, for messages.
    table : mapping
        What the file says.
    known : mapping
        What each key holds, a key of ``KINDS``.
    needed : tuple of str
        Keys that must not be missing.
    """
    unknown = sorted(set(table) - set(known))
    if unknown:
        close = difflib.get_close_matches(unknown[0], known, n=1)
        meant = f" (did you mean {close[0]}?)" if close else ""
        raise RobotFileError(
            f"{what} has the unknown key{'s' * (len(unknown) > 1)} {', '.join(unknown)}{meant}; known are "
            f"{', '.join(sorted(known))}"
        )
    for key in needed:
        if key not in table:
            raise RobotFileError(f"{what} has no '{key}'; add {key} = ..., {known[key]}")
    for key, value in table.items():
        if not KINDS[known[key]](value):
            raise RobotFileError(f"{what}: {key} = {shown(value)} must be {known[key]}")


def shown(value: Any) -> str:
    """Return a value as text, short enough for a message."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


@contextmanager
def reading(what: str) -> Iterator[None]:
    """Turn whatever goes wrong within into a `RobotFileError` that names the table."""
    try:
        yield
    except RobotFileError:
        raise
    except RodnetError as error:
        # "rod 'arm': ..." becomes "[[rod]] 'arm': ...", instead of naming the rod twice
        text, name = str(error), what.partition(" ")[2]
        named = re.match(rf"[a-z ]*{re.escape(name)}(?=[: ])", text) if name else None
        raise RobotFileError(what + text[named.end() :] if named else f"{what}: {text}") from error
    except MemoryError:
        raise RobotFileError(f"{what} is too large for this machine's memory") from None
    except Exception as error:  # a law of a plug-in may raise anything for arguments that it did not expect
        detail = f"{type(error).__name__}: {error}"
        raise RobotFileError(
            f"{what} cannot be made of these values ({detail}); see docs, robot files"
        ) from error


# -- text -----------------------------------------------------------------------------------
def read_text(path: str | Path) -> str:
    """Return the text of a file, without the byte order mark that some editors put before it."""
    try:
        return Path(path).read_text(encoding="utf-8-sig")
    except OSError as error:
        raise OutputError(f"cannot read '{path}': {error.strerror}") from None
    except UnicodeDecodeError:
        raise RobotFileError(f"'{path}' is not a text file in UTF-8") from None


def plain_values(text: str) -> dict[str, Any]:
    """Return what a TOML text says, checked to be of plain values that are not nested without end.

    Raises
    ------
    RobotFileError
        For a text that is not TOML, names the line; for values that no robot has, names the key.
    """
    try:
        document = tomllib.loads(text)
    except RecursionError:
        raise RobotFileError("lists or tables are nested too deeply to be read") from None
    except tomllib.TOMLDecodeError as error:
        raise RobotFileError(f"not TOML: {error}") from None
    except ValueError as error:  # Python refuses to read integers of thousands of digits
        raise RobotFileError(f"a value cannot be read: {error}") from None
    waiting: list[tuple[str, Any, int]] = [(key, value, 1) for key, value in document.items()]
    while waiting:  # not by recursion, which is what deep nesting would break
        where, value, depth = waiting.pop()
        if depth > DEEPEST:
            top = where.partition(".")[0].partition("[")[0]
            raise RobotFileError(f"'{top}': lists or tables are nested more than {DEEPEST} deep")
        if isinstance(value, dict):
            waiting += [(f"{where}.{key}", v, depth + 1) for key, v in value.items()]
        elif isinstance(value, list):
            waiting += [(f"{where}[{k}]", v, depth + 1) for k, v in enumerate(value)]
        elif isinstance(value, int) and abs(value) > LARGEST:
            raise RobotFileError(f"{where}: this whole number is too large; write it as 1e20")
        elif not isinstance(value, str | int | float):
            raise RobotFileError(
                f"{where} = {value} is a date or time, which no robot has; quote it if it is text"
            )
    return document
