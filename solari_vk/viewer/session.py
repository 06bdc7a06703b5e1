"""What the parts of a viewer share: the scene, the window, the camera, the pictures, and what the user switched on."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from solari_vk.scene.model import Camera
from solari_vk.viewer.camera_control import CameraControl
from solari_vk.viewer.messages import Messages
from solari_vk.viewer.picking import Pick
from solari_vk.viewer.pictures import Pictures
from solari_vk.viewer.player import Player
from solari_vk.viewer.reload import Sources
from solari_vk.viewer.scaling import ScaleControl
from solari_vk.viewer.window import Window


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
        self.window, self.pictures, self.camera_control, self.scale = window, pictures, camera_control, scale
        self.device, self.scene, self.settings = pictures.device, pictures.scene, pictures.settings
        self.source, self.source_options, self.folder = source, source_options, folder
        self.player = Player(self.scene)
        self.pick: Pick | None = None
        """The instance and the point that the user picked."""
        self.edits: dict[tuple[Any, str], None] = {}
        """The objects and the names of their fields that the user edited in the panels, in the order of first edits."""
        self.has_panels = self.shows_panels = self.shows_help = False
        self.timings: dict[str, float] = {}
        """GPU milliseconds of each pass in the last finished frame."""
        self.spans: deque[float] = deque(maxlen=20)
        """The seconds from frame to frame, for the latest frames."""
        self.shader_users: dict[str, Callable[[], object]] = {"shaders": pictures.reload}
        """The functions to call when shaders change, by the places of their errors in `faults`."""
        self._sources = sources

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
        """Reload the shaders and the scene's file if they changed on disk."""
        shaders, file = self._sources.changed()
        if shaders or file:
            self.reload(shaders=shaders, file=file)

    def reload(self, *, shaders: bool, file: bool) -> None:
        """Reload shaders, the scene's file or both. What has an error is reported and stays as it was."""
        loads = {**(self.shader_users if shaders else {}), **({"file": self._load_file} if file else {})}
        done = [self._reload(place, load) for place, load in loads.items()]
        self.scale.unsettle()
        if all(done):
            self.say("shaders are reloaded" if shaders and not file else "reloaded")

    def _reload(self, place: str, load: Callable[[], object]) -> bool:
        self.faults.pop(place, None)  # a fault that is still there is reported again
        with self.showing_mistakes(place):
            load()
        return place not in self.faults

    def _load_file(self) -> None:
        if self._sources.load_again():
            self.pick = None
            self.edits.clear()
            if self.player.posed:
                self.player.show(self.player.seconds)
