"""Unnamed forces on parts of the body: what a remainder is described by, and what a placebo is drawn from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from rodnet.diagnosis.bank.making import soft_rods
from rodnet.diagnosis.candidate import Candidate, add_terms
from rodnet.diagnosis.columns import bank_columns
from rodnet.diagnosis.measures import Measures
from rodnet.diagnosis.screen import Basis
from rodnet.diagnosis.workbench import Fitted, Workbench
from rodnet.errors import RodnetError
from rodnet.robot import Robot
from rodnet.terms.drag.local_law import LocalLaw

LAWS = ("gx", "gy", "gz", "linear", "along", "square", "rate_free")
PARTS = 3  # of a single rod
DRAWS = 200


def parts_of(robot: Robot) -> dict[str, list[str]]:
    """Parts of the body that get forces of their own, as selectors: its rods, or thirds of a single one."""
    rods = soft_rods(robot)
    if len(rods) > 1:
        return {rod.name: [rod.name] for rod in rods}
    rod = rods[0]
    count = rod.names - 1
    ends = np.unique(np.linspace(0, count, min(PARTS, count) + 1).astype(int))
    return {
        f"{rod.name} {a / count:.2g}-{b / count:.2g}": [f"{rod.name}:{k}-{k + 1}" for k in range(a, b)]
        for a, b in pairwise(ends)
    }


def unnamed(robot: Robot, duration: float) -> list[Candidate]:
    """Candidates that are sums of simple laws, one for each part of the body."""
    speed = Measures.of(robot, duration).speed
    found = []
    for k, (title, on) in enumerate(parts_of(robot).items()):
        name = f"unnamed-force-{k}"
        options = {"on": on, "name": name, "creep": 0.1 * speed}
        found.append(
            Candidate(
                id=name, title=f"a force without a name on {title}", group="medium",
                build=partial(add_terms, parts=((LocalLaw, options),)),
                strength=tuple(f"{name}.{law}" for law in LAWS), falsifier="",
            )
        )  # fmt: skip
    return found


@dataclass(frozen=True)
class ForceColumns:
    """Derivatives of the residuals by unnamed forces, training and held-out trials apart.

    Attributes
    ----------
    names : list of str
        Of the columns: part and law.
    train, held : ndarray, shapes (n, k), (m, k)
        Columns over their scales; nothing projected out.
    """

    names: list[str]
    train: np.ndarray
    held: np.ndarray


def force_columns(
    bench: Workbench, fitted: Fitted, held: Workbench | None, seen: Fitted | None
) -> ForceColumns:
    """Columns of all unnamed forces at a fitted model."""
    rec = bench.case.part(bench.recordings[0])
    names: list[str] = []
    columns: list[list[np.ndarray]] = [[], []]
    for candidate in unnamed(bench.case.robot(rec), rec.duration):
        try:
            mine = bank_columns(bench, fitted, candidate)
            theirs = bank_columns(held, seen, candidate) if held is not None and seen is not None else []
        except RodnetError:
            continue
        if not mine or (held is not None and not theirs):
            continue
        names += [f"{candidate.id}.{law}" for law in LAWS]
        columns[0].append(mine[0].columns)
        if theirs:
            columns[1].append(theirs[0].columns)
    empty = np.zeros((0, len(names)))
    train = np.hstack(columns[0]) if columns[0] else np.zeros((fitted.samples, 0))
    return ForceColumns(names, train, np.hstack(columns[1]) if columns[1] else empty)


@dataclass(frozen=True)
class Placebo:
    """What forces without meaning gain when they are chosen and fitted like candidates.

    Attributes
    ----------
    train, held : ndarray, shape (draws,)
        Gains of deviance on training and on held-out trials, of the best of each draw.
    """

    train: np.ndarray
    held: np.ndarray


def placebo(
    fitted: Fitted,
    seen: Fitted | None,
    columns: ForceColumns,
    candidates: int,
    parameters: int,
    seed: int = 0,
) -> Placebo:
    """Draw random smooth forces, as many as there are candidates, fit each and keep the best; many times.

    To first order about the fitted model: a force is a random combination of the unnamed forces, with as many
    free strengths as a candidate has parameters.
    """
    rng = np.random.default_rng(seed)
    count = columns.train.shape[1]
    if not count:
        return Placebo(np.zeros(DRAWS), np.zeros(DRAWS))
    basis = Basis.of(fitted.jacobian)
    padded = np.zeros((len(fitted.residual), count))
    padded[: len(columns.train)] = columns.train
    P, r = basis.out(padded), basis.out(fitted.residual)
    size = np.linalg.norm(P, axis=0)
    size = np.where(size > 0.0, size, np.inf)
    A, b = (P / size).T @ (P / size), (P / size).T @ r
    held = None
    if seen is not None and len(columns.held):
        # common parameters move with the force as in training; what a held-out trial has of its own is refitted
        J = fitted.jacobian
        follow = -np.linalg.pinv(J, rcond=1e-9) @ (padded / size)
        common = np.array([q.trial is None for q in fitted.quantities])
        moved = np.zeros((len(seen.residual), count))
        moved[: len(columns.held)] = columns.held / size
        both = moved
        if "common" in seen.extra:
            both = moved + _rows(seen.extra["common"], len(moved)) @ follow[common]
        own = Basis.of(seen.jacobian)
        H, h = own.out(both), own.out(seen.residual)
        held = H.T @ H, H.T @ h
    train_gain, held_gain = np.zeros(DRAWS), np.zeros(DRAWS)
    for draw in range(DRAWS):
        best = -np.inf
        for _ in range(max(candidates, 1)):
            W = rng.standard_normal((count, max(parameters, 1)))
            small = W.T @ A @ W
            z = -np.linalg.lstsq(small, W.T @ b, rcond=1e-10)[0]
            gain = float(-(2.0 * z @ (W.T @ b) + z @ small @ z))
            if gain > best:
                best, d = gain, W @ z
        train_gain[draw] = best
        if held is not None:
            held_gain[draw] = float(-(2.0 * d @ held[1] + d @ held[0] @ d))
    return Placebo(train_gain, held_gain)


def _rows(columns: np.ndarray, count: int) -> np.ndarray:
    out = np.zeros((count, columns.shape[1]))
    out[: len(columns)] = columns
    return out
