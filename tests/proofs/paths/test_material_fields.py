"""Each field of a material: realtime paths without the world cache have the path tracer's light, color by color."""

import functools
import math
from dataclasses import fields

import numpy as np
import pytest
from support.frames import (
    PATHS,
    PLAIN_PATHS,
    Effort,
    make_renderer,
    observe_runs,
    path_traced,
    path_tracer_at_centers,
    read_radiance,
)
from support.seeded_bugs import Bug, Measurement, Rule, bug_tests, require
from support.statistics import relative_interval

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import place, rgb
from solari_vk.scene.material import TEXTURES

PIXELS, EFFORT = 16, Effort(16, 0, 12, 512)  # a ball and its margins are so many pixels wide
ONE_WAVELENGTH = Effort(16, 0, 48, 2048)  # of each path: colors have more noise

# The other values with which a field has an effect. Glass is whole, so that no diffuse light hides its errors.
GLASS = {"transmission": 1.0, "perceptual_roughness": 0.3}
COAT = {"clearcoat": 1.0, "clearcoat_roughness": 0.4}  # a smooth one shows the sun in few pixels
FILM = {"iridescence": 1.0, "iridescence_ior": 1.6, "reflectance": 1.0}
NEEDED = {
    "alpha": {"alpha_mode": "blend"},
    "alpha_mode": {"alpha": 0.6},
    "alpha_cutoff": {"alpha_mode": "mask", "alpha": 0.5},
    "attenuation_color": {**GLASS, "solid": True, "attenuation_distance": 0.3},
    "attenuation_distance": {**GLASS, "solid": True, "attenuation_color": (0.8, 0.3, 0.2)},
    "clearcoat_normal_scale": COAT,
    "clearcoat_normal_texture": COAT,
    "clearcoat_roughness": {"clearcoat": 1.0},
    "clearcoat_roughness_texture": {"clearcoat": 1.0, "clearcoat_roughness": 1.0},
    "diffuse_transmission_color": {"diffuse_transmission": 0.7},
    "anisotropy_rotation": {"anisotropy": 0.8},
    "emissive_texture": {"emissive": 1.0},
    "sheen_color_texture": {"sheen_color": 0.8},
    "sheen_roughness": {"sheen_color": 0.8},
    "sheen_roughness_texture": {"sheen_color": 0.8, "sheen_roughness": 1.0},
    "solid": GLASS,
    "dispersion": {**GLASS, "solid": True},
    "transmission_texture": {"transmission": 1.0, "perceptual_roughness": 0.3},
    "metallic_roughness_texture": {"metallic": 1.0, "perceptual_roughness": 1.0},
    "specular_color_texture": {"reflectance": 1.0},
    "unlit": {"base_color": (0.2, 0.5, 0.9)},
    "clearcoat_texture": COAT,
    "anisotropy_texture": {"anisotropy": 1.0},
    "diffuse_transmission_texture": {"diffuse_transmission": 1.0},
    "diffuse_transmission_color_texture": {"diffuse_transmission": 0.7},
    **dict.fromkeys(("iridescence_ior", "iridescence_texture", "iridescence_thickness"), FILM),
    "iridescence_thickness_texture": FILM,
}
BUMPED = ("normal_scale", "clearcoat_normal_scale")
VALUES = {
    "alpha_mode": lambda random: ("opaque", "mask", "blend")[random.integers(3)],
    "anisotropy_rotation": lambda random: random.uniform(-3, 3),
    "attenuation_distance": lambda random: random.random(),
    "double_sided": lambda random: random.random() < 0.5,
    "solid": lambda random: random.random() < 0.5,
    "emissive": lambda random: 2 * random.random(3),
    "ior": lambda random: random.uniform(1, 4),
    "normal_scale": lambda random: random.uniform(-1, 1),
    "reflectance": lambda random: 2 * random.random(3),
    "dispersion": lambda random: random.uniform(0, 3),
    "iridescence_ior": lambda random: random.uniform(1, 2.5),
    "iridescence_thickness": lambda random: random.uniform(0, 900, 2),
    "clearcoat_normal_scale": lambda random: random.uniform(-1, 1),
    "unlit": lambda random: random.random() < 0.5,
}
FIELDS = {field.name: field for field in fields(sv.Material) if field.name != "name"}
GROUPS = {
    "surfaces": [
        "base_color",
        "base_color_texture",
        "metallic",
        "metallic_roughness_texture",
        "perceptual_roughness",
        "normal_scale",
        "normal_texture",
        "double_sided",
        "unlit",
        "ior",
    ],
    "emission": ["emissive", "emissive_texture"],
    "coverage": ["alpha", "alpha_mode", "alpha_cutoff"],
    "layers": [
        "reflectance",
        "specular",
        "specular_texture",
        "specular_color_texture",
        *(name for name in FIELDS if name.startswith(("clearcoat", "sheen", "anisotropy"))),
    ],
    "dispersion": ["dispersion"],
    "iridescence": [name for name in FIELDS if name.startswith("iridescence")],
    "glass": [name for name in FIELDS if name.startswith(("transmission", "solid", "attenuation", "diffuse"))],
}
RULES = {name: Rule(f"four balls of random {name} have the path tracer's light") for name in FIELDS}


def draw_value(field, random):
    """A random value of a field of materials. Textures have one texel, because filters may differ."""
    if "normal_texture" in field.name:
        normal = np.append(random.uniform(-0.4, 0.4, 2), 1)
        return np.uint8(255 * (normal / np.linalg.norm(normal) + 1) / 2).reshape(1, 1, 3)
    if field.name in TEXTURES:
        return random.integers(0, 256, (1, 1, 4), np.uint8)
    if field.name in VALUES:
        return VALUES[field.name](random)
    return random.random(3) if field.metadata["glsl"] == "vec3" or "color" in field.name else random.random()


def make_rows(names, seed=2):
    """A row of four balls for each field, under a sky and a sun, with random values of that field and random colors."""
    random = np.random.default_rng(seed)
    scene = sv.Scene(sv.Camera(transform=place(at=(0, 0, 300)), vertical_fov=2 * math.atan(len(names) / 300)))
    scene.environment = sv.Environment(np.linspace((0.5, 0.8, 1.5), (0.4, 0.3, 0.2), 8)[:, None])
    scene.add(sv.DirectionalLight(direction=rgb((-0.4, -0.8, -0.7)), illuminance=2.0, angular_diameter=0.1))
    for row, name in enumerate(names):
        for column in range(4):
            values = {"base_color": random.random(3), **NEEDED.get(name, {}), name: draw_value(FIELDS[name], random)}
            if name in BUMPED:
                values[name.replace("scale", "texture")] = np.uint8([[(220, 90, 200)]])
            at = (2 * column - 3, len(names) - 1 - 2 * row, 0)
            scene.add(shapes.sphere(0.9, 32), sv.Material(**values), place(at=at), name=name)
    return scene


def measure_fields(device, names, effort=EFFORT):
    """The largest relative error of each row's mean among the three channels, with its 95 % interval."""
    scene, size = make_rows(names), (4 * PIXELS, len(names) * PIXELS)
    with make_renderer(device, scene, size, passes=PATHS, **PLAIN_PATHS) as renderer:
        found = observe_runs(renderer, scene.camera, effort, read_radiance)
    with path_tracer_at_centers():
        expected = path_traced(device, scene, effort.samples, size, max_bounces=64)
    for row, name in enumerate(names):
        part = np.s_[..., row * PIXELS : (row + 1) * PIXELS, :, :]
        errors = [relative_interval(found[part][..., at], expected[part][..., at]) for at in range(3)]
        error, half_width = max(errors, key=lambda each: abs(each[0]) + each[1])
        note = f"{error:+.2%} +- {half_width:.2%}"
        yield Measurement(RULES[name], abs(error) + half_width, 0.01, f"relative error, {effort}", note)


@pytest.mark.slow  # compiles for a minute
@pytest.mark.parametrize(
    "layer",
    [
        COAT,
        {"sheen_color": (1, 1, 1), "sheen_roughness": 128 / 255},  # which the G-buffer stores as it is
    ],
    ids=["coat", "sheen"],
)
def test_layers_over_smooth_metal_show_points(device, layer):
    """Which no ray meets, so that smooth metals alone need no light samples."""
    metal = sv.Material(metallic=1.0, perceptual_roughness=0.0, **layer)
    camera = sv.Camera.look_at((0, 2, 2), (0, 0, 0), vertical_fov=0.5)
    scene = sv.Scene(camera, sv.Instance(shapes.plane(2), metal))
    scene.add(sv.PointLight(position=(0, 2, -2), intensity=100.0))
    with make_renderer(device, scene, (8, 8), passes=PATHS, **PLAIN_PATHS) as renderer:
        found = observe_runs(renderer, camera, Effort(96, 0, 16, 256), read_radiance)
    with path_tracer_at_centers():
        expected = path_traced(device, scene, 256, (8, 8), camera)
    error, half_width = relative_interval(found[..., 0], expected[..., 0])
    assert abs(error) + half_width < 0.03, f"{error:+.2%} +- {half_width:.2%}"


@pytest.mark.slow  # minutes
@pytest.mark.parametrize("names", GROUPS.values(), ids=GROUPS)
def test_fields(device, names):
    require(measure_fields(device, names, ONE_WAVELENGTH if names == ["dispersion"] else EFFORT))


def test_every_field_is_measured():
    assert sorted(name for names in GROUPS.values() for name in names) == sorted(FIELDS)


test_a_seeded_bug_is_noticed = bug_tests(
    {
        RULES["reflectance"]: (
            functools.partial(measure_fields, names=["reflectance"]),
            Bug(
                "scene/base_material.glsl",
                "unpack_base",
                "BaseMaterial right = correct(base, packed); right.reflectance = base.reflectance; return right;",
            ),
        )
    }
)
