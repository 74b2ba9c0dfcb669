"""The page of a diagnosis reads well: numbers, long lists, parts without anything in them, laws in words."""

from __future__ import annotations

import html
import io
import re
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

import rodnet as rn
from rodnet.diagnosis.design import Proposal
from rodnet.diagnosis.library import law_of, pieces
from rodnet.numbers import by_chance, chance, number, p_value, percent, times
from rodnet.report.figures import literally
from rodnet.report.law_words import parts_in_words
from rodnet.report.limits import titled, untold
from rodnet.report.page import Page, shown
from rodnet.report.sentences import short, sure
from rodnet.viz.file_names import file_names
from tests.diagnosis import shaken

# some that a diagnosis without an effect cannot tell apart, and some that have a sign
BANK = [
    "gravity",
    "flow",
    "natural-curvature",
    "natural-shape",
    "kink",
    "root-direction",
    "yield",
    "kelvin-voigt",
]


def text_of(page: Page, path) -> str:
    """What is read, with the folded parts in brackets."""
    raw = re.sub(
        r"<style>.*?</style>|<img[^>]*>", "", page.save(path).read_text(encoding="utf-8"), flags=re.S
    )
    raw = raw.replace("<details>", "[[").replace("</details>", "]]")
    return html.unescape(re.sub(r"\s*<[^>]+>\s*", " | ", raw))


def assert_tidy(text):
    """No number that is none, no chance of nothing."""
    cells = [cell.strip() for cell in text.split("|")]
    assert "-0" not in cells and "inf" not in cells
    assert "-0 %" not in text and "p = 0)" not in text


@pytest.fixture(scope="module")
def none(tmp_path_factory):
    trials = [shaken.record(k) for k in range(4)]
    found = rn.diagnose(
        shaken.CASE, trials[:3], hold_out=trials[3:], candidates=BANK, noise=shaken.SIGMA, workers=0
    )
    assert found.verdict == "none"
    return text_of(found.page(), tmp_path_factory.mktemp("none") / "report.html")


# -- numbers ------------------------------------------------------------------------------------------
def test_what_rounds_to_nothing_has_no_sign():
    assert [number(v) for v in (-0.0, 0.0, -1e-20, -0.25, 1234.0)] == [
        "0",
        "0",
        "-1e-20",
        "-0.25",
        "1.23e+03",
    ]
    assert number(-0.3, ".0f") == "0" and number(-0.004, ".2f") == "0.00"
    assert percent(-0.004) == "0 %" and percent(-0.08) == "-8 %"
    assert percent(0.9994) == "99.9 %" and percent(0.99999) == "99.9 %" and percent(1.0) == "100 %"
    assert shown(-0.0) == "0" and shown(float("nan")) == "–" and shown(True) == "yes"


def test_no_chance_is_nothing():
    assert chance(0.0) == "< 1e-9" and chance(0.028) == "0.028"
    assert p_value(0.0) == "p < 1e-9" and p_value(0.12) == "p = 0.12"
    assert by_chance(1e-12) == "less than one in a billion" and by_chance(0.5) == "0.5"


def test_counts_and_names():
    assert times(1) == "once" and times(3) == "3 times"
    assert short(["a.g", "b.g", "b.loss"]) == {"a.g": "a.g", "b.g": "b.g", "b.loss": "loss"}


# -- long lists ---------------------------------------------------------------------------------------
def test_the_rest_of_a_long_list_is_folded(tmp_path):
    page = Page("a page")
    page.items([f"item {k}" for k in range(6)], 4)
    page.items(["alone"], 4)
    page.folded("nothing", [])
    text = text_of(page, tmp_path / "page.html")
    before, folded = text.split("[[")
    assert "item 3" in before and "item 4" not in before
    assert "2 more" in folded and "item 4" in folded and "item 5" in folded
    assert text.count("[[") == 1 and "nothing" not in text


# -- nothing missing ----------------------------------------------------------------------------------
def test_a_page_without_a_finding_has_no_empty_parts(none):
    assert "repaired model" not in none and "placebo" not in none
    assert "on trials left out [nats]" not in none  # nothing was refitted
    assert "Which explanations would look alike?" in none and "which experiment would tell" not in none
    assert "The model as it is, on trials held out" in none and "Before and after" not in none
    assert "rodnet run" not in none.replace("`rodnet run`", "")


def test_a_page_has_no_negative_zero_and_no_chance_of_nothing(none):
    assert_tidy(none)


def test_what_cannot_be_told_is_short_and_whole_behind_a_tap(none):
    part = none.split("What these recordings cannot tell")[1].split("What this is about")[0]
    first, rest = part.split("[[")
    assert first.count("nearly the same effect") + first.count("refitting the other") + 1 <= 4
    assert " more" in rest and rest.count("nearly the same effect") >= 1


# -- a law --------------------------------------------------------------------------------------------
def test_every_part_that_a_law_may_have_is_known_in_words():
    robot = shaken.robot(shaken.drive(0))
    every = pieces(robot, shaken.DURATION)
    words = parts_in_words(every)
    assert set(law_of(every).strength) <= set(words)
    assert all(words.values())
    assert words["law-0.square"].startswith(
        "force per length along the velocity, proportional to the speed squared"
    )
    assert words["law-0.square"].endswith("(on rod from node 0 to 4)")
    assert words["law-flow.ux"] == "current along x, at the origin, at first"


def test_what_a_trial_would_tell_apart_is_told_by_titles():
    """The page names explanations by titles, and trials as the menu does."""
    titles = {"gravity": "a force on all mass", "kink@rod": "a kink in the rod"}
    menu = [("plan_0", 30.0)]
    one = Proposal(("gravity", "kink@rod at 0.30", "kink@rod at 0.70"), "plan_0", 30.0, 0.0, menu, 1, (),
                   (("kink@rod at 0.30", "kink@rod at 0.70"),))  # fmt: skip
    told = titled(one, titles)
    assert told.sentence.startswith(
        "plan_0 would decide between “a force on all mass”, “a kink in the rod” at 0.30 and “a kink in the rod” at "
        "0.70, except as follows"
    )
    assert told.left == (("“a kink in the rod” at 0.30", "“a kink in the rod” at 0.70"),)
    assert titled(one, {}) == one


def test_files_and_figures_bear_any_name():
    """Names that differ in what files cannot hold are different files, and a dollar begins no formula."""
    assert file_names(["run 1", "run_1", "run/1", "a.b-c"]) == ["run_1", "run_1_2", "run_1_3", "a.b-c"]
    figure = Figure()
    figure.suptitle(literally("a$_$b $"))
    figure.savefig(io.BytesIO(), format="png")


def test_what_does_not_act_or_show_is_told_as_such():
    """No sentence says that a refit hides what was never there."""
    candidate = SimpleNamespace(id="kink@rod", title="a kink")
    shown = {"p": 1.0, "scales": {"size": 1.0}, "visible": {"size": np.inf}, "candidate": candidate}
    for survives, says in (
        (0.0, "does nothing"),
        (1e-5, "hides all of it"),
        (0.01, "but 1 %"),
        (0.9, "plausible"),
    ):
        score = SimpleNamespace(survives=survives, **shown)
        found = SimpleNamespace(findings=[], location=None, screened=[score], tried=[], isolability=np.eye(1))
        (told,) = untold(found)
        assert told.startswith("a kink: ") and says in told


def test_why_what_scores_well_is_no_answer_is_told_as_it_is():
    """Too small, no better on trials left out, or never refitted: three reasons for `none`."""
    score = SimpleNamespace(p=1e-9, candidate=SimpleNamespace(id="kink@rod", title="a kink"))

    def says(*tried):
        return sure(SimpleNamespace(verdict="none", screened=[score], tried=list(tried)))

    small = SimpleNamespace(id="kink@rod", effect_sigma=0.01, reasons=("it is small",))
    useless = SimpleNamespace(
        id="kink@rod", effect_sigma=0.5, reasons=("it gains 1 nats on trials left out",)
    )
    assert "too small to name" in says(small)
    assert "“a kink”" in says(useless) and "on trials left out" in says(useless)
    assert "could be refitted" in says()
