"""What a law may say of cameras: by how much more what is far from the middle of the picture is seen off."""

from __future__ import annotations

import numpy as np

from rodnet.diagnosis.library import EYE, Piece
from rodnet.diagnosis.workbench import Workbench
from rodnet.inference.naive import prescribed
from rodnet.inference.readings import recorded
from rodnet.recordings.observation import Markers


def eyes_of(bench: Workbench) -> list[Piece]:
    """Lenses of the cameras of all trials, about the middle of what was seen in all of them.

    Markers that drive the model are seen where it is: of their camera nothing is told.
    """
    seen: dict[str, list[np.ndarray]] = {}
    axes: dict[str, list[int]] = {}
    out = set()
    for rec in bench.recordings:
        part = bench.case.part(rec)
        for one in bench.case.observations(part, bench.case.robot(part)):
            if not isinstance(one, Markers) or prescribed(part, one).any():
                out.add(one.name)
                continue
            kept = recorded(one, part, len(one.axes))
            seen.setdefault(one.name, []).append(one.measured(part)[..., kept].reshape(-1, len(kept)))
            axes[one.name] = [one.axes[k] for k in kept]
    found = []
    for name, rows in seen.items():
        if name in out:
            continue
        middle = np.nanmean(np.concatenate(rows), axis=0)
        options = {f"middle[{a}]": float(m) for a, m in zip(axes[name], middle, strict=True)}
        sides = tuple(f"{what}[{a}]" for what in ("keystone", "bow") for a in axes[name])
        found.append(Piece(EYE, name, (), options, ("lens", *sides)))
    return found
