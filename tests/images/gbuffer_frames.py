"""G-buffers alone, frame after frame, and what their texels say."""

from __future__ import annotations

import numpy as np

from solari_vk.gpu.frame.frame import Frame
from solari_vk.passes import gbuffer
from solari_vk.scene.binder import SceneBinder
from solari_vk.scene.matrices import transform_directions
from solari_vk.scene.view import write_view
from solari_vk.settings import Settings

NOTHING = 0xFFFFFFFF
VIEW = ("world_from_view", "view_from_world", "tan_half_fov", "near", "jitter")
IMAGES = ("gbuffer", "gbuffer_surface", "depth", "motion_vectors")


class GBufferFrames:
    """The G-buffer's stages over a binder, which the caller updates and destroys. A context manager."""

    def __init__(self, device, binder: SceneBinder, size: tuple[int, int], glsl=None, **settings) -> None:
        self.binder, self.size, self.settings = binder, size, Settings(**settings)
        self._frame = Frame(device, self._stages(), external=binder.resources, glsl_root=glsl)
        self._built = self._facts
        self._version = binder.version
        self._previous = None

    @property
    def _facts(self):
        return self.size, self.binder.instance_capacity, self.settings.built_in

    def _stages(self):
        rows = self.binder.instance_capacity
        return [gbuffer.stage(self.size, self.settings, rows), gbuffer.last_stage(rows)]

    def render(self, camera, jitter=(0.0, 0.0)) -> dict[str, np.ndarray]:
        """The images of the next frame by name, and its counters under theirs."""
        if self.binder.version != self._version:
            self._version = self.binder.version
            self._frame.bind(self.binder.resources)
        if self._facts != self._built:
            self._built = self._facts
            self._frame.rebuild(self._stages())
        uniforms = self._frame.uniforms
        write_view(uniforms, camera, self.size, self.size[1])
        uniforms["jitter"] = jitter
        now = {name: np.copy(uniforms[name]) for name in VIEW}
        for name, value in (self._previous or now).items():
            uniforms["previous_" + name] = value
        self._previous = now
        uniforms["exposure"] = camera.exposure
        self._frame.submit()
        found = {name: self._frame[name] for name in IMAGES}
        if self.settings.gbuffer == "raster":
            counters = self._frame["gbuffer_counters"]
            found |= {name: int(counters[name]) for name in gbuffer.COUNTERS}
        return found

    def __enter__(self) -> GBufferFrames:
        return self

    def __exit__(self, *_: object) -> None:
        self._frame.close()


# ---- what texels say --------------------------------------------------------------------------------


def decode_octahedral(codes: np.ndarray, bits: int) -> np.ndarray:
    """Unit vectors (..., 3) of octahedral codes with so many bits for each of two numbers."""
    mask = (1 << bits) - 1
    xy = np.stack([codes & mask, codes >> bits & mask], -1) / (mask - 1) * 2.0 - 1.0
    z = 1 - np.abs(xy).sum(-1, keepdims=True)
    folded = np.where(z >= 0, xy, (1 - np.abs(xy[..., ::-1])) * np.where(xy >= 0, 1, -1))
    vectors = np.concatenate([folded, z], -1)
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def decode(found: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Values (height, width[, channels]) of the packed layout; see glsl/passes/gbuffer/gbuffer.glsl."""
    x, y, z, w = np.moveaxis(found["gbuffer"].astype(np.int64), -1, 0)
    surface = found["gbuffer_surface"].astype(np.int64)
    fine_bits = np.array((5, 6, 5))
    coarse = np.stack([x & 255, x >> 8 & 255, x >> 16 & 255], -1)
    fine = np.stack([z >> 16 & 31, z >> 21 & 63, z >> 27 & 31], -1)
    return {
        "color": ((coarse << fine_bits | fine) / ((256 << fine_bits) - 1.0)) ** 2.2,
        "perceptual_roughness": (x >> 24) / 255.0,
        "emissive": np.stack([y >> at & 511 for at in (0, 9, 18)], -1) * 2.0 ** ((y >> 27) - 24.0)[..., None],
        "reflectance": (z & 255) / 255.0,
        "metallic": (z >> 8 & 255) / 255.0,
        "normal": decode_octahedral(w & 0xFFFFFF, 12),
        "geometric_normal": decode_octahedral(surface[..., 0], 16),
        "instance": surface[..., 1],
        "depth": found["depth"][..., 0].astype(np.float64),
        "motion": found["motion_vectors"].astype(np.float64),
    }


def pixel_directions(camera, size, jitter=(0.0, 0.0)) -> np.ndarray:
    """World vectors (height, width, 3) from the camera to what pixels show at distance 1 along the view axis."""
    width, height = size
    slope = np.tan(camera.vertical_fov / 2) * np.array((width / height, -1.0))
    ndc = (np.mgrid[0:height, 0:width][::-1].transpose(1, 2, 0) + 0.5 + np.asarray(jitter)) / (width, height) * 2 - 1
    return transform_directions(camera.transform, np.concatenate([ndc * slope, -np.ones((height, width, 1))], -1))


def project(camera, size, positions: np.ndarray) -> np.ndarray:
    """Pixel positions (..., 2) of world positions (..., 3), centres at + 0.5."""
    view = (positions - camera.transform[:3, 3]) @ np.linalg.inv(camera.transform[:3, :3]).T
    slope = np.tan(camera.vertical_fov / 2) * np.array((size[0] / size[1], -1.0))
    return (view[..., :2] / (-view[..., 2:] * slope) + 1) / 2 * size
