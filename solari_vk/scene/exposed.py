"""How bright a camera's pictures are."""

from __future__ import annotations

from typing import Any

from solari_vk.scene import checks


class Unset(float):
    """A number that nobody chose. Copies of a camera keep it; any assignment replaces it."""


def checked_ev100(value: Any) -> float:
    """A finite number from -100 to 100, still `Unset` if it was."""
    number: Any = checks.number(-100, 100)(value)
    return value if isinstance(value, Unset) else float(number)


def exposure_of(ev100: float) -> float:
    """`Camera.exposure`."""
    return float(1.0 / (1.2 * 2.0**ev100))


class Exposed:
    """The part of `Camera` that exposes."""

    ev100: float

    @property
    def has_exposure(self) -> bool:
        """Whether ev100 was set: by the constructor, an assignment, a file, or a picture with auto_exposure."""
        return not isinstance(self.ev100, Unset)

    @property
    def exposure(self) -> float:
        """The factor by which pictures multiply radiance."""
        return exposure_of(self.ev100)
