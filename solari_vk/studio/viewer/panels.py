"""The panels: files, the scene, the picture's options, times, and every setting."""

from __future__ import annotations

import math
import time
from itertools import groupby
from typing import Any

import numpy as np
from imgui_bundle import imgui

from solari_vk.output.tone_mapping import TONEMAPS
from solari_vk.settings import DEFAULTS, FIELDS, QUALITIES
from solari_vk.studio.viewer.actions import SIDES, act
from solari_vk.studio.viewer.comparison import errors
from solari_vk.studio.viewer.environment_panel import EnvironmentPanel
from solari_vk.studio.viewer.file_panel import FilePanel
from solari_vk.studio.viewer.material_panel import Show
from solari_vk.studio.viewer.object_panel import ObjectPanel
from solari_vk.studio.viewer.outliner import Outliner
from solari_vk.studio.viewer.pictures import MODES
from solari_vk.studio.viewer.scaling import MIN_SCALE
from solari_vk.studio.viewer.session import Session
from solari_vk.studio.viewer.widgets import choose, edit_on_enter, hint

HISTORY = 120  # frames in a plot
FIGURES_INTERVAL = 0.5  # seconds between two updates of the figures that need a wait for the device
OPEN = imgui.TreeNodeFlags_.default_open


class Panels:
    """Lays out the content of the panels' window. show: gives ImGui a texture, as `OverlayRenderer.show` does."""

    def __init__(self, session: Session, show: Show) -> None:
        self._session = session
        self._files = FilePanel(session)
        self._outliner = Outliner(session)
        self._object = ObjectPanel(session, show)
        self._environment = EnvironmentPanel(session)
        self._times: dict[str, Any] = {}  # the latest milliseconds of each pass
        self._figures: list[str] = []
        self._figures_at = 0.0
        self._rays = (0.0, 0)  # when rays were counted last, and how many there were

    def lay_out(self) -> None:
        """Lay out everything, from top to bottom."""
        self._files.lay_out()
        if imgui.collapsing_header("Scene", OPEN):
            self._outliner.lay_out()
        self._outliner.add_menu()
        if self._session.selected is not None and imgui.collapsing_header("Picked", OPEN):
            self._object.lay_out()
        if imgui.collapsing_header("Surroundings"):
            self._environment.lay_out()
        if imgui.collapsing_header("Picture", OPEN):
            self._picture()
        if self._session.player.clip is not None and imgui.collapsing_header("Animation", OPEN):
            self._animation()
        self._append_times()  # also while the header is closed, so that it opens with a full plot
        if imgui.collapsing_header("Time"):
            self._time()
        if imgui.collapsing_header("Settings"):
            self._settings()

    # ---- picture ------------------------------------------------------------------------------------

    def _picture(self) -> None:
        session = self._session
        pictures = self._session.pictures
        pictures.mode = choose("mode", pictures.mode, MODES)
        known = pictures.known_views
        pictures.view = choose("view", pictures.view, tuple(known))
        limited = ", of realtime pictures alone" if pictures.mode == "reference" else ""
        hint(known.get(pictures.view, "") + limited)
        pictures.tonemap = choose("tone mapping", pictures.tonemap, TONEMAPS)
        camera = session.camera
        changed, value = imgui.slider_float("EV100", camera.ev100, -10, 20)
        if changed:
            with session.showing_mistakes():
                camera.ev100 = value
        changed, degrees = imgui.slider_float("field of view", math.degrees(camera.vertical_fov), 5, 120, "%.0f deg")
        if changed and 0.1 < degrees < 179:
            camera.vertical_fov = math.radians(degrees)
        # The slider shows the scale that "auto" has chosen; moving it fixes the scale.
        scale = session.scale
        _, scale.auto = imgui.checkbox("auto", scale.auto)
        hint("Render fewer pixels while something moves, so that it moves smoothly; at rest all of them.")
        imgui.same_line()
        changed, value = imgui.slider_float("scale", scale.scale, MIN_SCALE, 1.0)
        if changed:
            scale.fix(value)
        (width, height), (rendered_width, rendered_height) = pictures.size, pictures.rendered_size
        imgui.text(f"{width} x {height} from {rendered_width} x {rendered_height}")
        imgui.text(f"{session.fps:.1f} frames/s, speed {session.camera_control.speed:.3g} m/s")
        refinement = session.refinement
        if pictures.mode != "realtime":
            imgui.set_next_item_width(7 * imgui.get_font_size())
            refinement.samples = max(edit_on_enter("samples", refinement.samples, imgui.input_int), 0)
            hint("Samples per pixel after which the path tracer's picture is finished; 0: never.")
        self._update_figures()
        for text in self._figures:
            imgui.text_wrapped(text)
        for label, action in (("screenshot", "screenshot"), ("reset camera", "reset"), ("keys", "help")):
            if imgui.button(label):
                act(session, action)
            imgui.same_line()
        imgui.new_line()
        self._sides()

    def _sides(self) -> None:
        """Buttons for what the number pad does."""
        session = self._session
        for number, side in enumerate(SIDES):
            if number:
                imgui.same_line()
            if imgui.small_button(side):
                act(session, "look_from", side)
            hint(f"Look from the {side} (number pad 1, 3, 7, with Ctrl from the other side; or Alt and the digit).")
        changed, _ = imgui.checkbox("orthographic", session.camera.orthographic_height > 0)
        hint("Without perspective (number pad 5, or Alt+5).")
        if changed:
            act(session, "orthographic")

    def _update_figures(self) -> None:
        """Read the figures that need a wait for the device, from time to time."""
        now = time.perf_counter()
        if now - self._figures_at < FIGURES_INTERVAL or self._session.is_rendering:
            return
        self._figures_at = now
        pictures = self._session.pictures
        self._figures = []
        if pictures.ready:
            self._figures = [*self._errors(), *self._samples(), *self._ray_rate(now), *self._cache_use()]

    def _errors(self) -> list[str]:
        """How far pictures side by side are from each other."""
        found = [
            f"{name}: error {100 * error:.1f} %, mean radiance {100 * mean:+.1f} %"
            for name, (error, mean) in errors(self._session.pictures).items()
        ]
        if self._session.beside is not None:
            difference = self._session.beside.difference(self._session.camera.exposure)
            found += [f"{name}: {value:.4g}" for name, value in difference.items()]
        return found

    def _samples(self) -> list[str]:
        pictures = self._session.pictures
        if pictures.reference is None or pictures.mode == "realtime":
            return []
        return [f"reference: {pictures.reference.tracer.samples} samples a pixel"]

    def _ray_rate(self, now: float) -> list[str]:
        """The rays since the latest look; nothing if they weren't counted, or if a counter began again."""
        count = self._session.pictures.ray_count()
        seconds_before, count_before = self._rays
        self._rays = (now, count)
        if count <= count_before or not seconds_before:
            return []
        return [f"{(count - count_before) / (now - seconds_before) / 1e6:.2f} million rays/s"]

    def _cache_use(self) -> list[str]:
        pictures = self._session.pictures
        if pictures.realtime is None or not pictures.realtime.has_frame or pictures.mode == "reference":
            return []
        cells = int(pictures.realtime["world_cache/active_cells"])
        failures = int(pictures.realtime["world_cache/insert_failures"])
        found = [f"world cache: {100 * cells / self._session.settings.world_cache_cells:.1f} % full"]
        if failures:
            found.append(f"no room for the light of {failures:,} places: raise world_cache_cells in Settings")
        return found

    # ---- animation ----------------------------------------------------------------------------------

    def _animation(self) -> None:
        """Choose a clip, play and pause, and scrub through its time."""
        session = self._session
        player = self._session.player
        assert player.clip is not None
        names = [clip.name or f"clip {number}" for number, clip in enumerate(session.scene.animations)]
        chosen, number = imgui.combo("clip", player.number, names)
        if imgui.button("pause" if player.playing else "play"):
            act(session, "play")
        imgui.same_line()
        scrubbed, seconds = imgui.slider_float("seconds", player.seconds, 0.0, max(player.clip.duration, 1e-3), "%.2f")
        with session.showing_mistakes():
            if chosen:
                player.choose(number)
            elif scrubbed:
                player.show(seconds)

    # ---- time ---------------------------------------------------------------------------------------

    def _append_times(self) -> None:
        timings = self._session.timings
        for name, milliseconds in {"all passes": sum(timings.values()), **timings}.items():
            history = self._times.setdefault(name, np.zeros(HISTORY, np.float32))
            history[:-1] = history[1:]
            history[-1] = milliseconds
        # Other settings have other passes.
        for name in self._times.keys() - timings.keys() - {"all passes"}:
            del self._times[name]

    def _time(self) -> None:
        pictures = self._session.pictures
        _, pictures.counts_rays = imgui.checkbox("count rays", pictures.counts_rays)
        hint("Show how many rays the realtime renderer traces per second. Counting makes it a little slower.")
        if not self._session.timings:
            imgui.text("this device has no timestamps")
            return
        if imgui.begin_table("times", 3, imgui.TableFlags_.row_bg):
            for title, share in (("pass", 2), ("ms", 0.7), ("history", 1.3)):
                imgui.table_setup_column(title, imgui.TableColumnFlags_.width_stretch, share)
            imgui.table_headers_row()
            for name, history in self._times.items():
                imgui.table_next_column()
                imgui.text_unformatted(name)
                imgui.table_next_column()
                imgui.text(f"{history[-1]:.2f}")
                imgui.table_next_column()
                size = imgui.ImVec2(-1, imgui.get_text_line_height())
                imgui.plot_lines(f"##{name}", history, scale_min=0.0, graph_size=size)
            imgui.end_table()

    # ---- settings -----------------------------------------------------------------------------------

    def _settings(self) -> None:
        settings = self._session.settings
        for quality in QUALITIES:
            if imgui.button(quality):
                values = {**DEFAULTS, **QUALITIES[quality]}
                # Only what differs, so that undoing it gives the user's own values back.
                changed = {name: values[name] for name in FIELDS if values[name] != getattr(settings, name)}
                with self._session.showing_mistakes():
                    self._session.history.assign_each(f"the quality {quality}", settings, changed)
            hint("Change all settings to this quality's.")
            imgui.same_line()
        imgui.new_line()
        for section, names in groupby(FIELDS, key=lambda name: FIELDS[name].section):
            if imgui.tree_node(section):
                for name in names:
                    self._setting(name)
                imgui.tree_pop()

    def _setting(self, name: str) -> None:
        settings = self._session.settings
        field = FIELDS[name]
        # What is in effect: the factor of upscaling follows the scale, whatever the user's setting is.
        value: Any = self._session.pictures.upscale if name == "upscale" else getattr(settings, name)
        default = DEFAULTS[name]
        label = f"{name} *" if field.rebuilds else name
        edited: Any = value
        imgui.set_next_item_width(7 * imgui.get_font_size())
        if field.choices:
            edited = choose(label, value, field.choices)
        elif isinstance(default, bool):
            edited = imgui.checkbox(label, value)[1]
        elif isinstance(default, int):
            edited = edit_on_enter(label, value, imgui.input_int)
        else:
            edited = edit_on_enter(label, value, imgui.input_float)
        meaning = field.meaning + (" Takes a moment, because the frame is built again." if field.rebuilds else "")
        hint(f"{meaning}\nDefault: {default}")
        if value != default:
            imgui.same_line()
            if imgui.small_button(f"reset##{name}"):
                edited = default
        if edited == value:
            return
        if edited != getattr(settings, name):
            self._session.edit(settings, **{name: edited})
        else:
            # The user wants their own factor, which is assigned already, instead of the scale's.
            self._session.pictures.prefer_users_upscale()
            if self._session.beside is not None:
                self._session.beside.pictures.prefer_users_upscale()
