"""The light that falls on points of a scene, in lux: `illuminance`."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.color import LUMINANCE_WEIGHTS
from solari_vk.base.errors import SolariError, checked_keywords
from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.acceleration.checks import check_switch, numbers, whole_number
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Stage
from solari_vk.passes import reference
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.renderers.scene_frame import checked_device
from solari_vk.scene.model import Camera, Scene

BUSY = 4096  # pixels that keep a device busy: fewer points are measured by several pixels each
LEAST_SAMPLES = 16  # of a pixel, so that its variance is known
REACH = 2e-6  # how far from a point its surface is searched, as a share of the scene's largest coordinate


class Illuminance(NamedTuple):
    """What `illuminance` returns: arrays with the shape of the points, in lux."""

    lux: NDArray[np.float64]
    standard_error: NDArray[np.float64]
    """One standard deviation of the noise in `lux`."""


@checked_keywords(who="solari_vk")
def illuminance(
    device: Device,
    scene: Scene | SceneBinder,
    points: ArrayLike,
    normals: ArrayLike = (0.0, 1.0, 0.0),
    *,
    cylindrical: bool = False,
    samples: int = 4096,
    max_bounces: int = 16,
    seed: int = 0,
    time_limit: float | None = None,
) -> Illuminance:
    """The illuminance at points of a scene, by path tracing from them: without bias, with a standard error each.

    points (..., 3) in meters and normals (..., 3) of any length are broadcast against each other. Planar illuminance is
    that of a plane's side to which the normal points, upwards by default; cylindrical illuminance is the mean
    over the side of a small upright cylinder whose axis is the normal. samples: paths from each point, at least 16;
    the error falls with the root of their number. max_bounces: surfaces that scatter light on its way; 0 is direct
    light alone. seed: a whole number; another one gives independent noise. time_limit: seconds after which it stops
    early, and the standard errors are larger. Light is photometric: emission in cd/m^2, intensities in cd, suns in lux.

    A point may lie on a surface, and is then measured just above it. Surfaces that let light pass, such as panes of
    glass, tint it, and so does the solid in which a point is, such as water. Raises SolariError for points and normals
    that don't fit each other or aren't finite, for normals of length 0 and other wrong arguments.
    """
    check_switch(cylindrical, "illuminance: cylindrical")
    whole_number(samples, "illuminance: samples", LEAST_SAMPLES)
    whole_number(max_bounces, "illuminance: max_bounces", 0)
    shape, places, directions = _broadcast(points, normals)
    if not len(places):
        return Illuminance(np.zeros(shape), np.zeros(shape))
    # Few points are measured by several pixels each, which share their samples.
    pixels = max(1, min(BUSY // len(places), samples // LEAST_SAMPLES))
    repeated = np.repeat(np.concatenate([places, directions], axis=1), pixels, axis=0)
    checked_device(device, "illuminance")
    with _PointTracer(device, scene, repeated, cylindrical, max_bounces, seed) as tracer:
        frame = tracer.render(Camera(), math.ceil(samples / pixels), time_limit=time_limit)
        measured = frame["raw_radiance"].astype(np.float64) @ LUMINANCE_WEIGHTS, frame["variance"].astype(np.float64)
    # A pixel is the radiance that a white Lambertian surface would have at its point: the illuminance over pi.
    # Pixels of one point are independent: the variance of their mean is the mean variance over their number.
    light, variance = (array.ravel()[: len(repeated)].reshape(-1, pixels) for array in measured)
    error = np.sqrt(variance.sum(axis=1)) / pixels
    return Illuminance(*(math.pi * array.reshape(shape) for array in (light.mean(axis=1), error)))


class _PointTracer(PathTracer):
    """A path tracer whose pixels are points with normals (N, 6), row by row; the last row is filled up."""

    LARGEST_PIXEL_BYTES = 24  # of a point with its normal

    def __init__(
        self,
        device: Device,
        scene: Scene | SceneBinder,
        points: NDArray[Any],
        cylindrical: bool,
        max_bounces: int,
        seed: int,
    ) -> None:
        # Nearly square, because dispatches are grids of squares of 8 x 8 pixels.
        width = math.ceil(math.sqrt(len(points)))
        size = width, math.ceil(len(points) / width)
        self._count = len(points)
        self._points = np.resize(points, (size[0] * size[1], 6))
        # The point itself counts as a surface at which the path is scattered.
        super().__init__(device, scene, size, max_bounces=max_bounces + 1, seed=seed)
        self._frame.uniforms["measurement.cylindrical"] = cylindrical

    def _checked_size(self, size: tuple[int, int]) -> tuple[int, int]:
        most = int(self.device.properties.limits.maxStorageBufferRange) // self.LARGEST_PIXEL_BYTES
        if math.prod(size) > most:
            raise SolariError(
                f"illuminance: {self._count:,} points at once are more than this device holds, which is "
                f"{math.isqrt(most) ** 2:,}: measure them in parts"
            )
        return size

    def _stages(self, size: tuple[int, int]) -> list[Stage]:
        dispatch = self._dispatch
        return [reference.trace_stage(size, dispatch.rows, dispatch.max_paths, self.settings, starts_at_points=True)]

    def _inputs(self) -> dict[str, Any]:
        # Numbers of 32 bits are rounded in proportion to the largest coordinate: by that a point that lies on a surface
        # may be off it. The shader lifts it as far as that surface needs.
        reach = max((np.abs(b).max() for b in self._corners()), default=0.0)
        points, normals = np.split(self._points, 2, axis=1)
        points = points - self.binder.origin
        near = REACH * np.maximum(np.abs(points).max(axis=1, keepdims=True), reach)
        values = np.concatenate([points, normals, near], axis=1).astype(np.float32)
        buffer = self.device.buffer(values.nbytes, "measured_points")
        self._owned.callback(buffer.destroy)
        buffer.upload(values)
        return super()._inputs() | {"measured_points": buffer}

    def _corners(self) -> tuple[NDArray[Any], ...]:
        scene = self.binder.scene
        if not any(instance.visible for instance in scene):
            return ()
        return tuple(corner - self.binder.origin for corner in scene.bounds)


def _broadcast(points: ArrayLike, normals: ArrayLike) -> tuple[tuple[int, ...], NDArray[Any], NDArray[Any]]:
    """The shape of the result, and points and unit normals as arrays (N, 3)."""
    arrays = {}
    for name, argument in {"points": points, "normals": normals}.items():
        array = numbers(argument, f"illuminance: {name}").astype(np.float64)
        arrays[name] = array
        if array.shape[-1:] != (3,):
            raise SolariError(f"illuminance: the shape of {name} is {array.shape}, not (..., 3)")
        if not np.isfinite(array).all():
            raise SolariError(f"illuminance: {name} must be finite numbers, in meters")
    lengths = np.linalg.norm(arrays["normals"], axis=-1, keepdims=True)
    if not (lengths > 0).all():
        raise SolariError("illuminance: a normal has the length 0: give a direction")
    arrays["normals"] = arrays["normals"] / lengths
    try:
        places, directions = np.broadcast_arrays(*arrays.values())
    except ValueError:
        shapes = " and ".join(f"{name} {array.shape}" for name, array in arrays.items())
        raise SolariError(f"illuminance: {shapes} don't fit each other") from None
    return places.shape[:-1], places.reshape(-1, 3), directions.reshape(-1, 3)
