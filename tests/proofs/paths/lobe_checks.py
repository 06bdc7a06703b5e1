"""The light of each lobe of a path's first surface, its demodulation, its distance, and light by mirrors."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from support import brdf_runs
from support.oracles.closed_forms import camera_rays
from support.realtime import (
    JITTER_PERIOD,
    PATHS,
    PLAIN,
    Effort,
    Image,
    make_renderer,
    measure_mean,
    read_radiance,
    run_pictures,
)

import solari_vk as sv
from solari_vk.conformance.rules import SUITE, Measurement, Rule
from solari_vk.conformance.shader_runner import ShaderRunner
from solari_vk.gpu.device.device import Device
from solari_vk.rendered import RenderedFrame
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, rgb

_PATHS = (SUITE, "Paths")
METAL = Rule("metals have no diffuse light", *_PATHS)
MIRRORS = Rule("bounces at mirrors count for nothing but their Fresnel terms", *_PATHS)
CHAIN = Rule("light comes whole by many mirrors in a row", *_PATHS)
MIRROR_DISTANCE = Rule("the distance of a mirror's light is the length of the reflected ray", *_PATHS)
LOBES = Rule("each lobe reflects as much white light as its albedo says", *_PATHS)
DEMODULATION = Rule("demodulated light times the surface's albedo is the lobe's radiance", *_PATHS)
DISTANCE = Rule("the distances of diffuse light are those of rays with a cosine distribution", *_PATHS)
OWN_DISTANCE = Rule("the distance belongs to the lobe that proposed the ray", *_PATHS)
SIZE = (32, 32)
# Light that leaves the first surface after one bounce.
ONE_BOUNCE: dict[str, Any] = {**PLAIN, "paths_bounces": 1}


def metal(color: tuple[float, ...], perceptual_roughness: float) -> sv.Material:
    """A metal of this color."""
    return sv.Material(base_color=rgb(color), metallic=1.0, perceptual_roughness=perceptual_roughness)


# ---- mirrors ----------------------------------------------------------------------------------------


_HALF = 2.0  # of the side of the cube below, in meters
_SIDES = {"left": (0, -1), "right": (0, 1), "floor": (1, -1), "ceiling": (1, 1), "back": (2, -1), "front": (2, 1)}
Colors = dict[str, tuple[float, float, float]]
_CORNER: Colors = {"floor": (0.9, 0.6, 0.3), "back": (0.5, 0.8, 0.95)}
# White, so that Russian roulette ends no path.
_RING: Colors = dict.fromkeys(("floor", "ceiling", "back", "front"), (1.0, 1.0, 1.0))
_MOST_MIRRORS = 32
_GLOWS: Colors = {"left": (1.0, 0.2, 0.1), "right": (0.1, 1.0, 0.3), "ceiling": (0.3, 0.2, 1.0),
                  "front": (1.0, 0.9, 0.2)}  # fmt: skip


def _mirror_cube(mirrors: Colors) -> sv.Scene:
    """The inside of a cube, of which some sides are metal mirrors of these colors; the others glow."""
    scene = sv.Scene(sv.Camera.look_at((0.31, 0.43, 0.87), (-0.2, -1.9, -1.8), vertical_fov=1.2))
    for name, (axis, sign) in _SIDES.items():
        normal, u = -sign * np.eye(3)[axis], np.eye(3)[axis - 2]
        mesh = shapes.quad(_HALF * sign * np.eye(3)[axis], _HALF * u, _HALF * np.cross(normal, u))
        material = metal(mirrors[name], 0.0) if name in mirrors else lamp(_GLOWS[name])
        scene.add(sv.Instance(mesh=mesh, material=material, name=name))
    return scene


def _look_into_cube(camera: sv.Camera, mirrors: Colors) -> tuple[Image, Image, Image]:
    """The radiance (32, 32, 3); the length (32, 32) of the first reflected ray, NaN where no mirror is seen; and the
    number of mirrors (32, 32) until a side glows, _MOST_MIRRORS where none of the first ones does."""
    (places, along), names = camera_rays(camera, *SIZE), list(_SIDES)
    weight, radiance = np.ones((*SIZE, 3)), np.zeros((*SIZE, 3))
    length, count = np.full(SIZE, np.nan), np.zeros(SIZE, int)
    inside = np.ones(SIZE, bool)
    for ray in range(_MOST_MIRRORS):
        sides = np.where(along < 0, -_HALF, _HALF)
        to_sides = (sides - places) / along
        axis, t = to_sides.argmin(axis=-1), to_sides.min(axis=-1)
        if ray == 1:
            length = np.where(inside, t, np.nan)
        places = places + t[..., None] * along
        met = 2 * axis + (np.take_along_axis(along, axis[..., None], -1)[..., 0] > 0)
        cosine = np.abs(np.take_along_axis(along, axis[..., None], -1))
        for at, name in enumerate(names):
            here = inside & (met == at)
            if name not in mirrors:
                radiance[here] += weight[here] * _GLOWS[name]
            else:
                count += here
                color = np.array(mirrors[name])
                weight = np.where(here[..., None], weight * (color + (1 - color) * (1 - cosine) ** 5), weight)
        inside = inside & np.isin(met, [names.index(name) for name in mirrors])
        along = np.where(np.arange(3) == axis[..., None], -along, along)
    return radiance, length, count


def measure_mirrors(device: Device) -> Iterator[Measurement]:
    """With one bounce, a cube with two mirrors shows what geometry and Fresnel's terms say."""
    scene = _mirror_cube(_CORNER)
    with make_renderer(device, scene, SIZE, passes=PATHS, **ONE_BOUNCE) as renderer:
        frame = renderer.render(scene.camera)
        found, diffuse, specular = read_radiance(frame), frame["paths_diffuse"], frame["paths_specular"]
        diffuse_light = np.abs(read_radiance(frame, "diffuse_radiance")).max()
    expected, length, _ = _look_into_cube(scene.camera, _CORNER)
    shown = np.isfinite(length)
    yield _compare_light(MIRRORS, found[shown] / expected[shown])
    apart = np.abs(specular[..., 3] / length - 1)[shown] + np.abs(diffuse[..., 3][shown])
    yield Measurement(MIRROR_DISTANCE, float(apart.max()), 1e-3, "relative error")
    yield Measurement(METAL, float(diffuse_light), 0.0, "cd/m^2")


def _compare_light(rule: Rule, ratio: Image, remark: str = "") -> Measurement:
    """The error of a ratio of pixels' light to the expected light, to which the walls' faint sheen may add a little."""
    error = max(float(1 - ratio.min()), float(ratio.mean() - 1), float(np.median(ratio) - 1) * 10)
    note = f"{ratio.min():.4f} at least, {ratio.mean():.4f} in the mean{remark}"
    return Measurement(rule, error, 0.03, "relative error", note)


def measure_mirror_chain(device: Device) -> Iterator[Measurement]:
    """With one bounce, two sides that glow are seen whole by rows of mirrors far longer than a path has rounds."""
    scene = _mirror_cube(_RING)
    with make_renderer(device, scene, SIZE, passes=PATHS, **ONE_BOUNCE) as renderer:
        found = read_radiance(renderer.render(scene.camera))
    expected, _, count = _look_into_cube(scene.camera, _RING)
    shown = (count > 0) & (count < _MOST_MIRRORS)
    yield _compare_light(CHAIN, found[shown] / expected[shown], f"; up to {count[shown].max()} mirrors")


# ---- lobes ------------------------------------------------------------------------------------------


# Numbers that 8 bits hold exactly; the roughness is perceptual, of either panel.
_PLASTIC, _REFLECTANCE, _ROUGHNESS = (0.8, 0.4, 5 / 255), 0.8, (0.4, 0.0)


def _white_room() -> sv.Scene:
    """Two panels of colored plastic, glossy and polished, in a sphere that glows with radiance 1."""
    sky = sv.Instance(mesh=shapes.sphere(30.0, 48), material=lamp(1.0, double_sided=True))
    scene = sv.Scene(sky, sv.Camera.look_at((0, 0, 0), (0, 0, -2), vertical_fov=1.2))
    for x, roughness in zip((-2.0, 2.0), _ROUGHNESS, strict=True):
        plastic = sv.Material(base_color=rgb(_PLASTIC), perceptual_roughness=roughness, reflectance=rgb(_REFLECTANCE))
        scene.add(sv.Instance(mesh=shapes.quad((x, 0, -2), (2, 0, 0), (0, 3, 0)), material=plastic))
    return scene


def _lobes(frame: RenderedFrame) -> Image:
    """The radiance by the diffuse and by the specular lobe, and the same demodulated: (4, h, w, 3)."""
    names = ("diffuse_radiance", "specular_radiance", "paths_diffuse", "paths_specular")
    return np.stack([read_radiance(frame, name) for name in names])


def measure_lobes(device: Device, shaders: ShaderRunner) -> Iterator[Measurement]:
    """Light of the lobes of plastic in white light; that of the specular lobe is what a black surface reflects."""
    scene, effort = _white_room(), Effort(8, 0, JITTER_PERIOD)
    with make_renderer(device, scene, SIZE, passes=PATHS, **ONE_BOUNCE) as renderer:
        found = run_pictures(renderer, scene.camera, effort, lambda frame: _lobes(frame)[:2])
        lobes = _lobes(renderer.render(scene.camera))
    made, demodulated = lobes[:2], lobes[2:]
    along = camera_rays(scene.camera, *SIZE)[1]
    roughness = np.broadcast_to(np.repeat(_ROUGHNESS, SIZE[0] // 2), SIZE)
    black = brdf_runs.materials(0.0, _REFLECTANCE, 0.0, roughness)
    specular = brdf_runs.albedo(shaders, black, (along * (1, 1, -1)).reshape(-1, 3)).reshape(*SIZE, 3)
    albedos = np.stack([(1 - specular) * _PLASTIC, specular])
    halves = [np.s_[..., : SIZE[0] // 2, :], np.s_[..., SIZE[0] // 2 :, :]]
    for lobe, half in itertools.product((0, 1), halves):
        yield measure_mean(LOBES, found[:, lobe][half], albedos[lobe][half], 0.03, effort)
    error = np.abs(demodulated * (0.02 + 0.98 * albedos) - made).max() / made.mean()
    yield Measurement(DEMODULATION, float(error), 0.01, "of the mean")


def measure_distances(device: Device, frames: int = 24) -> Iterator[Measurement]:
    """In a ball of radius R, t^2 / (2 R)^2 of diffuse rays is uniformly distributed over [0, 1]."""
    radius, ball = 2.0, shapes.sphere(2.0, 96)
    inward = sv.Mesh(ball.positions, ball.triangles[:, ::-1])
    paint = sv.Material(base_color=rgb(0.5), perceptual_roughness=0.6, emissive=rgb(1.0))
    scene = sv.Scene(sv.Instance(mesh=inward, material=paint), sv.Camera.look_at((0, 0, 0), (0, 0.3, -1)))
    lengths, wrong, diffuse_pixels = [], 0, []
    with make_renderer(device, scene, SIZE, passes=PATHS, **ONE_BOUNCE) as renderer:
        for _ in range(frames):
            frame = renderer.render(scene.camera)
            diffuse, specular = (frame[name][..., 3] for name in ("paths_diffuse", "paths_specular"))
            wrong += int(((diffuse > 0) == (specular > 0)).sum())
            lengths.append(diffuse[(diffuse > 0) & np.isfinite(diffuse)])
            diffuse_pixels.append((diffuse > 0).mean())
    shares = np.sort((np.concatenate(lengths) / (2 * radius)) ** 2)
    steps = np.arange(1, len(shares) + 1) / len(shares)
    apart = float(np.abs(shares - steps).max()) * math.sqrt(len(shares))
    # Kolmogorov's distribution exceeds 2.2 once in 8,000 runs; the ball's facets add little.
    yield Measurement(DISTANCE, apart, 2.5, "sqrt(n) times Kolmogorov's distance", f"{len(shares)} rays")
    yield Measurement(OWN_DISTANCE, float(wrong), 0.0, "pixels with both distances or none")
