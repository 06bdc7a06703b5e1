"""Rays that leave a G-buffer's surface never meet the plane that they leave from, however large its triangles are."""

from __future__ import annotations

import math

import numpy as np
import pytest
from gbuffer_frames import GBufferFrames

import solari_vk as sv
from solari_vk.gpu.frame.frame import Pass, Stage
from solari_vk.scene import shapes
from solari_vk.scene.binder import SceneBinder
from solari_vk.scene.builtin import matte, place

SIZE = (48, 32)
RAYS = 32
LEAVE = """#version 460
#extension GL_EXT_ray_query : require
#include "common/random.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "scene/trace.glsl"
layout(local_size_x = 8, local_size_y = 8) in;
layout(set = 1, binding = 149, scalar) buffer BlockedBlock { uint at[]; } blocked;

void main() {
    uvec2 pixel = INVOCATION_INDEX;
    if (any(greaterThanEqual(pixel, uniforms.size))) { return; }
    GBufferSurface surface = load_gbuffer(pixel);
    uint rng = seed_rng(pixel, 0u, 1u), count = 0u;
    for (uint i = 0u; surface.exists && i < %du; i++) {
        vec3 direction = orthonormalize(surface.geometric_world_normal) * sample_uniform_hemisphere(rand_vec2f(rng));
        vec3 origin = surface.world_position + surface.ray_offset * surface.geometric_world_normal;
        count += uint(!trace_visibility(origin, direction, INFINITY));
    }
    blocked.at[pixel.y * uniforms.size.x + pixel.x] = count;
}
"""


class LeavingRays(GBufferFrames):
    """The same, with rays from each pixel's surface."""

    def _stages(self):
        pixels = self.size[0] * self.size[1]
        rays = Stage("leave", buffers={"blocked": pixels}, passes=[Pass("test/leave", threads=self.size)])
        return [*super()._stages(), rays]


def check_offsets(device, folder, gbuffer="raster", scale=1.0):
    """A tilted square of two triangles, 200 wide, seen from 0.05 away, near the world's origin and far from it."""
    (folder / "passes/test").mkdir(parents=True, exist_ok=True)
    (folder / "passes/test/leave.comp").write_text(LEAVE % RAYS)
    normal = np.array((math.sin(0.5) * 0.6, math.cos(0.5), math.sin(0.5) * 0.8))
    u = np.cross(normal, (0, 0, 1))
    u /= np.linalg.norm(u)
    v = np.cross(normal, u)
    quad = shapes.quad((0, 0, 0), 100 * u, 100 * v)
    for far in (0.0, 1.0, 100.0):
        place_at = scale * far * np.array((1, 2, 3))
        scene = sv.Scene(sv.Instance(mesh=quad, material=matte(0.5), transform=place(scale, place_at)))
        eye, target = place_at + scale * (0.02 * normal + 0.05 * u), place_at + scale * 0.01 * u
        camera = sv.Camera.look_at(eye, target, vertical_fov=1.2, near=1e-4 * scale)
        binder = SceneBinder(device, scene)
        binder.update()
        with LeavingRays(device, binder, SIZE, folder, gbuffer=gbuffer) as frames:
            there = frames.render(camera)["depth"] > 0
            blocked = int(frames._frame["blocked"].sum())
        binder.destroy()
        assert there.mean() > 0.5
        assert blocked == 0, f"{blocked} of {there.sum() * RAYS} rays never left, {far} from the origin"


@pytest.mark.parametrize("gbuffer", ["raster", "traced"])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_rays_leave_their_surface(device, tmp_path, gbuffer, scale):
    check_offsets(device, tmp_path, gbuffer, scale)
