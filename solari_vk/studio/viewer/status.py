"""What the status line and the window's title say."""

from __future__ import annotations

import time
from collections.abc import Callable

from solari_vk.studio.viewer.picking import radiance_at
from solari_vk.studio.viewer.refinement import in_words
from solari_vk.studio.viewer.session import Session

PROBE_INTERVAL = 0.25  # seconds between two looks at the pixel under the cursor, each of which waits for the picture


def state_in_words(session: Session, *, brief: bool = False) -> str:
    """The mode, the view, the size that is rendered, the rate, and the progress; brief: the mode and the last one.
    While keys or the mouse do something, what that is."""
    if session.gesture is not None:
        return session.gesture.text if brief else f"{session.gesture.text}     {session.gesture.keys}"
    pictures = session.pictures
    refinement = session.refinement
    width, height = pictures.rendered_size
    parts = [pictures.mode]
    if not brief:
        if pictures.mode != "reference":
            parts.append(pictures.view)
        parts.append(f"{width}x{height}")
    progress = progress_in_words(session) if refinement.rests else f"{session.fps:.1f} fps"
    if brief and progress.endswith(" left"):
        progress, _, _ = progress.rpartition(", ")
    return " - ".join([*parts, progress])


def status_line(session: Session, probe: str, room: float, width_of: Callable[[str], float]) -> str:
    """What the status line says left of the probe's text, as much as there is room for; "" if there is none."""
    # Two spaces keep the texts apart.
    room -= width_of(f"{probe}  ") if probe else 0.0
    texts = [state_in_words(session), state_in_words(session, brief=True)]
    return next((text for text in texts if width_of(text) <= room), "" if probe else texts[-1])


def progress_in_words(session: Session) -> str:
    """How far the picture of the full size is: samples or frames, the share that is done, and the time left."""
    refinement = session.refinement
    pictures = session.pictures
    unit = "frames" if pictures.mode == "realtime" else "samples"
    count = f"{refinement.count:.4g} {unit}"
    if refinement.finished:
        return f"{count}, finished"
    # A path-traced picture without a limit has no share that is done.
    left = refinement.seconds_left
    of = f", {100 * refinement.done:.0f} %" if refinement.samples or pictures.mode == "realtime" else ""
    return count + of + (f", {in_words(left)} left" if left is not None else "")


class Probe:
    """Tells the radiance of the pixel under the cursor."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._seen: object = None
        self._looked_at = 0.0
        self.text = ""

    def update(self) -> None:
        """Look at the pixel again, if the cursor or the picture changed and the latest look is some time ago."""
        session = self._session
        now = time.perf_counter()
        area = session.layout.picture
        refinement = session.refinement
        # While the picture moves it is another one in each frame; at rest it changes with its count.
        seen = session.cursor, refinement.count if refinement.rests else now
        if seen == self._seen or now - self._looked_at < PROBE_INTERVAL:
            return
        self._seen = seen
        self._looked_at = now
        share = area.share(session.cursor)
        radiance = radiance_at(session.pictures_at(share[0]), *share) if area.holds(session.cursor) else None
        if radiance is None:
            self.text = ""
            return
        width, height = session.pictures.rendered_size
        place = f"({int(share[0] * width)}, {int(share[1] * height)})"
        self.text = f"{place}  R {radiance[0]:.4g}  G {radiance[1]:.4g}  B {radiance[2]:.4g} cd/m\N{SUPERSCRIPT TWO}"
