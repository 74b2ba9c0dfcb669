"""The blind benchmark: ``python -m benchmarks.blind generate|run|next|score --set full|small|smoke --workers N``."""

from __future__ import annotations

from benchmarks import process

process.one_thread()  # before NumPy is loaded

import argparse  # noqa: E402
from pathlib import Path  # noqa: E402

from benchmarks.blind import cost, plan, work  # noqa: E402
from benchmarks.blind.generate import ELEMENTS  # noqa: E402
from benchmarks.blind.run import LIMIT, through  # noqa: E402

STEPS = ("generate", "run", "next", "score")


def main(arguments: list[str] | None = None) -> int:
    """Do the steps that are asked for, all by default; what is done already is left as it is."""
    given = _given(arguments)
    seed = given.seed or plan.tree_hash()
    options = given.candidates, given.elements - ELEMENTS, given.limit - LIMIT
    root = given.root / f"{given.size}_{seed[:12]}{plan.variant(options)}"
    specs = plan.part(plan.plan(seed, given.size), given.share)
    if given.only:
        specs = [spec for spec in specs if spec.name in given.only]
    print(cost.told(specs, root, given.workers), flush=True)
    jobs = [
        (seed, some, root, given.steps, given.candidates, given.limit, given.elements)
        for some in cost.by_machine(specs)
    ]
    failed = work.each(through, jobs, given.workers, "machines") if set(given.steps) - {"score"} else 0
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
    chosen = (
        given.seed or given.candidates or given.only or given.elements != ELEMENTS or given.limit != LIMIT
    )
    if given.ledger and chosen:
        parser.error(
            "only a sealed set goes into the ledger, whole or a share: no --seed, --candidates, --only, --elements, "
            "--limit"
        )
    if given.ledger and (changed := plan.unsealed()):
        parser.error(f"a score in the ledger is of a commit: commit {', '.join(changed[:3])} first")
    return given


if __name__ == "__main__":
    raise SystemExit(main())
