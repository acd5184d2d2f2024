"""Copies of a recording with something changed, for tests."""

from collections.abc import Callable
from pathlib import Path

from replay.files.channels import Entry
from replay.files.log import Record, info, read
from replay.files.mcap_file import Part


def rewritten(
    source: Path,
    out: Path,
    change: Callable[[Record], bytes | None] = lambda record: record.data,
    run: dict[str, str] | None = None,
    without: tuple[str, ...] = (),
) -> Path:
    """Write `source` to `out`; `change` gives new bytes for a record, or None to leave it out.

    `run` replaces entries of the header, `without` names entries and attachments to leave out.
    """
    about = info(source)
    part = Part(out)
    header = {name: value for name, value in {**about.run, **(run or {})}.items() if name not in without}
    part.start(header, {name: text for name, text in about.attachments.items() if name not in without})
    for record in read(source):
        data = change(record)
        if data is not None:
            part.add(Entry(*record._replace(data=data), "msgpack", {}))
    part.finish("aucamp.end", {"cause": "clean"})
    return out
