"""Figures of claims of costs are medians of what their keys name; of corners, those of tags that are found."""

import pytest

from agent.experiments.claim import Figure, Share, measure
from tests.bench import bench_frames, bench_landmarks, bench_messages, bench_recording, bench_twin
from tests.bench.timing import median_figures, medians_ms

COSTS = (bench_frames, bench_messages, bench_recording, bench_twin)


def test_a_figure_is_the_median_of_what_its_key_names():
    rows = {"a-case": [{"way": 4.0, "other": 2.0}, {"way": 9.0, "other": 3.0}, {"way": 5.0, "other": 5.0}]}
    keys = ("a-case.way", "a-case.way/other", "a-case.absent", "not-run.way", "a-case.way<=5", "a-case.way<=1.5")
    found = median_figures([Figure(key, "") for key in keys], rows)
    assert (found.pop("a-case.way<=5"), found.pop("a-case.way<=1.5")) == (Share(2, 3), Share(0, 3))
    assert {key: list(value.values) for key, value in found.items()} == {
        "a-case.way": [4.0, 9.0, 5.0],
        "a-case.way/other": [2.0, 3.0, 1.0],
    }
    assert {value.percent for value in found.values()} == {50.0}


def test_ways_are_taken_in_turn_and_once_before_they_are_timed():
    done, now_s = [], iter(range(100))
    found = medians_ms({"one": lambda: done.append(1), "two": lambda: done.append(2)}, 2, lambda: next(now_s))
    assert done == [1, 2] * 3 and found == {"one": 1000.0, "two": 1000.0}


@pytest.mark.parametrize("module", COSTS, ids=lambda module: module.__name__)
def test_every_figure_is_of_a_case(module):
    claim = module.CLAIM
    assert {figure.key.split(".")[0] for figure in claim.figures} == set(claim.cases)
    assert claim.alone and claim.seeds == 5


def test_the_cheap_cases_have_all_their_figures():
    rows = {
        case: {0: bench_messages.run(0, case, bench_messages.Settings(times=1))}
        for case in ("neighbours-3", "signatures")
    }
    found = measure(bench_messages.CLAIM, rows)
    assert set(found) == {figure.key for figure in bench_messages.CLAIM.figures if figure.key.split(".")[0] in rows}
    assert found["neighbours-3.evidence_bytes/paper_bytes"].value > 1.0


def test_corners_are_judged_where_there_are_edges():
    seen, missed = {"ours_px": 0.3, "theirs_px": 3.0}, {"ours_px": None, "theirs_px": None}
    found = bench_landmarks.summary({"blur-8": [seen, missed, seen | {"ours_px": 0.4}], "blur-12": [missed]})
    assert found["blur-8_px"] == pytest.approx(0.125**0.5) and found["blur-8_edges"] == Share(2, 3)
    assert found["blur-8_times"] == pytest.approx(0.125**0.5 / 3.0)
    assert found["blur-12_px"] is None and found["blur-12_times"] is None
