"""The path tracer's picture as the viewer shows it: tone mapped, in an image of 8 bits."""

from __future__ import annotations

from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.image import Image
from solari_vk.gpu.frame.frame import Frame
from solari_vk.output.tone_mapping import TONEMAPS
from solari_vk.passes.display import show_stage
from solari_vk.reference import PathTracer
from solari_vk.scene.binder import SceneBinder
from solari_vk.scene.model import Camera


class ReferencePicture:
    """`tracer` and the frame that shows its radiance. `close` frees both."""

    def __init__(self, device: Device, binder: SceneBinder, size: tuple[int, int], seed: int) -> None:
        self.tracer = PathTracer(device, binder, size, seed=seed)
        try:
            self._frame = Frame(device, [show_stage(size)], external=self._external)
        except BaseException:
            self.tracer.close()
            raise

    @property
    def _external(self) -> dict[str, object]:
        return {"radiance": self.tracer.resource("radiance_mean")}

    @property
    def display(self) -> Image:
        """The image that is shown: sRGB, 8 bits."""
        image: Image = self._frame.resource("display")
        return image

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of `display`."""
        return self.display.width, self.display.height

    def render(self, camera: Camera, size: tuple[int, int], tonemap: str, max_samples: int) -> None:
        """Add at most `max_samples` samples per pixel to the picture, and tone map it into `display`."""
        if self.tracer.size != size:
            self.tracer.resize(size)
        radiance = self._external["radiance"]
        if self._frame.resource("radiance") is not radiance or self.size != size:
            self._frame.rebuild([show_stage(size)], self._external)
        self.tracer.advance(camera, max_samples)
        self._frame.uniforms["this_frame.exposure"] = camera.exposure
        self._frame.uniforms["display_settings.tonemap"] = TONEMAPS.index(tonemap)
        self._frame.submit()

    def reload(self) -> None:
        """Compile changed shaders. Raises CompilationError if one has an error; the old pipelines then stay in use."""
        self.tracer.reload()
        self._frame.rebuild()

    def close(self) -> None:
        """Free everything once the submitted work is done. Safe to call twice."""
        self._frame.close()
        self.tracer.close()
