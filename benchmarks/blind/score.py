"""Score a set: every rate with its Clopper-Pearson limits, beside what is demanded."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.blind import judge, plan
from benchmarks.blind.effects import BANK, FINER, OUTSIDE

LEDGER = Path(__file__).with_name("ledger.jsonl")
HIDDEN = "absorbed: size before the refit over that after"
FEW = 3  # cases at least of which a rate is told


@dataclass(frozen=True)
class Demand:
    """What a row of the score must reach: a rate, or the mean or median of a number, from ``least`` to ``most``."""

    row: str
    says: str
    least: float | None = None
    most: float | None = None
    number: str | None = None  # "mean" or "median"
    cases: int = 0  # of which it is demanded

    def met(self, value: float) -> bool:
        """Whether it is reached."""
        return (self.least is None or value >= self.least - 1e-12) and (
            self.most is None or value <= self.most + 1e-12
        )


DEMANDS = (
    Demand("named right", "at least 57 of 60", least=57 / 60, cases=60),
    Demand("right name first", "at least 57 of 60", least=57 / 60, cases=60),
    Demand("true cause in the stated class", "at least 59 of 60", least=59 / 60, cases=60),
    Demand("class size", "mean at most 1.5", most=1.5, number="mean"),
    Demand("false alarms, white", "at most 1 of 60", most=1 / 60, cases=60),
    Demand("false alarms, slow", "at most 1 of 60", most=1 / 60, cases=60),
    Demand("false alarms, numerical", "at most 1 of 60", most=1 / 60, cases=60),
    Demand("outside the bank: flagged", "at least 29 of 30", least=29 / 30, cases=30),
    Demand("outside: half removed by a law", "at least 60 %", least=0.6),
    Demand("place: regions within 0.05 L", "at least 80 %", least=0.8, cases=FEW),
    Demand("place: defects within 0.1 L", "at least 80 %", least=0.8, cases=FEW),
    Demand("onset within 0.2 s", "at least 80 %", least=0.8, cases=FEW),
    Demand("regime right", "at least 80 %", least=0.8),
    Demand("90 % intervals of place cover", "82 to 97 %", least=0.82, most=0.97),
    Demand("90 % intervals of strength cover", "82 to 97 %", least=0.82, most=0.97),
    Demand("two effects: both named", "at least 70 %", least=0.7),
    Demand("share of held-out excess removed", "median at least 80 %", least=0.8, number="median"),
    Demand("share removed beyond the placebo's", "median above 0", least=1e-9, number="median"),
    Demand("next trial resolves the class", "at least 80 % of 10 or more", least=0.8, cases=10),
)
BESIDE = (
    "trials alike: true cause stated",
    "trials alike: left open",
    "named right, what is recommended done",
    "outside: a name beside what is left",
    "outside: half of what was left removed by a law",
    judge.BY_ALL,
    judge.BY_FORCE,
    "class without a trial that would tell",
    "two effects: a false extra",
    "80 % of held-out excess removed",
    "more removed than by the placebo",
    "share removed by the placebo",
    HIDDEN,
)
NUMBERS = {"trials alike: left open": "mean", "share removed by the placebo": "median", HIDDEN: "median"}


def limits(hits: int, count: int, level: float = 0.95) -> tuple[float, float]:
    """Clopper-Pearson limits of a rate."""
    from scipy.stats import binomtest

    if count == 0:
        return 0.0, 1.0
    found = binomtest(hits, count).proportion_ci(level, "exact")
    return float(found.low), float(found.high)


def score(root: Path, size: str, seed: str, share: str = "1/1") -> dict[str, Any]:
    """Score what there is of a set: rates, numbers, and every case."""
    cases: dict[str, Any] = {}
    missing = 0
    for spec in plan.part(plan.plan(seed, size), share):
        at = root / "truth" / f"{spec.name}.json"
        run = root / "runs" / spec.name
        truth = json.loads(at.read_text()) if at.exists() else {}
        # what was made otherwise would be made anew
        if truth.get("made_by") != plan.made_by() or not (run / "diagnosis.json").exists():
            missing += 1
            continue
        found = json.loads((run / "diagnosis.json").read_text())
        next_at = run / "next" / "diagnosis.json"
        after = json.loads(next_at.read_text()) if next_at.exists() else None
        scores = judge.judge(truth, found, after)
        if scores and truth["concealed"] == "absorbed" and truth.get("raw"):
            (id,) = truth["effects"]
            scores[HIDDEN] = truth["raw"] / truth["post_refit"][id]
        cases[spec.name] = {
            **{key: truth[key] for key in ("kind", "effects", "concealed", "family", "slow")},
            "post_refit": truth.get("post_refit"), "raw": truth.get("raw"), "verdict": found.get("verdict"),
            "said": [term["id"] for term in found.get("terms") or []], "error": found.get("error"),
            "after_next": None if after is None else after.get("verdict"), "cpu_seconds": found.get("cpu_seconds"),
            "hurried": found.get("hurried"),
            "wrong": judge.wrong(scores), "why": judge.why(truth, found), "scores": scores,
        }  # fmt: skip
    return {"set": size, "share": share, "seed": seed, "missing": missing, **counted(cases), "cases": cases}


def counted(cases: Mapping[str, Any]) -> dict[str, Any]:
    """Rates with their limits, means and medians over cases, and the number of those whose effect was too small."""
    hits: dict[str, list[bool]] = {}
    numbers: dict[str, list[float]] = {}
    for case in cases.values():
        for row, value in case["scores"].items():
            for one in value if isinstance(value, list) else [value]:
                if isinstance(one, bool):
                    hits.setdefault(row, []).append(one)
                else:
                    numbers.setdefault(row, []).append(one)
    rates = {}
    for row, values in hits.items():
        low, high = limits(sum(values), len(values))
        rates[row] = {"hits": sum(values), "of": len(values), "low": low, "high": high}
    summary = {
        row: {"mean": sum(v) / len(v), "median": median(v), "of": len(v)} for row, v in numbers.items()
    }
    return {"rates": rates, "numbers": summary, "small": sum(not case["scores"] for case in cases.values())}


def table(scored: Mapping[str, Any]) -> str:
    """A row for each demand, met or not, and what is told beside them, as Markdown."""
    lines = ["| | cases | rate, 95 % limits | demanded | met |", "|---|---|---|---|---|"]
    rows = (*DEMANDS, *(Demand(row, "", number=NUMBERS.get(row)) for row in BESIDE))
    for demand in rows:
        rate, number = scored["rates"].get(demand.row), scored["numbers"].get(demand.row)
        found = number if demand.number else rate
        if found is None:
            cells, value = ("0", "not measured"), None
        elif demand.number:
            value = found[demand.number]
            cells = str(found["of"]), f"{demand.number} {value:.3g}"
        else:
            value = found["hits"] / found["of"]
            span = f"({100 * found['low']:.0f} to {100 * found['high']:.0f} %)"
            cells = f"{found['hits']} of {found['of']}", f"{100 * value:.0f} % {span}"
        met = "" if not demand.says else "no" if value is None or not demand.met(value) else "yes"
        if met == "yes" and found is not None and found["of"] < demand.cases:
            met = f"so far, with {found['of']} of {demand.cases}"
        lines.append(f"| {demand.row} | {cells[0]} | {cells[1]} | {demand.says} | {met} |")
    return "\n".join(lines)


def failures(scored: Mapping[str, Any]) -> list[str]:
    """A line for each case that went wrong: what it held, what was said, what is wrong with that."""
    lines = []
    for name, case in scored["cases"].items():
        if not case["wrong"]:
            continue
        held = f"{' + '.join(case['effects'])} ({case['concealed']}, {case['family']})"
        said = ", ".join(case["said"]) or "nothing"
        reasons = [case["error"], case.get("why") if "named right" in case["wrong"] else None]
        why = "".join(f"; {reason}" for reason in reasons if reason)
        lines.append(f"{name}, {held}: {case['verdict']}, {said}; not met: {'; '.join(case['wrong'])}{why}")
    return lines


def head(scored: Mapping[str, Any]) -> str:
    """Which set it is, and how much of it."""
    whole = "" if scored["share"] == "1/1" else f", **part {scored['share']} of it**"
    text = f"seed `{scored['seed'][:12]}`, set {scored['set']}{whole}, {len(scored['cases'])} of {of(scored)} cases"
    if scored["missing"]:
        text += f"; {scored['missing']} cases were not run"
    if scored["small"]:
        text += f"; {scored['small']} cases have less than {plan.LEAST} sigma and do not count"
    return text


def of(scored: Mapping[str, Any]) -> int:
    """Number of cases of the whole set."""
    size = plan.SETS[scored["set"]]
    return size.effects + size.controls * size.kinds + size.outside + size.alike


def together(entries: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Parts of one set, scored one after the other, as one entry in the place of the last; of all others as they are.

    They have one seed and one benchmark, so that all of it was made, diagnosed and judged by the same code.
    """
    found: dict[tuple[str, ...], dict[str, Any]] = {}
    for entry in entries:
        key = entry["set"], entry["seed"], entry.get("benchmark", entry["commit"])
        before = found.pop(key, None)
        if before is None:
            found[key] = dict(entry)
            continue
        cases = {**before["cases"], **entry["cases"]}
        parts = {
            **before.get("parts", {before["share"]: before["missing"]}),
            entry["share"]: entry["missing"],
        }
        share, missing = ", ".join(parts), sum(parts.values())
        found[key] = {
            **entry, "share": share, "missing": missing, "parts": parts, "cases": cases, **counted(cases)
        }  # fmt: skip
    return list(found.values())


def report(
    root: Path, seed: str, size: str, share: str = "1/1", ledger: Path | None = None,
    say: Callable[[str], None] = print,
) -> dict[str, Any]:  # fmt: skip
    """Score, print, write ``score.json``, and append to the ledger."""
    scored = score(root, size, seed, share)
    date = time.strftime("%Y-%m-%d", time.gmtime())
    entry = {"commit": plan.commit(), "benchmark": plan.benchmark_hash(), "date": date, **scored}
    root.mkdir(parents=True, exist_ok=True)
    (root / "score.json").write_text(json.dumps(entry, indent=1))
    say("\n".join([head(scored), "", table(scored), "", *failures(scored)]))
    if ledger is not None:
        with ledger.open("a") as file:
            file.write(json.dumps(entry) + "\n")
    return entry


def effects_table() -> str:
    """The effects, their engines and the machines that can have them, as Markdown."""
    lines = ["| effect | named by | engine | machines |", "|---|---|---|---|"]
    for effect in (*BANK, *FINER, *OUTSIDE):
        right = ", ".join(f"`{id}`" for id in effect.right) or "nothing in the bank"
        engine = "PyElastica" if effect.engine == "elastica" else "rodnet, finer"
        lines.append(f"| {effect.id} | {right} | {engine} | {', '.join(effect.families)} |")
    return "\n".join(lines)


def ledger_table(path: Path = LEDGER) -> str:
    """Every scored set, the newest first and unfolded, its parts together, with what went wrong, as Markdown."""
    entries = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    if not entries:
        return "No sealed set has been scored yet."
    parts = []
    for k, entry in enumerate(reversed(together(entries))):
        lines = "\n".join(f"- {line}" for line in failures(entry)) or "Nothing."
        which = f"commit {entry['commit'][:10]}, part {entry['share']} of set {entry['set']}"
        full = f"{head(entry)}\n\n{table(entry)}\n\nWhat went wrong:\n\n{lines}"
        summary = f"<summary>{entry['date']}, {which}: {in_short(entry)}</summary>"
        parts.append(f"<details{'' if k else ' open'}>\n{summary}\n\n{full}\n\n</details>")
    return "\n\n".join(parts)


def in_short(scored: Mapping[str, Any]) -> str:
    """The rates of what is demanded of a number of cases, in a line."""
    rows = [demand.row for demand in DEMANDS if demand.cases] + ["outside: half removed by a law"]
    found = [(row, scored["rates"][row]) for row in rows if row in scored["rates"]]
    return "; ".join(f"{row} {rate['hits']} of {rate['of']}" for row, rate in found) or "nothing measured"
