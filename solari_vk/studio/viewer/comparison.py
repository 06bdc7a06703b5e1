"""How pictures differ: from the path tracer's, and from those of a second scene that the same camera sees."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.gpu.device.device import Device
from solari_vk.output.compare import compare
from solari_vk.output.error import area_means, luminance, relative_squares
from solari_vk.passes.debug_views import PICTURE
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.scene.model import Camera, Scene
from solari_vk.studio.viewer.pictures import Pictures
from solari_vk.studio.viewer.presenter import Part

# What the viewer's columns show of the realtime renderer, by their names.
RESULTS = {"raw": "raw_radiance", "denoised": "radiance", "realtime": "radiance"}
FOLLOWED = ("mode", "view", "tonemap", "most_samples", "most_bands", "sample_limit", "interrupted")
"""The fields of `Pictures` that a second scene's take from the first one's."""


def difference(picture: NDArray[Any], tracer: PathTracer) -> tuple[float, float] | None:
    """(error, relative difference of mean radiance) of a picture (height, width, 3) against the path tracer's.

    The error is the root of relMSE as output/error.py defines it; the path tracer's own noise counts until it has
    refined. A picture of another size is averaged to the path tracer's. None before the path tracer has two samples,
    and in the dark.
    """
    # Without the denoiser of the path tracer, whose errors would count as the picture's.
    reference = tracer["raw_radiance"]
    mean = float(reference.mean(dtype=np.float64))
    if tracer.samples < 2 or not mean > 0:
        return None
    resized = area_means(picture, tracer.size)
    squares = (luminance(resized) - luminance(reference)) ** 2
    error = math.sqrt(float(relative_squares(reference, squares).mean()))
    return error, float(resized.mean()) / mean - 1


def errors(pictures: Pictures) -> dict[str, tuple[float, float]]:
    """How far the pictures in `columns` are from the path tracer's, by name, as `difference` says it.

    Empty unless the mode is "split" and the view is "picture", the only one that the path tracer has too.
    """
    if pictures.mode != "split" or pictures.view != PICTURE or not pictures.ready:
        return {}
    assert pictures.realtime is not None
    assert pictures.reference is not None
    names = [name for name in pictures.columns() if name in RESULTS]
    found = {name: difference(pictures.realtime[RESULTS[name]], pictures.reference.tracer) for name in names}
    return {name: error for name, error in found.items() if error is not None}


class SecondScene:
    """The pictures of a second scene, which follow those of the first one in everything but the scene.

    name: of the scene, for the user. `close` frees everything.
    """

    def __init__(self, device: Device, scene: Scene, first: Pictures, name: str) -> None:
        self.name = name
        self.first = first
        self.pictures = Pictures(device, scene, first.settings, first.seed, first.mode)

    @property
    def shown(self) -> bool:
        """Whether the second scene is shown: not in the mode "split", which has other pictures side by side."""
        return self.first.mode != "split"

    def render(self, camera: Camera, pixels: tuple[int, int], scale: float) -> None:
        """Submit the next frame; arguments and errors are those of `Pictures.render`."""
        if self.shown:
            for name in FOLLOWED:
                setattr(self.pictures, name, getattr(self.first, name))
            self.pictures.render(camera, pixels, scale)

    def restart(self) -> None:
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
        # The divider lies between texels, so that no texel is shown in part.
        divider = round(self.first.divider * left.image.width) / left.image.width
        return [Part(left.image, 0.0, divider), Part(right.image, divider, 1.0)]

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
        # Both are of the same window, but a size that can't be built leaves one of them at its last size.
        first = self.first.radiance()
        second = area_means(self.pictures.radiance(), (first.shape[1], first.shape[0]))
        compared = compare(second, first, exposure=exposure)
        found = {"relMSE": compared.relative_mse}
        if not math.isnan(compared.flip):
            found["FLIP"] = compared.flip
        return found

    def close(self) -> None:
        """Free everything once the submitted work is done. Safe to call twice."""
        self.pictures.close()
