"""Where on the body and when a force acts that the model does not know, beside errors of drive and camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from rodnet.diagnosis.bank.instruments import possible
from rodnet.diagnosis.bank.making import unchanged
from rodnet.diagnosis.candidate import Candidate, candidates
from rodnet.diagnosis.columns import all_columns
from rodnet.diagnosis.force_field import Hats, force_response
from rodnet.diagnosis.measures import Measures
from rodnet.diagnosis.motion import Motion, met, motion_of, velocity
from rodnet.diagnosis.screen import Score, worst
from rodnet.diagnosis.smoothing import Posterior, Smoother
from rodnet.diagnosis.workbench import Fitted, Workbench
from rodnet.recordings.observation import Markers

TRIALS = 5  # that are looked at, those that the model fits worst, with one body
BLIND = 0.8  # share of a prior variance that recordings leave where they see nothing
CHANNELS = ("force", "drive", "camera", "markers")
GROUPS = {"actuator": 1, "observation": 2, "marker": 3}  # of candidates, and the channel that they belong to
FILE = "location.npz"
NATS, TRACE = 3.0, 0.02  # of a channel, and its share of what all explain, beyond which it is told of


@dataclass(frozen=True)
class TrialLocation:
    """The force on the body in one trial.

    Attributes
    ----------
    name, number : str, int
        The trial's.
    hats : Hats
        Where and when the entries below are.
    mean, sd : ndarray, shape (B, T, 3)
        Posterior of the force per length [N/m].
    score : ndarray, shape (B, T)
        The mean over its standard deviation, along its own direction.
    blind : ndarray of bool, shape (B, T)
        Where the recording would not see a force that matters.
    met : dict
        What the body meets there, arrays of shape (B, T) (`rodnet.diagnosis.motion.met`).
    velocity : ndarray, shape (B, T, 3)
        Of the body there [m/s].
    own : dict
        Errors of drive and camera, (mean, standard deviation) by path.
    motion, after : Motion
        Of the model, and of the repaired one, if there is one.
    """

    name: str
    number: int
    hats: Hats
    mean: np.ndarray
    sd: np.ndarray
    score: np.ndarray
    blind: np.ndarray
    met: dict[str, np.ndarray]
    velocity: np.ndarray
    own: dict[str, tuple[float, float]]
    motion: Motion
    after: Motion | None = None


@dataclass(frozen=True)
class Location:
    """Where and when the model is off, to first order.

    Attributes
    ----------
    trials : list of TrialLocation
        Those that were looked at.
    prior : float
        Standard deviation that the evidence chose for the force [N/m].
    evidence : dict
        By channel, by how much the logarithm of the evidence falls without it [nats].
    shares : dict
        By channel, its share of what all of them explain.
    explained : float
        Share of the squared residuals beyond the noise that the channels explain.
    variance : float
        Of what is left, over the noise's.
    markers : list of (str, float)
        Rod and place of every marker.
    rods : dict
        Lengths [m] by name, in the order of the body.
    smoother : Smoother
        For hypotheses about the force (`rodnet.diagnosis.regimes`).
    posterior : Posterior
        At the best strengths.
    """

    trials: list[TrialLocation]
    prior: float
    evidence: dict[str, float]
    shares: dict[str, float]
    explained: float
    variance: float
    markers: list[tuple[str, float]]
    rods: dict[str, float]
    smoother: Smoother
    posterior: Posterior

    def loud(self, channel: str) -> bool:
        """Whether a channel is to be told of: the evidence asks for it, and what it explains is more than a trace."""
        return self.evidence.get(channel, 0.0) > NATS and self.shares[channel] > TRACE

    def along(self, rod: str, place: float) -> float:
        """Distance along the body [m] of a place on a rod, the rods one after the other."""
        before = 0.0
        for name, length in self.rods.items():
            if name == rod:
                return before + place * length
            before += length
        raise KeyError(rod)

    def save(self, directory: str | Path) -> Path:
        """Write ``location.npz`` into a directory: mean, sd, score and blind of every trial."""
        path = Path(directory) / FILE
        path.parent.mkdir(parents=True, exist_ok=True)
        arrays: dict[str, np.ndarray] = {
            "rods": np.array(self.trials[0].hats.rods), "places": np.array(self.trials[0].hats.places),
        }  # fmt: skip
        for k, one in enumerate(self.trials):
            arrays |= {
                f"trial{k}.name": np.array(one.name), f"trial{k}.times": np.array(one.hats.times),
                f"trial{k}.mean": one.mean, f"trial{k}.sd": one.sd,
                f"trial{k}.score": one.score, f"trial{k}.blind": one.blind,
                **{f"trial{k}.{name}": field for name, field in one.met.items()},
            }  # fmt: skip
        np.savez_compressed(path, **arrays)  # type: ignore[arg-type]
        return path


def locate(
    bench: Workbench, fitted: Fitted, scores: Sequence[Score] = (), channels: Sequence[str] = CHANNELS,
    anew: bool = False,
) -> Location | None:  # fmt: skip
    """Find where and when a force would have to act on a fitted model; None if no trial can be looked at.

    Parameters
    ----------
    bench : Workbench
        The trials.
    fitted : Fitted
        The model; what is free in it is projected out.
    scores : sequence of Score
        Of candidates at this model: errors of drive or camera that are among them have their derivatives there, and
        others are not looked for. All that there are, if none are among them.
    channels : sequence of str
        What is looked for beside a force: ``"drive"``, ``"camera"`` and ``"markers"``.
    anew : bool
        Whether the scores are of a model that was fitted otherwise: their derivatives are computed at this one.
    """
    chosen = sorted(_alike(bench, worst(fitted))[:TRIALS])
    some = bench.subset(chosen)
    part = replace(fitted, fits=[fitted.fits[k] for k in chosen], own=[fitted.own[k] for k in chosen])
    packed, values = _trials(some, fitted, chosen)
    case = bench.case
    recs = [case.part(rec) for rec in some.recordings]
    robot = case.robot(recs[0])
    graph = robot.graph
    hats = [Hats.over(graph, float(rec.t[-1] - rec.t[0])) for rec in recs]
    jobs = [
        (bench.executor.submit(force_response, p, v, h), bench.executor.submit(motion_of, p, v))
        for p, v, h in zip(packed, values, hats, strict=True)
    ]
    forces: list[Any] = [one.result() for one, _ in jobs]
    motions: list[Any] = [one.result() for _, one in jobs]
    for failure in (one for one in (*forces, *motions) if isinstance(one, str)):
        bench.tell(f"the force on the body cannot be located: {failure}")
        return None
    unit = Measures.of(robot, recs[0].duration).force
    unit /= max(rod.length for rod in graph.rods.values())
    scales, paths, columns, channel = _others(
        some, part, _known(some, part, fitted, scores, chosen, anew), channels
    )
    G = (
        np.hstack([unit * forces.pop(0), *(one[k] for one in columns)])
        for k in range(len(chosen))
    )  # fmt: skip
    width = hats[0].count
    channel = np.concatenate([np.zeros(width, dtype=int), channel]).astype(int)
    left = [k for k in range(len(fitted.fits)) if k not in chosen]
    order = [*chosen, *left]
    residuals = [*(fitted.fits[k].residual for k in order), fitted.prior[0]]
    jacobians = [*(fitted.jacobian_of(k) for k in order), fitted.prior[1]]
    smoother = Smoother(residuals, jacobians, G, channel)
    found = smoother.best()
    kinds = sorted(set(channel.tolist()))
    evidence = {
        CHANNELS[c]: float(found.evidence - smoother.best([k for k in kinds if k != c]).evidence)
        for c in kinds
    }
    shares, explained = smoother.explained(found)
    blind = _blind(smoother, found, width)
    trials = []
    for k, rec in enumerate(recs):
        shape = hats[k].shape
        mean, C = unit * found.mean[k][:width], unit**2 * found.covariance[k][:width, :width]
        sd = np.sqrt(np.diag(C)).reshape(shape)
        own = {
            path: (scale * found.mean[k][i], scale * float(np.sqrt(found.covariance[k][i, i])))
            for i, (path, scale) in enumerate(zip(paths, scales, strict=True), start=width)
        }
        motion = motions[k]
        trials.append(
            TrialLocation(
                rec.name, chosen[k], hats[k], mean.reshape(shape), sd, _score(mean, C, shape),
                blind[k].reshape(shape).mean(axis=2) > BLIND, met(motion, graph, hats[k]),
                velocity(motion, graph, hats[k]), own, motion,
            )
        )  # fmt: skip
    lengths = {rod.name: float(rod.length) for rod in graph.rods.values()}
    return Location(
        trials, unit * float(found.prior[0]), evidence,
        {CHANNELS[c]: shares[c] for c in kinds}, explained, found.variance, _markers(some), lengths,
        smoother, found,
    )  # fmt: skip


def _alike(bench: Workbench, ranked: Sequence[int]) -> list[int]:
    """Of ranked trials, those with the body of the first: hats over a body are the same in all that are looked at."""
    bodies = []
    for k in ranked:
        graph = bench.case.robot(bench.case.part(bench.recordings[k])).graph
        bodies.append([(rod.name, rod.kind, len(rod.edges)) for rod in graph.rods.values()])
    return [k for k, body in zip(ranked, bodies, strict=True) if body == bodies[0]]


def with_repair(bench: Workbench, location: Location, model: Fitted) -> Location:
    """Add how a repaired model moves in the same trials."""
    numbers = [one.number for one in location.trials]
    packed, values = _trials(bench.subset(numbers), model, numbers)
    jobs = [bench.executor.submit(motion_of, p, v) for p, v in zip(packed, values, strict=True)]
    after = [job.result() for job in jobs]
    trials = [
        replace(one, after=None if isinstance(motion, str) else motion)
        for one, motion in zip(location.trials, after, strict=True)
    ]
    return replace(location, trials=trials)


def _trials(
    some: Workbench, fitted: Fitted, chosen: Sequence[int]
) -> tuple[list[bytes], list[dict[str, float]]]:
    """Packed trials and all their values, of a workbench that has just these."""
    own = [fitted.own[k] for k in chosen]
    problem = some.problem(fitted.candidates, fitted.values, own)
    problem.fixed |= {p: v for p, v in fitted.values.items() if "." in p and p not in problem.fixed}
    z = np.zeros(len(problem.quantities))
    return problem.packed, [problem.values(z, k) for k in range(len(chosen))]


def _known(
    some: Workbench, part: Fitted, fitted: Fitted, scores: Sequence[Score], chosen: Sequence[int], anew: bool
) -> list[tuple[int, dict[str, float], np.ndarray]]:
    """Channel, scales by path and columns of what was scored already, of some trials one after the other."""
    ends = np.cumsum([0, *(len(f.residual) for f in fitted.fits)])
    rows = np.concatenate([np.arange(ends[k], ends[k + 1]) for k in chosen])
    kept = []
    for score in scores:
        one = score.candidate
        if one.group in GROUPS and not one.bank and score.follow is not None:
            # a trial that was not looked at, or in which that marker was lost
            if any(not score.columns[ends[k] : ends[k + 1]].any() for k in chosen) and one.group != "marker":
                continue
            kept.append(score)
    if anew:
        return _at(some, part, [(GROUPS[score.candidate.group], score.candidate) for score in kept])
    return [
        (GROUPS[score.candidate.group], score.scales, score.unprojected(fitted.jacobian)[rows])
        for score in kept
    ]


def _at(
    bench: Workbench, fitted: Fitted, asked: Sequence[tuple[int, Candidate]]
) -> list[tuple[int, dict[str, float], np.ndarray]]:
    """Channel, scales by path and columns of candidates at a model."""
    banks = all_columns(bench, fitted, [one for _, one in asked]) if asked else []
    return [
        (number, {p: places[0].scales[p] for p in one.strength}, places[0].columns)
        for (number, one), places in zip(asked, banks, strict=True)
        if places
    ]


def _others(
    bench: Workbench, fitted: Fitted, known: Sequence[tuple[int, dict[str, float], np.ndarray]],
    channels: Sequence[str],
) -> tuple[list[float], list[str], list[list[np.ndarray]], np.ndarray]:  # fmt: skip
    """Scales, paths, columns by trial, and channels of errors of drive and camera."""
    found = [one for one in known if CHANNELS[one[0]] in channels]
    missing = set(CHANNELS[1:]) & set(channels) - {CHANNELS[number] for number, _, _ in found}
    found += _computed(bench, fitted, missing)
    taken = {q.path for q in fitted.quantities}
    ends = np.cumsum([0, *(len(f.residual) for f in fitted.fits)])
    scales: list[float] = []
    paths: list[str] = []
    channel: list[int] = []
    columns = []
    for number, units, G in found:
        free = np.array([p not in taken for p in units])
        kept = np.flatnonzero(free & np.isfinite(G).all(axis=0) & G.any(axis=0))
        names = list(units)
        scales += [units[names[k]] for k in kept]
        paths += [names[k] for k in kept]
        channel += [number] * len(kept)
        columns.append([G[a:b, kept] for a, b in pairwise(ends)])
    return scales, paths, columns, np.array(channel, dtype=int)


def _computed(
    bench: Workbench, fitted: Fitted, channels: set[str]
) -> list[tuple[int, dict[str, float], np.ndarray]]:
    """Channel, scales by path and columns of all errors of some channels that there can be."""
    rec = bench.case.part(bench.recordings[0])
    robot = bench.case.robot(rec)
    instruments = bench.case.observations(rec, robot)
    taken = {q.path for q in fitted.quantities}
    here = possible(candidates(robot, instruments), lambda one: instruments, [rec])
    every = [c for c in here if c.bank is None]
    asked = [(1, c) for c in every if c.group == "actuator" and "drive" in channels]
    for group in ("observation", "marker"):
        name = CHANNELS[GROUPS[group]]
        seen = tuple(p for c in every if c.group == group for p in c.strength if p not in taken)
        if seen and name in channels:
            asked.append((GROUPS[group], Candidate(name, name, group, unchanged, seen, "", observe=True)))
    return _at(bench, fitted, asked)


def _score(mean: np.ndarray, C: np.ndarray, shape: tuple[int, int, int]) -> np.ndarray:
    """The mean of each hat over its standard deviation along its own direction."""
    blocks = mean.reshape(-1, 3)
    own = C.reshape(len(blocks), 3, len(blocks), 3)
    diagonal = own[np.arange(len(blocks)), :, np.arange(len(blocks)), :]
    spread = np.einsum("ni,nij,nj->n", blocks, diagonal, blocks)
    square = (blocks**2).sum(axis=1)
    return (square / np.sqrt(np.maximum(spread, 1e-300))).reshape(shape[:2])


def _blind(smoother: Smoother, found: Posterior, width: int) -> list[np.ndarray]:
    """Shares of the variance that are left of a force that is expected to matter, by trial, shapes (width,)."""
    prior = found.prior / np.sqrt(found.variance)
    prior[0] = max(smoother.loud[0], prior[0])
    one = smoother.at(prior)
    return [np.diag(C)[:width] / one.prior[0] ** 2 for C in one.covariance]


def _markers(bench: Workbench) -> list[tuple[str, float]]:
    """Rod and place of every marker of a trial."""
    rec = bench.case.part(bench.recordings[0])
    robot = bench.case.robot(rec)
    found = []
    for one in bench.case.observations(rec, robot):
        if not isinstance(one, Markers):
            continue
        for edge, along in zip(one.edge, one.along, strict=True):
            for rod in robot.graph.rods.values():
                place = np.flatnonzero(rod.edges == edge)
                if len(place):
                    length = robot.graph.rest_length[rod.edges]
                    before = float(length[: place[0]].sum())
                    found.append(
                        (rod.name, (before + float(along) * float(length[place[0]])) / float(length.sum()))
                    )
                    break
    return found


def strongest(location: Location) -> Sequence[tuple[TrialLocation, int, int]]:
    """The hat of the largest score in each trial: trial, and numbers over body and time."""
    return [(one, *np.unravel_index(int(np.argmax(one.score)), one.score.shape)) for one in location.trials]  # type: ignore[misc]
