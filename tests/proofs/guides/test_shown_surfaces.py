"""Guide images: those in mirrors and through glass against what is shown, albedos, ranges, the parts of the light."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from support.measured import hold
from support.realtime import GUIDES, OFF, PARTS, add_up, make_renderer, odd_scene
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.conformance.rules import SUITE, Measurement, Rule
from solari_vk.gpu.device.device import Device
from solari_vk.passes.guides import IMAGES
from solari_vk.rendered import RenderedFrame
from solari_vk.scene import shapes
from solari_vk.scene.builtin import cornell_box, place, rgb
from solari_vk.scene.matrices import transform_directions

Image = NDArray[Any]
_PSR, _GUIDES = ("Solari in Bevy 0.19", "primary surface replacement"), (SUITE, "Guides")
METAL = Rule("metals have no diffuse albedo", *_GUIDES)
DIFFUSE = Rule("diffuse albedo of a dielectric is its base color", *_GUIDES)
SPECULAR = Rule("a white metal's specular albedo is 1", *_GUIDES)
RANGE = Rule("degenerate and extreme scenes give finite guides, unit or zero normals, roughness 0 to 1", *_GUIDES)
LAMP = Rule("a clear wall before a lamp describes itself", *_GUIDES)
SUM = Rule("diffuse, specular and emission add up to the radiance", *_GUIDES)
BEFORE = Rule("emission is the lamp's radiance at any exposure", *_GUIDES)
SIZE = (48, 48)
# A color, and the roughnesses of three materials, by which their pixels are recognized.
PAINT, GOLD, WHITE_METAL, PLASTIC = (0.25, 0.5, 0.75), 0.35, 0.55, 0.7
LAMP_ROUGHNESS = 0.9
# Mirrors in the order in which the camera sees them: position, normal, and half of the side's length. The normals'
# components are whole numbers that add up to 2047, so that the G-buffer holds the normals exactly.
MIRRORS = {
    "one mirror": [((0, 0, 0), (300, 150, 1597), 2.0)],
    "two mirrors": [((0, 0, 0), (-1023, 0, 1024), 1.5), ((-3, 0, 0), (1024, 20, -1003), 3.0)],
}


class Setup(NamedTuple):
    """The transforms of one frame: world from camera, and world from each mirror, whose normal is its z axis."""

    camera: Image
    mirrors: list[Image]

    @classmethod
    def of(cls, name: str, moved: float) -> Setup:
        """The mirrors with this name and a camera in front of the first one, all moved by some centimeters."""
        aside = moved * np.array((0.04, -0.03, 0.02))
        mirrors = [
            _look(np.subtract(at, aside), np.asarray(facing) / 2047 - aside, half) for at, facing, half in MIRRORS[name]
        ]
        return cls(_look((0, 0, 3) + 2 * aside, (0, 0, 1) + 0.2 * aside), mirrors)

    @property
    def reflection(self) -> Image:
        """The matrix from real to virtual positions: the product of the mirrors' reflections, the first one's last."""
        chain = np.eye(4)
        for mirror in self.mirrors:
            normal = mirror[:3, 2] / np.linalg.norm(mirror[:3, 2])
            householder = np.eye(4)
            householder[:3, :3] -= 2 * np.outer(normal, normal)
            householder[:3, 3] = 2 * normal * (normal @ mirror[:3, 3])
            chain = chain @ householder
        return chain

    def camera_behind(self) -> sv.Camera:
        """The mirrored camera, which sees directly what the camera sees in the mirrors."""
        return _camera(np.linalg.inv(self.reflection) @ self.camera)


def _look(at: Image, z_axis: Image, scale: float = 1.0) -> Image:
    """World from an object (4, 4) with this z axis."""
    return sv.Camera.look_at(at, at - z_axis).transform @ np.diag((scale, scale, 1, 1))


def _camera(transform: Image) -> sv.Camera:
    return sv.Camera(transform=transform, vertical_fov=0.4)


def things() -> list[sv.Instance]:
    """What a camera at the origin sees: a wall, two balls of metal and a box; the box is last."""
    ball, box = shapes.sphere(0.8, 32), shapes.box()
    gold = sv.Material(base_color=rgb((0.9, 0.6, 0.2)), metallic=1.0, perceptual_roughness=GOLD)
    white = sv.Material(base_color=rgb(1.0), metallic=1.0, perceptual_roughness=WHITE_METAL)
    paint = sv.Material(base_color=rgb(PAINT), perceptual_roughness=PLASTIC)
    return [
        sv.Instance(mesh=shapes.quad((0, 0, -12), (6, 0, 0), (0, 6, 0)), material=sv.Material(base_color=rgb(0.3))),
        sv.Instance(mesh=ball, material=gold, transform=place(at=(-0.9, 0.6, -9))),
        sv.Instance(mesh=ball, material=white, transform=place(at=(0.9, 0.6, -9))),
        sv.Instance(mesh=box, material=paint, transform=place(1.0, (0, -0.8, -8.5), 0.5)),
    ]


def _read(frame: RenderedFrame) -> dict[str, Image]:
    """The guides; albedos are 8-bit codes."""
    found = {name: np.squeeze(frame[f"guides_{name}"]).astype(np.float64) for name in IMAGES}
    return {name: values[..., :3] if "albedo" in name else values for name, values in found.items()}


def _take(device: Device, before: Setup, now: Setup) -> tuple[dict[str, Image], dict[str, Image]]:
    """The guides of the second of two frames: through mirrors, and of the mirrored camera without mirrors."""
    seen_from, scene = now.camera_behind().transform, sv.Scene()
    for thing in (seen := things()):
        scene.add(thing).update(transform=seen_from @ thing.transform)
    mirror = sv.Material(metallic=1.0, perceptual_roughness=0.0)
    pane = shapes.quad((0, 0, 0), (1, 0, 0), (0, 1, 0))
    panes = [scene.add(sv.Instance(mesh=pane, material=mirror, transform=at)) for at in before.mirrors]
    placed, moved = seen[-1].transform.copy(), seen_from @ place((1.1, 1, 1), (0.1, -0.75, -8.4), 0.6)
    with make_renderer(device, scene, SIZE, passes=GUIDES, **OFF) as renderer:
        renderer.render(_camera(before.camera))
        seen[-1].update(transform=moved)
        for thing, at in zip(panes, now.mirrors, strict=True):
            thing.update(transform=at)
        shown = _read(renderer.render(_camera(now.camera)))
        for thing in panes:
            scene.remove(thing)
        seen[-1].update(transform=placed)
        renderer.render(before.camera_behind())
        seen[-1].update(transform=moved)
        return shown, _read(renderer.render(now.camera_behind()))


def measure_mirrors(device: Device, name: str) -> Iterator[Measurement]:
    """Guides in mirrors equal those of the mirrored camera while everything moves, and hold the right materials."""
    before, now = Setup.of(name, 1.0), Setup.of(name, 0.0)
    shown, seen = _take(device, before, now)
    for what, (worst, bar, unit) in _differences(shown, seen, now.reflection).items():
        rule = Rule(f"{name}: {what} equal those of the mirrored camera", *_PSR)
        yield Measurement(rule, worst, bar, f"{unit} in 98 % of pixels")
    for guides in (shown, seen):
        yield from _measure_materials(guides, name)


def _differences(
    shown: dict[str, Image], seen: dict[str, Image], reflection: Image, among: Image | None = None
) -> dict[str, tuple[float, float, str]]:
    """The differences between what mirrors or glass show and what is seen directly, reflected: by guide the difference
    in 98 % of the pixels `among` (all), since rays and raster may find an edge in neighboring pixels; bar; and unit."""
    shown_normal, seen_normal = (guides["normal_roughness"][..., :3] for guides in (shown, seen))
    seen_normal = transform_directions(reflection, seen_normal)
    errors = {
        "diffuse albedos": (shown["diffuse_albedo"] - seen["diffuse_albedo"], 1.0, "codes"),
        "specular albedos": (shown["specular_albedo"] - seen["specular_albedo"], 1.0, "codes"),
        "virtual normals": (shown_normal - seen_normal, 2e-3, "of 1"),
        "virtual depths": (shown["depth"] / seen["depth"] - 1, 1e-4, "relative error"),
        "specular motion": ((shown["specular_motion"] - seen["motion"]) * SIZE, 1 / 16, "of a pixel"),
    }
    found = {}
    for what, (error, bar, unit) in errors.items():
        worst = np.abs(error).reshape(*SIZE, -1).max(axis=-1)
        found[what] = (float(np.quantile(worst if among is None else worst[among], 0.98)), bar, unit)
    return found


def measure_wall(device: Device) -> Iterator[Measurement]:
    """Through a clear wall of glass, guides are those without it while everything moves; before a lamp, its own."""
    glass = sv.Material(base_color=rgb((0.9, 0.8, 0.7)), transmission=1.0, perceptual_roughness=0.0, double_sided=True)
    lamp = sv.Material(base_color=rgb(0.0), emissive=rgb(1.0), perceptual_roughness=LAMP_ROUGHNESS)
    wall = sv.Instance(shapes.quad((0, 0, -4), (2, 0, 0.5), (0, 2, 0)), glass)
    scene = sv.Scene(wall, *things(), sv.Instance(shapes.quad((0, 1.6, -10), (2, 0, 0), (0, 0.2, 0)), lamp))
    box, taken = scene.instances[4], []
    with make_renderer(device, scene, SIZE, passes=GUIDES, **OFF) as renderer:
        for visible in (True, False):
            for moved in (0.1, 0.0):
                wall.update(visible=visible, transform=place(at=(0, moved, 0)))
                box.update(transform=place(1.0, (moved, -0.8, -8.5), 0.5 + moved))
                frame = renderer.render(_camera(place(at=(moved, moved / 2, 0))))
            taken.append(_read(frame))
    shown, seen = taken
    of_lamp = np.abs(seen["normal_roughness"][..., 3] - LAMP_ROUGHNESS) < 0.004
    for what, (worst, bar, unit) in _differences(shown, seen, np.eye(4), ~of_lamp).items():
        rule = Rule(f"through a clear wall: {what} equal those without it", *_GUIDES)
        yield Measurement(rule, worst, bar, f"{unit} in 98 % of pixels")
    wrong = shown["normal_roughness"][of_lamp][:, 3] != 0
    yield Measurement(LAMP, float(wrong.mean()) if wrong.size > 50 else np.inf, 0.02, "of its pixels")


def _measure_materials(guides: dict[str, Image], name: str) -> Iterator[Measurement]:
    """Checks the guides of balls and box against their materials."""

    def of(image: str, roughness: float) -> Image:
        pixels = guides[image][np.abs(guides["normal_roughness"][..., 3] - roughness) < 0.004]
        return pixels if len(pixels) >= 30 else np.full((1, 3), np.inf)

    metals = np.concatenate([of("diffuse_albedo", GOLD), of("diffuse_albedo", WHITE_METAL)])
    yield Measurement(METAL, float(metals.max()), 0.0, "codes", name)
    painted, white = of("diffuse_albedo", PLASTIC) - 255 * np.array(PAINT), of("specular_albedo", WHITE_METAL) - 255
    yield Measurement(DIFFUSE, float(np.abs(painted).max()), 1.0, "codes", name)
    yield Measurement(SPECULAR, float(np.abs(white).max()), 2.0, "codes", name)


def measure_range(device: Device) -> Iterator[Measurement]:
    """Checks the ranges of values by which denoisers divide, or which they use for lookups."""
    scene, wrong = odd_scene(), 0
    with make_renderer(device, scene, (24, 24), passes=GUIDES, **{**OFF, "jitter": True}) as renderer:
        for _ in range(4):
            frame = renderer.render(scene.camera)
            images = {name: frame[f"guides_{name}"].astype(np.float64) for name in IMAGES}
            wrong += sum(int((~np.isfinite(image)).sum()) for image in images.values())
            length = np.linalg.norm(images["normal_roughness"][..., :3], axis=-1)
            roughness = images["normal_roughness"][..., 3]
            wrong += int(((np.abs(length - 1) > 2e-3) & (length > 0)).sum())
            wrong += int(((roughness < 0) | (roughness > 1)).sum()) + int((images["depth"] < 0).sum())
    yield Measurement(RANGE, float(wrong), 0.0, "values")


def measure_parts(device: Device) -> Iterator[Measurement]:
    """In a Cornell box, the parts add up to the radiance and don't depend on exposure."""
    scene, color = cornell_box(), np.array((17.0, 12.0, 4.0))
    apart, off = [], []
    with make_renderer(device, scene, jitter=False) as renderer:
        for ev100 in (-6.0, 0.0, 7.3):
            scene.camera.ev100 = ev100
            frame = renderer.render(scene.camera)
            whole = frame["radiance"].astype(np.float64)
            apart.append(np.abs(add_up(frame, "emission", *PARTS) - whole).max() / whole.max())
            emitted = frame["emission"].astype(np.float64)
            lamp = emitted[emitted.max(axis=-1) > 0]
            off.append(np.abs(lamp - color).max() / color.max() if len(lamp) else np.inf)
    yield Measurement(SUM, float(max(apart)), 1e-6, "of the brightest")
    yield Measurement(BEFORE, float(np.max(off)), 2.0**-9, "of its largest channel")


# ---- each rule holds, and can fail --------------------------------------------------------------------

@pytest.mark.parametrize("name", [name if name == "one mirror" else pytest.param(name, marks=pytest.mark.slow)
                                  for name in MIRRORS])  # fmt: skip
def test_mirrors(device, name):
    hold(measure_mirrors(device, name))


@pytest.mark.parametrize("measure", [
    measure_wall, pytest.param(measure_range, marks=pytest.mark.slow), measure_parts
], ids=lambda measure: measure.__name__)  # fmt: skip
def test_rules_hold(device, measure):
    hold(measure(device))


WRITE, MIRRORS_FILE = "passes/guides/write.comp", "passes/guides/mirrors.glsl"


def one_mirror(device):
    return measure_mirrors(device, "one mirror")


test_a_seeded_bug_is_noticed = bug_tests({
    "mirrors": (one_mirror, Bug(MIRRORS_FILE, "append_mirror", "return chain;")),
    "motion in mirrors": (one_mirror, Bug(MIRRORS_FILE, "previous_hit_position", "return world_position + 0.1;")),
    METAL: (one_mirror, Bug(
        WRITE, "describe", "correct(guides, material, NdotV); guides.diffuse_albedo = material.base_color;")),
    DIFFUSE: (one_mirror, Bug(
        WRITE, "describe", "correct(guides, material, NdotV); guides.diffuse_albedo *= 0.9;")),
    SPECULAR: (one_mirror, Bug(
        WRITE, "describe", "correct(guides, material, NdotV); guides.specular_albedo *= 0.9;")),
    "clear walls": (measure_wall, Bug(WRITE, "is_clear_wall", "return false;")),
    RANGE: (measure_range, Bug(
        WRITE, "describe", "correct(guides, material, NdotV); guides.perceptual_roughness = 1.0 / 0.0;")),
    SUM: (measure_parts, Bug("passes/display/emission.glsl", "visible_emission", "return 2.0 * correct(pixel);")),
})  # fmt: skip
