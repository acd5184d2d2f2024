import resource
import signal
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console

from agent.core.config import ConfigError
from agent.tools import training_pairs, training_scenes
from agent.tools.training_pairs import Pairs, check
from agent.tools.training_scenes import landscape

torch = pytest.importorskip("torch", reason="the extra `enhance` is not installed")

from agent.tools import training  # noqa: E402
from agent.tools.training import (  # noqa: E402
    Plan,
    Run,
    advance,
    batch,
    between,
    digest,
    rate,
)

TINY = Plan(steps=5, seed=3, sizes=((32, 2), (16, 3)), validate_every=2)


@pytest.fixture(scope="module")
def pairs() -> Pairs:
    made = [training_scenes.pair(*landscape(72, np.random.default_rng(i)), np.random.default_rng(i)) for i in range(6)]
    raw, target = (np.stack([pair[k] for pair in made]) for k in (0, 1))
    return Pairs(raw, target, np.array([f"land-{i}" for i in range(6)]))


def test_training_that_was_cut_off_goes_on_as_if_not(pairs, tmp_path):
    whole = Run(TINY)
    losses_whole = list(advance(whole, pairs, pairs.only(np.arange(2))))
    first = Run(TINY)
    steps = advance(first, pairs, pairs.only(np.arange(2)))
    losses_cut = [next(steps) for _ in range(3)]
    first.save(tmp_path / "run.checkpoint")
    second = Run.resume(tmp_path / "run.checkpoint", TINY)
    losses_cut += list(advance(second, pairs, pairs.only(np.arange(2))))
    assert losses_cut == losses_whole
    assert second.curve == whole.curve and [point.step for point in whole.curve] == [2, 4, 5]
    for ours, theirs in zip(second.average.state_dict().values(), whole.average.state_dict().values(), strict=True):
        assert torch.equal(ours, theirs)


def test_a_checkpoint_of_another_plan_or_none_is_one_line(tmp_path):
    file = tmp_path / "run.checkpoint"
    with pytest.raises(ConfigError, match="no checkpoint"):
        Run.resume(file, TINY)
    Run(TINY).save(file)
    for other, words in (
        (TINY._replace(steps=6), "with --steps 5; give the same"),
        (TINY._replace(steps=6, seed=4), "with --steps 5, --seed 3; give the same"),
        (TINY._replace(rate=3e-4), "with no --start; give the same"),
        (TINY._replace(augment=True), "with no --pairs; give the same"),
        (TINY._replace(validate_every=3), "by another version of aucamp; give the same"),
    ):
        with pytest.raises(ConfigError, match=rf"run\.checkpoint: was started {words}, or start anew elsewhere"):
            Run.resume(file, other)
    Run(TINY, of="these").save(file)
    with pytest.raises(ConfigError, match="was started with other pairs or another --start"):
        Run.resume(file, TINY, "those")
    file.write_bytes(b"not a checkpoint")
    with pytest.raises(ConfigError, match="no checkpoint"):
        Run.resume(file, TINY)


def test_a_run_is_known_by_its_pairs_and_its_start(pairs, tmp_path):
    start = tmp_path / "start.safetensors"
    start.write_bytes(b"weights")
    other = pairs._replace(target=pairs.target[::-1])
    found = [digest((pairs, pairs), None), digest((other, pairs), None), digest((pairs, pairs), start)]
    assert len(set(found)) == 3 and digest((pairs, pairs), None) == found[0]


def test_a_disk_that_is_full_is_an_error_of_the_file(tmp_path):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
        with pytest.raises(OSError, match="File too large") as raised:
            Run(TINY).save(tmp_path / "run.checkpoint")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert raised.value.filename == str(tmp_path / "run.checkpoint") and not list(tmp_path.iterdir())


def test_training_learns(pairs):
    plan = Plan(steps=25, sizes=((16, 8),))
    values = list(advance(Run(plan), pairs, pairs.only(np.zeros(6, bool))))
    assert np.mean(values[-5:]) < 0.9 * np.mean(values[:5])


def test_weights_between_two_are_a_share_of_the_way():
    start, tuned = Run(TINY).net, Run(TINY._replace(seed=4)).net
    half = between(start, tuned, 0.25)
    for name, value in half.state_dict().items():
        wanted = 0.75 * start.state_dict()[name] + 0.25 * tuned.state_dict()[name]
        assert torch.allclose(value.float(), wanted.float(), atol=1e-6)
    assert not half.training and torch.equal(start.last.bias, Run(TINY).net.last.bias)


def test_batches_follow_from_seed_and_step_and_both_pictures_move_together(pairs):
    same = Pairs(pairs.raw, pairs.raw, pairs.scene)
    raw, target = batch(same, TINY, 1)
    assert torch.equal(raw, target)
    assert torch.equal(raw, batch(same, TINY, 1)[0])
    assert raw.shape in [(2, 3, 32, 32), (3, 3, 16, 16)] and raw.min() >= 0 and raw.max() <= 1
    assert not torch.equal(batch(same, TINY._replace(augment=True), 1)[0], raw)


def test_the_rate_rises_and_ends_near_zero():
    plan = Plan(steps=1000)
    assert rate(plan, 0) < rate(plan, 49) > rate(plan, 500) > rate(plan, 999) > 0


def test_equal_pictures_lose_nothing_and_others_do():
    x = torch.rand(2, 3, 24, 20, generator=torch.Generator().manual_seed(0))
    assert training.loss(x, x).item() == pytest.approx(0, abs=1e-5)
    for worse in (x * 0.5, x.flip(1), torch.rand_like(x)):
        assert training.loss(worse, x).item() > 0.1


def test_a_buoy_that_comes_out_olive_costs_as_much_as_a_picture_that_is_too_dark():
    target = torch.full((1, 3, 48, 48), 0.4)
    target[:, :, 20:25, 20:25] = torch.tensor([0.9, 0.3, 0.1]).view(1, 3, 1, 1)
    olive = target.clone()
    olive[:, :, 20:25, 20:25] = torch.tensor([0.4, 0.4, 0.1]).view(1, 3, 1, 1)
    assert training.warm_loss(training.to_lab(olive), training.to_lab(target)) > 0.2
    assert training.loss(olive, target) > training.loss(target - 0.05, target)
    dull = torch.full_like(target, 0.4)
    assert training.warm_loss(training.to_lab(dull + 0.1), training.to_lab(dull)) == 0


def test_lab_agrees_with_opencv():
    rgb = torch.rand(1, 3, 8, 8, generator=torch.Generator().manual_seed(0))
    theirs = cv2.cvtColor(rgb[0].permute(1, 2, 0).numpy(), cv2.COLOR_RGB2LAB)
    assert np.abs(training.to_lab(rgb)[0].permute(1, 2, 0).numpy() - theirs).max() < 0.3


def test_losses_can_be_followed_downhill_from_black_and_white():
    x = torch.tensor([0.0, 1.0]).repeat(1, 3, 16, 8).requires_grad_()
    training.loss(x, torch.full_like(x, 0.4)).backward()
    assert torch.isfinite(x.grad).all() and x.grad.abs().sum() > 0


def test_near_things_keep_their_light_and_far_things_are_veil():
    sea = training_scenes.draw_sea(np.random.default_rng(0))
    lit = np.full((16, 16, 3), 0.5, np.float32)
    near, far = (training_scenes.submerge(lit, np.full((16, 16), z, np.float32), sea, 1.0) for z in (0.0, 1e3))
    assert near[8, 8] == pytest.approx(0.5 * sea.down, rel=1e-5)
    assert far[8, 8] == pytest.approx(sea.veil, rel=1e-5)


def test_targets_are_neutral_and_of_full_contrast(pairs):
    means, raw_means = pairs.target.mean((1, 2)), pairs.raw.mean((1, 2))
    assert np.ptp(means, axis=1).mean() < 0.5 * np.ptp(raw_means, axis=1).mean()
    assert (np.ptp(pairs.target, axis=(1, 2, 3)) >= 250).all()


def test_clips_stay_together_and_folds_keep_scenes_whole():
    rng = np.random.default_rng(0)
    views = [cv2.resize(rng.integers(0, 256, (6, 6, 3), dtype=np.uint8), (64, 64)) for _ in range(6)]
    clip = [np.roll(views[0], shift, axis=1) for shift in (0, 1, 2)]
    numbers = training_pairs.scenes(np.array(clip + views[1:]))
    assert numbers[0] == numbers[1] == numbers[2]
    assert len(set(numbers)) == 6
    fold = training_pairs.folds(np.array([f"scene-{n}" for n in numbers]), 3, seed=0)
    assert len(set(fold[:3])) == 1 and set(fold) == {0, 1, 2}
    with pytest.raises(ConfigError, match="cannot make 7 folds"):
        training_pairs.folds(np.array([f"scene-{n}" for n in numbers]), 7, seed=0)


def test_real_pairs_are_matched_by_name_and_bad_ones_are_one_line(tmp_path):
    raw, reference = tmp_path / "raw-890", tmp_path / "reference-890"
    with pytest.raises(ConfigError, match="no such folder"):
        training_pairs.read_pairs(raw, reference, 32)
    for folder in (raw, reference):
        folder.mkdir()
    cv2.imwrite(str(raw / "a.png"), np.full((40, 50, 3), 60, np.uint8))
    with pytest.raises(ConfigError, match="reference-890: no pictures"):
        training_pairs.read_pairs(raw, reference, 32)
    cv2.imwrite(str(reference / "b.bmp"), np.full((40, 50, 3), 90, np.uint8))
    with pytest.raises(ConfigError, match="no two pictures of the same name"):
        training_pairs.read_pairs(raw, reference, 32)
    cv2.imwrite(str(reference / "a.bmp"), np.full((40, 50, 3), 90, np.uint8))
    pairs = training_pairs.read_pairs(raw, reference, 32)
    assert pairs.raw.shape == (1, 32, 32, 3) and pairs.raw.max() == 60 and pairs.target.max() == 90
    cv2.imwrite(str(reference / "a.bmp"), np.zeros((40, 40, 3), np.uint8))
    with pytest.raises(ConfigError, match="50x40, but its reference 40x40 pixels"):
        training_pairs.read_pairs(raw, reference, 32)
    (raw / "a.png").write_bytes(b"torn")
    with pytest.raises(ConfigError, match="not an image"):
        training_pairs.read_pairs(raw, reference, 32)


@pytest.mark.parametrize(("asked", "expected"), [
    ({"pairs": (Path("nowhere"), Path("nowhere"))}, "nowhere: no such folder"),
    ({"resume": True}, "--resume needs --out"),
    ({"resume": True, "out": Path("w.safetensors")}, r"w\.checkpoint: no such checkpoint"),
    ({"start": Path("nowhere")}, "nowhere: no such file"),
    ({"out": Path("weights.bin")}, r"weights\.bin: give --out a name that ends in \.safetensors"),
    ({"cross_validate": 3}, "needs --pairs RAW REFERENCE and --start WEIGHTS"),
])  # fmt: skip
def test_mistakes(asked, expected, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=expected):
        check(**{"pairs": None, "start": None, "out": None, "resume": False, "cross_validate": None, **asked})
    assert not list(tmp_path.iterdir())


def test_a_mistake_is_one_line_and_said_before_torch_is_imported(tmp_path):
    command = [sys.executable, "-X", "importtime", "-m", "agent", "train", "--start", "nowhere"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    imported = [line for line in done.stderr.splitlines() if line.startswith("import time:")]
    said = [line for line in done.stderr.splitlines() if not line.startswith("import time:")]
    assert done.returncode == 2 and len(said) == 1 and "nowhere: no such file" in said[0] and not done.stdout, said
    assert not any(line.split("|")[-1].strip() == "torch" for line in imported), "torch takes seconds"


@pytest.mark.parametrize(("there", "resume", "expected"), [
    ("w.safetensors", False, "w.safetensors: is there already, and nothing is overwritten; give --out another name"),
    ("w.csv", False, "w.csv: is there already, and nothing is overwritten"),
    ("w.checkpoint", False, "w.checkpoint: is there already, of a training that was cut off; go on with --resume"),
    ("w.checkpoint w.safetensors w.safetensors.sha256", True, "this training has ended; train on with --start"),
])  # fmt: skip
def test_what_a_training_wrote_is_not_overwritten(there, resume, expected, tmp_path):
    for name in there.split():
        (tmp_path / name).write_text("mine")
    with pytest.raises(ConfigError, match=expected):
        check(None, None, tmp_path / "w.safetensors", resume, None)


def test_a_training_that_was_cut_off_may_go_on(tmp_path):
    (tmp_path / "w.checkpoint").write_text("mine")
    (tmp_path / "w.csv").write_text("its curves so far")
    check(None, None, tmp_path / "w.safetensors", True, None)


@pytest.mark.parametrize(("wait_s", "kept"), [(-1.0, True), (60.0, False)])
def test_a_slow_training_is_saved_each_minute(pairs, tmp_path, monkeypatch, wait_s, kept):
    def cut_off(*about):
        steps = advance(*about)
        yield from (next(steps) for _ in range(2))
        raise KeyboardInterrupt

    monkeypatch.setattr(training, "advance", cut_off)
    monkeypatch.setattr(training, "_made", lambda *about: (pairs, pairs.only(np.arange(2))))
    monkeypatch.setattr(training, "SAVE_S", wait_s)
    with pytest.raises(KeyboardInterrupt):
        training.train(None, tmp_path / "w.safetensors", TINY, None, False, False, Console(quiet=True))
    assert (tmp_path / "w.checkpoint").exists() == kept
    if kept:
        of = digest((pairs, pairs.only(np.arange(2))), None)
        assert Run.resume(tmp_path / "w.checkpoint", TINY, of).step == 2
