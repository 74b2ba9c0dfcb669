"""The blind benchmark: ``python -m benchmarks.blind generate|run|next|score --set full|small|smoke --workers N``."""

from __future__ import annotations

from benchmarks import process

process.one_thread()  # before NumPy is loaded

import argparse  # noqa: E402
from pathlib import Path  # noqa: E402

from benchmarks.blind import cost, plan, work  # noqa: E402
from benchmarks.blind.generate import ELEMENTS, generate  # noqa: E402
from benchmarks.blind.run import LIMIT, diagnose, follow  # noqa: E402

STEPS = ("generate", "run", "next", "score")


def main(arguments: list[str] | None = None) -> int:
    """Do the steps that are asked for, all by default; what is done already is left as it is."""
    given = _given(arguments)
    seed = given.seed or plan.tree_hash()
    root = given.root / f"{given.size}_{seed[:12]}"
    specs = plan.part(plan.plan(seed, given.size), given.share)
    if given.only:
        specs = [spec for spec in specs if spec.name in given.only]
    print(cost.told(specs, root, given.workers), flush=True)
    failed = 0
    if "generate" in given.steps:
        # one of each machine first, so that no two processes compute what they could share
        seen: set[tuple[object, ...]] = set()
        first: list[tuple[object, ...]] = []
        rest: list[tuple[object, ...]] = []
        for spec in specs:
            key = spec.engine, spec.family, spec.machine
            (rest if key in seen else first).append((seed, spec, root, given.elements))
            seen.add(key)
        failed += work.each(generate, first, given.workers, "machines")
        failed += work.each(generate, rest, given.workers, "generate")
    if "run" in given.steps:
        ready = [s.name for s in specs if (root / "truth" / f"{s.name}.json").exists()]
        jobs = [(root / "data" / n, root / "runs" / n, given.candidates, given.limit) for n in ready]
        failed += work.each(diagnose, jobs, given.workers, "diagnose")
    if "next" in given.steps:
        done = [s for s in specs if (root / "runs" / s.name / "diagnosis.json").exists()]
        again = [(seed, s, root, given.candidates, given.limit, given.elements) for s in done]
        failed += work.each(follow, again, given.workers, "next trials")
    if "score" in given.steps:
        from benchmarks.blind.score import report

        report(root, seed, given.size, given.share, given.ledger)
    return 1 if failed else 0


def _given(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind", description=__doc__)
    parser.add_argument("steps", nargs="*", default=list(STEPS), metavar="|".join(STEPS), help="default: all")
    parser.add_argument("--set", choices=sorted(plan.SETS), default="full", dest="size")
    parser.add_argument(
        "--share",
        default="1/1",
        metavar="[KIND:]K/N",
        help="only the K-th of N parts of the set, or of its cases of a kind (the ledger says so)",
    )
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--limit", type=float, default=LIMIT, help="CPU time of a diagnosis [s]")
    where = plan.ROOT / ".cache" / "blind"
    parser.add_argument("--root", type=Path, default=where, help="where sets are kept")
    parser.add_argument(
        "--seed", help="of a development set (default: the seal, a hash of the code under test)"
    )
    parser.add_argument("--elements", type=int, default=ELEMENTS, help="of the true rods")
    parser.add_argument("--candidates", nargs="+", help="ids to try, of a development set (default: all)")
    parser.add_argument("--only", nargs="+", metavar="CASE", help="names of cases, of a development set")
    parser.add_argument("--ledger", type=Path, help="file to which the score is appended")
    given = parser.parse_args(arguments)
    if wrong := sorted(set(given.steps) - set(STEPS)):
        parser.error(f"no step '{wrong[0]}'; there are {', '.join(STEPS)}")
    try:
        plan.part([], given.share)
    except ValueError as error:
        parser.error(f"--share: {error}")
    chosen = given.seed or given.candidates or given.only or given.elements != ELEMENTS
    if given.ledger and chosen:
        parser.error(
            "only a sealed set goes into the ledger, whole or a share: no --seed, --candidates, --only, --elements"
        )
    if given.ledger and (changed := plan.unsealed()):
        parser.error(f"a score in the ledger is of a commit: commit {', '.join(changed[:3])} first")
    return given


if __name__ == "__main__":
    raise SystemExit(main())
