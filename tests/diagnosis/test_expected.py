"""How long a diagnosis takes: by the runs that are expected, then by the pace that there was."""

from __future__ import annotations

import pytest

from rodnet.diagnosis.expected import Clock, amount, between, expect
from rodnet.diagnosis.workbench import Workbench
from rodnet.sweeps.collect import Serial
from tests.diagnosis import shaken

RUNS = {"calibrate": 10.0, "scores": 20.0, "refits": 30.0, "law": 40.0, "held out": 5.0, "location": 15.0}


class Watch:
    """A time that is set by hand, and a clock that goes by it, of a second for each run at first."""

    def __init__(self) -> None:
        self.time, self.told = 0.0, []
        self.clock = Clock(RUNS, 1.0, self.told.append, lambda: self.time)

    def tell(self, text: str, after: float = 0.0) -> tuple[float, float, bool]:
        self.time += after
        self.clock(text)
        return self.clock.left()


def test_what_may_come_is_told_apart_from_what_will():
    watch = Watch()
    least, most, late = watch.tell("calibrating the model as it is")
    assert (least, most, late) == (pytest.approx(50.0), pytest.approx(120.0), False)
    assert watch.told == ["calibrating the model as it is (50 s to 2 min left)"]


def test_the_pace_is_learnt_from_what_stages_took():
    watch = Watch()
    watch.tell("calibrating the model as it is")
    slow, _, _ = watch.tell("columns of 3 candidates", after=40.0)
    assert 40.0 < slow < 160.0  # 40 runs, of 1 s as expected, of 4 s as the first ones
    fast = Watch()
    fast.tell("calibrating the model as it is")
    assert fast.tell("columns of 3 candidates", after=1.0)[0] < 40.0


def test_what_was_passed_over_is_not_waited_for():
    watch = Watch()
    watch.tell("calibrating the model as it is")
    watch.tell("columns of 3 candidates", after=10.0)
    least, most, late = watch.tell("opening 1 trials held out", after=20.0)
    assert least == most == pytest.approx(20.0) and not late
    assert watch.told[-1].endswith("(about 20 s left)")


def test_a_law_comes_after_refits_and_its_refit_is_none_of_them():
    watch = Watch()
    watch.tell("calibrating the model as it is")
    watch.tell("columns of 3 candidates", after=10.0)
    watch.tell("refit with gravity", after=20.0)
    least, most, _ = watch.tell("looking for a law in what is left", after=30.0)
    assert (least, most) == (pytest.approx(20.0), pytest.approx(60.0))
    least, most, _ = watch.tell("refit with a law of 3 parts", after=10.0)
    assert (least, most) == (pytest.approx(20.0), pytest.approx(50.0))
    least, most, _ = watch.tell("looking for a law in the place of what was accepted", after=10.0)
    assert (least, most) == (pytest.approx(20.0), pytest.approx(40.0))


def test_what_takes_longer_than_expected_is_only_known_to_end():
    watch = Watch()
    watch.tell("calibrating the model as it is")
    watch.tell("columns of 3 candidates", after=10.0)
    least, _, late = watch.tell("columns of gravity", after=200.0)
    assert late and least > 20.0  # and the rest goes as slowly
    assert "(at least " in watch.told[-1]
    watch.tell("opening 1 trials held out")
    assert not watch.clock.left()[2]


def test_no_stage_begins_before_one_that_has_begun():
    """A second round of scores goes on from the refits of the first."""
    watch = Watch()
    watch.tell("calibrating the model as it is")
    watch.tell("columns of 3 candidates", after=10.0)
    before = watch.tell("refit with gravity", after=20.0)
    again = watch.tell("columns of 2 candidates", after=10.0)
    assert again[0] == pytest.approx(before[0]) and again[1] == pytest.approx(before[1] - 10.0)


def test_what_begins_no_stage_is_handed_on():
    watch = Watch()
    watch.clock("  evaluation 1: residual 1 sd")
    assert watch.told == ["  evaluation 1: residual 1 sd"]


def test_what_is_expected_of_a_diagnosis_is_told_with_and_without_a_finding():
    told: list[str] = []
    bench = Workbench.of(shaken.CASE, [shaken.record(k) for k in range(2)], Serial(), shaken.SIGMA)
    clock = expect(bench, [], 1, told.append)
    sure = sum(runs for stage, runs in clock.runs.items() if stage not in ("refits", "law"))
    assert clock.runs["law"] > sure  # the columns of all the library
    assert told[0].startswith(f"about {sure:.0f} runs of ")
    assert f"if nothing is missing, about {sum(clock.runs.values()):.0f} (" in told[0]


def test_times_in_words():
    assert [amount(s) for s in (0.2, 42.0, 150.0, 7200.0)] == ["1 s", "42 s", "2 min", "2 h"]
    assert between(41.8, 42.3) == "about 42 s" and between(42.0, 150.0) == "42 s to 2 min"
