"""A sweep under way: what is known, what is missing, and how it gets computed and kept."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rodnet
from rodnet.errors import ParameterError
from rodnet.sweeps.collect import collect, greet
from rodnet.sweeps.dataset import check_metrics, import_writer, make_dataset, write
from rodnet.sweeps.job import ContractError, describe, load, pack, run_point
from rodnet.sweeps.journal import Journal
from rodnet.sweeps.meter import Meter, SweepProgress
from rodnet.sweeps.points import Points

if TYPE_CHECKING:
    import xarray as xr

WRITE_EVERY = 30.0  # seconds after which the dataset on disk is brought up to date


@dataclass
class Study:
    """A sweep with its records.

    Parameters
    ----------
    packed : bytes
        The task, as workers read it.
    points : Points
        What is to be computed.
    attributes : dict
        Global attributes of the dataset; ``status`` is kept up to date.
    units : dict
        Units by name that the caller gives.
    journal : Journal, optional
        Where records are kept.
    out : Path, optional
        The dataset's file.
    records : dict
        Records by key (see `rodnet.sweeps.job.run_point`).
    """

    packed: bytes
    points: Points
    attributes: dict[str, Any]
    units: dict[str, str]
    journal: Journal | None = None
    out: Path | None = None
    records: dict[str, dict[str, Any]] = field(default_factory=dict)
    _shapes: dict[str, tuple[int, ...]] = field(default_factory=dict)  # of the metrics
    _written: float = 0.0
    _pause: float = WRITE_EVERY

    def recall(self, retry: bool, kept: bool = False) -> None:
        """Take from the journal what belongs to these points; without failures, to ``retry`` them.

        With ``kept`` trajectories what has none is computed again.
        """
        assert self.journal is not None
        for key in self.points.keys:
            record = self.journal.records.get(key)
            lost = kept and record is not None and not Path(record.get("trajectory", "")).is_file()
            if (
                record is not None
                and not (retry and "error" in record)
                and not (lost and "error" not in record)
            ):
                self.records[key] = self._checked(record)

    def finish(self, executor: Executor, progress: bool | Callable[[SweepProgress], None]) -> xr.Dataset:
        """Compute what is missing, and return everything; after Ctrl-C, what there is."""
        rows = zip(self.points.keys, self.points.rows, strict=True)
        missing = {key: row for key, row in rows if key not in self.records}
        try:
            if missing:
                self._compute(missing, executor, progress)
            self.attributes["status"] = "finished"
        except KeyboardInterrupt:
            self.attributes["status"] = "interrupted"
            if progress is True:
                left = sum(key not in self.records for key in missing)
                print(f"interrupted: {left} of {len(self.points.rows)} robots are missing", file=sys.stderr)
        finally:  # also if an executor or a metric breaks it off
            if self.out is not None and (self.records or self.attributes["status"] == "finished"):
                write(self.dataset(), self.out)
        return self.dataset()

    def dataset(self) -> xr.Dataset:
        """Return what there is."""
        return make_dataset(self.points, self.records, self.units, self.attributes)

    def _compute(
        self,
        missing: Mapping[str, Mapping[str, Any]],
        executor: Executor,
        progress: bool | Callable[[SweepProgress], None],
    ) -> None:
        # values mostly ascend, and work with them: the longest first leaves no worker alone in the end
        jobs = [(self.packed, key, pack(row, "parameters")) for key, row in reversed(list(missing.items()))]
        import_writer()  # while processes get ready
        there = greet(executor, load, self.packed)
        if there != rodnet.__version__:
            raise ParameterError(
                f"the executor's workers have rodnet {there}, here it is {rodnet.__version__}; install the same one"
            )
        self._written = time.perf_counter()
        known, failed = len(self.records), sum("error" in record for record in self.records.values())
        with (
            Meter(known + len(missing), known, failed, progress) as meter,
            contextlib.closing(collect(executor, run_point, jobs, meter.tick)) as results,
        ):
            for (_, key, _), result in results:
                found = {"error": describe(result)} if isinstance(result, BaseException) else result
                record = self._checked({"key": key, "parameters": self.points.told(missing[key]), **found})
                if self.journal is not None:
                    self.journal.add(record)
                self.records[key] = record
                meter.count("error" in record)
                self._write_sometimes()

    def _write_sometimes(self) -> None:
        begun = time.perf_counter()
        if self.out is not None and begun - self._written > self._pause:
            write(self.dataset(), self.out)
            self._written = time.perf_counter()
            self._pause = max(WRITE_EVERY, 20.0 * (self._written - begun))  # a large one less often

    def _checked(self, record: dict[str, Any]) -> dict[str, Any]:
        """Return a record that can be tabulated with the others: with an error in place of metrics that cannot.

        Raises
        ------
        ParameterError
            If the functions do not keep to their contract from the first.
        """
        wrong = record.pop("invalid", None)
        if wrong is None:
            try:
                check_metrics(self.points, record.get("metrics", {}), self._shapes)
            except ContractError as error:
                wrong = str(error)
        if wrong is None:
            return record
        if not self._shapes:
            at = ", ".join(f"{k} = {v!r}" for k, v in record["parameters"].items())
            raise ParameterError(f"{wrong} (at {at})")
        kept = {name: value for name, value in record.items() if name not in ("metrics", "units")}
        return {**kept, "error": describe(ContractError(wrong))}
