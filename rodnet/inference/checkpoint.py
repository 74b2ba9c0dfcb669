"""What a search has found so far, on disk: after Ctrl-C or a crash the same calibration goes on from there."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import rodnet
from rodnet.inference.quantities import Quantity
from rodnet.recordings.recording import Recording
from rodnet.storage import check_writable

if TYPE_CHECKING:
    from rodnet.inference.case import Case
    from rodnet.inference.comparison import Comparison

FORMAT = "rodnet-search-1"


class Checkpoint:
    """A file with the best place of every start, replaced as a whole whenever a better one is found.

    Parameters
    ----------
    path : path
        The file.
    identity : str
        Of the calibration: the file of another one is not used, and replaced.

    Attributes
    ----------
    places : dict
        Best coordinates by stage: ``"start 1"``, ``"start 2"``, ...
    done : dict
        Of the stages that have ended: cost, success and message.
    """

    def __init__(self, path: str | Path, identity: str) -> None:
        self.path, self.identity = Path(path), identity
        self.places: dict[str, list[float]] = {}
        self.done: dict[str, dict[str, Any]] = {}
        known = self.path.exists()
        check_writable(self.path)
        try:
            record = json.loads(self.path.read_text(encoding="utf-8"))
            if record["format"] == FORMAT and record["identity"] == identity:
                self.places, self.done = dict(record["places"]), dict(record["done"])
        except (OSError, ValueError, KeyError, TypeError):
            if not known:
                self.path.unlink(missing_ok=True)

    def better(self, stage: str, z: np.ndarray) -> None:
        """Keep a place that is better than all before of this stage."""
        self.places[stage] = np.asarray(z, dtype=float).tolist()
        self._write()

    def ended(self, stage: str, z: np.ndarray, cost: float, success: bool, message: str) -> None:
        """Keep where a stage has ended."""
        self.done[stage] = {"cost": cost, "success": success, "message": message}
        self.better(stage, z)

    def _write(self) -> None:
        record = {
            "format": FORMAT, "identity": self.identity, "places": self.places, "done": self.done,
        }  # fmt: skip
        draft = self.path.with_name(f"{self.path.name}.{os.getpid()}")
        draft.write_text(json.dumps(record), encoding="utf-8")
        draft.replace(self.path)


def identity(
    case: Case, trials: Sequence[Comparison], quantities: Sequence[Quantity], fixed: Any, options: Any
) -> str:
    """Return what everything that a search finds depends on, as 64 hexadecimal digits.

    Data files that ``build`` or another function of the case reads cannot be seen: give another file after a change of
    these, or delete it.
    """
    from rodnet.sweeps.fingerprint import fingerprint, packages

    functions = [case.build, case.observe, case.options, case.cut, *case.tied.values()]
    parts: list[Any] = [rodnet.__version__, sorted(case.tied), fixed, options, code(case)]
    parts += [None if f is None else fingerprint(f) for f in functions]
    parts += [(q.path, q.trial, q.start, q.low, q.high, q.scale, q.log, *_prior(q.prior)) for q in quantities]
    parts += packages(t.__module__ for trial in trials for t in (*trial.robot.terms, *trial.instruments))
    for trial in trials:
        parts += [content(trial.rec), {name: model.to_dict() for name, model in trial.noise.items()}]
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def code(case: Case) -> list[Any]:
    """Hashes of a case's file, and of what that or the files of its functions have imported from beside themselves."""
    from rodnet.sweeps.fingerprint import sources

    beside = sources([*vars(case).values(), *case.tied.values()], case.path)
    if case.path is None or not case.path.is_file():
        return [*beside]
    return [hashlib.sha256(case.path.read_bytes()).hexdigest(), *beside]


def content(rec: Recording) -> tuple[str, str, str]:
    """Whatever a recording says: its name, and hashes of its samples and of all that is known of them."""
    from rodnet.sweeps.fingerprint import fingerprint

    known = [rec.names, rec.edges, rec.prescribed, rec.planar, rec.group, rec.attrs, rec.meta, rec.noise]
    return rec.name, rec.digest, fingerprint(known)


def _prior(prior: Any) -> tuple[Any, ...]:
    """What tells one frozen distribution from another."""
    if prior is None:
        return ()
    return tuple(float(prior.ppf(p)) for p in (0.1, 0.5, 0.9))
