"""What the parts of a viewer share: the scene, the window, the camera, the pictures, and what the user switched on."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol
from weakref import WeakSet

from solari_vk.scene.model import Camera, Instance, Scene
from solari_vk.scene.observable import Checked
from solari_vk.settings import Settings
from solari_vk.studio.viewer.camera_control import CameraControl
from solari_vk.studio.viewer.comparison import SecondScene
from solari_vk.studio.viewer.history import History
from solari_vk.studio.viewer.layout import Area, Layout
from solari_vk.studio.viewer.messages import Messages
from solari_vk.studio.viewer.picking import Pick
from solari_vk.studio.viewer.pictures import Pictures
from solari_vk.studio.viewer.player import Player
from solari_vk.studio.viewer.presenter import Part
from solari_vk.studio.viewer.refinement import Refinement
from solari_vk.studio.viewer.reload import Sources
from solari_vk.studio.viewer.scaling import ScaleControl
from solari_vk.studio.viewer.window import Event, Window

GIZMOS = ("none", "move", "turn", "scale")


@dataclass(frozen=True)
class Question:
    """A question to the user, and the actions that answer it: their words, and what each does."""

    text: str
    answers: dict[str, Callable[[], object]]


class Gesture(Protocol):
    """What keys begin, such as moving what is picked; until it ends it takes the keys and the buttons."""

    @property
    def text(self) -> str:
        """What it does, for the status line."""

    @property
    def keys(self) -> str:
        """What keys and buttons do meanwhile."""

    def handle(self, event: Event) -> None: ...
    def cancel(self) -> None: ...


class Session(Messages):
    """The state of a viewer, which keys, panels and screenshots read and change.

    source, source_options, folder: as in `Viewer`.
    """

    def __init__(
        self,
        window: Window,
        pictures: Pictures,
        camera_control: CameraControl,
        scale: ScaleControl,
        sources: Sources,
        *,
        source: str | None,
        source_options: Sequence[str],
        folder: Path,
    ) -> None:
        super().__init__()
        self.window = window
        self.pictures = pictures
        self.camera_control = camera_control
        self.scale = scale
        self.device = pictures.device
        self.scene = pictures.scene
        self.settings = pictures.settings
        self.source = source
        self.source_options = source_options
        self.folder = folder
        self.player = Player(self.scene)
        self.pick: Pick | None = None
        """The instance and the point that the user clicked on last."""
        self._selected: Checked | None = None
        self._others: list[Checked] = []
        # Weak, so that the locks of a scene that was replaced go with its objects.
        self.locked = WeakSet[Checked]()
        """Objects that clicks don't pick and that nothing edits."""
        self.history = History()
        """All edits of the scene and the settings."""
        self.refinement = Refinement()
        self.question: Question | None = None
        """What the user is asked before something else happens."""
        self.gesture: Gesture | None = None
        """What the user is about to do, None for nothing."""
        self.gizmo = GIZMOS[0]
        self.gizmo_is_local = False
        """What dragging the picked object does, and whether along its own axes."""
        self.opens_add_menu = False
        """Whether the panels are to open the menu of what can be added."""
        self.texture_field = "base_color_texture"
        """The field of a material on which a picture from a file is put."""
        self.cursor = (0.0, 0.0)
        """Where the mouse is, in window coordinates."""
        self.beside: SecondScene | None = None
        """The second scene that is shown beside this one."""
        self.is_rendering = False
        """Whether a frame is being rendered: what waits for the device would wait for all of it."""
        self.has_panels = self.shows_panels = self.shows_help = False
        self.timings: dict[str, float] = {}
        """GPU milliseconds of each pass in the last finished frame."""
        self.spans: deque[float] = deque(maxlen=20)
        """The seconds from frame to frame, for the latest frames."""
        self.shader_users: dict[str, Callable[[], object]] = {"shaders": pictures.reload}
        """The functions to call when shaders change, by the places of their errors in `faults`."""
        self.sources = sources
        self.save_path: Path | None = None
        """Where the scene was saved last."""
        self.map_folder: Path | None = None
        """Where pictures of all directions are, None until the user gave one."""
        self.load_count = 0
        """How often shaders or the scene were loaded again."""

    @property
    def selected(self) -> Checked | None:
        """The instance, light or camera that is picked, None without one. May be assigned."""
        return self._selected if self._is_there(self._selected) else None

    @selected.setter
    def selected(self, item: Checked | None) -> None:
        self._selected = item
        self._others = []
        if not isinstance(item, Instance) or (self.pick is not None and self.pick.instance is not item):
            self.pick = None

    @property
    def picked(self) -> list[Checked]:
        """All that is picked: `selected` is the last, whose fields the panels show."""
        # Undoing and scripts remove objects without asking what is picked.
        found = [item for item in self._others if self._is_there(item)]
        if self.selected is not None:
            found.append(self.selected)
        return found

    def _is_there(self, item: Checked | None) -> bool:
        return item in self.scene.instances or item in self.scene.lights or item in self.scene.cameras

    def pick_also(self, item: Checked) -> None:
        """Add an object to what is picked, or take it out if it is picked."""
        before = self.picked
        picked = [other for other in before if other is not item]
        if len(picked) == len(before):
            picked.append(item)
        self.pick_only(picked)

    def pick_only(self, items: Iterable[Checked]) -> None:
        """Pick these objects and no others; the last one is `selected`."""
        picked = list(items)
        self.selected = picked[-1] if picked else None
        self._others = picked[:-1]

    @property
    def layout(self) -> Layout:
        """Where the picture and the panels are in the window."""
        return Layout.of(self.window.size, panels=self.has_panels and self.shows_panels, scale=self.window.text_scale)

    @property
    def picture_area(self) -> Area:
        """Where the picture is in the window, in pixels."""
        return self.layout.picture.scaled(self.window.size, self.window.pixels)

    def parts(self) -> list[Part]:
        """The parts of images that make up the latest picture; an empty list before there is one."""
        return self.beside.parts() if self.beside is not None and self.beside.ready else self.pictures.parts()

    def columns(self) -> dict[str, tuple[float, float]]:
        """The names of the pictures side by side, and where each begins and ends, as shares of the width."""
        if self.beside is not None and self.beside.shown:
            return self.beside.columns(self.name)
        return self.pictures.columns()

    def pictures_at(self, x: float) -> Pictures:
        """The pictures of the scene that is seen at this share of the picture's width."""
        return self.pictures if self.beside is None else self.beside.pictures_at(x)

    def edit(self, item: Checked | Settings, **fields: Any) -> None:
        """Assign values to fields, so that it can be undone. A value that is refused is shown as a message."""
        if isinstance(item, Checked) and item in self.locked:
            self.say(f"{item.describe()} is locked")
            return
        with self.showing_mistakes():
            self.history.assign(item, **fields)

    def edit_all(self, text: str, values: Iterable[tuple[Checked, dict[str, Any]]]) -> None:
        """Assign fields of several objects, but for locked ones, as one edit that has this text."""
        with self.showing_mistakes():
            self.history.assign_all(text, [(item, fields) for item, fields in values if item not in self.locked])

    @property
    def camera(self) -> Camera:
        """The camera that the user moves."""
        return self.camera_control.camera

    @property
    def name(self) -> str:
        """The name of the file or the scene, "" without one."""
        return Path(self.source).name if self.source else self.scene.name

    @property
    def fps(self) -> float:
        """The mean number of frames per second over the latest frames, 0 before the first."""
        return len(self.spans) / sum(self.spans) if self.spans else 0.0

    # ---- reloading ----------------------------------------------------------------------------------

    def reload_changed(self) -> None:
        """Reload the shaders and the scene's file if they changed on disk. Edits that aren't saved keep the file."""
        shaders, file = self.sources.changed()
        # Nobody loses edits because another program writes the file.
        if file and self.history.unsaved:
            self.say(f"{self.name} has changed on disk: F5 loads it again, without your edits")
            file = False
        if shaders or file:
            self.reload(shaders=shaders, file=file)

    def reload(self, *, shaders: bool, file: bool) -> None:
        """Reload shaders, the scene's file or both. What has an error is reported and stays as it was."""
        self.load_count += 1
        loads: dict[str, Callable[[], object]] = {}
        if shaders:
            loads |= self.shader_users
        if file:
            loads["file"] = self._load_file
        # All of them, although one may fail: an error in a shader doesn't keep the file from being read.
        done = [self._reload(place, load) for place, load in loads.items()]
        # Other shaders, or another scene, take another time.
        self.scale.forget_times()
        if all(done):
            self.say("shaders are reloaded" if shaders and not file else "reloaded")

    @property
    def has_file(self) -> bool:
        """Whether the scene comes from a file that can be loaded again."""
        return self.sources.load is not None

    def replace_scene(self, loaded: Scene, file: Path, load: Callable[[], Scene]) -> None:
        """Show what another scene holds, of a file that is loaded again when it changes. Forgets the edits."""
        self.sources.replace(loaded, file, load)
        self._forget()
        self.player = Player(self.scene)
        self.source = str(file)
        self.source_options = ()
        self.save_path = None
        self.load_count += 1

    def _forget(self) -> None:
        self.selected = self.pick = self.question = self.gesture = None
        self.history.clear()

    def _reload(self, place: str, load: Callable[[], object]) -> bool:
        self.faults.pop(place, None)  # a fault that is still there is reported again
        with self.showing_mistakes(place):
            load()
        return place not in self.faults

    def _load_file(self) -> None:
        if self.sources.load_again():
            self._forget()
            if self.player.posed:
                self.player.show(self.player.seconds)
