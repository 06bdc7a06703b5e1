"""The description of a setting: its meaning and its allowed values."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from solari_vk.base.errors import is_name


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

    def checked(self, value: Any, default: Any) -> Any:
        """The value in the default's type; None if it isn't allowed."""
        if self.choices:
            return value if is_name(value, self.choices) else None
        if isinstance(default, bool):
            return bool(value) if np.ndim(value) == 0 and value in (True, False) else None
        try:
            number = float(value)
        except (TypeError, ValueError, OverflowError):
            return None
        whole = isinstance(default, int)
        # NaN fails every comparison, so it isn't allowed either.
        if not (self.low <= number <= self.high) or (whole and number != int(number)):
            return None
        return int(number) if whole else number


def setting(section: str, default: Any, meaning: str, **more: Any) -> Any:
    """A dataclass field with this default that is described by a Field."""
    return dataclasses.field(default=default, metadata={"field": Field(section, meaning, **more)})
