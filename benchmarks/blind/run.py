"""Diagnose the cases of a set, each in a process of its own; done cases are left as they are."""

from __future__ import annotations

import json
import time
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any

HELD_OUT = 1  # the last trials of each case


def diagnose(data: Path, out: Path, candidates: Sequence[str] | None = None) -> dict[str, Any]:
    """Diagnose one case as its user would, and write ``diagnosis.json``; what fails is written down instead.

    Without ``candidates``, all that are installed are tried.
    """
    import rodnet as rn

    done = out / "diagnosis.json"
    if done.exists():
        return dict(json.loads(done.read_text()))
    out.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    try:
        recordings = rn.read_recordings([str(p) for p in sorted(data.glob("trial_*.npz"))])
        found = rn.diagnose(
            rn.load_case(data / "CASE.py"), recordings[:-HELD_OUT], hold_out=recordings[-HELD_OUT:],
            candidates=candidates, ledger=out / "ledger.jsonl", workers=0, progress=_log(out / "log.txt"),
        ).to_dict()  # fmt: skip
    except Exception as error:  # a diagnosis that fails is a result, and the others go on
        found = {
            "verdict": "failed",
            "error": f"{type(error).__name__}: {error}",
            "trace": traceback.format_exc(),
        }
    found["wall_seconds"] = time.monotonic() - began
    part = out / "diagnosis.part"
    part.write_text(json.dumps(found))
    part.replace(done)
    return found


def _log(path: Path) -> Any:
    began = time.monotonic()

    def tell(text: str) -> None:
        with path.open("a") as file:
            file.write(f"{time.monotonic() - began:8.1f} s  {text}\n")

    return tell
