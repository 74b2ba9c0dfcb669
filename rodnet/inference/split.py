"""Which recordings are fitted, which are predicted to judge the fit, and which nobody looks at until the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from glob import glob
from pathlib import Path

import numpy as np

from rodnet.errors import ParameterError
from rodnet.names import listed
from rodnet.recordings.files import read_recordings
from rodnet.recordings.recording import Recording, by_group

SHARE = 0.2  # of the groups, of what is held out and of what confirms
SEED = 60_20_20  # of the order in which groups are dealt: not that in which they were recorded


@dataclass(frozen=True)
class Split:
    """Recordings in three parts.

    Attributes
    ----------
    train : list of Recording
        What is fitted.
    held_out : list of Recording
        What is predicted to judge the fit.
    confirm : list of Recording
        What is left alone until everything has been chosen.
    how : str
        How they were told apart, in words.
    """

    train: list[Recording]
    held_out: list[Recording]
    confirm: list[Recording]
    how: str

    def __str__(self) -> str:
        names = lambda recs: ", ".join(rec.name for rec in recs) or "none"  # noqa: E731
        return (
            f"fitted: {names(self.train)}; held out: {names(self.held_out)}; left alone to confirm: "
            f"{names(self.confirm)} ({self.how})"
        )


def split(
    recordings: Sequence[Recording], hold_out: Sequence[str] = (), confirm: Sequence[str] = ()
) -> Split:
    """Split recordings by patterns, or without any by group, 60/20/20.

    Frames of one trial share what nobody knows of it, and trials of one group (specimen, day) more than others:
    they are never divided. The same groups are always dealt in the same way.

    Parameters
    ----------
    recordings : sequence of Recording
        All there are.
    hold_out, confirm : sequence of str
        Patterns of file names, files, folders, or ``"group=..."`` of groups.

    Raises
    ------
    ParameterError
        If a pattern fits none, or nothing is left to fit.
    """
    recordings = list(recordings)
    if not recordings:
        raise ParameterError("there are no recordings to split")
    if not hold_out and not confirm:
        return _by_share(recordings)
    for option, patterns in (("--hold-out", hold_out), ("--confirm", confirm)):
        for pattern in patterns:
            if not any(_fits(rec, pattern) for rec in recordings):
                raise ParameterError(
                    f"{option} {pattern!r} fits no recording; {listed(rec.name for rec in recordings)}"
                )
    kept = [rec for rec in recordings if any(_fits(rec, p) for p in confirm)]
    held = [rec for rec in recordings if any(_fits(rec, p) for p in hold_out)]
    if both := [rec.name for rec in held if any(rec is k for k in kept)]:
        raise ParameterError(
            f"{', '.join(both)} would be held out and left alone to confirm; a recording is for one of them: name it "
            "in --hold-out or in --confirm"
        )
    train = [rec for rec in recordings if not any(rec is one for one in (*kept, *held))]
    if not train:
        raise ParameterError("--hold-out and --confirm leave nothing to fit")
    asked = [option for option, patterns in (("--hold-out", hold_out), ("--confirm", confirm)) if patterns]
    return Split(train, held, kept, f"by {' and '.join(asked)}")


def read_split(paths: Sequence[str], hold_out: Sequence[str] = (), confirm: Sequence[str] = ()) -> Split:
    """Read recordings and split them; what is held out may also be files and folders beside ``paths``.

    Parameters
    ----------
    paths : sequence of str
        As for `rodnet.read_recordings`.
    hold_out, confirm : sequence of str
        As for `split`; what fits none of the recordings is read.

    Raises
    ------
    ParameterError
        As by `split`.
    RecordingError
        As by `rodnet.read_recordings`.
    """
    recordings = read_recordings(paths)
    for pattern in (*hold_out, *confirm):
        if any(_fits(rec, pattern) for rec in recordings) or not _exists(pattern):
            continue
        recordings += read_recordings(pattern)
    return split(recordings, hold_out, confirm)


def _exists(pattern: str) -> bool:
    return not pattern.startswith("group=") and (Path(pattern).exists() or bool(glob(pattern)))


def _fits(rec: Recording, pattern: str) -> bool:
    if pattern.startswith("group="):
        return fnmatch(rec.group, pattern.removeprefix("group="))
    if rec.path is None:
        return fnmatch(rec.name, pattern)
    here, asked = rec.path.resolve(), str(Path(pattern).resolve())
    names = {rec.name: pattern, rec.path.name: pattern, str(here): asked, str(here.parent): asked}
    return any(fnmatch(name, wanted) for name, wanted in names.items())


def _by_share(recordings: list[Recording]) -> Split:
    groups = by_group(recordings)
    names = sorted(groups)
    count = len(names)
    order = [names[k] for k in np.random.default_rng(SEED).permutation(count)]
    size = max(round(SHARE * count), 1)
    held = order[:size] if count > 1 else []
    kept = order[size : 2 * size] if count > 2 else []
    pick = lambda among: [rec for rec in recordings if rec.group in among]  # noqa: E731
    rest = set(names) - set(held) - set(kept)
    unit = "trial" if count == len(recordings) else "group"
    return Split(pick(rest), pick(held), pick(kept), f"split by {unit}, 60/20/20")
