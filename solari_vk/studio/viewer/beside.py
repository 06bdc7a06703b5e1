"""A second scene beside the first one, seen by the same camera: what is different, and how much."""

from __future__ import annotations

import math

from solari_vk.gpu.device.device import Device
from solari_vk.output.compare import compare
from solari_vk.output.error import area_means
from solari_vk.scene.model import Camera, Scene
from solari_vk.studio.viewer.pictures import Pictures
from solari_vk.studio.viewer.presenter import Part


class Beside:
    """The pictures of a second scene, which follow those of the first one in everything but the scene.

    name: of the scene, for the user. `close` frees everything.
    """

    def __init__(self, device: Device, scene: Scene, first: Pictures, name: str) -> None:
        self.name, self.first = name, first
        self.pictures = Pictures(device, scene, first.settings, first.seed, first.mode)

    @property
    def shown(self) -> bool:
        """Whether the second scene is shown: not in the mode "split", which has other pictures side by side."""
        return self.first.mode != "split"

    def render(self, camera: Camera, pixels: tuple[int, int], scale: float) -> None:
        """Submit the next frame; arguments and errors are those of `Pictures.render`."""
        if self.shown:
            first, second = self.first, self.pictures
            second.mode, second.view, second.tonemap = first.mode, first.view, first.tonemap
            second.most_samples, second.most_bands = first.most_samples, first.most_bands
            second.sample_limit, second.interrupted = first.sample_limit, first.interrupted
            second.render(camera, pixels, scale)

    def begin(self) -> None:
        """Let both path tracers begin anew, so that in the end they have as many samples."""
        for pictures in (self.first, self.pictures):
            if pictures.reference is not None:
                pictures.reference.tracer.reset()

    @property
    def ready(self) -> bool:
        """Whether both scenes have pictures to show."""
        return self.shown and self.first.ready and self.pictures.ready

    def columns(self, name: str) -> dict[str, tuple[float, float]]:
        """The names of both scenes, of which the first one's is given, and where their pictures begin and end."""
        other = self.name if self.name != name else f"{self.name} (2)"
        return {name: (0.0, self.first.divider), other: (self.first.divider, 1.0)}

    def parts(self) -> list[Part]:
        """The parts of images that make up the window's picture; call it when `ready`."""
        (left,), (right,) = self.first.parts(), self.pictures.parts()
        at = round(self.first.divider * left.image.width) / left.image.width
        return [Part(left.image, 0.0, at), Part(right.image, at, 1.0)]

    def pictures_at(self, x: float) -> Pictures:
        """The pictures of the scene that is seen at this share of the width."""
        return self.pictures if self.ready and x >= self.first.divider else self.first

    def expose(self, camera: Camera) -> None:
        """As `Pictures.expose`."""
        if self.shown:
            self.pictures.tonemap = self.first.tonemap
            self.pictures.expose(camera)

    def difference(self, exposure: float) -> dict[str, float]:
        """How far the second scene's radiance is from the first one's: `compare` at a camera's exposure, FLIP if
        flip-evaluator is installed. Empty before there are both."""
        if not self.ready:
            return {}
        first = self.first.radiance()
        second = area_means(self.pictures.radiance(), (first.shape[1], first.shape[0]))
        apart = compare(second, first, exposure=exposure)
        return {"relMSE": apart.relative_mse} | ({} if math.isnan(apart.flip) else {"FLIP": apart.flip})

    def close(self) -> None:
        """Free everything once the submitted work is done. Safe to call twice."""
        self.pictures.close()
