"""Where the window's parts are: the picture, the panels beside it, and the status line below. Needs no window."""

from __future__ import annotations

from dataclasses import dataclass

PANEL_WIDTH = 340.0  # in window coordinates, at a scale of 1
STATUS_HEIGHT = 26.0  # the same
LARGEST_SHARE = 0.45  # of the window's width that panels take, and of its height that the status line takes
NARROWEST = 120.0


@dataclass(frozen=True)
class Area:
    """A rectangle, in window coordinates or in pixels."""

    x: int
    y: int
    width: int
    height: int

    def share(self, cursor: tuple[float, float]) -> tuple[float, float]:
        """Where the cursor is, from (0, 0) at the top left corner to (1, 1)."""
        return (cursor[0] - self.x) / max(self.width, 1), (cursor[1] - self.y) / max(self.height, 1)

    def holds(self, cursor: tuple[float, float]) -> bool:
        """Whether the cursor is in it."""
        x, y = self.share(cursor)
        return 0 <= x < 1 and 0 <= y < 1

    def scaled(self, size: tuple[int, int], pixels: tuple[int, int]) -> Area:
        """The same part of a window in pixels, if this one is in window coordinates and the window has these sizes."""

        # Both edges are rounded, not the width: areas that touch in window coordinates touch in pixels too.
        def to_pixels(place: int, axis: int) -> int:
            return round(place * pixels[axis] / max(size[axis], 1))

        left, right = to_pixels(self.x, 0), to_pixels(self.x + self.width, 0)
        top, bottom = to_pixels(self.y, 1), to_pixels(self.y + self.height, 1)
        return Area(left, top, max(right - left, min(1, pixels[0])), max(bottom - top, min(1, pixels[1])))


@dataclass(frozen=True)
class Layout:
    """The parts of a window, in window coordinates. Without panels the picture fills the window."""

    picture: Area
    panels: Area | None = None
    status: Area | None = None

    @classmethod
    def of(cls, size: tuple[int, int], *, panels: bool, scale: float = 1.0, width: float = PANEL_WIDTH) -> Layout:
        """For a window of this width and height. scale: of texts. width: of the panels, at a scale of 1."""
        if not panels or 0 in size:
            return cls(Area(0, 0, *size))
        # A narrow window leaves at least half of itself to the picture.
        side = int(min(max(width, NARROWEST) * scale, LARGEST_SHARE * size[0]))
        foot = int(min(STATUS_HEIGHT * scale, LARGEST_SHARE * size[1]))
        picture = Area(0, 0, size[0] - side, size[1] - foot)
        return cls(picture, Area(picture.width, 0, side, size[1] - foot), Area(0, picture.height, size[0], foot))
