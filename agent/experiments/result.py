"""What an experiment found, as it goes into result.json."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec

NAME = "result.json"
BESIDE = "shown"  # the one field that stays out of the file

Row = dict[str, Any]  # of a list in result.json


class ExperimentResult(msgspec.Struct, frozen=True, kw_only=True):
    """Base of all results: fields are the keys of result.json in their order, units in the names.

    A field `shown` holds what tables and figures need beyond that.
    """

    def as_json(self) -> dict[str, Any]:
        """The content of result.json."""
        return {name: getattr(self, name) for name in self.__struct_fields__ if name != BESIDE}

    @property
    def failed(self) -> bool:
        """Whether a target is missed, which is exit code 1. An experiment that has no targets misses none, nor does one
        that was run too seldom to tell: it gives no verdict."""
        return False


def write_result(result: ExperimentResult, folder: Path) -> None:
    """Write result.json."""
    (folder / NAME).write_text(json.dumps(result.as_json(), indent=1) + "\n", encoding="utf-8")
