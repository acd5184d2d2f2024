"""Recordings of an older schema: in what today's outputs must differ from theirs, however alike the robots behave."""

from __future__ import annotations

import re
from collections.abc import Collection
from functools import cache

from agent.core.messages import SCHEMA
from replay.check.compare import ABSENT, Difference

NUMBERED = ("says.schema", "state.schema", "log.schema")  # fields that say the schema itself
# What later schemas added, by the older one that lacks it: `common`; proposals, which end a gossip; the signature that
# ends an entry; time and signature, which end a sample; of a state, `signed`, `sway_m`, `battery_v` and `ladder`.
# Another entry is no such.
ADDED = {
    1: r"says\[\d+\]\.(common|gossip\[4\]|gossip\[1\]\[\d+\]\[6\]|gossip\[2\]\[\d+\]\[[67]\])"
    r"|state\.(signed|battery_v|ladder|explain\.sway_m)"
}
IN_WORDS = {
    1: "the schema itself, signatures, times of exposure, proposals, `common`, `signed`, `sway_m`, battery, ladder"
}
YOUNGER = ("state.battery_v", "state.ladder")  # said by robots only since some recordings of today's schema were made


def must_differ(schema: int, difference: Difference) -> bool:
    """Whether a difference from a recording of this schema says nothing but that the schema is an older one."""
    if schema == SCHEMA:
        return False
    if difference.plain in NUMBERED:
        return bool(difference.recorded == schema and difference.replayed == SCHEMA)
    return difference.recorded is ABSENT and _added(schema).fullmatch(difference.field) is not None


def note(schema: int) -> str | None:
    """What a reader of the verdict has to know; None for a recording of today's schema."""
    if schema == SCHEMA:
        return None
    return f"recorded with schema {schema}: compared but for {IN_WORDS.get(schema, 'what later ones added')}"


def only_younger(fields: Collection[str], first: Difference) -> bool:
    """Whether a recording differs in nothing but fields that it may be too old to have."""
    return first.recorded is ABSENT and set(fields) <= set(YOUNGER)


@cache
def _added(schema: int) -> re.Pattern[str]:
    return re.compile(ADDED.get(schema, r"\b\B"))  # else nothing
