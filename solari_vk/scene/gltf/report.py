"""What a file asks for that could not be taken over: each thing once, with how often and where."""

from __future__ import annotations

from itertools import islice

NAMES_SHOWN = 3


class Report:
    """Collects remarks; the same remark about many objects becomes one line."""

    def __init__(self) -> None:
        self._places: dict[str, dict[str, None]] = {}

    def add(self, remark: str, place: str) -> None:
        """Note the remark about the object at that place, once."""
        self._places.setdefault(remark, {})[place] = None

    def lines(self) -> list[str]:
        """One line for each remark, in the order in which they came up."""
        result = []
        for remark, places in self._places.items():
            more = len(places) - NAMES_SHOWN
            result.append(f"{remark}: {', '.join(islice(places, NAMES_SHOWN))}" + (f" and {more} more" * (more > 0)))
        return result
