"""What trials that were not seen show, in sentences and rows."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rodnet.numbers import number, percent

if TYPE_CHECKING:
    from rodnet.diagnosis.result import Diagnosis


def resampled(found: Diagnosis) -> str:
    """What other trials of the same kind might have given; empty if that is not known."""
    if not found.resampled:
        return ""
    one = found.resampled[-1]
    how = "the whole diagnosis of recordings that the repaired model might have given"
    how = "trials drawn again, to first order" if one.kind == "linearised" else how
    titles = {one.id: one.title for one in found.findings}
    text = [
        f"{titles.get(id, id)} is found in {'all' if share == 1.0 else percent(share)}"
        for id, share in one.named.items()
    ]
    if one.removed is not None:
        low, high = (number(100.0 * min(v, 1.0), ".0f") for v in one.removed)
        beyond = "" if found.floor is None else " beyond the noise"
        text.append(f"{low} to {high} % of the squared error{beyond} is removed")
    if one.verdicts:
        counts = ", ".join(f"'{verdict}' {count}" for verdict, count in sorted(one.verdicts.items()))
        text.append(f"verdicts: {counts}")
    return f"In {one.draws} repetitions ({how}) {'; '.join(text)}." if text else ""


WORDS = {
    "mean_mm_5s": "distance of free markers in the first 5 s [mm]", "mean_mm_1s": "the same in the first second [mm]",
}  # fmt: skip


def lead_of(found: Diagnosis) -> str:
    """What the repair takes off the mean distance over free markers, beside the placebo."""
    one = found.removed[0]
    what = f"the mean {WORDS.get(one.measure, found.case.metric_name)} "
    does = f"adds {percent(-one.share)} to" if one.share < 0.0 else f"takes {percent(one.share)} off"
    text = f"It {does} {what}"
    if one.files > 1:
        text += f"(90 % interval over {one.files} files: {percent(one.low)} to {percent(one.high)})"
    else:
        text += "(of a single file)"
    placebo = found.placebo_removed
    if placebo is None:
        return f"{text}."
    does = f"adds {percent(-placebo)} to" if placebo < 0.0 else f"takes {percent(placebo)} off"
    return f"{text}; the median placebo {does} the rms error."


def removals(found: Diagnosis) -> list[tuple[str, int, float, float, str, str]]:
    """Rows of a table: what is measured, and what the repair takes off it."""
    return [
        (
            WORDS.get(one.measure, found.case.metric_name) + (f", {one.kind}" if one.kind else ""), one.files,
            one.before, one.after, percent(one.share),
            f"{percent(one.low)} to {percent(one.high)}" if one.files > 1 else "–",
        )
        for one in found.removed
    ]  # fmt: skip
