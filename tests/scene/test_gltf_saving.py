"""`Scene.save`: glTF files are read back equal, what glTF can't say is named, and Khronos' validator agrees."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import re
import shutil
import subprocess
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.files import ASSETS
from support.scenes import bent_joints, check_same, random_transform, tube

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.scene import shapes
from solari_vk.scene.animation.clip import Animation
from solari_vk.scene.animation.keyframes import Channel
from solari_vk.scene.animation.rig import Rig
from solari_vk.scene.builtin import SCENES, builtin
from solari_vk.scene.material import TEXTURES, Material, Texture

VALIDATOR = "SOLARI_VK_GLTF_VALIDATOR"
ANIMATED = ["Fox/Fox.glb", "SimpleSkin/SimpleSkin.gltf", "MorphStressTest/MorphStressTest.gltf"]
FILES = [
    "FlightHelmet/FlightHelmet.gltf",
    "khronos_tests/ClearCoatTest.glb",
    "kaykit_dungeon/chest_gold.glb",
    *ANIMATED,
]

# ---- random scenes ----------------------------------------------------------------------------------

UNIT = st.floats(0, 1, width=32)
RANGES = {
    "ior": st.floats(1, 5) | st.just(1e6),
    "reflectance": st.floats(0, 100, width=32),
    "emissive": UNIT | st.floats(0, 2**20, width=32),
    "normal_scale": st.floats(-2, 2),
    "clearcoat_normal_scale": st.floats(-2, 2),
    "attenuation_distance": st.floats(1e-3, 1e6) | st.just(math.inf),
    "iridescence_ior": st.floats(1, 5),
    "dispersion": st.floats(0, 9),
    "iridescence_thickness": st.floats(0, 1e4, width=32),
    "anisotropy_rotation": st.floats(-9, 9),
    "double_sided": st.sampled_from([None, True, False]),
    "alpha_mode": st.sampled_from(["opaque", "mask", "blend"]),
    "name": st.text(max_size=4),
}
PIXELS = [np.full((1, 1), 9), np.arange(2 * 3 * 3).reshape(2, 3, 3), np.arange(2 * 2 * 4).reshape(2, 2, 4) * 16]
IMAGES = [sv.TextureImage(pixels.astype(np.uint8), name=f"picture {n}") for n, pixels in enumerate(PIXELS)]


@st.composite
def textures(draw):
    turn, size = draw(st.floats(-4, 4)), np.diag([draw(st.floats(-3, 3)) for _ in range(2)])
    rows = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]]) @ size
    wrap, filters = (
        st.sampled_from(["repeat", "mirrored_repeat", "clamp_to_edge"]),
        st.sampled_from(["linear", "nearest"]),
    )
    return Texture(
        draw(st.sampled_from(IMAGES)),
        wrap_u=draw(wrap),
        wrap_v=draw(wrap),
        magnification=draw(filters),
        minification=draw(filters),
        mipmaps=draw(st.booleans()),
        uv_set=draw(st.integers(0, 1)),
        uv_transform=np.append(rows, [[draw(UNIT)], [draw(UNIT)]], axis=1) if draw(st.booleans()) else np.eye(2, 3),
    )


@st.composite
def materials(draw):
    """Any fields of a material, a few of them other than by default."""
    made = {}
    for field in dataclasses.fields(Material):
        default, one = getattr(Material(), field.name), RANGES.get(field.name, UNIT)
        if draw(st.integers(0, 3)):
            continue
        if field.name.endswith("_texture"):
            made[field.name] = draw(textures())
        elif isinstance(default, np.ndarray):
            made[field.name] = [draw(one) for _ in default]
        else:
            made[field.name] = draw(st.booleans() if isinstance(default, bool) else one)
    return Material(**made)


def meshes(random):
    box, (skin, _) = shapes.box(), tube(targets=2, rng=random)
    count = len(box.positions)
    return [
        box,
        dataclasses.replace(box, name="plain", uvs=None),
        dataclasses.replace(box, name="rich", second_uvs=random.random((count, 2)), colors=random.random((count, 4))),
        skin,
        dataclasses.replace(skin, name="still", deformation=None),
    ]


@st.composite
def scenes(draw):
    random = np.random.default_rng(draw(st.integers(0, 2**16)))
    choices, scene = meshes(random), sv.Scene(name=draw(st.text(min_size=1, max_size=3)))
    for number in range(draw(st.integers(1, 4))):
        mesh, transform = choices[random.integers(len(choices))], random_transform(random, 1.0)
        if random.random() < 0.2:
            transform[:3, :3] = random.normal(size=(3, 3)) + 2 * np.eye(3)  # sheared
        pose = {}
        if mesh.deformation is not None and random.random() < 0.8:
            _, rest = tube()
            pose = {"joint_matrices": bent_joints(rest, 0.5)[:, :3], "morph_weights": random.random(2)}
        visible = bool(random.random() < 0.8)
        material = draw(materials())
        if material.normal_texture is not None and mesh.tangents is None:
            material.normal_texture = None  # with which the reader makes tangents
        scene.add(sv.Instance(mesh, material, transform, visible=visible, name=f"item {number}", **pose))
    color, at = random.random(3) * 3, random.normal(size=3)
    radius = draw(st.sampled_from([0, 0.25]))
    shadow = bool(radius) and draw(st.booleans())
    scene.add(sv.PointLight(at, color=color, radius=radius, blocks_light=shadow, name="point"))
    scene.add(
        sv.SpotLight(at, at + 1, color=color, range=draw(st.none() | st.just(7.5)), inner_cone_angle=0.2, name="a")
    )
    scene.add(sv.DirectionalLight(-at, color=color, angular_diameter=0.5, name="sun"))
    scene.add(sv.Portal(at, *(random.normal(size=(2, 3)) + np.eye(2, 3) * 3), name="window"))
    scene.add(sv.Camera.look_at(at, at + random.normal(size=3), ev100=3.5, aperture=0.1, vertical_fov=0.3, name="b"))
    scene.add(sv.Camera(position=at, orthographic_height=3, name="map"))
    scene.add(sv.Camera(projection="fisheye", vertical_fov=3.2, image_circle=3, pixel_aspect=1.1, name="fish"))
    scene.add(sv.Camera(distortion=[-0.2, 0.05, 1e-3, -1e-3, 0.01], fov=70, name="measured"))
    scene.add(sv.Camera(principal_point=(0.45, 0.6), orthographic_height=draw(st.sampled_from([0, 2])), name="shifted"))
    height, width = draw(st.sampled_from([(1, 1), (4, 9)]))
    picture = random.random((height, width, 3)) * 1e4
    scene.environment = sv.Environment(picture, intensity=2.5, rotation=draw(st.floats(-4, 4)))
    return scene


def saved(scene, path):
    """The scene that is read back, without any loss."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene.save(path)
    found = sv.load(path, strict=True)
    remarks = [remark for remark in found.warnings if "see their textures" not in remark]
    assert not remarks
    return found


@settings(max_examples=20, deadline=None)
@given(scenes(), st.sampled_from(["glb", "gltf"]))
def test_random_scenes_are_read_back_equal(tmp_path_factory, scene, suffix):
    path = tmp_path_factory.mktemp("saved") / f"a scene.{suffix}"
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*(unlit|as pinholes)")
        scene.save(path)
    found = sv.load(path, strict=True)
    check_same(scene, found)
    assert {file.suffix for file in path.parent.iterdir()} == ({".glb"} if suffix == "glb" else {".gltf", ".bin"})


@pytest.mark.parametrize("name", sorted(SCENES))
def test_builtin_scenes_are_read_back_equal(tmp_path, name):
    small = {"many_lights": {"sphere_count": 9, "box_count": 9}, "rooms": {"columns": 1, "rows": 2}}
    scene = builtin(name, **small.get(name, {}))
    check_same(scene, saved(scene, tmp_path / "scene.glb"))


@pytest.mark.parametrize("name", FILES)
def test_files_are_read_back_equal(tmp_path, name, asset):
    path = asset(name)
    check_same(sv.load(path), saved(sv.load(path), tmp_path / "scene.glb"))


# ---- clips ------------------------------------------------------------------------------------------


@pytest.fixture
def machine():
    """A scene whose clips move, hide and bend what hangs on nodes below a mirrored, sheared one."""
    mesh, rest = tube(targets=2)
    base = np.eye(4)
    base[:3, :3] = [[-1, 0.4, 0], [0, 1, 0], [0, 0, 2]]
    rig = Rig(
        [-1, 0, 1, 0],
        np.tile(np.eye(4), (4, 1, 1)),
        np.zeros((4, 3)),
        np.tile([0, 0, 0, 1], (4, 1)),
        np.ones((4, 3)),
        [(base, True)] + [(np.eye(4), True)] * 3,
        [True, True, True, False],
    )
    character = sv.Instance(mesh, joint_matrices=np.tile(np.eye(4), (3, 1, 1)), morph_weights=[0, 0.5], name="tube")
    box = sv.Instance(shapes.box(), transform=base @ np.diag([1, 1, 1, 1.0]), name="box")
    lamp = sv.PointLight((0, 0, 0), name="lamp")
    camera = sv.Camera(name="camera", vertical_fov=0.5)
    mirrored = sv.Instance(rig.inside_out(mesh), joint_matrices=character.joint_matrices, name="mirrored")
    scene = sv.Scene(character, mirrored, box, lamp, camera, name="machine")
    rig.attach(mirrored, 0, moves=False)
    rig.attach_side(mirrored, 0, True)
    rig.attach_skin(mirrored, [1, -1, 2], rest, np.linalg.inv(rest))
    rig.attach(box, 1)
    rig.attach(lamp, 2)
    rig.attach(camera, 0)
    rig.attach_skin(character, [1, -1, 2], rest, np.linalg.inv(rest))
    rig.attach_weights(character, 3)
    scene.animations.add(
        Animation(
            rig,
            [
                Channel(0, "translation", [0, 1, 1, 2], [[0, 0, 0], [1, 0, 0], [0, 5, 0], [0, 0, 1]]),
                Channel(1, "rotation", [0.5, 1], [[0, 0, 0, 1], [0, 2, 0, 2]]),
                Channel(1, "scale", [0, 2], np.ones((2, 3, 3)), "CUBICSPLINE"),
                Channel(2, "visible", [0, 1], [[1], [0]], "STEP"),
                Channel(3, "weights", [0, 1], [[0, 1], [0.5, 0.25]], "STEP"),
                Channel(0, "translation", [0, 2], [[0, 0, 0], [0, 3, 0]]),
            ],
            name="work",
        )
    )
    scene.animations.add(Animation(rig, [Channel(2, "translation", [0, 1], [[0, 0, 0], [1, 1, 1]])], name="rest"))
    scene.animate(0, "rest")
    return scene


def test_clips_are_read_back_equal(machine, tmp_path):
    check_same(machine, saved(machine, tmp_path / "machine.glb"))


def test_moved_objects_of_clips_are_named(machine, tmp_path):
    machine.animate(1.5, "work")
    named = "Instance 'mirrored', Instance 'box', PointLight 'lamp' and 2"
    with pytest.warns(UserWarning, match=f"in which these are written: {named} more"):
        machine.save(tmp_path / "machine.glb")


@pytest.fixture
def lit():
    """A scene of a camera and a lamp, which a clip lifts."""
    rig = Rig([-1], [np.eye(4)], [[0, 0, 0]], [[0, 0, 0, 1]], [[1, 1, 1]])
    scene = sv.Scene(sv.Camera(name="camera"), sv.SpotLight((0, 0, 0), (0, 0, -1), name="lamp"), name="lit")
    for item in (scene.cameras[0], scene.lights[0]):
        rig.attach(item, 0)
    scene.animations.add(Animation(rig, [Channel(0, "translation", [0, 1], [[0, 0, 0], [0, 2, 0]])], name="lift"))
    return scene


@pytest.mark.parametrize(
    ("edit", "named"),
    [
        (lambda scene: scene.animate(0.5), "Camera 'camera', SpotLight 'lamp'"),
        (lambda scene: scene.cameras[0].place((0, 0, 1), (1, 0, 0)), "Camera 'camera'"),
        (lambda scene: scene.lights[0].update(direction=(0, -1, 0)), "SpotLight 'lamp'"),
    ],
)
def test_moved_cameras_and_lights_of_clips_are_named(lit, tmp_path, edit, named):
    check_same(lit, saved(lit, tmp_path / "lit.glb"))
    lit.animate(0)
    edit(lit)
    with pytest.warns(UserWarning, match=f"in which these are written: {named}$"):
        lit.save(tmp_path / "lit.glb")


def test_hidden_instances_of_clips_stay_hidden(machine, tmp_path):
    machine.instances["box"].visible = False
    found = saved(machine, tmp_path / "machine.glb")
    found.animate(0.7, "work")
    assert [one.name for one in found.instances if not one.visible] == ["box"]


def test_the_backdrop_and_the_default_camera_may_follow_clips(machine, tmp_path):
    """Of two cameras, of which the second is read first."""
    second = sv.Camera(name="second")
    machine.animations[0].rig.attach(second, 1)
    machine.add(second)
    machine.animate(0, "rest")
    machine.backdrop = machine.instances["box"]
    check_same(machine, saved(machine, tmp_path / "machine.glb"))


def test_an_object_of_two_rigs_is_written_once(machine, lit, tmp_path):
    clip = lit.animations[0]
    clip.rig.attach(machine.cameras[0], 0)
    machine.animations.add(clip)
    with pytest.warns(UserWarning, match="two rigs follows the first alone: Camera 'camera'$"):
        machine.save(tmp_path / "machine.glb")
    assert sv.load(tmp_path / "machine.glb").cameras.names == ["camera"]


# ---- what is special --------------------------------------------------------------------------------


def test_variants_are_read_back_equal(tmp_path):
    box, red = shapes.box(), sv.Material(base_color=(1, 0, 0), name="red")
    scene = sv.Scene(sv.Instance(box, name="a"), sv.Instance(box, name="b"), name="shoes")
    scene.variants = {
        "Red": {scene.instances["a"]: red},
        "Blue": {scene.instances["a"]: sv.Material(base_color=(0, 0, 1))},
    }
    check_same(scene, saved(scene, tmp_path / "shoes.gltf"))


def test_meshes_materials_and_images_are_shared(tmp_path):
    box, picture = shapes.box(), Texture(IMAGES[1])
    materials = [sv.Material(base_color_texture=picture), sv.Material(emissive_texture=picture)]
    scene = sv.Scene(*(sv.Instance(box, material) for material in (*materials, *materials)))
    found = saved(scene, tmp_path / "scene.glb")
    assert (len(found.meshes), len(found.materials)) == (1, 2)
    first, second = found.materials
    assert first.base_color_texture.image is second.emissive_texture.image


def test_the_default_camera_comes_first(machine, tmp_path):
    machine.camera = sv.Camera(position=(0, 0, 9), name="mine")
    found = saved(machine, tmp_path / "scene.glb")
    assert found.camera.name == "mine"
    assert found.cameras.names == ["mine", "camera"]


def test_vertices_without_joints_stay(tmp_path):
    mesh, rest = tube()
    weights = mesh.deformation.joint_weights.copy()
    weights[:8] = 0
    still = dataclasses.replace(mesh.deformation, joint_weights=weights)
    instance = sv.Instance(
        dataclasses.replace(mesh, deformation=still),
        joint_matrices=bent_joints(rest, 1.0),
        name="tube",
        transform=np.diag([1, 2, 3, 1]),
    )
    check_same(sv.Scene(instance, name="one"), saved(sv.Scene(instance, name="one"), tmp_path / "scene.glb"))


SHEARED = sv.Texture(np.zeros((1, 1), np.uint8), uv_transform=[[1, 1, 0], [0, 1, 0]])
BOX, TILTED = shapes.box(), [[1, 0, 0], [0, 0, 1], [0, -1, 0]]


@pytest.mark.parametrize(
    ("item", "message"),
    [
        (sv.Instance(BOX, ray_mesh=BOX, name="tree"), "meshes for rays aren't written.*: Instance 'tree'$"),
        (sv.Instance(BOX, sv.Material(base_color_texture=SHEARED, name="cloth")), "lose the shear.*'cloth'$"),
        (sv.Instance(BOX, sv.Material(unlit=True, clearcoat=1, name="sign")), "unlit materials don't show.*'sign'"),
        (sv.Instance(sv.Mesh(np.eye(3), tangents=np.ones((3, 4)), name="flat")), "tangents.*without normals.*'flat'"),
        (sv.PointLight((0, 0, 0), intensity=1e15, color=2, name="nova"), "dimmed to 1e\\+15: PointLight 'nova'"),
        (sv.Environment(np.eye(4), rotation=TILTED, name="dome"), "tilted: Environment 'dome'"),
        (sv.Camera(projection="fisheye", name="fish"), "other programs show cameras.* as pinholes: Camera 'fish'"),
    ],
)
def test_what_gltf_cannot_say_is_named_once(tmp_path, item, message):
    scene = sv.Scene(item)
    with pytest.warns(UserWarning, match=message) as found:
        scene.save(tmp_path / "scene.glb")
    assert len(found) == 1
    sv.load(tmp_path / "scene.glb")


LENGTHS = np.arange(len(BOX.normals))[:, None]
UNFIT = dataclasses.replace(
    BOX, name="unfit", normals=LENGTHS * BOX.normals, tangents=LENGTHS * BOX.normals[:, [1, 2, 0, 0]]
)


def test_normals_have_a_length_of_1(tmp_path):
    """The first normal has the length 0: the faces of a box share no vertices, so it becomes that of its face."""
    found = saved(sv.Scene(sv.Instance(UNFIT)), tmp_path / "scene.glb").instances[0].mesh
    np.testing.assert_allclose(found.normals, BOX.normals, atol=1e-6)


@pytest.mark.parametrize("name", ["clearcoat_normal_texture", "anisotropy_texture"])
def test_textures_that_need_tangents_get_them(tmp_path, name):
    """As glTF demands them where there is no normal texture: along u, with vertices split where u turns around."""
    half = sv.Mesh(
        [[-1, 0, 0], [0, 0, 0], [0, 1, 0], [1, 0, 0]],
        [[0, 1, 2], [1, 3, 2]],
        normals=[[0, 0, 1]] * 4,
        uvs=[[1, 0], [0, 0], [0, 1], [1, 0]],
        colors=np.eye(4),
        name="half",
    )
    skin = dataclasses.replace(tube(targets=2)[0], tangents=None)
    pose = {"joint_matrices": bent_joints(tube()[1], 0.5)[:, :3], "morph_weights": [0.2, 0.7]}
    textured = sv.Material(**{name: IMAGES[1]})
    scene = sv.Scene(
        *(sv.Instance(mesh, textured) for mesh in (half, dataclasses.replace(half, normals=None))),
        sv.Instance(skin, textured, **pose),
        name="scene",
    )
    found = saved(scene, tmp_path / "scene.glb")
    check_same(scene, found)
    for mesh, least in zip((item.mesh for item in found.instances), (0.999, 0.999, 0.9), strict=True):
        faces, uvs = (part[mesh.triangles].astype(np.float64) for part in (mesh.positions, mesh.uvs))
        along = np.linalg.solve(uvs[:, 1:] - uvs[:, :1], faces[:, 1:] - faces[:, :1])[:, :1]
        tangents = mesh.tangents[mesh.triangles][..., :3]
        assert (along / np.linalg.norm(along, axis=2, keepdims=True) * tangents).sum(axis=2).min() > least
    assert saved(sv.Scene(sv.Instance(half)), tmp_path / "scene.glb").instances[0].mesh.tangents is None


def test_a_sky_becomes_a_map_and_a_sun(tmp_path):
    scene = sv.Scene()
    scene.environment = sv.Sky((1, 1, 0))
    with pytest.warns(UserWarning, match="a sky is written as a map and a sun"):
        scene.save(tmp_path / "sky.glb")
    found = sv.load(tmp_path / "sky.glb")
    assert found.environment.flux == pytest.approx(scene.environment.flux, rel=1e-6)
    np.testing.assert_allclose(found.environment.brightest, scene.environment.brightest, atol=1e-6)
    assert found.lights["sun"].illuminance > 1000


def test_a_file_of_another_ending_is_refused_and_nothing_is_lost_when_writing_fails(tmp_path, monkeypatch):
    scene = builtin("closed_box")
    for path in (tmp_path / "scene.obj", tmp_path / "scene"):
        with pytest.raises(SolariError, match=r"scene.*saved as .glb or .gltf"):
            scene.save(path)
    with pytest.raises(SolariError, match="there is no folder"):
        scene.save(tmp_path / "missing" / "scene.glb")
    with pytest.raises(SolariError, match="the path of a file"):
        scene.save(3)
    scene.save(tmp_path / "scene.gltf")
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}

    def fail(*paths):
        raise OSError(28, "No space left on device")

    replace = os.replace

    def fail_for_the_main_file(source, target):
        change = fail if str(source).endswith(".gltf") else replace
        change(source, target)

    for broken in (fail, fail_for_the_main_file):
        monkeypatch.setattr(os, "replace", broken)
        with pytest.raises(SolariError, match="No space left"):
            builtin("thin_wall").save(tmp_path / "scene.gltf")
        assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before
    with pytest.raises(SolariError, match="No space left"):
        builtin("thin_wall").save(tmp_path / "fresh.gltf")
    assert {file.name for file in tmp_path.iterdir()} == {*before}


def test_a_sky_that_cannot_be_written_is_named(tmp_path, monkeypatch):
    import OpenEXR

    for error in (OSError(28, "No space left on device"), RuntimeError("write failed")):

        def write(self, path, error=error):
            raise error

        monkeypatch.setattr(OpenEXR.File, "write", write)
        with pytest.raises(SolariError, match=r"sky.exr: can't be written: (No space|write failed)"):
            sv.Scene(sv.Environment(np.eye(4))).save(tmp_path / "sky.glb")
    assert not list(tmp_path.iterdir())


def test_extras_of_others_are_not_ours(tmp_path, writer):
    for extras in (None, 3, [], {"solari_vk": 1}, {"solari_vk": {"radius": -1}}):
        writer.json["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "point", "extras": extras}]}}
        writer.json["nodes"] = [{"extensions": {"KHR_lights_punctual": {"light": 0}}}]
        scene = writer.load()
        wrong = isinstance(extras, dict) and extras["solari_vk"] != 1
        assert [light.radius for light in scene.lights] == ([] if wrong else [0])
        assert bool(re.search("radius must be", "\n".join(scene.warnings))) == wrong


# ---- Khronos' validator -----------------------------------------------------------------------------

SCRIPT = """
const validator = require(process.argv[2]), fs = require('fs'), path = require('path')
Promise.all(process.argv.slice(3).map(file => validator.validateBytes(new Uint8Array(fs.readFileSync(file)), {
  externalResourceFunction: uri => Promise.resolve(
    new Uint8Array(fs.readFileSync(path.join(path.dirname(file), decodeURIComponent(uri))))),
}))).then(reports => console.log(JSON.stringify(reports.map(report => report.issues))))
"""


@pytest.fixture
def validate(tmp_path):
    """Validates files: the errors of each."""
    package, node = os.environ.get(VALIDATOR), shutil.which("node")
    if not package or not node:
        pytest.skip(f"no validator: `npm i gltf-validator`, and {VALIDATOR}=.../node_modules/gltf-validator")

    def errors(files):
        script = tmp_path / "validate.cjs"
        script.write_text(SCRIPT)
        ran = subprocess.run([node, script, os.path.abspath(package), *files], capture_output=True, check=True)
        return {
            file.name: [issue for issue in report["messages"] if issue["severity"] == 0]
            for file, report in zip(files, json.loads(ran.stdout), strict=True)
        }

    return errors


@pytest.mark.slow
def test_files_pass_the_validator_of_khronos(validate, machine, tmp_path):
    scenes = {name: builtin(name) for name in SCENES if name not in ("many_lights", "rooms")} | {"machine": machine}
    scenes |= {name.partition("/")[0]: sv.load(ASSETS / name) for name in FILES if (ASSETS / name).exists()}
    random = np.random.default_rng(5)
    layers = ("clearcoat", "sheen_color", "transmission", "anisotropy", "specular")
    layers += ("diffuse_transmission", "iridescence", "dispersion")
    rich = [
        sv.Material(**dict.fromkeys(layers, 0.5), solid=True, emissive=7, ior=2),
        sv.Material(unlit=True, alpha_mode="blend", alpha=0.5),
    ]
    scenes["meshes"] = sv.Scene(
        *(
            sv.Instance(mesh, one, random_transform(random, 1.0))
            for mesh in meshes(random)
            for one in rich
            for _ in range(6)
        )
    )
    layered = sv.Material(
        **dict.fromkeys((*layers, "roughness"), 0.5),
        **{
            name: Texture(IMAGES[1], uv_set=number % 2)
            for number, name in enumerate(TEXTURES)
            if name != "normal_texture"
        },
    )
    with_uvs = [mesh for mesh in [*meshes(random), UNFIT] if mesh.uvs is not None]
    scenes["layers"] = sv.Scene(*(sv.Instance(mesh, layered) for mesh in with_uvs))
    beam = sv.LightProfile([0, 30, 90], [0, 90], [[100, 80, 0], [100, 60, 0]])
    scenes["luminaires"] = sv.Scene(*(sv.PointLight((x, 2, 0), ies=beam, color=2 - x, radius=x) for x in (0, 1)))
    scenes["sky"] = sv.Scene(sv.Environment(random.random((4, 8, 3))), sv.DirectionalLight((0, -1, 0), color=3))
    for name, scene in scenes.items():
        scene.save(tmp_path / f"{name}.{'gltf' if name == 'cornell_box' else 'glb'}")
    files = sorted([*tmp_path.glob("*.glb"), *tmp_path.glob("*.gltf")])
    assert len(files) == len(scenes)
    found = validate(files)
    assert not any(found.values()), found
