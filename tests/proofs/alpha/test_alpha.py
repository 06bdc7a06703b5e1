"""Masks and blended surfaces: closed forms, the same surfaces for all rays, random numbers, and seeded bugs."""

from __future__ import annotations

import math

import numpy as np
import pytest
import test_panes_and_masks as alpha_checks
from support.measured import hold
from support.realtime import GBUFFER, SPLIT, Effort, make_renderer, run_pictures, trace
from support.seeded_bugs import Bug, bug_tests, seeded
from support.statistics import relative_interval
from test_panes_and_masks import (
    CAMERA,
    FLOOR_CAMERA,
    SIZE,
    before_a_lamp,
    below_a_pane,
    checkers,
    lamp_in_a_mirror,
    mean,
    pane,
    quad,
)

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import place
from solari_vk.settings import RAW


def check_panes(device):
    hold(alpha_checks.measure_panes(device))


def check_colored_light(device):
    hold(alpha_checks.measure_colored_light(device))


def check_lamps(device):
    hold(alpha_checks.measure_lamps(device))


def check_mask(device):
    hold(alpha_checks.measure_mask(device))


@pytest.mark.parametrize("check", [check_panes, check_colored_light, check_lamps, check_mask])
def test_closed_forms(device, check):
    check(device)


def test_light_comes_from_what_is_left_of_a_lamp(device):
    """Light samples on cut-out parts give nothing, as rays that pass there."""
    scene = below_a_pane(alpha=0.0)
    pixels = np.full((2, 2, 4), 255, np.uint8)
    pixels[0, :, 3] = 0
    scene.instances[2].material.update(base_color_texture=sv.TextureImage(pixels=pixels), alpha_mode="mask")
    found = {s: mean(device, scene, 256, FLOOR_CAMERA, max_bounces=1, light_strategy=s) for s in ("nee", "brdf")}
    np.testing.assert_allclose(found["nee"], found["brdf"], rtol=0.03)
    whole = mean(device, below_a_pane(alpha=0.0), 64, FLOOR_CAMERA, max_bounces=1, light_strategy="nee")
    np.testing.assert_allclose(found["nee"] / whole, 0.5, rtol=0.05)  # seen from the middle of the floor


def passes(device, seed):
    """Which pixels' rays pass a pane that covers half of what lies behind, less the mean."""
    with sv.PathTracer(device, before_a_lamp(pane(0.5)), (64, 64), max_bounces=0, seed=seed) as tracer:
        return (tracer.render(CAMERA, 1)["radiance"][..., 0] > 0) - 0.5


def check_random_numbers(device):
    """Pixels, seeds and panes have independent random numbers."""
    first, second = passes(device, 0), passes(device, 1)
    np.testing.assert_array_equal(first, passes(device, 0))
    limit = 4 / math.sqrt(first.size)
    for other in (second, np.roll(first, 1, axis=0), np.roll(first, 1, axis=1), np.roll(second, 1, axis=1)):
        assert abs(np.mean(first * other)) * 4 < limit


def test_random_numbers_are_independent(device):
    check_random_numbers(device)


def check_even_frames(device):
    """Frames show panes evenly over pixels and over time: with less error than the binomial noise of random numbers.
    Two panes have independent thresholds."""
    shown = (*GBUFFER, "guides/", "solari019/compose", "display/", "taa/")
    for alphas, over_time in (((0.3,), 0.5), ((0.6,), 0.5), ((0.3, 0.6), 0.8)):
        share = math.prod(1 - alpha for alpha in alphas)
        scene = before_a_lamp(*(pane(alpha, 2.0 + index) for index, alpha in enumerate(alphas)))
        with make_renderer(device, scene, (64, 64), passes=shown, **SPLIT) as renderer:
            frames = np.array([renderer.render(CAMERA)["radiance"][..., 0] / 2 for _ in range(64)])
        noise = math.sqrt(share * (1 - share))
        blocks = frames.reshape(64, 16, 4, 16, 4).mean(axis=(2, 4))
        errors = [float(np.sqrt(np.mean((found - share) ** 2))) for found in (frames[:8].mean(axis=0), blocks)]
        ratios = [error / noise * math.sqrt(count) for error, count in zip(errors, (8, 16), strict=True)]
        print(alphas, f"8 frames {ratios[0]:.2f}, 4 x 4 pixels {ratios[1]:.2f}, mean {frames.mean() / share:.3f}")
        assert ratios[0] < over_time
        assert ratios[1] < 0.8
        assert abs(frames.mean() - share) < 0.01


def test_frames_show_panes_evenly(device):
    check_even_frames(device)


@pytest.mark.slow  # the driver compiles whole frames
@pytest.mark.parametrize("lighting", [{}, SPLIT], ids=["paths", "split"])
def test_panes_tint_the_lamps_behind_them_alone(device, lighting):
    """Realtime, as alpha_checks.measure_lamps by the path tracer."""
    for distance, expected in ((-1.0, 0.25), (-8.0, 1.0)):
        with make_renderer(device, lamp_in_a_mirror(pane(0.5, distance)), SIZE, **lighting) as renderer:
            found = np.mean([renderer.render(CAMERA)["radiance"][12:20, 12:20, 0] for _ in range(64)])
        np.testing.assert_allclose(found, expected, rtol=0.1 if expected < 1 else 0.01)


def test_rays_to_lamps_through_panes_are_counted(device):
    """A camera ray, one from the mirror, one to what it passes, and one more where it meets the lamp."""
    with sv.PathTracer(device, lamp_in_a_mirror(pane(0.5, -8.0)), SIZE, max_bounces=1) as tracer:
        lit = (tracer.render(CAMERA, 1)["radiance"][..., 0] > 0).sum()
        assert 0 < lit < 500
        assert tracer.rays == 3 * 1024 + lit


@pytest.mark.slow  # the driver compiles a whole frame
def test_frames_count_them_too(device):
    """The first rays of paths, as above without the camera's."""
    scene = lamp_in_a_mirror(pane(0.5, -8.0))
    with sv.Renderer(device, scene, SIZE, sv.Settings(**RAW), count_rays=True) as renderer:
        lit = (renderer.render(CAMERA)["radiance"][..., 0] > 0.9).sum()
        assert 0 < lit < 500
        row = renderer.counted_passes.index("paths/first_ray")
        assert renderer["ray_counts"][row] == 2 * 1024 + lit


BEFORE = """#version 460
#include "scene/trace.glsl"
layout(local_size_x = 1) in;
layout(set = 1, binding = 0, scalar) buffer AnswerBlock { vec3 at[]; } answer;
void main() { answer.at[0] = trace_previous_transmittance(vec3(0.3, 0.2, -1.0), vec3(0.0, 0.0, -1.0), 3.0); }
"""


def test_rays_through_the_previous_frame_pass_what_is_hidden_now(device, tmp_path):
    """A pane that light has passed isn't opaque in the frame that hides it."""
    (tmp_path / "passes").mkdir()
    (tmp_path / "passes" / "before.comp").write_text(BEFORE)
    glass = sv.Instance(quad(2.0), sv.Material(base_color=(1, 0.2, 0), alpha=0.5, alpha_mode="blend"))
    scene, stage = sv.Scene(glass), sv.Stage("before", buffers={"answer": 1}, passes=[sv.Pass("before", threads=1)])
    tinted, seen = (0.5, 0.3, 0.25), []
    with sv.SceneFrame(device, scene, [stage], glsl_root=tmp_path) as frame:
        frame.binder.keep_previous_tlas(frame, True)
        for visible in (True, True, False, False, True, True):
            glass.visible = visible
            frame.submit()
            seen.append(frame["answer"][0].copy())
        frame.binder.keep_previous_tlas(frame, False)
    np.testing.assert_allclose(seen[1:], [tinted, tinted, (1, 1, 1), (1, 1, 1), tinted], atol=1e-6)


def everything():
    """A mask, two panes and vertex colors before a lit floor."""
    mesh = quad(4.0, 3.0)
    colors = np.random.default_rng(1).uniform(0.2, 1, (len(mesh.positions), 4))
    ground = sv.Instance(sv.Mesh(mesh.positions, mesh.triangles, normals=mesh.normals, colors=colors))
    mask = sv.Instance(
        quad(2.5, 0.6), sv.Material(base_color_texture=checkers(5), alpha_mode="mask", alpha_cutoff=0.5)
    )
    lamp = sv.Instance(
        shapes.quad((0, 2, -1), (0.5, 0, 0), (0, 0, 0.5)), sv.Material(base_color=0.0, emissive=30.0)
    )
    panes = [
        sv.Instance(quad(2.0, 0.4), sv.Material(base_color=(1, 0.3, 0.1), alpha=0.4, alpha_mode="blend")),
        sv.Instance(quad(3.0, 0.8), sv.Material(alpha=0.6, alpha_mode="blend", double_sided=True)),
    ]
    return sv.Scene(ground, mask, lamp, *panes)


def pictures_by_way(device, scene, count):
    """The path tracer's picture, and some frames of the realtime renderer."""
    with sv.PathTracer(device, scene, SIZE, seed=5) as tracer:
        taken = [tracer.render(CAMERA, 4)["radiance"].copy()]
    if count:
        with make_renderer(device, scene, SIZE, seed=5) as renderer:
            taken += [renderer.render(CAMERA)["radiance"].copy() for _ in range(count)]
    return taken


@pytest.mark.parametrize("frames", [0, pytest.param(3, marks=pytest.mark.slow)])
def test_queries_and_pipelines_are_equal(frames):
    taken = []
    for way in ("query", "pipeline"):
        with sv.Device(validation=True, rays=way) as device:
            taken.append(pictures_by_way(device, everything(), frames))
    for query, pipeline in zip(*taken, strict=True):
        assert query.tobytes() == pipeline.tobytes()


def test_raster_and_rays_show_the_same(device):
    """All but pixels at the edges of texels and squares, whose points raster snaps."""
    shown = []
    for way in ("raster", "traced"):
        with make_renderer(device, everything(), (64, 64), seed=2, passes=GBUFFER, gbuffer=way) as renderer:
            for _ in range(3):
                renderer.render(CAMERA)
            shown.append(renderer.read("gbuffer_surface")[..., 1])
    assert (shown[0] != shown[1]).mean() < 0.002
    assert len(np.unique(shown[0])) == 4


@pytest.mark.slow
@pytest.mark.parametrize("lighting", [{}, {"restir": True}, SPLIT], ids=["paths", "reuse", "split"])
@pytest.mark.parametrize("lit", ["by a triangle", "by a sphere"])
def test_frames_have_the_path_tracers_mean(device, lighting, lit):
    """Reservoirs choose samples by luminance, so that light which the pane makes red would have much more noise."""
    scene = lamp_among_panes() if lit == "by a sphere" else below_a_pane(alpha=0.5, base_color=(0.2, 1, 0))
    scene.instances[0].material.roughness = 1.0
    right = trace(device, scene, 2048, (16, 16), FLOOR_CAMERA)
    with make_renderer(device, scene, (16, 16), **lighting) as renderer:
        effort = Effort(runs=8, warm_up=24, observed=64)
        runs = run_pictures(renderer, FLOOR_CAMERA, effort, lambda frame: frame["radiance"].mean(axis=(0, 1)))
    for channel, expected in enumerate(right.mean(axis=(0, 1))):
        error, half_width = relative_interval(runs[:, channel], expected)
        assert abs(error) < 0.01 + half_width, (channel, error, half_width)
        assert half_width < 0.03


def lamp_among_panes():
    """FLOOR_CAMERA's floor, and above it a sphere light, a pane and a mirror: the pane is behind the light, and in the
    mirror before it."""
    scene = below_a_pane(alpha=0.5, base_color=(0.3, 1, 0.1))
    _, colored, ceiling = scene.instances
    colored.transform = place(at=(0, 1.5, 0))
    ceiling.material.update(emissive=0.0, base_color=1.0, metallic=1.0, roughness=0.0)
    scene.add(sv.PointLight((0, 1.5, 0), intensity=3.0, radius=0.6))
    return scene


def check_specks(device):
    """Pixels of a still pane tend to the mean of the pane and what is behind it, with 64 frames' binomial noise: of a
    black pane before a lamp, and of a thin one that shines, of which the pixels around often show nothing."""
    passes = (*GBUFFER, "guides/", "solari019/compose", "display/", "taa/")
    thin = sv.Scene(sv.Instance(quad(5.0), sv.Material(base_color=0.0)), pane(0.06))
    thin.instances[1].material.update(emissive=2.0)
    for scene, share in ((before_a_lamp(pane(0.6)), 0.4), (thin, 0.06)):
        with make_renderer(device, scene, SIZE, passes=passes, antialiasing=True, **SPLIT) as renderer:
            for _ in range(64):
                picture = renderer.render(CAMERA)["radiance"][..., 0]
        off = np.abs(picture / 2 - share).max() / math.sqrt(share * (1 - share) * 4 / 3 / 64)
        print(f"{share} of 2 cd/m^2: off by {off:.2f} standard deviations")
        assert off < 5


def test_frames_have_no_specks(device):
    check_specks(device)


def check_gone(device):
    """A thin pane that is moved away leaves nothing behind, though most pixels around showed none of it before."""
    passes = (*GBUFFER, "guides/", "solari019/compose", "display/", "taa/")
    scene = before_a_lamp(pane(0.2))
    with make_renderer(device, scene, SIZE, passes=passes, antialiasing=True, **SPLIT) as renderer:
        for _ in range(64):
            renderer.render(CAMERA)
        scene.instances[1].transform = place(at=(50, 0, 0))
        off = np.abs(renderer.render(CAMERA)["radiance"][..., 0] - 2)
    print(f"off by {off.max():.3f}")
    assert off.max() < 0.08


def test_panes_that_are_moved_leave_nothing(device):
    check_gone(device)


test_a_seeded_bug_is_noticed = bug_tests({
    "light keeps its color": (check_colored_light, Bug(
        "scene/alpha.glsl", "attenuate_by_cover(inout RayTransmittance through, vec4",
        "through.probability *= 1.0 - cover.w;")),
    "one seed for all rays": (check_random_numbers, Bug(
        "scene/trace.glsl", "random_blend_point", "return uvec2(7u);")),
    "frames are independent": (check_even_frames, Bug(
        "passes/gbuffer/pixel.glsl", "pixel_blend_point",
        "return pcg4d(uvec4(correct(pixel), this_frame.index, 0u)).xy;")),
    "chance counts as a change": (check_specks, Bug("passes/taa/history.glsl", "is_blended", "return false;")),
    "panes that are gone are remembered": (check_gone, Bug("passes/taa/history.glsl", "is_blended", "return true;")),
})  # fmt: skip


def test_a_hit_group_without_its_shader_is_noticed():
    """Pipelines ask the any-hit shader."""
    with (
        seeded(Bug("scene/alpha.glsl", "resolve_cover(Material",
                   "return vec4(correct(material, mesh, triangle, barycentrics).rgb, 1.0);")),
        sv.Device(validation=True, rays="pipeline") as device,
        sv.PathTracer(device, before_a_lamp(pane(0.5)), SIZE, max_bounces=0) as tracer,
    ):
        assert not tracer.render(CAMERA, 1)["radiance"].any()
