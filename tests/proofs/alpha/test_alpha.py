"""Masks and blended surfaces: closed forms, the same surfaces for all rays, random numbers, and seeded bugs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.frames import GBUFFER, SPLIT_LIGHTING, Effort, make_renderer, observe_runs, path_traced
from support.seeded_bugs import Bug, bug_tests, seeded
from support.statistics import relative_interval

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import place
from solari_vk.settings import RAW

SIZE = (32, 32)
CAMERA = sv.Camera(vertical_fov=2 * math.atan(0.5))  # sees a square of 2 x 2 meters in 2 meters
FLOOR_CAMERA = sv.Camera.look_at((0, 0.5, 1e-3), (0, 0, 0))
BLACK = {"base_color": 0.0, "reflectance": 0.0, "roughness": 1.0}
SHOWN = (*GBUFFER, "guides/", "denoise/reflection_motion", "display/", "taa/")  # visible emission alone


def quad(distance, half=10.0):
    """A square that faces the camera, with v = 0 below."""
    return shapes.quad((0, 0, -distance), (half, 0, 0), (0, half, 0))


def pane(alpha, distance=2.0):
    """A black pane before the camera."""
    return sv.Instance(quad(distance), sv.Material(**BLACK, alpha=alpha, alpha_mode="blend"))


def before_a_lamp(*others):
    """A lamp of 2 cd/m^2 that fills the picture, behind other things."""
    return sv.Scene(sv.Instance(quad(5.0), sv.Material(base_color=0.0, emissive=2.0)), *others)


def below_a_pane(**fields):
    """A floor below a pane below a lamp; FLOOR_CAMERA is between floor and pane."""

    def level(y, half, side):
        return shapes.quad((0, y, 0), (half, 0, 0), (0, 0, -side * half))

    return sv.Scene(
        sv.Instance(level(0, 10, 1), sv.Material(base_color=0.5)),
        sv.Instance(level(1, 9, 1), sv.Material(alpha_mode="blend", double_sided=True, **fields)),
        sv.Instance(level(3, 1, -1), sv.Material(base_color=0.0, emissive=10.0)),
    )


def lamp_in_a_mirror(*panes):
    """CAMERA sees a mirror 2 m away, and in the picture's middle a lamp behind itself, from 2 m to 6 m."""
    mirror = sv.Material(base_color=1.0, metallic=1.0, roughness=0.0)
    lamp = sv.PointLight((0, 0, 4), intensity=4 * math.pi, radius=2.0)
    return sv.Scene(sv.Instance(quad(2.0), mirror), lamp, *panes)


def lamp_among_panes():
    """FLOOR_CAMERA's floor, and above it a sphere light, a pane and a mirror: the pane is behind the light, and in the
    mirror before it."""
    scene = below_a_pane(alpha=0.5)
    _, blended, ceiling = scene.instances
    blended.transform = place(at=(0, 1.5, 0))
    ceiling.material.update(emissive=0.0, base_color=1.0, metallic=1.0, roughness=0.0)
    scene.add(sv.PointLight((0, 1.5, 0), intensity=3.0, radius=0.6))
    return scene


def checkers(seed, count=8):
    """A white texture of count x count texels with random alpha."""
    pixels = np.full((count, count, 4), 255, np.uint8)
    pixels[..., 3] = np.random.default_rng(seed).integers(0, 256, (count, count))
    image = sv.TextureImage(pixels=pixels)
    return sv.Texture(image=image, magnification="nearest", minification="nearest", mipmaps=False)


def everything():
    """A mask, two panes and vertex colors before a lit floor."""
    mesh = quad(4.0, 3.0)
    colors = np.random.default_rng(1).uniform(0.2, 1, (len(mesh.positions), 4))
    ground = sv.Mesh(mesh.positions, mesh.triangles, normals=mesh.normals, colors=colors)
    mask = sv.Material(base_color_texture=checkers(5), alpha_mode="mask", alpha_cutoff=0.5)
    lamp = shapes.quad((0, 2, -1), (0.5, 0, 0), (0, 0, 0.5))
    return sv.Scene(
        sv.Instance(ground),
        sv.Instance(quad(2.5, 0.6), mask),
        sv.Instance(lamp, sv.Material(base_color=0.0, emissive=30.0)),
        sv.Instance(quad(2.0, 0.4), sv.Material(base_color=(1, 0.3, 0.1), alpha=0.4, alpha_mode="blend")),
        sv.Instance(quad(3.0, 0.8), sv.Material(alpha=0.6, alpha_mode="blend", double_sided=True)),
    )


# ---- the path tracer --------------------------------------------------------------------------------


def mean(device, scene, samples, camera=CAMERA, **settings):
    """The mean color (3,) of the path tracer's picture."""
    return path_traced(device, scene, samples, SIZE, camera, **settings).mean(axis=(0, 1))


def check_panes(device):
    """Panes dim a lamp by their alpha: a mean of independent samples, each all of the lamp's radiance or nothing."""
    for alphas in ((0.3,), (0.3, 0.6)):
        panes = [pane(alpha, 2.0 + index) for index, alpha in enumerate(alphas)]
        share = math.prod(1 - alpha for alpha in alphas)
        seen = mean(device, before_a_lamp(*panes), 64, max_bounces=0)[0] / 2
        assert abs(seen - share) < 4 * math.sqrt(share * (1 - share) / (32 * 32 * 64)), alphas


def check_light_through_a_pane(device):
    """Every strategy finds the light of a floor times 1 - alpha, whatever the pane's color."""
    scene = below_a_pane(alpha=0.5, base_color=(1, 0.2, 0))
    scene.instances[1].visible = False
    free = mean(device, scene, 256, FLOOR_CAMERA, max_bounces=1)
    scene.instances[1].visible = True
    for strategy in ("nee", "brdf", "mis"):
        lit = mean(device, scene, 256, FLOOR_CAMERA, max_bounces=1, light_strategy=strategy)
        np.testing.assert_allclose(lit / free, [0.5] * 3, rtol=0.02, err_msg=strategy)


def check_lamps(device):
    """Rays that meet a lamp, whose radiance is 1, count the panes before it and not those behind it."""
    for distance, expected in ((-1.0, 0.5), (-8.0, 1.0)):
        picture = path_traced(device, lamp_in_a_mirror(pane(0.5, distance)), 256, SIZE, CAMERA, max_bounces=1)
        assert picture[12:20, 12:20, 0].mean() == pytest.approx(expected, rel=0.02)


def check_mask(device):
    """Camera rays and rays of arrays agree with the alpha texture about every pixel."""
    texture = checkers(3)
    cutoff = 0.4
    factor = 0.8
    material = sv.Material(**BLACK, base_color_texture=texture, alpha=factor, emissive=1.0)
    material.update(alpha_mode="mask", alpha_cutoff=cutoff)
    covered = texture.image.pixels[::-1, :, 3] / 255 * factor >= cutoff  # the image's first row is below
    covered = covered.repeat(4, axis=0).repeat(4, axis=1)
    scene = before_a_lamp(sv.Instance(quad(2.0, 1.0), material))
    seen = path_traced(device, scene, 1, SIZE, CAMERA, max_bounces=0)
    np.testing.assert_array_equal(seen[..., 0] == 1, covered)
    x, y = np.meshgrid((np.arange(32) + 0.5) / 16 - 1, 1 - (np.arange(32) + 0.5) / 16)
    with sv.RayTracer(device, scene) as rays:
        hits = rays.trace(np.zeros(3), np.stack([x, y, np.full_like(x, -2)], axis=-1))
    np.testing.assert_array_equal(np.isclose(hits["t"], 1), covered)


def passes(device, seed):
    """Which pixels' rays pass a pane that covers half of what lies behind, less the mean."""
    return (
        path_traced(device, before_a_lamp(pane(0.5)), 1, (64, 64), CAMERA, max_bounces=0, seed=seed)[..., 0] > 0
    ) - 0.5


def check_random_numbers(device):
    """Pixels and seeds have independent random numbers."""
    first, second = passes(device, 0), passes(device, 1)
    np.testing.assert_array_equal(first, passes(device, 0))
    limit = 4 / math.sqrt(first.size)
    for other in (second, np.roll(first, 1, axis=0), np.roll(first, 1, axis=1), np.roll(second, 1, axis=1)):
        assert abs(np.mean(first * other)) * 4 < limit


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


def test_rays_to_lamps_through_panes_are_counted(device):
    """A camera ray, one from the mirror, one to what it passes, and one more where it meets the lamp."""
    with sv.PathTracer(device, lamp_in_a_mirror(pane(0.5, -8.0)), SIZE, max_bounces=1) as tracer:
        lit = (tracer.render(CAMERA, 1)["radiance"][..., 0] > 0).sum()
        assert 0 < lit < 500
        assert tracer.rays == 3 * 1024 + lit


# ---- frames -----------------------------------------------------------------------------------------


def check_even_frames(device):
    """Frames show panes evenly over pixels and over time: with less error than the binomial noise of random numbers.
    Two panes have independent thresholds."""
    for alphas, over_time in (((0.6,), 0.5), ((0.3, 0.6), 0.8)):
        share = math.prod(1 - alpha for alpha in alphas)
        scene = before_a_lamp(*(pane(alpha, 2.0 + index) for index, alpha in enumerate(alphas)))
        with make_renderer(device, scene, (64, 64), passes=SHOWN, **SPLIT_LIGHTING) as renderer:
            frames = np.array([renderer.render(CAMERA)["radiance"][..., 0] / 2 for _ in range(64)])
        noise = math.sqrt(share * (1 - share))
        blocks = frames.reshape(64, 16, 4, 16, 4).mean(axis=(2, 4))
        errors = [float(np.sqrt(np.mean((found - share) ** 2))) for found in (frames[:8].mean(axis=0), blocks)]
        ratios = [error / noise * math.sqrt(count) for error, count in zip(errors, (8, 16), strict=True)]
        print(alphas, f"8 frames {ratios[0]:.2f}, 4 x 4 pixels {ratios[1]:.2f}, mean {frames.mean() / share:.3f}")
        assert ratios[0] < over_time
        assert ratios[1] < 0.8
        assert abs(frames.mean() - share) < 0.01


def check_specks(device):
    """Pixels of a still pane tend to the mean of the pane and what is behind it, with 64 frames' binomial noise: of a
    black pane before a lamp, and of a thin one that shines, of which the pixels around often show nothing."""
    thin = sv.Scene(sv.Instance(quad(5.0), sv.Material(base_color=0.0)), pane(0.06))
    thin.instances[1].material.update(emissive=2.0)
    for scene, share in ((before_a_lamp(pane(0.6)), 0.4), (thin, 0.06)):
        with make_renderer(device, scene, SIZE, passes=SHOWN, antialiasing=True, **SPLIT_LIGHTING) as renderer:
            for _ in range(64):
                picture = renderer.render(CAMERA)["radiance"][..., 0]
        off = np.abs(picture / 2 - share).max() / math.sqrt(share * (1 - share) * 4 / 3 / 64)
        print(f"{share} of 2 cd/m^2: off by {off:.2f} standard deviations")
        assert off < 5


def check_gone(device):
    """A thin pane that is moved away leaves nothing behind, though most pixels around showed none of it before."""
    scene = before_a_lamp(pane(0.2))
    with make_renderer(device, scene, SIZE, passes=SHOWN, antialiasing=True, **SPLIT_LIGHTING) as renderer:
        for _ in range(64):
            renderer.render(CAMERA)
        scene.instances[1].transform = place(at=(50, 0, 0))
        off = np.abs(renderer.render(CAMERA)["radiance"][..., 0] - 2)
    print(f"off by {off.max():.3f}")
    assert off.max() < 0.08


@pytest.mark.slow  # the driver compiles a whole frame
def test_frames_count_rays_through_panes(device):
    """The first rays of paths: one from the mirror, one to what it passes, and one more where it meets the lamp."""
    scene = lamp_in_a_mirror(pane(0.5, -8.0))
    with sv.Renderer(device, scene, SIZE, sv.Settings(**RAW), count_rays=True) as renderer:
        lit = (renderer.render(CAMERA)["radiance"][..., 0] > 0.9).sum()
        assert 0 < lit < 500
        row = renderer.counted_passes.index("paths/first_ray")
        assert renderer["ray_counts"][row] == 2 * 1024 + lit


@pytest.mark.slow
@pytest.mark.parametrize("lighting", [{}, {"restir": True}, SPLIT_LIGHTING], ids=["paths", "reuse", "split"])
@pytest.mark.parametrize("lit", ["by a triangle", "by a sphere"])
def test_frames_have_the_path_tracers_mean(device, lighting, lit):
    scene = lamp_among_panes() if lit == "by a sphere" else below_a_pane(alpha=0.5)
    scene.instances[0].material.roughness = 1.0
    right = path_traced(device, scene, 2048, (16, 16), FLOOR_CAMERA)
    with make_renderer(device, scene, (16, 16), **lighting) as renderer:
        effort = Effort(runs=8, warm_up=24, observed=64)
        runs = observe_runs(renderer, FLOOR_CAMERA, effort, lambda frame: frame["radiance"].mean(axis=(0, 1)))
    for channel, expected in enumerate(right.mean(axis=(0, 1))):
        error, half_width = relative_interval(runs[:, channel], expected)
        assert abs(error) < 0.01 + half_width, (channel, error, half_width)
        assert half_width < 0.03


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
    glass = pane(0.5)
    scene, stage = sv.Scene(glass), sv.Stage("before", buffers={"answer": 1}, passes=[sv.Pass("before", threads=1)])
    seen = []
    with sv.SceneFrame(device, scene, [stage], glsl_root=tmp_path) as frame:
        frame.binder.keep_previous_tlas(frame, True)
        for visible in (True, True, False, False, True, True):
            glass.visible = visible
            frame.submit()
            seen.append(frame["answer"][0].copy())
        frame.binder.keep_previous_tlas(frame, False)
    np.testing.assert_allclose(seen[1:], np.outer((0.5, 0.5, 1, 1, 0.5), np.ones(3)), atol=1e-6)


# ---- the same surfaces for all ----------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("frames", [0, 3])
def test_queries_and_pipelines_are_equal(frames):
    """The path tracer's picture, and some frames of the realtime renderer."""
    taken = []
    for way in ("query", "pipeline"):
        with sv.Device(validation=True, rays=way) as device:
            taken.append([path_traced(device, everything(), 4, SIZE, CAMERA, seed=5)])
            if frames:
                with make_renderer(device, everything(), SIZE, seed=5) as renderer:
                    taken[-1] += [renderer.render(CAMERA)["radiance"].copy() for _ in range(frames)]
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


# ---- each check holds, and can fail -----------------------------------------------------------------

CHECKS = (
    check_panes,
    check_light_through_a_pane,
    check_lamps,
    check_mask,
    check_random_numbers,
    check_even_frames,
    check_specks,
    check_gone,
)


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_holds(device, check):
    check(device)


ALPHA, HISTORY = "scene/alpha.glsl", "passes/taa/history.glsl"
test_a_seeded_bug_is_noticed = bug_tests(
    {
        "rays pass as often as alpha says": (
            check_panes,
            Bug(ALPHA, "alpha_threshold", "return square(correct(alpha_seed, instance_index, triangle, edge));"),
        ),
        "light keeps its color": (
            check_light_through_a_pane,
            Bug(
                ALPHA,
                "attenuate_by_surface(inout RayTransmittance through, vec4",
                "through.weight *= vec3(1.0, 0.6, 0.5); through.probability *= 1.0 - filter_opacity.w;",
            ),
        ),
        "lamps behind panes": (
            check_lamps,
            Bug(
                "scene/walk.glsl",
                "accumulate_segment",
                "segment.along_ray.radiance = segment.along_ray.radiance_over_probability; "
                "return correct(walk, segment, receiver, radiance);",
            ),
        ),
        "masks cover pixels": (
            check_mask,
            Bug(ALPHA, "accepts_hit(float opacity, uvec2 alpha_seed, uint instance_index, uint", "return true;"),
        ),
        "one seed for all rays": (
            check_random_numbers,
            Bug("scene/trace.glsl", "random_alpha_seed", "return uvec2(7u);"),
        ),
        "frames are independent": (
            check_even_frames,
            Bug(
                "passes/gbuffer/pixel.glsl",
                "pixel_alpha_seed",
                "return pcg4d(uvec4(correct(pixel), this_frame.index, 0u)).xy;",
            ),
        ),
        "chance counts as a change": (check_specks, Bug(HISTORY, "is_blended", "return false;")),
        "panes that are gone are remembered": (check_gone, Bug(HISTORY, "is_blended", "return true;")),
    },
    quick=("masks cover pixels",),
)


def test_a_hit_group_without_its_shader_is_noticed():
    """Pipelines ask the any-hit shader."""
    opaque = "return vec4(correct(material, mesh, triangle, barycentrics).rgb, 1.0);"
    bug = Bug(ALPHA, "resolve_color_opacity(Material", opaque)
    with seeded(bug), sv.Device(validation=True, rays="pipeline") as device:
        assert not path_traced(device, before_a_lamp(pane(0.5)), 4, SIZE, CAMERA, max_bounces=0).any()
