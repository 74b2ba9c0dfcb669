"""The blind benchmark: ``python -m benchmarks.blind generate|run|score --set full|small --workers N``."""

from __future__ import annotations

from benchmarks import process

process.one_thread()  # before NumPy is loaded

import argparse  # noqa: E402
from pathlib import Path  # noqa: E402

from benchmarks.blind import plan, work  # noqa: E402
from benchmarks.blind.generate import ELEMENTS, generate  # noqa: E402
from benchmarks.blind.run import diagnose  # noqa: E402

STEPS = ("generate", "run", "score")


def main(arguments: list[str] | None = None) -> int:
    """Do the steps that are asked for, all by default."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind", description=__doc__)
    parser.add_argument(
        "steps", nargs="*", default=list(STEPS), metavar="generate|run|score", help="default: all"
    )
    parser.add_argument("--set", choices=sorted(plan.SETS), default="full", dest="size")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument(
        "--root", type=Path, default=plan.ROOT / ".cache" / "blind", help="where sets are kept"
    )
    parser.add_argument(
        "--seed", help="of a development set (default: the seal, a hash of the code under test)"
    )
    parser.add_argument("--elements", type=int, default=ELEMENTS, help="of the true rods")
    parser.add_argument("--candidates", nargs="+", help="ids to try, of a development set (default: all)")
    parser.add_argument("--ledger", type=Path, help="file to which the score is appended")
    given = parser.parse_args(arguments)
    if wrong := sorted(set(given.steps) - set(STEPS)):
        parser.error(f"no step '{wrong[0]}'; there are {', '.join(STEPS)}")
    if given.ledger and (given.seed or plan.unsealed()):
        parser.error(
            "only a sealed set of a committed state goes into the ledger: no --seed, and commit first"
        )
    seed = given.seed or plan.tree_hash()
    root = given.root / f"{given.size}_{seed[:12]}"
    specs = plan.plan(seed, given.size)
    failed = 0
    if "generate" in given.steps:
        # one of each machine first, so that no two processes compute what they could share
        seen, first, rest = set(), [], []
        for spec in specs:
            key = spec.engine, spec.family, spec.machine
            (rest if key in seen else first).append((seed, spec, root, given.elements))
            seen.add(key)
        failed += work.each(generate, first, given.workers, "machines")
        if rest:
            failed += work.each(generate, rest, given.workers, "generate")
    if "run" in given.steps:
        ready = [s.name for s in specs if (root / "truth" / f"{s.name}.json").exists()]
        jobs = [(root / "data" / name, root / "runs" / name, given.candidates) for name in ready]
        failed += work.each(diagnose, jobs, given.workers, "diagnose")
    if "score" in given.steps:
        from benchmarks.blind.score import report

        report(root, seed, given.size, given.ledger)
    return 1 if failed else 0


if __name__ == "__main__":
    raise SystemExit(main())
