"""What a diagnosis says, in sentences."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from rodnet.diagnosis.library import LAW
from rodnet.diagnosis.scales import ALPHA, LEAST
from rodnet.diagnosis.selection import MOST
from rodnet.diagnosis.verdict import ASTRAY, FEWEST, LEARNT, UNSEEN, complete
from rodnet.numbers import by_chance, number, p_value, percent
from rodnet.report.figures import measure

if TYPE_CHECKING:
    from rodnet.diagnosis.findings import Finding, Interval
    from rodnet.diagnosis.law import Draft
    from rodnet.diagnosis.locate import Location
    from rodnet.diagnosis.result import Diagnosis

SHOWN = 12  # rows of rankings
MANY = 4  # strengths of an explanation, beyond which they are not listed
STANDS_OUT = 3.0  # [sd] of a force beyond which it is told
QUIET = 0.5  # of the noise: no model leaves less
VERDICTS = {
    "none": "Nothing is missing that these recordings could show.",
    "named": "The model leaves out:",
    "partial": "The model leaves out what is named here, and something else that is not:",
    "class": "The model leaves something out; of explanations joined by 'or' these recordings cannot tell which it is:",
    "surrogate": "Something is missing. What is found here stands in for it; it is not its name.",
    "unresolved-numerics": "The time step or the mesh is too coarse to say anything: refine them first.",
    "unidentifiable": "These recordings cannot tell.",
}
LIKEWISE = 0.1  # of the evidence for the channel that there is most for: what there is less for is told apart
FEW = f"The model leaves something out; to be sure of a name takes {FEWEST} recordings, {LEARNT} of them to be fitted:"
NAMELESS = "Something is missing, and nothing that was tried explains it."
PERHAPS = (
    "Perhaps something is missing: an explanation gains more than chance would, but not on all trials alike, and what "
    "is left without it is what noise leaves."
)
UNTOLD = "The model leaves something out; these recordings cannot tell which of all that shows in them it is:"
UNSEEN_ALONE = "Something is missing that acts in trials held out, and not in those that were searched."
CHANNELS = {
    "force": "a force on the body", "drive": "what drives or holds it", "camera": "the camera or the clock",
    "markers": "single markers that sit elsewhere or slip",
}  # fmt: skip


def summary(found: Diagnosis) -> str:
    """The verdict in a few sentences."""
    alone = found.verdict == "class" and not any(one.equivalents for one in found.findings)
    text = [FEW if alone else VERDICTS[found.verdict]]
    if found.verdict == "unidentifiable" and found.findings:
        text = [UNTOLD]
    if found.verdict == "surrogate" and not found.findings:
        text = [PERHAPS if complete(found.remainder) else NAMELESS]
    text += [f"{one.title}{place(one)}, {strengths(one)}{or_else(found, one)};" for one in found.findings]
    if found.held is not None and found.findings:
        share = found.explained_fraction
        removed = "" if share is None else f", which {takes(share)} what is not noise"
        before, after = found.held.before.error, found.held.after.error
        way = "falls" if after < before else "rises"
        fall = f"the error {way} from {error(found, before)} to {error(found, after)}{removed}"
        text.append(
            f"trials {found.shown} hardly show it, for it moves them by {found.held.change:.2g} sigma at most."
            if found.held.silent
            else f"on trials {found.shown} {fall}."
        )
    elif found.findings:
        text[-1] = text[-1].removesuffix(";") + "."
    tested = found.tested
    if found.findings and tested is not None and complete(found.remainder) and tested.unexplained > UNSEEN:
        text.append(
            f"Of the trials held out {tested.unexplained:.2g} sigma are left beside the noise, of those searched "
            "nothing: what is found does not hold for all of them."
        )
    if lost := [*found.lost, *(found.tested.failed if found.tested else [])]:
        text.append(
            f"Not with every model can {', '.join(lost)} be simulated, which {was(lost)} not searched."
        )
    if unseen_alone(found):
        text = [UNSEEN_ALONE, *text[1:], unlike(found)]
    if found.verdict == "none":
        text.append(
            f"What the model leaves is what the noise would leave ({p_value(found.remainder.p)})."
            if found.remainder.p > ALPHA
            else f"What the model leaves beside noise is {number(found.remainder.excess, '.2g')} sigma, too little to "
            "name."
        )
    if found.verdict == "partial" and len(found.findings) >= MOST and complete(found.remainder):
        text.append("So many together may also stand for one that is not in the bank.")
    if (left := leaves(found)) < QUIET:
        text.append(
            f"The model as it is leaves {number(left, '.2g')} times the noise that was given: that is too large, or in "
            "another unit than SI."
        )
    if found.hurried:
        text.append(
            "The time was up before all was looked for or asked again: with more of it (minutes) more may be found."
        )
    if found.remainder.grips:
        text.append(
            f"A smooth remainder of {found.remainder.grips:.2g} sigma is what trials leave that are each held a little "
            "elsewhere than their records say, as their noise makes it."
        )
    if found.remainder.records >= ASTRAY:
        text.append(
            f"Trials are held {found.remainder.records:.2g} times as far beside their drives' records as the noise of "
            "these lets expect, each elsewhere: the records are off, or what they are the records of gives way."
        )
    return " ".join(text)


def or_else(found: Diagnosis, one: Finding) -> str:
    """What explains the recordings as well as a finding does."""
    titles = {s.candidate.id: s.candidate.title for s in found.screened}
    return "".join(f", or {titles.get(id, id)}" for id in one.equivalents)


def takes(share: float) -> str:
    """What a repair does to an error, whose share it removes."""
    return f"adds {percent(-share)} to" if share < 0.0 else f"removes {percent(min(share, 1.0))} of"


def was(names: Sequence[str]) -> str:
    """The verb for one name or several."""
    return "was" if len(names) == 1 else "were"


def leaves(found: Diagnosis) -> float:
    """Rms residual of the model as it is, over the noise."""
    base = found.base
    return float(np.sqrt(sum(float(f.residual @ f.residual) for f in base.fits) / base.samples))


def unseen_alone(found: Diagnosis) -> bool:
    """Whether nothing is missing in the trials that were searched, and much in those held out."""
    if found.tested is None or found.findings or found.verdict != "surrogate":
        return False
    return complete(found.remainder) and found.tested.unexplained > UNSEEN


def unlike(found: Diagnosis) -> str:
    """Which trials held out the model that holds for all others does not predict, and what to do about it."""
    assert found.tested is not None
    after, floor = found.tested.after, found.tested.floor or 0.0
    names = [rec.name for rec in found.tested.bench.recordings]
    far = [(n, e) for n, e in zip(names, after.trials, strict=True) if e > floor * np.hypot(1.0, UNSEEN)]
    each = ", ".join(f"{name} by {error(found, e)}" for name, e in far)
    return (
        f"It is off by no more than noise in those, but in {each} (noise: {error(found, floor)}). "
        "Search such trials, too, record more of their kind, and hold out others."
    )


def strengths(one: Finding) -> str:
    """Its strengths with intervals; of many their number, for they have different units."""
    if one.id == LAW:
        return f"{len(one.strength)} parts"
    if len(one.strength) > MANY:
        return f"{len(one.strength)} strengths"
    names = short(one.parameters)
    return ", ".join(f"{names[p]} {told(one.parameters[p])}" for p in one.strength)


def short(paths: Iterable[str]) -> dict[str, str]:
    """Names of parameters by path, without that of their term where it is not needed to tell them apart."""
    paths = list(paths)
    last = [path.rpartition(".")[2] for path in paths]
    return {path: name if last.count(name) == 1 else path for path, name in zip(paths, last, strict=True)}


def told(v: Interval) -> str:
    """A value with its interval and unit."""
    unit = "" if v.unit == "1" else f" {v.unit}"
    if any(v.open):
        return f"{ends(v)}{'' if all(v.open) else unit}"
    also = "".join(f", or {number(value)}" for value in v.also)
    return f"{number(v.value)}{also} ({ends(v)}){unit}"


def ends(v: Interval, form: str = ".3g") -> str:
    """An interval; where one side or both are open, what is known."""
    if all(v.open):
        return "any value fits"
    if v.open[1]:
        return f"at least {number(v.low, form)}"
    high = number(v.high, form)
    return f"at most {high}" if v.open[0] else f"{number(v.low, form)} to {high}"


def place(one: Finding) -> str:
    """Where on the body, and from when on, as far as it is known."""
    text = f" on {one.on}" if one.on and one.on not in one.title else ""
    if one.at is not None:
        others = "".join(f" or {number(value, '.2f')}" for value in one.at.also)
        text += f" at {number(one.at.value, '.2f')}{others} of its length ({ends(one.at, '.2f')})"
    if one.when is not None:
        others = "".join(f" or {number(value, '.2f')}" for value in one.when.also)
        text += f", from {number(one.when.value, '.2f')}{others} s on ({ends(one.when, '.2f')})"
    return text


def error(found: Diagnosis, value: float) -> str:
    """An error in the recordings' unit."""
    unit, factor = measure(found)
    return f"{number(factor * value)} {unit}"


def sure(found: Diagnosis) -> str:
    """Whether anything is missing, and how sure that is."""
    if found.verdict == "unresolved-numerics":
        worst = found.numerics.worst
        if found.numerics.failed:
            kind, text = next(iter(found.numerics.failed.items()))
            return f"It cannot be said: the error of the {kind} is unknown, for with a finer one {text}."
        return (
            f"It cannot be said: the time step and the mesh alone change the prediction by {worst:.2g} sigma."
        )
    if found.verdict == "unidentifiable":
        if found.findings:
            chances = by_chance(found.findings[0].p)
            return f"Yes (by chance with a probability of {chances}), but all that would show explains it as well."
        return "These recordings cannot tell: no plausible effect would show in them, or all would look the same."
    least = min([s.p for s in found.screened], default=1.0)
    if found.verdict == "none":
        if least < ALPHA:
            return _too_little(found)
        return f"No. The best explanation of all would look as good by chance with a probability of {by_chance(least)}."
    if found.findings:
        best = found.findings[0]
        trials = sum(g > 0.0 for g in best.gains)
        text = f"Yes. The probability that chance alone would gain as much is {by_chance(best.p)}"
        if len(best.gains) < 2:
            return f"{text}. There is no second trial to try it on."
        return (
            f"{text}, and {trials} of {len(best.gains)} trials, each left out in turn, are predicted better with it "
            "than without."
        )
    left = found.remainder
    if unseen_alone(found):
        return f"Yes. {UNSEEN_ALONE} {unlike(found)}"
    if complete(left):
        return PERHAPS
    return (
        f"Yes: what is left is too smooth for noise (probability {by_chance(left.p)}), but nothing that was tried "
        "explains it."
    )


def _too_little(found: Diagnosis) -> str:
    """Why what scores better than chance is no answer."""
    best = min(found.screened, key=lambda s: s.p)
    title, tried = best.candidate.title, [t for t in found.tried if t.id == best.candidate.id]
    if not tried:
        return f"Nothing that could be refitted. To first order “{title}” explains more than chance, and was not."
    if any(t.effect_sigma < LEAST for t in tried):
        return "No: what the best explanation would change is too small to name, whatever its cause."
    return f"No: to first order “{title}” explains more than chance, but {'; '.join(tried[0].reasons)}."


def unit_of_residuals(found: Diagnosis) -> str:
    """What sigma is: the noise, or what the model as it is leaves of each trial."""
    if found.case.noise is None:
        return "the noise"
    noise = next(iter(found.noise.values()))
    white = float(np.sqrt(np.mean(np.square(noise.white))))
    return f"sigma ({error(found, white)} in the first; trials count by distances)"


def channels(location: Location) -> str:
    """Whether it is a force on the body, or an error of what drives or films it."""
    loud = {name: nats for name, nats in location.evidence.items() if location.loud(name)}
    if not loud:
        return (
            "A force without a law, free over body and time, does not stand out of the noise, nor does an error of "
            "drive, camera or markers: with so many freedoms it takes a larger mismatch than a single explanation does."
        )
    ordered, most = sorted(loud.items(), key=lambda item: -item[1]), max(loud.values())
    parts = [f"{CHANNELS[name]} ({nats:.0f} nats)" for name, nats in ordered if nats >= LIKEWISE * most]
    small = [f"{CHANNELS[name]} ({nats:.0f} nats)" for name, nats in ordered[len(parts) :]]
    quiet = [CHANNELS[name] for name in location.evidence if name not in loud]
    text = f"To first order, what the model leaves looks like {' and '.join(parts)}"
    text += f"; {' and '.join(small)} would explain a little beside that" if small else ""
    return text + (f", not like {' or '.join(quiet)}." if quiet and not small else ".")


def _plain(value: float, digits: int) -> str:
    """A number in some digits, without an exponent."""
    return np.format_float_positional(value, digits, unique=False, fractional=False, trim="-")


def spots(location: Location) -> list[str]:
    """The strongest force of each trial, if it stands out."""
    from rodnet.diagnosis.locate import strongest

    found = []
    most = max(float(one.score.max()) for one in location.trials)
    if most < STANDS_OUT:
        return [
            f"No single place and time stands out: it is spread over both ({most:.1f} standard deviations at most)."
        ]
    for one, b, t in strongest(location):
        if one.score[b, t] < STANDS_OUT:
            found.append(
                f"{one.name}: no single place stands out ({one.score[b, t]:.1f} standard deviations at most)."
            )
            continue
        size, sd = (
            float(np.linalg.norm(one.mean[b, t])),
            float(np.linalg.norm(one.mean[b, t]) / one.score[b, t]),
        )
        found.append(
            f"{one.name}: strongest at {one.hats.places[b]:.2f} of {one.hats.rods[b]}, about "
            f"{one.hats.times[t]:.2g} s: {_plain(size, 2)} ± {_plain(sd, 1)} N/m, "
            f"{one.score[b, t]:.1f} standard deviations."
        )
    return found


def beside(one: Finding) -> str:
    """How an effect holds beside what is left."""
    assert one.beside is not None
    beaten = f"it gains more than {percent(one.beside.beaten)} of the placebos"
    where = "on trials left out" if len(one.gains) > 1 else "on the only trial"
    if one.beside.holds:
        return f"Something else is left, but this holds beside it: {beaten} {where}."
    return f"Beside what else is left it may stand in for something: {'; '.join(one.beside.reasons)}."


def gained(gain: float, crossed: float | None, relief: float | None = None) -> str:
    """What an effect gains on trials left out, where there is more than one, and what of their errors it takes off."""
    if crossed is None:
        return f"{number(0.5 * gain)} nats on the only trial"
    text = f"{number(0.5 * crossed)} nats on trials left out"
    return text if relief is None else f"{text}, whose rms errors fall by {percent(relief)}"


def about_law(found: Diagnosis, law: Draft) -> str:
    """The law that was drafted from what is left."""
    one = law.refit
    parts = len(law.candidate.strength)
    alone = law.alone_after is not None
    begin = "With nothing else added, what is missing" if alone else "What is left"
    text = (
        f"{begin} is described by a law without a name, of {parts} parts: it "
        f"changes the prediction by {number(one.effect_sigma, '.2g')} sigma and gains {gained(one.gain, one.crossed)}. "
    )
    if law.alone_after is not None:
        text += f"The rms error on trials held out is {error(found, law.alone_after)} with it. "
    if law.judgement.accepted:
        return f"{text}It is in the repaired robot, and runs like any other term."
    return f"{text}It is not in the repaired robot: {'; '.join(law.judgement.reasons)}."


def about_remainder(found: Diagnosis) -> str:
    """Where, when and in which trial what is smooth in the residuals is largest, with its share there."""
    left = found.left
    parts = [(share, name, k) for name, shares in left.where.items() for k, share in shares.items()]
    told = []
    if len(parts) > 1:
        share, name, k = max(parts)
        which = f"{k} of '{name}'" if len(left.where[name]) > 1 else f"'{name}'"
        told.append(f"{which} ({percent(share)}, {percent(1.0 / len(parts))} if all were alike)")
    tenth = int(np.argmax(left.when))
    told.append(
        f"the time from {10 * tenth} to {10 * (tenth + 1)} % of a trial ({percent(left.when[tenth])})"
    )
    if len(left.trials) > 1:
        worst = int(np.argmax(left.trials))
        told.append(f"{found.names[worst]} ({percent(left.trials[worst])})")
    return f"Of that part most is in {', '.join(told[:-1])}{' and ' if told[:-1] else ''}{told[-1]}."
