"""The binder's tables against the scene they mirror, through random edits."""

from __future__ import annotations

import contextlib
import re
from collections import Counter

import numpy as np
import pytest

from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.constants import NO_INDEX
from solari_vk.bound.lights.light_kinds import KIND_INDEX
from solari_vk.bound.table import Table, upload
from solari_vk.bound.traced_instances import HIDDEN, VISIBLE
from solari_vk.errors import SolariError
from solari_vk.gpu.acceleration.tlas import Tlas
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.uploads import Uploads
from solari_vk.reference import PathTracer
from solari_vk.scene.camera import Camera
from solari_vk.scene.matrices import by_columns
from solari_vk.scene.model import DirectionalLight, Instance, Material, Mesh, Scene, Texture, TextureImage


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.fixture
def scene(rng):
    """A scene with one instance."""
    return Scene(make_instance(rng))


@pytest.fixture
def binder(device, scene):
    made = SceneBinder(device, scene)
    yield made
    made.destroy()


def make_instance(rng, **material):
    return Instance(mesh=make_mesh(rng), material=Material(**material))


def make_mesh(rng, triangles=1):
    return Mesh(positions=rng.normal(size=(3 * triangles, 3)), normals=np.tile([0, 0, 1], (3 * triangles, 1)))


def make_texture(rng):
    return Texture(image=TextureImage(pixels=rng.integers(0, 256, (*rng.integers(1, 9, 2), 4))))


def make_transform(rng):
    transform = np.eye(4)
    transform[:3] = rng.normal(size=(3, 4))
    return transform


def table(binder, name):
    """The contents of a table on the device."""
    host = {t.name: t for t in binder._tables}[name]
    return host.buffer.read(host.records.dtype)


def assert_mirrors(binder, scene):
    """Assert that every object's record on the device equals the object."""
    binder.update()
    instances, materials = table(binder, "instances"), table(binder, "materials")
    meshes, sources = table(binder, "meshes"), table(binder, "light_sources")
    traced = table(binder, "tlas_instances")[: binder._traced.count]
    info = table(binder, "scene_info")[0]
    emissive = [i for i in scene if i.visible and i.material.emits]
    assert info["light_count"] == len(emissive) + len(scene.lights)
    assert info["first_light_at_infinity"] == len(emissive)
    assert (sources["kind"][: len(emissive)] == KIND_INDEX["emissive_mesh"]).all()
    assert (sources["kind"][len(emissive) : info["light_count"]] == KIND_INDEX["directional"]).all()
    rows = set()
    for instance in scene:
        row = binder._instance_rows[instance]
        rows.add(row)
        record = instances[row]
        [ray] = traced[traced["custom_index_and_mask"] & 0xFFFFFF == row]
        transform = instance.transform[:3].astype(np.float32)
        np.testing.assert_array_equal(by_columns(record["world_from_object"]), transform)
        np.testing.assert_array_equal(ray["transform"], transform)
        assert ray["custom_index_and_mask"] == row | (VISIBLE if instance.visible else HIDDEN)
        assert ray["blas_address"] == binder._geometry.blases[instance.ray_mesh or instance.mesh].address
        assert (record["mesh"] == NO_INDEX) == (not instance.visible)
        drawn = [("mesh", instance.mesh)] if instance.visible else []
        for name, mesh in (*drawn, ("ray_mesh", instance.ray_mesh or instance.mesh)):
            entry = meshes[record[name]]
            assert entry["triangle_count"] == len(mesh.triangles)
            buffer = binder._geometry._buffers[mesh]
            assert entry["positions"] == buffer.address
            np.testing.assert_array_equal(buffer.read(np.float32, mesh.positions.size), mesh.positions.ravel())
        material = materials[record["material"]]
        np.testing.assert_array_equal(material["base_color"], instance.material.base_color)
        np.testing.assert_array_equal(material["emissive"], instance.material.emissive)
        assert material["flags"] == instance.material.double_sided
        assert bool(ray["sbt_offset_and_flags"] >> 24 & 1) == instance.material.double_sided
        texture = instance.material.base_color_texture
        if texture is None:
            assert material["base_color_texture"] == NO_INDEX
        else:
            image, _ = binder.resources["texture_images"][table(binder, "textures")[material["base_color_texture"]][1]]
            np.testing.assert_array_equal(image.read(), texture.image.pixels)
        if instance in emissive:
            source = sources[record["light_index"]]
            assert (source["kind"], source["index"]) == (KIND_INDEX["emissive_mesh"], row)
            assert source["part_count"] == len((instance.ray_mesh or instance.mesh).triangles)
        else:
            assert record["light_index"] == NO_INDEX
    used = np.isin(np.arange(len(instances)), sorted(rows))
    ever = instances["id"] > 0
    assert (instances["mesh"][ever & ~used] == NO_INDEX).all()  # removed instances aren't drawn
    assert len(set(instances["id"][used])) == len(rows)
    assert len(binder.lights.ids) == info["light_count"] == len(set(binder.lights.ids))
    assert all(image.handle is not None for image, _ in binder.resources["texture_images"])
    assert sorted(traced["custom_index_and_mask"] & 0xFFFFFF) == sorted(rows)


@pytest.mark.parametrize("seed", range(3))
def test_random_edits_are_mirrored(device, seed):
    rng = np.random.default_rng(seed)
    scene = Scene()
    objects = device.live_objects
    binder = SceneBinder(device, scene)
    meshes = [make_mesh(rng, triangles) for triangles in (1, 2, 5)]
    materials = [
        Material(base_color=rng.random(3), emissive=rng.choice([0.0, 2.0]), double_sided=rng.random() < 0.5,
                 base_color_texture=rng.choice([None, make_texture(rng)])) for _ in range(4)
    ]  # fmt: skip

    def add():
        ray_mesh = rng.choice(meshes) if rng.random() < 0.3 else None
        scene.add(Instance(mesh=rng.choice(meshes), material=rng.choice(materials), ray_mesh=ray_mesh,
                           transform=make_transform(rng)))  # fmt: skip

    def some():
        return rng.choice(list(scene.instances))

    edits = [
        add,
        lambda: scene.remove(some()),
        lambda: setattr(some(), "transform", make_transform(rng)),
        lambda: setattr(some(), "visible", rng.random() < 0.5),
        lambda: setattr(some(), "material", rng.choice(materials)),
        lambda: setattr(some(), "mesh", rng.choice(meshes)),
        lambda: setattr(some(), "ray_mesh", rng.choice([None, *meshes])),
        lambda: setattr(rng.choice(materials), "emissive", rng.choice([0.0, 3.0])),
        lambda: setattr(rng.choice(materials), "base_color_texture", rng.choice([None, make_texture(rng)])),
        lambda: setattr(rng.choice(materials), "double_sided", rng.random() < 0.5),
        lambda: rng.choice(meshes).update(positions=rng.normal(size=(6, 3)), normals=None),
        lambda: scene.add(DirectionalLight(direction=rng.normal(size=3))),
        lambda: scene.lights and scene.remove(next(iter(scene.lights))),
    ]
    for _ in range(12):
        for _ in range(rng.integers(1, 12)):
            if not scene.instances:
                add()
            rng.choice(edits)()
        assert_mirrors(binder, scene)
    binder.destroy()
    device.wait_idle()
    assert device.live_objects <= objects + 4  # shared samplers are kept


def test_instances_can_leave_and_come_back(rng, scene, binder):
    for _ in range(39):
        scene.add(make_instance(rng, emissive=1))
    assert_mirrors(binder, scene)
    first = list(scene)[:25]
    for edit in (scene.remove, scene.add):
        for instance in first:
            edit(instance)
        assert_mirrors(binder, scene)
    assert binder._instance_rows.limit == 40


def test_a_small_change_uploads_little(rng, scene, binder, monkeypatch):
    first = scene.instances[0]
    for _ in range(5000):
        scene.add(Instance(mesh=first.mesh, material=first.material))
    binder.update()
    sizes = []
    find_runs = Table._runs

    def note(self):
        runs = find_runs(self)
        sizes.extend(end - begin for begin, end in runs)
        return runs

    monkeypatch.setattr(Table, "_runs", note)
    first.transform = make_transform(rng)
    binder.update()
    assert 0 < sum(sizes) < 500
    sizes.clear()
    binder.update()
    assert not sizes


def test_two_binders_see_the_same_changes(device, rng, scene, binder):
    other = SceneBinder(device, scene)
    for _ in range(3):
        scene.add(make_instance(rng, emissive=1))
        assert_mirrors(binder, scene)
        assert_mirrors(other, scene)
    other.destroy()


def test_a_failed_update_is_tried_again(rng, scene, binder, monkeypatch):
    upload, find_runs = Uploads.buffer, Table._runs
    for calls in range(1, 30):
        for _ in range(17):
            scene.add(make_instance(rng, emissive=1))
        left = [calls]

        def failing(function, left=left):
            def call(*arguments):
                left[0] -= 1
                if left[0] == 0:
                    raise SolariError("out of memory")
                return function(*arguments)

            return call

        with monkeypatch.context() as patch:
            patch.setattr(Uploads, "buffer", failing(upload))
            patch.setattr(Table, "_runs", failing(find_runs))
            with pytest.raises(SolariError, match="out of memory") if calls < 17 else contextlib.suppress(SolariError):
                binder.update()
        assert_mirrors(binder, scene)


def fail_to_add(scene, binder, rng, monkeypatch, kind, method):
    """Add an instance in an update that fails, and remove it."""
    assert_mirrors(binder, scene)
    instance = scene.add(make_instance(rng, emissive=1))
    with monkeypatch.context() as patch:
        patch.setattr(kind, method, lambda *_, **__: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            binder.update()
    scene.remove(instance)


@pytest.mark.parametrize("count", [1, 16])  # tables begin with 16 rows
def test_an_instance_that_was_never_uploaded_can_be_removed(rng, scene, binder, monkeypatch, count):
    for _ in range(count - 1):
        scene.add(make_instance(rng))
    fail_to_add(scene, binder, rng, monkeypatch, Uploads, "buffer")
    assert_mirrors(binder, scene)


def test_a_tlas_build_that_fails_leaves_the_previous_one(device, rng, scene, binder, monkeypatch):
    fail_to_add(scene, binder, rng, monkeypatch, Tlas, "_record")
    before = binder._traced._build
    assert before._commands._pool._token in device._owned
    assert_mirrors(binder, scene)  # as many instances as before, so that the old commands fit
    assert binder._traced._build is before


SQUARE = Mesh(positions=[[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], triangles=[[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize("staging", [False, True])
def test_the_tlas_is_built_after_the_upload_of_its_records(any_device, rng, staging):
    """With mapped memory and with staging buffers, rays hit the instances that were added or made visible."""
    scene = Scene(Instance(mesh=SQUARE, material=Material(base_color_texture=make_texture(rng))))
    camera = Camera.look_at((0, 0, 1), (0, 0, 0))
    with Device(staging=staging) as device:
        renderer = PathTracer(device, scene, (4, 4), max_bounces=0)
        renderer.render(camera, samples=1)
        assert (renderer["instance_id"] == 0).all()
        scene.add(Instance(mesh=SQUARE, material=Material(), transform=np.diag([0.1, 0.1, 0.1, 1])))
        next(iter(scene)).visible = False
        renderer.render(camera, samples=1)
        assert set(renderer["instance_id"].ravel().tolist()) <= {1, NO_INDEX}


@pytest.mark.parametrize("staging", [False, True])
def test_moving_an_instance_adds_no_submission_and_makes_nothing(any_device, rng, staging, monkeypatch):
    """Its upload and the build of the TLAS are part of the frame's submission, also while frames are in flight."""
    instance = make_instance(rng)
    with Device(staging=staging) as device, PathTracer(device, Scene(instance), (4, 4)) as tracer:
        called = Counter()

        def frame(wait):
            instance.transform = make_transform(rng)
            tracer.render(samples=1)
            if wait:
                device.wait_idle()

        def counted(name, function):
            def call(*arguments):
                called[name] += 1
                return function(*arguments)

            return call

        for wait in 8 * [False, True]:
            frame(wait)
        device.wait_idle()
        for name, function in list(vars(device.vk).items()):
            if name.startswith("vk"):
                monkeypatch.setattr(device.vk, name, counted(name, function))
        for wait in 8 * [False, True]:
            frame(wait)
        assert called["vkQueueSubmit2"] == 16
        assert not [name for name in called if re.match("vk(Create|Allocate|Destroy|Free|Get.*Requirements)", name)]


def test_fields_in_another_order_are_refused(device):
    record = np.dtype([("mesh", "<u4"), ("material", "<u4")])
    with pytest.raises(SolariError, match="instances have the fields mesh, material, not material, mesh"):
        Table(device, "instances", record, ("material", "mesh"))


def test_tables_reach_memory_that_is_not_mapped(any_device, rng):
    """Few bytes are written by the commands themselves, many are staged."""
    record = np.dtype([("id", "<u4"), ("position", "<f4", (3,))])
    with Device(validation=True, staging=True) as device:
        table = Table(device, "points", record, ("id", "position"))
        for rows, changed in ((16, 3), (8000, 8000), (8000, 1), (8000, 40), (8000, 5000)):
            table.reserve(rows)
            picked = rng.choice(rows, changed, replace=False).tolist()
            for row in picked:
                table.set(row, row, *rng.normal(size=3))
            table.replace()
            upload(device, [table])
            assert not table.marked
            assert np.array_equal(table.buffer.read(record), table.records)


def test_edits_reach_frames_in_flight(device):
    """A picture shows an edit that was made while earlier frames were still running."""
    instance = Instance(mesh=SQUARE, material=Material(emissive=1))
    camera = Camera.look_at((0, 0, 1), (0, 0, 0))
    with PathTracer(device, Scene(instance), (64, 64), max_bounces=0) as renderer:
        for turn in range(10):
            shown = turn % 2 == 0
            for _ in range(3):
                renderer.advance(camera)
            instance.transform = np.eye(4) + (0 if shown else 50) * np.eye(4, k=3)
            assert (renderer.render(camera, samples=1)["radiance"] > 0).all() == shown


def test_a_texture_without_users_is_unbound(device, rng, scene):
    """The renderer continues without it, also after a resize."""
    textured = scene.add(make_instance(rng, base_color_texture=make_texture(rng)))
    camera = Camera.look_at((0, 0, 5), (0, 0, 0))
    with PathTracer(device, scene, (4, 4), max_bounces=0) as renderer:
        renderer.render(camera, samples=1)
        scene.remove(textured)
        renderer.render(camera, samples=1)
        assert renderer["depth"].shape == (4, 4)
        renderer.resize((5, 5))
        assert renderer.render(camera, samples=1)["radiance"].shape == (5, 5, 3)


def test_renderers_share_a_binder(device, rng, scene, binder):
    camera = Camera.look_at((0, 0, 5), (0, 0, 0))
    first, second = (PathTracer(device, binder, (4, 4), max_bounces=0) for _ in range(2))
    with first, second:
        for renderer in (first, second):
            renderer.render(camera, samples=1)
            assert renderer["depth"].shape == (4, 4)
        for _ in range(40):  # tables are replaced
            scene.add(make_instance(rng))
        first.render(camera, samples=1)
        assert second["depth"].shape == (4, 4)
        assert second.render(camera, samples=2)["radiance"].shape == (4, 4, 3)
