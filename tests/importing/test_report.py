"""What the report of an import prints: three digits, and one unit in each column."""

import re

import numpy as np
import pytest

from rodnet.importing.findings import mm, place, unit_of
from rodnet.importing.report import ImportedJunction, ImportedRod, ImportReport


@pytest.mark.parametrize(
    ("length", "text"),
    [
        (1.0, "1 m"), (0.99951, "1 m"), (0.9994, "999 mm"), (1e-3, "1 mm"), (0.99999e-3, "1 mm"),
        (0.99949e-3, "999 um"),
        (12.3456, "12.3 m"), (12345.6, "12300 m"), (1.23456e-7, "0.123 um"), (0.0, "0 um"), (-0.0123456, "-12.3 mm"),
    ],
)  # fmt: skip
def test_a_length_has_three_digits_and_no_exponent(length, text):
    assert mm(length) == text


def test_a_position_has_three_digits_and_no_dust():
    assert place(np.array([0.0123456, -1e-19, 0.1])) == "(12.3, 0, 100) mm"
    assert place(np.array([0.0, 0.0, 0.0])) == "(0, 0, 0) mm"


def rod(name, length, low, high, **options):
    s = np.linspace(0, length, 5)
    return ImportedRod(name, length, 7, 0.5 * (low + high), s, np.linspace(low, high, 5), **options)


def test_columns_have_one_unit_and_three_digits():
    rods = (
        rod("rod0", 0.0999999, 0.99999e-3, 0.99999e-3),
        rod("rod1", 0.1234567, 0.5e-3, 1.23456e-3),
        rod("rod2", 0.000987654, 4.5678e-5, 4.5678e-5, closed=True),
    )
    joint = ImportedJunction("rod0.end", (0.0123456, 1e-9, -0.1), ("rod0", "rod1", "rod2"), 0.000123456)
    text = str(ImportReport("'a.stl'", rods, (joint,), 2, 0))
    header, *rows = text.splitlines()[1:5]
    assert header.split() == ["rod", "length", "[mm]", "radius", "[mm]", "edges"]
    assert [row.split() for row in rows] == [
        ["rod0", "100", "1", "7"],
        ["rod1", "123", "0.867", "(0.5", "to", "1.23)", "7"],
        ["rod2", "0.988", "0.0457", "7", "ring"],
    ]
    assert [row.index("7") for row in rows[:1]] == [header.index("edges")]
    assert "at (12.3, 0, -100) mm, axes pass it at 0.123 mm" in text
    assert not re.search(r"e[+-]\d", text)


def test_the_unit_is_that_of_the_largest():
    assert unit_of(1e-6, 2e-3) == ("mm", 1e-3)
    assert unit_of() == ("um", 1e-6)
