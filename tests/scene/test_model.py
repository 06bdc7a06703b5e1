"""The scene's objects: what they accept, that changes reach their watchers, and that refusals change nothing."""

from __future__ import annotations

import dataclasses
import gc
import math
import weakref

import numpy as np
import pytest
from PIL import Image

from solari_vk import Environment, Sky
from solari_vk.base.color import decode_srgb
from solari_vk.base.errors import SolariError
from solari_vk.scene import shapes
from solari_vk.scene.lights.punctual import PointLight, SpotLight
from solari_vk.scene.model import Camera, DirectionalLight, Instance, Material, Mesh, Scene, Texture, TextureImage

TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
SPOT = {"position": [0, 1, 0], "direction": [0, -1, 0]}


def mesh(**fields):
    return Mesh(**{"positions": TRIANGLE, **fields})


class Notes:
    """A watcher."""

    def __init__(self):
        self.seen = []

    def mark_changed(self, changed):
        self.seen.append(changed)


# ---- fields -----------------------------------------------------------------------------------------


def test_arrays_are_copied_converted_and_frozen():
    given = np.array(TRIANGLE, np.float64)
    made = mesh(positions=given, triangles=[[0, 1, 2]])
    given[:] = 9
    assert made.positions.tolist() == TRIANGLE
    assert (made.positions.dtype, made.triangles.dtype) == (np.float32, np.uint32)
    with pytest.raises(ValueError, match="read-only"):
        made.positions[0, 0] = 1


def test_textures_from_files(tmp_path):
    pixels = np.arange(24, dtype=np.uint8).reshape(2, 3, 4)
    Image.fromarray(pixels).save(tmp_path / "a.png")
    for given in (tmp_path / "a.png", str(tmp_path / "a.png")):
        assert (Material(base_color_texture=given).base_color_texture.image.pixels == pixels).all()
        assert (TextureImage(given).pixels == pixels).all()
    (tmp_path / "b.png").write_bytes(b"none")
    with pytest.raises(SolariError, match=r"b\.png is not a PNG"):
        Texture(tmp_path / "b.png")


PIXEL = TextureImage(np.zeros((1, 1, 4), np.uint8))
SUN = DirectionalLight([0, 1, 0])
OBJECTS = [
    mesh(),
    PIXEL,
    Texture(PIXEL),
    Material(),
    Instance(mesh()),
    SUN,
    PointLight([0, 1, 0]),
    SpotLight(**SPOT),
    Camera(),
    Environment(1.0),
    Sky([1, 1, 0]),
]


@pytest.mark.parametrize("item", OBJECTS, ids=lambda item: type(item).__name__)
def test_no_field_takes_nonsense(item):
    for field in dataclasses.fields(item):
        value = getattr(item, field.name)
        wrong_numbers = np.full(np.shape(value) if np.size(value) else 4, math.nan)
        wrongs = (object(), wrong_numbers, -1e60 if field.name != "rotation" else "x")
        if isinstance(value, bool):
            item.update(**{field.name: np.bool_(value)})
            wrongs = (object(), "no", np.ones(2, bool), 2, 1.0, None)
        for wrong in wrongs:
            with pytest.raises(SolariError, match=f"{field.name} |pixels "):
                item.update(**{field.name: wrong})
            assert getattr(item, field.name) is value


REFUSED = [
    (mesh, {"positions": [[0, 0]]}, r"positions must have the shape \(N, 3\), not \(1, 2\)"),
    (mesh, {"positions": [[0, 0, math.nan]] * 3}, r"must be finite, but element \(0, 2\) is nan"),
    (mesh, {"positions": TRIANGLE[:2]}, "must be a positive multiple of 3, not 2"),
    (mesh, {"positions": np.zeros((0, 3))}, "there are no positions"),
    (mesh, {"triangles": [[0, 1, 3]]}, "triangles must be rows of positions, 0 to 2"),
    (mesh, {"triangles": np.zeros((0, 3), int)}, "triangles must be rows"),
    (mesh, {"triangles": [[0, -1, 2]]}, "must lie between 0 and 4294967295"),
    (mesh, {"triangles": [[0.0, 1.0, 2.0]]}, "must be integers, not float64"),
    (mesh, {"uvs": [[0, 0]]}, "uvs has 1 rows for 3 positions"),
    (mesh, {"name": "wall", "normals": [[0, 0, 1]]}, "Mesh 'wall': normals has 1 rows"),
    (mesh, {"indices": [[0, 1, 2]], "faces": [[0, 1, 2]]}, "Mesh: indices and faces name the same field"),
    (mesh, {"_default_triangles": None}, r"no field '_default_triangles'; .*there are positions, triangles"),
    (TextureImage, {"pixels": np.zeros((0, 4, 4), np.uint8)}, "at least one pixel"),
    (
        TextureImage,
        {"pixels": np.zeros((2, 2, 2), np.uint8)},
        r"shape \(N, N, 4\).*: give 8-bit pixels, uint16, or floats",
    ),
    (Texture, {"image": PIXEL, "wrap_u": "wrap"}, "wrap_u must be one of repeat, mirrored_repeat, clamp_to_edge, not"),
    (Material, {"metallic": 1.5}, "metallic must be a finite number between 0 and 1, not 1.5"),
    (Material, {"roughness": 0, "perceptual_roughness": 0}, "name the same field: give one"),
    (Material, {"base_color": [0, 0, 1.1]}, "base_color must lie between 0 and 1"),
    (Material, {"base_color_texture": np.full((2, 2, 3), 200.0)}, "between 0 and 1, or be integers of 8 or 16 bits"),
    (Material, {"normal_texture": TRIANGLE}, "must be a Texture, an array of pixels or a path, not list"),
    (Instance, {"mesh": None, "material": Material()}, "mesh must be a Mesh, not NoneType"),
    (DirectionalLight, {"direction": [0, 0, 0]}, "direction must not be zero"),
    (PointLight, {"position": [0, 1, 0], "radius": 1e-9}, "radius must be 0 or at least 1e-05 m"),
    (PointLight, {"position": [0, 1, 0], "range": 0}, "range"),
    (SpotLight, {**SPOT, "outer_cone_angle": 1.6}, "outer_cone_angle must be a finite number between 0 and 1.57"),
    (SpotLight, {**SPOT, "inner_cone_angle": 0.8}, "inner_cone_angle must be smaller than outer_cone_angle"),
    (Texture, {"image": PIXEL, "mipmaps": "no"}, "Texture: mipmaps must be True or False, not 'no'"),
    (Texture, {"image": PIXEL, "uv_set": np.ones(2)}, "uv_set must be a whole number from 0 to 255, not array"),
    (Texture, {"image": PIXEL, "wrap_u": "a " * 5000}, r"Texture: wrap_u .{,150}a a\.\.\.a a[ a]{,20}'$"),
    (Texture, {"image": PIXEL, "uv_set": 10**5000}, "uv_set must be .{,40}, not a value of the type int"),
    (Camera, {"near": 0}, r"near must be a finite number between 1e-09 and 1e\+18"),
    (Camera, {"orthographic_height": 1e-30}, "orthographic_height"),
    (Camera, {"vertical_fow": 1.0}, r"Camera has no field 'vertical_fow'; did you mean 'vertical_fov'"),
]
TRANSFORMS = [
    (np.eye(3), "shape"),
    (np.diag([1, 0, 0, 1]), "only one axis may have a scale of 0"),
    (np.diag([1, 1, 1, 2]), "affine"),
    (np.diag([1e300, 1, 1, 1]), "within 1e"),
]
REFUSED += [(Instance, {"mesh": mesh(), "transform": transform}, message) for transform, message in TRANSFORMS]


@pytest.mark.parametrize(("kind", "fields", "message"), REFUSED)
def test_refused_fields(kind, fields, message):
    with pytest.raises(SolariError, match=message):
        kind(**fields)


@pytest.mark.parametrize("scale", [1e-3, 1e4, -1])
def test_transforms_of_any_usual_size_three_rows_or_a_position(scale):
    matrix = np.diag([scale, 1, 1, 1])
    matrix[:3, 3] = [1e4, 0, 0]
    assert Instance(mesh(), transform=matrix[:3]).transform.tolist() == matrix.tolist()
    assert Camera(transform=(0, 1, 5)).transform.tolist() == [[1, 0, 0, 0], [0, 1, 0, 1], [0, 0, 1, 5], [0, 0, 0, 1]]


@pytest.mark.parametrize("length", [1e-300, 1.0, 1e300])
def test_directions_of_any_length_become_unit_vectors(length):
    light = DirectionalLight(direction=np.array((3.0, 0.0, -4.0)) * length)
    assert light.direction == pytest.approx((0.6, 0.0, -0.8))


def test_colors_of_the_web_are_srgb():
    assert Material(base_color="#ff0000").base_color.tolist() == [1, 0, 0]
    np.testing.assert_allclose(Material(base_color="#808").base_color, [0.2462, 0, 0.2462], atol=1e-4)


def test_colors_may_be_gray_and_textures_are_made_of_pixels():
    assert Material(base_color=0.25, reflectance=[0, 0.5, 1]).base_color.tolist() == [0.25] * 3
    assert [Material(emissive=light).emits for light in (0, [0, 0, 1])] == [False, True]
    gray = np.full((2, 3), 7, np.uint8)
    material = Material(base_color_texture=gray, normal_texture=TextureImage(np.zeros((1, 1, 3), np.uint8)))
    assert material.base_color_texture.image.pixels.tolist() == [[[7, 7, 7, 255]] * 3] * 2
    assert TextureImage(np.array([[0, 0.501, 1]])).pixels[0, :, 1].tolist() == [0, 128, 255]
    assert material.normal_texture.uv_transform.tolist() == np.eye(2, 3).tolist()


def test_some_fields_have_two_names():
    material = Material(roughness=0.3)
    assert material.perceptual_roughness == material.roughness == 0.3
    material.roughness = 0.4
    material.update(roughness=0.5)
    assert material.perceptual_roughness == 0.5
    assert mesh(faces=[[2, 1, 0]]).triangles.tolist() == [[2, 1, 0]]
    assert "_default" not in repr(mesh())
    with pytest.raises(SolariError, match=r"'metalic'; did you mean 'metallic'. the nearest of \d+ are (\w+, ){4}\w+$"):
        material.metalic = 1


def test_default_triangles_follow_the_positions():
    made = mesh()
    made.positions = TRIANGLE * 2
    assert made.triangles.tolist() == [[0, 1, 2], [3, 4, 5]]
    with pytest.raises(SolariError, match="normals has 3 rows for 9 positions"):
        made.update(positions=TRIANGLE * 3, normals=TRIANGLE)
    assert (len(made.positions), len(made.triangles)) == (6, 2)
    made.update(triangles=[[0, 1, 5]])
    made.positions = TRIANGLE * 3
    assert made.triangles.tolist() == [[0, 1, 5]]
    made.triangles = None
    assert len(made.triangles) == 3


def test_a_mesh_from_trimesh(monkeypatch):
    def missing(*_, **__):
        raise ImportError("no scipy")

    trimesh = pytest.importorskip("trimesh")
    with pytest.raises(SolariError, match=r"a trimesh.Trimesh is needed, not Scene; trimesh.Scene.to_mesh"):
        Mesh.from_trimesh(trimesh.Scene())
    ball = trimesh.creation.icosphere(subdivisions=1)
    flat, smooth = Mesh.from_trimesh(ball), Mesh.from_trimesh(ball, smooth=True)
    np.testing.assert_allclose(flat.positions, ball.vertices, atol=1e-6)
    assert flat.triangles.tolist() == ball.faces.tolist()
    assert flat.normals is None
    np.testing.assert_allclose(smooth.normals, smooth.positions, atol=0.05)
    visual = trimesh.visual.TextureVisuals(uv=[[0, 0], [1, 0], [0, 0.25]])
    found = Mesh.from_trimesh(trimesh.Trimesh(TRIANGLE, [[0, 1, 2]], visual=visual, process=False))
    assert found.uvs.tolist() == [[0, 1], [1, 1], [0, 0.75]]
    monkeypatch.setattr(trimesh.geometry, "weighted_vertex_normals", missing)
    monkeypatch.setattr(trimesh.geometry, "mean_vertex_normals", missing)
    with pytest.raises(SolariError, match=r"smooth=True needs .*no scipy.*pip install scipy"):
        Mesh.from_trimesh(trimesh.creation.icosphere(subdivisions=1), smooth=True)


def test_colors_and_materials_of_trimesh():
    trimesh = pytest.importorskip("trimesh")
    from trimesh.visual.material import PBRMaterial, SimpleMaterial

    def added(visual=None, **colors):
        shape = trimesh.creation.box()
        shape.visual = visual or shape.visual
        for name, value in colors.items():
            setattr(shape.visual, name, value)
        return Scene().add(shape)

    assert (added().mesh.colors, added().material.base_color.tolist()) == (None, Material().base_color.tolist())
    codes = np.arange(32, dtype=np.uint8).reshape(8, 4) * 8
    vertices = added(vertex_colors=codes)
    np.testing.assert_allclose(vertices.mesh.colors[:, :3], decode_srgb(codes[:, :3] / 255), atol=1e-6)
    np.testing.assert_allclose(vertices.mesh.colors[:, 3], codes[:, 3] / 255)
    assert (vertices.material.alpha_mode, vertices.material.base_color[0]) == ("blend", 1)
    faces = added(face_colors=np.tile(np.arange(12, dtype=np.uint8)[:, None] * 20, 4))
    at = faces.mesh.triangles[7]
    np.testing.assert_allclose(faces.mesh.colors[at, 3], 140 / 255)
    np.testing.assert_allclose(faces.mesh.positions[at], trimesh.creation.box().triangles[7])

    checks, uv = np.array([[0, 255], [255, 9]], np.uint8), np.zeros((8, 2))
    image = Image.fromarray(checks)
    pbr = PBRMaterial(
        "paint",
        baseColorFactor=[0, 255, 51, 102],
        roughnessFactor=0.25,
        emissiveFactor=[0, 0.5, 1],
        alphaMode="BLEND",
        metallicRoughnessTexture=image,
        doubleSided=True,
    )
    found = added(trimesh.visual.TextureVisuals(uv=uv, material=pbr)).material
    np.testing.assert_allclose([*found.base_color, found.alpha], (0, 1, 0.2, 0.4))
    assert (found.metallic, found.roughness, found.alpha_mode, found.name) == (1, 0.25, "blend", "paint")
    assert found.emissive.tolist() == [0, 0.5, 1]
    assert found.double_sided
    assert found.metallic_roughness_texture.image.pixels[..., 1].tolist() == checks.tolist()
    simple = SimpleMaterial(image=image, glossiness=30)
    found = added(trimesh.visual.TextureVisuals(uv=uv, material=simple)).material
    assert (found.metallic, *found.base_color) == (0, 1, 1, 1)
    assert found.base_color_texture is not None
    assert found.roughness == pytest.approx((2 / 32) ** 0.25)
    with pytest.warns(UserWarning, match="trimesh: metallicRoughnessTexture left out; textures need uvs"):
        assert added(trimesh.visual.TextureVisuals(material=pbr)).material.metallic_roughness_texture is None
    red = Material(base_color=(1, 0, 0))
    assert Scene().add(trimesh.creation.box(), red).material is red


# ---- changes ----------------------------------------------------------------------------------------


def test_watchers_are_notified_once_per_change_and_held_weakly():
    notes = Notes()
    other = Notes()
    material = Material()
    for watcher in (notes, notes, other):
        material.watch(watcher)
    material.metallic = 0.5
    material.update(metallic=1, perceptual_roughness=0.25)
    assert notes.seen == other.seen == [material, material]
    gone = weakref.ref(notes)
    del notes
    gc.collect()
    assert gone() is None
    material.metallic = 0.5
    assert len(other.seen) == 3
    material.unwatch(other)
    material.metallic = 0
    assert len(other.seen) == 3


def test_updates_are_all_or_nothing():
    notes, made = Notes(), mesh(name="wall")
    made.watch(notes)
    for fields, message in (
        ({"uvs": [[0, 0]] * 3, "normals": "x"}, "Mesh 'wall': normals"),
        ({"uvs": [[0, 0]] * 3, "positions": [*TRIANGLE, [1, 1, 1]], "triangles": [[0, 1, 2]]}, "uvs has 3 rows"),
        ({"uvs": [[0, 0]] * 3, "shade": 1}, "has no field 'shade'; there are positions, triangles"),
    ):
        with pytest.raises(SolariError, match=message):
            made.update(**fields)
        assert (made.uvs, made.triangles.tolist(), made.positions.tolist()) == (None, [[0, 1, 2]], TRIANGLE)
    assert not notes.seen
    made.update(positions=np.zeros((4, 3)), triangles=[[0, 1, 3]])
    assert notes.seen == [made]


def test_equal_objects_are_different_keys():
    assert len({mesh(), mesh()}) == 2


@pytest.mark.parametrize("value", [np.ones((3, 3)) * 1j, np.full((3, 3), None), np.full((3, 3), np.float32, object)])
def test_only_real_numbers_are_taken(value):
    with pytest.raises(SolariError, match="must be real numbers, not"):
        Mesh(positions=value)
    with pytest.raises(SolariError, match="must be real numbers, not"):
        Material(base_color=value[0])


@pytest.mark.parametrize(
    "make", [lambda: shapes.sphere(-1), lambda: shapes.sphere(float("nan")), lambda: shapes.box((1, 0, 0), (0, 1, 1))]
)
def test_shapes_have_a_size(make):
    with pytest.raises(SolariError, match=r"needs a|lowest and its highest corner"):
        make()


def test_words_for_objects_leave_out_defaults():
    assert repr(Material()) == "Material()"
    red = Material(base_color=(1, 0, 0), roughness=0.25, name="red")
    assert repr(red) == "Material(base_color=(1, 0, 0), perceptual_roughness=0.25, name='red')"
    ball = Instance(shapes.sphere(), red, (1, 2, 3))
    assert repr(ball) == "Instance(mesh=Mesh 'sphere', material=Material 'red', transform=<to (1, 2, 3)>)"
    assert repr(PointLight((0, 1, 0))) == "PointLight(position=(0, 1, 0))"
