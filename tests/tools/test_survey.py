"""Surveys of tags that are drawn: what is found, how sure it says it is, and what the verb writes and refuses."""

import re
from functools import partial
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from msgspec.structs import replace
from rich.console import Console

from agent.__main__ import main
from agent.core.codec import encode
from agent.core.config import ConfigError, Landmarks, Tag, dump, read_toml
from agent.core.step_io import Inputs, SeenTags
from agent.process.command import Failed, shipped_fleet, terminal
from agent.robot.fleet_reader import load_fleet
from agent.tools import tag_map as verb
from agent.tools.tag_bundle import bundle, turn_of, turned_by
from agent.tools.tag_map import (
    Asked,
    Views,
    block,
    check_out,
    fresh,
    known_tags,
    missing,
    priors,
    put,
    recorded,
    remarks,
    run,
    start,
    survey,
)
from tests.known_lens import CAMERA
from tests.perception.printed import modules, photograph
from tests.tools.drawn_survey import SIDE_M, SIGMA_DEG, SIGMA_M, SIZE_SPREAD, TANK, basin_film, drawn, film, listed
from tests.tools.planes import CALIBRATION

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
    for seed in range(8):
        rng = np.random.default_rng(seed)
        truth = drawn(rng, LISTED)
        prior_of = partial(priors, known=known, landmarks=LISTED, flat=True, focal=1e-5)
        begun = start(film(rng, truth, 24), known, SIDE_M, TANK, prior_of)
        prior = prior_of(begun)._replace(size=SIZE_SPREAD)
        off, lean = np.minimum(prior.sigma_m, [np.inf, np.inf, SIGMA_M]), np.radians([SIGMA_DEG, SIGMA_DEG, np.inf])
        prior = prior._replace(sigma_m=off, sigma_rad=np.minimum(prior.sigma_rad, lean))
        result = bundle(begun.frames, begun.cameras, prior, SIDE_M)
        error = errors(result, truth)
        nees += np.einsum("ki,kij,kj->k", error, np.linalg.inv(result.covariance), error).tolist()
        tags.append(error)
    assert 0.7 < np.mean(nees) / 6 < 1.3
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


def test_a_long_chain_of_small_tags_does_not_drift_away():
    """Six tags known of 68, in a basin where most that a picture shows is small."""
    fleet, rng = load_fleet(shipped_fleet("swim")), np.random.default_rng(0)
    truth, ids = drawn(rng, fleet.landmarks), tuple(tag.id for tag in fleet.landmarks.tag)
    known = known_tags(fleet, (2, 7, 20, 33, 46, 61), "fleet.toml")
    found = survey(Views(basin_film(rng, truth, ids, 40), 40, 0.002), fleet, known, flat=True)
    assert len(found.tags) > 40 and found.bundle.misfit_px < 0.3
    for each in found.tags:
        off_m = np.abs(each.tag.position_m - truth.middle_m[ids.index(each.tag.id)]).max()
        assert off_m < 5 * each.sigma_m


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
    said = remarks(survey(Views(odd, 24, 0.002), FLEET, known, flat=True), 24)
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


def test_tags_of_the_fleet_file_that_nobody_filmed_are_named(filmed, tmp_path, monkeypatch, capsys):
    fleet = tmp_path / "fleet.toml"
    fleet.write_text(dump(FLEET))
    unseen = [frame._replace(tags=tuple(tag for tag in frame.tags if tag.id not in (0, 9))) for frame in filmed[1]]
    monkeypatch.setattr(verb, "filmed", lambda *rest: Views([each for each in unseen if len(each.tags) > 1], 30, 0.002))
    asked = Asked(calibration=tmp_path / "r1.toml", out=tmp_path / "tags.toml", known=(0, 4, 11))
    run("film.mp4", fleet, asked, terminal())
    said = capsys.readouterr().out
    assert "--known 0: in no picture" in said
    written = {tag["id"] for tag in read_toml(tmp_path / "tags.toml")["landmarks"]["tag"]}
    lost = [tag.id for tag in LISTED.tag if tag.id not in written]
    assert {0, 9} <= set(lost)
    assert f"left out of the survey as no picture places them: {', '.join(map(str, lost))}; film" in said


def test_a_survey_of_all_tags_says_nothing_of_others(filmed):
    found = survey(Views(filmed[1], 24, 0.002), FLEET, known_tags(FLEET, KNOWN, "fleet.toml"), flat=True)
    all_of_them = replace(LISTED, tag=tuple(each.tag for each in found.tags))
    assert missing(found, all_of_them, KNOWN) == []


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
        start(alone, LISTED.tag[:1], SIDE_M, TANK, priors)


def test_turns_and_vectors():
    for vector in ([0.3, -1.0, 0.5], [1e-12, 0.0, 0.0], [0.0, 0.0, 3.0]):
        assert turned_by(turn_of(np.array(vector))) == pytest.approx(vector, abs=1e-9)


def test_a_folder_of_pictures_by_the_command(tmp_path, monkeypatch, capsys):
    """Two tags on a wall, seen square on, from two places."""
    sheet = np.hstack(
        [np.pad(0.03 + 0.67 * np.kron(modules(n), np.ones((8, 8))), 32, constant_values=0.3) for n in (0, 3)]
    )
    camera = replace(CAMERA, width_px=sheet.shape[1], height_px=sheet.shape[0], f_px=600.0, cx_px=143.5, cy_px=71.5)
    (tmp_path / "pictures").mkdir()
    for k in range(2):
        cv2.imwrite(str(tmp_path / "pictures" / f"{k}.png"), photograph(np.roll(sheet, 18 * k, axis=1), 1.0, seed=k))
    (tmp_path / "r1.toml").write_text(dump(replace(CALIBRATION, camera=camera)))
    tags = tuple(Tag(id=n, face="y0", position_m=(x, 0.0, 0.2)) for n, x in ((0, 0.4), (3, 0.215)))
    (tmp_path / "fleet.toml").write_text(dump(replace(FLEET, landmarks=Landmarks(size_m=0.08, sigma_m=0.01, tag=tags))))
    asked = ["pictures", "fleet.toml", "--calibration", "r1.toml", "--out", "tags.toml"]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["aucamp", "calibrate", "landmarks", *asked])
    with pytest.raises(SystemExit) as ended:
        main()
    assert not ended.value.code, capsys.readouterr().err
    assert "2 of 2 pictures used" in capsys.readouterr().out
    first, last = (np.array(tag["position_m"]) for tag in read_toml(tmp_path / "tags.toml")["landmarks"]["tag"])
    assert first[0] - last[0] == pytest.approx(144 / 64 * 0.08, abs=0.0015)  # by the sheet; 5 mm more by the fleet file
    cv2.imwrite("pictures/2.png", cv2.imread("pictures/1.png")[:, 4:])  # a later one of another size: cut, or scaled
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert "calibrated for 288x144 pixels, and these pictures have 284x144" in capsys.readouterr().err


def test_what_a_dive_recorded_is_taken_where_the_lens_was_at_rest(filmed):
    looked = [
        SeenTags(t_ns=k, frame=k, focus=None if k == 1 else 300, tags=f.tags) for k, f in enumerate(filmed[1][:4])
    ]
    steps = [SimpleNamespace(inputs=encode(Inputs(landmarks=(one,)))) for one in looked]
    steps.append(SimpleNamespace(inputs=encode(Inputs())))
    box = SimpleNamespace(calibration=replace(CALIBRATION, camera=CAMERA), steps=lambda: steps)
    views = recorded([box])
    assert (views.looked_at, views.focal) == (4, 0.002)
    assert [frame.tags for frame in views.frames] == [looked[k].tags for k in (0, 2, 3)]
