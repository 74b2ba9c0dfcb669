"""What is promised of every term that is installed, plug-ins' included."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import rodnet as rn
from rodnet import registry

TERMS = registry.terms()
# where the example of the class, made for strong contact, costs hundreds of iterations
GENTLE = {"rod-contact": rn.RodContact(reach=0.03, stiffness=1.0, rod_radius=1e-3, friction=0.4, slip=0.05)}


@pytest.mark.parametrize("name", sorted(TERMS))
def test_it_works_in_a_robot_with_joints(name):
    """With second-order steppers, in a sweep, and through save and restart."""
    report = rn.testing.check_in_robot(GENTLE.get(name, TERMS[name].object))
    assert {"sdirk2: Jacobian by position", "alpha: continued from a file", "sweep: as it was"} <= set(
        report.errors
    )


# -- the catalogue -------------------------------------------------------------------------
DOCS = Path(__file__).parents[1] / "docs"
OURS = [
    k
    for k, r in TERMS.items()
    if r.distribution.split()[0] in ("rodnet", "rodnet-quadratic", "rodnet-jamming")
]


def entries():
    """What the documentation has between the label of a term and the next one, by id; every page's own."""
    found = {}
    for page in DOCS.rglob("*.md"):
        if "_build" not in page.parts:
            parts = re.split(r"^\(term-([\w-]+)\)=\n", page.read_text(), flags=re.M)
            for name, text in zip(parts[1::2], parts[2::2], strict=True):
                found.setdefault(name, []).append(text)
    return found


@pytest.mark.parametrize("name", sorted(OURS))
def test_it_has_an_entry_in_the_documentation(name):
    """With equation, parameters with units, source, and a figure; and somebody who looks for a law finds it."""
    record, found = TERMS[name], entries().get(name, [])
    assert len(found) == 1, f"docs/terms has {len(found)} entries for '{name}'"
    (entry,) = found
    assert record.object.__name__ in entry.splitlines()[0]
    assert entry.count("$$") >= 2, "an equation"
    assert f"```{{term}} {name}\n```" in entry, "the registry's table"
    figures = re.findall(r"```{code-cell} ipython3\n(.*?)```", entry, flags=re.S)
    assert any(re.search(r"plot|semilogx|strobe|swing|shapes|show\(", cell) for cell in figures), "a figure"
    assert record.source and all(p.unit and p.doc for p in record.parameters)
    assert f"<term-{name}>" in (DOCS / "terms" / "index.md").read_text(), "where a newcomer chooses"


def test_the_documentation_has_no_entry_of_what_is_not_there():
    assert set(entries()) - set(TERMS) <= {
        "jamming",
        "grain-yield",
        "quadratic",
    }  # plug-ins that need not be installed
