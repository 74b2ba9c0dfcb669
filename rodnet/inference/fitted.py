"""What a calibration found, as a small file that a prediction reads."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from rodnet.errors import CaseError, OutputError
from rodnet.parameters import is_number

FILE, FORMAT, VERSION = "fitted.json", "rodnet-fitted", 1


@dataclass(frozen=True)
class FittedValue:
    """One parameter.

    Parameters
    ----------
    value : float or list of float
        Fitted value, SI.
    unit : str
        SI unit.
    low, high : float or None
        Ends of its 95 % interval, where one was found.
    """

    value: Any
    unit: str = "1"
    low: Any = None
    high: Any = None


@dataclass(frozen=True)
class Fitted:
    """Fitted values of a case's parameters, the same for every trial.

    Saved as ``fitted.json`` in a directory::

        {"format": "rodnet-fitted", "version": 1, "case": "dlo",
         "parameters": {"cable.E": {"value": 4e7, "unit": "Pa", "low": 3.8e7, "high": 4.2e7}},
         "recordings": ["train_000.npz"], "notes": {}}

    Parameters
    ----------
    case : str
        Name of the case.
    parameters : mapping
        Path -> `FittedValue`: of the robot (``"cable.E"``) or of an observation (``"markers.lag"``).
    recordings : sequence of str
        Files that it was fitted to, as they were given.
    notes : mapping
        Whatever else is worth keeping; nothing reads it.
    baselines : mapping
        Simpler models that were fitted to the same recordings, by name, as `stored` has them.
    """

    case: str
    parameters: Mapping[str, FittedValue]
    recordings: Sequence[str] = ()
    notes: Mapping[str, Any] = field(default_factory=dict)
    baselines: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def values(self) -> dict[str, Any]:
        """Values by path."""
        return {path: p.value for path, p in self.parameters.items()}

    def save(self, directory: str | Path) -> Path:
        """Write ``fitted.json`` into a directory, which is made if need be; return its path.

        Raises
        ------
        OutputError
            If it cannot be written.
        """
        from rodnet.numbers import plain

        record = {
            "format": FORMAT,
            "version": VERSION,
            "case": self.case,
            "parameters": {path: vars(p) for path, p in self.parameters.items()},
            "recordings": [str(r) for r in self.recordings],
            "notes": dict(self.notes),
            "baselines": dict(self.baselines),
        }
        path = Path(directory) / FILE
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(plain(record), indent=1, allow_nan=False) + "\n", encoding="utf-8")
        except (OSError, ValueError, TypeError) as error:
            raise OutputError(f"cannot write '{path}': {error}") from None
        return path

    @classmethod
    def load(cls, directory: str | Path) -> Fitted:
        """Read ``fitted.json`` from a directory, or such a file itself.

        Raises
        ------
        CaseError
            If there is none, or it is not what `save` writes.
        """
        path = Path(directory)
        path = path / FILE if path.is_dir() else path
        if not path.is_file():
            raise CaseError(f"there is no fitted model at '{directory}': a directory with {FILE} is expected")
        try:
            record = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            raise CaseError(f"cannot read '{path}': {error}") from None
        if not isinstance(record, dict) or record.get("format") != FORMAT:
            raise CaseError(f'\'{path}\' is not a fitted model: it lacks "format": "{FORMAT}"')
        if record.get("version") != VERSION:
            raise CaseError(
                f"'{path}' is of version {record.get('version')!r}, this rodnet reads {VERSION}; fit again"
            )
        parameters = record.get("parameters")
        if not isinstance(parameters, dict):
            raise CaseError(f"'{path}': \"parameters\" must be an object of values by path")
        if not isinstance(record.get("baselines") or {}, dict):
            raise CaseError(f"'{path}': \"baselines\" must be an object of models by name")
        names = record.get("recordings", [])
        return cls(
            str(record.get("case", "")),
            {name: _value(path, name, entry) for name, entry in parameters.items()},
            [str(n) for n in names] if isinstance(names, list) else [],
            record.get("notes") or {},
            record.get("baselines") or {},
        )


def _value(path: Path, name: str, entry: Any) -> FittedValue:
    """Check one entry of a file."""
    if not isinstance(entry, dict) or "value" not in entry:
        raise CaseError(f"'{path}': parameter '{name}' must be an object with a \"value\", got {entry!r:.80}")
    unknown = sorted(set(entry) - {"value", "unit", "low", "high"})
    if unknown:
        raise CaseError(f"'{path}': parameter '{name}' has unknown entries {', '.join(unknown)}")
    for key in ("value", "low", "high"):
        value = entry.get(key)
        if value is None and key != "value":
            continue
        numbers = value if isinstance(value, list) else [value]
        if not numbers or not all(
            is_number(v) and math.isfinite(v) for v in np.ravel(np.array(numbers, dtype=object))
        ):
            raise CaseError(f"'{path}': {key} = {value!r:.80} of '{name}' must be a finite number")
    return FittedValue(entry["value"], str(entry.get("unit", "1")), entry.get("low"), entry.get("high"))
