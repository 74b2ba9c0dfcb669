"""What one would predict without a model: the baselines that a model has to beat."""

from __future__ import annotations

import numpy as np

from rodnet.recordings.observation import Markers, Observation
from rodnet.recordings.recording import Recording

START = 2  # frames that a prediction begins from; the third is the first to be predicted


def held(rec: Recording, instrument: Observation) -> np.ndarray:
    """Last known value of each reading, held; prescribed markers move as measured. Shape as measured."""
    measured = instrument.measured(rec)
    out = np.array(np.broadcast_to(_last_known(measured), measured.shape))
    known = prescribed(rec, instrument)
    out[:, known] = measured[:, known]
    return out


def interpolated(rec: Recording, instrument: Observation) -> np.ndarray:
    """Last known pose, displaced by what is interpolated between the prescribed markers.

    Along the rods between markers (``rec.edges``) the displacement is linear in arc length, in whatever
    hangs from them constant: the harmonic function on the graph of markers. Without ``edges`` or
    prescribed markers it is zero.
    """
    out = held(rec, instrument)
    known = prescribed(rec, instrument)
    if not isinstance(instrument, Markers) or not known.any() or not len(rec.edges):
        return out
    pose = _last_known(rec.trusted)
    columns = [rec.marker(m) for m in instrument.markers]
    weights = _harmonic(rec, pose)  # (M, prescribed)
    moved = _filled(rec.t, rec.trusted[:, rec.prescribed] - pose[rec.prescribed])
    shift = np.einsum("mp,tpa->tma", weights, moved)[:, columns][..., instrument.axes]
    free = ~known
    out[:, free] += shift[:, free]
    return out


def _filled(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (T, ...), linear in time where some were lost; zero where all were."""
    found = values.reshape(len(t), -1).copy()
    for column in found.T:
        good = np.isfinite(column)
        column[~good] = np.interp(t[~good], t[good], column[good]) if good.any() else 0.0
    return found.reshape(values.shape)


def _last_known(values: np.ndarray) -> np.ndarray:
    """Row 1, or where that is lost the first that is not."""
    row = np.array(values[min(START, len(values)) - 1])
    flat, all_rows = row.reshape(-1), values.reshape(len(values), -1)
    for k in np.flatnonzero(~np.isfinite(flat)):
        good = np.flatnonzero(np.isfinite(all_rows[:, k]))
        flat[k] = all_rows[good[0], k] if len(good) else np.nan
    return flat.reshape(row.shape)


def prescribed(rec: Recording, instrument: Observation) -> np.ndarray:
    """Which columns of an instrument are prescribed, shape (columns,)."""
    if not isinstance(instrument, Markers):
        return np.zeros(instrument.measured(rec).shape[1:2], dtype=bool)
    return np.isin([rec.marker(m) for m in instrument.markers], rec.prescribed)


def _harmonic(rec: Recording, pose: np.ndarray) -> np.ndarray:
    """Weights of the prescribed markers' displacements in that of every marker, shape (M, prescribed)."""
    count = len(pose)
    i, j = rec.edges.T
    pull = 1.0 / np.maximum(np.linalg.norm(pose[j] - pose[i], axis=1), 1e-9)
    laplace = np.zeros((count, count))
    np.add.at(laplace, (i, j), -pull)
    np.add.at(laplace, (j, i), -pull)
    laplace[np.diag_indices(count)] = -laplace.sum(axis=1)
    weights = np.zeros((count, len(rec.prescribed)))
    weights[rec.prescribed, np.arange(len(rec.prescribed))] = 1.0
    free = rec.free
    # a part that nothing prescribed touches stays: its block is singular, its least-squares solution zero
    weights[free] = np.linalg.lstsq(
        laplace[np.ix_(free, free)], -laplace[np.ix_(free, rec.prescribed)], rcond=None
    )[0]
    return weights
