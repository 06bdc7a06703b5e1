"""The scene's objects: what they accept, that changes reach their watchers, and that refusals change nothing."""

from __future__ import annotations

import gc
import math

import numpy as np
import pytest

from solari_vk.errors import SolariError
from solari_vk.scene.lights.punctual import PointLight, SpotLight
from solari_vk.scene.model import Camera, DirectionalLight, Instance, Material, Mesh, Texture, TextureImage

TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
SPOT = {"position": [0, 1, 0], "direction": [0, -1, 0]}


def mesh(**fields):
    return Mesh(**{"positions": TRIANGLE, **fields})


class Notes:
    """A watcher."""

    def __init__(self):
        self.seen = []

    def note(self, changed):
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
    assert mesh().triangles.tolist() == [[0, 1, 2]]


REFUSED = [
    (Mesh, {"positions": [[0, 0]]}, r"positions must have the shape \(N, 3\), not \(1, 2\)"),
    (Mesh, {"positions": [[0, 0, math.nan]] * 3}, r"must be finite, but element \(0, 2\) is nan"),
    (Mesh, {"positions": [[0, 0, 1e60]] * 3}, "must be finite"),
    (Mesh, {"positions": TRIANGLE[:2]}, "must be a positive multiple of 3, not 2"),
    (Mesh, {"positions": np.zeros((0, 3))}, "must be a positive multiple of 3, not 0"),
    (Mesh, {"positions": TRIANGLE, "triangles": [[0, 1, 3]]}, "triangles must be rows of positions, 0 to 2"),
    (Mesh, {"positions": TRIANGLE, "triangles": np.zeros((0, 3), int)}, "triangles must be rows"),
    (Mesh, {"positions": TRIANGLE, "triangles": [[0, -1, 2]]}, "must lie between 0 and 4294967295"),
    (Mesh, {"positions": TRIANGLE, "triangles": [[0, 1, 2**40]]}, "must lie between 0 and 4294967295"),
    (Mesh, {"positions": TRIANGLE, "triangles": [[0.0, 1.0, 2.0]]}, "must be integers, not float64"),
    (Mesh, {"positions": TRIANGLE, "uvs": [[0, 0]]}, "uvs has 1 rows for 3 positions"),
    (Mesh, {"positions": TRIANGLE, "name": "wall", "normals": [[0, 0, 1]]}, "Mesh 'wall': normals has 1 rows"),
    (Mesh, {"positions": "none"}, "positions"),
    (TextureImage, {"pixels": np.zeros((0, 4, 4), np.uint8)}, "at least one pixel"),
    (TextureImage, {"pixels": np.zeros((2, 2, 2), np.uint8)}, r"shape \(N, N, 4\).*: give 8-bit pixels"),
    (TextureImage, {"pixels": np.zeros((2, 2, 4))}, "must be integers"),
    (Material, {"metallic": 1.5}, "metallic must be a finite number between 0 and 1, not 1.5"),
    (Material, {"metallic": "much"}, "metallic"),
    (Material, {"perceptual_roughness": math.nan}, "perceptual_roughness must be a finite number"),
    (Material, {"base_color": [0, 0, 1.1]}, "base_color must lie between 0 and 1"),
    (Material, {"base_color": [0, 0]}, "base_color"),
    (Material, {"emissive": [-1, 0, 0]}, "emissive must lie between 0 and 1e"),
    (Material, {"emissive": math.inf}, "emissive must be finite"),
    (Material, {"emissive": 1e60}, "emissive must be finite"),
    (Material, {"normal_texture": TRIANGLE}, "normal_texture must be a Texture or an array of pixels, not list"),
    (Instance, {"mesh": None, "material": Material()}, "mesh must be a Mesh, not NoneType"),
    (DirectionalLight, {"direction": [0, 0, 0]}, "direction must not be zero"),
    (DirectionalLight, {"direction": [0, 1, 0], "angular_diameter": 0}, "angular_diameter"),
    (DirectionalLight, {"direction": [0, 1, 0], "illuminance": -1}, "illuminance"),
    (PointLight, {"position": [0, 1]}, "position must have the shape"),
    (PointLight, {"position": [0, 1, np.nan]}, "position must be finite"),
    (PointLight, {"position": [0, 1, 0], "intensity": -1}, "intensity"),
    (PointLight, {"position": [0, 1, 0], "intensity": np.nan}, "intensity must be a finite number"),
    (PointLight, {"position": [0, 1, 0], "radius": -1}, "radius"),
    (PointLight, {"position": [0, 1, 0], "radius": 1e-9}, "radius must be 0 or at least 1e-05 m"),
    (PointLight, {"position": [0, 1, 0], "range": 0}, "range"),
    (PointLight, {"position": [0, 1, 0], "color": -1}, "color"),
    (SpotLight, {"position": [0, 1, 0], "direction": [0, 0, 0]}, "direction must not be zero"),
    (SpotLight, {**SPOT, "outer_cone_angle": 1.6}, "outer_cone_angle must be a finite number between 0 and 1.57"),
    (SpotLight, {**SPOT, "inner_cone_angle": 0.8}, "inner_cone_angle must be smaller than outer_cone_angle"),
    (SpotLight, {**SPOT, "inner_cone_angle": 0.5, "outer_cone_angle": 0.5}, "inner_cone_angle must be smaller"),
    (SpotLight, {**SPOT, "inner_cone_angle": -0.1}, "inner_cone_angle"),
    (Camera, {"vertical_fov": 4}, "vertical_fov"),
    (Camera, {"near": 0}, "near"),
    (Camera, {"near": 1e39}, r"near must be a finite number between 1e-09 and 1e\+18"),
    (Camera, {"jitter": [0, 0, 0]}, "jitter"),
]


@pytest.mark.parametrize(("kind", "fields", "message"), REFUSED)
def test_refused_fields(kind, fields, message):
    with pytest.raises(SolariError, match=message):
        kind(**fields)


@pytest.mark.parametrize(
    ("transform", "message"),
    [(np.eye(3), "shape"), (np.diag([1, 0, 1, 1]), "invertible"), (np.diag([1, 1, 1, 2]), "affine"),
     (np.full((4, 4), math.nan), "finite"), (np.zeros((4, 4)), "affine"), (np.diag([1e300, 1, 1, 1]), "within 1e"),
     (np.ones((3, 4)), "invertible"), ("x", "transform")],
)  # fmt: skip
def test_refused_transforms(transform, message):
    with pytest.raises(SolariError, match=message):
        Instance(mesh(), transform=transform)


@pytest.mark.parametrize("scale", [1e-3, 1, 1e4, -1])
def test_transforms_of_any_usual_size_and_three_rows(scale):
    matrix = np.diag([scale, 1, 1, 1])
    matrix[:3, 3] = [1e4, 0, 0]
    assert Instance(mesh(), transform=matrix[:3]).transform.tolist() == matrix.tolist()


@pytest.mark.parametrize("length", [1e-300, 1.0, 1e300])
def test_directions_of_any_length_become_unit_vectors(length):
    light = DirectionalLight(direction=np.array((3.0, 0.0, -4.0)) * length)
    assert light.direction == pytest.approx((0.6, 0.0, -0.8))


def test_colors_may_be_gray_and_wrap_modes_are_words():
    assert Material(base_color=0.25, reflectance=[0, 0.5, 1]).base_color.tolist() == [0.25] * 3
    image = TextureImage(pixels=np.zeros((1, 1, 4), np.uint8))
    assert Texture(image=image, wrap_u="clamp_to_edge").uv_transform.tolist() == np.eye(2, 3).tolist()
    with pytest.raises(SolariError, match="wrap_u must be one of repeat, mirrored_repeat, clamp_to_edge, not 'wrap'"):
        Texture(image=image, wrap_u="wrap")
    assert not Material().emits
    assert Material(emissive=[0, 0, 1]).emits


# ---- changes ----------------------------------------------------------------------------------------


def test_watchers_are_notified_once_per_change():
    notes, material = Notes(), Material()
    material.watch(notes)
    material.watch(notes)
    material.metallic = 0.5
    material.update(metallic=1, perceptual_roughness=0.25)
    assert notes.seen == [material, material]
    material.unwatch(notes)
    material.metallic = 0
    assert len(notes.seen) == 2


def test_watchers_are_held_weakly():
    notes, other, material = Notes(), Notes(), Material()
    material.watch(notes)
    material.watch(other)
    del notes
    gc.collect()
    material.metallic = 0.5
    assert other.seen == [material]
    material.unwatch(other)
    assert not material._watchers


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
        assert made.uvs is None
        assert made.triangles.tolist() == [[0, 1, 2]]
        assert made.positions.tolist() == TRIANGLE
    assert not notes.seen
    made.update(positions=np.zeros((4, 3)), triangles=[[0, 1, 3]])
    assert notes.seen == [made]


def test_misspelt_fields_are_refused():
    with pytest.raises(SolariError, match=r"no field '_default_triangles'; .*there are positions, triangles"):
        mesh(_default_triangles=None)
    assert "_default" not in repr(mesh())
    with pytest.raises(SolariError, match=r"no field 'metalic'; did you mean 'metallic'. there are base_color"):
        Material().metalic = 1
    with pytest.raises(SolariError, match=r"Camera has no field 'fov'; did you mean 'vertical_fov'"):
        Camera(fov=1.0)


def test_equal_objects_are_different_keys():
    assert len({mesh(), mesh()}) == 2


# ---- cameras ----------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_look_at():
    camera = Camera.look_at([1, 2, 3], [1, 2, -7], vertical_fov=1, name="eye", ev100=3)
    np.testing.assert_allclose(camera.transform, [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
    assert (camera.vertical_fov, camera.name) == (1, "eye")
    assert camera.look_at([0, 5, 0], [0, 0, 0], up=[0, 0, -1], vertical_fov=0.5) is camera, "moves the camera"
    np.testing.assert_allclose(camera.transform[:3, 2:], [[0, 0], [1, 5], [0, 0]])
    assert (camera.ev100, camera.vertical_fov) == (3, 0.5)
    for position, target in (([0, 0, 0], [0, 0, 0]), ([0, 5, 0], [0, 0, 0])):
        with pytest.raises(SolariError, match="must differ, and up must not lie along the view"):
            Camera.look_at(position, target)
    for position in ([math.nan, 0, 0], [math.inf, 0, 0], [1e308, -1e308, 0], [10**400, 0, 0]):
        with pytest.raises(SolariError, match="must be finite and not too far apart"):
            Camera.look_at(position, [0, 1e308, 0])
    with pytest.raises(SolariError, match="must be finite and not too far apart"):
        Camera.from_pose({"position": [10**400, 0, 0], "target": [0, 0, 0]})


def test_exposure():
    assert Camera(ev100=0).exposure == pytest.approx(1 / 1.2)
    assert Camera(ev100=3).exposure == pytest.approx(1 / 9.6)


def test_poses_round_trip():
    camera = Camera.look_at([1, 2, 3], [4, 5, 7], ev100=2)
    again = Camera.from_pose(camera.pose())
    np.testing.assert_allclose(again.transform, camera.transform)
    assert again.vertical_fov == pytest.approx(camera.vertical_fov)
    assert again.ev100 == 2
    aimed = Camera.from_pose({"position": [1, 2, 3], "target": [4, 5, 7]})
    np.testing.assert_allclose(aimed.transform, camera.transform)


@pytest.mark.parametrize(
    ("pose", "message"),
    [([], "a JSON object of"), ({"eye": 1}, "a JSON object of"), ({"position": [0, 0, 0]}, "needs 'position' and"),
     ({"position": "x", "target": [0, 0, 0]}, "needs"), ({"transform": [[1]]}, "shape"),
     ({"position": [0, 0, 1], "target": [0, 0, 0], "vertical_fov_degrees": 200}, "vertical_fov")],
)  # fmt: skip
def test_poses_that_make_no_camera(pose, message):
    with pytest.raises(SolariError, match=message):
        Camera.from_pose(pose)
