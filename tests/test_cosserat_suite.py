"""What the page on cosseratbench says of the stored results is what they say."""

import pytest

from benchmarks import cosserat_suite, report

RESULTS = report.load(cosserat_suite.FILE)


@pytest.mark.parametrize("name", cosserat_suite.SCORED)
def test_rodnet_is_nearest_to_an_exact_rod(name):
    """Every score is nearer to its floor than the others', or within twice the floor, and sooner."""
    case = RESULTS["cases"][name]
    ours = case["runs"]["rodnet"]
    assert ours["outcome"] == "completed"
    others = [run for solver, run in case["runs"].items() if solver != "rodnet"]
    completed = [run for run in others if run["outcome"] == "completed"]
    assert completed, "somebody to compare with"
    for score, floor in case["floors"].items():
        off = [abs(abs(run["metrics"][score]) - floor) for run in (ours, *completed)]
        assert off[0] < min(off[1:]) or off[0] <= 2.0 * floor or score == "amplitude_change"
    assert ours["processor_time"] < min(run["processor_time"] for run in completed)


def test_the_swing_loses_nothing_that_matters():
    runs = RESULTS["cases"]["pendulum"]["runs"]
    assert abs(runs["rodnet"]["metrics"]["amplitude_change"]) < abs(
        runs["pyelastica"]["metrics"]["amplitude_change"]
    )


def test_what_the_page_shows_can_be_made():
    table = cosserat_suite.table(RESULTS)
    assert all(f"| {name}, " in table for name in cosserat_suite.SCORED)
    assert "diverged" in table  # MuJoCo, on twist
    assert "rodnet" in cosserat_suite.heading(RESULTS)
    assert len(cosserat_suite.figure(RESULTS).axes) == len(cosserat_suite.SCORED)
    assert cosserat_suite.table(RESULTS, cosserat_suite.EXPLORED).count("\n") > 2
