"""The next frame of a session's pictures: small while something moves, at the window's full size while it rests."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable
from typing import Any

from solari_vk.gpu.frame.in_parts import Interrupted
from solari_vk.settings import FIELDS
from solari_vk.studio.viewer.pictures import Pictures
from solari_vk.studio.viewer.presenter import Part, PictureCopy, pixels_of
from solari_vk.studio.viewer.refinement import FRAMES
from solari_vk.studio.viewer.session import Session

SMOOTH = 20.0  # frames per second from which the history of a renderer is short in time
SLOW = 0.25  # seconds of a frame, from which the panels are shown meanwhile


class ProgressiveRenderer:
    """Renders the pictures of a session. show_panels: is called while slow frames are rendered. `close` frees what
    it made."""

    def __init__(self, session: Session, show_panels: Callable[[], object]) -> None:
        self._session = session
        self._show_panels = show_panels
        session.pictures.meanwhile = show_panels
        self._is_slow = False  # whether the latest small frame was
        self._previous = PictureCopy(session.device)
        self._interrupted = False  # the latest frame, by an input
        self._torn = False  # the pictures' images, from an interrupted frame until the next whole one
        self._revisions: list[int] = []  # of the scenes in the latest frame
        self._changes = False  # whether they were others than in the frame before
        self._shown_by: tuple[float, str] | None = None  # the exposure and tone mapping of the latest picture

    def parts(self) -> list[Part]:
        """What the window shows: the latest picture, or the one before while that still looks better."""
        if (self._torn or self._session.refinement.hides) and self._previous.parts:
            return self._previous.parts
        return self._session.parts()

    def render(self, pixels: tuple[int, int]) -> None:
        """Submit the next frame for a picture of this width and height, unless it is finished.

        Raises SolariError for an error in the scene or in a shader.
        """
        # An input interrupted the latest frame. Its effect on the window is shown before another frame takes its time.
        if self._interrupted:
            self._interrupted = False
            return
        refinement = self._session.refinement
        refinement.enabled = self._session.scale.auto
        refinement.begin_frame(self._view(pixels))
        self._cut_after_edits()
        if not refinement.hides and not self._torn:
            self._previous.drop()
        if refinement.finished:
            self._show_finished()
            return
        if refinement.begins:
            self._begin_full_size()
        self._set_limits()
        began = time.perf_counter()
        try:
            self._submit(pixels, 1.0 if refinement.rests else self._session.scale.scale)
        except Interrupted:
            refinement.restart()
            self._interrupted = True
            self._torn = True
            return
        # The measured time decides how large the next step is, so it must include the device's work.
        if refinement.rests:
            self._session.device.wait_idle()
        else:
            self._is_slow = time.perf_counter() - began > SLOW
        refinement.end_frame(time.perf_counter() - began, self._count(), self._session.pictures.mode != "realtime")
        self._shown_by = self._tone

    def _cut_after_edits(self) -> None:
        """Drop the history once the scene doesn't change anymore, where frames are few: shadows of where things were
        stay in it for some thirty frames, while a first frame without it is close already."""
        shown = self._shown()
        revisions = [pictures.binder.scene_revision for pictures in shown]
        changes = bool(self._revisions) and revisions != self._revisions
        ended = self._changes and not changes
        self._revisions = revisions
        self._changes = changes
        if ended and self._session.fps < SMOOTH:
            for pictures in shown:
                pictures.cut()

    def _shown(self) -> list[Pictures]:
        """The pictures of the scene, and of the one beside it."""
        session = self._session
        return [session.pictures] if session.beside is None else [session.pictures, session.beside.pictures]

    def _begin_full_size(self) -> None:
        """Store what the window shows, for as long as the first frames of the full size look worse."""
        # A torn picture is never stored: the one before it still stands in for it.
        if not (self._torn and self._previous.parts):
            parts = self._session.parts()
            if parts:
                self._previous.store(pixels_of(parts))
        if self._session.beside is not None:
            self._session.beside.restart()

    def _set_limits(self) -> None:
        """Tell the pictures how much they may do in the next frame."""
        refinement = self._session.refinement
        pictures = self._session.pictures
        traces_bands = refinement.rests and pictures.mode == "reference"
        pictures.most_bands = refinement.bands if traces_bands else None
        pictures.sample_limit = refinement.samples if refinement.rests else 0
        pictures.keeps_realtime = pictures.mode == "split" and refinement.steps >= FRAMES
        # A frame of the full size takes a software device seconds, so an input interrupts it between two passes. A
        # GPU's frames are short, and a wait after each of their passes would cost more than it saves.
        software = self._session.device.properties.kind == "cpu"
        if not software:
            pictures.interrupted = None
        elif refinement.rests:
            pictures.interrupted = self._gives_way
        else:
            pictures.interrupted = self._goes_on if self._is_slow else None

    def _gives_way(self) -> bool:
        has_input = self._session.window.has_input()
        self._show_panels()
        return has_input

    def _goes_on(self) -> bool:
        # An input doesn't end a frame of a moving picture, which another input would end again.
        self._gives_way()
        return False

    def _submit(self, pixels: tuple[int, int], scale: float) -> None:
        session = self._session
        session.pictures.render(session.camera, pixels, scale)
        if session.beside is not None:
            session.beside.render(session.camera, pixels, scale)
        self._torn = False

    def _count(self) -> float:
        """The frames, or samples per pixel, of the full size: of two scenes the smaller number."""
        session = self._session
        if session.pictures.mode == "realtime":
            return session.refinement.count + 1
        shown = [session.pictures]
        if session.beside and session.beside.shown:
            shown.append(session.beside.pictures)
        return min(pictures.reference.mean_samples for pictures in shown if pictures.reference is not None)

    def is_current(self, pixels: tuple[int, int]) -> bool:
        """Whether the latest picture shows the scene as it is now, in all its pixels."""
        whole = self._session.pictures.whole and not self._torn
        return whole and self._session.refinement.shows(self._view(pixels))

    def _view(self, pixels: tuple[int, int]) -> Hashable:
        """All that the picture depends on but for exposure and tone mapping: a change begins it anew."""
        return pixels, self._session.load_count, self._setting_values(), self._scene_views()

    @property
    def _tone(self) -> tuple[float, str]:
        return self._session.camera.ev100, self._session.pictures.tonemap

    def _setting_values(self) -> tuple[Any, ...]:
        """The settings but for the one that follows the scale."""
        return tuple(getattr(self._session.settings, name) for name in FIELDS if name != "upscale")

    def _scene_views(self) -> tuple[Hashable, ...]:
        """What the scenes hold and how they are seen."""
        scenes = self._shown()
        # `view_key` has the scene's revision, which the binder raises when it finds the edits.
        for pictures in scenes:
            pictures.binder.update()
        return tuple(pictures.view_key(self._session.camera) for pictures in scenes)

    def _show_finished(self) -> None:
        """Show the finished picture with another exposure or tone mapping, if that was changed."""
        session = self._session
        if self._shown_by == self._tone:
            return
        self._shown_by = self._tone
        # The realtime renderer tone maps as a part of its frame; the path tracer's radiance is tone mapped by itself.
        if session.pictures.mode != "reference":
            session.pictures.interrupted = None  # a single frame, which nothing would submit again
            self._submit(session.pictures.size, 1.0)
        if session.pictures.mode != "realtime":
            session.pictures.expose(session.camera)
            if session.beside is not None:
                session.beside.expose(session.camera)

    def close(self) -> None:
        """Free everything once the submitted work is done. Safe to call twice."""
        self._previous.drop()
