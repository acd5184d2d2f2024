"""Recordings that went wrong, a few of them: `python -m tests.fuzz.recordings COUNT SEED` has more."""

from pathlib import Path

import pytest

from agent.core.config import ConfigError
from replay.files.info import suspecting
from tests.fuzz.recordings import Harm, fuzz, one, run


@pytest.mark.slow
def test_no_verb_of_replay_shows_more_than_a_line() -> None:
    run(8, seed=1)


def test_each_verb_is_asked_and_most_recordings_are_refused() -> None:
    outcome = fuzz(4, seed=7)
    assert outcome.verbs == 4 * 10 + 2  # a page and the command line for the first one
    assert sum(outcome.verdicts.values()) == outcome.verbs


def test_the_fuzzer_sees_what_it_looks_for(tmp_path: Path) -> None:
    harm = Harm("test", True, True)

    def falls(file: Path, harm: Harm) -> str:
        raise KeyError("x")

    with pytest.raises(AssertionError, match="falls: KeyError"):
        one(falls, tmp_path, harm, "falls")

    def says_two_lines(file: Path, harm: Harm) -> str:
        raise ConfigError("one\ntwo")

    with pytest.raises(AssertionError, match="no line"):
        one(says_two_lines, tmp_path, harm, "says")


def test_the_last_net_names_the_file_and_the_place(tmp_path: Path) -> None:
    what = r"r1\.mcap: holds what no recorder writes \(KeyError: 'x', in "
    with pytest.raises(ConfigError, match=what) as told, suspecting(tmp_path / "r1.mcap"):
        {}["x"]
    assert "\n" not in str(told.value)
