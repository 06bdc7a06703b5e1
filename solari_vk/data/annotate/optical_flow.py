"""Where the points that pixels show go from one picture to another, and whether they are seen there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, checked_keywords
from solari_vk.data.annotate.surfaces import (
    SELF_OCCLUSION,
    check_view,
    first_surfaces,
    is_blocked,
    is_inside,
    pixel_grid,
)
from solari_vk.renderers.ray_tracer import Hits, RayTracer
from solari_vk.scene.calibrated import pixel_rays
from solari_vk.scene.matrices import transform_points
from solari_vk.scene.model import Camera, Instance

VISIBLE, OCCLUDED, OUTSIDE = range(3)
"""States of a pixel's point in the other picture."""
FAR = 1e6  # meters to the background, which only turns
Floats = NDArray[np.float64]


class Flow(NamedTuple):
    """What becomes of the points at pixels' centers in another picture."""

    flow: Floats
    """(height, width, 2) in pixels: the position in the other picture minus the pixel's; NaN where it has none."""
    state: NDArray[np.uint8]
    """(height, width): 0, the point is seen in the other picture; 1, a surface hides it; 2, it is outside."""
    scene_flow: Floats
    """(height, width, 3) in meters in the world: how the surface moves; NaN where nothing is."""

    @property
    def disparity(self) -> Floats:
        """(height, width) in pixels: of the left one of a rectified pair's pictures, to the right one."""
        return -self.flow[..., 0]


@checked_keywords(who="solari_vk")
def optical_flow(
    tracer: RayTracer,
    cameras: Sequence[Camera],
    size: tuple[int, int],
    *,
    pose: Callable[[float], Any] | None = None,
    times: tuple[float, float] = (0.0, 1.0),
) -> tuple[Flow, Flow]:
    """The flow from a first picture to a second one, and the flow back.

    cameras: those of both pictures, of any projection. pose(time): poses the scene, such as `scene.animate`, and is
    called with both times; it may move, edit and deform instances, and the scene stays as at the second time. Without
    it the scene stands still: then the flow between the cameras of a stereo pair has its `disparity`. Points are
    those of the surfaces at pixels' centers; occlusion is found by a ray each. The background turns with the camera.
    Raises SolariError if an edit between the times changes the number of a mesh's triangles.
    """
    pair = list(cameras) if isinstance(cameras, Sequence) else []
    if len(pair) != 2 or not all(isinstance(camera, Camera) for camera in pair):
        raise SolariError("optical_flow: cameras are two Camera objects, one for each picture")

    check_view("optical_flow", tracer, cameras[0], size)

    def show(index: int) -> None:
        if pose is not None:
            pose(times[index])

    # Each picture's surfaces are found at its own time, and where they are is asked for at both times. The order poses
    # the scene as rarely as that allows, and leaves it at the second time.
    show(1)
    second = _Picture(tracer, cameras[1], size)
    show(0)
    first = _Picture(tracer, cameras[0], size)
    before = first.positions(), second.positions()
    show(1)
    after = first.positions(), second.positions()
    forward = first.flow(tracer, cameras[1], before[0], after[0])
    show(0)
    backward = second.flow(tracer, cameras[0], after[1], before[1])
    show(1)
    return forward, backward


class _Picture:
    """The points that a camera's pixels show."""

    def __init__(self, tracer: RayTracer, camera: Camera, size: tuple[int, int]) -> None:
        self.size = size
        self.camera = camera
        self.pixels = pixel_grid(size)
        origins, self.directions, starts = pixel_rays(camera, self.pixels, size)
        rays, hits = first_surfaces(tracer, origins, self.directions, starts)
        self.found = np.zeros(len(self.pixels), np.bool_)
        self.found[rays] = True
        self.parts = [] if hits is None else _by_instance(tracer, rays, hits)

    def positions(self) -> Floats:
        """Where the points are now in the world, (N, 3); NaN where nothing is."""
        found = np.full((len(self.pixels), 3), np.nan)
        for instance, rays, count, triangles, weights in self.parts:
            mesh = instance.posed_mesh() if instance.posed else instance.ray_mesh or instance.mesh
            if len(mesh.triangles) != count:
                raise SolariError(
                    f"optical_flow: {instance.describe()}: its mesh had {count} triangles and has "
                    f"{len(mesh.triangles)}: move its vertices only"
                )
            corners = mesh.positions.astype(np.float64)[mesh.triangles[triangles]]
            found[rays] = transform_points(instance.transform, np.einsum("nk,nki->ni", weights, corners))
        return found

    def flow(self, tracer: RayTracer, camera: Camera, here: Floats, there: Floats) -> Flow:
        """To a camera's picture of the scene as it is now. here, there: positions at the two times."""
        # The background is so far away that it turns with the camera and doesn't move with it.
        far = camera.position + FAR * self.directions
        if self.camera.orthographic_height or camera.orthographic_height:
            far[:] = np.nan  # parallel projections don't say which part of a background a pixel shows
        targets = np.where(self.found[:, None], there, far)
        arrivals = camera.project(targets, self.size)
        inside = is_inside(arrivals, self.size)
        slack = SELF_OCCLUSION * np.linalg.norm(targets - camera.position, axis=-1)
        state = np.full(len(arrivals), OUTSIDE, np.uint8)
        blocked = is_blocked(tracer, camera, targets[inside], arrivals[inside], self.size, slack[inside])
        state[inside] = np.where(blocked, OCCLUDED, VISIBLE)
        shape = self.size[1], self.size[0]
        flow = (arrivals - self.pixels).reshape(*shape, 2)
        return Flow(flow, state.reshape(shape), (there - here).reshape(*shape, 3))


Part = tuple[Instance, NDArray[np.int64], int, NDArray[Any], Floats]


def _by_instance(tracer: RayTracer, rays: NDArray[np.int64], hits: Hits) -> list[Part]:
    """For each instance: the rays that hit it, its number of triangles, the triangles, and weights of corners."""
    parts = list[Part]()
    for number in np.unique(hits.instance).tolist():
        chosen = hits.instance == number
        instance = tracer.instances[number]
        # Vulkan gives the weights of the second and the third corner; all three add up to 1.
        others = hits.barycentrics[chosen].astype(np.float64)
        weights = np.concatenate([1 - others.sum(axis=-1, keepdims=True), others], axis=-1)
        # Rays meet the ray_mesh where there is one, but what joints move is always its own mesh.
        mesh = instance.mesh if instance.posed else instance.ray_mesh or instance.mesh
        parts.append((instance, rays[chosen], len(mesh.triangles), hits.primitive[chosen], weights))
    return parts
