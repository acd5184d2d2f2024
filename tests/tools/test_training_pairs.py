import numpy as np
import pytest

from agent.tools import training_pairs, training_scenes
from agent.tools.evaluate_enhance import warm
from agent.tools.training_pairs import Water, augmented, linear, through, water_of
from agent.tools.training_scenes import landscape

SIDE = 48


@pytest.fixture(scope="module")
def reference() -> np.ndarray:
    picture, _ = landscape(SIDE, np.random.default_rng(4))
    return training_scenes.finish(picture)


def test_the_water_of_a_pair_is_found_again(reference):
    water = Water(np.array([0.5, 0.6, 0.1], np.float32), np.array([0.2, 0.25, 0.02], np.float32))
    found = water_of(training_scenes.coded_bytes(through(linear(reference), water, 1.0)), reference)
    assert found.gain == pytest.approx(water.gain, abs=0.02)
    assert found.veil == pytest.approx(water.veil, abs=0.01)


def test_what_is_near_keeps_its_colour():
    water = Water(np.array([0.5, 0.8, 0.1], np.float32), np.array([0.2, 0.25, 0.02], np.float32))
    red = np.full((1, 1, 3), (0.1, 0.1, 0.8), np.float32)
    near, far = through(red, water, 0.0)[0, 0], through(red, water, 1.0)[0, 0]
    assert near == pytest.approx(0.8 * red[0, 0])  # the exposure
    assert far == pytest.approx(water.gain * red[0, 0] + water.veil)


def test_pairs_follow_from_the_draw_and_keep_their_sizes(reference):
    raw = (reference // 2 + 40).astype(np.uint8)
    ones, others = (augmented(raw, reference, np.random.default_rng(1)) for _ in range(2))
    for one, other in zip(ones, others, strict=True):
        assert np.array_equal(one, other) and one.shape == reference.shape and one.dtype == np.uint8


def test_some_pairs_are_good_already_and_others_are_in_other_water(reference, monkeypatch):
    monkeypatch.setattr(training_pairs, "WITH_THINGS", 0.0)
    monkeypatch.setattr(training_pairs, "OWN", 0.0)
    raw = np.full_like(reference, 30)
    pairs = [augmented(raw, reference, np.random.default_rng(seed)) for seed in range(40)]
    assert all(np.array_equal(target, reference) for _, target in pairs)
    apart = np.array([np.abs(seen.astype(float) - reference).mean() for seen, _ in pairs])
    flat = np.array([np.ptp(seen, axis=(0, 1)).max() <= 1 for seen, _ in pairs])  # the raw one, taken otherwise
    assert 12 <= flat.sum() <= 32 and (~flat).sum() >= 8
    assert apart[~flat].min() < 15 and apart[~flat].max() > 30  # hardly any water, and some


def test_some_pairs_are_of_our_own_making(reference, monkeypatch):
    monkeypatch.setattr(training_pairs, "WITH_THINGS", 0.0)
    targets = [augmented(reference, reference, np.random.default_rng(seed))[1] for seed in range(20)]
    assert 1 <= sum(not np.array_equal(target, reference) for target in targets) <= 10


def test_most_things_are_warm_and_none_is_yellow_green():
    rng = np.random.default_rng(0)
    colours = [training_scenes.coded_bytes(training_scenes.vivid_colour(rng)[None, None]) for _ in range(200)]
    share = np.mean([warm(c).all() for c in colours])
    assert share == pytest.approx(training_scenes.WARM_SHARE, abs=0.1)


def test_things_do_not_tint_the_targets_balance():
    grey = np.full((SIDE, SIDE, 3), 0.3, np.float32) * np.linspace(0.5, 1, SIDE, dtype=np.float32)[:, None, None]
    vivid = np.zeros((SIDE, SIDE), np.float32)
    vivid[:, SIDE // 2 :] = 1
    picture = training_scenes.put_into(grey, training_scenes.Thing(vivid, np.full_like(grey, (0.01, 0.02, 0.7))))
    balanced, tinted = training_scenes.finish(picture, vivid), training_scenes.finish(picture)
    assert np.ptp(balanced[:, : SIDE // 2].astype(int), axis=2).max() <= 1
    assert np.ptp(tinted[:, : SIDE // 2].astype(int), axis=2).max() > 30


def test_small_and_large_things_are_drawn_inside_their_masks():
    for seed in range(12):
        thing = training_scenes.draw_thing(SIDE, np.random.default_rng(seed))
        assert thing.mask.shape == (SIDE, SIDE) and thing.mask.min() >= 0 and thing.mask.max() <= 1
        assert np.isfinite(thing.picture).all() and thing.picture.min() >= 0
