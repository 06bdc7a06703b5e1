"""The light of each lobe of a path's first surface, its demodulation, its distance, and light by mirrors."""

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from oracles.rays import camera_rays
from support.frames import (
    JITTER_PERIOD,
    PATHS,
    PLAIN_PATHS,
    Effort,
    make_renderer,
    material_records,
    observe_runs,
    run_albedo,
)
from support.frames import read_radiance as read
from support.seeded_bugs import Bug, Measurement, Rule, bug_tests, require
from support.statistics import measure_mean

import solari_vk as sv
from solari_vk.lab.shader_runner import ShaderRunner
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, rgb

METAL = Rule("metals have no diffuse light")
MIRRORS = Rule("bounces at mirrors count for nothing but their Fresnel terms")
CHAIN = Rule("light comes whole by many mirrors in a row")
MIRROR_DISTANCE = Rule("the distance of a mirror's light is the length of the reflected ray")
LOBES = Rule("each lobe reflects as much white light as its albedo says")
DEMODULATION = Rule("demodulated light times the surface's albedo is the lobe's radiance")
DISTANCE = Rule("the distances of diffuse light are those of rays with a cosine distribution")
OWN_DISTANCE = Rule("the distance belongs to the lobe that proposed the ray")
SIZE = (32, 32)


def make(device, scene):
    """A renderer of the light that leaves the first surface after one bounce."""
    return make_renderer(device, scene, SIZE, passes=PATHS, **{**PLAIN_PATHS, "paths_bounces": 1})


# ---- mirrors ----------------------------------------------------------------------------------------


HALF = 2.0  # of the side of the cube below, in meters
SIDES = {"left": (0, -1), "right": (0, 1), "floor": (1, -1), "ceiling": (1, 1), "back": (2, -1), "front": (2, 1)}
GLOWS = {"left": (1.0, 0.2, 0.1), "right": (0.1, 1.0, 0.3), "ceiling": (0.3, 0.2, 1.0), "front": (1.0, 0.9, 0.2)}
CORNER = {"floor": (0.9, 0.6, 0.3), "back": (0.5, 0.8, 0.95)}
# White, so that Russian roulette ends no path.
RING = dict.fromkeys(("floor", "ceiling", "back", "front"), (1.0, 1.0, 1.0))
MOST_MIRRORS = 32


def mirror_cube(mirrors):
    """The inside of a cube, of which some sides are metal mirrors of these colors; the others glow."""
    scene = sv.Scene(sv.Camera.look_at((0.31, 0.43, 0.87), (-0.2, -1.9, -1.8), vertical_fov=1.2))
    for name, (axis, sign) in SIDES.items():
        normal, u = -sign * np.eye(3)[axis], np.eye(3)[axis - 2]
        mirror = sv.Material(base_color=rgb(mirrors.get(name, 0)), metallic=1.0, perceptual_roughness=0.0)
        mesh = shapes.quad(HALF * sign * np.eye(3)[axis], HALF * u, HALF * np.cross(normal, u))
        scene.add(sv.Instance(mesh=mesh, material=mirror if name in mirrors else lamp(GLOWS[name]), name=name))
    return scene


def look_into_cube(camera, mirrors):
    """The radiance (32, 32, 3); the length (32, 32) of the first reflected ray, NaN where no mirror is seen; and the
    number of mirrors (32, 32) until a side glows, MOST_MIRRORS where none of the first ones does."""
    (places, along), names = camera_rays(camera, *SIZE), list(SIDES)
    weight, radiance = np.ones((*SIZE, 3)), np.zeros((*SIZE, 3))
    length = np.full(SIZE, np.nan)
    count = np.zeros(SIZE, int)
    inside = np.ones(SIZE, bool)
    for ray in range(MOST_MIRRORS):
        to_sides = (np.where(along < 0, -HALF, HALF) - places) / along
        axis, t = to_sides.argmin(axis=-1), to_sides.min(axis=-1)
        if ray == 1:
            length = np.where(inside, t, np.nan)
        places = places + t[..., None] * along
        across = np.take_along_axis(along, axis[..., None], -1)[..., 0]
        side, cosine = 2 * axis + (across > 0), np.abs(across)[..., None]
        for at, name in enumerate(names):
            here = inside & (side == at)
            if name in mirrors:
                count += here
                color = np.array(mirrors[name])
                weight = np.where(here[..., None], weight * (color + (1 - color) * (1 - cosine) ** 5), weight)
            else:
                radiance[here] += weight[here] * GLOWS[name]
        inside = inside & np.isin(side, [names.index(name) for name in mirrors])
        along = np.where(np.arange(3) == axis[..., None], -along, along)
    return radiance, length, count


def compare_light(rule, ratio, remark=""):
    """The error of a ratio of pixels' light to the expected light, to which the walls' faint sheen may add a little."""
    error = max(1 - ratio.min(), ratio.mean() - 1, (np.median(ratio) - 1) * 10)
    note = f"{ratio.min():.4f} at least, {ratio.mean():.4f} in the mean{remark}"
    return Measurement(rule, float(error), 0.03, "relative error", note)


def measure_mirrors(device):
    """With one bounce, a cube with two mirrors shows what geometry and Fresnel's terms say."""
    scene = mirror_cube(CORNER)
    with make(device, scene) as renderer:
        frame = renderer.render(scene.camera)
        found = read(frame)
        diffuse = frame["paths_diffuse"]
        specular = frame["paths_specular"]
        diffuse_light = np.abs(read(frame, "diffuse_radiance")).max()
    expected, length, _ = look_into_cube(scene.camera, CORNER)
    shown = np.isfinite(length)
    yield compare_light(MIRRORS, found[shown] / expected[shown])
    apart = np.abs(specular[..., 3] / length - 1)[shown] + np.abs(diffuse[..., 3][shown])
    yield Measurement(MIRROR_DISTANCE, float(apart.max()), 1e-3, "relative error")
    yield Measurement(METAL, float(diffuse_light), 0.0, "cd/m^2")


def measure_mirror_chain(device):
    """With one bounce, two sides that glow are seen whole by rows of mirrors far longer than a path has waves."""
    scene = mirror_cube(RING)
    with make(device, scene) as renderer:
        found = read(renderer.render(scene.camera))
    expected, _, count = look_into_cube(scene.camera, RING)
    shown = (count > 0) & (count < MOST_MIRRORS)
    yield compare_light(CHAIN, found[shown] / expected[shown], f"; up to {count[shown].max()} mirrors")


# ---- lobes ------------------------------------------------------------------------------------------


# Numbers that 8 bits hold exactly; the roughness is perceptual, of either panel.
PLASTIC = (0.8, 0.4, 5 / 255)
REFLECTANCE = 0.8
ROUGHNESS = (0.4, 0.0)
HALVES = (np.s_[..., : SIZE[0] // 2, :], np.s_[..., SIZE[0] // 2 :, :])
BRDF_SHADERS = Path(__file__).parents[1] / "brdf" / "glsl"


def white_room():
    """Two panels of colored plastic, glossy and polished, in a sphere that glows with radiance 1."""
    sky = sv.Instance(mesh=shapes.sphere(30.0, 48), material=lamp(1.0, double_sided=True))
    scene = sv.Scene(sky, sv.Camera.look_at((0, 0, 0), (0, 0, -2), vertical_fov=1.2))
    for x, roughness in zip((-2.0, 2.0), ROUGHNESS, strict=True):
        plastic = sv.Material(base_color=rgb(PLASTIC), perceptual_roughness=roughness, reflectance=rgb(REFLECTANCE))
        scene.add(sv.Instance(mesh=shapes.quad((x, 0, -2), (2, 0, 0), (0, 3, 0)), material=plastic))
    return scene


def measure_lobes(device):
    """Light of the lobes of plastic in white light; that of the specular lobe is what a black surface reflects."""
    scene, effort = white_room(), Effort(8, 0, JITTER_PERIOD)

    def lobes(frame, *names):
        return np.stack([read(frame, name) for name in names])

    def radiance(frame):
        return lobes(frame, "diffuse_radiance", "specular_radiance")

    with make(device, scene) as renderer:
        found = observe_runs(renderer, scene.camera, effort, radiance)
        frame = renderer.render(scene.camera)
        made, demodulated = radiance(frame), lobes(frame, "paths_diffuse", "paths_specular")
    toward_viewer = (camera_rays(scene.camera, *SIZE)[1] * (1, 1, -1)).reshape(-1, 3)
    black = material_records(0.0, REFLECTANCE, 0.0, np.broadcast_to(np.repeat(ROUGHNESS, SIZE[0] // 2), SIZE))
    with ShaderRunner(device, BRDF_SHADERS) as shaders:
        specular = run_albedo(shaders, black, toward_viewer).reshape(*SIZE, 3)
    albedos = np.stack([(1 - specular) * PLASTIC, specular])
    for lobe, half in itertools.product((0, 1), HALVES):
        yield measure_mean(LOBES, found[:, lobe][half], albedos[lobe][half], 0.03, effort)
    least = np.reshape((1e-4, 5e-3), (2, 1, 1, 1))  # passes/demodulation.glsl
    error = np.abs(demodulated * (least + (1 - least) * albedos) - made).max() / made.mean()
    yield Measurement(DEMODULATION, float(error), 0.01, "of the mean")


def measure_distances(device):
    """In a ball of radius R, t^2 / (2 R)^2 of diffuse rays is uniformly distributed over [0, 1]."""
    radius, ball = 2.0, shapes.sphere(2.0, 96)
    # Rougher paint would propose some directions into the surface: no ray, and no distance.
    paint = sv.Material(base_color=rgb(0.5), perceptual_roughness=0.1, emissive=rgb(1.0))
    inward = sv.Instance(mesh=sv.Mesh(ball.positions, ball.triangles[:, ::-1]), material=paint)
    scene = sv.Scene(inward, sv.Camera.look_at((0, 0, 0), (0, 0.3, -1)))
    lengths, wrong = [], 0
    with make(device, scene) as renderer:
        for _ in range(24):
            frame = renderer.render(scene.camera)
            diffuse, specular = (frame[name][..., 3] for name in ("paths_diffuse", "paths_specular"))
            wrong += int(((diffuse > 0) == (specular > 0)).sum())
            lengths.append(diffuse[(diffuse > 0) & np.isfinite(diffuse)])
    shares = np.sort((np.concatenate(lengths) / (2 * radius)) ** 2)
    apart = np.abs(shares - np.arange(1, len(shares) + 1) / len(shares)).max() * math.sqrt(len(shares))
    # Kolmogorov's distribution exceeds 2.2 once in 8,000 runs; the ball's facets add little.
    yield Measurement(DISTANCE, float(apart), 2.5, "sqrt(n) times Kolmogorov's distance", f"{len(shares)} rays")
    yield Measurement(OWN_DISTANCE, float(wrong), 0.0, "pixels with both distances or none")


# ---- each rule holds, and can fail ------------------------------------------------------------------


@pytest.mark.parametrize(
    "measure",
    [
        measure_mirrors,
        *(pytest.param(m, marks=pytest.mark.slow) for m in (measure_mirror_chain, measure_distances, measure_lobes)),
    ],
)
def test_rules_hold(device, measure):
    require(measure(device))


def writing(change):
    """A bug in what the first ray writes of a pixel, of which `w` is the ray's length for the lobe that proposed it.

    The pass runs several times in a frame, so the change must be wrong also when it is made twice.
    """
    return Bug(
        "passes/paths/first_ray.comp",
        "main",
        "correct(); uvec2 at = INVOCATION_INDEX; "
        "if (any(greaterThanEqual(at, camera.size))) { return; } uint row = at.y * camera.size.x + at.x; "
        f"vec2 lengths = vec2(paths_diffuse.at[row].w, paths_specular.at[row].w); {change} "
        "paths_diffuse.at[row].w = lengths.x; paths_specular.at[row].w = lengths.y;",
    )


PATH = "passes/paths/path.glsl"
test_a_seeded_bug_is_noticed = bug_tests(
    {
        METAL: (
            measure_mirrors,
            Bug(
                PATH,
                "lobe_weights",
                "if (next.pdf == INFINITY) { return PerLobe(next.weight, vec3(0.0)); } return correct(next);",
            ),
        ),
        MIRRORS: (measure_mirrors, Bug("scene/walk.glsl", "MAX_DELTA_BOUNCES", "0u")),
        CHAIN: (
            measure_mirror_chain,
            Bug(
                "passes/paths/path_state.glsl",
                "load_path_state",
                "Path path = correct(pixel_index); path.delta_bounces = 0u; return path;",
            ),
        ),
        MIRROR_DISTANCE: (measure_mirrors, writing("lengths = vec2(max(lengths.x, lengths.y), 0.0);")),
        LOBES: (
            measure_lobes,
            Bug(PATH, "path_light", "PerLobe light = correct(path); light.diffuse += light.specular; return light;"),
        ),
        # demodulated by the other lobe
        DEMODULATION: (
            measure_lobes,
            Bug(
                "passes/demodulation.glsl",
                "demodulation",
                "Demodulation by = correct(surface); by.specular = by.diffuse; return by;",
            ),
        ),
        DISTANCE: (measure_distances, writing("lengths *= 1.1;")),
        OWN_DISTANCE: (measure_distances, writing("lengths = vec2(max(lengths.x, lengths.y));")),
    }
)
