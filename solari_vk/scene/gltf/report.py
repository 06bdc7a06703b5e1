"""What a loader could not use of a file: one line for each kind of problem, with the places."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

from solari_vk.scene.gltf.values import Entry

NAMES_SHOWN = 3


class Report:
    """Collects remarks. The same remark about many objects is one line."""

    def __init__(self) -> None:
        self._places: dict[str, dict[str, None]] = {}

    def add(self, remark: str, place: str) -> None:
        """Add a remark about the object at a place."""
        self._places.setdefault(remark, {})[place] = None

    def add_extensions(self, entry: Entry, handled: Iterable[str] = ()) -> None:
        """Add a remark about each extension of an object that isn't handled."""
        for name in entry.extensions():
            if name not in handled:
                self.add(f"the extension {name} is not supported and was ignored", entry.place)

    def lines(self) -> list[str]:
        """One line for each remark, in the order of their first occurrence."""
        result = []
        for remark, places in self._places.items():
            more = len(places) - NAMES_SHOWN
            result.append(f"{remark}: {', '.join(islice(places, NAMES_SHOWN))}" + (f" and {more} more" * (more > 0)))
        return result
