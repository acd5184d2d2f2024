"""Every verb of `aucamp replay` on recordings that went wrong: `python -m tests.fuzz.recordings COUNT SEED`.

One line for a person, or a verdict that knows of the change: anything else fails, with the seed and the number of the
recording, from which `mutant` makes it again.
"""

from __future__ import annotations

import json
import random
import resource
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from typer.testing import CliRunner

from agent.__main__ import app
from agent.core.config import ConfigError
from agent.ground.page.replayed import Reel, Replayed, came_of
from agent.ground.page.rows import Board
from agent.ground.page.server import hello
from agent.process.command import Failed
from replay.check.check import check, text, update_recordings
from replay.check.explain import explain
from replay.check.vision_check import check_vision
from replay.export import write_lines, write_tables
from replay.files.info import info, suspecting
from replay.files.log import read
from replay.files.recover import auto_recovered, recover_all
from replay.film import write_film
from replay.report.report import report
from replay.report.timeline import open_run
from replay.story import info_all
from tests.fuzz.decoding import within
from tests.fuzz.recording_bases import bases
from tests.fuzz.recording_mutants import BYTES, rewritten
from tests.replay.small_box import flat

PAGE_EVERY = 250  # recordings: a page with its figures takes as long as a hundred other verbs
COMMAND_EVERY = 100  # and the command line takes a while to build
VERB_S = 20  # of the processor: a verb that takes longer hangs
MEMORY_BYTES = 3 * 2**30  # of address space, for one process


class Outcome(NamedTuple):
    """What the verbs made of the recordings."""

    recordings: int
    verbs: int
    verdicts: Counter[str]  # how each verb ended
    nets: Counter[str]  # places in our code where only the last net caught what was wrong


def run(count: int, seed: int) -> None:
    """Give `count` recordings to every verb. AssertionError names the first that did what none may do."""
    fuzz(count, seed)


def fuzz(count: int, seed: int) -> Outcome:
    """The same, with figures."""
    outcome = Outcome(count, 0, Counter(), Counter())
    verbs = 0
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as folder, bounded():
        for number in range(count):
            place = Path(folder) / str(number)
            place.mkdir()
            file, harm = mutant(seed, number, place)
            for verb in VERBS:
                if (verb is page and number % PAGE_EVERY) or (verb is command and number % COMMAND_EVERY):
                    continue
                verbs += 1
                ended = one(verb, file, harm, f"seed {seed}, recording {number} ({harm.how}), {verb.__name__}")
                outcome.verdicts[f"{verb.__name__}: {ended.split(' (')[0]}"] += 1
                if ended.startswith("net"):
                    outcome.nets[ended] += 1
            shutil.rmtree(place)
    return outcome._replace(verbs=verbs)


class Harm(NamedTuple):
    """What was done to a recording."""

    how: str
    changed: bool  # some byte is another, and no digest was mended
    digests: bool  # the recording has digests


def mutant(seed: int, number: int, folder: Path) -> tuple[Path, Harm]:
    """The recording of that number, in a folder."""
    chance = random.Random(seed * 1_000_003 + number)
    base = chance.choices(bases(), [1 if base.label == "long" else 6 for base in bases()])[0]
    file = folder / base.name
    if chance.random() < 0.5:
        mutation = chance.choice(BYTES)
        whole = base.path.read_bytes()
        data = mutation(chance, whole)
        file.write_bytes(data)
        return file, Harm(f"{base.label}, {mutation.__name__}", data != whole, base.digests)
    digests = chance.random() < 0.7
    rewritten(chance, base.path, file, digests)
    return file, Harm(f"{base.label}, rewritten", False, digests)


def one(verb: Callable[[Path, Harm], str], file: Path, harm: Harm, what: str) -> str:
    """How a verb ended: its verdict, or "refused", or "net (PLACE)". AssertionError if it must not end so."""
    try:
        with within(VERB_S):
            return verb(file, harm)
    except (ConfigError, Failed) as error:
        said = str(error)
        assert said and "\n" not in said and len(said) < 1500, f"{what}: no line: {said!r}"
        assert "MemoryError" not in said, f"{what}: {said}"
        if "holds what no recorder writes" in said:
            kind, _, rest = said.partition("no recorder writes (")[2].partition(":")
            return f"net ({kind} in {rest.rpartition(', in ')[2].partition(')')[0]})"
        return "refused"
    except AssertionError:
        raise
    except BaseException as error:
        raise AssertionError(f"{what}: {type(error).__name__}: {str(error)[:300]}") from error


# --- the verbs --------------------------------------------------------------------------------------------------


def informed(file: Path, harm: Harm) -> str:
    lines: list[str] = []
    info_all([file], False, lines.append)
    info_all([file], True, lines.append)
    about = info(file)
    if harm.changed and harm.digests:
        assert not about.complete, f"not noticed: {lines[0]}"
    if harm.changed and not about.torn and not about.damage:
        assert "; it is older than digests" in lines[0], f"not noticed: {lines[0]}"
    return "whole" if about.complete else "not whole"


def mended(file: Path, harm: Harm) -> str:
    source = file.with_name(f"copy_{file.name}")
    shutil.copy(file, source)
    lines: list[str] = []
    code = recover_all([source], False, lines.append)
    copies = list(file.parent.glob("copy_*.recovered.mcap"))
    for copy in copies:
        about = info(copy)
        assert not about.torn, f"the mended copy is torn: {lines}"
        assert harm.how.endswith("rewritten") or set(read(copy)) <= originals(harm.how.split(",")[0]), "invented"
        copy.unlink()
    source.unlink()
    return f"exit {code}, {len(copies)} copies"


def checked(file: Path, harm: Harm) -> str:
    (there,) = auto_recovered([file], lambda line: None)
    found = check([there])
    text(found)
    found.as_json()
    if harm.changed and harm.digests:
        assert not any(each.box.complete for each in found.results), "checked as if it were whole"
    return f"exit {found.exit_code}"


def explained(file: Path, harm: Harm) -> str:
    explain(file)
    explain(file, "1.0s")
    return "explained"


def gathered(file: Path, harm: Harm) -> str:
    with suspecting(file):  # as the page does, whose data these are
        return f"{len(open_run(file).timelines)} timelines"


def page(file: Path, harm: Harm) -> str:
    report(file, file.with_name("page.html"), flat)
    return "written"


def on_a_page(file: Path, harm: Harm) -> str:
    """Laid out, looked at from both ends, and what came of it."""
    came_of(file)
    with Reel(file) as reel:
        board = Board()
        replayed = Replayed(reel, board)
        hello(reel.fleet, "recording", file.parent)
        for at_ns in (reel.times_ns[0], reel.times_ns[-1]):
            replayed.seek(at_ns)
            viewer = board.join()
            for shown in board.next_for(viewer):
                assert isinstance(shown, bytes) or json.loads(shown)["k"], "no message of a page"
            board.leave(viewer)
    return f"shown; {'some' if board.refused else 'none'} refused"


def seen_again(file: Path, harm: Harm) -> str:
    found = check_vision([file], lambda fleet, camera: lambda image, roi, then, first: then)
    return f"{[each.passed for each in found]} {[str(each)[:0] for each in found]}"


def updated(file: Path, harm: Harm) -> str:
    copy = file.with_name(f"u_{file.name}")
    shutil.copy(file, copy)
    try:
        return f"{len(update_recordings([copy], 'because'))} updated"
    finally:
        copy.unlink()


def in_folder(file: Path, harm: Harm) -> str:
    return f"exit {check(auto_recovered([file.parent], lambda line: None)).exit_code}"


def exported(file: Path, harm: Harm) -> str:
    """Tables, lines and a film: each is written whole or not at all, whatever the others come to."""
    ended = []
    for write, name in ((write_tables, "tables"), (write_lines, "lines.jsonl"), (write_film, "film.mp4")):
        out = file.with_name(f"out_{name}")
        try:
            write(file, out)
            ended.append("written")
        except (ConfigError, Failed) as error:
            assert "\n" not in str(error), f"{name}: no line: {error}"
            assert not out.exists(), f"{name}: half of it was left, and said: {error}"
            ended.append("refused")
        shutil.rmtree(out) if out.is_dir() else out.unlink(missing_ok=True)
    return ", ".join(ended)


def command(file: Path, harm: Harm) -> str:
    for verb in (["info"], ["info", "--json"], ["check"], ["check", "--json"], ["explain"], ["recover"]):
        result = CliRunner().invoke(app, ["replay", *verb, str(file)])
        ended = result.exception
        assert ended is None or isinstance(ended, (ConfigError, Failed, SystemExit)), f"{verb}: {ended!r}"
    return "done"


VERBS: tuple[Callable[[Path, Harm], str], ...] = (
    *(
        informed,
        mended,
        checked,
        explained,
        gathered,
        page,
        on_a_page,
        seen_again,
        updated,
        in_folder,
        exported,
        command,
    ),
)


@cache
def originals(label: str) -> frozenset[Any]:
    """All that a base says, on any channel that recovery may give it."""
    (base,) = [each for each in bases() if each.label == label]
    there = list(read(base.path))
    return frozenset([*there, *(each._replace(channel="/raw/step_in_cut") for each in there)])


# --- bounds -----------------------------------------------------------------------------------------------------


@contextmanager
def bounded() -> Iterator[None]:
    """No more memory than MEMORY_BYTES beyond what is taken now."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + MEMORY_BYTES, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


if __name__ == "__main__":
    result = fuzz(int(sys.argv[1]), int(sys.argv[2]))
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    sys.stdout.write(f"{result.recordings} recordings, {result.verbs} verbs, at most {peak_mb:.0f} MB resident\n")
    for name, times in sorted((result.verdicts + result.nets).items()):
        sys.stdout.write(f"{times:>8}  {name}\n")
