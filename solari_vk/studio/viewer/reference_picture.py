"""The path tracer's picture as the viewer shows it: tone mapped, in an image of 8 bits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.image import Image
from solari_vk.gpu.frame.frame import Frame
from solari_vk.output.tone_mapping import TONEMAPS
from solari_vk.passes.display import show_stage
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.scene.model import Camera

RGB_BYTES = 12  # of a pixel in the path tracer's buffer: three float32


class ToneMapped:
    """An image, `display`, of the radiance in a buffer. `close` frees it."""

    def __init__(self, device: Device, radiance: Buffer, size: tuple[int, int]) -> None:
        self._frame = Frame(device, [show_stage(size)], external={"radiance": radiance})

    @property
    def display(self) -> Image:
        """The image that is shown: sRGB, 8 bits."""
        image: Image = self._frame.resource("display")
        return image

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of `display`."""
        return self.display.width, self.display.height

    def fit(self, radiance: Buffer, size: tuple[int, int]) -> None:
        """Take the radiance from this buffer, of a picture of this size, from the next `render` on."""
        if self._frame.resource("radiance") is not radiance or self.size != size:
            self._frame.rebuild([show_stage(size)], {"radiance": radiance})

    def render(self, exposure: float, tonemap: str) -> None:
        """Submit the tone mapping of what the buffer holds then."""
        self._frame.uniforms["this_frame.exposure"] = exposure
        self._frame.uniforms["display_settings.tonemap"] = TONEMAPS.index(tonemap)
        self._frame.submit()

    def reload(self) -> None:
        """Compile changed shaders. Raises CompilationError if one has an error; the old pipelines then stay in use."""
        self._frame.rebuild()

    def close(self) -> None:
        """Free everything once the submitted work is done. Safe to call twice."""
        self._frame.close()


class ReferencePicture:
    """`tracer` and the image that shows its radiance. `close` frees both."""

    def __init__(self, device: Device, binder: SceneBinder, size: tuple[int, int], seed: int) -> None:
        self.tracer = PathTracer(device, binder, size, seed=seed)
        try:
            self._shown = ToneMapped(device, self.tracer.resource("radiance_mean"), size)
        except BaseException:
            self.tracer.close()
            raise

    @property
    def display(self) -> Image:
        """The image that is shown: sRGB, 8 bits."""
        return self._shown.display

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of `display`."""
        return self._shown.size

    @property
    def mean_samples(self) -> float:
        """The mean number of samples of a pixel so far: a part of the rows may have more than the others."""
        count, row = self.tracer.unfinished_bands
        return self.tracer.samples + count * row / self.tracer.size[1]

    def render(
        self, camera: Camera, size: tuple[int, int], tonemap: str, max_samples: int, bands: int | None = None
    ) -> None:
        """Add at most `max_samples` samples per pixel to the picture, or to so many bands of it, and tone map it."""
        if self.tracer.size != size:
            self.tracer.resize(size)
        # The path tracer has another buffer after a change of size.
        self._shown.fit(self.tracer.resource("radiance_mean"), size)
        self.tracer.advance(camera, max_samples, bands=bands)
        self._shown.render(camera.exposure, tonemap)

    def expose(self, camera: Camera, tonemap: str) -> None:
        """Tone map the picture into `display` again."""
        self._shown.render(camera.exposure, tonemap)

    def probe(self, x: float, y: float) -> NDArray[np.float32]:
        """The radiance (3,) in cd/m^2 at (x, y), both from 0 to 1 from the picture's top left corner."""
        # Only this pixel is read: the whole picture would take as long as a frame, and the cursor moves all the time.
        width, height = self.tracer.size
        pixel = int(y * height) * width + int(x * width)
        found: NDArray[np.float32] = self.tracer.resource("radiance_mean").read(np.float32, 3, RGB_BYTES * pixel)
        return found

    def reload(self) -> None:
        """Compile changed shaders. Raises CompilationError if one has an error; the old pipelines then stay in use."""
        self.tracer.reload()
        self._shown.reload()

    def close(self) -> None:
        """Free everything once the submitted work is done. Safe to call twice."""
        self._shown.close()
        self.tracer.close()
