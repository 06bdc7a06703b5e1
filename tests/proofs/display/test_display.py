"""The displayed picture: exposure, sRGB and tone mapping over sixteen stops; debug views against their buffers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from support.measured import hold
from support.oracles.encodings import decode_srgb, encode_srgb
from support.realtime import OFF, add_up, make_renderer
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.conformance.rules import SUITE, Measurement, Rule, count_wrong
from solari_vk.errors import SolariError
from solari_vk.gpu.device.device import Device
from solari_vk.output import tone_mapping
from solari_vk.passes.debug_views import DEBUG_VIEWS, views_of
from solari_vk.rendered import RenderedFrame
from solari_vk.scene import shapes
from solari_vk.scene.builtin import cornell_box, lamp, rgb

Image = NDArray[Any]
_DEBUG_VIEWS = (SUITE, "Debug views")
EXPOSURE = Rule("white is 1.2 * 2^EV100 cd/m^2, and exposure is linear", "ISO 12232", "saturation-based speed")
SRGB = Rule("colors without tone mapping have the sRGB transfer function", "IEC 61966-2-1", "8 bits")
CURVES = {
    "reinhard": Rule("Reinhard's tone mapping of luminance", "Reinhard et al. 2002", "equation 3"),
    "aces": Rule("the ACES filmic tone mapping", "Narkowicz 2015", "ACES Filmic Tone Mapping Curve"),
    "agx": Rule("the AgX tone mapping", "Wrensch 2023", "Minimal AgX Implementation"),
}
SHOWN = Rule("every debug view shows more than one color", *_DEBUG_VIEWS)
LIGHT = Rule("views of light show the parts of radiance", *_DEBUG_VIEWS)
SURFACE = Rule("views of surfaces and guides show their buffers", *_DEBUG_VIEWS)
NUMBERS = Rule("views of numbers use the colors of Viridis", *_DEBUG_VIEWS)
COLUMNS, ROWS = 16, 12
EV100, EXPOSURES = 6.0, (3.0, 6.0, 9.0)
SIZE = (32, 24)

# ---- the picture ------------------------------------------------------------------------------------


def patches() -> tuple[sv.Scene, Image]:
    """A scene of one emissive square per pixel, sixteen stops around white, and the squares' radiance."""
    rng, scene, half = np.random.default_rng(3), sv.Scene(), 0.5 / ROWS
    stops = rng.permutation(np.linspace(-10, 6, ROWS * COLUMNS))[:, None]
    radiance = 1.2 * 2 ** (EV100 + stops) * rng.uniform(0, 1, (ROWS * COLUMNS, 3))
    for index, color in enumerate(radiance):
        at = (2 * half * (index % COLUMNS - COLUMNS / 2 + 0.5), 2 * half * (ROWS / 2 - 0.5 - index // COLUMNS), -1)
        scene.add(sv.Instance(mesh=shapes.quad(at, (half, 0, 0), (0, half, 0)), material=lamp(color)))
    scene.add(sv.Camera(vertical_fov=2 * np.arctan(0.5)))
    return scene, radiance.reshape(ROWS, COLUMNS, 3)


def measure_picture(device: Device) -> Iterator[Measurement]:
    """Exposure, and the tone curves applied to the frame's own radiance."""
    scene, radiance = patches()
    with make_renderer(device, scene, (COLUMNS, ROWS), **OFF) as renderer:
        for ev100, tonemap in (*((ev100, "none") for ev100 in EXPOSURES), *((EV100, curve) for curve in CURVES)):
            scene.camera.ev100, renderer.tonemap = ev100, tonemap
            frame = renderer.render(scene.camera)
            codes, exposure = frame["display"][..., :3].astype(np.float64), 1 / (1.2 * 2**ev100)
            if tonemap == "none":
                unclipped = (codes > 20) & (codes < 250)
                slope = decode_srgb(codes)[unclipped].sum() / radiance[unclipped].sum()
                note = f"EV100 {ev100:g}"
                yield Measurement(EXPOSURE, abs(slope / exposure - 1), 0.005, "relative error", note)
            exposed = frame["radiance"] * np.float32(exposure)
            expected = encode_srgb(tone_mapping.CURVES[tonemap](exposed))
            error = np.abs(codes - expected).max() if len(np.unique(codes)) > 50 else np.inf
            # Vulkan allows either neighboring code when a value is converted to 8 bits.
            yield Measurement(CURVES.get(tonemap, SRGB), float(error), 1.0, "codes", f"EV100 {ev100:g}")


# ---- debug views ------------------------------------------------------------------------------------

# Views of light and the results that they show, by lighting.
_LIGHT: dict[str, dict[str, tuple[str, ...]]] = {
    "paths": {
        "paths_diffuse": ("paths_diffuse",), "paths_specular": ("paths_specular",), "emission": ("emission",),
        "diffuse_radiance": ("diffuse_radiance",), "specular_radiance": ("specular_radiance",),
    },
    "split": {
        "di": ("di_diffuse", "di_specular"), "gi": ("gi_diffuse",), "specular": ("specular_gi",),
        "diffuse_radiance": ("di_diffuse", "gi_diffuse"), "specular_radiance": ("di_specular", "specular_gi"),
    },
}  # fmt: skip
_SURFACE: dict[str, Callable[[RenderedFrame], Image]] = {
    "roughness": lambda frame: 255 * frame["guides_normal_roughness"][..., 3:],
    "shading_normal": lambda frame: 127.5 + 127.5 * frame["guides_normal_roughness"][..., :3],
    "motion": lambda frame: 127.5 - 255 / 16 * frame["motion_vectors"] * SIZE,
    "guide_roughness": lambda frame: 255 * frame["guides_normal_roughness"][..., 3:],
    "guide_normal": lambda frame: 127.5 + 127.5 * frame["guides_normal_roughness"][..., :3],
    "guide_diffuse_albedo": lambda frame: encode_srgb(frame["guides_diffuse_albedo"][..., :3] / 255),
    "guide_specular_albedo": lambda frame: encode_srgb(frame["guides_specular_albedo"][..., :3] / 255),
    "guide_specular_motion": lambda frame: 127.5 - 255 / 16 * frame["guides_specular_motion"] * SIZE,
}
# Views of numbers, and whether a pixel without a number is black.
_NUMBERS = {
    "depth": False, "guide_depth": False, "cache_lod": False, "cache_samples": True, "cache_life": True,
    "paths_distance": True, "denoise_frames": False, "denoise_noise": False, "di_confidence": False,
    "di_weight": True, "gi_confidence": False, "gi_weight": False,
}  # fmt: skip
# Five colors of Viridis (van der Walt and Smith 2015).
_VIRIDIS = np.array([(68, 1, 84), (58, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37)])


def _is_viridis(codes: Image) -> NDArray[np.bool_]:
    """Whether codes (N, 3) are interpolated between neighboring colors of _VIRIDIS."""
    share = np.linspace(0, 4, 1025)
    ramp = np.stack([np.interp(share, np.arange(5), channel) for channel in _VIRIDIS.T], axis=-1)
    found: NDArray[np.bool_] = np.abs(codes[:, None] - ramp).max(axis=-1).min(axis=-1) <= 2
    return found


def room() -> sv.Scene:
    """A Cornell box with more materials and lights, so that every view should show several colors."""
    scene = cornell_box()
    blocks = {instance.name: instance for instance in scene.instances}
    gold = sv.Material(base_color=rgb((0.9, 0.7, 0.4)), metallic=1.0, perceptual_roughness=0.2)
    blocks["short block"].material = gold
    blocks["tall block"].material = sv.Material(base_color=rgb((0.2, 0.3, 0.9)), emissive=rgb((0.1, 0.3, 0.2)))
    return scene


def measure_views(device: Device) -> Iterator[Measurement]:
    """Renders each view in a frame of its own, and compares it with its buffers; the camera moves between frames."""
    named = {name for views in _LIGHT.values() for name in views}.union(_SURFACE, _NUMBERS)
    if unknown := named - set(DEBUG_VIEWS):
        raise SolariError(f"there are no views {', '.join(sorted(unknown))}: these rules need their new names")
    constant: list[str] = []
    errors: dict[Rule, list[float]] = {LIGHT: [], SURFACE: [], NUMBERS: []}
    for lighting in _LIGHT:
        _measure_views_of(device, lighting, constant, errors)
    yield count_wrong(SHOWN, constant)
    yield Measurement(LIGHT, float(np.max(errors[LIGHT])), 1.0, "codes")
    yield Measurement(SURFACE, float(np.max(errors[SURFACE])), 1.0, "codes")
    yield Measurement(NUMBERS, float(np.sum(errors[NUMBERS])), 0.0, "pixels of other colors")


def _measure_views_of(device: Device, lighting: str, constant: list[str], errors: dict[Rule, list[float]]) -> None:
    """Adds the names of views of one color to `constant`, and each view's error to its rule's in `errors`."""
    scene, lights = room(), _LIGHT[lighting]
    camera = scene.camera
    settings: dict[str, Any] = {"denoise": lighting == "paths", "world_cache_lod_distance": 0.5, "jitter": False}
    with make_renderer(device, scene, SIZE, lighting=lighting, **settings) as renderer:
        for index, view in enumerate(["picture"] * 4 + list(views_of(lighting))):
            renderer.view = view
            moved = camera.transform.copy()
            moved[:3, 3] += (0.2 * np.sin(index), 0, 0.5)
            frame = renderer.render(sv.Camera(transform=moved, vertical_fov=camera.vertical_fov, ev100=camera.ev100))
            there = frame["gbuffer_depth"][..., 0] > 0
            codes = frame["display"][..., :3][there].astype(np.float64)
            if len(np.unique(codes, axis=0)) < 2:
                constant.append(view)
            if view in lights:
                exposed = (add_up(frame, *lights[view]) * camera.exposure)[there].astype(np.float32)
                errors[LIGHT].append(np.abs(codes - encode_srgb(tone_mapping.CURVES["agx"](exposed))).max())
            if view in _SURFACE:
                expected = np.clip(_SURFACE[view](frame)[there], 0, 255)
                errors[SURFACE].append(np.abs(codes[:, : expected.shape[-1]] - expected).max())
            if view in _NUMBERS:
                none = _NUMBERS[view] & (codes == 0).all(axis=-1)
                errors[NUMBERS].append(float((~_is_viridis(codes) & ~none).sum()))


# ---- each rule holds, and can fail --------------------------------------------------------------------

@pytest.mark.parametrize("measure", [measure_picture, pytest.param(measure_views, marks=pytest.mark.slow)],
                         ids=lambda measure: measure.__name__)  # fmt: skip
def test_rules_hold(device, measure):
    hold(measure(device))


TONEMAP, VIEWS = "passes/display/tonemap.glsl", "passes/display/debug_views.glsl"
test_a_seeded_bug_is_noticed = bug_tests({
    EXPOSURE: (measure_picture, Bug(TONEMAP, "show_radiance", "return correct(1.02 * radiance);")),
    SRGB: (measure_picture, Bug(TONEMAP, "encode_srgb", "return pow(linear, vec3(1.0 / 2.2));")),
    CURVES["reinhard"]: (measure_picture, Bug(TONEMAP, "map_reinhard", "return color / (1.0 + color);")),
    CURVES["aces"]: (measure_picture, Bug(TONEMAP, "map_aces", "return correct(1.1 * color);")),
    CURVES["agx"]: (measure_picture, Bug(TONEMAP, "map_agx", "return correct(1.1 * color);")),
    SHOWN: (measure_views, Bug(VIEWS, "show_number", "return vec3(0.5);")),
    LIGHT: (measure_views, Bug(TONEMAP, "show_radiance", "return correct(1.1 * radiance);")),
    SURFACE: (measure_views, Bug(VIEWS, "show_direction", "return 0.5 - 0.5 * direction;")),
    NUMBERS: (measure_views, Bug(VIEWS, "show_share", "return vec3(share, 0.0, 0.0);")),
}, quick=(EXPOSURE,))  # fmt: skip
