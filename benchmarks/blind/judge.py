"""Whether a diagnosis is right: each case by itself."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from benchmarks.blind.effects import EFFECTS, asked
from benchmarks.blind.plan import ALIKE, LEAST
from benchmarks.blind.run import open_class, recommended

CLEAN = ("none", "unresolved-numerics", "unidentifiable")
SURE = ("named", "partial")
BY_FORCE = "regime, by the force alone"
BY_ALL = "outside: half removed by what stands in and the law"
# rows that tell more of what other rows judge
BESIDE = BY_FORCE, BY_ALL, "outside: half of what was left removed by a law"
LAW = "local-law"  # id of what is drafted
PLACED = ("place", "onset")  # parameters that say where or when
ONSET = 0.2  # [s]
REMOVED, DRAFTED = 0.8, 0.5  # of the held-out excess, by the repaired model and by a drafted law

Scores = dict[str, bool | float | list[bool]]


def judge(
    truth: Mapping[str, Any], found: Mapping[str, Any], after: Mapping[str, Any] | None = None
) -> Scores:
    """Compare a diagnosis with its truth; ``after`` is the one with the trial that it recommended.

    Returns
    -------
    dict
        Hits by row of the score, lists of hits where a case has several, and numbers; what does not apply is left out.
    """
    terms = list(found.get("terms") or [])
    if truth["kind"] == "control":
        alarm = bool(terms) or found.get("verdict") not in CLEAN
        return {f"false alarms, {truth['effects'][0]}": alarm}
    if too_small(truth):
        return {}
    if truth["kind"] == "outside":
        return {
            "outside the bank: flagged": _flagged(found, terms),
            "outside: a name beside what is left": any(term.get("status") == "named" for term in terms),
            "outside: half removed by a law": _law(found, alone=True),
            "outside: half of what was left removed by a law": _law(found, alone=False),
            BY_ALL: _by_all(found),
        }
    right = [set(names) for names in truth["right"]]
    same = [
        names.union(also)
        for names, also in zip(right, truth.get("twins") or [[] for _ in right], strict=True)
    ]
    first = _named_right(found, right, same, truth)
    out: Scores = {
        "named right": first,
        "right name first": first or _first_right(found, same, truth),
        "true cause in the stated class": bool(right[0] & _stated(found, terms, truth)),
        "named right, what is recommended done": first
        or (after is not None and _named_right(after, right, same, truth)),
    }
    if len(right) > 1:
        pairs = list(zip(right, same, strict=True))
        out["two effects: both named"] = all(any(_names(t, *pair, truth) for t in terms) for pair in pairs)
        out["two effects: a false extra"] = bool(_false(terms, same, truth))
    if terms:
        out["class size"] = sum(len(_class(term, truth)) for term in terms) / len(terms)
    for names, id in zip(right, truth["effects"], strict=True):
        for term in terms:
            if _kind(term["id"], truth) in names and term.get("status") != "surrogate":
                out |= _details(id, truth["truth"][id], term, out)
        if EFFECTS[id].regime is not None:
            out |= _regimes(id, names, truth, found, out)
    out |= _removed(found)
    if open_class(found):
        asked_for = bool(recommended(found))
        out["class without a trial that would tell"] = not asked_for
        there = bool(right[0] & _stated(found, terms, truth))  # else there is nothing right to be left of it
        if asked_for and after is not None and there:
            out["next trial resolves the class"] = _resolved(right, same, found, after, truth)
    return _of_alike(out, found) if truth["kind"] == ALIKE else out


def _of_alike(scores: Scores, found: Mapping[str, Any]) -> Scores:
    """What is asked of trials that are alike: not to say more than they tell, and which trial would."""
    kept = ("next trial resolves the class", "class without a trial that would tell")
    return {
        "trials alike: true cause stated": scores["true cause in the stated class"],
        "trials alike: left open": float(open_class(found)),
        **{row: scores[row] for row in kept if row in scores},
    }


def too_small(truth: Mapping[str, Any]) -> bool:
    """Whether no admissible strength makes the effect as large as a case must be."""
    sizes = truth.get("post_refit") or {}
    return any(sizes.get(id, LEAST) < LEAST for id in truth["effects"])


def wrong(scores: Scores) -> list[str]:
    """Rows that a case fails, but for what is only told beside them."""
    alarms = ("false alarms", "two effects: a false extra", "class without a trial", "outside: a name")
    return [
        row
        for row, value in scores.items()
        if row not in BESIDE
        and (
            (isinstance(value, bool) and value is row.startswith(alarms))
            or (isinstance(value, list) and not all(value))
        )
    ]


def why(truth: Mapping[str, Any], found: Mapping[str, Any]) -> str:
    """What a diagnosis said of the true effects that it did not name, in words."""
    lines = []
    for names in truth.get("right") or []:
        if any(
            _kind(t["id"], truth) in names and t.get("status") == "named" for t in found.get("terms") or []
        ):
            continue
        refits = [r for r in found.get("refits") or [] if _kind(r["id"], truth) in names]
        scores = [s for s in found.get("scores") or [] if _kind(s["id"], truth) in names]
        if refits:
            best = max(refits, key=lambda refit: refit["gain"])
            most = max(found["refits"], key=lambda refit: refit["gain"])
            said = "; ".join(best["reasons"]) or "acceptable"
            lines.append(
                f"{best['id']} gained {best['gain']:.3g} of deviance ({said}), {most['id']} {most['gain']:.3g}"
            )
        elif scores:
            best = max(scores, key=lambda score: score["chi2"])
            lines.append(
                f"{best['id']} was not refitted, its score being {best['chi2']:.3g} (p = {best['p']:.2g})"
            )
        else:
            lines.append(f"{' or '.join(sorted(names))} was not tried")
    return "; ".join(lines)


ABOVE, SIDEWAYS = ("wall", "obstacle"), "gravity@sideways"


def family(id: str) -> str:
    """Id of a kind of candidate, without the rod that it is on."""
    return id.split("@")[0]


def _kind(id: str, truth: Mapping[str, Any]) -> str:
    """Id of a kind of candidate; of one about another marker or side than the truth's the whole id: it is of no kind.

    Walls and obstacles of a truth are above, and weights pull down.
    """
    if id == SIDEWAYS or (family(id) in ABOVE and not id.endswith("@+z")):
        return id
    marked = [v["marker"] for v in truth["truth"].values() if "marker" in v]
    there = [truth["kept"].index(m) for m in marked]
    single = family(id) in ("marker-place", "marker-slip") and marked
    return id if single and not id.endswith(tuple(f":{k}" for k in there)) else family(id)


def _class(term: Mapping[str, Any], truth: Mapping[str, Any]) -> set[str]:
    return {_kind(i, truth) for i in [term["id"], *(term.get("class") or [])]}


def _stated(
    found: Mapping[str, Any], terms: Iterable[Mapping[str, Any]], truth: Mapping[str, Any]
) -> set[str]:
    stated = set().union(*(_class(term, truth) for term in terms))
    for id, same in (found.get("equivalents") or {}).items():
        stated |= {_kind(one, truth) for one in (id, *same)}
    return stated


def _named(terms: Iterable[Mapping[str, Any]], truth: Mapping[str, Any]) -> list[str]:
    return [_kind(term["id"], truth) for term in terms if term.get("status", "named") == "named"]


def _false(terms: Iterable[Mapping[str, Any]], same: list[set[str]], truth: Mapping[str, Any]) -> list[str]:
    """Names that are none of the effects', and classes in which none of them is."""
    true, terms = set().union(*same), list(terms)
    classes = [t["id"] for t in terms if t.get("status") == "class" and not _class(t, truth) & true]
    return [id for id in _named(terms, truth) if id not in true] + classes


def _named_right(
    found: Mapping[str, Any], right: list[set[str]], same: list[set[str]], truth: Mapping[str, Any]
) -> bool:
    """Whether the first effect is named, and nothing wrong is."""
    terms = list(found.get("terms") or [])
    sure = found.get("verdict") in SURE and not _false(terms, same, truth)
    return (sure and any(id in right[0] for id in _named(terms, truth))) or _by_twins(
        found, terms, right, same, truth
    )


def _first_right(found: Mapping[str, Any], same: list[set[str]], truth: Mapping[str, Any]) -> bool:
    """Whether the first effect stands for its class, whatever else is in it, and nothing wrong stands for another."""
    terms = [term for term in found.get("terms") or [] if term.get("status") != "surrogate"]
    heads = [_kind(term["id"], truth) for term in terms]
    listed = found.get("verdict") in ("class", *SURE) and not _false(terms, same, truth)
    return listed and any(head in same[0] for head in heads) and set(heads) <= set().union(*same)


def _by_twins(
    found: Mapping[str, Any], terms: list[Mapping[str, Any]], right: list[set[str]], same: list[set[str]],
    truth: Mapping[str, Any],
) -> bool:  # fmt: skip
    """Whether the first effect is named and nothing wrong is, where a class of names of one motion is a name."""
    if found.get("verdict") not in ("class", *SURE):
        return False
    every = range(len(right))
    return any(_names(term, right[0], same[0], truth) for term in terms) and all(
        any(_names(term, right[k], same[k], truth) for k in every) for term in terms
    )


def _names(term: Mapping[str, Any], right: set[str], same: set[str], truth: Mapping[str, Any]) -> bool:
    """Whether a term names an effect, be it by a class of its names, or of names of the same motion."""
    status = term.get("status", "named")
    alike = status != "surrogate" and _class(term, truth) <= same
    return alike or (status == "named" and _kind(term["id"], truth) in right)


def _flagged(found: Mapping[str, Any], terms: list[Mapping[str, Any]]) -> bool:
    """Whether a diagnosis says that no name of the bank is the whole of it."""
    verdict = found.get("verdict")
    if verdict in ("class", "unidentifiable"):
        return not terms
    return verdict in ("surrogate", "partial")


def _resolved(
    right: list[set[str]], same: list[set[str]], before: Mapping[str, Any], found: Mapping[str, Any],
    truth: Mapping[str, Any],
) -> bool:  # fmt: skip
    """Whether the right one is named, alone in its class or with what makes the same motion, and nothing wrong is.

    What no trial of the menu tells from it, as was said before, may be left.
    """
    true = set().union(*right, *same)
    untold = set().union(*(pair for pair in _untold(before, truth) if pair & true)) - true
    terms = [term for term in found.get("terms") or [] if term.get("status", "named") != "surrogate"]
    pairs = list(zip(right, same, strict=True))
    terms = [_without(term, untold, truth) for term in terms]
    alone = all(len(kinds := _class(t, truth)) == 1 or any(kinds <= alike for alike in same) for t in terms)
    told = found.get("verdict") in ("class", *SURE)
    return (
        told
        and alone
        and any(_names(term, *pairs[0], truth) for term in terms)
        and all(any(_names(term, *pair, truth) for pair in pairs) for term in terms)
    )


def _untold(found: Mapping[str, Any], truth: Mapping[str, Any]) -> list[set[str]]:
    """Pairs of kinds of which a diagnosis says that no trial of the menu tells the one from the other."""
    none = [
        p["between"] for p in found.get("next_experiment") or [] if not p.get("needed") and p.get("between")
    ]
    return [{_kind(one, truth), _kind(other, truth)} for one, *others in none for other in others]


def _without(term: Mapping[str, Any], untold: set[str], truth: Mapping[str, Any]) -> Mapping[str, Any]:
    """A class without some kinds of it, if it is more than these."""
    ids = [id for id in [term["id"], *(term.get("class") or [])] if _kind(id, truth) not in untold]
    return {**term, "id": ids[0], "class": ids} if ids else term


def _details(id: str, truth: Mapping[str, Any], term: Mapping[str, Any], before: Scores) -> Scores:
    """Place, onset and intervals of a term with the right name."""
    out: Scores = {}
    effect, true = EFFECTS[id], asked(id, truth)
    given = dict(term.get("parameters") or {})
    given |= {path.split(".")[-1].partition("[")[0]: value for path, value in given.items()}

    def hit(row: str, right: bool) -> None:  # of two effects both must be
        out[row] = right and before.get(row, True) is True

    if effect.place is not None:
        row = "place: regions within 0.05 L" if effect.place < 0.1 else "place: defects within 0.1 L"
        hit(row, "place" in given and abs(given["place"]["value"] - truth["place"]) <= effect.place)
    if effect.onset:
        hit("onset within 0.2 s", "onset" in given and abs(given["onset"]["value"] - truth["onset"]) <= ONSET)
    for name, value in true.items():
        if name in given:
            low, high = (given[name].get(end) for end in ("low", "high"))
            above, below = low is None or low <= value, high is None or value <= high
            row = f"90 % intervals of {'place' if name in PLACED else 'strength'} cover"
            hits = out.setdefault(row, list(before.get(row, [])))  # type: ignore[arg-type]
            # of one side, where a bound is the other; none at all covers nothing
            hits.append(above and below and not (low is None and high is None))  # type: ignore[union-attr]
    return out


def _regimes(
    id: str, names: set[str], truth: Mapping[str, Any], found: Mapping[str, Any], before: Scores
) -> Scores:
    """Whether the regime is told: by the right term, else by the force that was missing; and by this alone."""
    there = [
        t
        for t in found.get("terms") or []
        if _kind(t["id"], truth) in names and t.get("status") != "surrogate"
    ]
    force = str((found.get("regime") or {}).get("variable") or "")
    told = [str(t.get("regime") or "") for t in there] or [force]
    right = {"regime right": EFFECTS[id].regime in told, BY_FORCE: EFFECTS[id].regime == force}
    return {row: hit and before.get(row, True) is True for row, hit in right.items()}


def _removed(found: Mapping[str, Any]) -> Scores:
    """Share of the held-out excess that the repaired model removes, and that of the placebo."""
    after, placebo = _share(found, found.get("error_after")), _share(found, found.get("placebo_after"))
    if after is None and found.get("verdict") == "failed":
        after = 0.0  # nor does it remove anything
    out: Scores = {}
    if not _nothing(found):
        out["80 % of held-out excess removed"] = after is not None and after >= REMOVED
    if after is not None:
        out["share of held-out excess removed"] = after
        if placebo is not None or found.get("verdict") == "failed":
            out["more removed than by the placebo"] = placebo is not None and after > placebo
        if placebo is not None:
            out["share removed by the placebo"] = placebo
            out["share removed beyond the placebo's"] = after - placebo
    return out


def _nothing(found: Mapping[str, Any]) -> bool:
    """Whether there is nothing to remove: the trial held out is predicted to the noise by the model as it is."""
    before, floor = found.get("error_before"), found.get("error_floor")
    return before is not None and floor is not None and before <= floor


def _law(found: Mapping[str, Any], alone: bool) -> bool:
    """Whether the drafted law, run as a term, removes half of the held-out excess.

    ``alone``: of all that the model as it is leaves, whatever else was accepted; else of what there was when it joined.
    """
    law, terms = found.get("law") or {}, found.get("terms") or []
    if "error_after" in law or not law.get("accepted"):
        share = _share(found, law.get("error_after"))
    else:
        gone = [term.get("explained_fraction") or 0.0 for term in terms]
        own = [g for g, term in zip(gone, terms, strict=True) if family(term["id"]) == LAW]
        others = sum(g for g, term in zip(gone, terms, strict=True) if family(term["id"]) != LAW)
        left = 1.0 if alone else 1.0 - others
        share = own[0] / left if own and left > 0.0 else None
    return share is not None and share >= DRAFTED


def _by_all(found: Mapping[str, Any]) -> bool:
    """Whether the repaired model, with whatever stands in it and the law, removes half of the held-out excess."""
    share = _share(found, found.get("error_after"))
    return share is not None and share >= DRAFTED


def _share(found: Mapping[str, Any], after: float | None) -> float | None:
    """Of the held-out error^2 above the floor, what is gone; None where nothing was above it, or all is unknown."""
    before, floor = found.get("error_before"), found.get("error_floor")
    if before is None or after is None:
        return None
    excess = before**2 - (floor or 0.0) ** 2
    return (before**2 - after**2) / excess if excess > 0.0 else None
