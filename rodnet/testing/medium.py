"""Checks of what laws with memory do to the medium."""

from __future__ import annotations

from typing import Any

import numpy as np

from rodnet.solve.model import Model
from rodnet.terms.drag.line import DragModel
from rodnet.terms.drag.medium import BoundMediumLaw, Cells
from rodnet.testing.pure import check_pure, check_shape, relative, rows
from rodnet.testing.report import Report

CELLS = 11


def some_memory(term: DragModel, untouched: np.ndarray, rng: np.random.Generator, count: int) -> np.ndarray:
    """Memories between the untouched medium's and the law's ``example_memory``, shape (count, memory_size)."""
    if term.example_memory is None:
        return np.tile(untouched, (count, 1))
    return untouched + rng.uniform(0.0, 1.0, (count, len(untouched))) * (
        np.asarray(term.example_memory) - untouched
    )


def fill_field(bound: BoundMediumLaw, model: Model, rng: np.random.Generator) -> None:
    """Give the cells that a bound law has touched a memory of their own each."""
    field = bound.field
    if bound.law.example_memory is not None:
        field.values[:] = some_memory(bound.law, field.untouched, rng, len(field.codes))
        bound.restore(model, bound.pack_field(field, field.values, 1e-2))


def check_medium(term: DragModel, report: Report, rng: np.random.Generator, site: Any, p: Any) -> None:
    """Check ``disturb``, ``settle``, ``diffusivity`` and the untouched medium."""
    untouched = np.asarray(term.initial_memory(site, p), dtype=float)
    report.demand(
        "untouched medium", bool(np.all(untouched == untouched[0])), "initial_memory() differs between sites",
        "What the medium holds is alike wherever no rod has been.",
    )  # fmt: skip
    count, size = len(site.x), term.memory_size
    report.demand(
        "example memory", term.example_memory is None or np.shape(term.example_memory) == (size,),
        f"example_memory has the shape {np.shape(term.example_memory)}", f"Give {size} values.",
    )  # fmt: skip
    memory = some_memory(term, untouched[0], rng, count)
    other = some_memory(term, untouched[0], rng, count)
    change = check_pure(report, term, "disturb", (site, p, memory), (site, p, other))
    change = check_shape(report, "disturb()", change, (count, size), "Return one row for each site.")
    order = np.roll(np.arange(count)[::-1], 2)
    report.require(
        "disturb: permutation", relative(term.disturb(rows(site, order), p, memory[order]), change[order]), 1e-9,
        "sites in another order change the result", "It may depend on all sites, but not on their order.",
    )  # fmt: skip
    rate = np.asarray(term.diffusivity(p), dtype=float)
    report.demand(
        "diffusivity", rate.shape in ((), (size,)) and bool(np.all(np.isfinite(rate) & (rate >= 0.0))),
        f"diffusivity() returns {rate}", f"Return a number that is not negative, or {size} of them [m^2/s].",
    )  # fmt: skip
    cells = Cells(rng.integers(-5, 5, (CELLS, 3)) * 1e-2, 1e-2, 0.3, 1e-2)
    memory = some_memory(term, untouched[0], rng, CELLS)
    settled = check_pure(report, term, "settle", (cells, p, memory), (cells, p, memory[::-1]))
    settled = check_shape(report, "settle()", settled, (CELLS, size), "Return one row for each cell.")
    order = np.roll(np.arange(CELLS)[::-1], 2)
    report.require(
        "settle: permutation", relative(term.settle(rows(cells, order), p, memory[order]), settled[order]), 1e-9,
        "cells in another order change the result", "It may depend on all cells, but not on their order.",
    )  # fmt: skip
    still = np.tile(untouched[0], (CELLS, 1))
    report.demand(
        "untouched medium", np.array_equal(np.asarray(term.settle(cells, p, still), dtype=float), still),
        "settle() changes a medium that no rod has touched",
        "Cells are stored where rods have been only: elsewhere nothing may happen.",
    )  # fmt: skip
