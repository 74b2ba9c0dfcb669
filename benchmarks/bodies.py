"""A true rigid head beside a very stiff one, on the paper's robot: ``python -m benchmarks.bodies``.

Both robots take turns, 20 steps each, over 60 s of motion from rest. Times are of the processor; kernels are compiled
before. Prints the ratio of times over the whole run and over its first 5 s, Newton iterations and both speeds.
"""

from __future__ import annotations

from benchmarks import process

process.one_thread()  # before NumPy is loaded

import time  # noqa: E402

import rodnet as rn  # noqa: E402

DT, SECONDS, BLOCK, START = 0.01, 60.0, 20, 5.0
KINDS = ("stiff", "body")


def measure(tails: int) -> str:
    """Run both robots; return a row of the table."""
    robots = {kind: rn.robots.flagellated(tails, rpm=100.0, rigid=kind) for kind in KINDS}
    for robot in robots.values():
        rn.Simulation(robot, DT).run(BLOCK * DT)
    sims = {kind: rn.Simulation(robot, DT) for kind, robot in robots.items()}
    spent: dict[str, list[float]] = {kind: [] for kind in KINDS}
    for block in range(round(SECONDS / DT) // BLOCK):
        for kind in KINDS if block % 2 else KINDS[::-1]:
            begin = time.process_time()
            for _ in range(BLOCK):
                sims[kind].step()
            spent[kind].append(time.process_time() - begin)
    first = round(START / DT) // BLOCK
    whole, start = (sum(spent["body"][:n]) / sum(spent["stiff"][:n]) for n in (None, first))
    stiff, body = (sims[kind].observe().sensors for kind in KINDS)
    apart = max(abs(body[k] / stiff[k] - 1.0) for k in stiff)
    solves = " / ".join(str(sims[kind].newton.iterations) for kind in KINDS)
    return f"{tails:5d}  {whole:12.3f}  {start:11.3f}  {solves:>16}  {100.0 * apart:15.3f} %"


def main() -> None:
    """Print the table."""
    print("tails  time, 60 s  first 5 s  iterations (stiff / body)  speeds apart")
    for tails in (2, 3, 5):
        print(measure(tails), flush=True)


if __name__ == "__main__":
    main()
