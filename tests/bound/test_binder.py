"""The binder's tables against the scene they mirror, through edits, failures and frames in flight."""

from __future__ import annotations

import contextlib
import functools
import re
import warnings
from collections import Counter

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule, run_state_machine_as_test
from support.frames import fail_after

from solari_vk.base.errors import SolariError
from solari_vk.bound import scene_records
from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.constants import MATERIAL_DOUBLE_SIDED, MATERIAL_HIDES_BACK, NO_INDEX
from solari_vk.bound.lights.light_kinds import KIND_INDEX
from solari_vk.bound.table import Table, upload_tables
from solari_vk.bound.traced_instances import HIDDEN, VISIBLE
from solari_vk.gpu.acceleration.tlas import Tlas
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.uploads import Uploads
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.gpu.shaders.spirv import reflect
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.scene.camera import Camera
from solari_vk.scene.lights.portal import Portal
from solari_vk.scene.matrices import by_columns
from solari_vk.scene.model import DirectionalLight, Environment, Instance, Material, Mesh, Scene, Texture, TextureImage
from solari_vk.scene.shapes import sphere


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.fixture
def binder(bound, rng):
    return bound(make_instance(rng))


@pytest.fixture
def scene(binder):
    """A scene with one instance."""
    return binder.scene


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


@functools.cache
def layout():
    return reflect(compile_shader("scene/layout.comp")).bindings


TABLES = ("instances", "materials", "textures", "meshes", "light_sources", "scene_infos")


def table(binder, name):
    """The contents of a table on the device."""
    binding = layout()[name]
    return binder.resources[name].read(binding.dtype if binding.element is None else binding.element)


def assert_mirrors(binder, scene):
    """Assert that every object's record on the device equals the object."""
    binder.update()
    tables = {name: table(binder, name) for name in TABLES}
    info = tables["scene_infos"][0]
    emissive = [instance for instance in scene if instance.visible and instance.material.emits]
    assert_mirrors_lights(binder, scene, tables, emissive)
    instances = tables["instances"]
    traced = binder.records.traced
    traced = traced.table.buffer.read(traced.table.records.dtype)[: traced.count]
    row_of = {instance: row for row, instance in binder.instances.items()}
    assert row_of.keys() == set(scene)
    for instance, row in row_of.items():
        [ray] = traced[traced["custom_index_and_mask"] & 0xFFFFFF == row]
        assert_mirrors_instance(binder, tables, instance, row, ray)
        assert_mirrors_material(binder, tables, instance, row, ray)
        assert_mirrors_emission(tables, instance, row, instance in emissive)
    used = np.isin(np.arange(len(instances)), list(binder.instances))
    ever = instances["id"] > 0
    assert (instances["mesh"][ever & ~used] == NO_INDEX).all()  # removed instances aren't drawn
    assert len(set(instances["id"][used])) == len(row_of)
    assert len(binder.lights.ids) == info["light_count"] == len(set(binder.lights.ids))
    assert all(image.handle is not None for image, _ in binder.resources["texture_images"])
    assert sorted(traced["custom_index_and_mask"] & 0xFFFFFF) == sorted(binder.instances)


def assert_mirrors_lights(binder, scene, tables, emissive):
    """The list of lights: emissive meshes, portals, suns and environments, in this order."""
    info = tables["scene_infos"][0]
    assert info["light_count"] == len(emissive) + len(scene.lights)
    portals, suns, skies = (
        [light for light in scene.lights if isinstance(light, kind)] for kind in (Portal, DirectionalLight, Environment)
    )
    assert info["first_portal"] == len(emissive)
    assert info["first_pass_through_light"] == info["first_light_at_infinity"] == len(emissive) + len(portals)
    assert not skies or info["first_environment"] == info["light_count"] - len(skies)
    counts = {
        "emissive_mesh": len(emissive),
        "portal": len(portals),
        "directional": len(suns),
        "environment": len(skies),
    }
    kinds = np.repeat([KIND_INDEX[name] for name in counts], list(counts.values()))
    np.testing.assert_array_equal(tables["light_sources"]["kind"][: info["light_count"]], kinds)
    flux = sum(sky.flux for sky in skies)
    of_portals = slice(len(emissive), len(emissive) + len(portals))
    np.testing.assert_allclose(binder.lights.powers[of_portals], [p.area / 2 * flux for p in portals], rtol=1e-4)
    if portals:
        records = table(binder, "portals")[: len(portals)]
        corners = [p.center - p.half_u - p.half_v for p in portals]
        np.testing.assert_allclose(records["corner"], corners, rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(records["side_v"], [2 * p.half_v for p in portals], rtol=1e-5, atol=1e-5)


def assert_mirrors_instance(binder, tables, instance, row, ray):
    """The transform, the visibility and the meshes of an instance, in its record and in the one that rays use."""
    record = tables["instances"][row]
    geometry = binder.assets.geometry
    ray_mesh = instance.ray_mesh or instance.mesh
    transform = instance.transform[:3].astype(np.float32)
    np.testing.assert_array_equal(by_columns(record["world_from_object"]), transform)
    np.testing.assert_array_equal(ray["transform"], transform)
    assert ray["custom_index_and_mask"] == row | (VISIBLE if instance.visible else HIDDEN)
    assert ray["blas_address"] == geometry.blases[ray_mesh].address
    assert (record["mesh"] == NO_INDEX) == (not instance.visible)
    drawn = [("mesh", instance.mesh)] if instance.visible else []
    for name, mesh in (*drawn, ("ray_mesh", ray_mesh)):
        entry = tables["meshes"][record[name]]
        assert entry["triangle_count"] == len(mesh.triangles)
        buffer = geometry._buffers[mesh]
        assert entry["positions"] == buffer.address
        np.testing.assert_array_equal(buffer.read(np.float32, mesh.positions.size), mesh.positions.ravel())


def assert_mirrors_material(binder, tables, instance, row, ray):
    wanted = instance.material
    material = tables["materials"][tables["instances"][row]["material"]]
    np.testing.assert_array_equal(material["base_color"], wanted.base_color)
    np.testing.assert_array_equal(material["emissive"], wanted.emissive)
    assert (
        material["flags"] == MATERIAL_DOUBLE_SIDED * bool(wanted.double_sided) + MATERIAL_HIDES_BACK * wanted.hides_back
    )
    assert bool(ray["sbt_offset_and_flags"] >> 24 & 1) != wanted.hides_back
    texture = wanted.base_color_texture
    if texture is None:
        assert material["base_color_texture"] == NO_INDEX
    else:
        number = tables["textures"][material["base_color_texture"]][1]
        image, _ = binder.resources["texture_images"][number]
        np.testing.assert_array_equal(image.read(), texture.image.pixels)


def assert_mirrors_emission(tables, instance, row, emits):
    index = tables["instances"][row]["light_index"]
    if not emits:
        assert index == NO_INDEX
        return
    source = tables["light_sources"][index]
    assert (source["kind"], source["record_index"]) == (KIND_INDEX["emissive_mesh"], row)
    assert source["part_count"] == len((instance.ray_mesh or instance.mesh).triangles)


PARTS = [(Uploads, "buffer"), (Table, "_runs"), (Tlas, "_record")]
RNGS = st.integers(0, 99).map(np.random.default_rng)
SIDES = st.sampled_from([None, True, False])
ANY = st.integers(0, 99)
CALLS = st.integers(0, 2) | st.integers(0, 12)
HAS_INSTANCES = precondition(lambda self: self.scene.instances)


class Edits(RuleBasedStateMachine):
    """A scene of a few meshes and materials that is edited, with updates of its binder in between."""

    def __init__(self, device):
        super().__init__()
        rng = np.random.default_rng(0)
        self.scene = Scene()
        self.binder, self.other = SceneBinder(device, self.scene), SceneBinder(device, self.scene)
        self.meshes = [make_mesh(rng, triangles) for triangles in (1, 2, 5)]
        self.textures = [None, *(make_texture(rng) for _ in range(3))]
        self.materials = [
            Material(base_color=rng.random(3), emissive=light, base_color_texture=texture)
            for light, texture in zip((0, 0, 2, 2), self.textures, strict=True)
        ]

    def instance(self, number):
        return self.scene.instances[number % len(self.scene.instances)]

    @rule(mesh=ANY, ray_mesh=ANY, material=ANY, rng=RNGS, count=st.integers(1, 20))
    def add(self, mesh, ray_mesh, material, rng, count):
        for _ in range(count):
            self.scene.add(
                Instance(
                    mesh=self.meshes[mesh % 3],
                    material=self.materials[material % 4],
                    transform=make_transform(rng),
                    ray_mesh=[None, None, *self.meshes][ray_mesh % 5],
                )
            )

    @HAS_INSTANCES
    @rule(number=ANY, count=st.integers(1, 20), again=st.booleans())
    def remove(self, number, count, again):
        removed = [self.instance(number + k) for k in range(min(count, len(self.scene.instances)))]
        for edit in (self.scene.remove, self.scene.add)[: 1 + again]:
            for instance in removed:
                edit(instance)

    @HAS_INSTANCES
    @rule(number=ANY, rng=RNGS, visible=st.booleans())
    def move(self, number, rng, visible):
        self.instance(number).update(transform=make_transform(rng), visible=visible)

    @HAS_INSTANCES
    @rule(number=ANY, mesh=ANY, ray_mesh=ANY, material=ANY)
    def exchange(self, number, mesh, ray_mesh, material):
        self.instance(number).update(
            mesh=self.meshes[mesh % 3],
            ray_mesh=[None, *self.meshes][ray_mesh % 4],
            material=self.materials[material % 4],
        )

    @rule(number=ANY, emissive=st.sampled_from([0.0, 3.0]), texture=ANY, double_sided=SIDES)
    def edit_material(self, number, emissive, texture, double_sided):
        self.materials[number % 4].update(
            emissive=emissive, base_color_texture=self.textures[texture % 4], double_sided=double_sided
        )

    @rule(number=ANY, rng=RNGS, triangles=st.integers(1, 3))
    def edit_mesh(self, number, rng, triangles):
        self.meshes[number % 3].update(positions=rng.normal(size=(3 * triangles, 3)), normals=None)

    @rule(rng=RNGS)
    def add_sun(self, rng):
        self.scene.add(DirectionalLight(direction=rng.normal(size=3)))

    @rule(rng=RNGS)
    def add_portal(self, rng):
        self.scene.add(Portal(*rng.normal(size=(3, 3))))

    @rule(intensity=st.sampled_from([None, 0.0, 1.0, 2.0]), rng=RNGS, anew=st.booleans())
    def edit_sky(self, intensity, rng, anew):
        if intensity is None or anew or self.scene.environment is None:
            self.scene.environment = None if intensity is None else Environment(rng.random(3), intensity=intensity)
        else:
            self.scene.environment.intensity = intensity

    @precondition(lambda self: any(isinstance(light, Portal) for light in self.scene.lights))
    @rule(number=ANY, rng=RNGS)
    def move_portal(self, number, rng):
        portals = [light for light in self.scene.lights if isinstance(light, Portal)]
        portals[number % len(portals)].update(center=rng.normal(size=3), half_u=rng.normal(size=3))

    @precondition(lambda self: self.scene.lights)
    @rule(number=ANY)
    def remove_light(self, number):
        self.scene.remove(self.scene.lights[number % len(self.scene.lights)])

    @rule(part=st.sampled_from(PARTS), calls=CALLS, count=st.integers(0, 17), rng=RNGS, kept=st.booleans())
    def fail_to_update(self, part, calls, count, rng, kept):
        """Tables begin with 16 rows, so that they may have to grow."""
        mesh = make_mesh(rng)
        added = [self.scene.add(Instance(mesh=mesh, material=self.materials[2])) for _ in range(count)]
        with pytest.MonkeyPatch.context() as patch, contextlib.suppress(SolariError):
            fail_after(patch, *part, calls)
            self.binder.update()
        for instance in () if kept else added:
            self.scene.remove(instance)

    @rule()
    def update(self):
        assert_mirrors(self.binder, self.scene)

    @rule()
    def update_other(self):
        assert_mirrors(self.other, self.scene)

    def teardown(self):
        for binder in (self.binder, self.other):
            assert_mirrors(binder, self.scene)
            binder.destroy()


@pytest.mark.parametrize(("examples", "staging"), [(25, False), pytest.param(200, True, marks=pytest.mark.slow)])
def test_random_edits_are_mirrored(any_device, examples, staging):
    """With mapped memory, and where all data waits in staging memory for its copy."""
    with Device(validation=True, staging=staging) as device:
        run_state_machine_as_test(
            lambda: Edits(device), settings=settings(max_examples=examples, stateful_step_count=40)
        )
        device.wait_idle()
        assert device.objects_in_use == 0


@pytest.mark.parametrize(("part", "count"), [(PARTS[0], 16), (PARTS[2], 2)])
def test_what_was_never_uploaded_can_be_removed(rng, scene, binder, monkeypatch, part, count):
    """The row after the 16 with which tables begin; an instance without which the previous TLAS build fits again."""
    for _ in range(count - 1):
        scene.add(make_instance(rng))
    assert_mirrors(binder, scene)
    added = scene.add(make_instance(rng))
    with monkeypatch.context() as patch:
        fail_after(patch, *part, calls=0)
        with pytest.raises(SolariError, match="out of memory"):
            binder.update()
    scene.remove(added)
    assert_mirrors(binder, scene)


def test_whichever_upload_fails_is_made_again(rng, each_failed_upload):
    lamp = Material(emissive=2, base_color_texture=make_texture(rng))
    for binder in each_failed_upload(lambda: Scene(Instance(make_mesh(rng), lamp), Instance(sphere(0.5, 12), lamp))):
        assert_mirrors(binder, binder.scene)


def test_a_small_change_uploads_little(rng, scene, binder, monkeypatch):
    first = scene.instances[0]
    for _ in range(2000):
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

        for wait in 4 * [False, True]:
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
            upload_tables(device, [table])
            assert not table.marked
            assert np.array_equal(table.buffer.read(record), table.records)


def test_edits_reach_frames_in_flight(device):
    """A picture shows an edit that was made while earlier frames were still running."""
    instance = Instance(mesh=SQUARE, material=Material(emissive=1))
    camera = Camera.look_at((0, 0, 1), (0, 0, 0))
    with PathTracer(device, Scene(instance), (64, 64), max_bounces=0) as renderer:
        for turn in range(4):
            shown = turn % 2 == 0
            for _ in range(3):
                renderer.advance(camera)
            instance.transform = np.eye(4) + (0 if shown else 50) * np.eye(4, k=3)
            assert (renderer.render(camera, samples=1)["radiance"] > 0).all() == shown


def test_renderers_share_a_binder(device, rng, scene, binder):
    """Textures without users are unbound, and tables replaced, also while a renderer is resized."""
    camera = Camera.look_at((0, 0, 5), (0, 0, 0))
    textured = scene.add(make_instance(rng, base_color_texture=make_texture(rng)))
    first, second = (PathTracer(device, binder, (4, 4), max_bounces=0) for _ in range(2))
    with first, second:
        for renderer in (first, second):
            renderer.render(camera, samples=1)
            assert renderer["depth"].shape == (4, 4)
        scene.remove(textured)
        for _ in range(40):
            scene.add(make_instance(rng))
        first.render(camera, samples=1)
        assert second["depth"].shape == (4, 4)
        second.resize((5, 5))
        assert second.render(camera, samples=2)["radiance"].shape == (5, 5, 3)


def test_edits_of_colors_build_nothing(bound):
    """Neither the structure nor the worlds of a batch, which edits that rays notice have built anew."""
    paint = Material()
    binder = bound(Instance(sphere(0.5, 12), paint))
    edits = (
        ({"base_color": 0.1, "roughness": 0.3}, False),
        ({"double_sided": False}, True),
        ({"alpha": 0.5, "alpha_mode": "blend"}, True),
        ({"base_color": 0.2}, False),
        ({"emissive": 1.0}, True),
        ({"emissive": 0.0}, True),
        ({"emissive_texture": None}, False),
    )
    binder.update()
    for fields, builds in edits:
        before = binder.tlas.current.build_count, binder.records.record_revision
        paint.update(**fields)
        binder.update()
        after = binder.tlas.current.build_count, binder.records.record_revision
        assert [b > a for a, b in zip(before, after, strict=True)] == [builds] * 2, fields


def test_an_instance_too_many_takes_no_row(bound, monkeypatch):
    monkeypatch.setattr(scene_records, "MAX_INSTANCES", 3)
    binder = bound(*(Instance(sphere(0.5, 12)) for _ in range(3)))
    binder.update()
    extra = binder.scene.add(Instance(sphere(0.5, 12)))
    for _ in range(2):
        with pytest.raises(SolariError, match="more than 3 instances"):
            binder.update()
    binder.scene.remove(extra)
    binder.update()
    assert sorted(binder.instances) == [0, 1, 2]
    assert len(binder.records.instance_rows) == 3


def test_an_edit_of_alpha_leaves_memory_shared(bound):
    """Equal meshes get another structure, which is one for both."""
    meshes, veil = [sphere(0.5, 12) for _ in range(2)], Material()
    binder = bound(*(Instance(mesh, veil) for mesh in meshes))
    binder.update()
    geometry, used = binder.assets.geometry, binder.device.objects_in_use
    shared, opaque = geometry._buffers[meshes[0]], geometry.blases[meshes[0]]
    veil.update(alpha=0.5, alpha_mode="blend")
    binder.update()
    assert [geometry._buffers[mesh] for mesh in meshes] == [shared, shared]
    assert geometry.blases[meshes[0]] is geometry.blases[meshes[1]] is not opaque
    binder.device.wait_idle()
    assert binder.device.objects_in_use == used


def test_a_mesh_takes_over_what_another_one_was_before_its_edit(bound):
    meshes = [sphere(0.5, 12), sphere(0.4, 12)]
    binder = bound(*map(Instance, meshes))
    binder.update()
    structures = [binder.assets.geometry.blases[mesh] for mesh in meshes]
    shapes = [mesh.positions for mesh in meshes]
    for mesh, positions in zip(meshes, shapes[::-1], strict=True):
        mesh.positions = positions
    added = [sphere(0.5, 12), sphere(0.4, 12)]
    for mesh in added:
        binder.scene.add(mesh)
    binder.update()
    assert [binder.assets.geometry.blases[mesh] for mesh in added] == structures
    assert not any(structure.destroyed for structure in structures)


def test_fields_of_solids_without_a_solid(bound, rng):
    """A color that absorbs nothing is named, when its surface is shown and when an edit brings it; a solid's isn't."""
    glass = {"transmission": 1.0, "attenuation_color": 0.5, "dispersion": 0.3}
    plain = Material()
    with warnings.catch_warnings(action="error"):
        binder = bound(make_instance(rng, solid=True, **glass), Instance(make_mesh(rng), plain))
        binder.update()
    with pytest.warns(UserWarning, match="'pane': attenuation_color, dispersion: without effect.*solid=True"):
        bound(make_instance(rng, name="pane", **glass)).update()
    plain.attenuation_color = 0.5
    with pytest.warns(UserWarning, match="attenuation_color: without effect"):
        binder.update()
