"""Surveys of tags that are drawn: what is found, how sure it says it is, and what the verb writes and refuses."""

import re

import numpy as np
import pytest
from msgspec.structs import replace
from rich.console import Console

from agent.calibration import landmarks as verb
from agent.calibration.landmarks import Asked, block, check_out, known_tags, priors, put, run, survey
from agent.calibration.rotation import turn_of, turned_by
from agent.calibration.survey_bundle import bundle
from agent.calibration.survey_start import start
from agent.calibration.survey_views import Views, fresh
from agent.failure import Failed
from agent.fleet_files import shipped_fleet
from agent.kernel.config import ConfigError
from agent.kernel.fleet_reader import load_fleet
from agent.kernel.toml_files import dump, read_toml
from tests.calibration.drawn_survey import SIDE_M, SIGMA_DEG, SIGMA_M, SIZE_SPREAD, TANK, drawn, film, listed

KNOWN = (0, 4, 11)
LISTED = listed()
FLEET = replace(load_fleet(shipped_fleet()), tank=TANK, landmarks=LISTED)


def errors(result, truth):
    """(n, 6): shift, m, and turn, rad, of each tag from where it is."""
    ids = list(result.tags.ids)
    turns = zip(result.tags.rotation, truth.rotation[ids], strict=True)
    return np.hstack([result.tags.middle_m - truth.middle_m[ids], [turned_by(a @ b.T) for a, b in turns]])


def test_the_survey_is_as_good_as_it_says():
    """Tags off their faces and prints too large as the priors have it, so that nothing but the truth is left."""
    nees, tags = [], []
    known = [tag for tag in LISTED.tag if tag.id in KNOWN]
    for seed in range(16):
        rng = np.random.default_rng(seed)
        truth = drawn(rng, LISTED)
        begun = start(film(rng, truth, 24), known, SIDE_M, TANK)
        prior = priors(begun, known, LISTED, flat=True, focal=1e-5)._replace(size=SIZE_SPREAD)
        off, lean = np.minimum(prior.sigma_m, [np.inf, np.inf, SIGMA_M]), np.radians([SIGMA_DEG, SIGMA_DEG, np.inf])
        prior = prior._replace(sigma_m=off, sigma_rad=np.minimum(prior.sigma_rad, lean))
        result = bundle(begun.frames, begun.cameras, prior, SIDE_M)
        error = errors(result, truth)
        nees += np.einsum("ki,kij,kj->k", error, np.linalg.inv(result.covariance), error).tolist()
        tags.append(error)
    assert 0.75 < np.mean(nees) / 6 < 1.25
    rms = np.sqrt((np.vstack(tags) ** 2).mean(axis=0))
    assert rms[:3].max() < 0.001 and np.degrees(rms[3:]).max() < 0.15


@pytest.fixture(scope="module")
def filmed():
    rng = np.random.default_rng(5)
    truth = drawn(rng, LISTED)
    return truth, film(rng, truth, 24)


def test_tags_that_nobody_listed_are_found(filmed):
    truth, frames = filmed
    three = replace(FLEET, landmarks=replace(LISTED, tag=tuple(tag for tag in LISTED.tag if tag.id in KNOWN)))
    found = survey(Views(frames, 24, 0.002), three, three.landmarks.tag, flat=True)
    assert {each.tag.id for each in found.tags} == {tag.id for frame in frames for tag in frame.tags} > set(KNOWN)
    for each in found.tags:
        there = LISTED.tag[each.tag.id]
        assert each.tag.face == there.face and abs((each.tag.turn_deg - there.turn_deg + 180) % 360 - 180) < 0.5
        assert np.abs(each.tag.position_m - truth.middle_m[there.id]).max() < 4 * each.sigma_m
        assert (each.moved_m is None) == (each.tag.id not in KNOWN)


def test_without_faces_it_is_found_too_and_known_less_well(filmed):
    truth, frames = filmed
    known = known_tags(FLEET, KNOWN, "fleet.toml")
    flat, free = (survey(Views(frames, 24, 0.002), FLEET, known, flat) for flat in (True, False))
    assert sum(each.sigma_m for each in free.tags) > sum(each.sigma_m for each in flat.tags)
    assert all(np.abs(one.tag.position_m - truth.middle_m[one.tag.id]).max() < 4 * one.sigma_m for one in free.tags)


def test_a_tag_of_another_size_is_named_and_a_wrong_camera_refused(filmed):
    _, frames = filmed
    known = known_tags(FLEET, (), "fleet.toml")
    odd = [frame._replace(tags=tuple(larger(tag) if tag.id == 9 else tag for tag in frame.tags)) for frame in frames]
    said = verb.remarks(survey(Views(odd, 24, 0.002), FLEET, known, flat=True), Views(odd, 24, 0.002))
    assert next(line for line in said if line.startswith("tag ")).startswith("tag 9 does not fit")
    wrong = [frame._replace(tags=tuple(larger(tag) for tag in frame.tags)) for frame in frames]
    with pytest.raises(Failed, match=r"corners miss by .* px; check size_m"):
        survey(Views(wrong, 24, 0.002), FLEET, known, flat=True)


def larger(tag):
    slopes = np.array(tag.corners)
    return replace(tag, corners=tuple(map(tuple, 1.1 * slopes - 0.1 * slopes.mean(axis=0))))


def test_pictures_that_show_the_same_again_are_left_out(filmed):
    frames = filmed[1]
    assert len(list(fresh([frames[0]] * 5 + [frames[1]._replace(tags=frames[1].tags[:1])]))) == 1
    assert 20 <= len(list(fresh(frames))) <= 24


def test_the_verb_prints_writes_and_keeps_what_was_there(filmed, tmp_path, monkeypatch, capsys):
    fleet, out = tmp_path / "fleet.toml", tmp_path / "tags.toml"
    fleet.write_text(dump(FLEET))
    monkeypatch.setattr(verb, "filmed", lambda *rest: Views(filmed[1], 30, 0.002))
    found = run("film.mp4", fleet, Asked(calibration=tmp_path / "r1.toml", out=out), Console(width=160))
    said = capsys.readouterr().out
    assert "24 of 30 pictures used" in said and "written to" in said
    written = read_toml(out)["landmarks"]
    assert written["size_m"] == SIDE_M and len(written["tag"]) == len(found.tags)
    assert written["sigma_m"] == pytest.approx(max(each.sigma_m for each in found.tags), abs=1e-5)
    before = out.read_text()
    assert re.search(r"as it was: .*tags\.toml\.before$", put(out, block(found, FLEET)))
    assert (tmp_path / "tags.toml.before").read_text() == before
    with pytest.raises(ConfigError, match=r"holds more than \[landmarks\]"):
        check_out(fleet)


def test_what_cannot_be_surveyed_is_one_line(filmed, tmp_path, monkeypatch):
    fleet = tmp_path / "fleet.toml"
    fleet.write_text(dump(FLEET))
    with pytest.raises(ConfigError, match=r"--known 99: .*lists no such tag"):
        run("film.mp4", fleet, Asked(known=(99,)), Console(quiet=True))
    with pytest.raises(ConfigError, match="do not say which camera took them"):
        run("film.mp4", fleet, Asked(), Console(quiet=True))
    with pytest.raises(ConfigError, match=r"has no table \[landmarks\]"):
        known_tags(replace(FLEET, landmarks=None), (), fleet)
    alone = [frame._replace(tags=frame.tags[1:3]) for frame in filmed[1] if frame.tags[0].id == 0][:1]
    with pytest.raises(ConfigError, match=r"no picture shows a tag of known place \(0\)"):
        start(alone, LISTED.tag[:1], SIDE_M, TANK)


def test_turns_and_vectors():
    for vector in ([0.3, -1.0, 0.5], [1e-12, 0.0, 0.0], [0.0, 0.0, 3.0]):
        assert turned_by(turn_of(np.array(vector))) == pytest.approx(vector, abs=1e-9)
