"""Results of the stages of a diagnosis on disk: after an interruption it goes on from the last finished one."""

from __future__ import annotations

import hashlib
import io
import os
import pickle
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import rodnet
from rodnet import registry
from rodnet.diagnosis.candidate import Candidate
from rodnet.errors import RodnetError
from rodnet.inference.case import Case
from rodnet.inference.checkpoint import code, content
from rodnet.recordings.recording import Recording
from rodnet.storage import check_writable

FORMAT = "rodnet-stages-1"
FOLDER = "stages"
FUNCTIONS = (
    "build",
    "observe",
    "options",
    "tied",
    "drives",
    "metric",
    "cut",
    "kind",
    "baselines",
    "candidates",
    "noise",
)

FAILURES = (RodnetError, ArithmeticError, ValueError)  # that end what a verdict can do without

Result = TypeVar("Result")


class Stages:
    """Stages by name: each is computed once, kept in a file, and read from it when the same diagnosis is run again.

    What a diagnosis is given (the case, its functions, recordings, candidates, the executor) is not written into
    the files but referred to by name; so a case may hold functions that cannot be pickled. The files are Python
    pickles: continue in directories of your own only.

    Parameters
    ----------
    directory : path or None
        Where the files are; nothing is kept without.
    identity : str
        Of the diagnosis: each has a folder of its own, so that none takes another's place.
    known : mapping
        What is referred to by name.
    tell : callable
        Told what is taken from an earlier run.

    Attributes
    ----------
    seconds : float
        That the stages took which an earlier run has finished.
    """

    def __init__(
        self, directory: Path | None, identity: str, known: Mapping[str, Any],
        tell: Callable[[str], None] = lambda text: None,
    ) -> None:  # fmt: skip
        self.known, self.tell, self.seconds = dict(known), tell, 0.0
        self._count: Counter[str] = Counter()
        self.folder: Path | None = None
        if directory is None:
            return
        every = Path(directory) / FOLDER
        self.folder = every / hashlib.sha256(f"{FORMAT} {identity}".encode()).hexdigest()[:12]
        if not self.folder.is_dir() and every.is_dir() and any(every.iterdir()):
            tell(
                "the case, the recordings, the options or rodnet have changed since the last run: from the start; "
                f"'{every}' keeps what the last one has computed"
            )
        check_writable(self.folder / "stage.pkl")

    def __call__(self, name: str, compute: Callable[..., Result], *arguments: Any) -> Result:
        """Return ``compute(*arguments)``: what an earlier run has kept, or a new result, which is kept."""
        began = time.monotonic()
        if self.folder is None:
            return compute(*arguments)
        self._count[name] += 1  # what is done between, as a bootstrap, moves no other stage
        path = self.folder / f"{name.replace(' ', '-')}-{self._count[name]}.pkl"
        try:
            seconds, result = self._read(path)
        except FileNotFoundError:
            pass
        except Exception as error:  # a torn disk, another version of a library: whatever it is, compute again
            self.tell(f"'{path}' cannot be read ({type(error).__name__}: {error}): computing it again")
        else:
            self.tell(f"taken from the earlier run: {name} ({seconds:.1f} s)")
            self.seconds += seconds
            return result
        result = compute(*arguments)
        self._write(path, (time.monotonic() - began, result))
        return result

    def _read(self, path: Path) -> Any:
        with path.open("rb") as file:
            return _Reader(file, self.known).load()

    def _write(self, path: Path, thing: Any) -> None:
        assert self.folder is not None
        stream = io.BytesIO()
        try:
            _Writer(stream, self.known).dump(thing)
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            self.tell(f"this stage cannot be kept for a later run: {error}")
            return
        draft = path.with_name(f"{path.name}.{os.getpid()}")
        with draft.open("wb") as file:
            file.write(stream.getbuffer())
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)


class _Writer(pickle.Pickler):
    def __init__(self, file: Any, known: Mapping[str, Any]) -> None:
        super().__init__(file, protocol=5)
        self.names = {id(thing): name for name, thing in known.items()}

    def persistent_id(self, thing: Any) -> str | None:
        return self.names.get(id(thing))


class _Reader(pickle.Unpickler):
    def __init__(self, file: Any, known: Mapping[str, Any]) -> None:
        super().__init__(file)
        self.known = known

    def persistent_load(self, name: str) -> Any:
        return self.known[name]


def named(
    case: Case, recordings: Mapping[str, Sequence[Recording]], candidates: Sequence[Candidate], **others: Any
) -> dict[str, Any]:
    """Names of what every run of a diagnosis has anyway."""
    found: dict[str, Any] = {"case": case, **others}
    for name in FUNCTIONS:
        if getattr(case, name):
            found[f"case.{name}"] = getattr(case, name)
    for part, recs in recordings.items():
        found |= {f"{part}[{k}]": rec for k, rec in enumerate(recs)}
    return found | {f"candidate {c.id}": c for c in candidates}


def identity(
    case: Case, recordings: Mapping[str, Sequence[Recording]], candidates: Sequence[Candidate], options: Any
) -> str:
    """Return what everything that a diagnosis finds depends on, as 64 hexadecimal digits.

    The sources of all plug-ins that are installed are part of it. Data files that ``build`` or another function of the
    case reads cannot be seen: after a change of these continue in another directory, or delete the stages.
    """
    from rodnet.sweeps.fingerprint import fingerprint, packages

    first = case.part(next(rec for recs in recordings.values() for rec in recs))
    robot = case.robot(first)
    own = [thing.__module__ for thing in (*robot.terms, *case.observations(first, robot))]
    parts: list[Any] = [rodnet.__version__, _sources(), case.name, tuple(case.free), tuple(case.per_trial)]
    parts += packages([*registry.plug_ins(), *own])
    parts += [code(case), *(fingerprint(getattr(case, name)) for name in FUNCTIONS)]
    for part, recs in recordings.items():
        parts += [(part, *content(rec)) for rec in recs]
        if case.kind is None:  # they are summed up by their folders
            parts.append([case.kind_of(rec) for rec in recs])
    parts += [(c.id, fingerprint(c)) for c in candidates]
    parts.append(fingerprint(options))
    return hashlib.sha256(repr(parts).encode()).hexdigest()


@cache
def _sources() -> str:
    """Hash of the package's own sources: a result of other code is not taken up."""
    sha, root = hashlib.sha256(), Path(rodnet.__file__).parent
    for path in sorted(root.rglob("*.py")):
        sha.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return sha.hexdigest()
