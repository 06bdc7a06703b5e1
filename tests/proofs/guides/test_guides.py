"""Guide images: ordinary surfaces against the path tracer's AOVs and closed forms, mirrors and glass against what they
show; ranges, and the parts of the light."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.rays import camera_rays
from support.frames import GUIDES, LIGHT_OFF, PARTS, add_up, make_renderer, path_traced
from support.seeded_bugs import Bug, Measurement, Rule, bug_tests, require, seeded

import solari_vk as sv
from solari_vk.output.compare import relative_mse
from solari_vk.passes.guides import IMAGES
from solari_vk.scene import shapes
from solari_vk.scene.builtin import builtin, cornell_box, lamp, place, rgb
from solari_vk.scene.matrices import transform_directions
from solari_vk.scene.model import Instance, Material, Mesh

_PSR = ("Solari in Bevy 0.19", "primary surface replacement")
RANGE = Rule("degenerate and extreme scenes give finite guides, unit or zero normals, roughness 0 to 1")
LAMP = Rule("a clear wall before a lamp describes itself")
SUM = Rule("diffuse, specular and emission add up to the radiance")
BEFORE = Rule("emission is the lamp's radiance at any exposure")
SIZE = (48, 48)
PIXEL = 1 / 16  # the largest error of a motion vector, in pixels
MIRROR = sv.Material(base_color=rgb(0.9), metallic=1.0, perceptual_roughness=0.0, name="mirror")
CLEAR = {"transmission": 1.0, "perceptual_roughness": 0.0, "double_sided": True}


def odd_scene():
    """Slivers, points, a light without area, zero normals, huge and tiny instances, a mirror, and extreme radiance."""
    points = np.array([(0, 0, 0), (1, 0, 0), (0.5, 1e-7, 0), (0.3, 0.3, 0.3), (0.3, 0.3, 0.3), (0.3, 0.3, 0.3)])
    spoiled, ball = Mesh(positions=points, normals=np.zeros((6, 3), np.float32)), shapes.sphere(0.3, 8)
    scene = cornell_box(radiance=(1e8, 1e-3, 0))
    mirror = Material(metallic=1.0, perceptual_roughness=0.0, base_color=(1.0, 1.0, 1.0))
    for mesh, material, scale in (
        (spoiled, lamp(5.0), 1.0),
        (spoiled, mirror, 1.0),
        (ball, mirror, 1.0),
        (ball, lamp(1e6), 1e-5),
        (shapes.box(inward=True), mirror, 1e4),
    ):
        scene.add(Instance(mesh=mesh, material=material, transform=place(scale, (0.8, 1.2, 0.5))))
    return scene


def guide_renderer(device, scene, **settings):
    return make_renderer(device, scene, SIZE, passes=GUIDES, **{**LIGHT_OFF, **settings})


def read(frame):
    """The guides; albedos are 8-bit codes."""
    found = {name: np.squeeze(frame[f"guides_{name}"]).astype(np.float64) for name in IMAGES}
    return {name: values[..., :3] if "albedo" in name else values for name, values in found.items()}


# ---- ordinary surfaces ------------------------------------------------------------------------------


@pytest.mark.parametrize("scene_name", ["cornell_box", "sphere_grid"])
def test_surfaces_are_the_path_tracers(device, scene_name):
    """Without primary surface replacement, this includes mirrors. The bounds are the formats' precision."""
    scene = builtin(scene_name)
    with guide_renderer(device, scene, gbuffer="traced", primary_surface_replacement=False) as renderer:
        guides = read(renderer.render(scene.camera))
    with sv.PathTracer(device, scene, SIZE) as tracer:
        tracer.render(scene.camera, samples=1)
        albedo, normal, depth = (tracer[name] for name in ("albedo", "shading_normal", "depth"))
        roughness, metallic = np.moveaxis(tracer["roughness_metallic"], -1, 0)
    there = np.isfinite(depth)
    diffuse = guides["diffuse_albedo"] / 255
    np.testing.assert_allclose(diffuse[there], (albedo * (1 - metallic)[..., None])[there], atol=0.004)
    np.testing.assert_allclose(guides["normal_roughness"][there, :3], normal[there], atol=0.002)
    np.testing.assert_allclose(guides["normal_roughness"][there, 3], roughness[there], atol=0.0025)
    np.testing.assert_allclose(guides["depth"][there], scene.camera.near / depth[there], rtol=1e-5)
    assert (diffuse[~there] == 0).all()
    assert (guides["depth"][~there] == 0).all()


@pytest.mark.parametrize("gbuffer", ["traced", "raster"])
def test_edited_vertices_move_as_a_moved_instance_does(device, gbuffer):
    """By 0.1 m each frame from the second on; the last frame is one without an edit, which is at rest."""
    made = []
    for edits in (False, True):
        scene = sv.Scene(sv.DirectionalLight((0, -1, -1)), sv.Camera.look_at((0, 0, 4), (0, 0, 0)))
        instance = scene.add(shapes.sphere(0.8, 32))
        with guide_renderer(device, scene, gbuffer=gbuffer) as renderer:
            made.append([read(renderer.render(scene.camera))["motion"]])
            for frame in (1, 2, 3):
                if frame < 3 and edits:
                    instance.mesh.positions = instance.mesh.positions + np.float32((0.1, 0, 0))
                elif frame < 3:
                    instance.transform = (0.1 * frame, 0, 0)
                made[-1].append(read(renderer.render(scene.camera))["motion"])
    moved, edited = np.array(made)
    assert (np.abs(moved[[1, 2]]).max(axis=(1, 2, 3)) > PIXEL / SIZE[0]).all()
    assert (edited[[0, 3]] == 0).all()
    np.testing.assert_allclose(edited, moved, atol=0.1 * PIXEL / SIZE[0])


@pytest.mark.parametrize("gbuffer", ["traced", "raster"])
def test_motion_as_it_is_read_is_that_of_the_pixels_centers(device, gbuffer):
    """As that of a batch, whatever the sample positions: of a moved camera, a moved box and edited vertices."""
    scene = sv.Scene(sv.DirectionalLight((0, -1, -1)))
    scene.add(shapes.box((-1.5, -0.4, -0.4), (-0.7, 0.4, 0.4)))
    moved, edited = (scene.add(shapes.box((x, -0.4, -0.4), (x + 0.8, 0.4, 0.4))) for x in (-0.4, 0.7))
    poses = [sv.Camera.look_at((0.1 * step, 0, 4), (0.1 * step, 0.1 * step, 0)) for step in range(3)]
    with (
        sv.Batch(device, scene, SIZE, 1, outputs=["motion_vectors"]) as batch,
        sv.Renderer(device, scene, SIZE, sv.Settings(gbuffer=gbuffer)) as renderer,
    ):
        for camera in poses:
            moved.position += (0, 0.05, 0)
            edited.mesh.positions = edited.mesh.positions + np.float32((0.05, 0, 0))
            found = renderer.render(camera)["guides_motion"]
            expected = batch.render([camera])["motion_vectors"][0]
    assert np.abs(expected * SIZE).max() > 1
    np.testing.assert_allclose(found * SIZE, expected * SIZE, atol=5e-6)


def test_specular_albedo_is_the_directional_albedo(device):
    """It is 1 for a white metal at every angle and roughness, and Schlick's Fresnel term for a smooth dielectric."""
    scene = sv.Scene(sv.Camera.look_at((0, 1.0, 4), (0, 0, 0), vertical_fov=0.6))
    for column in range(4):
        metal = {"base_color": 1.0, "metallic": 1.0, "perceptual_roughness": (0.1, 0.3, 0.6, 1.0)[column]}
        smooth = {"base_color": 0.0, "perceptual_roughness": 0.0, "reflectance": rgb(0.25 + 0.25 * column)}
        for z, fields in ((0.5, metal), (-0.5, smooth)):
            scene.add(shapes.quad((column - 1.5, 0, z), (0, 0, 0.5), (0.5, 0, 0)), sv.Material(**fields))
    with guide_renderer(device, scene) as renderer:
        made = read(renderer.render(scene.camera))["specular_albedo"][..., 0] / 255
    origin, directions = camera_rays(scene.camera, *SIZE)
    cosine = -directions[..., 1]
    x, _, z = np.moveaxis(origin + directions * (scene.camera.transform[1, 3] / cosine)[..., None], -1, 0)
    metal, smooth = ((np.abs(x) < 1.99) & (np.abs(z - at) < 0.49) for at in (0.5, -0.5))
    assert np.ptp(cosine[metal]) > 0.02
    np.testing.assert_allclose(made[metal], 1.0, atol=0.01)
    f0 = 0.16 * (0.25 + 0.25 * np.clip(np.floor(x + 2), 0, 3)) ** 2
    np.testing.assert_allclose(made[smooth], (f0 + (1 - f0) * (1 - cosine) ** 5)[smooth], atol=0.004)


def measure_range(device):
    """Checks the ranges of values by which denoisers divide, or which they use for lookups."""
    scene, wrong = odd_scene(), 0
    with guide_renderer(device, scene, jitter=True) as renderer:
        for _ in range(4):
            guides = read(renderer.render(scene.camera))
            wrong += sum(int((~np.isfinite(image)).sum()) for image in guides.values())
            length = np.linalg.norm(guides["normal_roughness"][..., :3], axis=-1)
            roughness = guides["normal_roughness"][..., 3]
            wrong += int(((np.abs(length - 1) > 2e-3) & (length > 0)).sum())
            wrong += int(((roughness < 0) | (roughness > 1)).sum()) + int((guides["depth"] < 0).sum())
    yield Measurement(RANGE, float(wrong), 0.0, "values")


def measure_parts(device):
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
            emitted = emitted[emitted.max(axis=-1) > 0]
            off.append(np.abs(emitted - color).max() / color.max() if len(emitted) else np.inf)
    yield Measurement(SUM, float(max(apart)), 1e-6, "of the brightest")
    yield Measurement(BEFORE, float(np.max(off)), 2.0**-9, "of its largest channel")


# ---- mirrors ----------------------------------------------------------------------------------------

# Mirrors in the order in which the camera sees them: position, normal, and half of the side's length. The normals'
# components are whole numbers that add up to 2047, so that the G-buffer holds the normals exactly.
MIRRORS = {
    "one mirror": [((0, 0, 0), (300, 150, 1597), 2.0)],
    "two mirrors": [((0, 0, 0), (-1023, 0, 1024), 1.5), ((-3, 0, 0), (1024, 20, -1003), 3.0)],
}


UNEVEN = place(1.0, (0, 0, 0), 0.7) @ np.diag((2.0, 1.0, 0.5, 1.0)) @ place(1.0, (0, 0, 0), 0.4)


def placed(name, moved):
    """World from a camera and from the mirrors before it, whose normal is their z axis, all moved by centimeters."""
    aside = moved * np.array((0.04, -0.03, 0.02))
    mirrors = [
        _look(np.subtract(at, aside), np.asarray(facing) / 2047 - aside, half) for at, facing, half in MIRRORS[name]
    ]
    return _look((0, 0, 3) + 2 * aside, (0, 0, 1) + 0.2 * aside), mirrors


def reflection_in(mirrors):
    """The matrix from real to virtual positions: the product of the mirrors' reflections, the first one's last."""
    chain = np.eye(4)
    for mirror in mirrors:
        normal = mirror[:3, 2] / np.linalg.norm(mirror[:3, 2])
        householder = np.eye(4)
        householder[:3, :3] -= 2 * np.outer(normal, normal)
        householder[:3, 3] = 2 * normal * (normal @ mirror[:3, 3])
        chain = chain @ householder
    return chain


def _look(at, z_axis, scale=1.0):
    """World from an object (4, 4) with this z axis."""
    return sv.Camera.look_at(at, at - z_axis).transform @ np.diag((scale, scale, 1, 1))


def _camera(transform):
    return sv.Camera(transform=transform, vertical_fov=0.4)


ROUGHNESSES = (0.35, 0.55, 0.7)  # by which the pixels of metals and paint are recognized


def things():
    """What a camera at the origin sees: a wall, two balls of metal and a box; the box is last."""
    ball, (gold, white, paint) = shapes.sphere(0.8, 32), ROUGHNESSES
    return [
        sv.Instance(mesh, sv.Material(**fields), at)
        for mesh, fields, at in (
            (shapes.quad((0, 0, -12), (6, 0, 0), (0, 6, 0)), {"base_color": 0.3}, (0, 0, 0)),
            (ball, {"base_color": (0.9, 0.6, 0.2), "metallic": 1, "perceptual_roughness": gold}, (-0.9, 0.6, -9)),
            (ball, {"base_color": 1.0, "metallic": 1, "perceptual_roughness": white}, (0.9, 0.6, -9)),
            (
                shapes.box(),
                {"base_color": (0.25, 0.5, 0.75), "perceptual_roughness": paint},
                place(1.0, (0, -0.8, -8.5), 0.5),
            ),
        )
    ]


def _differences(shown, seen, reflection, among=np.s_[:]):
    """The differences between what mirrors or glass show and what is seen directly, reflected: by guide the difference
    in 98 % of the pixels `among`, since rays and raster may find an edge in neighboring pixels; bar; and unit."""
    shown_normal, seen_normal = (guides["normal_roughness"][..., :3] for guides in (shown, seen))
    for roughness in ROUGHNESSES:
        assert (np.abs(seen["normal_roughness"][..., 3] - roughness) < 0.004).sum() > 30, "nothing is seen"
    for what, error, bar, unit in (
        ("diffuse albedos", shown["diffuse_albedo"] - seen["diffuse_albedo"], 1.0, "codes"),
        ("specular albedos", shown["specular_albedo"] - seen["specular_albedo"], 1.0, "codes"),
        ("virtual normals", shown_normal - transform_directions(reflection, seen_normal), 2e-3, "of 1"),
        ("virtual depths", shown["depth"] / seen["depth"] - 1, 1e-4, "relative error"),
        ("specular motion", (shown["specular_motion"] - seen["motion"]) * SIZE, PIXEL, "of a pixel"),
    ):
        worst = np.abs(error).reshape(*SIZE, -1).max(axis=-1)[among]
        yield what, float(np.quantile(worst, 0.98)), bar, f"{unit} in 98 % of pixels"


def measure_mirrors(device, name):
    """Guides in mirrors equal those of the mirrored camera without mirrors while everything moves."""
    steps = [placed(name, moved) for moved in (1.0, 0.0)]
    reflections = [reflection_in(mirrors) for _, mirrors in steps]
    behind = [np.linalg.inv(chain) @ camera for chain, (camera, _) in zip(reflections, steps, strict=True)]
    scene = sv.Scene()
    seen = things()
    # Each mirror is a tilted pane of an instance that is scaled unevenly: its normal turns unlike its edges.
    sides = np.linalg.inv(UNEVEN)[:3, :2].T
    pane = shapes.quad((0, 0, 0), *sides)
    for thing in seen:
        scene.add(thing).update(transform=behind[1] @ thing.transform)
    mirrors = [scene.add(pane, MIRROR) for _ in MIRRORS[name]]
    boxes = seen[-1].transform.copy(), behind[1] @ place((1.1, 1, 1), (0.1, -0.75, -8.4), 0.6)
    with guide_renderer(device, scene) as renderer:
        for box, (camera, transforms) in zip(boxes, steps, strict=True):
            seen[-1].update(transform=box)
            for mirror, at in zip(mirrors, transforms, strict=True):
                mirror.update(transform=at @ UNEVEN)
            frame = renderer.render(_camera(camera))
        in_mirrors = read(frame)
        for mirror in mirrors:
            scene.remove(mirror)
        for box, camera in zip(boxes, behind, strict=True):
            seen[-1].update(transform=box)
            frame = renderer.render(_camera(camera))
        directly = read(frame)
    for what, worst, bar, unit in _differences(in_mirrors, directly, reflections[1]):
        yield Measurement(Rule(f"{name}: {what} equal those of the mirrored camera", *_PSR), worst, bar, unit)


def test_an_empty_sky_in_a_mirror_turns_with_the_camera(device):
    """The reflected sky moves when the camera turns, not when the camera moves; it has no depth and no albedo."""
    scene = sv.Scene(sv.Instance(shapes.quad((0, 0, 0), (2, 0, 0), (0, 2, 0)), MIRROR))
    near, moved, turned = (
        sv.Camera.look_at(eye, target, vertical_fov=0.9)
        for eye, target in (((0, 0, 2), (0, 0, 0)), ((0.2, 0.1, 2), (0.2, 0.1, 0)), ((0.2, 0.1, 2), (0.3, 0.1, 0)))
    )
    with guide_renderer(device, scene) as renderer:
        renderer.render(near)
        guides = read(renderer.render(moved))
        assert np.abs(guides["specular_motion"] * SIZE).max() < PIXEL
        assert (guides["depth"] == 0).all()
        assert (guides["diffuse_albedo"] == 0).all()
        assert np.abs(guides["motion"] * SIZE).max() > 1.0
        guides = read(renderer.render(turned))
        assert np.abs(guides["specular_motion"][..., 0] * SIZE[0]).min() > 1.0


# ---- glass ------------------------------------------------------------------------------------------


def measure_wall(device):
    """Through a clear wall of glass, guides are those without it while everything moves; before a lamp, its own."""
    lamp_roughness = 0.9
    bright = sv.Material(base_color=0.0, emissive=rgb(1.0), perceptual_roughness=lamp_roughness)
    glass = sv.Material(base_color=(0.9, 0.8, 0.7), **CLEAR)
    wall = sv.Instance(shapes.quad((0, 0, -4), (2, 0, 0.5), (0, 2, 0)), glass)
    scene = sv.Scene(wall, *things(), sv.Instance(shapes.quad((0, 1.6, -10), (2, 0, 0), (0, 0.2, 0)), bright))
    box, taken = scene.instances[4], []
    with guide_renderer(device, scene) as renderer:
        for visible in (True, False):
            for moved in (0.1, 0.0):
                wall.update(visible=visible, transform=place(at=(0, moved, 0)))
                box.update(transform=place(1.0, (moved, -0.8, -8.5), 0.5 + moved))
                frame = renderer.render(_camera(place(at=(moved, moved / 2, 0))))
            taken.append(read(frame))
    shown, seen = taken
    of_lamp = np.abs(seen["normal_roughness"][..., 3] - lamp_roughness) < 0.004
    for what, worst, bar, unit in _differences(shown, seen, np.eye(4), ~of_lamp):
        yield Measurement(Rule(f"through a clear wall: {what} equal those without it"), worst, bar, unit)
    wrong = shown["normal_roughness"][of_lamp][:, 3] != 0
    yield Measurement(LAMP, float(wrong.mean()) if wrong.size > 50 else np.inf, 0.02, "of its pixels")


NO_WALLS = Bug("passes/guides/write.comp", "is_clear_wall", "return false;")


@pytest.mark.slow  # the driver compiles whole frames
def test_what_a_pane_shows_is_denoised_by_its_own_guides(device):
    colors = np.random.default_rng(7).integers(20, 250, (8, 8, 3), np.uint8).repeat(8, axis=0).repeat(8, axis=1)
    scene = sv.Scene(sv.Camera.look_at((0, 0, 1), (0, 0, -3), vertical_fov=0.8))
    scene.add(shapes.quad((0, 0, -3), (2, 0, 0), (0, 2, 0)), sv.Material(base_color_texture=colors))
    scene.add(shapes.quad((0, 2.5, -2), (0.5, 0, 0), (0, 0, 0.5)), lamp(20.0))
    scene.add(shapes.quad((0, 0, -1), (2, 0, 0), (0, 2, 0)), sv.Material(base_color=0.95, **CLEAR))
    truth, errors = path_traced(device, scene, 512, SIZE, seed=5), []
    for bugs in ((), (NO_WALLS,)):
        with seeded(*bugs), make_renderer(device, scene, SIZE, denoise=True, antialiasing=True, seed=31) as renderer:
            for _ in range(8):
                frame = renderer.render(scene.camera)
            errors.append(relative_mse(np.asarray(frame["radiance"], np.float64)[..., :3], truth))
    print(errors)
    assert errors[0] < 0.05 < errors[1]


# ---- each rule holds, and can fail --------------------------------------------------------------------


def measure_one_mirror(device):
    return measure_mirrors(device, "one mirror")


def measure_two_mirrors(device):
    return measure_mirrors(device, "two mirrors")


@pytest.mark.parametrize(
    "measure",
    [
        measure_one_mirror,
        measure_wall,
        measure_parts,
        *(pytest.param(measure, marks=pytest.mark.slow) for measure in (measure_two_mirrors, measure_range)),
    ],
    ids=lambda measure: measure.__name__,
)
def test_rules_hold(device, measure):
    require(measure(device))


WRITE, MIRRORS_FILE = "passes/guides/write.comp", "passes/guides/mirrors.glsl"


def describing(change):
    """A bug in what guides say of a material."""
    return Bug(WRITE, "describe", f"correct(guides, material, wo); guides.{change};")


test_a_seeded_bug_is_noticed = bug_tests(
    {
        "diffuse albedo of metals": (
            lambda device: test_surfaces_are_the_path_tracers(device, "sphere_grid"),
            describing("diffuse_albedo = material.base.color"),
        ),
        "diffuse albedo": (
            lambda device: test_surfaces_are_the_path_tracers(device, "cornell_box"),
            describing("diffuse_albedo *= 0.9"),
        ),
        "specular albedo": (test_specular_albedo_is_the_directional_albedo, describing("specular_albedo *= 0.9")),
        RANGE: (measure_range, describing("perceptual_roughness = 1.0 / 0.0")),
        SUM: (
            measure_parts,
            Bug(
                "passes/display/compose.comp",
                "main",
                """
        correct();
        uvec2 pixel = gl_GlobalInvocationID.xy;
        if (is_inside(pixel, camera.size)) { emission.at[pixel_index(pixel, camera.size)] *= 0.99; }""",
            ),
        ),
        BEFORE: (
            measure_parts,
            Bug(
                "passes/display/emission.glsl",
                "visible_emission",
                "return this_frame.exposure * correct(pixel, medium);",
            ),
        ),
        "mirrors": (measure_one_mirror, Bug(MIRRORS_FILE, "append_mirror", "return chain;")),
        "motion in mirrors": (
            measure_one_mirror,
            Bug(MIRRORS_FILE, "previous_hit_position", "return world_position + 0.1;"),
        ),
        "previous normals of mirrors": (
            measure_one_mirror,
            Bug(
                MIRRORS_FILE,
                "previous_plane",
                """SurfacePlane plane_before = correct(instance_index, plane);
        vec3 object_normal = plane.normal * mat3(instances.at[instance_index].world_from_object);
        mat3 turn = mat3(previous_instances.at[instance_index].world_from_object);
        return SurfacePlane(plane_before.point, normalize(turn * object_normal));""",
            ),
        ),
        "clear walls": (measure_wall, NO_WALLS),
        LAMP: (
            measure_wall,
            Bug(
                WRITE,
                "replace_primary_surface",
                "Guides found = correct(seen, pixel); found.is_noisy = true; found.shows_light = false; return found;",
            ),
        ),
    }
)
