"""Names and values of parameters, checked before they are asked of a board."""

from __future__ import annotations

from agent.core.config import ConfigError
from hw.firmware import parameters
from hw.stm32.parameter_texts import TEXTS

IDS: dict[str, int] = {name: i for i, name in enumerate(parameters.NAMES)}


def parameter_id(name: str) -> int:
    """Number of a parameter. Raises ConfigError that names those that there are."""
    if name not in IDS:
        raise ConfigError(f"parameter '{name}' is not known, write one of: {' '.join(parameters.NAMES)}")
    return IDS[name]


def checked_id(name: str, value: float) -> int:
    """Number of a parameter that may have this value. Raises ConfigError that says what it may have."""
    i = parameter_id(name)
    if not parameters.in_range(i, value):
        _, _, lowest, highest, kind = parameters.TABLE[i]
        unit, _ = TEXTS[name]
        whole = " whole" if kind == parameters.WHOLE else ""
        raise ConfigError(f"{name} = {value:g}: write a{whole} number from {lowest:g} to {highest:g} {unit}".rstrip())
    return i
