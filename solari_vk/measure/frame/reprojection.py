"""A slow camera movement, and the mean of its frames as the last camera sees them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.gpu.device.device import Device
from solari_vk.reference import PathTracer
from solari_vk.scene.binder import SceneBinder
from solari_vk.scene.model import Camera
from solari_vk.scene.projection import JITTERS, Projection

Floats = NDArray[np.float64]
STEP = 0.002  # sideways movement in a frame, over the picture's height at the median depth
SMOOTH = 0.4  # perceptual roughness; what smoother surfaces reflect moves in another way than they do
PLANE_DISTANCE, NORMAL_COSINE = 0.01, 0.9  # of samples of one surface; the distance is over the depth


class _Hits(NamedTuple):
    """What the samples of a picture hit: depth along the view axis, position, normal, instance, and whether it is no
    smooth surface."""

    depth: Floats
    position: Floats
    normal: Floats
    instance: NDArray[np.uint32]
    rough: NDArray[np.bool_]


class _Taps(NamedTuple):
    """Where the samples of the last camera are in an earlier frame: (pixels, 4) texels and their weights, and whether
    the frame has the sample (pixels,). A sample that hits nothing is black and has no texels."""

    texels: NDArray[np.int32]
    weights: NDArray[np.float32]
    found: NDArray[np.bool_]


class Movement:
    """A camera that moves to the right and arrives at `camera` in its last frame, and the reprojection of the last
    `observed` frames onto that frame's pixels.

    The scene stands still, so that a surface's positions in earlier frames follow from the cameras alone. These equal
    the sums of the motion vectors of the frames between, without their rounding. Frames are jittered by the cameras.
    A sample of the last camera reads the four nearest samples of an earlier frame, bilinearly; those of another surface
    are left out, and without any of the same surface the frame is dropped for this pixel. Frames of a camera that
    stands still would be averaged as they are. What mirrors show moves in another way, and is blurred.
    """

    def __init__(
        self, device: Device, binder: SceneBinder, camera: Camera, size: tuple[int, int], warm_up: int, observed: int,
        step: float = STEP,
    ) -> None:  # fmt: skip
        with PathTracer(device, binder, size) as tracer:

            def trace(view: Camera) -> _Hits:
                names = ("depth", "position", "geometric_normal", "instance_id", "roughness_metallic")
                depth, position, normal, instance, roughness = (
                    tracer.first_hits.read(name, Projection.of(view, size), size).reshape(size[0] * size[1], -1)
                    for name in names
                )
                rough = (roughness[:, 0] >= SMOOTH) | np.isinf(depth[:, 0])
                return _Hits(depth[:, 0], position, normal, instance[:, 0], rough)

            depth = trace(camera).depth
            seen = depth[np.isfinite(depth)]
            height = 2 * np.tan(camera.vertical_fov / 2) * float(np.median(seen)) if len(seen) else 0.0
            stride = step * height
            count = warm_up + observed
            self.cameras = [_moved(camera, stride * (i + 1 - count), JITTERS[i % len(JITTERS)]) for i in range(count)]
            """One for each frame."""
            self._taps = []
            rough = np.ones(size[0] * size[1], np.bool_)
            for view in self.cameras[warm_up:]:
                wanted = trace(_moved(camera, 0.0, view.jitter))
                self._taps.append(_find(wanted, trace(view), view, size))
                rough &= wanted.rough
            self.rough = rough.reshape(size[1], size[0])
            """Whether pixels show no smooth surface (h, w). On a smooth one, reflections move in another way than the
            surface, and frames reprojected with it don't fit together."""

    def mean(self, frames: Sequence[NDArray[np.float32]]) -> Floats:
        """The mean (h, w, 3) of the observed frames' radiance (h, w, 3) as the last camera sees it."""
        total, count = np.zeros(frames[0].shape).reshape(-1, 3), np.zeros((frames[0].size // 3, 1))
        for frame, taps in zip(frames, self._taps, strict=True):
            total += (frame.reshape(-1, 3)[taps.texels] * taps.weights[..., None]).sum(axis=1)
            count += taps.found[:, None]
        return np.asarray((total / count).reshape(frames[0].shape))


def _moved(camera: Camera, right: float, jitter: ArrayLike) -> Camera:
    transform = camera.transform.copy()
    transform[:3, 3] += right * transform[:3, 0] / np.linalg.norm(transform[:3, 0])
    fields = {name: getattr(camera, name) for name in ("vertical_fov", "near", "ev100")}
    return Camera(transform=transform, jitter=np.asarray(jitter, np.float32), **fields)


def _find(wanted: _Hits, there: _Hits, view: Camera, size: tuple[int, int]) -> _Taps:
    """The texels of a frame, whose samples hit `there`, that show the surfaces `wanted`."""
    width, height = size
    projection = Projection.of(view, size).numbers  # see projection.FIELDS
    from_world = np.reshape(projection[12:24], (4, 3))
    local = wanted.position @ from_world[:3] + from_world[3]
    with np.errstate(divide="ignore", invalid="ignore"):
        uv = 0.5 + np.array((0.5, -0.5)) * local[:, :2] / (np.array(projection[24:26]) * -local[:, 2:])
    is_surface = np.isfinite(wanted.depth)
    ahead = is_surface & (local[:, 2] < 0)
    at = np.where(ahead[:, None], uv * size - 0.5 - view.jitter, -10.0).clip(-10, max(size) + 10)
    corner = np.floor(at).astype(np.int32)
    part = at - corner
    texels, weights = [], []
    for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
        x, y = corner[:, 0] + dx, corner[:, 1] + dy
        inside = ahead & (x >= 0) & (x < width) & (y >= 0) & (y < height)
        texel = np.where(inside, y * width + x, 0)
        away = np.abs(((there.position[texel] - wanted.position) * wanted.normal).sum(axis=1))
        same = (there.instance[texel] == wanted.instance) & (away < PLANE_DISTANCE * wanted.depth)
        same &= (there.normal[texel] * wanted.normal).sum(axis=1) > NORMAL_COSINE
        weight = np.abs(1 - dx - part[:, 0]) * np.abs(1 - dy - part[:, 1])
        texels.append(texel)
        weights.append(np.where(inside & same, weight, 0.0))
    total = np.sum(weights, axis=0)
    found = total > 1e-3
    share = np.stack(weights, axis=1) / np.where(found, total, np.inf)[:, None]
    return _Taps(np.stack(texels, axis=1).astype(np.int32), share.astype(np.float32), found | ~is_surface)
