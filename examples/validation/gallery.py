"""What all cases of the gallery share: what is compared, how it is printed, and the list of cases.

A case is a script that a reader can run by itself, ``python examples/validation/cantilever.py``, with a function
``main`` that returns a `Case`.
"""

from __future__ import annotations

import argparse
import base64
import importlib.util
import io
import os
import pickle
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt

# page of the documentation -> its cases
GROUPS = {
    "statics": ["cantilever", "elastica", "hanging_chain", "helical_spring", "two_rods", "net"],
    "stability": ["euler_column", "twisted_ring", "greenhill_shaft", "writhing", "lateral_buckling"],
    "vibrations": ["vibrating_cantilever", "swinging_chain"],
    "drag": ["sedimenting_rod", "rigid_helix", "flagellum", "snake"],
    "friction": ["sliding_rod", "capstan"],
    "paper": ["paper_robot"],
}
CASES = [name for names in GROUPS.values() for name in names]


@dataclass(frozen=True)
class Check:
    """One number of theory beside what rodnet finds.

    Attributes
    ----------
    what : str
        The quantity, with its unit.
    theory, found : float
        Its two values.
    """

    what: str
    theory: float
    found: float

    @property
    def error(self) -> float:
        """Relative error; where theory says zero, what was found."""
        return abs(self.found / self.theory - 1.0) if self.theory else abs(self.found)


@dataclass
class Case:
    """What a case returns: its name for people, the numbers, a figure, and the source of the theory."""

    title: str
    checks: list[Check]
    figure: plt.Figure
    source: str

    @property
    def error(self) -> float:
        """Largest error of the checks."""
        return max(check.error for check in self.checks)


def rows(case: Case) -> list[tuple[str, str, str, str]]:
    """Quantity, theory, rodnet and error of each check, as text."""
    return [
        (
            c.what,
            f"{c.theory:.6g}",
            f"{c.found:.6g}",
            f"{c.error:.1e}" if c.error < 1e-3 else f"{c.error:.2%}",
        )
        for c in case.checks
    ]


def table(case: Case) -> str:
    """The checks of a case as a table in Markdown."""
    lines = ["| | theory | rodnet | error |", "|---|---|---|---|"]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows(case)])


def show(main: Callable[[], Case]) -> None:
    """Run a case from the command line: print its numbers, and draw its figure with ``--out``."""
    parser = argparse.ArgumentParser(description=sys.modules["__main__"].__doc__)
    parser.add_argument("--out", type=Path, help="file of the figure")
    options = parser.parse_args()
    case = main()
    print(f"{case.title} ({case.source})")
    print(f"{'':48}{'theory':>12}{'rodnet':>12}{'error':>10}")
    for what, theory, found, error in rows(case):
        print(f"{what:48}{theory:>12}{found:>12}{error:>10}")
    if options.out:
        case.figure.savefig(options.out, dpi=150)


def compute(name: str) -> Case:
    """Run a case's script, as a module of another name: there are packages called like some of them."""
    here = Path(__file__).parent
    spec = importlib.util.spec_from_file_location(f"gallery_{name}", here / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # what is pickled is found by it
    sys.path.insert(0, str(here))
    try:
        spec.loader.exec_module(module)
        return module.main()
    finally:
        sys.path.pop(0)


def run(name: str) -> Case:
    """Run a case by name; with the directory ``RODNET_GALLERY`` set, once for all who ask."""
    kept = os.environ.get("RODNET_GALLERY")
    path = Path(kept, f"{name}.pickle") if kept else None
    if path is not None and path.exists():
        return pickle.loads(path.read_bytes())
    case = compute(name)
    plt.close(case.figure)
    if path is not None:
        part = path.with_suffix(f".{os.getpid()}")  # another page may be read at the same time
        part.write_bytes(pickle.dumps(case))
        part.replace(path)
    return case


def picture(case: Case, dpi: int = 110) -> bytes:
    """The figure of a case as PNG."""
    file = io.BytesIO()
    case.figure.savefig(file, format="png", dpi=dpi)
    return file.getvalue()


def display(name: str) -> None:
    """Show figure and numbers of a case in a notebook."""
    from IPython.display import Image, Markdown
    from IPython.display import display as put

    case = run(name)
    put(Image(picture(case)), Markdown(table(case)))


def overview() -> str:
    """All cases as a table in Markdown: the first number of each, and its largest error."""
    lines = ["| case | | theory | rodnet | error | largest error |", "|---|---|---|---|---|---|"]
    for page, names in GROUPS.items():
        for name in names:
            case, shown = run(name), rows(run(name))
            worst = max(range(len(shown)), key=lambda k: case.checks[k].error)
            cells = [f"[{case.title}]({page}.md#{anchor(name)})", *shown[0], shown[worst][3]]
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def thumbnails() -> str:
    """All figures, small, as HTML."""
    cells = []
    for page, names in GROUPS.items():
        for name in names:
            case = run(name)
            data = base64.b64encode(picture(case, dpi=40)).decode()
            cells.append(
                f'<a href="{page}.html#{anchor(name)}" style="margin: 0.4em; text-align: center">'
                f'<img src="data:image/png;base64,{data}" alt="{case.title}" style="height: 8em; display: block">'
                f"{case.title}</a>"
            )
    return f'<div style="display: flex; flex-wrap: wrap; justify-content: center">{"".join(cells)}</div>'


def anchor(name: str) -> str:
    """Where a case is on its page."""
    return f"case-{name.replace('_', '-')}"


def order(sizes: list[int], errors: list[float]) -> float:
    """Fitted exponent p of errors that fall as sizes^-p."""
    return float(-np.polyfit(np.log(sizes), np.log(np.abs(errors)), 1)[0])
