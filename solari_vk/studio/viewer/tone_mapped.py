"""Radiance as the viewer shows it: tone mapped, in an image of 8 bits."""

from __future__ import annotations

from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.image import Image
from solari_vk.gpu.frame.frame import Frame
from solari_vk.output.tone_mapping import TONEMAPS
from solari_vk.passes.display import show_stage


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
