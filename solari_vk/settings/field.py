"""The description of a setting: its meaning and its allowed values."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Field:
    """The meaning and the allowed values of a setting.

    section groups settings. rebuilds: a change rebuilds pipelines or buffers; the other settings are live.
    """

    section: str
    meaning: str
    choices: tuple[str, ...] = ()
    low: float = 0
    high: float = math.inf
    rebuilds: bool = False


def setting(section: str, default: Any, meaning: str, **more: Any) -> Any:
    """A dataclass field with this default that is described by a Field."""
    return dataclasses.field(default=default, metadata={"field": Field(section, meaning, **more)})
