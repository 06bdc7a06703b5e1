"""The next frame of a session's pictures: small while something moves, at the window's full size while it rests."""

from __future__ import annotations

import time
from collections.abc import Hashable
from typing import Any

from solari_vk.gpu.frame.in_parts import Interrupted
from solari_vk.settings import FIELDS
from solari_vk.studio.viewer.held import Held
from solari_vk.studio.viewer.presenter import Part, pixels_of
from solari_vk.studio.viewer.refining import FRAMES
from solari_vk.studio.viewer.session import Session


class Rendering:
    """Renders the pictures of a session. `close` frees what it made."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._held = Held(session.device)
        self._gave_up = False  # the latest frame
        self._torn = False  # the pictures' images, from a frame that was given up until the next whole one
        self._shown_by: tuple[float, str] | None = None  # the exposure and tone mapping of the latest picture

    def parts(self) -> list[Part]:
        """What the window shows: the latest picture, or the one before while that still looks better."""
        return (self._held.parts if self._torn or self._session.refining.hides else []) or self._session.parts()

    def render(self, pixels: tuple[int, int]) -> None:
        """Submit the next frame for a picture of this width and height, unless it is finished.

        Raises SolariError for an error in the scene or in a shader.
        """
        if self._gave_up:  # for an input, whose effect on the window is shown before another frame takes its time
            self._gave_up = False
            return
        session = self._session
        refining, pictures = session.refining, session.pictures
        refining.enabled = session.scale.auto
        refining.note_view(self._view(pixels))
        if not refining.hides and not self._torn:
            self._held.drop()
        if refining.finished:
            self._show_finished()
            return
        if refining.begins:
            if not (self._torn and self._held.parts) and (parts := session.parts()):
                self._held.keep(pixels_of(parts))
            if session.beside is not None:
                session.beside.begin()
        pictures.most_bands = refining.bands if refining.rests and pictures.mode == "reference" else None
        pictures.sample_limit = refining.samples if refining.rests else 0
        pictures.keeps_realtime = pictures.mode == "split" and refining.steps >= FRAMES
        began = time.perf_counter()
        software = session.device.properties.kind == "cpu"
        pictures.interrupted = session.window.has_input if software and refining.rests else None
        try:
            self._submit(pixels, 1.0 if refining.rests else session.scale.scale)
        except Interrupted:
            refining.restart()
            self._gave_up = self._torn = True
            return
        if refining.rests:
            session.device.wait_idle()  # so that steps take as long as they seem to
        refining.note(time.perf_counter() - began, self._count(), pictures.mode != "realtime")
        self._shown_by = self._tone

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
            return session.refining.count + 1
        shown = [session.pictures, *([session.beside.pictures] if session.beside and session.beside.shown else [])]
        return min(pictures.reference.mean_samples for pictures in shown if pictures.reference is not None)

    def is_current(self, pixels: tuple[int, int]) -> bool:
        """Whether the latest picture shows the scene as it is now, in all its pixels."""
        whole = self._session.pictures.whole and not self._torn
        return whole and self._session.refining.shows(self._view(pixels))

    def _view(self, pixels: tuple[int, int]) -> Hashable:
        return pixels, self._session.load_count, self._setting_values(), self._seen()

    @property
    def _tone(self) -> tuple[float, str]:
        return self._session.camera.ev100, self._session.pictures.tonemap

    def _setting_values(self) -> tuple[Any, ...]:
        """The settings but for the one that follows the scale."""
        return tuple(getattr(self._session.settings, name) for name in FIELDS if name != "upscale")

    def _seen(self) -> tuple[Hashable, ...]:
        """What the scenes hold and how they are seen."""
        session = self._session
        scenes = [session.pictures, *([session.beside.pictures] if session.beside is not None else [])]
        for pictures in scenes:
            pictures.binder.update()
        return tuple(pictures.view_key(session.camera) for pictures in scenes)

    def _show_finished(self) -> None:
        """Show the finished picture with another exposure or tone mapping, if that was changed."""
        session = self._session
        if self._shown_by == self._tone:
            return
        self._shown_by = self._tone
        if session.pictures.mode != "reference":
            session.pictures.interrupted = None  # a single frame, which nothing would submit again
            self._submit(session.pictures.size, 1.0)
        if session.pictures.mode != "realtime":
            session.pictures.expose(session.camera)
            if session.beside is not None:
                session.beside.expose(session.camera)

    def close(self) -> None:
        """Free everything once the submitted work is done. Safe to call twice."""
        self._held.drop()
