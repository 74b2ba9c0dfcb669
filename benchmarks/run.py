"""The command: run cases, print tables, write JSON and the figure."""

from __future__ import annotations

from benchmarks import process

process.one_thread()  # before NumPy is loaded

import argparse  # noqa: E402
import sys  # noqa: E402
import time  # noqa: E402
import traceback  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import Any  # noqa: E402

from benchmarks import cases, report  # noqa: E402


def run(names: list[str], options: cases.Options) -> dict[str, Any]:
    """Run cases one after the other, all on the same core."""
    results: dict[str, Any] = {"machine": process.machine(), "quick": options.quick}
    results["pinned"] = process.one_core()
    found: dict[str, Any] = {}
    begin = time.perf_counter()
    try:
        for name in names:
            found[name] = _one_case(name, options)
    finally:
        process.all_cores()
    results |= {
        "disturbance": options.clock.disturbance,
        "took_s": time.perf_counter() - begin,
        "cases": found,
    }
    return results


def _one_case(name: str, options: cases.Options) -> dict[str, Any]:
    """Run a case; one that fails says so in its place, so that the others' results are not lost."""
    start = time.perf_counter()
    print(f"{name} ...", end=" ", flush=True, file=sys.stderr)
    try:
        result = cases.measure(name, options).plain()
    except Exception as error:
        traceback.print_exc()
        result = cases.Result(name, f"failed: {type(error).__name__}: {error}").plain() | {"failed": True}
    print(f"{time.perf_counter() - start:.0f} s", flush=True, file=sys.stderr)
    return result


def main(arguments: list[str] | None = None) -> int:
    """Measure, print, save. Returns 1 if a case failed; a missed demand is not a failure."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__.splitlines()[0])
    parser.add_argument("--cases", nargs="+", choices=cases.NAMES, default=list(cases.NAMES), metavar="CASE",
                        help=f"which, of {', '.join(cases.NAMES)}")  # fmt: skip
    parser.add_argument("--quick", action="store_true", help="small sizes, few repeats; numbers mean little")
    parser.add_argument("--no-rivals", action="store_true", help="rodnet alone")
    parser.add_argument("--json", type=Path, help="where to write the results; by default benchmarks/results, "
                        "if all cases were run in full")  # fmt: skip
    parser.add_argument("--again", action="store_true", help="put cases, measured in full, in the place of those that "
                        "benchmarks/results holds")  # fmt: skip
    chosen = parser.parse_args(arguments)
    if chosen.again and (chosen.quick or chosen.no_rivals or chosen.json):
        parser.error("--again is for cases in full, in benchmarks/results")
    options = cases.Options(quick=chosen.quick)
    if chosen.no_rivals:
        options.rivals = ()
    results = run(chosen.cases, options)
    report.show(results)
    whole = not (chosen.quick or chosen.no_rivals) and set(chosen.cases) == set(cases.NAMES)
    if chosen.again:
        results = report.replaced(report.load(), results)
    path = chosen.json or (report.FILE if whole or chosen.again else None)
    if path is not None:
        from benchmarks import figures

        report.save(results, path)
        print(f"\nwritten: {', '.join(map(str, [path, *figures.save(results, path)]))}")
    return int(any("failed" in r for r in results["cases"].values()))


if __name__ == "__main__":
    raise SystemExit(main())
