"""Specular GI against the path tracer: unbiased where it is one itself, within its bars where it ends in the cache."""

from __future__ import annotations

import numpy as np
import pytest
from specular_frames import metal_gallery, take_frames

import solari_vk as sv
from solari_vk.gpu.shaders.patches import patched_shaders
from solari_vk.measure.claims.older import CLAMPED_GGX
from solari_vk.scene import shapes
from solari_vk.scene.builtin import closed_box, lamp, place, rgb
from solari_vk.scene.matrices import transform_directions
from solari_vk.scene.model import Camera, DirectionalLight, Instance, Material, Scene

SIZE = (24, 24)
PANELS = {
    "mirror": np.s_[:12, :12],
    "smooth": np.s_[:12, 12:],
    "glossy": np.s_[12:, :12],
    "rough": np.s_[12:, 12:],
}


def reference(device, scene, size, samples, camera=None, **settings):
    """The path tracer's picture (h, w, 3), and the variance (h, w) of its luminance."""
    tracer = sv.PathTracer(device, scene, size, **settings)
    try:
        frame = tracer.render(camera or scene.camera, samples=samples)
        return frame["radiance"].astype(float), frame["variance"].astype(float)
    finally:
        tracer.close()


def relative_error(mean, variance, truth, truth_variance):
    """Of a region's mean: the error and the half width of its 95 % interval."""
    spread = variance.mean(axis=-1) + truth_variance  # channels come from the same paths
    return mean.mean() / truth.mean() - 1, 1.96 * np.sqrt(spread.sum()) / spread.size / truth.mean()


# ---- without bias -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def gallery_truth(device):
    scene = metal_gallery()
    return scene, *reference(device, scene, SIZE, 4096)


def check_gallery(device, gallery_truth):
    """The 95 % interval of each panel's relative error lies within 2.5 %, that of all within 1 %."""
    scene, truth, truth_variance = gallery_truth
    made, variance = take_frames(device, scene, SIZE, 2500)
    for name, panel in {**PANELS, "all": np.s_[:, :]}.items():
        error, width = relative_error(made[panel], variance[panel], truth[panel], truth_variance[panel])
        print(f"{name}: {error:+.2%} +- {width:.2%}")
        assert abs(error) < 0.005 + width, name
        assert abs(error) + width < (0.01 if name == "all" else 0.025), name


def test_paths_of_the_specular_lobe_are_unbiased(device, gallery_truth):
    """Mirror, smooth, glossy and rough metals; a lamp, a sun, diffuse, glossy and mirror surfaces in what they show."""
    check_gallery(device, gallery_truth)


TRACE, LOBE = "passes/specular_gi/trace.comp", "passes/specular_gi/lobe.glsl"
MUTANTS = {
    "lights counted twice": (TRACE, "* power_heuristic(path.bounce_pdf, light_pdf)", ""),
    "sun counted twice": ("scene/sampling.glsl", "* power_heuristic(bounce_pdf, light_pdf)", ""),
    "light samples without weights": (TRACE, "* power_heuristic(light.solid_angle_pdf, brdf_pdf(brdf, wo, wi))", ""),
    "no Fresnel in mirrors": (LOBE, "specular_fresnel(brdf, wo.z), INFINITY", "vec3(1.0), INFINITY"),
    "no light samples": (TRACE, "if (!brdf.mirror || brdf.specular_probability < 1.0) {", "if (false) {"),
    "roulette's survivors are not raised": (TRACE, "path.throughput /= survival;", ""),
    "no first lights": (TRACE, "_settings.di_roughness ? INFINITY : 0.0", "_settings.di_roughness ? 0.0 : 0.0"),
    "pdf of another lobe": (LOBE, "brdf.pdf_per_d * D_GGX", "1.1 * brdf.pdf_per_d * D_GGX"),
}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[] if n == "no light samples" else [pytest.mark.slow]) for n in MUTANTS]
)
def test_a_seeded_bug_is_noticed(device, gallery_truth, name):
    with patched_shaders(MUTANTS[name]), pytest.raises(AssertionError):
        check_gallery(device, gallery_truth)


# ---- mirrors ----------------------------------------------------------------------------------------


GOLD = Material(base_color=rgb((0.9, 0.6, 0.3)), metallic=1.0, perceptual_roughness=0.0, name="gold")


def schlick(color, cosine):
    return np.asarray(color) + (1 - np.asarray(color)) * (1 - cosine[..., None]) ** 5


def view_directions(camera, size):
    """Unit vectors (h, w, 3) through the middles of the pixels."""
    right, down = np.meshgrid(
        (np.arange(size[0]) + 0.5) * 2 / size[0] - 1, (np.arange(size[1]) + 0.5) * 2 / size[1] - 1
    )
    tangent = np.tan(camera.vertical_fov / 2)
    view = np.stack([right * tangent * size[0] / size[1], -down * tangent, -np.ones_like(right)], axis=-1)
    directions = transform_directions(camera.transform, view)
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def glowing_shapes():
    """Balls and a square that glow in many colours, before a mirror in the plane z = -2."""
    random = np.random.default_rng(7)
    scene = Scene(Instance(mesh=shapes.quad((0, 0, -2.0), (9.0, 0, 0), (0, 9.0, 0)), material=GOLD, name="mirror"))
    for at in random.uniform((-3, -2, 2), (3, 2, 5), (12, 3)):
        color = random.uniform(0.5, 5.0, 3)
        ball = shapes.sphere(random.uniform(0.2, 0.8), 16)
        scene.add(Instance(mesh=ball, material=lamp(color), transform=place(at=at)))
    scene.add(Instance(mesh=shapes.quad((0, 0, 6), (0, 5, 0), (5, 0, 0)), material=lamp((0.2, 0.4, 0.8))))
    return scene


def test_a_flat_mirror_shows_the_mirrored_cameras_picture(device):
    """Pixel by pixel what the camera behind the mirror sees, times Fresnel; lights are met directly, and once."""
    size = (48, 36)
    scene = glowing_shapes()
    camera = Camera.look_at((0.3, -0.3, 1.5), (0.1, 0.1, -2.0), vertical_fov=1.2)
    made, _ = take_frames(device, scene, size, 2, camera=camera, jitter=False, specular_bounces=1)
    left_to_di, _ = take_frames(device, scene, size, 2, camera=camera, jitter=False, specular_bounces=1,
                                specular_di_roughness=0.0, specular_reuse_roughness=0.0)  # fmt: skip
    mirrored = np.diag((1, 1, -1, 1)) @ camera.transform @ np.diag((-1, 1, 1, 1))  # turned about: no rotation without
    mirrored[2, 3] -= 4.0
    scene.remove(next(instance for instance in scene if instance.name == "mirror"))
    tracer = sv.PathTracer(device, scene, size)
    try:
        tracer.render(Camera(transform=mirrored, vertical_fov=1.2, near=0.01), samples=1)
        emissive = tracer["emissive"][:, ::-1]
    finally:
        tracer.close()
    expected = emissive * schlick(GOLD.base_color, np.abs(view_directions(camera, size)[..., 2]))
    assert len(np.unique(emissive[..., 0])) > 8
    wrong = ~np.isclose(made, expected, rtol=0.03, atol=0.02).all(axis=-1)
    assert wrong.sum() <= 3, f"{wrong.sum()} pixels differ"
    assert left_to_di.mean() > 0.9 * made.mean(), "DI never has the lights of mirrors"


@pytest.mark.parametrize("mirrors", [1, 2])
def test_mirrors_show_the_suns_disk(device, mirrors):
    """A mirror on the floor, and another upright behind it; mirrors don't count as surfaces of a path."""
    size = (48, 48)
    scene = Scene(Instance(mesh=shapes.quad((0, 0, 0), (0, 0, 9), (9, 0, 0)), material=GOLD))
    turned = np.array((1, -1, 1))
    if mirrors == 2:
        scene.add(Instance(mesh=shapes.quad((0, 0, -3), (40, 0, 0), (0, 40, 0)), material=GOLD))
        turned = np.array((1, -1, -1))
    to_sun = np.array((-0.1, 1.0, -0.4)) * (1, 1, turned[2])
    scene.add(DirectionalLight(direction=-to_sun, illuminance=10.0, angular_diameter=0.3))
    camera = Camera.look_at((0, 2, 0.5), (0.2, 0, -0.3), vertical_fov=0.9)
    made, _ = take_frames(device, scene, size, 2, camera=camera, jitter=False, specular_bounces=1)
    directions = view_directions(camera, size)
    angle = np.arccos((directions * turned) @ (to_sun / np.linalg.norm(to_sun)))
    expected = 10.0 / (np.pi * np.sin(0.15) ** 2) * schlick(GOLD.base_color, -directions[..., 1])
    if mirrors == 2:
        expected = expected * schlick(GOLD.base_color, np.abs(directions[..., 2]))
    expected *= (angle < 0.15)[..., None]
    inside = np.abs(angle - 0.15) > 1e-3
    assert 50 < (angle < 0.15).sum() < 2000
    np.testing.assert_allclose(made[inside], expected[inside], rtol=0.01)


def test_the_mirror_brdf_is_exact_where_clamped_ggx_is_not(device):
    """A ball in a white furnace: Solari 0.18 gains and loses what rounding leaves of a lobe so narrow."""
    size = (48, 48)
    around = Instance(mesh=shapes.box((-9, -9, -9), (9, 9, 9), inward=True), material=lamp(1.0))
    ball = Instance(mesh=shapes.sphere(1.0, 64), material=GOLD)
    camera = Camera.look_at((0, 0, 3), (0, 0, 0), vertical_fov=0.4)
    mirror, _ = take_frames(device, Scene(around, ball), size, 2, camera=camera, jitter=False)
    with patched_shaders(*CLAMPED_GGX):
        clamped, _ = take_frames(device, Scene(around, ball), size, 2, camera=camera, jitter=False)
    directions = view_directions(camera, size)
    along = -3.0 * directions[..., 2]
    apart = np.sqrt(9.0 - along**2)  # of the ray from the ball's middle
    expected = schlick(GOLD.base_color, np.sqrt(1 - apart**2))
    np.testing.assert_allclose(mirror, expected, rtol=0.02)
    ratio = clamped / mirror
    assert ratio.min() < 0.8, "no black lines to be rid of"
    assert ratio.max() > 1.2


# ---- energy, and all else ---------------------------------------------------------------------------


@pytest.mark.parametrize("perceptual_roughness", [0.0, 0.3, 0.7])
def test_a_glowing_box_of_metal(device, perceptual_roughness):
    """Walls emit 1 and reflect about half, over many bounces; the path tracer's own box is proved elsewhere."""
    scene = closed_box(albedo=0.5)
    walls = next(iter(scene))
    walls.material.update(base_color=rgb(0.5), metallic=1.0, perceptual_roughness=perceptual_roughness)
    made, variance = take_frames(device, scene, (16, 16), 100)
    truth, truth_variance = reference(device, scene, (16, 16), 400)
    error, width = relative_error(made + 1.0, variance, truth, truth_variance)
    print(f"{error:+.2%} +- {width:.2%}")
    assert abs(error) + width < 0.01, f"{error:+.2%} +- {width:.2%}"


@pytest.mark.parametrize("termination", ["spread", "camera_spread"])
def test_one_seed_gives_one_picture(device, termination):
    scene = metal_gallery()
    settings = {"specular_bounces": 3, "specular_termination": termination}
    first, _ = take_frames(device, scene, SIZE, 3, **settings)
    again, _ = take_frames(device, scene, SIZE, 3, **settings)
    assert (first == again).all()
    assert first.mean() > 0.05


def test_off_is_black(device):
    made, _ = take_frames(device, metal_gallery(), SIZE, 2, specular=False)
    assert (made == 0).all()
