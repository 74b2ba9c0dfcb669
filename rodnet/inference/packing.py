"""Trials of a case as other processes take them, and what they do with them."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rodnet.errors import DerivativeError, RodnetError
from rodnet.inference.case import Case
from rodnet.inference.comparison import Comparison, Fit
from rodnet.inference.corrections import Corrections
from rodnet.inference.segments import Segment, make_segments
from rodnet.inference.shots import why
from rodnet.recordings.noise import NoiseModel
from rodnet.recordings.recording import Recording

_known: dict[str, Comparison] = {}  # those that were used last
MOST = 256  # of them: a search uses those of a few models by turns


def pack_case(case: Case) -> bytes:
    """Return what other processes need to make trials of a case: these are what it cuts out of recordings already.

    Raises
    ------
    ParameterError
        If functions of the case hold on to something that only lives in this process.
    """
    from rodnet.sweeps.job import pack

    return pack(replace(case, cut=None), "functions of the case")


def pack_trial(
    case: bytes, rec: Recording, noise: Mapping[str, NoiseModel], modes: int, segments: Sequence[Segment] = (),
    corrections: Corrections | None = None,
) -> bytes:  # fmt: skip
    """Return what another process needs to make the trial; ``case`` is that of `pack_case`, without the corrections."""
    return pickle.dumps((case, rec, dict(noise), modes, tuple(segments), corrections))


def unpack_trial(packed: bytes) -> Comparison:
    """Make the trial, once in each process."""
    key = hashlib.sha256(packed).hexdigest()
    if key in _known:
        _known[key] = _known.pop(key)
    else:
        while len(_known) >= MOST:
            del _known[next(iter(_known))]
        case, rec, noise, modes, segments, corrections = pickle.loads(packed)
        rec = rec.replace(channels={k: np.asarray(v) for k, v in rec.channels.items()})
        _known[key] = Comparison(pickle.loads(case), rec, noise, modes, segments)
        if corrections is not None:
            corrections.put(_known[key].instruments)
    return _known[key]


def evaluate_trial(
    packed: bytes, values: Mapping[str, float], scales: Mapping[str, float] | None,
    rejected: Sequence[np.ndarray] | None,
) -> Fit | str:  # fmt: skip
    """Evaluate a trial; a text says why its motion could not be computed."""
    trial = unpack_trial(packed)
    try:
        fit = trial.evaluate(values, scales, rejected)
    except DerivativeError:  # a law, not a motion
        raise
    except RodnetError as error:  # laws refuse values, too, that only a search would give them
        return f"trial '{trial.rec.name}' {why(error)}"
    if not np.isfinite(fit.residual).all():
        return f"trial '{trial.rec.name}': its motion is not finite"
    return fit


def segment_trial(
    packed: bytes, values: Mapping[str, float], frames: Sequence[int], modes: int
) -> list[Segment] | str:
    """Find the segments of a trial; a text says why they cannot be simulated."""
    try:
        return make_segments(unpack_trial(packed), values, frames, modes)
    except RodnetError as error:
        return why(error)
