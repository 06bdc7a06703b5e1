"""What a loader could not use of a file: one line for each kind of problem, with the places."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import islice

from solari_vk.base import budget
from solari_vk.base.errors import SolariError
from solari_vk.scene.files.gltf.values import Entry, WholeFileError

NAMES_SHOWN = 3
_BYTES_PER_FAULT = 2048


class Report:
    """Collects remarks. The same remark about many objects is one line.

    file: the words for it in errors. strict: whether a part that is wrong is an error.
    """

    def __init__(self, file: str, strict: bool) -> None:
        self._file = file
        self._strict = strict
        self._places: dict[str, dict[str, None]] = {}
        self.first_error: SolariError | None = None
        """The first one that cost a part of the file."""

    def add(self, remark: str, place: str) -> None:
        """Add a remark about the object at a place."""
        self._places.setdefault(remark, {})[place] = None

    @contextmanager
    def costs(self, remark: str) -> Iterator[None]:
        """Errors within this context cost what the remark names, see `lost`."""
        try:
            yield
        except SolariError as error:
            self.lost(remark, error)

    def lost(self, remark: str, error: SolariError) -> None:
        """Add a remark about the part of the file that an error costs.

        Raises the error if `strict`, and if it concerns the whole file or what loading may take.
        """
        if self._strict or isinstance(error, (budget.BudgetError, WholeFileError)):
            raise error
        # A damaged file may have a fault in each of a million parts.
        budget.charge(_BYTES_PER_FAULT, self._file, "the list of what is wrong in it")
        self.first_error = self.first_error or error
        # All lines are about this file.
        self.add(remark, str(error).removeprefix(f"{self._file}: "))

    def add_extensions(self, entry: Entry, handled: Iterable[str] = ()) -> None:
        """Add a remark about each extension of an object that isn't handled."""
        for name in entry.extensions():
            if name not in handled:
                self.add(f"the extension {name} is not supported and was ignored", entry.place)

    def lines(self) -> list[str]:
        """One line for each remark, in the order of their first occurrence."""
        result = []
        for remark, places in self._places.items():
            line = f"{remark}: {', '.join(islice(places, NAMES_SHOWN))}"
            more = len(places) - NAMES_SHOWN
            result.append(f"{line} and {more} more" if more > 0 else line)
        return result
