"""What may be added to the predictions of a trial beside what its robot does, a share of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from rodnet.recordings.observation import Observation

Fields = Mapping[str, tuple[np.ndarray, ...]]  # by instrument: one for each share, of the readings' shape


@dataclass(frozen=True)
class Corrections:
    """Changes of the readings of one trial.

    Attributes
    ----------
    numerics : mapping
        What a finer time step and a finer mesh change. Each instrument has its own shares of them.
    records : mapping
        What a standard deviation of each error of its drives' records changes. These errors are those of the trial, and
        the first instrument has them for all.
    count : int
        Number of such errors.
    """

    numerics: Fields = field(default_factory=dict)
    records: Fields = field(default_factory=dict)
    count: int = 0

    def put(self, instruments: Sequence[Observation]) -> None:
        """Let instruments have them."""
        for one in instruments:
            one.corrections = self.numerics.get(one.name, ())
            one.misread = self.records.get(one.name, ())
        if instruments and self.count:
            first = instruments[0]
            first.records = first.records.with_value(np.zeros(self.count))


def is_share(path: str) -> bool:
    """Whether a path is that of a share of something that is added to predictions, which are linear in it."""
    return ".numerics[" in path or is_record(path)


def is_record(path: str) -> bool:
    """Whether that is an error of a drive's record."""
    return ".records[" in path
