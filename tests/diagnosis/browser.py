"""A page in a headless browser, as wide as a phone."""

from __future__ import annotations

import html
import re
import shutil
import subprocess
from pathlib import Path

import pytest

PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
# what the page looks like there, written where `--dump-dom` shows it
LOOK = """
const page = document.querySelector("iframe").contentDocument, root = page.documentElement;
const out = [...page.body.children].filter(e => e.getBoundingClientRect().right > root.clientWidth + 1);
const cut = [...page.images].filter(i => !(i.complete && i.naturalWidth > 0));
document.body.dataset.seen = JSON.stringify({
  wide: root.scrollWidth, view: root.clientWidth, out: out.map(e => e.tagName), broken: cut.length,
  images: page.images.length, font: parseFloat(page.defaultView.getComputedStyle(page.body).fontSize),
  headings: [...page.querySelectorAll("h1, h2")].map(e => e.textContent),
  fetched: page.defaultView.performance.getEntriesByType("resource").map(e => e.name).filter(n => !n.startsWith("data:")),
});
"""  # noqa: E501


def browser() -> str:
    """A browser that there is; else the test is skipped."""
    found = next((path for path in map(shutil.which, PROGRAMS) if path), None)
    if found is None:
        pytest.skip(f"needs a browser to look at the page: one of {', '.join(PROGRAMS)} on the search path")
    return found


def look(page: Path, width: int = 360) -> dict:
    """Open a page in a frame of a width in pixels, for a browser's own window is never so narrow."""
    import json

    program = browser()
    inside = html.escape(page.read_text(encoding="utf-8"))
    outer = page.with_name("frame.html")
    outer.write_text(
        f'<!doctype html><html><body style="margin:0"><iframe style="width:{width}px;height:800px;border:0" '
        f'srcdoc="{inside}"></iframe><script>addEventListener("load", () => {{{LOOK}}})</script></body></html>',
        encoding="utf-8",
    )
    command = [program, "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom", outer.as_uri()]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=120)
    seen = re.search(r'<body[^>]* data-seen="([^"]*)"', ran.stdout)
    assert seen, ran.stderr[-2000:]
    return dict(json.loads(html.unescape(seen[1])))
