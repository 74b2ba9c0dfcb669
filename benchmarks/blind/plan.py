"""What a sealed set consists of: cases drawn from a seed."""

from __future__ import annotations

import hashlib
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.effects import ABSORBED, BANK, EFFECTS, FINER, MISTAKEN, OUTSIDE, Effect

SHOWING = "report", "viz", "cli*.py", "demo.py"  # of the package: what no answer depends on
SEALED = ("rodnet", "plugins", *(f":(exclude)rodnet/{some}" for some in SHOWING))
GENERATOR = ("benchmarks/blind", ":(exclude)benchmarks/blind/ledger.jsonl")
# of its files, those that make no case
MAKE_NOTHING = "judge", "score", "cost", "work", "shipped", "__main__"
ROOT = Path(__file__).resolve().parents[2]
CONCEALED = ("plain", "absorbed", "away", "second")
OTHERS = ("plain", "weak", "away")  # of kinds that do not come in all of these ways
ALIKE = "alike"  # trials: all of one regime, seen by one marker
# post-refit size of the effect [sigma]; what is smaller than the least is no case
SIZE = {"plain": 4.0, "absorbed": 0.65, "weak": 0.65, "away": 2.5, "second": 2.5, ALIKE: 0.8}
LEAST = 0.5
DEFECT = 0.1  # within which the place of a defect must be told, over a rod's length; that of a region within half of it
KINDS = "effect", "control", "outside", ALIKE  # of cases
CONTROLS = ("white", "slow", "numerical")


@dataclass(frozen=True)
class Size:
    """How many cases of each kind a set has.

    ``core`` kinds of effect come plain and concealed in each of the three ways, others once in one of `OTHERS`, up to
    ``effects`` cases; ``controls`` of each of ``kinds``, on ``machines`` machines; ``outside`` effects that no
    candidate names; ``alike`` effects in trials that are so much alike that another one may have to tell.
    """

    effects: int
    core: int
    controls: int
    machines: int
    kinds: int
    outside: int
    variety: int  # machines of each family
    alike: int = 0


SETS = {
    "full": Size(66, 10, 60, 20, 3, 30, 6),  # of 66 effects some six are too small to count
    "small": Size(12, 2, 3, 3, 3, 6, 1),
    "smoke": Size(2, 0, 1, 1, 1, 1, 1),
    ALIKE: Size(0, 0, 0, 1, 0, 0, 4, alike=36),
}
TRIALS, HELD_OUT = 5, 1  # of a case, and of these not to learn from: the last


@dataclass(frozen=True)
class Spec:
    """One case, before anything is simulated.

    ``name`` says nothing of what is in it; ``machine`` and ``noise`` are numbers of the machine (with its drives)
    and of the draw of noise.
    """

    name: str
    kind: str  # of KINDS
    effects: tuple[str, ...]
    concealed: str
    family: str
    machine: int
    noise: int
    size: float
    slow: float
    sigma: float  # over the first rod's length
    engine: str


def tree_hash() -> str:
    """SHA-256 of the tracked files' names and contents: any change of them draws another set."""
    return _hash(*SEALED)


def benchmark_hash() -> str:
    """The same of the benchmark itself: parts of a set that were made or judged otherwise are not of one set."""
    return _hash(*GENERATOR)


@cache
def made_by() -> str:
    """SHA-256 of what makes recordings and has them diagnosed: a case that was made otherwise is another one."""
    here = Path(__file__).parent
    files = sorted({*here.rglob("*.py")} - {here / f"{name}.py" for name in MAKE_NOTHING})
    return hashlib.sha256(b"".join(file.name.encode() + file.read_bytes() for file in files)).hexdigest()[:16]


def _hash(*paths: str) -> str:
    listed = subprocess.run(
        ["git", "ls-files", "-s", "--", *paths], cwd=ROOT, check=True, capture_output=True
    ).stdout
    return hashlib.sha256(listed).hexdigest()


def unsealed() -> list[str]:
    """Files of the code under test, or of the benchmark, that differ from the commit."""
    changed = subprocess.run(
        ["git", "status", "--porcelain", "--", *SEALED, *GENERATOR],
        cwd=ROOT, check=True, capture_output=True, text=True,
    ).stdout  # fmt: skip
    return [line[3:] for line in changed.splitlines()]


def variant(options: Sequence[Any]) -> str:
    """What a set that the seed alone does not tell of is called beside it: by options, and changes not committed."""
    changed = [(name, (ROOT / name).read_bytes() if (ROOT / name).is_file() else b"") for name in unsealed()]
    if not any(options) and not changed:
        return ""
    return "_" + hashlib.sha256(repr((options, changed)).encode()).hexdigest()[:8]


def commit() -> str:
    """The commit at hand."""
    return subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.strip()


def generator(seed: str, *labels: Any) -> np.random.Generator:
    """A generator of random numbers of its own for each part of a set."""
    text = ":".join([seed, *map(str, labels)])
    return np.random.default_rng(int.from_bytes(hashlib.sha256(text.encode()).digest()[:16], "big"))


def plan(seed: str, size: str = "full") -> list[Spec]:
    """Draw the cases of a set, in random order."""
    wanted = SETS[size]
    rng = generator(seed, "plan", size)
    found = [*_effect_cases(seed, rng, wanted), *_outside_cases(seed, rng, wanted)]
    if wanted.alike:
        found += _alike_cases(seed, rng, wanted)
    for kind in CONTROLS[: wanted.kinds]:
        for k in range(wanted.controls):
            number = k % wanted.machines
            found.append(_spec(seed, "control", (kind,), "none", _family(number), 1000 + number, k, 0.0))
    rng.shuffle(found)
    return found


def part(specs: list[Spec], share: str) -> list[Spec]:
    """The K-th of N parts of a set, ``"K/N"``, with its share of each kind of case; or of one kind, ``"effect:K/N"``.

    Raises
    ------
    ValueError
        If the share is none.
    """
    kind, _, which = share.rpartition(":")
    try:
        k, n = (int(v) for v in which.split("/"))
    except ValueError:
        k, n = 0, 0
    if not 1 <= k <= n or kind not in ("", *KINDS):
        raise ValueError(
            f"a share is 'K/N' with K from 1 to N, or of {', '.join(KINDS)} 'KIND:K/N', got '{share}'"
        )
    specs = [spec for spec in specs if kind in ("", spec.kind)]
    alike = sorted(
        specs, key=lambda spec: (spec.kind, spec.effects if spec.kind == "control" else (), spec.concealed)
    )
    kept = {spec.name for spec in alike[k - 1 :: n]}
    return [spec for spec in specs if spec.name in kept]


def _effect_cases(seed: str, rng: np.random.Generator, wanted: Size) -> Iterator[Spec]:
    kinds = [EFFECTS[id] for id in rng.permutation([e.id for e in (*BANK, *FINER)])]
    if wanted.variety == 1 and not wanted.core:
        kinds = [e for e in kinds if e.families[0] == "shaken"]  # the quickest to simulate
    able = [e for e in kinds if e.id in ABSORBED]
    first = [
        e for e in able if e.onset or (e.place or 1.0) < DEFECT
    ]  # few kinds have an onset, or are a region
    core = [*first, *(e for e in able if e not in first)][: wanted.core]
    others = [e for e in kinds if e not in core]
    cases = [(e, mode) for e in core for mode in CONCEALED]
    for k in range(wanted.effects - len(cases)):
        effect = others[k % len(others)]
        cases.append((effect, OTHERS[k % 3] if effect.concealable else "plain"))
    for k, (effect, mode) in enumerate(cases):
        family = effect.families[(k + k // 4) % len(effect.families)] if wanted.core else effect.families[0]
        names = [effect.id]
        if mode == "second":
            beside = [
                e
                for e in BANK
                if e is not effect and family in e.families and not twins(e, effect) and not marked(e, effect)
            ]
            names.append(beside[rng.integers(len(beside))].id)
        slow = bool(rng.random() < 1 / 3)
        yield _spec(seed, "effect", tuple(names), mode, family, k % wanted.variety, k, SIZE[mode], slow)


def _outside_cases(seed: str, rng: np.random.Generator, wanted: Size) -> Iterator[Spec]:
    kinds = [EFFECTS[id] for id in rng.permutation([e.id for e in OUTSIDE])]
    for k in range(wanted.outside):
        effect = kinds[k % len(kinds)]
        family = effect.families[(k // len(kinds)) % len(effect.families)]
        slow = bool(rng.random() < 1 / 3)
        yield _spec(
            seed, "outside", (effect.id,), "plain", family, k % wanted.variety, 500 + k, SIZE["plain"], slow
        )


def _alike_cases(seed: str, rng: np.random.Generator, wanted: Size) -> Iterator[Spec]:
    kinds = [EFFECTS[id] for id in rng.permutation(list(MISTAKEN))]
    for k in range(wanted.alike):
        effect = kinds[k % len(kinds)]
        family = effect.families[k % len(effect.families)]
        yield _spec(seed, ALIKE, (effect.id,), ALIKE, family, k % wanted.variety, 700 + k, SIZE[ALIKE])


def _family(number: int) -> str:
    return ("shaken", "spatial", "shaken", "branched", "spatial")[number % 5]


def _spec(
    seed: str, kind: str, effects: tuple[str, ...], concealed: str, family: str, machine: int, noise: int,
    size: float, slow: bool = False,
) -> Spec:  # fmt: skip
    numerical = effects == ("numerical",)
    engine = "finer" if numerical else "elastica" if kind == "control" else EFFECTS[effects[0]].engine
    label = hashlib.sha256(f"{seed}:{kind}:{effects}:{noise}:{concealed}".encode()).hexdigest()[:10]
    share = 0.5 if slow or effects == ("slow",) else 0.0
    # a numerical control has little noise, so that the difference of the meshes shows
    sigma = 7e-4 if numerical else 2e-3
    return Spec(f"case_{label}", kind, effects, concealed, family, machine, noise, size, share, sigma, engine)


def twins(one: Effect, other: Effect) -> bool:
    """Whether two effects are the same motion by two names."""
    return bool({*one.right, *one.twins} & {*other.right, *other.twins})


def marked(one: Effect, other: Effect) -> bool:
    """Whether both effects are of a single marker, which might be the same."""
    return all(e.id in ("misplaced-marker", "slipping-marker") for e in (one, other))


def as_dict(spec: Spec) -> dict[str, Any]:
    """For files."""
    there = [EFFECTS[e] for e in spec.effects if e in EFFECTS]
    twins = [list(e.twins_on(spec.family)) for e in there]
    return asdict(spec) | {"right": [list(e.right) for e in there], "twins": twins}
