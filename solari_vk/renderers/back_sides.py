"""A warning of pictures that look through the backs of surfaces, which files hide unless they say otherwise."""

from __future__ import annotations

import time
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
SHARE_OF_TIME = 0.01  # that later looks may take


class BackSides:
    """Looks for hidden backs in the pictures of a renderer, and warns of them once."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._has_warned = False
        # What the latest look was at.
        self._transform: Any = None
        self._others = 0.0, 0
        self._looks = 0
        self._next_look = 0.0

    @property
    def rests(self) -> bool:
        """Whether no look is due."""
        return self._has_warned or (self._looks >= FIRST_LOOKS and time.monotonic() < self._next_look)

    def look(self, scene: Scene | SceneBinder, camera: Camera, size: tuple[int, int]) -> None:
        """Warn if more than half of a picture shows what lies behind a surface that hides its back.

        Call it before the renderer's own update of the binder, whose previous frame is then that of the renderer.
        """
        if self.rests:
            return
        revision = 0
        if isinstance(scene, SceneBinder):
            scene.update()  # so that edits count now
            revision = scene.scene_revision
        # A transform is another array once it is assigned.
        others = camera.vertical_fov, revision
        if camera.transform is self._transform and others == self._others:
            return
        self._transform, self._others = camera.transform, others
        self._looks += 1
        started = time.monotonic()
        instances = (scene if isinstance(scene, Scene) else scene.scene).instances
        if any(instance.visible and instance.material.hides_back for instance in instances):
            self._judge(scene, camera, size)
        ended = time.monotonic()
        self._next_look = ended + (ended - started) / SHARE_OF_TIME

    def _judge(self, scene: Scene | SceneBinder, camera: Camera, size: tuple[int, int]) -> None:
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
