"""Depth cameras that see a pattern of dots which a projector beside them casts, such as the first Kinect."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, checked_constructor
from solari_vk.data.annotate.surfaces import SELF_OCCLUSION, check_view, first_surfaces, pixel_grid
from solari_vk.data.sensors.echoes import checked_numbers
from solari_vk.data.sensors.time_of_flight import DepthImage
from solari_vk.renderers.ray_tracer import RayTracer
from solari_vk.scene.calibrated import pixel_rays
from solari_vk.scene.checks import check_whole
from solari_vk.scene.model import Camera

Floats = NDArray[np.float64]
STEEPEST = math.pi / 2 - 1e-3  # radians: the noise of larger angles has no bound


@checked_constructor
@dataclass(frozen=True, kw_only=True)
class StructuredLightCamera:
    """A depth camera with a projector `baseline` meters to its right.

    What the projector doesn't reach is missing, and so are depths that aren't between min_range and max_range, in
    meters, and surfaces that rays meet at more than max_angle, in radians, from the normal. disparity_step: in pixels;
    depths are those of multiples of it, which lie z² / (f baseline) * disparity_step apart (Khoshelham and Elberink,
    "Accuracy and Resolution of Kinect Depth Data", 2012). Noise is that measured of the first Kinect (Nguyen, Izadi and
    Lovell, "Modeling Kinect Sensor Noise", 2012), at a depth z in meters and an angle a between the ray and the normal,
    which the paper measured in the middle of the picture: along the axis
    0.0012 + 0.0019 (z - 0.4)² + 0.0001 / sqrt(z) * a² / (pi / 2 - a)² meters, and in the picture
    0.8 + 0.035 a / (pi / 2 - a) pixels; both are standard deviations. Raises SolariError for numbers out of range.
    """

    baseline: float = 0.075
    min_range: float = 0.4
    max_range: float = 5.0
    max_angle: float = math.radians(80)
    disparity_step: float = 1 / 8

    def __post_init__(self) -> None:
        checked_numbers(
            self,
            {
                "baseline": (1e-6, 1e3, "m"),
                "min_range": (0, 1e6, "m"),
                "max_range": (1e-6, 1e6, "m"),
                "max_angle": (0, math.pi / 2, "radians"),
                "disparity_step": (0, 1e3, "pixels"),
            },
        )

    def capture(
        self, tracer: RayTracer, camera: Camera, size: tuple[int, int], *, seed: int = 0, noise: bool = True
    ) -> DepthImage:
        """A picture of depths, of a perspective camera, in the form of TimeOfFlightCamera's, without an amplitude.

        noise: by numpy's `default_rng(seed)`. Raises SolariError for another camera and a wrong seed.
        """
        check_view("StructuredLightCamera.capture", tracer, camera, size)
        check_whole("StructuredLightCamera.capture: seed", seed)
        if camera.orthographic_height or camera.projection != "perspective":
            raise SolariError(f"StructuredLightCamera.capture: {camera.describe()}: a perspective camera is needed")
        rng = np.random.default_rng(seed)
        pixels = pixel_grid(size)
        axial = rng.standard_normal(len(pixels))
        lateral = rng.standard_normal(pixels.shape)
        if noise:
            # The lateral noise of Nguyen, Izadi and Lovell moves what a pixel shows, by the angle at its center.
            _, angle = self._find(tracer, camera, pixels, size)
            angle = np.minimum(angle, self.max_angle)
            steepness = np.nan_to_num(angle / (math.pi / 2 - angle))
            pixels = pixels + (0.8 + 0.035 * steepness)[:, None] * lateral
        depth, angle = self._find(tracer, camera, pixels, size)
        if noise:
            # Their axial noise changes the depth that is found there.
            steepness = angle / (math.pi / 2 - angle)
            depth = depth + axial * (0.0012 + 0.0019 * (depth - 0.4) ** 2 + 0.0001 / np.sqrt(depth) * steepness**2)
            depth = np.where(depth > 0, depth, np.nan)
        if self.disparity_step:
            # Khoshelham and Elberink: the camera measures whole steps of disparity, f * baseline / depth.
            product = camera.intrinsics(size)[0, 0] * self.baseline
            steps = np.maximum(np.round(product / depth / self.disparity_step), 1)
            depth = product / (steps * self.disparity_step)
        valid = (depth >= self.min_range) & (depth <= self.max_range) & (angle <= self.max_angle)
        depth = np.where(valid, depth, np.nan)
        _, rays = camera.rays(pixel_grid(size), size)
        along = rays @ -camera.rotation[:, 2]
        shape = size[1], size[0]
        return DepthImage(depth.reshape(shape), (depth / along).reshape(shape), None)

    def _find(self, tracer: RayTracer, camera: Camera, pixels: Floats, size: tuple[int, int]) -> tuple[Floats, Floats]:
        """Depths (N) of what pixels show, and angles (N), at most STEEPEST, between its normals and the rays; NaN where
        nothing is or the pattern isn't."""
        depth, angle = np.full(len(pixels), np.nan), np.full(len(pixels), np.nan)
        origins, directions, starts = pixel_rays(camera, pixels, size)
        rays, hits = first_surfaces(tracer, origins, directions, starts)
        if hits is None:
            return depth, angle
        points = origins[rays] + hits.t[:, None].astype(np.float64) * directions[rays]
        projector = camera.position + self.baseline * camera.rotation[:, 0]
        # Directions reach from the projector to the points, so distances along them are shares of the way.
        shadow = tracer.trace(projector, points - projector, t_max=1 - SELF_OCCLUSION, any_hit=True)
        lit = shadow.instance < 0
        forward = -camera.rotation[:, 2]
        depth[rays[lit]] = ((points - camera.position) @ forward)[lit]
        cosine = np.abs(np.einsum("ni,ni->n", hits.normal, directions[rays]))
        angle[rays[lit]] = np.minimum(np.arccos(np.minimum(cosine, 1)), STEEPEST)[lit]
        return depth, angle
