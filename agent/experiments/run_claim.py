"""Run a claim for many seeds: side by side on this machine's cores, or on a cluster; cut off, it goes on where it was.

A piece of work is one case with one seed. Its rows are a line of `finished.jsonl` as soon as they are there. When all
are, `rows.json` has them in order and `result.json` the figures: the same bytes, however often the run was cut, and
on whatever it ran.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import multiprocessing
import os
import signal
from collections.abc import Generator, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from threading import Thread
from typing import IO, Any, NamedTuple

import msgspec

from agent.clock import machine
from agent.core.config import ConfigError, write_whole
from agent.experiments.claim import Claim, Row
from agent.experiments.registry import Entry, code_hash, load
from agent.process.command import Failed, Progress

PLAN, FINISHED, ROWS = "plan.json", "finished.jsonl", "rows.json"
TIMED_OUT_S = 30.0  # until a scheduler answers
LOOK_S = 0.2  # how soon a signal is seen


class Plan(NamedTuple):
    """What is asked for. The folder of a run belongs to one claim, its settings and the code (`of`); more seeds and
    cases may join it."""

    name: str
    entry: Entry  # where the claim is
    code: str  # hash of what is measured (registry.py)
    settings: msgspec.Struct
    cases: tuple[str, ...]
    seeds: range

    @property
    def of(self) -> dict[str, Any]:
        settings = json.loads(msgspec.json.encode(self.settings))  # as a file gives it back: a tuple is a list there
        return {"claim": self.name, "code": self.code, "settings": settings}

    @property
    def pieces(self) -> list[tuple[str, int]]:
        return [(case, seed) for seed in self.seeds for case in self.cases]


class Found(NamedTuple):
    """Rows by case and seed, and what they took."""

    seeds: range  # those that were asked for, and all others of the folder
    rows: dict[str, dict[int, list[Row]]]
    seconds_a_seed: float  # of one process, all cases together
    kept: int  # pieces that were on the disk before


def run_plan(
    plan: Plan, folder: Path, jobs: int | None, scheduler: str | None, progress: Progress, claim: Claim
) -> Found:
    """Run what is not on the disk yet. Progress counts pieces.

    Raises ConfigError for a folder of something else or of seeds that leave a gap, a scheduler that does not answer,
    and jobs for a claim that runs alone; Failed, or what the claim raises, where a seed fails: what has finished stays.
    """
    if claim.alone and (scheduler is not None or (jobs or 1) > 1):
        raise ConfigError(
            f"experiment {plan.name}: runs alone, for it times the machine; leave --jobs, --scheduler out"
        )
    begin(plan, folder)
    with (folder / FINISHED).open("a", encoding="utf-8") as file, contextlib.ExitStack() as stack:
        lock(file, folder)
        finished = read_finished(folder / FINISHED)
        plan = plan._replace(seeds=joined(plan, finished, folder))
        wanted = plan.pieces
        missing = [piece for piece in wanted if piece not in finished]
        done = len(wanted) - len(missing)
        progress(done, len(wanted))
        if claim.alone:
            results = on_this_process(plan, missing)
        elif scheduler is not None:
            results = stack.enter_context(contextlib.closing(on_cluster(plan, missing, scheduler)))
        else:
            results = stack.enter_context(contextlib.closing(on_processes(plan, missing, jobs or os.cpu_count() or 1)))
        for piece, line in results:
            write_line(file, line)
            finished[piece] = json.loads(line)
            done += 1
            progress(done, len(wanted))
    rows = {case: {seed: finished[case, seed]["rows"] for seed in plan.seeds} for case in plan.cases}
    seconds = sum(finished[piece]["seconds"] for piece in wanted) / len(plan.seeds)
    write_whole(folder / ROWS, json.dumps(rows, indent=1) + "\n")
    return Found(plan.seeds, rows, seconds, len(wanted) - len(missing))


# --- a piece of work, in whatever process ---


def work(module: str, settings: Mapping[str, Any], case: str, seed: int) -> str:
    """One line of finished.jsonl. Raises ConfigError for rows that no line of it can hold."""
    claim = load(module)
    start_s = spent_s(claim)
    try:
        rows = claim.run(seed, case, msgspec.convert(settings, claim.settings))
    except Failed as error:
        raise Failed(f"{case}, seed {seed}: {error}") from error
    seconds = round(spent_s(claim) - start_s, 3)
    try:
        return json.dumps({"case": case, "seed": seed, "seconds": seconds, "rows": rows}, allow_nan=False) + "\n"
    except (TypeError, ValueError) as error:  # an infinity, a NaN, an array, a number of numpy's
        raise ConfigError(f"{module}: {case}, seed {seed}: rows are plain JSON, and this is none: {error}") from None


def spent_s(claim: Claim) -> float:
    """What a claim takes of the machine: its processor time, that of programs that it starts included; one that runs
    alone, which may wait for them, its time."""
    used = os.times()
    return machine.stopwatch_s() if claim.alone else used.user + used.system + used.children_user + used.children_system


Results = Generator[tuple[tuple[str, int], str]]


def arguments(plan: Plan, piece: tuple[str, int]) -> tuple[str, dict[str, Any], str, int]:
    return plan.entry.module, msgspec.to_builtins(plan.settings), *piece


def on_this_process(plan: Plan, pieces: Sequence[tuple[str, int]]) -> Results:
    for piece in pieces:
        yield piece, work(*arguments(plan, piece))


def on_processes(plan: Plan, pieces: Sequence[tuple[str, int]], jobs: int) -> Results:
    """Spawned, for a fork would copy the progress bar's thread in mid-step. A signal, or a piece that fails, ends the
    workers in mid-work; what they had finished by then is told first."""
    others = multiprocessing.active_children()
    with held_back() as asked:
        pool = ProcessPoolExecutor(
            min(jobs, max(len(pieces), 1)), mp_context=multiprocessing.get_context("spawn"), initializer=end_with_parent
        )
        with kept_from_children(signal.SIGINT):  # a terminal sends it to all of them
            futures = {pool.submit(work, *arguments(plan, piece)): piece for piece in pieces}
        try:
            waiting, failed = set(futures), list[Future[str]]()
            while waiting and not asked and not failed:
                done, waiting = wait(waiting, LOOK_S, FIRST_COMPLETED)
                ended = [future for future in futures if future in done]  # in order: of several that fail, the first
                failed = [future for future in ended if future.exception() is not None]
                for future in ended:
                    if future not in failed:
                        yield futures[future], future.result()
        finally:
            for worker in multiprocessing.active_children() if waiting else ():
                if worker not in others:
                    worker.kill()
            pool.shutdown(wait=True, cancel_futures=True)
        for future in waiting:
            if future.done() and not future.cancelled() and future.exception() is None:
                yield futures[future], future.result()
        try:
            if failed and not asked:
                failed[0].result()
        except BrokenProcessPool:
            raise Failed(
                f"experiment {plan.name}: a process of it was ended from outside, as when memory is short; "
                "what has finished is kept, and the same command goes on; fewer --jobs need less memory"
            ) from None


@contextlib.contextmanager
def held_back() -> Iterator[list[int]]:
    """What ends this process ends it when the block is left; until then, the signals that have come."""
    asked: list[int] = []
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    for number, handler in before.items():
        if handler is not signal.SIG_IGN:  # nohup means it
            signal.signal(number, lambda number, frame: asked.append(number))
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if asked:
            signal.raise_signal(asked[0])


@contextlib.contextmanager
def kept_from_children(number: signal.Signals) -> Iterator[None]:
    """Processes that begin here never get this signal: they have the mask of the thread that begins them."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (number,))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def end_with_parent() -> None:
    """A worker waits for work for ever, unless it looks for the process that gives it."""
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    Thread(target=watch, name="parent watch", daemon=True).start()


def on_cluster(plan: Plan, pieces: Sequence[tuple[str, int]], scheduler: str) -> Results:
    """On the workers of a Dask scheduler, each of which has this same code installed."""
    try:
        import distributed
    except ImportError:
        raise ConfigError("--scheduler: needs the extra `cluster`: pip install 'aucamp[cluster]'") from None
    try:
        client = distributed.Client(scheduler, timeout=TIMED_OUT_S, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError, TimeoutError) as error:
        raise ConfigError(f"--scheduler {scheduler}: no scheduler answers there ({error})") from None
    with client:
        theirs = client.submit(code_hash, plan.entry.module, plan.entry.also, pure=False)
        if theirs.result() != plan.code:
            raise ConfigError(f"--scheduler {scheduler}: its workers have another state of the code; install this one")
        futures = {client.submit(work, *arguments(plan, piece), pure=False): piece for piece in pieces}
        try:
            for future in distributed.as_completed(list(futures), loop=client.loop):  # type: ignore[no-untyped-call]
                yield futures[future], future.result()
                future.release()
        except (distributed.KilledWorker, distributed.client.FutureCancelledError) as error:
            raise Failed(
                f"experiment {plan.name}: the cluster lost a seed ({error}); the same command goes on"
            ) from None


# --- the folder ---


def begin(plan: Plan, folder: Path) -> None:
    """Make the folder, or see that it is this plan's. Raises ConfigError."""
    path = folder / PLAN
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not path.exists():
            if any(folder.iterdir()):
                raise ConfigError(f"{folder}: not empty, and nothing is overwritten; give --out a new folder")
            write_whole(path, json.dumps(plan.of, indent=1) + "\n")
        known = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written ({error.strerror}); give --out another folder") from None
    except json.JSONDecodeError:
        raise ConfigError(f"{path}: is no plan of a run; give --out a new folder") from None
    asked = plan.of
    for key, words in (("claim", "claim"), ("settings", "settings"), ("code", "state of the code")):
        if known.get(key) != asked[key]:
            raise ConfigError(f"{folder}: holds seeds of another {words}; give --out a new folder")


def lock(file: IO[str], folder: Path) -> None:
    """For as long as the file is open. Raises ConfigError where another run has it."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        raise ConfigError(f"{folder}: another run writes there; wait for it, or give --out another folder") from None


def read_finished(path: Path) -> dict[tuple[str, int], dict[str, Any]]:
    """What has finished, by case and seed. A last line that was cut off is taken away: its seed runs again."""
    content = path.read_bytes()
    whole = content[: content.rfind(b"\n") + 1]
    if len(whole) < len(content):
        os.truncate(path, len(whole))
    try:
        lines = [json.loads(line) for line in whole.splitlines()]
        return {(line["case"], line["seed"]): line for line in lines}
    except (json.JSONDecodeError, KeyError, TypeError):
        raise ConfigError(f"{path}: holds a line that no run wrote; give --out a new folder") from None


def joined(plan: Plan, finished: Mapping[tuple[str, int], Any], folder: Path) -> range:
    """The seeds that are asked for with all that have every case. Raises ConfigError where some between are missing."""
    whole = {seed for _, seed in finished if all((case, seed) in finished for case in plan.cases)} | set(plan.seeds)
    seeds = range(min(whole), max(whole) + 1)
    if len(whole) < len(seeds):
        raise ConfigError(
            f"{folder}: holds other seeds, and some between are missing; "
            f"ask for all by --seed {seeds[0]} --seeds {len(seeds)}, or give --out a new folder"
        )
    return seeds


def write_line(file: IO[str], line: str) -> None:
    """It is on the disk when this returns."""
    file.write(line)
    file.flush()
    os.fsync(file.fileno())
