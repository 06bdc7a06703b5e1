"""A warning of pictures that look through the backs of surfaces, which files hide unless they say otherwise."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from solari_vk.base.errors import warn
from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.device.device import Device
from solari_vk.renderers.ray_tracer import RayTracer
from solari_vk.scene.calibrated import pixel_rays
from solari_vk.scene.model import Camera, Scene

SIDE = 24  # rays along each side of a picture
FIRST_LOOKS = 8  # at pictures of other views, which are never left out
FRAMES_APART = 1000  # later looks, whose cost then doesn't show; by the clock, equal renders would have other warnings


class BackSides:
    """Looks for hidden backs in the pictures of a renderer, and warns of them once."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._has_warned = False
        # The view of the latest look: the camera's transform; its field of view, and the scene's revision.
        self._transform: Any = None
        self._view_key = 0.0, 0
        self._looks = 0
        self._frames = 0
        self._next_look = 0

    def is_due(self) -> bool:
        """Count a frame, and say whether it may be looked at."""
        self._frames += 1
        return not self._has_warned and (self._looks < FIRST_LOOKS or self._frames >= self._next_look)

    def count_and_look(self, scene: SceneBinder, camera: Camera, size: tuple[int, int]) -> None:
        """Call it in each frame, as `look`."""
        if self.is_due():
            self.look(scene, camera, size)

    def look(self, scene: Scene | SceneBinder, camera: Camera, size: tuple[int, int]) -> None:
        """Warn if more than half of a picture shows what lies behind a surface that hides its back.

        Call it after the frame was submitted: a look updates the binder, which ends what frames know of previous ones.
        """
        if self._has_warned:  # of another view of the frame
            return
        revision = scene.scene_revision if isinstance(scene, SceneBinder) else 0
        view_key = camera.vertical_fov, revision
        # Assigning a transform makes a new array, so that an unchanged one is the same object.
        if camera.transform is self._transform and view_key == self._view_key:
            return
        self._transform = camera.transform
        self._view_key = view_key
        self._looks += 1
        self._next_look = self._frames + FRAMES_APART
        instances = (scene if isinstance(scene, Scene) else scene.scene).instances
        if any(instance.visible and instance.material.hides_back for instance in instances):
            self._warn_if_most_is_hidden(scene, camera, size)

    def _warn_if_most_is_hidden(self, scene: Scene | SceneBinder, camera: Camera, size: tuple[int, int]) -> None:
        # Pixels are counted from the middle of the first one.
        x, y = ((np.arange(SIDE) + 0.5) * side / SIDE - 0.5 for side in size)
        pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        origins, directions, starts = pixel_rays(camera, pixels, size)
        with RayTracer(self._device, scene) as tracer:
            hits = tracer.trace(origins, directions, t_min=starts)
            hidden = hits.instance[(hits.instance >= 0) & ~hits.front_face & tracer.hides_back[hits.instance]]
            if len(hidden) > len(hits) / 2:
                self._has_warned = True
                instance = tracer.instances[Counter(hidden.tolist()).most_common(1)[0][0]]
                warn(
                    f"{camera.describe()} looks through the backs of surfaces in {len(hidden) / len(hits):.0%} of its "
                    f"picture, most of them of {instance.describe()}: {instance.material.describe()} has "
                    "double_sided=False, as glTF has it unless a file says otherwise; True shows both sides"
                )
