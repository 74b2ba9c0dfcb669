"""One self-contained HTML page: headings, words, tables, figures. Readable on a phone, without a network."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rodnet.errors import OutputError
from rodnet.numbers import number

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STYLE = """
:root { color-scheme: light dark; --line: #8886; --soft: #8881; --mark: #0072b2; --dim: light-dark(#5b5b5b, #b4b4b4); }
* { box-sizing: border-box; }
body { font: 17px/1.55 system-ui, sans-serif; max-width: 62rem; margin: 0 auto; padding: 1rem 1rem 4rem;
  overflow-wrap: break-word; -webkit-text-size-adjust: 100%; }
h1 { font-size: 1.6rem; line-height: 1.25; margin: .5rem 0 1rem; }
h2 { font-size: 1.3rem; line-height: 1.3; margin-top: 2.6rem; padding-bottom: .3rem;
  border-bottom: 2px solid var(--line); }
p, ul { max-width: 46rem; } li { margin: .3rem 0; }
.table { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .95rem; }
th, td { padding: .35rem .7rem; border-bottom: 1px solid var(--line); text-align: right; vertical-align: top;
  white-space: nowrap; }
th:first-child, td:first-child { text-align: left; white-space: normal; min-width: 9rem; padding-left: 0; }
thead th { font-weight: 600; border-bottom: 2px solid var(--line); white-space: normal; }
td.words { text-align: left; white-space: normal; min-width: 11rem; }
.matrix td, .matrix th { padding: 0; border: 1px solid var(--line); text-align: center; width: 1.9rem; height: 1.9rem;
  font-size: .78rem; vertical-align: middle; }
.matrix th:first-child { text-align: left; padding: .2rem .4rem; width: auto; min-width: 7.2rem; font-weight: 400;
  font-size: .82rem; line-height: 1.2; }
.grid { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(100%, 18.5rem), 1fr)); gap: .6rem; }
figure { margin: 1.2rem 0; } img { width: 100%; height: auto; background: white; border-radius: .3rem; display: block; }
figcaption, .note { color: var(--dim); font-size: .92rem; } figcaption { margin-top: .4rem; }
.verdict { font-size: 1.22rem; line-height: 1.45; padding: .9rem 1.1rem; background: var(--soft); max-width: none;
  border-left: .35rem solid var(--mark); border-radius: .2rem; }
.lead { font-size: 1.08rem; font-weight: 600; }
@media (max-width: 36rem) { /* rows of a wide table one below the other, every number with its name */
  .rows thead { display: none; } .rows, .rows tbody { display: block; }
  .rows tr { display: grid; grid-template-columns: 1fr 1fr; column-gap: 1rem; padding: .5rem 0;
    border-bottom: 1px solid var(--line); }
  .rows td, .rows td.words { border: 0; padding: .1rem 0; text-align: left; white-space: normal; min-width: 0; }
  .rows td:empty { display: none; }
  .rows td:first-child { grid-column: 1 / -1; font-weight: 600; }
  .rows td:not(:first-child)::before { content: attr(data-name) " "; color: var(--dim); }
}
summary { cursor: pointer; padding: .5rem 0; font-weight: 600; }
"""


class Page:
    """A page that grows from top to bottom.

    Parameters
    ----------
    title : str
        Heading and title.
    """

    def __init__(self, title: str) -> None:
        self.title, self._parts = title, [f"<h1>{html.escape(title)}</h1>"]

    def heading(self, text: str) -> None:
        """Begin a section."""
        self._parts.append(f"<h2>{html.escape(text)}</h2>")

    def text(self, text: str, kind: str = "") -> None:
        """Add a paragraph; ``kind`` is "verdict", "lead", "note" or nothing."""
        mark = f' class="{html.escape(kind)}"' if kind else ""
        self._parts.append(f"<p{mark}>{html.escape(text)}</p>")

    def items(self, texts: Iterable[str], first: int | None = None) -> None:
        """Add a list, of which what comes after the ``first`` few is opened by a tap on how many there are."""
        texts = list(texts)
        shown = len(texts) if first is None else first
        self._parts.append(_list(texts[:shown]))
        self.folded(f"{len(texts) - shown} more", texts[shown:])

    def folded(self, title: str, texts: Iterable[str]) -> None:
        """Add a list that is opened by a tap on its title; nothing without texts."""
        if texts := list(texts):
            self._parts.append(f"<details><summary>{html.escape(title)}</summary>{_list(texts)}</details>")

    def table(self, head: Sequence[str], rows: Iterable[Sequence[Any]], first: int | None = None) -> None:
        """Add a table; numbers are shown with three digits, long texts wrap.

        Of many rows, what comes after the ``first`` few is opened by a tap on how many there are.
        """
        rows = list(rows)
        shown = len(rows) if first is None else first
        self._parts.append(_table(head, rows[:shown]))
        if rest := rows[shown:]:
            self._parts.append(f"<details><summary>{len(rest)} more</summary>{_table(head, rest)}</details>")

    def matrix(self, names: Sequence[str], values: np.ndarray, caption: str) -> None:
        """Add a table of numbers from 0 to 1, shaded by them; columns are numbered as the rows are."""
        head = "".join(f"<th>{k}</th>" for k in range(1, len(names) + 1))
        rows = []
        for k, (name, row) in enumerate(zip(names, values, strict=True), start=1):
            cells = "".join(
                f'<td style="background:rgb(0 114 178/{0.85 * float(v) ** 2:.2f})">{_short(v)}</td>'
                for v in row
            )
            rows.append(f"<tr><th>{k} {html.escape(name)}</th>{cells}</tr>")
        words = html.escape(caption)
        self._parts.append(
            f'<figure><div class="table"><table class="matrix"><tr><th></th>{head}</tr>{"".join(rows)}</table></div>'
            f"<figcaption>{words}</figcaption></figure>"
        )

    def figure(self, figure: Figure, caption: str) -> None:
        """Add a matplotlib figure, and close it; the caption is also its text for who cannot see it."""
        words = html.escape(caption)
        self._parts.append(f"<figure>{_image(figure, caption)}<figcaption>{words}</figcaption></figure>")

    def figures(self, figures: Iterable[tuple[str, Figure]], caption: str) -> None:
        """Add several with their names, beside each other where there is room for it."""
        images = "".join(_image(figure, f"{name}: {caption}") for name, figure in figures)
        words = html.escape(caption)
        self._parts.append(
            f'<figure><div class="grid">{images}</div><figcaption>{words}</figcaption></figure>'
        )

    def save(self, path: str | Path) -> Path:
        """Write the page.

        Raises
        ------
        OutputError
            If it cannot be written.
        """
        path = Path(path)
        text = (
            '<!doctype html><html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            f"<title>{html.escape(self.title)}</title><style>{STYLE}</style></head><body>"
            + "\n".join(self._parts)
            + "</body></html>\n"
        )
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        except OSError as error:
            raise OutputError(f"cannot write '{path}': {error}") from None
        return path


def _list(texts: Iterable[str]) -> str:
    return "<ul>" + "".join(f"<li>{html.escape(t)}</li>" for t in texts) + "</ul>"


def _table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    top = "".join(f"<th>{html.escape(h)}</th>" for h in head)
    body = "".join("<tr>" + "".join(map(_cell, head, row)) + "</tr>" for row in rows)
    kind = ' class="rows"' if len(head) > 3 else ""
    return f'<div class="table"><table{kind}><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def _image(figure: Figure, words: str) -> str:
    """A figure as an element of the page."""
    import matplotlib.pyplot as plt

    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=160, bbox_inches="tight")
    plt.close(figure)
    encoded = base64.b64encode(data.getvalue()).decode()
    return f'<img alt="{html.escape(words)}" src="data:image/png;base64,{encoded}">'


def _cell(name: str, value: Any) -> str:
    mark = ' class="words"' if isinstance(value, str) and len(value) > 24 else ""
    return f'<td{mark} data-name="{html.escape(name)}">{html.escape(shown(value))}</td>'


def _short(value: float) -> str:
    """A number from 0 to 1 in two digits."""
    return "1" if value >= 0.995 else f".{round(100.0 * float(value)):02d}"


def shown(value: Any) -> str:
    """A value as people read it."""
    if value is None or (isinstance(value, float) and value != value):
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return number(value) if isinstance(value, float) else str(value)
