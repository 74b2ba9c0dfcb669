"""What a sealed set consists of: cases drawn from a seed."""

from __future__ import annotations

import hashlib
import subprocess
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind.effects import BANK, EFFECTS, FINER, OUTSIDE, Effect

SEALED = ("rodnet/inference", "rodnet/diagnosis", "rodnet/terms", "rodnet/tangent")
ROOT = Path(__file__).resolve().parents[2]
CONCEALED = ("plain", "absorbed", "away", "second")
# post-refit size of the effect [sigma] and how many of 20 cases are of each kind
SIZE = {"plain": 4.0, "absorbed": 0.5, "away": 2.5, "second": 2.5}
SHARE = {"plain": 5, "absorbed": 6, "away": 5, "second": 4}
CONTROLS = ("white", "slow", "numerical")
SETS = {
    # effects, controls of each kind, of how many machines, outside the bank
    "full": (60, 60, 20, 30),
    "small": (3, 1, 1, 1),
}
TRIALS = 5


@dataclass(frozen=True)
class Spec:
    """One case, before anything is simulated.

    ``name`` says nothing of what is in it; ``machine`` and ``noise`` are numbers of the machine (with its drives)
    and of the draw of noise.
    """

    name: str
    kind: str  # "effect", "control" or "outside"
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
    listed = subprocess.run(
        ["git", "ls-tree", "-r", "HEAD", "--", *SEALED], cwd=ROOT, check=True, capture_output=True
    ).stdout
    return hashlib.sha256(listed).hexdigest()


def unsealed() -> list[str]:
    """Files of the sealed parts that differ from the commit: a score would be of no commit at all."""
    changed = subprocess.run(
        ["git", "status", "--porcelain", "--", *SEALED], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout
    return [line[3:] for line in changed.splitlines()]


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
    effects, controls, machines, outside = SETS[size]
    rng = generator(seed, "plan", size)
    found = [*_effect_cases(seed, rng, effects), *_outside_cases(seed, rng, outside)]
    for kind in CONTROLS if size == "full" else CONTROLS[:1]:
        for k in range(controls):
            number = k % machines
            found.append(
                _spec(
                    seed, "control", (kind,), "none", _family(number), 1000 + number, k, 0.0, kind == "slow"
                )
            )
    rng.shuffle(found)  # type: ignore[arg-type]
    return found


def _effect_cases(seed: str, rng: np.random.Generator, count: int) -> Iterator[Spec]:
    modes = [mode for mode in CONCEALED for _ in range(SHARE[mode])]
    if count < len(modes):
        modes = ["plain", "absorbed", "away"]
    order: list[Effect] = []
    kinds = (*BANK, *FINER) if count > len(BANK) else BANK
    for k in range(count):
        order = order or [kinds[i] for i in rng.permutation(len(kinds))]
        effect, mode = order.pop(), modes[k % len(modes)]
        if mode == "absorbed" and effect.id == "anisotropy":
            mode = "plain"  # two per cent of it survive a refit: no admissible strength would do
        # a small set has one machine in the plane, if it can have the effect
        if mode == "second" and effect.engine == "finer":
            mode = "away"  # what goes beside another effect must be of the same engine
        family = effect.families[k % len(effect.families)] if count > 3 else effect.families[0]
        names = [effect.id]
        if mode == "second":
            others = [
                e for e in BANK if e is not effect and family in e.families and e.engine == effect.engine
            ]
            names.append(others[rng.integers(len(others))].id)
        yield _spec(
            seed,
            "effect",
            tuple(names),
            mode,
            family,
            k % 12 if count > 3 else 0,
            k,
            SIZE[mode],
            bool(k % 3 == 2),
        )


def _outside_cases(seed: str, rng: np.random.Generator, count: int) -> Iterator[Spec]:
    for k in range(count):
        effect = OUTSIDE[k % len(OUTSIDE)]
        family = effect.families[(k // len(OUTSIDE)) % len(effect.families)]
        yield _spec(
            seed, "outside", (effect.id,), "plain", family, k % 12 if count > 3 else 0, 500 + k, 3.0, False
        )


def _family(number: int) -> str:
    return ("shaken", "spatial", "shaken", "branched", "spatial")[number % 5]


def _spec(
    seed: str, kind: str, effects: tuple[str, ...], concealed: str, family: str, machine: int, noise: int,
    size: float, slow: bool,
) -> Spec:  # fmt: skip
    engine = (
        "finer"
        if effects == ("numerical",)
        else EFFECTS[effects[0]].engine
        if effects[0] in EFFECTS
        else "elastica"
    )
    label = hashlib.sha256(f"{seed}:{kind}:{effects}:{noise}:{concealed}".encode()).hexdigest()[:10]
    sigma = 7e-4 if effects == ("numerical",) else 2e-3
    return Spec(
        f"case_{label}",
        kind,
        effects,
        concealed,
        family,
        machine,
        noise,
        size,
        0.5 if slow else 0.0,
        sigma,
        engine,
    )


def as_dict(spec: Spec) -> dict[str, Any]:
    """For files."""
    return asdict(spec) | {"right": [list(EFFECTS[e].right) for e in spec.effects if e in EFFECTS]}
