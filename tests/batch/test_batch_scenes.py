"""Batches of several scenes: the views of a world are bit by bit those of its own scene, and memory is shared."""

from __future__ import annotations

import copy
from unittest.mock import Mock

import numpy as np
import pytest
from support.frames import leaves_nothing

import solari_vk as sv
from solari_vk.batch import results
from solari_vk.bound.binder import SceneBinder
from solari_vk.passes.reference import numbered_seeds
from solari_vk.settings import Settings

SIZE = 13, 9
CAMERAS = np.stack([sv.Camera.look_at(place, (1, 0.8, 1)).transform for place in ((0.7, 1, -2.5), (1.2, 1.3, -2.3))])
OPTIONS = {
    "labels": {"outputs": [name for name in sv.Batch.OUTPUTS if name != "material_id"]},
    "reference": {"seed": 3, "outputs": ["instance_id"]},
    "realtime": {"seed": 3, "settings": Settings(world_cache=False), "outputs": ["depth"]},
}


def checkers():
    pixels = np.full((8, 8, 4), 255, np.uint8)
    pixels[::2, ::2, :3] = 40
    return sv.Texture(sv.TextureImage(pixels))


def bar():
    """Two bones along y: a skinned box with a morph target."""
    mesh = sv.shapes.box((-0.1, 0, -0.1), (0.1, 1, 0.1))
    joints = (mesh.positions[:, 1] > 0.5).astype(np.uint32)[:, None]
    targets = np.zeros((1, *mesh.positions.shape))
    targets[0, :, 0] = 0.3 * mesh.positions[:, 1]
    mesh.deformation = sv.Deformation(joints=joints, joint_weights=np.ones(joints.shape), targets=targets)
    return mesh


def garden():
    """An environment, a sun, a bulb with a body, a texture, alpha, a pose; no emissive mesh."""
    scene = sv.Scene(name="garden")
    tiles = sv.Material(base_color_texture=checkers())
    scene.add(sv.shapes.quad((1, 0, 1), (3, 0, 0), (0, 0, -3)), tiles, name="floor")
    veil = sv.Material(alpha=0.5, alpha_mode="blend")
    scene.add(sv.shapes.sphere(0.4, 16), veil, position=(1.3, 0.6, 0.3), name="veil")
    steel = sv.Material(metallic=1, perceptual_roughness=0.4)
    scene.add(sv.Instance(bar(), steel, name="bar", joint_matrices=[np.eye(4)] * 2, morph_weights=[0.5]))
    scene.add(sv.Environment(np.random.default_rng(1).random((4, 8, 3)), name="sky"))
    scene.add(sv.DirectionalLight((0.3, -1, 0.5), illuminance=3, name="sun"))
    scene.add(sv.PointLight((0.5, 1.2, 0.5), intensity=2, radius=0.1, blocks_light=True, name="bulb"))
    return scene


def edit(scene, frame):
    """Moves, poses and edits of materials, lights, meshes, textures; what is added and removed."""
    if frame == 1 and scene.name == "garden":
        bend = np.eye(4)
        bend[0, 3] = 0.2
        scene.instances["bar"].update(position=(0.6, 0, 0), joint_matrices=[np.eye(4), bend], morph_weights=[1])
        scene.lights["sun"].illuminance = 9
        scene.instances["floor"].material.base_color_texture.image.pixels = np.full((8, 8, 4), 90, np.uint8)
    elif frame == 1:
        scene.instances["short block"].position += (0.1, 0, -0.1)
        scene.instances["tall block"].material = sv.Material(emissive=(1, 2, 0), base_color_texture=checkers())
        scene.instances["tall block"].mesh.positions = scene.instances["tall block"].mesh.positions * 0.9
    elif frame == 2:
        scene.remove(scene.instances[-1])
        scene.add(sv.shapes.sphere(0.3, 12), sv.Material(emissive=(0, 0, 3)), position=(0.4, 0.3, 0.4), name="ball")
        for index in range(20):  # more than the table of instances has
            scene.add(sv.shapes.box(), sv.Material(), scale=0.1, position=(0.1 * index, 1, 1))
    elif frame == 3:
        scene.remove("ball")


def frames_of(batch, poses, scenes, **seeds):
    taken = []
    for frame in range(4):
        for scene in scenes:
            edit(scene, frame)
        batch.render(poses, fov=50, **seeds)
        taken.append({name: batch[name] for name in batch})
    return taken


def three():
    """The first scene twice in different states."""
    scenes = sv.builtin("cornell_box"), garden(), copy.deepcopy(sv.builtin("cornell_box"))
    scenes[2].instances["short block"].position += (0.3, 0.2, 0)
    return scenes


@pytest.mark.parametrize(
    "renderer", ["labels", *(pytest.param(name, marks=pytest.mark.slow) for name in ("reference", "realtime"))]
)
def test_each_world_shows_its_scene(device, renderer):
    options = {"renderer": renderer, **OPTIONS[renderer]}
    a, b, c = three()
    seeds = numbered_seeds(3, 8)
    seeds[6:] = seeds[:2]  # the scene that is there twice
    given = {} if renderer == "labels" else {"seeds": seeds}
    with sv.Batch(device, [a, b, c, a], SIZE, 8, **options) as batch:
        together = frames_of(batch, np.tile(CAMERAS, (4, 1, 1)), (a, b, c), **given)
        assert batch.instances[1][0] is b.instances["floor"]
    for world, own in enumerate(three()):
        views = slice(2 * world, 2 * world + 2)
        with sv.Batch(device, own, SIZE, 2, **options) as batch:
            alone = frames_of(batch, CAMERAS, [own], **{name: numbers[views] for name, numbers in given.items()})
        for frame, (expected, found) in enumerate(zip(alone, together, strict=True)):
            for name, values in expected.items():
                np.testing.assert_array_equal(found[name][views], values, f"{name}, world {world}, frame {frame}")
                np.testing.assert_array_equal(found[name][6:], found[name][:2])
    first = next(iter(together[3].values()))
    assert len({first[2 * world : 2 * world + 2].tobytes() for world in range(3)}) == 3


def room(seed):
    """Equal arrays in objects of their own, and a color of its own."""
    scene = sv.Scene(name=f"room {seed}")
    scene.add(sv.shapes.sphere(1, 100), sv.Material(base_color=(0.1 * seed, 1, 1)), name="ball")
    image = sv.TextureImage(np.random.default_rng(1).integers(0, 255, (128, 128, 4), np.uint8))
    scene.add(sv.shapes.box(), sv.Material(base_color_texture=sv.Texture(image)), position=(2, 0, 0), name="box")
    scene.add(sv.Environment(np.random.default_rng(2).random((64, 128, 3))))
    return scene


def test_equal_meshes_textures_and_environments_are_on_the_device_once(device):
    staging = 4 << 20  # bytes of a buffer of uploads, which comes and goes

    def bytes_of(scenes):
        device.sync_host()
        before = device.memory.bytes_used
        cameras = np.tile(CAMERAS[:1], (8, 1, 1))
        with sv.Batch(device, scenes, SIZE, len(cameras), outputs=["depth"]) as batch:
            batch.render(cameras)
            device.sync_host()
            used = (device.memory.bytes_used - before) % staging
            scenes[0].instances["ball"].mesh.positions = scenes[0].instances["ball"].mesh.positions * 0.5
            depth = batch.render(cameras)["depth"]
            device.sync_host()
            edited = (device.memory.bytes_used - before - used) % staging
        return used, edited, depth

    alone, _, _ = bytes_of([room(1)])
    shared, edited, depth = bytes_of([room(seed) for seed in range(1, 9)])
    ball, image = room(1).instances["ball"].mesh, 128 * 128 * 4
    assert alone > ball.positions.nbytes + ball.triangles.nbytes + image
    assert 0 < shared - alone < 7 * 7_000  # tables and structures of their own
    assert ball.positions.nbytes < edited < alone
    assert (depth[1:] == depth[1]).all()
    assert (depth[0] != depth[1]).any()


@pytest.mark.parametrize(
    ("scenes", "options", "said"),
    [
        ("", {}, "the list of scenes is empty"),
        ("a3", {}, "the scene of world 1 is '3': give a solari_vk.Scene"),
        ("aba", {}, "4 views are no multiple of 3 worlds"),
        ("ab", {"worlds": 4}, "worlds=4 goes with one scene"),
        (None, {"worlds": ["a", "b"]}, "give a list of scenes in its place"),
        ("ab", {"worlds": np.arange(2)}, "give a list of scenes in its place"),
    ],
)
def test_wrong_lists_are_named(device, scenes, options, said):
    known = {"a": sv.builtin("cornell_box"), "b": sv.Scene()}
    given = known["a"] if scenes is None else [known.get(letter, letter) for letter in scenes]
    with pytest.raises(sv.SolariError, match=said):
        sv.Batch(device, given, SIZE, 4, **options)


def test_a_binder_of_a_list_shows_its_scenes_in_worlds_alone(device, monkeypatch):
    scenes = [sv.builtin("cornell_box"), sv.Scene()]
    with leaves_nothing(device):
        binder = SceneBinder(device, scenes)
        with sv.Batch(device, binder, SIZE, 2, outputs=["depth"]) as batch:
            depth = batch.render(CAMERAS[:2], fov=50)["depth"]
            assert np.isfinite(depth[0]).any()
            assert not np.isfinite(depth[1]).any()
        with pytest.raises(sv.SolariError, match="worlds=2 goes with one scene"):
            sv.Batch(device, binder, SIZE, 2, worlds=2)
        for kind, size in ((sv.RayTracer, ()), (sv.PathTracer, (SIZE,)), (sv.Renderer, (SIZE,))):
            with pytest.raises(sv.SolariError, match=f"{kind.__name__}: the SceneBinder has a list of scenes"):
                kind(device, binder, *size)
        binder.destroy()

        def full(device):
            raise sv.DeviceError("no memory")

        # What a batch has made of a list is freed where it can't be made.
        monkeypatch.setattr(results, "TensorPort", full)
        with pytest.raises(sv.DeviceError, match="no memory"):
            sv.Batch(device, scenes, SIZE, 2)
        device.wait_idle()


def test_what_is_for_worlds_of_one_scene_is_named(device):
    scenes = [sv.builtin("cornell_box"), sv.builtin("cornell_box")]
    with sv.Batch(device, scenes, SIZE, 2) as batch:
        for name, what in (("transforms", "instances"), ("world_materials", "instances"), ("world_lights", "lights")):
            with pytest.raises(sv.SolariError, match=f"Batch.{name} is for .* change the {what} of a world's scene"):
                getattr(batch, name)
        assert batch.render_many(CAMERAS[:2], frames=3, fov=50, outputs=["depth"])["depth"].shape == (3, 2, *SIZE[::-1])
        with pytest.raises(sv.SolariError, match=r"Batch\.transforms is for"):
            batch.render_many(CAMERAS[:2], frames=3, fov=50, transforms={"lamp": np.ones((3, 2, 4, 4))})


@pytest.mark.slow
@pytest.mark.parametrize("renderer", ["reference", "realtime"])
def test_worlds_have_portals_of_their_own(device, renderer):
    """Of one and two portals and none below the same sky, which take their share of its samples."""
    options, seeds = {"renderer": renderer, **OPTIONS[renderer], "outputs": []}, numbered_seeds(3, 6)

    def world(index):
        scene = sv.builtin("cornell_box")
        scene.add(sv.Environment(np.random.default_rng(index).random((8, 16, 3)) * 3))
        for number in range((1, 0, 2)[index]):
            scene.add(sv.Portal((0.5 + number, 1, -0.1), (0.4, 0, 0), (0, 0.3 + 0.1 * index, 0)))
        return scene

    def shown(scenes, seeds):
        """Two frames, before and after an edit of the first world's portal."""
        with sv.Batch(device, scenes, SIZE, len(seeds), **options) as batch:
            poses, frames = np.tile(CAMERAS, (len(scenes), 1, 1)), []
            for width in (0.4, 0.2):
                for portal in scenes[0].lights[1:2]:
                    portal.half_u = width, 0, 0
                frames.append(batch.render(poses, fov=50, seeds=seeds, reset=True)["radiance"])
            return np.stack(frames)

    together = shown([world(index) for index in range(3)], seeds)
    assert (together[0, :2] != together[1, :2]).any()
    for index in range(3):
        views = slice(2 * index, 2 * index + 2)
        alone = shown([world(index)], seeds[views])
        frames = slice(None) if index == 0 else slice(1)  # the others aren't edited together
        np.testing.assert_array_equal(together[frames, views], alone[frames], f"world {index}")


def test_an_update_that_failed_is_done_again(device, monkeypatch):
    scenes = [sv.builtin("cornell_box"), sv.builtin("cornell_box")]
    with sv.Batch(device, scenes, SIZE, 2, renderer="reference") as batch:
        dark = batch.render(CAMERAS[:2], samples=1)["radiance"]
        scenes[1].instances["lamp"].material.emissive = (900, 900, 900)
        with monkeypatch.context() as patched:
            patched.setattr(batch._worlds, "_upload", Mock(side_effect=MemoryError))
            with pytest.raises(MemoryError):
                batch.render(CAMERAS[:2], samples=1)
        lit = batch.render(CAMERAS[:2], samples=1)["radiance"]
        assert np.array_equal(lit[0], dark[0])
        assert lit[1].mean() > 5 * dark[1].mean()


def test_a_scene_without_light_is_named(device):
    dark = sv.Scene(name="cellar")
    dark.add(sv.shapes.box(), sv.Material())
    with (
        sv.Batch(device, [sv.builtin("cornell_box"), dark], SIZE, 2, renderer="reference") as batch,
        pytest.warns(UserWarning, match="'cellar' has no light"),
    ):
        assert batch.render(np.tile(CAMERAS[:1], (2, 1, 1)), samples=1)["radiance"][1].max() == 0
