"""In which regime a model is off: what the places and times have in common where a force is missing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rodnet.diagnosis.locate import Location
from rodnet.diagnosis.motion import UNITS
from rodnet.diagnosis.smoothing import Posterior, Smoother
from rodnet.numbers import percent

NATS = 3.0  # that a regime must gain, beyond the price of its choice
LEAST = 0.08  # share of the hats, and of what was seen, that a regime has on either side of its threshold
AMPLITUDES = np.geomspace(1e-3, 1e3, 25)  # tried to first order, of the strength that the evidence chose
ABOVE = {
    "speed": "where the body moves faster than {} m/s", "curvature": "where it is curved more than {} per metre",
    "depth": "where it is deeper than {} m", "spacing": "where it is farther than {} m from other parts",
    "time": "after {} s",
}  # fmt: skip
KINDS = (
    "free",
    "growing",
    "drag",
)  # any force, one that grows with the speed, one against or with the motion
ONSETS = 57  # times that an onset is tried at
CUTS = 12  # thresholds of a variable that a drag is tried with
BELOW = {
    "speed": "where the body moves slower than {} m/s", "curvature": "where it is curved less than {} per metre",
    "depth": "where it is less deep than {} m", "spacing": "where it is nearer than {} m to other parts",
    "time": "before {} s",
}  # fmt: skip


@dataclass(frozen=True)
class Regime:
    """A side of a threshold where a force is missing.

    Attributes
    ----------
    variable : str
        ``"speed"``, ``"curvature"``, ``"spacing"``, ``"depth"``, ``"time"``, ``"place"``, or empty for no regime.
    above : bool
        Whether it is missing above the threshold; inside of the window of a place.
    threshold : tuple of float
        One number, or the ends of the window [m along the body]; none where the force grows with the speed
        everywhere.
    unit : str
        Of the threshold.
    share : float
        Of the evidence, on that side.
    body : float
        Share of what was observed, over body and time, on that side.
    nats : float
        By how much it is more probable than no regime.
    runner_up : str
        The variable that comes next, and does worse.
    margin : float
        By so many nats.
    onset : float or None
        When the force begins [s], if the variable is time.
    words : str
        All of it in words.
    """

    variable: str
    above: bool
    threshold: tuple[float, ...]
    unit: str
    share: float
    body: float
    nats: float
    runner_up: str
    margin: float
    onset: float | None
    words: str


@dataclass(frozen=True)
class _Split:
    """A division of the hats of all trials, and what the force is there: any, growing with the speed, or a drag."""

    variable: str
    kind: str
    inside: list[np.ndarray]
    threshold: tuple[float, ...]


def find_regime(location: Location) -> Regime | None:
    """Compare regimes by their evidence: where, when, or at what speed, curvature, spacing or depth a force is missing.

    Parameters
    ----------
    location : Location
        The force over body and time, of `locate`.

    Returns
    -------
    Regime or None
        None if there is no force to speak of.
    """
    if not location.loud("force"):
        return None
    test = _Test(location)
    everywhere = [np.ones(one.score.shape, bool) for one in location.trials]
    plain = {kind: test.exact(_Split("", kind, everywhere, ())).evidence for kind in KINDS}
    base = max(plain.values())
    by: dict[str, tuple[float, _Split, Posterior]] = {}
    for split, cost in test.splits():
        if not LEAST <= test.seen(split) <= 1.0 - LEAST:  # nearly all there is, or nearly none, is no regime
            continue
        found = test.exact(split)
        value = found.evidence - cost - base
        if split.variable not in by or value > by[split.variable][0]:
            by[split.variable] = value, split, found
    ranked = sorted(by.values(), key=lambda t: -t[0])
    if ranked and ranked[0][0] > NATS:
        gain, best, posterior = ranked[0]
        second = (ranked[1][1].variable, gain - ranked[1][0]) if len(ranked) > 1 else ("", gain)
        return test.told(best, posterior, float(gain), second[0], float(second[1]))
    growing = float(base - plain["free"])
    if growing > NATS:
        words = "all of the evidence fits a force that grows with the speed, everywhere"
        return Regime("speed", True, (), "m/s", 1.0, 1.0, growing, "", growing, None, words)
    return Regime(
        "", True, (), "1", 1.0, 1.0, 0.0, "", 0.0, None, "nothing ties the places and times together"
    )


class _Test:
    """Evidence of divisions of the force."""

    def __init__(self, location: Location) -> None:
        self.location, self.trials = location, location.trials
        self.smoother, self.found = location.smoother, location.posterior
        speed = np.concatenate([one.met["speed"].ravel() for one in self.trials])
        self.pace = float(np.sqrt(np.mean(speed**2))) or 1.0
        self.prior = self.found.prior / np.sqrt(self.found.variance)
        self.width = self.trials[0].hats.count

    def growth(self, kind: str) -> list[np.ndarray]:
        """Amplitudes, shapes (B, T), over their mean square."""
        if kind == "free":
            return [np.ones(one.score.shape) for one in self.trials]
        return [np.maximum(one.met["speed"] / self.pace, 1e-3) for one in self.trials]

    # -- to first order ---------------------------------------------------------------------------
    def _likelihoods(self, kind: str) -> np.ndarray:
        """Of each hat for each amplitude, (hats, amplitudes): the posterior with its prior taken off."""
        rows = []
        prior = self.found.prior[0] ** 2
        for mean, C, g in zip(self.found.mean, self.found.covariance, self.growth(kind), strict=True):
            m, c = mean[: self.width], np.diag(C)[: self.width]
            kept = np.maximum(1.0 - c / prior, 1e-9)
            v, m = c / kept, m / kept
            A = (np.repeat(g.ravel(), 3)[:, None] * AMPLITUDES) ** 2 * prior
            one = -0.5 * np.log(1.0 + A / v[:, None]) - 0.5 * (m**2)[:, None] / (v[:, None] + A)
            rows.append(one.reshape(-1, 3, len(AMPLITUDES)).sum(axis=1))
        return np.concatenate(rows)

    def splits(self) -> Iterator[tuple[_Split, float]]:
        """Divisions worth a look, and the price of the choice: for a drag many, else the best to first order."""
        for kind in KINDS[:2]:
            every = self._likelihoods(kind)
            for variable in UNITS:
                values = np.concatenate([one.met[variable].ravel() for one in self.trials])
                order = np.argsort(values)
                cut = self._cut(every[order], values[order])
                if cut is not None:
                    yield self._at(variable, kind, cut[0]), cut[1]
            window = self._window(every)
            if window is not None:
                yield _Split("place", kind, *window[:2]), window[2]
                yield _Split("place", "drag", *window[:2]), window[2]
        for variable in UNITS:
            values = np.concatenate([one.met[variable].ravel() for one in self.trials])
            cuts = np.unique(np.quantile(values, np.linspace(LEAST, 1.0 - LEAST, CUTS)))
            if cuts[-1] - cuts[0] > 1e-9 * np.abs(values).max():
                for cut in cuts:
                    yield self._at(variable, "drag", float(cut)), float(np.log(CUTS))

    def _at(self, variable: str, kind: str, cut: float) -> _Split:
        return _Split(variable, kind, [one.met[variable] > cut for one in self.trials], (cut,))

    @staticmethod
    def _cut(every: np.ndarray, values: np.ndarray) -> tuple[float, float] | None:
        """Threshold of the largest likelihood among sorted values, and logarithm of the number of thresholds."""
        n = len(values)
        below = np.cumsum(every, axis=0)
        sides = below.max(axis=1) + (below[-1] - below).max(axis=1)
        least = int(np.ceil(LEAST * n))
        fits = np.arange(n - 1)
        fits = fits[(fits + 1 >= least) & (n - 1 - fits >= least)]
        fits = fits[values[fits + 1] > values[fits] + 1e-9 * max(abs(values[-1]), abs(values[0]))]
        if not len(fits):
            return None
        k = int(fits[np.argmax(sides[fits])])
        return 0.5 * float(values[k] + values[k + 1]), float(np.log(min(len(fits), 10)))

    def _window(self, every: np.ndarray) -> tuple[list[np.ndarray], tuple[float, ...], float] | None:
        """Part of a rod of the largest likelihood, not more than half of the hats."""
        hats = self.trials[0].hats
        B, T, _ = hats.shape
        by_hat = every.reshape(len(self.trials), B, T, -1).sum(axis=(0, 2))
        total = by_hat.sum(axis=0)
        best: tuple[float, int, int] | None = None
        count = 0
        for a in range(B):
            for b in range(a + 1, min(B, a + B // 2) + 1):
                if hats.rods[b - 1] != hats.rods[a]:
                    break
                count += 1
                part = by_hat[a:b].sum(axis=0)
                value = float(part.max() + (total - part).max())
                if best is None or value > best[0]:
                    best = value, a, b
        if best is None or B < 3:
            return None
        _, a, b = best
        mask = np.zeros((B, T), dtype=bool)
        mask[a:b] = True
        # half way to the next hats of that rod, which are not in it
        rod, p = hats.rods[a], hats.places
        before = 0.5 * (p[a - 1] + p[a]) if a > 0 and hats.rods[a - 1] == rod else 0.0
        after = 0.5 * (p[b - 1] + p[b]) if b < B and hats.rods[b] == rod else 1.0
        ends = tuple(self.location.along(rod, s) for s in (before, after))
        return [mask] * len(self.trials), ends, float(np.log(count))

    # -- exactly ----------------------------------------------------------------------------------
    def exact(self, split: _Split) -> Posterior:
        """Posterior of a division, whose two amplitudes are chosen by evidence."""
        begin = np.append(self.prior, self.prior[0])
        free = [0, len(self.prior)] if split.variable else [0]
        return self.divided(split).around(begin, free)

    def divided(self, split: _Split) -> Smoother:
        """The force in two channels, the first and the last."""
        others = int(self.smoother.count)
        maps, channel = [], []
        for own, one, g, inside in zip(
            self.smoother.channel, self.trials, self.growth(split.kind), split.inside, strict=True
        ):
            share = np.asarray(inside, dtype=float)
            c = own.copy()
            c[: self.width][np.repeat(share.ravel() == 0.0, 3)] = others
            if split.kind == "drag":
                rest = np.eye(len(own))[:, self.width :]
                against = np.zeros((len(own), 2))
                against[: self.width, 0] = (one.velocity * share[..., None]).ravel() / self.pace
                against[: self.width, 1] = (one.velocity * (1.0 - share[..., None])).ravel() / self.pace
                maps.append(np.hstack([against, rest]))
                channel.append(np.concatenate([[0, others], own[self.width :]]))
                continue
            m = np.ones(len(own))
            m[: self.width] = np.repeat((g * np.where(share > 0.0, share, 1.0)).ravel(), 3)
            maps.append(m)
            channel.append(c)
        divided: Smoother = self.smoother.mapped(maps, channel)
        divided.count = others + 1
        return divided

    def seen(self, split: _Split) -> float:
        """Share of what was seen, over body and time, that is inside."""
        seen = [~one.blind for one in self.trials]
        body = sum(int((s & m).sum()) for s, m in zip(seen, split.inside, strict=True))
        return body / max(sum(int(s.sum()) for s in seen), 1)

    # -- words ------------------------------------------------------------------------------------
    def told(self, split: _Split, found: Posterior, nats: float, next_: str, margin: float) -> Regime:
        """What a division amounts to."""
        sides, _ = self.divided(split).explained(found)
        share = sides[0] / max(sides[0] + sides[-1], 1e-300)
        body_share = self.seen(split)
        above = bool(share >= body_share)  # the side that there is more evidence of than of the body
        if not above:
            share, body_share = 1.0 - share, 1.0 - body_share
        onset = self.onset(split, found) if split.variable == "time" and above else None
        threshold = split.threshold if onset is None else (onset,)
        where = self._where(split.variable, above, threshold)
        there = f"which holds for {percent(body_share)} of what was seen"
        words = f"{percent(share)} of the evidence is {where}, {there}"
        unit = UNITS.get(split.variable, "m")
        return Regime(
            split.variable, above, threshold, unit, share, body_share, nats, next_, margin, onset, words
        )

    def _where(self, variable: str, above: bool, threshold: Sequence[float]) -> str:
        if variable != "place":
            return (ABOVE if above else BELOW)[variable].format(f"{threshold[0]:.3g}")
        a, b = threshold
        side = "between" if above else "outside of"
        return f"on the body {side} {a:.3g} and {b:.3g} m"

    def onset(self, split: _Split, found: Posterior) -> float:
        """When the force begins [s]: the time of the largest evidence, where hats that it falls into count in part."""
        last = min(one.hats.times[-1] for one in self.trials)
        prior = found.prior / np.sqrt(found.variance)
        evidence = []
        times = np.linspace(0.0, last, ONSETS)
        for t in times:
            inside = []
            for one in self.trials:
                late = np.array([_share_after(t, one.hats.times, k) for k in range(len(one.hats.times))])
                inside.append(np.broadcast_to(late, one.score.shape))
            evidence.append(self.divided(_Split("time", split.kind, inside, ())).at(prior).evidence)
        return float(times[int(np.argmax(evidence))])


def _share_after(t: float, times: Sequence[float], k: int) -> float:
    """Share of a hat over time that is after a time."""
    at = np.linspace(times[max(k - 1, 0)], times[min(k + 1, len(times) - 1)], 101)
    hat = np.interp(at, times, np.eye(len(times))[k])
    return float(hat[at >= t].sum() / hat.sum())
