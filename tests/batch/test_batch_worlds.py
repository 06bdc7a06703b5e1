"""Batches of worlds: the views of a world are bit by bit those of a scene with its transforms."""

from __future__ import annotations

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.batch.light_changes import WORLD, LightChanges, LightState
from solari_vk.passes import world_cache
from solari_vk.passes.reference import numbered_seeds
from solari_vk.settings import Settings

SIZE, WORLDS = (13, 9), 3
MOVED = ("short block", "tall block")
CAMERAS = np.stack([sv.Camera.look_at(place, (1, 0.8, 1)).transform for place in ((0.7, 1, -2.5), (1.2, 1.3, -2.3))])
OPTIONS = {
    "labels": {"outputs": sv.Batch.OUTPUTS},
    "reference": {"seed": 3, "outputs": ["instance_id"]},
    "realtime": {"seed": 3, "settings": Settings(world_cache=False), "outputs": ["depth"]},
}


def transforms(frame, name, scene):
    """Of an instance in all worlds."""
    moves = [
        sv.Camera.look_at((0.1 * world + 0.02 * frame, 0, 0.05 * world), (world + 1, 0, -5)).transform
        for world in range(WORLDS)
    ]
    return np.stack(moves) @ scene.instances[name].transform


def frames_of(batch, poses, seeds=None, apply=None):
    taken = []
    for frame in range(3):
        apply(batch, frame)
        batch.render(poses, fov=50, **({} if seeds is None else {"seeds": seeds}))
        taken.append({name: batch[name] for name in batch})
    return taken


@pytest.mark.parametrize(("renderer", "upscale"), [*((name, 1.0) for name in OPTIONS), ("realtime", 1.5)])
def test_worlds_are_scenes_of_their_own(device, renderer, upscale):
    scene, options = sv.builtin("cornell_box"), {"renderer": renderer, **OPTIONS[renderer]}
    if upscale > 1:  # a workgroup may have pixels of several worlds
        options["settings"] = Settings(world_cache=False, upscale=upscale)
    given = {name: [transforms(frame, name, scene) for frame in range(3)] for name in MOVED}

    def move_worlds(batch, frame):
        for name in MOVED:
            batch.transforms[name] = given[name][frame]
            np.testing.assert_array_equal(batch.transforms[name], given[name][frame])

    views = 2 * WORLDS
    with sv.Batch(device, scene, SIZE, views, worlds=WORLDS, **options) as batch:
        together = frames_of(batch, np.tile(CAMERAS, (WORLDS, 1, 1)), apply=move_worlds)
        assert len(batch.transforms) == 2
    seeds = None if renderer == "labels" else numbered_seeds(3, views).reshape(WORLDS, 2)
    for world in range(WORLDS):
        own = sv.builtin("cornell_box")

        def move(batch, frame, world=world, own=own):
            for name in MOVED:
                own.instances[name].transform = given[name][frame][world]

        with sv.Batch(device, own, SIZE, 2, **options) as batch:
            alone = frames_of(batch, CAMERAS, None if seeds is None else seeds[world], move)
        for frame, (expected, found) in enumerate(zip(alone, together, strict=True)):
            for name, values in expected.items():
                np.testing.assert_array_equal(found[name][2 * world : 2 * world + 2], values, f"{name}, frame {frame}")
    first = next(iter(together[0].values()))
    assert len({first[2 * world : 2 * world + 2].tobytes() for world in range(WORLDS)}) == WORLDS


def test_the_world_cache_has_cells_for_each_world(device):
    """Light of one world isn't found in another: a wall hides the lamp in the second one."""
    scene = sv.Scene()
    grey = sv.Material(base_color=(0.8, 0.8, 0.8))
    scene.add(sv.shapes.box((-1, -1, -1), (1, 1, 1), inward=True), grey)
    scene.add(sv.shapes.quad((0, 0.99, 0), (0.25, 0, 0), (0, 0, 0.25)), sv.Material(emissive=(10, 10, 10)))
    scene.add(sv.shapes.box((-1, -0.02, -1), (1, 0.02, 1)), grey, name="wall", position=(0, 5, 0))
    pose = sv.Camera.look_at((0, -0.5, 0.9), (0, -0.8, -1)).transform
    with sv.Batch(device, scene, (16, 16), 2, renderer="realtime", worlds=2, outputs=()) as batch:
        hidden = np.tile(scene.instances["wall"].transform, (2, 1, 1))
        hidden[1, 1, 3] = 0.5
        batch.transforms["wall"] = hidden
        for _ in range(12):
            radiance = batch.render([pose, pose], fov=60)["radiance"]
        assert radiance[0].mean() > 0.1
        assert radiance[1].max() == 0
        checksums, worlds = (batch._realtime.frame[f"world_cache_{name}"] for name in ("checksums", "worlds"))
        cells = np.flatnonzero(checksums)
        np.testing.assert_array_equal(worlds[cells], cells // (len(checksums) // 2))  # each in its part of the map
        assert set(worlds[cells]) == {0, 1}
        hidden[0], hidden[1, 1, 3] = hidden[1].copy(), 5
        batch.transforms["wall"] = hidden
        radiance = batch.render([pose, pose], fov=60, reset=True, reset_cache=True)["radiance"]
        assert radiance[0].max() == 0
        assert radiance[1].mean() > 0.1


@pytest.mark.parametrize("renderer", ["labels", "reference", "realtime"])
def test_edits_of_the_scene_reach_all_worlds(device, renderer):
    scene = sv.builtin("cornell_box")
    poses = np.tile(CAMERAS[:1], (WORLDS, 1, 1))
    options = {"worlds": WORLDS, "outputs": ["depth", "instance_id"], "renderer": renderer}
    with sv.Batch(device, scene, SIZE, WORLDS, **options) as batch:
        before = batch.render(poses)["depth"]
        np.testing.assert_array_equal(before, np.tile(before[:1], (WORLDS, 1, 1)))
        rows = batch.binder.instance_capacity
        for index in range(rows):  # more than the table of instances has
            scene.add(sv.shapes.box(), sv.Material(), position=(9 + index, 0, 0))
        block = scene.add(sv.shapes.box(), sv.Material(), scale=0.3, position=(1, 1, 0.2))
        apart = np.tile(block.transform, (WORLDS, 1, 1))
        apart[:, 0, 3] = 0.5, 1, 1.5
        batch.transforms[block] = apart
        batch.render(poses)
        assert batch.binder.instance_capacity > rows
        [row] = [row for row, other in batch.instances.items() if other is block]
        middles = [np.argwhere(picture == row)[:, 1].mean() for picture in batch["instance_id"]]
        assert np.abs(np.diff(middles)).min() > 1
        scene.remove(block)
        batch.render(poses)
        assert (batch["instance_id"] != row).all()
        np.testing.assert_array_equal(batch["depth"], before)
        assert not batch.transforms


def test_histories_outlive_a_larger_table_of_instances(device):
    taken = []
    for grows in (False, True):
        scene = sv.builtin("cornell_box")
        with sv.Batch(device, scene, SIZE, 2, worlds=2, **OPTIONS["realtime"] | {"renderer": "realtime"}) as batch:
            for _ in range(4):
                batch.render(CAMERAS, fov=50)
            rows = batch.binder.instance_capacity
            for index in range(rows if grows else 1):
                scene.add(sv.shapes.box(), sv.Material(), position=(index, 0, -50))
            batch.render(CAMERAS, fov=50)
            assert (batch.binder.instance_capacity > rows) == grows
            taken.append(batch["radiance"])
    np.testing.assert_array_equal(*taken)


def test_transforms_go_back_to_the_scenes(device):
    scene = sv.builtin("cornell_box")
    with sv.Batch(device, scene, SIZE, 2, worlds=2, outputs=["depth"]) as batch:
        poses = np.tile(CAMERAS[:1], (2, 1, 1))
        before = batch.render(poses)["depth"]
        batch.world_materials["short block"] = [sv.Material(), sv.Material()]
        apart = np.tile(scene.instances["short block"].transform, (2, 1, 1))
        apart[:, 1, 3] += 5
        batch.transforms["short block"] = apart
        assert (batch.render(poses)["depth"] != before).any()
        del batch.transforms["short block"]
        np.testing.assert_array_equal(batch.render(poses)["depth"], before)


@pytest.mark.parametrize("change", [{"scale": 3, "position": (0, 0.7, 0)}, {"joint_matrices": [np.diag((2, 2, 2, 1))]}])
def test_lamps_of_worlds_move_with_the_scene(device, change):
    """What emits light in worlds alone, at the scene's place and in its pose."""
    powers, box = [], sv.shapes.box()
    count = len(box.positions)
    box.deformation = sv.Deformation(joints=np.zeros((count, 1), np.uint32), joint_weights=np.ones((count, 1)))
    for moved_early in (True, False):
        scene = sv.builtin("cornell_box")
        scene.instances["tall block"].update(mesh=box, joint_matrices=[np.eye(4)])
        with sv.Batch(device, scene, SIZE, 2, worlds=2, outputs=["depth"]) as batch:
            batch.world_materials["tall block"] = [sv.Material(emissive=(5, 5, 5)), sv.Material(emissive=(1, 9, 1))]
            if not moved_early:
                batch.render(np.tile(CAMERAS[:1], (2, 1, 1)))
            scene.instances["tall block"].update(**change)
            batch.render(np.tile(CAMERAS[:1], (2, 1, 1)))
            powers.append([(known.powers, known.positions) for known in batch._worlds.light_states])
    for early, late in zip(*powers, strict=True):
        np.testing.assert_array_equal(late[0], early[0])
        np.testing.assert_array_equal(late[1], early[1])


def test_emissive_textures_of_worlds_change(device):
    """Of what emits light in worlds alone: as if the texture had been so from the beginning."""
    powers = []
    for early in (True, False):
        image = sv.TextureImage(np.full((2, 2, 3), 255, np.uint8))
        dark = np.full((2, 2, 3), 90, np.uint8)
        dark[0] = 30
        lamp = sv.Material(emissive=(5, 5, 5), emissive_texture=sv.Texture(image))
        with sv.Batch(device, sv.builtin("cornell_box"), SIZE, 2, worlds=2, outputs=["depth"]) as batch:
            batch.world_materials["tall block"] = [lamp, sv.Material()]
            if not early:
                batch.render(np.tile(CAMERAS[:1], (2, 1, 1)))
            image.pixels = dark
            batch.render(np.tile(CAMERAS[:1], (2, 1, 1)))
            powers.append(batch._worlds.light_states[0].powers)
    np.testing.assert_array_equal(powers[1], powers[0])


def test_worlds_stay_as_they_were_without_memory(device, monkeypatch):
    scene, _ = own_room(False)
    lamps, make = [sv.Material(emissive=(1, 1, 1)), sv.Material()], device.buffer

    def refuse(size, name, **options):
        if name == "light_sources":
            raise sv.DeviceError("out of memory")
        return make(size, name, **options)

    with sv.Batch(device, scene, SIZE, 2, worlds=2, outputs=["depth"]) as batch:
        batch.world_lights["sun"] = [None, None]
        batch.render(np.tile(CAMERAS[:1], (2, 1, 1)))
        batch.world_materials["short block"] = batch.world_materials["tall block"] = lamps
        monkeypatch.setattr(device, "buffer", refuse)
        with pytest.raises(sv.DeviceError, match="out of memory"):
            batch.render(np.tile(CAMERAS[:1], (2, 1, 1)))
        monkeypatch.setattr(device, "buffer", make)
        batch.world_materials.clear()
        batch.render(np.tile(CAMERAS[:1], (2, 1, 1)))


def own_room(everything):
    """The Cornell box with a sun. everything: what costs shaders of their own too, a bulb and a sky."""
    scene, lights = sv.builtin("cornell_box"), [sv.DirectionalLight((0.1, -0.3, 1), illuminance=20, name="sun")]
    if everything:
        lights.append(sv.PointLight((0.5, 1.2, 1.1), intensity=3, radius=0.1, blocks_light=True, name="bulb"))
        lights.append(sv.Environment(np.full((4, 8, 3), 0.3), name="sky"))
    for light in lights:
        scene.add(light)
    return scene, lights


def materials_of(world, everything):
    """The tall block shines in world 2; the lamp is off in world 1."""
    tall = sv.Material(metallic=1, perceptual_roughness=0.2 + 0.3 * world, emissive=(0, 0.2 * (world == 2), 0))
    made = {"tall block": tall, "lamp": sv.Material(emissive=np.array((9, 4, 1)) * (world != 1))}
    if everything:
        image = sv.TextureImage(np.random.default_rng(world).integers(0, 255, (4, 4, 4), np.uint8))
        mode = "mask" if world == 1 else "opaque"
        made["short block"] = sv.Material(base_color_texture=sv.Texture(image), alpha_mode=mode)
    return made


def lights_of(world, everything):
    """World 0 has no sun, and a lamp in place of the environment; the bulb of world 1 casts no shadow."""
    made = {"sun": sv.DirectionalLight((0.3 * world, -0.3, 1), illuminance=9 * world) if world else None}
    if everything:
        place = 0.5, 1, 1 + 0.1 * world
        made["bulb"] = sv.PointLight(place, intensity=1 + world, radius=0.1, blocks_light=world != 1)
        sky = sv.Environment(np.random.default_rng(world).random((4 + world, 8, 3)))
        made["sky"] = sky if world else sv.PointLight((1, 1, 0.5), intensity=2)
    return made


def begin_noise_again(batch, reset=False):
    """Let the next frame of a realtime batch have the noise of the first; the reference's never differs."""
    if batch._realtime is not None:
        batch._realtime.frame_count = 0
        if reset:
            batch._realtime.reset()


@pytest.mark.parametrize("everything", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("renderer", ["reference", "realtime"])
def test_worlds_have_materials_and_lights_of_their_own(device, renderer, everything):
    """Also when these are edited, with the lamp moved in each world, and when all go back to the scene's."""
    options = {"renderer": renderer, **OPTIONS[renderer], "outputs": ["albedo", "material_id"]}
    scene, _ = own_room(everything)
    materials = [materials_of(world, everything) for world in range(WORLDS)]
    lights = [lights_of(world, everything) for world in range(WORLDS)]
    lamp_places = np.tile(scene.instances["lamp"].transform, (WORLDS, 1, 1))
    lamp_places[:, :3, 3] += np.outer(np.arange(WORLDS), (0.1, -0.2, 0.05))

    def together(batch, frame):
        if frame == 0:
            for name in materials[0]:
                batch.world_materials[name] = [made[name] for made in materials]
            for name in lights[0]:
                batch.world_lights[name] = [made[name] for made in lights]
        for of_world, lit in zip(materials, lights, strict=True):
            edit_world(frame, of_world, lit)
        if frame == 2:
            batch.transforms["lamp"] = lamp_places

    views, poses = 2 * WORLDS, np.tile(CAMERAS, (WORLDS, 1, 1))
    with sv.Batch(device, scene, SIZE, views, worlds=WORLDS, **options) as batch:
        before = batch.render(poses, fov=50)["radiance"]
        begin_noise_again(batch, reset=True)
        found = frames_of(batch, poses, apply=together)
        assert batch.world_lights["sun"] == [made["sun"] for made in lights]
        shown = {batch.materials[row] for row in np.unique(found[2].pop("material_id")) if row in batch.materials}
        assert {made["tall block"] for made in materials} < shown
        for given in (batch.world_materials, batch.world_lights, batch.transforms):
            given.clear()
        begin_noise_again(batch)
        np.testing.assert_array_equal(batch.render(poses, fov=50, reset=True)["radiance"], before)
    seeds = numbered_seeds(3, views).reshape(WORLDS, 2)
    for world in range(WORLDS):
        alone = frames_of_one_world(device, options, everything, world, lamp_places[world], seeds[world])
        for frame, expected in enumerate(alone):
            for name in expected.keys() - {"material_id"}:
                of_views = found[frame][name][2 * world : 2 * world + 2]
                np.testing.assert_array_equal(of_views, expected[name], f"{name}, world {world}, frame {frame}")


def edit_world(frame, materials, lights):
    """What a frame of the test above changes in the materials and lights of a world."""
    if frame == 1:
        materials["tall block"].base_color = 0.9, 0.2, 0.1
        if lights["sun"] is not None:
            lights["sun"].illuminance *= 5
    elif frame == 2:
        materials["lamp"].emissive = materials["lamp"].emissive * 2


def frames_of_one_world(device, options, everything, world, lamp_place, seeds):
    """The frames of a batch of the test above that has one world alone, whose scene has what that world has."""
    scene, scene_lights = own_room(everything)
    materials, lights = materials_of(world, everything), lights_of(world, everything)
    for name, material in materials.items():
        scene.instances[name].material = material
    for light in scene_lights:
        scene.remove(light)
    for light in lights.values():
        if light is not None:
            scene.add(light)

    def edit(batch, frame):
        edit_world(frame, materials, lights)
        if frame == 2:
            scene.instances["lamp"].transform = lamp_place

    with sv.Batch(device, scene, SIZE, 2, **options) as batch:
        return frames_of(batch, CAMERAS, seeds, edit)


@pytest.mark.parametrize(
    ("use", "said"),
    [
        (lambda batch: batch.transforms.__setitem__("blok", np.tile(np.eye(4), (2, 1, 1))), "no instance 'blok'"),
        (lambda batch: batch.transforms.__setitem__(3, np.eye(4)), "name of an instance or an Instance, not 3"),
        (lambda batch: batch.transforms.__setitem__("short block", np.eye(4)), r"must have the shape \(2, 4, 4\)"),
        (lambda batch: batch.transforms.__setitem__("short block", np.zeros((2, 4, 4))), "of world 0 must be affine"),
        (lambda batch: batch.world_materials.__setitem__("short block", [sv.Material()]), "list of 2 .* not 1"),
        (lambda batch: batch.world_materials.__setitem__("short block", [sv.Material(), 3]), "world 1 of .* not 3"),
        (lambda batch: batch.world_materials.__setitem__("short block", sv.Material()), "takes a list of 2"),
        (lambda batch: batch.world_lights.__setitem__("sun", [None, None]), "no light 'sun'"),
        (lambda batch: batch.world_lights.__setitem__("lamp", []), "no light 'lamp'"),
    ],
)
def test_what_worlds_do_not_take_is_named(device, use, said):
    with (
        sv.Batch(device, sv.builtin("cornell_box"), SIZE, 2, worlds=2) as batch,
        pytest.raises(sv.SolariError, match=said),
    ):
        use(batch)


def test_wrong_worlds_are_named(device, monkeypatch):
    scene = sv.builtin("cornell_box")
    assert world_cache.most_worlds((1 << 27) + 3) == 2048
    monkeypatch.setattr(world_cache, "most_worlds", lambda largest_buffer: 2)
    for options, said in (
        ({"views": 3, "worlds": 2}, "3 views are no multiple of 2 worlds"),
        ({"worlds": 0}, "worlds is 0"),
        ({"views": 200_000, "worlds": 200_000, "size": (1, 1)}, "this device holds at most [0-9,]+: share"),
        ({"views": 3, "worlds": 3, "renderer": "realtime"}, "3 worlds: .* of the world cache for at most 2: share"),
    ):
        with pytest.raises(sv.SolariError, match=said):
            sv.Batch(device, scene, **{"size": SIZE, "views": 2, **options})
    with sv.Batch(device, scene, SIZE, 2) as batch, pytest.raises(sv.SolariError, match="has one world"):
        batch.transforms["short block"] = np.eye(4)[None]


def test_what_is_given_is_a_mapping(device):
    scene = sv.builtin("cornell_box")
    with sv.Batch(device, scene, SIZE, 2, worlds=2) as batch:
        group = scene.group("tall block", name="blocks")
        for mapping, key in ((batch.transforms, "blocks"), (batch.world_lights, group)):
            with pytest.raises(sv.SolariError, match="Group 'blocks' is a group"):
                mapping[key] = np.eye(4)
        given = batch.world_materials
        assert "tall block" not in given
        assert given.get("tall block") is None
        assert given.pop("tall block", 3) == 3
        with pytest.raises(KeyError):
            given.pop("tall block")
        lists = [[sv.Material(), sv.Material()] for _ in range(2)]
        assert given.setdefault("tall block", lists[0]) == given.setdefault("tall block", lists[1]) == lists[0]
        given["short block"] = lists[1]
        assert "short block" in given
        assert "block" not in given
        scene.remove(scene.instances["tall block"])
        assert list(dict(given).values()) == [lists[1]]
        assert given.pop("short block") == lists[1]
        given.clear()
        assert not given


def test_blended_instances_of_worlds_count_when_they_change(device):
    """Which cuts the history of pixels behind them."""
    scene = sv.builtin("cornell_box")
    poses, moved = np.tile(CAMERAS[:1], (2, 1, 1)), np.tile(scene.instances["tall block"].transform, (2, 1, 1))
    glass = [sv.Material(alpha=0.5, alpha_mode="blend")] * 2
    with sv.Batch(device, scene, SIZE, 2, worlds=2, outputs=["depth"]) as batch:
        for step, counts in (
            (lambda: batch.world_materials.update({"tall block": glass}), True),
            (lambda: scene.instances["short block"].update(position=(0.1, 0, 0)), False),
            (lambda: batch.transforms.update({"short block": moved}), False),
            (lambda: scene.instances["tall block"].update(position=(0.1, 0, 0)), True),
            (lambda: batch.transforms.update({"tall block": moved}), True),
            (lambda: None, False),
            (lambda: batch.world_materials.clear(), True),
        ):
            before = batch.binder.records.blended_changes
            step()
            batch.render(poses)
            assert (batch.binder.records.blended_changes != before) == counts


@pytest.mark.parametrize("renderer", ["reference", "realtime"])
def test_light_of_worlds_is_light(device, renderer, recwarn):
    scene = sv.Scene()
    scene.add(sv.shapes.box(), sv.Material(), name="box")
    with sv.Batch(device, scene, SIZE, 2, worlds=2, **{**OPTIONS[renderer], "renderer": renderer}) as batch:
        batch.world_materials["box"] = [sv.Material(), sv.Material(emissive=(1, 1, 1))]
        batch.render(np.tile(CAMERAS[:1], (2, 1, 1)))
    assert not [warning for warning in recwarn if "has no light" in str(warning.message)]


def test_a_light_takes_one_place_in_a_world(device):
    scene, _ = own_room(False)
    scene.add(sv.PointLight((1, 1, 1), intensity=1, name="bulb"))
    shared, poses = sv.PointLight((0.5, 1, 1), intensity=2), np.tile(CAMERAS[:1], (2, 1, 1))
    with sv.Batch(device, scene, SIZE, 2, worlds=2) as batch:
        batch.world_lights["sun"] = [shared, None]
        for given in ([None, shared], [shared, None]):
            batch.world_lights["bulb"] = given
            if given[0] is None:
                batch.render(poses)
        with pytest.raises(sv.SolariError, match="takes the places of two lights in world 0: give a copy"):
            batch.render(poses)


def test_a_light_that_is_the_scenes_again_leaves_nothing_of_the_worlds(device, monkeypatch):
    """Its ball casts the scene's shadow, and edits of lights that no world has any more count for nothing, but for
    those of one that comes back."""
    scene, _ = own_room(False)
    ball = {"intensity": 3.0, "radius": 0.2, "blocks_light": True}
    scene.add(sv.PointLight((0.6, 0.4, 0.6), **ball, name="ball"))
    scene.add(sv.PointLight((1, 1, 1), intensity=1, name="bulb"))
    poses, kept, moved = (
        np.tile(CAMERAS[:1], (2, 1, 1)),
        sv.PointLight((1, 1.2, 1)),
        sv.PointLight((1.4, 1, 0.8), **ball),
    )
    with sv.Batch(device, scene, SIZE, 2, worlds=2, renderer="reference", outputs=()) as batch:

        def shown():
            batch.render(poses, fov=50)
            return batch._worlds._traced.copy(), batch["radiance"]

        batch.world_lights["bulb"] = [kept, None]
        expected, _ = shown()
        batch.world_lights["ball"] = [moved, None]
        _, before = shown()
        del batch.world_lights["ball"]
        np.testing.assert_array_equal(shown()[0], expected)
        moved.intensity = 300.0
        assert not batch._worlds.overrides.changed
        batch.world_lights["ball"] = [moved, None]
        assert shown()[1].mean() > 1.5 * before.mean()
        kept.intensity = 9.0
        monkeypatch.setattr(batch._worlds, "_write", None)  # no instance changes, and the ball stays
        shown()


def test_changes_of_all_worlds_count_where_they_share_lights_again(device):
    def known(power):
        return LightState(np.ones(1, np.uint32), np.array([power]), np.zeros((1, 3)), np.zeros((1, 3)))

    scene, off = known(10.0), known(0.0)
    changes = LightChanges(device, 2)
    for own in ([scene, off], [scene, off]):
        changes.update(own, 0.1)
    changes.update([scene], 0.1)  # the second world's light goes on
    assert changes.newest == changes.change == 1
    changes.upload(np.zeros(1))
    records = changes.buffer.read(WORLD, 1)
    assert records["count"] == 1
    assert records["at"]["power"][0, 0] == 10
    changes.update([scene, off], 0.1)
    np.testing.assert_array_equal(changes.newest, [0, 1])
    changes.buffer.destroy()


@pytest.mark.parametrize("way", [pytest.param("material", marks=pytest.mark.slow), "light"])
def test_caches_follow_the_lights_of_their_world(device, way):
    """A lamp that goes out in one world: its cells and pixels forget, those of the other world keep what they have."""
    scene = sv.Scene()
    grey = sv.Material(base_color=(0.8, 0.8, 0.8))
    scene.add(sv.shapes.box((-1, -1, -1), (1, 1, 1), inward=True), grey)
    lamps = [sv.Material(emissive=(10 * (way == "material"),) * 3) for _ in range(2)]
    scene.add(sv.shapes.quad((0, 0.99, 0), (0.25, 0, 0), (0, 0, 0.25)), lamps[0], name="lamp")
    bulbs = [sv.PointLight((0, 0.5, 0), intensity=5 * (way == "light")) for _ in range(2)]
    scene.add(sv.PointLight((0, 0.5, 0), intensity=5, name="bulb"))
    pose = sv.Camera.look_at((0, -0.5, 0.9), (0, -0.8, -1)).transform
    with sv.Batch(device, scene, (16, 16), 2, renderer="realtime", worlds=2, outputs=()) as batch:
        batch.world_lights["bulb"] = bulbs
        batch.world_materials["lamp"] = lamps
        for _ in range(36):
            lit = batch.render([pose, pose], fov=60)["radiance"]
        if way == "material":
            lamps[1].emissive = 0, 0, 0
        else:
            bulbs[1].intensity = 0
        batch.render([pose, pose], fov=60)
        worlds, irradiance = (batch._realtime.frame[f"world_cache_{name}"] for name in ("worlds", "irradiance"))
        known = batch._realtime.frame["world_cache_checksums"] != 0
        samples = [irradiance[known & (worlds == world), 3] for world in range(2)]
        assert samples[0].max() > 2
        assert samples[1].max() <= 1.25  # begun anew, and updated once at most since
        for _ in range(3):
            dark = batch.render([pose, pose], fov=60)["radiance"]
        assert dark[1].max() < 1e-3 * lit[1].mean()
        assert 0.8 < dark[0].mean() / lit[0].mean() < 1.25
