"""A sweep under way: what is known, what is missing, and how it gets computed and kept."""

from __future__ import annotations

import contextlib
import functools
import sys
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rodnet
from rodnet.errors import ParameterError
from rodnet.sweeps.dataset import check_names, make_dataset, write
from rodnet.sweeps.job import describe, greet, run_point
from rodnet.sweeps.journal import Journal
from rodnet.sweeps.meter import Meter, SweepProgress
from rodnet.sweeps.points import Points
from rodnet.sweeps.pool import Workers

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
    _names: set[str] | None = None  # of the metrics
    _written: float = 0.0
    _pause: float = WRITE_EVERY

    def recall(self, retry: bool) -> None:
        """Take from the journal what belongs to these points; without failures, to ``retry`` them."""
        assert self.journal is not None
        keys = set(self.points.keys())
        for key, record in self.journal.records.items():
            if key in keys and not (retry and "error" in record):
                self._check(record)
                self.records[key] = record

    def finish(
        self, executor: Executor | None, count: int, progress: bool | Callable[[SweepProgress], None]
    ) -> xr.Dataset:
        """Compute what is missing, and return everything; after Ctrl-C, what there is.

        Parameters
        ----------
        executor, progress
            As in `rodnet.sweep`.
        count : int
            Number of processes, if there is no executor.
        """
        rows = zip(self.points.keys(), self.points.rows, strict=True)
        missing = {key: row for key, row in rows if key not in self.records}
        try:
            if missing:
                self._compute(missing, executor, min(count, len(missing)), progress)
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
        executor: Executor | None,
        count: int,
        progress: bool | Callable[[SweepProgress], None],
    ) -> None:
        self._written = time.perf_counter()
        failed = sum("error" in record for record in self.records.values())
        with Workers(executor, count) as workers:
            there = workers.greet(greet, self.packed)
            if there != rodnet.__version__:
                raise ParameterError(
                    f"the executor's workers have rodnet {there}, here it is {rodnet.__version__}; install the same one"
                )
            known = len(self.records)
            work = functools.partial(run_point, self.packed)
            with (
                Meter(known + len(missing), known, failed, progress) as meter,
                contextlib.closing(workers.results(work, missing.items(), meter.tick)) as results,
            ):
                for (key, row), result in results:
                    if isinstance(result, BaseException):
                        result = {"key": key, "parameters": dict(row), "error": describe(result)}
                    self._keep(result)
                    meter.count("error" in result)

    def _keep(self, record: dict[str, Any]) -> None:
        self._check(record)
        if self.journal is not None:
            self.journal.add(record)
        self.records[record["key"]] = record
        begun = time.perf_counter()
        if self.out is not None and begun - self._written > self._pause:
            write(self.dataset(), self.out)
            self._written = time.perf_counter()
            self._pause = max(WRITE_EVERY, 20.0 * (self._written - begun))  # a large one less often

    def _check(self, record: Mapping[str, Any]) -> None:
        """Check that the metrics of a record can be tabulated with the others."""
        at = ", ".join(f"{k} = {v!r}" for k, v in record["parameters"].items())
        if "invalid" in record:
            raise ParameterError(f"{record['invalid']} (at {at})")
        if "metrics" not in record:
            return
        names = set(record["metrics"])
        if self._names is None:
            check_names(self.points, record["metrics"])
            self._names = names
        if names != self._names:
            raise ParameterError(
                f"metrics must have the same names at every point: {', '.join(sorted(names ^ self._names))} is not "
                f"everywhere (look at {at}); return nan where there is no value"
            )
