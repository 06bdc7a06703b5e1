"""Surfaces with alpha: how often rays pass panes, the color of light behind them, and the pixels of masks."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from support.measured import hold
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.conformance.rules import SUITE, Measurement, Rule
from solari_vk.gpu.device.device import Device
from solari_vk.scene import shapes
from solari_vk.scene.builtin import rgb

SIZE = (32, 32)
CAMERA = sv.Camera(vertical_fov=2 * math.atan(0.5))  # sees a square of 2 x 2 meters in 2 meters
FLOOR_CAMERA = sv.Camera.look_at((0, 0.5, 1e-3), (0, 0, 0))
BLACK: dict[str, Any] = {"base_color": 0.0, "reflectance": 0.0, "roughness": 1.0}
MASK = Rule("a mask covers the pixels whose alpha reaches the cutoff", SUITE, "Alpha")
STRATEGIES = ("nee", "brdf", "mis")


def quad(distance: float, half: float = 10.0) -> sv.Mesh:
    """A square that faces the camera, with v = 0 below."""
    return shapes.quad((0, 0, -distance), (half, 0, 0), (0, half, 0))


def pane(alpha: float, distance: float = 2.0) -> sv.Instance:
    """A black pane before the camera."""
    return sv.Instance(quad(distance), sv.Material(**BLACK, alpha=alpha, alpha_mode="blend"))


def before_a_lamp(*others: sv.Instance) -> sv.Scene:
    """A lamp that fills the picture, behind other things."""
    return sv.Scene(sv.Instance(quad(5.0), sv.Material(base_color=rgb(0.0), emissive=rgb(2.0))), *others)


def below_a_pane(**fields: Any) -> sv.Scene:
    """A floor below a pane below a lamp; FLOOR_CAMERA is between floor and pane."""

    def level(y: float, half: float, side: float) -> sv.Mesh:
        return shapes.quad((0, y, 0), (half, 0, 0), (0, 0, -side * half))

    return sv.Scene(
        sv.Instance(level(0, 10, 1), sv.Material(base_color=rgb(0.5))),
        sv.Instance(level(1, 9, 1), sv.Material(alpha_mode="blend", double_sided=True, **fields)),
        sv.Instance(level(3, 1, -1), sv.Material(base_color=rgb(0.0), emissive=rgb(10.0))),
    )


def checkers(seed: int, count: int = 8) -> sv.Texture:
    """A white texture of count x count texels with random alpha."""
    pixels = np.full((count, count, 4), 255, np.uint8)
    pixels[..., 3] = np.random.default_rng(seed).integers(0, 256, (count, count))
    image = sv.TextureImage(pixels=pixels)
    return sv.Texture(image=image, magnification="nearest", minification="nearest", mipmaps=False)


def cut_out(cutoff: float = 0.4, factor: float = 0.8) -> tuple[sv.Instance, NDArray[np.bool_]]:
    """A glowing mask that fills the picture, and which pixels it covers: the image's first row is below."""
    texture = checkers(3)
    material = sv.Material(
        **BLACK, base_color_texture=texture, alpha=factor, alpha_mode="mask", alpha_cutoff=cutoff,
        emissive=rgb(1.0),
    )  # fmt: skip
    covered = texture.image.pixels[::-1, :, 3] / 255 * factor >= cutoff
    return sv.Instance(quad(2.0, 1.0), material), covered.repeat(4, axis=0).repeat(4, axis=1)


def mean(
    device: Device, scene: sv.Scene, samples: int, camera: sv.Camera = CAMERA, **settings: Any
) -> NDArray[np.float64]:
    """The mean color (3,) of the path tracer's picture."""
    with sv.PathTracer(device, scene, SIZE, **settings) as tracer:
        color: NDArray[np.float64] = tracer.render(camera, samples)["radiance"].mean(axis=(0, 1), dtype=np.float64)
    return color


def measure_panes(device: Device, samples: int = 64) -> Iterator[Measurement]:
    """Panes dim a lamp by their alpha: a mean of independent samples, each all of the lamp's radiance or nothing."""
    for name, alphas in (("one pane", (0.3,)), ("two panes", (0.3, 0.6))):
        panes = [pane(alpha, 2.0 + index) for index, alpha in enumerate(alphas)]
        share = math.prod(1 - alpha for alpha in alphas)
        seen = float(mean(device, before_a_lamp(*panes), samples, max_bounces=0)[0]) / 2
        deviation = math.sqrt(share * (1 - share) / (SIZE[0] * SIZE[1] * samples))
        rule = Rule(f"{name}: rays pass as often as alpha says", SUITE, "Alpha")
        yield Measurement(rule, abs(seen - share) / deviation, 4.0, "standard deviations")


def measure_colored_light(device: Device, samples: int = 256) -> Iterator[Measurement]:
    """Every strategy finds the light of a floor times (1 - alpha) * mix(1, color, alpha)."""
    free = mean(device, below_a_pane(alpha=0.0), samples, FLOOR_CAMERA, max_bounces=1)
    for strategy in STRATEGIES:
        scene = below_a_pane(alpha=0.5, base_color=(1, 0.2, 0))
        lit = mean(device, scene, samples, FLOOR_CAMERA, max_bounces=1, light_strategy=strategy)
        error = float(np.abs(lit / free / (0.5, 0.3, 0.25) - 1).max())
        rule = Rule(f"light takes the color of a pane, {strategy}", SUITE, "Alpha")
        yield Measurement(rule, error, 0.02, "relative error")


def lamp_in_a_mirror(*panes: sv.Instance) -> sv.Scene:
    """CAMERA sees a mirror 2 m away, and in the picture's middle a lamp behind itself, from 2 m to 6 m."""
    mirror = sv.Material(base_color=rgb(1.0), metallic=1.0, roughness=0.0)
    lamp = sv.PointLight(np.array((0, 0, 4), np.float32), intensity=4 * math.pi, radius=2.0)
    return sv.Scene(sv.Instance(quad(2.0), mirror), lamp, *panes)


def measure_lamps(device: Device, samples: int = 256) -> Iterator[Measurement]:
    """Rays that meet a lamp, whose radiance is 1, count the panes before it and not those behind it."""
    for name, distance, expected in (("before", -1.0, 0.25), ("behind", -8.0, 1.0)):
        with sv.PathTracer(device, lamp_in_a_mirror(pane(0.5, distance)), SIZE, max_bounces=1) as tracer:
            found = tracer.render(CAMERA, samples)["radiance"][12:20, 12:20, 0].mean(dtype=np.float64)
        rule = Rule(f"a lamp in a mirror with a pane {name} it", SUITE, "Alpha")
        yield Measurement(rule, abs(float(found) / expected - 1), 0.02, "relative error")


def measure_mask(device: Device) -> Iterator[Measurement]:
    """Camera rays and rays of arrays agree with the alpha texture about every pixel."""
    instance, covered = cut_out()
    scene = before_a_lamp(instance)
    with sv.PathTracer(device, scene, SIZE, max_bounces=0) as tracer:
        wrong = (tracer.render(CAMERA, 1)["emissive"][..., 0] == 1) != covered
    x, y = np.meshgrid((np.arange(32) + 0.5) / 16 - 1, 1 - (np.arange(32) + 0.5) / 16)
    with sv.RayTracer(device, scene) as rays:
        hits = rays.trace(np.zeros(3), np.stack([x, y, np.full_like(x, -2)], axis=-1))
    wrong = wrong | (np.isclose(hits["t"], 1) != covered)
    yield Measurement(MASK, float(wrong.sum()), 0.0, "of 1,024 pixels")


def measure_alpha(device: Device) -> Iterator[Measurement]:
    """All of them."""
    yield from measure_panes(device)
    yield from measure_colored_light(device)
    yield from measure_lamps(device)
    yield from measure_mask(device)


# ---- each rule holds, and can fail --------------------------------------------------------------------

def test_rules_hold(device):
    hold(measure_alpha(device))


ALPHA = "scene/alpha.glsl"
test_a_seeded_bug_is_noticed = bug_tests({
    "rays pass as often as alpha says": (measure_panes, Bug(
        ALPHA, "alpha_threshold", "return square(correct(blend_point, instance_index, triangle, edge));")),
    "light takes colors": (measure_colored_light, Bug(
        ALPHA, "attenuate_by_cover(inout RayTransmittance through, vec4", "through.probability *= 1.0 - cover.w;")),
    "lamps behind panes": (measure_lamps, Bug(
        "scene/walk.glsl", "pass_segment", "segment.passed.radiance = segment.passed.for_reservoir; "
        "return correct(walk, segment, radiance);")),
    MASK: (measure_mask, Bug(ALPHA, "is_met(vec4 cover, uvec2 blend_point, uint instance_index, uint",
                             "return true;")),
}, quick=(MASK,))  # fmt: skip
