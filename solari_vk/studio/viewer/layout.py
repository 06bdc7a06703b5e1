"""Where the window's parts are: the picture, the panels beside it, and the status line below. Needs no window."""

from __future__ import annotations

from dataclasses import dataclass

PANEL_WIDTH, STATUS_HEIGHT = 340.0, 26.0  # at a scale of 1
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
        ends = [
            (round(start * to / max(of, 1)), round((start + length) * to / max(of, 1)))
            for start, length, of, to in (
                (self.x, self.width, size[0], pixels[0]),
                (self.y, self.height, size[1], pixels[1]),
            )
        ]
        (left, right), (top, bottom) = ends
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
        side = int(min(max(width, NARROWEST) * scale, LARGEST_SHARE * size[0]))
        foot = int(min(STATUS_HEIGHT * scale, LARGEST_SHARE * size[1]))
        picture = Area(0, 0, size[0] - side, size[1] - foot)
        return cls(picture, Area(picture.width, 0, side, size[1] - foot), Area(0, picture.height, size[0], foot))
