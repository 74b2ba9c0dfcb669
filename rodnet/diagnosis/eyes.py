"""What a law may say of cameras: by how much more what is far from the middle of the picture is seen off."""

from __future__ import annotations

import numpy as np

from rodnet.diagnosis.library import EYE, Piece
from rodnet.diagnosis.workbench import Workbench
from rodnet.inference.naive import prescribed
from rodnet.inference.readings import recorded
from rodnet.recordings.observation import Markers


def eyes_of(bench: Workbench) -> list[Piece]:
    """Lenses of the cameras that all trials have, about the middle of what was seen in all of them.

    Markers that drive the model are seen where it is: of their camera nothing is told. Nor is of one whose lens is
    known, of which another would be no change.
    """
    seen: dict[str, list[dict[int, np.ndarray]]] = {}
    out = set()
    for rec in bench.recordings:
        part = bench.case.part(rec)
        for one in bench.case.observations(part, bench.case.robot(part)):
            if not isinstance(one, Markers) or one.bends or prescribed(part, one).any():
                out.add(one.name)
                continue
            kept, picture = recorded(one, part, len(one.axes)), one.measured(part)
            seen.setdefault(one.name, []).append({one.axes[k]: picture[..., k].ravel() for k in kept})
    found = []
    for name, pictures in seen.items():
        axes = [a for a in pictures[0] if all(a in picture for picture in pictures)]
        if name in out or len(pictures) < len(bench.recordings) or not axes:
            continue
        options = {f"middle[{a}]": float(np.nanmean(np.concatenate([p[a] for p in pictures]))) for a in axes}
        sides = tuple(f"{what}[{a}]" for what in ("keystone", "bow") for a in axes)
        found.append(Piece(EYE, name, (), options, ("lens", *sides)))
    return found
