"""The next experiment: which trial out of a menu would tell explanations apart."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rodnet.diagnosis.chosen import Accepted
from rodnet.diagnosis.refit import Refit
from rodnet.diagnosis.scales import variance_factor
from rodnet.diagnosis.screen import Basis
from rodnet.diagnosis.verdict import CROSS
from rodnet.diagnosis.workbench import Fitted, Workbench
from rodnet.errors import CaseError, RodnetError
from rodnet.recordings.recording import Recording

DECISIVE = 25.0  # expected difference of deviance with which a trial decides
# repetitions of a trial that are worth telling of: what neither explanation has in it is the same in each of them
MOST = 4
REPEATING = "repeating "


@dataclass(frozen=True)
class Proposal:
    """A trial that would tell an explanation from one or several others.

    Attributes
    ----------
    between : tuple of str
        The explanations, that from which the others are told first.
    trial : str
        What to do.
    power : float
        Expected difference of deviance between them, all other parameters refitted, as far as the numerical error
        cannot be blamed for it; the least of several.
    repeat : float
        The same for the best of the trials that there are, repeated.
    menu : list of (str, float)
        All trials that were considered, best first.
    """

    between: tuple[str, ...]
    trial: str
    power: float
    repeat: float
    menu: list[tuple[str, float]]

    @property
    def sentence(self) -> str:
        """In words."""
        one, *others = self.between
        times = (
            "" if self.repeat <= 0.0 else f", {self.power / self.repeat:.3g} times as much as repeating one"
        )
        if self.needed is None:
            adds = f" within {MOST} trials: the best, {self.trial}, adds {self.power:.2g} to the deviance"
            best = adds if self.power > 0.0 else ""
            return f"no trial that can be simulated tells {one} from {' and '.join(others)}{best}"
        told = (
            "would decide"
            if self.needed == 1
            else f"would tell most, {self.needed} such trials would decide,"
        )
        between = f"{', '.join([one, *others[:-1]])} and {others[-1]}"
        return (
            f"{self.trial} {told} between {between} (expected difference of deviance {self.power:.3g}{times})"
        )

    def to_dict(self) -> dict[str, Any]:
        """As JSON takes it."""
        return {**vars(self), "needed": self.needed, "sentence": self.sentence}

    @property
    def needed(self) -> int | None:
        """How many such trials are expected to decide; None if even `MOST` would not."""
        return int(np.ceil(DECISIVE / self.power)) if MOST * self.power >= DECISIVE else None


def menu_of(bench: Workbench) -> list[tuple[str, Recording]]:
    """What the case says could be tried, as names and recordings.

    Raises
    ------
    CaseError
        If ``drives(rec)`` returns something else.
    """
    if bench.case.drives is None:
        return []
    found = []
    for entry in bench.case.drives(bench.recordings[0]):
        if isinstance(entry, Recording):
            found.append((entry.name, entry))
        elif isinstance(entry, tuple) and len(entry) == 2 and isinstance(entry[1], Recording):
            found.append((str(entry[0]), entry[1].replace(name=str(entry[0]))))
        else:
            raise CaseError(
                f"case '{bench.case.name}': drives(rec) must list recordings, or pairs (what to do, recording), "
                f"got {entry!r:.80}"
            )
    return found


def propose_all(
    bench: Workbench, accepted: Sequence[Accepted], numerical: float, tell: Callable[[str], None]
) -> list[Proposal]:
    """Trials that would tell each effect from what explains as much in its place: one trial from all, if one can."""
    found = []
    for one in accepted:
        pairs = []
        for other in one.equivalents:
            if not _beside_the_same(one, other):
                tell(
                    f"{other.id} was not fitted beside all that was found: no trial is looked for that tells it apart"
                )
                continue
            tell(f"looking for a trial that tells {one.candidate.id} from {other.id}")
            proposal = propose(bench, one.refit.fitted, other.fitted, (one.candidate.id, other.id), numerical)
            if proposal is not None:
                pairs.append(proposal)
        found += from_all(pairs)
    return found


def propose_places(
    bench: Workbench, model: Fitted, places: Mapping[str, Sequence[Fitted]], numerical: float,
    tell: Callable[[str], None],
) -> list[Proposal]:  # fmt: skip
    """Trials that would tell where an effect is, of models with it elsewhere that explain as much, by its id."""
    found = []
    by_id = {candidate.id: candidate for candidate in model.candidates}
    for id, others in places.items():
        path = by_id[id].place or by_id[id].onset or ""
        for other in others:
            tell(f"looking for a trial that tells two places of {id} apart")
            here, there = (f"{id} at {fit.values[path]:.2f}" for fit in (model, other))
            proposal = propose(bench, model, other, (here, there), numerical)
            found += [] if proposal is None else [proposal]
    return found


def from_all(pairs: Sequence[Proposal]) -> list[Proposal]:
    """The trial that tells one explanation from all others at once, in the place of one for each of them.

    What no trial tells from it stays by itself; and all do, if no trial would decide between all of the others.
    """
    some = [pair for pair in pairs if pair.needed is not None]
    if len(some) < 2:
        return list(pairs)
    powers = [dict(pair.menu) for pair in some]
    least = {trial: min(of[trial] for of in powers) for trial, _ in some[0].menu}
    menu = sorted(least.items(), key=lambda entry: -entry[1])
    between = (some[0].between[0], *(pair.between[1] for pair in some))
    repeat = max((power for trial, power in menu if trial.startswith(REPEATING)), default=0.0)
    joint = Proposal(between, *menu[0], repeat, menu)
    return list(pairs) if joint.needed is None else [joint, *(pair for pair in pairs if pair.needed is None)]


def _beside_the_same(one: Accepted, other: Refit) -> bool:
    """Whether a rival was fitted beside what the effect stands beside; else more than the two is different."""
    mine, its = ({c.id for c in model.candidates} for model in (one.refit.fitted, other.fitted))
    rise = (other.fitted.deviance - one.refit.fitted.deviance) / variance_factor(one.refit.fitted)
    return mine - {one.candidate.id} == its - {other.id} and rise < max(DECISIVE, CROSS * one.refit.gain)


def propose(
    bench: Workbench, one: Fitted, other: Fitted, names: tuple[str, str], numerical: float = 0.0
) -> Proposal | None:
    """Find the trial with the largest expected difference; None if nothing can be simulated.

    Where two explanations differ by no more than the numerical error [sigma], a trial tells nothing of them, however
    often it is repeated.
    """
    powers = _powers(bench, one, other, list(bench.recordings), True, numerical)
    repeat = max(powers, default=0.0)
    menu = menu_of(bench)
    planned = _powers(bench, one, other, [rec for _, rec in menu], False, numerical)
    repeats = zip([f"{REPEATING}{rec.name}" for rec in bench.recordings], powers, strict=True)
    both = sorted([*zip([m for m, _ in menu], planned, strict=True), *repeats], key=lambda pair: -pair[1])
    if not both:
        return None
    return Proposal(names, both[0][0], both[0][1], repeat, both)


def _powers(
    bench: Workbench, one: Fitted, other: Fitted, recs: Sequence[Recording], own: bool, numerical: float
) -> list[float]:
    """Expected difference of deviance of each trial, the parameters of either model known as well as they are.

    That is what is left when one of them is refitted to what the other does, whichever leaves less. Of a difference d
    the numerical error e may be to blame for |e|, in repetitions for the same of each: (|d| - |e|)^2 tells.
    """
    if not recs:
        return []
    noise = (
        [bench.noise[k % len(bench.noise)] for k in range(len(recs))] if own else [bench.noise[0]] * len(recs)
    )
    new = bench.with_trials(recs, noise)
    found = []
    for k in range(len(recs)):
        single = new.subset([k])
        try:
            fits = []
            for model in (one, other):
                problem = single.problem(model.candidates, model.values, [model.own[k]] if own else None)
                fits.append(single.evaluate(problem, np.zeros(len(problem.quantities)), model.candidates))
        except RodnetError as error:  # beyond what the robot, or its gripper, can do
            bench.tell(f"{recs[k].name} is left out: {error}")
            found.append(0.0)
            continue
        a, b = fits
        apart = np.sqrt(min(_distance(a, b, one), _distance(b, a, other)))
        blamed = numerical * np.sqrt(len(a.fits[0].residual))
        found.append(float(max(apart - blamed, 0.0) ** 2))
    return found


def _of_common(model: Fitted) -> np.ndarray:
    """Covariance of what is common to the trials."""
    common = np.array([q.trial is None for q in model.quantities])
    return np.asarray(model.covariance()[np.ix_(common, common)])


def _distance(a: Fitted, b: Fitted, known: Fitted) -> float:
    """What is left of the difference of two models in a trial when the first, as well as it is known, is refitted."""
    d = a.fits[0].residual - b.fits[0].residual
    # what a trial has of its own is free, the rest as uncertain as it is
    U = Basis.of(a.jacobian_of(0)[:, [q.trial is not None for q in a.quantities]]).U
    d = d - U @ (U.T @ d)
    K = a.by_coordinates_of(known, 0)
    K = K - U @ (U.T @ K)
    values, vectors = np.linalg.eigh(_of_common(known))
    K = K @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    small = np.eye(K.shape[1]) + K.T @ K
    return max(float(d @ d - (K.T @ d) @ np.linalg.solve(small, K.T @ d)), 0.0)
