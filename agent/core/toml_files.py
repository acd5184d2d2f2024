"""TOML files and frozen structs: text into one, one into text."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import tomli_w

from agent.core.config import ConfigError
from agent.core.toml_errors import explain

T = TypeVar("T")


def dump(struct: msgspec.Struct) -> str:
    """The TOML text from which the same struct is read again."""

    def drop_none(value: Any) -> Any:
        if isinstance(value, dict):
            return {k: drop_none(v) for k, v in value.items() if v is not None}
        return value

    return tomli_w.dumps(drop_none(msgspec.to_builtins(struct)))


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file; every failure is a ConfigError."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file; give the path of an existing TOML file") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); give the path of a TOML file") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: not a text file; give the path of a TOML file") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: not valid TOML: {error}") from None


def convert(data: dict[str, Any], kind: type[T], path: Path) -> T:
    """Check parsed TOML against a struct; the message names file, key and remedy."""
    try:
        return msgspec.convert(data, kind)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{path}: {explain(error, data, kind)}") from None
