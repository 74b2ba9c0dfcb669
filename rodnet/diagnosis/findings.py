"""The parts of what a diagnosis found: intervals, effects, explanations tried, trials that were opened."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import norm

from rodnet.diagnosis.heldout import Opened, floor_of
from rodnet.diagnosis.refit import Refit
from rodnet.diagnosis.scales import largest_change, variance_factor
from rodnet.diagnosis.verdict import Judgement
from rodnet.diagnosis.workbench import Fitted, Workbench

if TYPE_CHECKING:
    from rodnet.diagnosis.beside import Beside
    from rodnet.diagnosis.chosen import Accepted

LEVEL = 0.9  # of all intervals
WITHOUT = 1e-6  # [sigma] change of all residuals together, below which a value has no influence
HARDLY = 0.1  # [sigma] rms change of trials held out, below which they tell nothing of an effect
NOTHING = 1e-3  # of the smallest strength that would show: one that has come to nothing


@dataclass(frozen=True)
class Interval:
    """A value with its unit and its 90 % interval.

    Attributes
    ----------
    value, low, high : float
        The value, and the ends of the interval.
    unit : str
        Of all three.
    open : tuple of bool
        Whether what lies beyond an end fits as well, to the bounds: then nothing is known to that side.
    also : tuple of float
        Values apart from it that explain as much, with their own intervals within the ends.
    """

    value: float
    low: float
    high: float
    unit: str
    open: tuple[bool, bool] = (False, False)
    also: tuple[float, ...] = ()

    def with_other(self, other: Interval) -> Interval:
        """Return an interval that holds that of another value, too, which explains as much."""
        beyond = self.open[0] or other.open[0], self.open[1] or other.open[1]
        low, high = min(self.low, other.low), max(self.high, other.high)
        return replace(self, low=low, high=high, open=beyond, also=(*self.also, other.value))

    def to_dict(self) -> dict[str, Any]:
        """Return it as JSON takes it."""
        more: dict[str, Any] = {"also": list(self.also)} if self.also else {}
        if any(self.open):
            more["open"] = list(self.open)
        return {"value": self.value, "low": self.low, "high": self.high, "unit": self.unit, **more}


def interval(model: Fitted, path: str, level: float = LEVEL) -> Interval:
    """Interval of a common value, by the linearised likelihood, widened by what the model leaves.

    What the trials do not depend on, as a torque where nothing twists, may be anything within its bounds.
    """
    k = model.place(path)
    q = model.quantities[k]
    if float(np.linalg.norm(model.jacobian[: model.samples, k])) < WITHOUT:  # whatever its prior says
        low, high = sorted(q.value(bound) for bound in q.bounds)
        return Interval(model.values[path], low, high, q.unit, (True, True))
    z = q.coordinate(model.values[path])
    half = float(norm.ppf(0.5 + 0.5 * level)) * np.sqrt(variance_factor(model) * model.covariance()[k, k])
    ends = sorted((q.value(z - half), q.value(z + half)))
    beyond = (bool(z - half <= q.bounds[0]), bool(z + half >= q.bounds[1]))
    return Interval(model.values[path], ends[0], ends[1], q.unit, beyond)


def idle_below(one: Interval, shown: float) -> Interval:
    """A strength that has come to nothing, where no change of it shows: all that is known is what would have shown.

    ``shown`` is the smallest strength that would; an interval of another value stays as it is.
    """
    if not all(one.open) or not abs(one.value) < NOTHING * shown < np.inf:
        return one
    return replace(one, low=min(one.low, 0.0), high=shown, open=(True, False))


@dataclass(frozen=True)
class Finding:
    """An effect that was accepted.

    Attributes
    ----------
    id, title, group, family, on : str
        Of the candidate.
    status : str
        ``"named"``, ``"class"`` or ``"surrogate"``.
    parameters : dict
        `Interval` by path.
    strength : tuple of str
        Which of them are strengths.
    at, when : Interval or None
        Place along the rod, and onset.
    effect_sigma : float
        Rms change of the prediction that it makes, after the nominal parameters were refitted, over sigma.
    explained_fraction : float or None
        Share of the squared error on trials not seen beyond the floor that the model loses with it.
    gain, cross_gain : float
        Of deviance, in training and on trials left out; the latter is None of a single trial.
    gains : list of float
        The latter by trial.
    relief : float
        Share of the rms errors of trials left out that it takes off.
    p : float
        Of the gain by chance, everything that was tried counted.
    equivalents : list of str
        Ids of what explains the data as well.
    falsifier : str
        What would be otherwise if this were so.
    beside : Beside or None
        How it holds beside a remainder, where there is one.
    """

    id: str
    title: str
    group: str
    family: str
    on: str
    status: str
    parameters: dict[str, Interval]
    strength: tuple[str, ...]
    at: Interval | None
    when: Interval | None
    effect_sigma: float
    explained_fraction: float | None
    gain: float
    cross_gain: float | None
    gains: list[float]
    relief: float
    p: float
    equivalents: list[str]
    falsifier: str
    beside: Beside | None = None

    @classmethod
    def of(
        cls, accepted: Accepted, sure: Mapping[str, Interval], model: Fitted, status: str, shown: HeldOut | None,
        floor: float | None, place: int, beside: Beside | None,
    ) -> Finding:  # fmt: skip
        """Describe an accepted effect as it is in the final model.

        ``sure`` are intervals by path, where better ones than linear are known; ``place`` is that of its model in
        the chain of those that were opened.
        """
        refit, c = accepted.refit, accepted.candidate
        parameters = {p: sure[p] if p in sure else interval(model, p) for p in c.paths}
        share = None
        if shown is not None and floor is not None and place < len(shown.chain):
            before, after = (shown.chain[k].error ** 2 for k in (place - 1, place))
            excess = shown.before.error**2 - floor**2
            share = (before - after) / excess if excess > 0.0 else None
        return cls(
            c.id, c.title, c.group, c.family, c.on, status, parameters, c.strength,
            parameters.get(c.place) if c.place else None, parameters.get(c.onset) if c.onset else None,
            refit.effect_sigma, share, refit.gain, refit.crossed, refit.gains.tolist(), refit.relief,
            refit.p, [o.id for o in accepted.equivalents], c.falsifier, beside,
        )  # fmt: skip


@dataclass(frozen=True)
class Tried:
    """A candidate that was refitted, accepted or not."""

    id: str
    round: int
    gain: float
    cross_gain: float | None
    p: float
    effect_sigma: float
    accepted: bool
    reasons: tuple[str, ...]

    @classmethod
    def of(cls, refit: Refit, judgement: Judgement, number: int) -> Tried:
        """Describe a refit."""
        return cls(refit.id, number, refit.gain, refit.crossed, refit.p, refit.effect_sigma,
                   judgement.accepted, judgement.reasons)  # fmt: skip


@dataclass(frozen=True)
class HeldOut:
    """Held-out trials with the model as it is, and with every accepted model after it.

    ``borrowed`` says that their noise is that of the training trials alone, as they are too short to tell it;
    ``failed`` names those that are not here, for not every model could be simulated in them.
    """

    chain: list[Opened]
    bench: Workbench
    borrowed: bool = False
    failed: list[str] = field(default_factory=list)

    @property
    def before(self) -> Opened:
        """With the model as it is."""
        return self.chain[0]

    @property
    def after(self) -> Opened:
        """With the repaired model."""
        return self.chain[-1]

    @property
    def unexplained(self) -> float:
        """What the repaired model leaves of these trials beside the noise, rms of a coordinate over sigma.

        Where sigma is what a model is off by, nothing is said of it (0).
        """
        floor = self.floor
        return float(np.sqrt(max((self.after.error / floor) ** 2 - 1.0, 0.0))) if floor else 0.0

    @property
    def floor(self) -> float | None:
        """Rms distance that the noise alone makes in these trials; None where sigma is what a model is off by."""
        return floor_of(self.after, self.bench) if self.bench.case.noise is None else None

    @property
    def gain(self) -> float:
        """By how much the deviance falls."""
        return self.before.fitted.deviance - self.after.fitted.deviance

    @property
    def change(self) -> float:
        """Rms change of the prediction by the repair, over sigma, of the trial in which it is largest."""
        return largest_change(self.before.fitted, self.after.fitted, self.bench.noise)

    @property
    def silent(self) -> bool:
        """Whether these trials tell nothing of what was found: they hardly show it (an obstacle out of reach).

        Beside noise; where sigma is what a model is off by, what changes little does not help.
        """
        return self.bench.case.noise is None and self.change < HARDLY

    @property
    def better(self) -> bool:
        """Whether all these trials can be simulated and are predicted better, if they show what was found."""
        return not self.failed and (self.gain > 0.0 or self.silent)

    @property
    def last_gain(self) -> float:
        """By how much it falls with the last effect."""
        return self.chain[-2].fitted.deviance - self.after.fitted.deviance
