"""Pictures whose rays compute shaders trace equal those by ray queries on lavapipe bit by bit, in scenes of all that
decides about hits; where they differ is listed with its reason."""

from __future__ import annotations

from contextlib import ExitStack
from itertools import count

import numpy as np
import pytest
from support.files import ASSETS
from support.frames import make_renderer, snapshot
from support.scenes import bent_joints, random_items, tube

import solari_vk as sv
from solari_vk.lab.structures import random_rotation
from solari_vk.passes import paths
from solari_vk.renderers.frame_budget import FrameBudget
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte, place

SIZE = (32, 24)
FRAMES = 3
RAYS = 4000  # more than a picture has rows
BUMPS = np.random.default_rng(1).integers(90, 166, (8, 8, 3), np.uint8) | [[[0, 0, 128]]]
HOLES = np.random.default_rng(2).integers(0, 256, (16, 16, 4), np.uint8)
MATERIALS = {
    "opaque": [{}, {"metallic": 1.0, "roughness": 0.1}, {"double_sided": True}],
    "cut-outs": [{"base_color_texture": HOLES, "alpha_mode": "mask", "double_sided": True}, {}],
    "blended": [
        {"base_color_texture": HOLES, "alpha_mode": "blend"},
        {"alpha": 0.4, "alpha_mode": "blend", "double_sided": True},
        {"base_color_texture": HOLES, "alpha_mode": "mask"},
        {"roughness": 0.0, "metallic": 1.0},
    ],
    "glass": [
        {"transmission": 1.0, "roughness": 0.0, "solid": True, "attenuation_color": (0.9, 0.5, 0.2), "dispersion": 0.5},
        {"transmission": 1.0, "roughness": 0.0, "double_sided": True},
        {"transmission": 0.8, "roughness": 0.4, "solid": True},
    ],
    "layers": [
        {"normal_texture": BUMPS, "clearcoat": 1.0},
        {"normal_texture": BUMPS, "metallic": 1.0, "anisotropy": 0.7, "roughness": 0.3},
        {"sheen_color": 1.0, "diffuse_transmission": 0.5},
        {"base_color_texture": HOLES, "unlit": True},
    ],
}


def still_life(name, spread=1.0, at=(0, 0, 0)):
    """Turned and stretched things of these materials on a floor below a sky, a lamp and a small light."""
    rng, scene = np.random.default_rng(11), sv.Scene()
    meshes = [shapes.sphere(0.5, 10), shapes.box(), shapes.quad((0, 0, 0), (0.6, 0, 0), (0, 0.6, 0))]
    for number in range(24):
        transform = np.eye(4)
        transform[:3, :3] = random_rotation(rng) @ np.diag(rng.uniform(0.2, 0.9, 3) * rng.choice((-1, 1), 3))
        transform[:3, 3] = np.array((0, 1.1, 0)) + spread * rng.uniform((-2, -1, -2), (2, 1, 2)) + at
        fields = {"base_color": rng.random(3), **MATERIALS[name][number % len(MATERIALS[name])]}
        scene.add(sv.Instance(meshes[number % 3], sv.Material(**fields), transform, name=f"thing {number}"))
    scene.add(shapes.quad((0, 0, 0), (0, 0, 6), (6, 0, 0)), matte(0.6), transform=place(at=at))
    scene.add(shapes.quad((0, 4, 0), (0.5, 0, 0), (0, 0, 0.5)), lamp(20.0), transform=place(at=at))
    scene.add(sv.PointLight(np.add((2, 2, 2), at), intensity=30.0, radius=0.1))
    scene.environment = sv.Environment((0.4, 0.5, 0.6))
    scene.camera = sv.Camera.look_at(np.add((1, 2.2, 5), at), np.add((0, 0.9, 0), at))
    return scene


# ---- scenes: what makes one, and what changes before each frame --------------------------------------


def posed():
    scene, (mesh, rest) = still_life("layers"), tube(targets=1)
    scene.add(sv.Instance(mesh, sv.Material(normal_texture=BUMPS), joint_matrices=rest, morph_weights=[0], name="tube"))
    return scene


def bend(scene, frame):
    tube_, rest = scene.instances["tube"], tube()[1]
    tube_.joint_matrices, tube_.morph_weights = bent_joints(rest, 0.2 * frame), [0.5 * frame]


def move(scene, frame):
    """Instances move, hide, come and go; a material becomes blended, another one masked."""
    first, second, third, fourth = (scene.instances[f"thing {number}"] for number in (0, 3, 6, 9))
    first.transform = place(at=(0.3, 0.1 * frame, 0)) @ first.transform
    second.visible = frame % 2 == 0
    third.material.update(alpha=0.5, alpha_mode="blend" if frame % 2 else "opaque")
    fourth.material.update(base_color_texture=HOLES, alpha_mode="mask" if frame % 2 else "opaque")
    scene.add(sv.Instance(shapes.sphere(0.2 + 0.1 * frame, 6), matte(0.3), place(at=(frame - 1, 2, 1))))


def edit(scene, frame):
    """A mesh gets other vertices, one more triangle or less of them; a proxy replaces another for rays."""
    ball = scene.instances["thing 0"].mesh
    ball.positions = ball.positions * (1 + 0.2 * np.sin(7 * ball.positions[:, ::-1] + frame))
    box = scene.instances["thing 1"]
    box.mesh = shapes.sphere(0.4, 5 + frame)
    scene.instances["thing 2"].ray_mesh = shapes.box() if frame % 2 else None


def file_scene(name):
    def load():
        scene = sv.load(ASSETS / name)
        if not scene.lights:
            scene.environment = sv.Environment((0.6, 0.7, 0.8))
        return scene

    return load


def animate(scene, frame):
    if scene.animations:
        scene.animate(0.3 * frame)


def stay(scene, frame):
    """Change nothing."""


SCENES = {
    **{name: (lambda name=name: still_life(name), stay) for name in MATERIALS},
    "poses": (posed, bend),
    "things that move": (lambda: still_life("opaque"), move),
    "panes that move": (lambda: still_life("blended"), move),
    "meshes that change": (lambda: still_life("cut-outs"), edit),
    "far away": (lambda: still_life("cut-outs", at=(3e5, 0, -2e5)), move),
    **{f"unusual {n}": (lambda n=n: sv.Scene(*random_items(np.random.default_rng(n))), stay) for n in range(8)},
}
FILES = {
    name: (file_scene(name), animate)
    for name in (
        "FlightHelmet/FlightHelmet.gltf",
        "Fox/Fox.glb",
        "MorphStressTest/MorphStressTest.gltf",
        "AnisotropyBarnLamp/AnisotropyBarnLamp.gltf",
        "khronos_tests/AlphaBlendModeTest.glb",
        "khronos_tests/TransmissionRoughnessTest.glb",
        "kaykit_dungeon/wall_window_open.glb",
        "kaykit_dungeon/table_medium_tablecloth.glb",
    )
}


ORDER_OF_PANES = "the last bit: a ray multiplies the filters of panes in the order in which it finds them"
TIES = {
    "glass": (2, ORDER_OF_PANES),
    "exposures": (2, ORDER_OF_PANES),
    "MorphStressTest/MorphStressTest.gltf": (2, "the box stands in the plane of the ground"),
}
"""Of scenes: the pixels or rays that may differ in one result, and why."""


@pytest.fixture(scope="module")
def devices(any_device):
    with ExitStack() as opened:
        yield [opened.enter_context(sv.Device(validation=False, rays=way)) for way in ("query", "compute")]


def pictures(device, make, change):
    """All outputs of a few realtime frames and of the path tracer, with jitter, a lens and a medium's worth of rays."""
    scene, found = make(), {}
    renderer = make_renderer(device, scene, SIZE, seed=3, gbuffer="traced", jitter=True)
    tracer = sv.PathTracer(device, scene, SIZE, seed=3)
    with renderer, tracer, sv.RayTracer(device, scene) as rays:
        for frame in range(FRAMES):
            change(scene, frame)
            found |= {f"{name} {frame}": array for name, array in snapshot(renderer.render(scene.camera)).items()}
            traced = tracer.render(scene.camera, samples=2)
            found |= {f"path tracer: {name} {frame}": traced[name].copy() for name in tracer.OUTPUTS}
        for kind, records in random_rays(rays, scene).items():
            found |= {f"{kind}: {name}": records[name].copy() for name in records.dtype.names}
    return found


def random_rays(tracer, scene):
    """Hits of rays through the scene's bounds, any of them, and echoes."""
    rng = np.random.default_rng(6)
    low, high = scene.bounds if scene.instances else (np.full(3, -1.0), np.ones(3))
    origins, aims = (rng.uniform(low - 0.1 * (high - low), high + 0.1 * (high - low), (RAYS, 3)) for _ in range(2))
    hits, echoes = tracer.backscatter(origins, aims - origins)
    closest = tracer.trace(origins, aims - origins, seed=1)
    between = tracer.trace(origins, aims - origins, t_min=0.1, t_max=0.8)
    return {"closest": closest, "between": between, "lidar": hits, "echoes": echoes}


def differing(query, compute):
    """The number of pixels or rays that differ, by name."""
    assert query.keys() == compute.keys()
    counts = {}
    for name, expected in query.items():
        pixels = expected.shape[:1] if len(expected) == RAYS else expected.shape[:2]
        same = _bytes(expected, pixels) == _bytes(compute[name], pixels)
        if not same.all():
            counts[name] = int((~same.all(axis=-1)).sum())
    return counts


def _bytes(array, shape):
    return np.ascontiguousarray(array).reshape(*shape, -1).view(np.uint8)


def check_ties(name, counts):
    ties, reason = TIES.get(name, (0, ""))
    assert max(counts.values(), default=0) <= ties, f"{counts}; of which may differ: {ties}: {reason}"


@pytest.mark.slow
@pytest.mark.parametrize("name", [*SCENES, *FILES])
def test_pictures_are_equal(devices, name):
    found = [pictures(device, *(SCENES | FILES)[name]) for device in devices]
    check_ties(name, differing(*found))
    if not name.startswith("unusual"):
        picture = found[1]["path tracer: raw_radiance 2"]
        assert np.median(picture.max(axis=-1)) > 0, "a picture of nothing proves nothing"


@pytest.mark.parametrize("lacked", ["descriptorIndexing", "shaderFloat64"])
@pytest.mark.parametrize(
    "name", ["blended", *(pytest.param(n, marks=pytest.mark.slow) for n in ("layers", "poses", "glass"))]
)
def test_pictures_without_features(devices, monkeypatch, name, lacked):
    """Without doubles they are the same but for roundings, with textures in buffers but for those of filters; some rays
    decide otherwise then."""
    monkeypatch.setenv("SOLARI_VK_HIDDEN_FEATURES", lacked)
    with sv.Device(validation=True, rays="compute") as device:
        found = pictures(device, *SCENES[name])
    for output, expected in pictures(devices[1], *SCENES[name]).items():
        largest = np.abs(expected[np.isfinite(expected)]).max(initial=0.0)
        near = np.isclose(found[output], expected, rtol=0.01, atol=1e-3 * largest, equal_nan=True)
        assert near.mean() > 0.97, output


@pytest.mark.parametrize(
    "settings", [{}, {"restir": True}, {"frame_ms": 5.0, "denoise": True}], ids=["paths", "restir", "frame_ms"]
)
@pytest.mark.parametrize(
    "name", ["blended", *(pytest.param(name, marks=pytest.mark.slow) for name in SCENES if name != "blended")]
)
def test_rays_that_are_traced_apart_find_the_same_light(devices, monkeypatch, name, settings):
    """As GPUs that trace by compute shaders do: passes of their own trace what others have chosen. Compilers round
    elsewhere then, by a few units of the last place."""
    monkeypatch.setattr(paths, "WAVES_APART", paths.WAVES)  # wavelengths are rounded between waves
    monkeypatch.setattr(FrameBudget, "choose", lambda self, *limits: 0.7)  # the frame's time would decide
    found = []
    # Whole; in waves to the end; and from the third wave on by the last one, as few paths go.
    for apart, few in ((False, 0), (True, 0), (True, 90)):
        monkeypatch.setattr(paths, "apart_bytes", lambda *_, apart=apart: apart << 27)
        monkeypatch.setattr(paths, "FEW_PATHS", few)
        make, change = SCENES[name]
        scene, frames = make(), {}
        with make_renderer(devices[1], scene, SIZE, seed=3, gbuffer="traced", **settings) as renderer:
            names = {step.name.split(" ")[0] for stage in renderer.stages for step in stage.passes}
            assert ({"paths/trace", "world_cache/trace"} <= names) == apart
            for frame in range(2 * FRAMES):
                change(scene, frame)
                shown = snapshot(renderer.render(scene.camera))
                frames |= {f"{output} {frame}": array for output, array in shown.items()}
        found.append(frames)
    check_near(found[0], found[1])
    check_near(found[0], found[2])


def check_near(expected, found):
    for output, values in expected.items():
        largest = np.abs(values[np.isfinite(values)]).max(initial=0.0)
        near = np.isclose(found[output], values, rtol=1e-5, atol=1e-6 * largest, equal_nan=True)
        assert near.all(), output


def exposures(device):
    """A picture by a lens, one of things that move, and light on points."""
    scene = still_life("blended")
    scene.camera.update(aperture=0.3, focus_distance=4.0)
    first, base = scene.instances["thing 0"], scene.instances["thing 0"].transform

    def pose(seconds):
        first.transform = place(at=(0.5 * seconds, 0, 0)) @ base

    with sv.PathTracer(device, scene, SIZE, seed=4) as tracer:
        found = {"lens": tracer.render(samples=4)["raw_radiance"].copy()}
        found["motion"] = tracer.render(samples=8, shutter=sv.Shutter(close=1.0, time_samples=4), pose=pose)["radiance"]
    points = np.random.default_rng(3).uniform((-2, 0.01, -2), (2, 0.01, 2), (20, 3))
    found["lux"] = np.asarray(sv.illuminance(device, scene, points, samples=32).lux)[:, None]
    return found


def worlds(device):
    """Views of worlds in which things are in other places."""
    scene = still_life("blended")
    found = {}
    for renderer in ("reference", "realtime"):
        with sv.Batch(device, scene, (16, 12), 3, renderer=renderer, worlds=3, outputs=sv.Batch.OUTPUTS) as batch:
            for number in range(0, 12, 2):
                places = batch.transforms[f"thing {number}"]
                places[:, 0, 3] += [0.0, 0.3, 0.1 * number]
                batch.transforms[f"thing {number}"] = places
            for frame in range(2):
                batch.render([scene.camera] * 3, **({"samples": 2} if renderer == "reference" else {}))
                found |= {f"{renderer}: {name} {frame}": batch[name].reshape(36, 16, -1) for name in batch}
    return found


@pytest.mark.slow
@pytest.mark.parametrize("taken", [exposures, worlds])
def test_exposures_and_worlds_are_equal(devices, taken):
    check_ties(taken.__name__, differing(*map(taken, devices)))


# ---- a thousand frames of edits ----------------------------------------------------------------------


def edit_at_random(scene, rng):
    """One change of many kinds: of places, meshes, poses, visibility, proxies, materials, or what there is."""
    kind = rng.integers(9)
    things = [instance for instance in scene.instances if instance.name.startswith("thing")]
    thing = things[rng.integers(len(things))]
    if kind <= 1:
        thing.transform = place(at=rng.uniform(-0.3, 0.3, 3), turn=rng.uniform(-1, 1)) @ thing.transform
    elif kind == 2:
        thing.visible = not thing.visible
    elif kind == 3:
        thing.ray_mesh = None if thing.ray_mesh else shapes.sphere(0.4, int(rng.integers(4, 9)))
    elif kind == 4:
        thing.mesh.positions = thing.mesh.positions + rng.normal(0, 0.02, thing.mesh.positions.shape)
    elif kind == 5:
        mode = ("opaque", "mask", "blend")[rng.integers(3)]
        texture = HOLES if rng.random() < 0.5 else None
        thing.material.update(alpha_mode=mode, alpha=rng.choice((0.4, 1.0)), base_color_texture=texture)
    elif kind == 6:
        bend(scene, rng.uniform(-2, 2))
    elif kind == 7 or len(things) < 12:
        name = f"thing {rng.integers(1 << 30)}"
        scene.add(sv.Instance(shapes.sphere(0.3, 6), matte(rng.random(3)), place(at=rng.uniform(-1, 2, 3)), name=name))
    else:
        scene.remove(thing)


def surfaces_and_rays(renderer, tracer, rays, scene):
    """A frame, the path tracer's picture, and the hits of random rays, with the names of what they hit."""
    frame, traced = snapshot(renderer.render()), tracer.render(samples=1)
    hits, names = random_rays(rays, scene)["lidar"], {number: one.name for number, one in rays.instances.items()}
    found = {name: hits[name].copy() for name in hits.dtype.names}
    found["instance"] = np.array([names.get(number, "") for number in hits["instance"]])
    return {**frame, "paths": traced["raw_radiance"].copy(), **found}


def made_for(device, scene):
    """A renderer, a path tracer and a ray tracer."""
    size = (16, 12)
    yield make_renderer(device, scene, size, seed=3, gbuffer="traced", jitter=False)
    yield sv.PathTracer(device, scene, size, seed=3)
    yield sv.RayTracer(device, scene)


def changing(device):
    """Frames of a scene that changes before each, without end, and the scene. In every fiftieth nothing in sight is
    blended, so that nothing depends on the order in which things came."""
    scene, (mesh, rest), rng = still_life("blended"), tube(targets=1), np.random.default_rng(8)
    scene.add(sv.Instance(mesh, matte(0.5), joint_matrices=rest, morph_weights=[0], name="tube"))
    # Below the floor: new renderers use as many random numbers a ray as those that have seen blended things.
    scene.add(shapes.box(), sv.Material(alpha=0.5, alpha_mode="blend", name="hidden"), transform=place(0.1, (0, -1, 0)))
    with ExitStack() as opened:
        made = [opened.enter_context(one) for one in made_for(device, scene)]
        for frame in count(1):
            edit_at_random(scene, rng)
            for instance in scene.instances if frame % 50 == 0 else ():
                if instance.material.alpha_mode == "blend" and instance.material.name != "hidden":
                    instance.material.alpha_mode = "opaque"
            yield surfaces_and_rays(*made, scene) if frame % 50 == 0 else snapshot(made[0].render()), scene


@pytest.mark.slow
def test_a_thousand_frames_are_those_of_queries_and_of_new_renderers(devices):
    """Bit by bit, but for the light of panes: see TIES."""
    light = {"radiance", "diffuse_radiance", "specular_radiance", "raw_radiance", "paths_diffuse", "paths_specular"}
    kept, last = {"depth", "gbuffer", "guides_normal_roughness", "paths"}, []
    for frame, (query, compute) in zip(range(1, 1001), zip(*map(changing, devices), strict=True), strict=False):
        counts = differing(query[0], compute[0])
        assert counts.keys() <= light, frame
        assert max(counts.values(), default=0) <= 2, frame
        if frame % 50:
            continue
        with ExitStack() as opened:
            scene = compute[1]
            new = surfaces_and_rays(*(opened.enter_context(one) for one in made_for(devices[1], scene)), scene)
        shared = [name for name in new if name in kept or len(new[name]) == RAYS]
        assert len(shared) == 11
        assert differing(*({name: frame[name] for name in shared} for frame in (new, compute[0]))) == {}, frame
        last.append(compute[0]["t"])
    assert len({hits.tobytes() for hits in last}) == 20
    assert 0.1 < np.isfinite(last).mean() < 0.9
