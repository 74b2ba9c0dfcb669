"""Score diagnoses against the truth; every rate with its Clopper-Pearson limits."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from benchmarks.blind import plan
from benchmarks.blind.effects import BANK, EFFECTS, FINER, OUTSIDE

# what is demanded: rate of at least (or, of alarms, at most) so many out of so many
DEMANDS = {
    "named right": "at least 57 of 60",
    "true cause in the stated class": "at least 59 of 60",
    "false alarms, white": "at most 1 of 60",
    "false alarms, slow": "at most 1 of 60",
    "false alarms, numerical": "at most 1 of 60",
    "outside the bank, flagged": "at least 29 of 30",
    "place within bounds": "regions 0.05 L, defects 0.1 L",
    "onset within 0.2 s": "",
    "regime right": "at least 80 %",
    "90 % intervals cover": "82 to 97 %",
    "two effects, both named": "at least 70 %",
    "80 % of held-out excess removed": "",
    "more removed than by the placebo": "",
}
LEDGER = Path(__file__).with_name("ledger.jsonl")
CLEAN = ("none", "unresolved-numerics", "unidentifiable")


def family(id: str) -> str:
    """Id of a kind of candidate, without the rod that it is on."""
    return id.split("@")[0]


def limits(hits: int, count: int, level: float = 0.95) -> tuple[float, float]:
    """Clopper-Pearson limits of a rate."""
    from scipy.stats import binomtest

    if count == 0:
        return 0.0, 1.0
    found = binomtest(hits, count).proportion_ci(level, "exact")
    return float(found.low), float(found.high)


def judge(truth: Mapping[str, Any], found: Mapping[str, Any]) -> dict[str, bool | float | None]:
    """Compare one diagnosis with its truth: {score: hit or number}; what does not apply is left out."""
    terms = list(found.get("terms") or [])
    said = [family(term["id"]) for term in terms]
    verdict = found.get("verdict")
    out: dict[str, Any] = {}
    if truth["kind"] == "control":
        out[f"false alarms, {truth['effects'][0]}"] = (
            verdict == "failed" or (verdict not in CLEAN) or bool(terms)
        )
        return out
    if truth["kind"] == "outside":
        out["outside the bank, flagged"] = verdict in ("surrogate", "partial", "unresolved-numerics") or (
            verdict in ("class", "unidentifiable") and not terms
        )
        out |= _removed(found, "outside: half of held-out excess removed", 0.5)
        return out
    right = [set(names) for names in truth["right"]]
    stated = _stated(found, terms)
    named = [term for term in terms if term.get("status", "named") == "named"]
    if len(right) == 1:
        hits = [family(t["id"]) in right[0] for t in named]
        out["named right"] = verdict in ("named", "partial") and bool(hits) and all(hits)
    else:
        out["two effects, both named"] = all(any(s in names for s in said) for names in right)
        out["two effects, a false extra"] = any(not any(s in names for names in right) for s in said)
    out["true cause in the stated class"] = all(names & stated for names in right)
    if terms:
        out["class size"] = sum(len(_class(term)) for term in terms) / len(terms)
    for names, id in zip(right, truth["effects"], strict=True):
        for term in terms:
            if family(term["id"]) in names:
                out |= _details(EFFECTS[id], truth["truth"][id], term)
    if terms:
        out |= _removed(found, "80 % of held-out excess removed", 0.8)
    return out


def _class(term: Mapping[str, Any]) -> set[str]:
    return {family(i) for i in [term["id"], *(term.get("class") or [])]}


def _stated(found: Mapping[str, Any], terms: Iterable[Mapping[str, Any]]) -> set[str]:
    stated = set().union(*(_class(term) for term in terms)) if terms else set()
    others = found.get("equivalents") or {}
    for id, same in others.items():
        stated |= {family(one) for one in (id, *same)}
    return stated


def _details(effect: Any, truth: Mapping[str, Any], term: Mapping[str, Any]) -> dict[str, Any]:
    """Place, onset, regime and intervals of a term with the right name."""
    out: dict[str, Any] = {}
    given = {path.split(".")[-1]: value for path, value in (term.get("parameters") or {}).items()}
    if effect.place is not None and "place" in given:
        out["place within bounds"] = abs(given["place"]["value"] - truth["place"]) <= effect.place
        out["place error"] = abs(given["place"]["value"] - truth["place"])
    if effect.onset and "onset" in given:
        out["onset within 0.2 s"] = abs(given["onset"]["value"] - truth["onset"]) <= 0.2
    if effect.regime is not None:
        out["regime right"] = effect.regime in str(term.get("regime") or "").lower()
    covered = [
        low <= truth[own] <= high
        for theirs, own in effect.asked.items()
        if theirs in given
        for low, high in [(given[theirs].get("low"), given[theirs].get("high"))]
        if low is not None and high is not None
    ]
    if covered:
        out["90 % intervals cover"] = covered
    return out


def _removed(found: Mapping[str, Any], name: str, share: float) -> dict[str, Any]:
    before, after, floor = (found.get(f"error_{k}") for k in ("before", "after", "floor"))
    before, after, floor = (_number(v) for v in (before, after, floor))
    if before is None or after is None:
        return {name: False}
    excess = before**2 - (floor or 0.0) ** 2
    out: dict[str, Any] = {name: excess > 0.0 and (before**2 - after**2) >= share * excess}
    placebo = _number(found.get("placebo_after"))
    if placebo is not None:
        out["more removed than by the placebo"] = after < placebo
    return out


def _number(value: Any) -> float | None:
    """An error in the recording's units, given as a number or beside one in sigma."""
    if isinstance(value, dict):
        value = next(
            (value[k] for k in ("units", "value", "m", "metric", "rms", "sigma") if k in value), None
        )
    return None if value is None else float(value)


def score(root: Path, size: str, seed: str) -> dict[str, Any]:
    """Score a set: counts and limits of each rate, means of each number, and every case."""
    cases, rates, numbers = {}, {}, {}  # type: ignore[var-annotated]
    missing = 0
    for spec in plan.plan(seed, size):
        truth_at, found_at = (
            root / "truth" / f"{spec.name}.json",
            root / "runs" / spec.name / "diagnosis.json",
        )
        if not (truth_at.exists() and found_at.exists()):
            missing += 1
            continue
        truth, found = json.loads(truth_at.read_text()), json.loads(found_at.read_text())
        judged = judge(truth, found)
        cases[spec.name] = {
            **{key: truth[key] for key in ("kind", "effects", "concealed", "family")},
            "post_refit": truth.get("post_refit"), "verdict": found.get("verdict"),
            "said": [term["id"] for term in found.get("terms") or []], "error": found.get("error"),
            "seconds": found.get("seconds", found.get("wall_seconds")), "scores": judged,
        }  # fmt: skip
        for name, value in judged.items():
            for one in value if isinstance(value, list) else [value]:
                (rates if isinstance(one, bool) else numbers).setdefault(name, []).append(one)
    counted = {}
    for name, hits in rates.items():
        low, high = limits(sum(hits), len(hits))
        counted[name] = {
            "hits": sum(hits),
            "of": len(hits),
            "low": low,
            "high": high,
            "demand": DEMANDS.get(name, ""),
        }
    means = {name: sum(values) / len(values) for name, values in numbers.items()}
    return {"set": size, "seed": seed, "missing": missing, "rates": counted, "means": means, "cases": cases}


def table(scored: Mapping[str, Any]) -> str:
    """Rates with their limits, as Markdown."""
    lines = ["| | hits | rate, 95 % limits | demanded |", "|---|---|---|---|"]
    for name in [*DEMANDS, *(n for n in scored["rates"] if n not in DEMANDS)]:
        if row := scored["rates"].get(name):
            rate = row["hits"] / row["of"]
            lines.append(
                f"| {name} | {row['hits']} of {row['of']} | {100 * rate:.0f} % ({100 * row['low']:.0f} to "
                f"{100 * row['high']:.0f} %) | {row['demand']} |"
            )
    lines += [f"| {name}, mean | {value:.3g} | | |" for name, value in scored["means"].items()]
    return "\n".join(lines)


def report(
    root: Path, seed: str, size: str, ledger: Path | None = None, say: Callable[[str], None] = print
) -> dict[str, Any]:
    """Score, print, write ``score.json``, and append to the ledger."""
    scored = score(root, size, seed)
    entry = {"commit": plan.commit(), "date": time.strftime("%Y-%m-%d", time.gmtime()), **scored}
    (root / "score.json").write_text(json.dumps(entry, indent=1))
    say(table(scored))
    for name, case in scored["cases"].items():
        wrong = [
            k
            for k, v in case["scores"].items()
            if v is ("alarm" in k or "false" in k) and isinstance(v, bool)
        ]
        if wrong:
            say(
                f"{name} {'+'.join(case['effects'])} ({case['concealed']}, {case['family']}): "
                f"{case['verdict']} {', '.join(case['said']) or '-'}; {'; '.join(wrong)}"
                + (f"; {case['error']}" if case["error"] else "")
            )
    if scored["missing"]:
        say(f"{scored['missing']} cases have not been generated or diagnosed yet")
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
    """Every scored set, the newest first, as Markdown."""
    entries = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    if not entries:
        return "No sealed set has been scored yet."
    parts = []
    for entry in reversed(entries):
        head = f"**{entry['date']}**, commit `{entry['commit'][:10]}`, seed `{entry['seed'][:12]}`, set {entry['set']}"
        missing = f"; {entry['missing']} cases were not run" if entry["missing"] else ""
        parts.append(f"{head}{missing}\n\n{table(entry)}")
    return "\n\n".join(parts)
