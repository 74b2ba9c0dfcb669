"""cosseratbench with rodnet, PyElastica and MuJoCo, one after the other: ``python -m benchmarks.cosserat_suite``.

Needs cosseratbench and plugins/rodnet-cosseratbench, PyElastica and MuJoCo < 4; what is not installed is named in the
table. Results go to ``benchmarks/results/cosseratbench.json``, after every run.
"""

from __future__ import annotations

from benchmarks import process

process.one_thread()  # before NumPy is loaded

import argparse  # noqa: E402
import time  # noqa: E402
from dataclasses import replace  # noqa: E402
from importlib.metadata import version  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import Any  # noqa: E402

import numpy as np  # noqa: E402

from benchmarks import report  # noqa: E402

FILE = report.RESULTS / "cosseratbench.json"
SCORED = ("catenary", "cantilever", "pendulum", "twist", "crossing")
EXPLORED = ("capstan", "pile")
SOLVERS = ("rodnet", "pyelastica", "mujoco")
FINE = 20  # times as many elements for what counts as an exact rod


class Timed:
    """A solver whose last run's processor time is kept."""

    def __init__(self, solver: Any) -> None:
        self.solver, self.name, self.capabilities = solver, solver.name, solver.capabilities
        self.backend_version, self.settings = solver.backend_version, solver.settings
        self.seconds = 0.0

    def run(self, scenario: Any, *, n_elements: int, n_frames: int) -> Any:
        """Run the solver."""
        begin = time.process_time()
        try:
            return self.solver.run(scenario, n_elements=n_elements, n_frames=n_frames)
        finally:
            self.seconds = time.process_time() - begin


def measure(experiment: Any, name: str) -> dict[str, Any]:
    """Run one solver on the ordinary case of one experiment."""
    from cosseratbench import registry
    from cosseratbench.experiment import run

    try:
        solver = Timed(registry.load_solver(name))
    except (ImportError, KeyError) as error:
        return {"outcome": f"not installed ({error})"}
    result = run(experiment, solver)
    summary = result.summary()
    keys = (
        "outcome",
        "n_elements",
        "failure",
        "missing",
        "diverged_at",
        "wall_time",
        "metrics",
        "observations",
    )
    return {k: summary[k] for k in keys} | {"processor_time": solver.seconds, "settings": summary["settings"]}


def floors(experiment: Any) -> dict[str, float]:
    """What an exact rod would score, seen at the nodes of the default mesh."""
    from rodnet_cosseratbench import RodnetSolver

    name, scenario, n = experiment.name, experiment.scenario, experiment.n_elements
    if name == "pendulum":  # 2e-5 is what the suite's own text says of the period
        shown = RodnetSolver(0.25).run(scenario, n_elements=8 * n, n_frames=experiment.n_frames)
    elif name == "twist":  # not static: rodnet on a mesh twice as fine
        alone = replace(scenario, self_contact=False)
        shown = RodnetSolver().run(alone, n_elements=2 * n, n_frames=experiment.n_frames)
    else:
        shown = _still(
            scenario, n, _exact_crossing(scenario, n) if name == "crossing" else _converged(scenario, n)
        )
    metrics = {k: float(m(scenario, shown)) for k, m in experiment.metrics.items()}
    return {k: v for k, v in metrics.items() if k != "settling_residual"}


def _converged(scenario: Any, n: int) -> list[np.ndarray]:
    """Nodes of rodnet's equilibrium on a finer mesh."""
    from rodnet_cosseratbench import make_robot

    import rodnet as rn

    return [rn.equilibrium(make_robot(scenario, FINE * n)).x[-1, ::FINE]]


def _exact_crossing(scenario: Any, n: int) -> list[np.ndarray]:
    """Material points of the suite's reference."""
    from cosseratbench.experiments import crossing

    arc, *curves = crossing._shapes(*crossing._parameters(scenario), 2.0 * crossing.RADIUS)
    s = np.linspace(0.0, arc[-1], n + 1)
    return [np.stack([np.interp(s, arc, c[:, k]) for k in range(3)], axis=1) for c in curves]


def _still(scenario: Any, n: int, shapes: list[np.ndarray]) -> Any:
    """A trajectory of rods at rest."""
    from cosseratbench.trajectory import Trajectory

    directors = tuple(np.repeat(rod.directors(n)[None], 2, axis=0) for rod in scenario.rods)
    return Trajectory(np.array([0.0, 1.0]), tuple(np.stack([x, x]) for x in shapes), directors)


def heading(results: dict[str, Any]) -> str:
    """What was measured on what."""
    codes = ", ".join(f"{k} {v}" for k, v in results["versions"].items() if v)
    machine = results["machine"]
    return f"{codes}, on {machine.get('cpu', 'a machine')}; every run on one core, ordinary case, default resolution."


def table(results: dict[str, Any], names: tuple[str, ...] = SCORED) -> str:
    """Scores, floors and times, as Markdown."""
    lines = [
        "| experiment, score | floor | " + " | ".join(SOLVERS) + " |",
        "|---|---|" + "---|" * len(SOLVERS),
    ]
    for name in names:
        case = results["cases"][name]
        scores = [k for k in next(iter(case["runs"].values())).get("metrics", {}) if k != "settling_residual"]
        for score in scores:
            cells = [_cell(case["runs"].get(s), score) for s in SOLVERS]
            floor = case["floors"].get(score)
            lines.append(f"| {name}, {score} | {_shown(floor)} | " + " | ".join(cells) + " |")
        cells = [_seconds(case["runs"].get(s)) for s in SOLVERS]
        lines.append(f"| {name}, processor time [s] | | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cell(run: dict[str, Any] | None, score: str) -> str:
    if run is None:
        return "not run"
    if run["outcome"] == "completed":
        return _shown(run["metrics"].get(score))
    at = run.get("diverged_at")
    return run["outcome"] + (f" at {at:.2g} s" if at else "")


def _seconds(run: dict[str, Any] | None) -> str:
    return report.number(run["processor_time"]) if run and run["outcome"] == "completed" else ""


def _shown(value: float | None) -> str:
    return "" if value is None else f"{value:.2e}"


def figure(results: dict[str, Any]) -> Any:
    """Distance from the floor against processor time, one panel per scored experiment."""
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(2.6 * len(SCORED), 2.8), layout="constrained")
    axes = drawn.subplots(1, len(SCORED))
    marks = dict(zip(SOLVERS, (("C0", "o"), ("C2", "^"), ("C1", "s")), strict=True))
    for ax, name in zip(axes, SCORED, strict=True):
        case = results["cases"][name]
        for solver, (color, marker) in marks.items():
            run = case["runs"].get(solver, {})
            if run.get("outcome") != "completed":
                continue
            for score, style in zip(case["floors"], ("full", "none"), strict=False):
                off = abs(abs(run["metrics"][score]) - case["floors"][score])
                ax.loglog(
                    run["processor_time"], off, marker, color=color, fillstyle=style,
                    label=solver if style == "full" else None,
                )  # fmt: skip
        ax.set_title(name, fontsize=10)
        ax.set_xlabel("processor time [s]")
        ax.margins(0.2)
        ax.grid(True, lw=0.4)
    axes[0].set_ylabel("| score - floor |")
    axes[0].legend(fontsize=7)
    return drawn


def main(arguments: list[str] | None = None) -> int:
    """Run, save and print."""
    from cosseratbench import registry

    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.cosserat_suite", description=__doc__.splitlines()[0]
    )
    parser.add_argument("experiments", nargs="*", default=[*SCORED, *EXPLORED], help="which (default: all)")
    parser.add_argument("--solvers", nargs="+", default=list(SOLVERS), help="which (default: all)")
    parser.add_argument(
        "--json", type=Path, default=FILE, help="where the results go; what is there is completed"
    )
    chosen = parser.parse_args(arguments)
    results: dict[str, Any] = report.load(chosen.json) if chosen.json.exists() else {"cases": {}}
    results |= {
        "machine": process.machine(),
        "versions": {k: _version(k) for k in ("cosseratbench", *SOLVERS)},
    }
    for name in chosen.experiments:
        experiment = registry.load_experiment(name)
        case = results["cases"].setdefault(name, {"runs": {}, "floors": {}})
        case["n_elements"] = experiment.n_elements
        for solver in chosen.solvers:
            case["runs"][solver] = measure(experiment, solver)
            print(
                name, solver, case["runs"][solver]["outcome"], case["runs"][solver].get("metrics"), flush=True
            )
            report.save(results, chosen.json)
        if name in SCORED and "rodnet" in chosen.solvers:
            case["floors"] = floors(experiment)
            report.save(results, chosen.json)
    print(table(results, tuple(n for n in (*SCORED, *EXPLORED) if n in results["cases"])))
    return 0


def _version(name: str) -> str:
    try:
        return version(name)
    except Exception:
        return ""


if __name__ == "__main__":
    raise SystemExit(main())
