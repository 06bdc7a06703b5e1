"""What a setting is: its default, what it means to people, and what it may be."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Field:
    """What a setting means and may be. `section` groups fields for people; `rebuilds`: it is built into pipelines or
    sizes a buffer, so that the frame is built anew (history of what keeps its size stays), all others are live."""

    section: str
    meaning: str
    choices: tuple[str, ...] = ()
    low: float = 0
    high: float = math.inf
    rebuilds: bool = False


def setting(default: Any, section: str, meaning: str, **more: Any) -> Any:
    """A dataclass field with its default that is a setting."""
    return dataclasses.field(default=default, metadata={"field": Field(section, meaning, **more)})
