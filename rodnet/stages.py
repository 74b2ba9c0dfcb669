"""The stages of a diagnosis, each a function of trials and a fitted model whose result can be kept and plotted.

`rodnet.diagnose` runs them all, with the rules of what follows from what. By hand::

    bench = rn.stages.trials("CASE.py", "day1/*.npz")
    fitted = bench.fit()
    scores = rn.stages.screen(bench, fitted, rn.stages.bank(bench))

Results hold the case and its functions, which files cannot: `kept` keeps a result in a folder with what it was given
by name, and reads it there when the same is asked for again.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rodnet.diagnosis.candidate import Candidate
from rodnet.diagnosis.confirm import intervals
from rodnet.diagnosis.design import propose_all
from rodnet.diagnosis.diagnose import bank_of
from rodnet.diagnosis.forces import force_columns, library_of, placebos
from rodnet.diagnosis.in_motion import begun_in_motion
from rodnet.diagnosis.law import draft
from rodnet.diagnosis.locate import locate
from rodnet.diagnosis.numerics import measure
from rodnet.diagnosis.preflight import preflight
from rodnet.diagnosis.refit import refit
from rodnet.diagnosis.regimes import find_regime
from rodnet.diagnosis.remainder import test_remainder
from rodnet.diagnosis.screen import isolability, screen
from rodnet.diagnosis.selection import select
from rodnet.diagnosis.stage_files import Stages, identity, named
from rodnet.diagnosis.workbench import Fitted, Workbench
from rodnet.inference.case import Case, load_case
from rodnet.recordings.files import as_recordings
from rodnet.recordings.recording import Recording
from rodnet.sweeps.collect import Serial

__all__ = [
    "Fitted",
    "Stages",
    "Workbench",
    "bank",
    "begun_in_motion",
    "draft",
    "find_regime",
    "force_columns",
    "intervals",
    "isolability",
    "kept",
    "library_of",
    "locate",
    "measure",
    "placebos",
    "preflight",
    "propose_all",
    "refit",
    "screen",
    "select",
    "test_remainder",
    "trials",
]


def trials(
    case: Case | str | Path, recordings: Sequence[Recording] | str | Path, noise: Any = None, **options: Any
) -> Workbench:
    """Return the trials of a case, to be fitted (``fit``) and looked at by the other functions, on one core.

    Parameters
    ----------
    case : Case or path
        How a recording is simulated.
    recordings : sequence of Recording, or paths
        Training trials, or files, folders and patterns that they are read from.
    noise : object, optional
        As for `rodnet.calibrate`; by default the case's own.
    **options
        ``priors``, ``start`` and ``modes``, likewise.

    Raises
    ------
    CaseError, RecordingError, ParameterError
        For bad input.
    """
    case = case if isinstance(case, Case) else load_case(case)
    given = case.noise if noise is None else noise
    return Workbench.of(case, as_recordings(recordings), Serial(), given, **options)


def bank(bench: Workbench, only: Sequence[str] | Sequence[Candidate] | None = None) -> list[Candidate]:
    """Return what `rodnet.diagnose` would try: all that is installed and applies to the robots, and the case's own.

    Parameters
    ----------
    bench : Workbench
        The trials.
    only : sequence of str or Candidate, optional
        Ids of families or candidates, or candidates.

    Raises
    ------
    ParameterError
        If none of those applies.
    """
    return bank_of(bench.case, bench.simplest, only, [bench.case.part(rec) for rec in bench.recordings])


def kept(directory: str | Path, bench: Workbench, bank: Sequence[Candidate]) -> Stages:
    """Return a function ``stage(name, function, *arguments)``, which computes a stage once and keeps it in a folder.

    With another case, other recordings, candidates or sources of rodnet it is computed anew. The files are Python
    pickles: read those alone that you have written.
    """
    parts = {"training": list(bench.recordings)}
    options = [bench.noise, dict(bench.priors), dict(bench.start), bench.modes]
    mark = identity(bench.case, parts, bank, options)
    return Stages(
        Path(directory), mark, named(bench.case, parts, bank, executor=bench.executor, tell=bench.tell)
    )
