"""Robots' files: MJCF and URDF by MuJoCo, whose own poses, colors and lights are the judge."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

import solari_vk as sv
from solari_vk.base.budget import BudgetError
from solari_vk.base.color import decode_srgb
from solari_vk.scene.files.mujoco import geoms, urdf
from solari_vk.scene.files.mujoco.mjcf import compile_spec
from solari_vk.scene.files.mujoco.model_scene import ModelScene, model_scene
from solari_vk.scene.files.mujoco.surfaces import WHITE, sky_image

mujoco = pytest.importorskip("mujoco")
UP = geoms.UP

ROBOT = """<mujoco model="arm">
  <asset>
    <texture name="board" type="2d" builtin="checker" width="8" height="8" rgb1="1 0 0" rgb2="0 0 1"/>
    <texture name="faces" type="cube" file="faces.png" gridsize="3 4" gridlayout=".U..LFRB.D.."/>
    <texture name="sky" type="skybox" builtin="gradient" rgb1="0 0 1" rgb2="1 0 0" width="16" height="96"/>
    <material name="board" texture="board" texrepeat="3 2" texuniform="true" reflectance=".2" shininess="1"/>
    <material name="faces" texture="faces" emission=".5" rgba="1 1 1 .5"/>
    <mesh name="tip" vertex="0 0 0 1 0 0 0 1 0 0 0 3"/>
    <hfield name="hill" nrow="3" ncol="3" size="1 2 .5 .1" elevation="0 0 0 0 1 0 0 0 0"/>
  </asset>
  <worldbody>
    <light name="lamp" pos="0 0 3" diffuse=".5 .5 .5" cutoff="30"/>
    <light name="sun" type="directional" dir="1 0 -1"/>
    <light name="bulb" type="point" pos="1 1 1" attenuation="0 0 1"/>
    <light name="candles" type="point" pos="1 1 1" intensity="7" bulbradius=".1"/>
    <camera name="wide" pos="0 -3 1" xyaxes="1 0 0 0 0 1" fovy="70"/>
    <camera name="sensor" pos="0 -3 1" xyaxes="1 0 0 0 0 1" focal=".004 .004" sensorsize=".004 .003" resolution="8 6"/>
    <geom name="floor" type="plane" size="0 0 1"/>
    <geom name="table" type="plane" size="2 1 1" material="board"/>
    <geom type="hfield" hfield="hill" pos="5 0 0"/>
    <body name="base" pos="0 0 1" euler="0 0 90">
      <geom name="shell" type="box" size=".3 .2 .1" material="faces"/>
      <geom name="hull" type="sphere" size=".5" group="3"/>
      <body name="forearm" pos="1 0 0">
        <joint name="elbow" axis="0 1 0" pos=".1 0 0"/>
        <geom name="bone" type="capsule" size=".1 .4" rgba=".2 .4 .6 1" group="1"/>
        <geom name="claw" type="mesh" mesh="tip"/>
        <site name="grip" size=".02"/>
      </body>
    </body>
  </worldbody>
</mujoco>"""


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "arm.xml"
    path.write_text(ROBOT, encoding="utf-8")
    Image.fromarray(np.arange(12).repeat(48).reshape(3, 4, 48)[..., :1].repeat(3, -1).astype(np.uint8) * 20).resize(
        (32, 24), Image.Resampling.NEAREST
    ).save(path.with_name("faces.png"))
    return path


def state(path):
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def test_geoms_stand_where_mujoco_has_them(robot):
    scene = sv.load(robot)
    model, data = state(robot)
    names = {"floor", "table", "shell", "bone", "claw", "grip"}
    assert names < set(scene.instances.names)
    assert "hull" not in scene.instances.names  # MuJoCo shows groups 0 to 2
    for name in names - {"grip"}:
        found = scene.instances[name].transform
        np.testing.assert_allclose(found[:3, :3], UP @ data.geom(name).xmat.reshape(3, 3), atol=1e-6)
        np.testing.assert_allclose(found[:3, 3], UP @ data.geom(name).xpos, atol=1e-6)
    number = model.geom("claw").id
    vertices = model.mesh_vert @ data.geom_xmat[number].reshape(3, 3).T + data.geom_xpos[number]
    claw = scene.instances["claw"]
    low, high = claw.mesh.positions @ claw.transform[:3, :3].T + claw.transform[:3, 3], vertices @ UP.T
    np.testing.assert_allclose((low.min(0), low.max(0)), (high.min(0), high.max(0)), atol=1e-5)
    assert scene.backdrop is scene.instances["floor"]  # without end, so that the default camera leaves it out


def test_surfaces_keep_what_the_file_says(robot):
    scene = sv.load(robot)
    table = scene.instances["table"].material
    # Twice in 2 m: texuniform counts half sizes.
    np.testing.assert_allclose(table.base_color_texture.uv_transform, [(6, 0, 0), (0, 2, 0)])
    texels = {tuple(texel) for texel in table.base_color_texture.image.pixels[..., :3].reshape(-1, 3).tolist()}
    assert texels == {(255, 0, 0), (0, 0, 255)}
    assert 0.16 * table.reflectance[0] ** 2 == pytest.approx(0.2, rel=1e-5)
    np.testing.assert_allclose(scene.instances["bone"].material.base_color, decode_srgb((0.2, 0.4, 0.6)))
    shell = scene.instances["shell"].material
    assert shell.alpha == 0.5
    assert shell.alpha_mode == "blend"
    np.testing.assert_allclose(shell.emissive, 0.5 * WHITE, rtol=1e-6)


@pytest.mark.parametrize(
    ("size", "uniform", "expected"),
    [
        # u = a x + b and v = c y + d (b, d without whole repeats), measured in pictures of mujoco.Renderer 3.17.
        ("0 0", "true", (0.25, 0.5, -0.35, 0.5)),
        ("0 0", "false", (0.25, 0.5, -0.35, 0.5)),
        ("0 2", "true", (0.25, 0.5, -0.35, 0.2)),
        ("0 2", "false", (0.25, 0.5, -0.175, 0.85)),
        ("2 1.5", "true", (0.25, 0.5, -0.35, 0.525)),
        ("2 1.5", "false", (0.125, 0.25, -0.7 / 3, 0.35)),
    ],
)
def test_textures_of_planes_lie_where_mujoco_has_them(tmp_path, size, uniform, expected):
    (tmp_path / "floor.xml").write_text(
        f"""<mujoco><asset><texture name="t" type="2d" builtin="checker" width="8" height="8"/>
        <material name="m" texture="t" texrepeat=".5 .7" texuniform="{uniform}"/></asset>
        <worldbody><geom name="floor" type="plane" size="{size} 1" material="m"/></worldbody></mujoco>"""
    )
    floor = sv.load(tmp_path / "floor.xml").instances["floor"]
    corners = np.column_stack([floor.mesh.uvs, np.ones(4)]) @ floor.material.base_color_texture.uv_transform.T
    places = floor.mesh.positions
    u, v = np.polyfit(places[:, 0], corners[:, 0], 1), np.polyfit(places[:, 1], corners[:, 1], 1)
    np.testing.assert_allclose((u[0], u[1] % 1, v[0], v[1] % 1), expected, atol=1e-3)


def test_sides_of_a_box_show_the_faces_of_a_cube(robot):
    """The file's layout is up, left, front, right, back, down; OpenGL's faces look along x, y and z."""
    scene = sv.load(robot)
    shell = scene.instances["shell"]
    pixels = shell.material.base_color_texture.image.pixels[..., 0]
    middle = shell.mesh.positions[shell.mesh.triangles].mean(axis=1)
    sides = np.abs(middle / (0.3, 0.2, 0.1)).argmax(axis=1)
    uvs = shell.mesh.uvs[shell.mesh.triangles].mean(axis=1)
    shown = pixels[(uvs[:, 1] * len(pixels)).astype(int), (uvs[:, 0] * pixels.shape[1]).astype(int)] // 20
    place = {(0, 1): 6, (0, -1): 4, (1, 1): 1, (1, -1): 9, (2, 1): 5, (2, -1): 7}  # by axis and sign
    assert [place[axis, np.sign(middle[i, axis])] for i, axis in enumerate(sides.tolist())] == shown.tolist()


def test_cubes_are_split_where_a_face_begins():
    """On a sphere, whose triangles lie across the edges of the cube, each uv is that of its direction."""
    mesh = geoms.with_cube_uvs(geoms.primitive("SPHERE", np.ones(3), 1.0), np.ones(3))
    corners = mesh.positions[mesh.triangles].astype(np.float64)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert area == pytest.approx(4 * np.pi, rel=0.01)
    height = 1 + 2 * geoms.FACE_MARGIN
    uvs = mesh.uvs[mesh.triangles].astype(np.float64)
    face = (uvs[..., 1].mean(axis=1) * 6).astype(int)
    share = np.stack([uvs[..., 0] * height, uvs[..., 1] * 6 * height - face[:, None] * height], -1) - geoms.FACE_MARGIN
    assert share.min() > -1e-5
    assert share.max() < 1 + 1e-5
    axes = np.array(geoms.CUBE_FACES, np.float64)[face]
    normal = np.cross(axes[:, 1], axes[:, 0])
    direction = normal[:, None] + np.einsum("tcs,tsk->tck", 2 * share - 1, axes)
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    found = corners / np.linalg.norm(corners, axis=-1, keepdims=True)
    assert np.abs(direction - found).max() < 1e-3


def test_lights_have_physical_units(robot):
    lights = sv.load(robot).lights
    lamp, sun, bulb, candles = (lights[name] for name in ("lamp", "sun", "bulb", "candles"))
    model, _ = state(robot)
    full = np.pi * WHITE
    np.testing.assert_allclose((lamp.position, lamp.direction), [(0, 3, 0), (0, -1, 0)], atol=1e-6)
    assert np.degrees(lamp.outer_cone_angle) == pytest.approx(30)
    squared = np.sum((model.light("lamp").pos - model.stat.center) ** 2)
    assert lamp.intensity == pytest.approx(full * squared, rel=1e-6)
    np.testing.assert_allclose(lamp.color, 0.5)
    np.testing.assert_allclose(sun.direction * 2**0.5, (1, -1, 0), atol=1e-6)
    assert bulb.intensity == pytest.approx(full, rel=1e-6)  # falls off by itself
    assert (candles.intensity, candles.radius) == (7, pytest.approx(0.1))
    assert lights["headlight"].illuminance == pytest.approx(full)
    sky = sv.load(robot).environment
    assert 0.05 < sky.flux / (4 * np.pi * WHITE) <= 0.4 + 1e-6  # of a white one all around
    sky = sky.image
    np.testing.assert_allclose(sky[0, 0], WHITE * decode_srgb((0, 0, 1)), atol=0.2)  # at the top
    np.testing.assert_allclose(sky[-1, 0], WHITE * decode_srgb((1, 0, 0)), atol=0.2)


def test_lights_follow_the_model(robot):
    """What the model changes changes; what it doesn't stays as it was edited, and a light that moves as bright."""
    model, data = state(robot)
    shown = model_scene(model, data)
    lamp, bulb, sun = (shown.scene.lights[name] for name in ("lamp", "bulb", "sun"))
    before = lamp.intensity
    lamp.color = (1, 0, 0)
    sun.illuminance = 5
    data.light_xpos[model.light("lamp").id] = (0, 0, 9)
    shown.update(data)
    assert lamp.position[1] == pytest.approx(9)
    assert (lamp.intensity, tuple(lamp.color)) == (before, (1, 0, 0))
    model.light_cutoff[model.light("lamp").id] = 20
    model.light_diffuse[model.light("bulb").id] = (0, 0.5, 0)
    model.light_type[model.light("sun").id] = mujoco.mjtLightType.mjLIGHT_POINT
    shown.update(data)
    assert np.degrees(lamp.outer_cone_angle) == pytest.approx(20)
    np.testing.assert_allclose((lamp.color, bulb.color), [(1, 0, 0), (0, 0.5, 0)])
    assert isinstance(shown.scene.lights["sun"], sv.PointLight)


def test_ambient_light_follows_the_model():
    model = mujoco.MjModel.from_xml_string('<mujoco><worldbody><geom size="1"/></worldbody></mujoco>')
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    shown = model_scene(model, data)
    flux = shown.scene.environment.flux
    model.vis.headlight.ambient *= 3
    shown.update(data)
    assert shown.scene.environment.flux == pytest.approx(3 * flux)
    own = shown.scene.environment = sv.Environment(7.0)
    model.vis.headlight.ambient *= 2
    shown.update(data)
    assert shown.scene.environment is own


def test_a_skybox_has_its_faces_around_the_scene():
    """Right, left, up, down, front, back, as rows of the texture; y is up, as in the scene."""
    colors = np.arange(6, dtype=np.uint8)[:, None, None, None] * 40 + np.zeros((1, 8, 8, 3), np.uint8)
    image = sky_image(colors.reshape(48, 8, 3))
    rows, columns = image.shape[:2]
    seen = [image[rows // 2, int(columns * share)] for share in (0.5, 0.75, 0.01, 0.25)]  # +x, +z, -x, -z
    expected = [WHITE * decode_srgb(np.full(3, 40 * face / 255)) for face in (0, 4, 1, 5)]
    np.testing.assert_allclose(seen, expected, rtol=1e-5)
    np.testing.assert_allclose((image[0, 0], image[-1, 0]), WHITE * decode_srgb(np.array([[80] * 3, [120] * 3]) / 255))


def test_cameras_have_the_files_lenses(robot):
    scene = sv.load(robot)
    wide, sensor = scene.cameras
    assert wide.fov == pytest.approx(70, abs=1e-4)
    np.testing.assert_allclose(wide.position, (0, 1, 3), atol=1e-6)
    np.testing.assert_allclose(-wide.transform[:3, 2], (0, 0, -1), atol=1e-6)
    assert sensor.vertical_fov == pytest.approx(2 * np.arctan(0.003 / 0.008), rel=1e-5)
    assert sensor.pixel_aspect == pytest.approx(1)


def test_groups_turn_as_joints_do(robot):
    """A joint's group, turned about its z axis, moves what MuJoCo moves; the body goes along with its base."""
    scene = sv.load(robot)
    model, data = state(robot)
    data.joint("elbow").qpos[0] = 0.7
    mujoco.mj_forward(model, data)
    elbow = scene.groups["elbow"]
    elbow.turn(-0.2)
    elbow.turn(0.7)  # not from the last angle on, but from the file's
    for name in ("bone", "claw"):
        np.testing.assert_allclose(scene.instances[name].transform[:3, 3], UP @ data.geom(name).xpos, atol=1e-5)
    np.testing.assert_allclose(scene.groups["forearm"].transform[:3, 3], UP @ data.body("forearm").xpos, atol=1e-5)
    before = elbow.position
    scene.groups["base"].position += (0, 1, 0)
    np.testing.assert_allclose(scene.groups["elbow"].position - before, (0, 1, 0), atol=1e-6)
    assert {one.name for one in scene.groups["geom group 1"]} == {"bone"}


def test_geoms_that_are_too_many_are_said(robot, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where MuJoCo writes its log
    model, data = state(robot)
    shown = ModelScene(model, most_geoms=2)
    with pytest.warns(UserWarning, match="only 2 geoms are shown: give a larger max_geom"):
        shown.update(data)
    assert len(shown.scene) == 2
    shown.update(data)
    assert len(shown.scene.warnings) == 1


def test_groups_of_bodies_keep_their_names(tmp_path):
    """A joint of the same name gets a number, as does a body without a name."""
    (tmp_path / "leg.xml").write_text(
        """<mujoco><worldbody><body name="knee"><joint name="body 2"/><geom size="1"/>
        <body><joint name="knee"/><geom size="1"/></body></body>
        <body name="geom group 0"><geom size="1"/></body></worldbody></mujoco>"""
    )
    names = {group.name for group in sv.load(tmp_path / "leg.xml").groups}
    assert names == {"knee", "knee 2", "body 2", "body 2 2", "geom group 0", "geom group 0 2"}


def test_long_chains_load_in_seconds(tmp_path):
    (tmp_path / "cable.xml").write_text(
        """<mujoco><worldbody><composite type="cable" curve="s" count="301 1 1" size="5" offset="0 0 1" initial="none">
        <joint kind="main" damping=".01"/><geom type="capsule" size=".002"/></composite></worldbody></mujoco>"""
    )
    scene = sv.load(tmp_path / "cable.xml")
    assert len(scene) == 300
    assert "levels deep" in scene.warnings[0]
    last = scene[-1]
    before = last.transform[1, 3]
    scene.groups["B_first"].position += (0, 1, 0)  # moves all, also what has no group of its own
    assert last.transform[1, 3] == pytest.approx(before + 1)


def test_bodies_are_labels(robot):
    scene = sv.load(robot)
    found = {name: (scene.instances[name].label, scene.instances[name].part_of) for name in ("table", "shell", "claw")}
    assert found == {"table": ("table", ""), "shell": ("base", "base"), "claw": ("base", "forearm")}


def test_soft_bodies_are_drawn(tmp_path):
    (tmp_path / "cloth.xml").write_text(
        """<mujoco><worldbody><flexcomp name="cloth" type="grid" count="4 4 1" spacing=".1 .1 .1" dim="2" mass="1"
        pos="0 0 1"><edge equality="true"/></flexcomp></worldbody></mujoco>"""
    )
    scene = sv.load(tmp_path / "cloth.xml")
    cloth = next(one for one in scene if "flex" in one.mesh.name)
    positions = cloth.mesh.positions @ cloth.transform[:3, :3].T
    np.testing.assert_allclose(np.ptp(positions, axis=0)[[0, 2]], 0.3, atol=0.02)
    assert abs(positions[:, 1].mean() - 1) < 0.01


URDF = """<robot name="r"><material name="blue"><color rgba="0 0 1 1"/></material>
<link name="a"><visual><geometry><box size="2 4 1"/></geometry><material name="blue"/></visual>
<collision><geometry><sphere radius="9"/></geometry></collision></link>
<link name="b"><inertial><mass value="nan"/></inertial>
<visual><origin xyz="0 0 1"/><geometry>
<mesh filename="package://pack/meshes/tip.obj" scale="2 2 2"/></geometry></visual>
<visual><geometry><cylinder radius=".1" length="1"/></geometry></visual></link>
<joint name="j" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0 0 .5"/><axis xyz="0 1 0"/></joint>
</robot>"""


@pytest.fixture
def package(tmp_path):
    for name in ("urdf", "meshes"):
        (tmp_path / "pack" / name).mkdir(parents=True)
    tip = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 3\nusemtl red\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    (tmp_path / "pack/meshes/tip.obj").write_text("mtllib tip.mtl\n" + tip)
    (tmp_path / "pack/meshes/tip.mtl").write_text("newmtl red\nKd 1 0 0\n")
    (tmp_path / "pack/urdf/r.urdf").write_text(URDF)
    return tmp_path / "pack/urdf/r.urdf"


def test_urdf_shows_what_is_visual(package):
    """Links without a mass, joints without limits, meshes of a package with materials of their own."""
    scene = sv.load(package)
    assert sorted(scene.instances.names) == ["a/box", "b/cylinder", "b/tip"]
    assert not scene.lights
    with pytest.raises(sv.SolariError, match="robots' files are turned to y up already"):
        sv.load(package, up="z")
    box = next(one for one in scene if one.part_of == "a")
    np.testing.assert_allclose(box.material.base_color, (0, 0, 1))
    tip = next(one for one in scene if one.material.name == "red")
    points = tip.mesh.positions @ tip.transform[:3, :3].T + tip.transform[:3, 3]
    np.testing.assert_allclose((points.min(0), points.max(0)), ((0, 1.5, -2), (2, 7.5, 0)), atol=1e-5)
    assert (tip.label, tip.part_of) == ("a", "b")
    scene.groups["j"].turn(np.pi)
    assert tip.transform[1, 3] == pytest.approx(-0.5, abs=1e-5)


def test_collada_has_its_unit_and_colors(package):
    trimesh, _ = pytest.importorskip("trimesh"), pytest.importorskip("collada")
    mesh = trimesh.creation.box((100, 200, 300))
    green = trimesh.visual.material.PBRMaterial(baseColorFactor=(0, 255, 0, 255))
    mesh.visual = trimesh.visual.TextureVisuals(material=green)
    text = mesh.export(file_type="dae").decode()
    text = text.replace("<up_axis>", '<unit name="centimeter" meter="0.01"/><up_axis>')
    assert "centimeter" in text
    (package.parent.parent / "meshes/tip.dae").write_text(text)
    package.write_text(URDF.replace("tip.obj", "tip.dae"))
    part = next(one for one in sv.load(package) if one.part_of == "b" and one.mesh.name != "cylinder")
    points = part.mesh.positions @ part.transform[:3, :3].T
    np.testing.assert_allclose(sorted(np.ptp(points, axis=0)), (2, 4, 6), rtol=1e-4)
    assert part.material.base_color[1] > 3 * part.material.base_color[0]


REPLICATED = """<mujoco><worldbody><replicate count="3000" offset="1 0 0"><replicate count="3000" offset="0 1 0">
<geom size=".1"/></replicate></replicate></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<svg/>", "is no model of MuJoCo"),
        ("<mujoco><worldbody></mujoco>", "damaged XML"),
        ('<mujoco><asset><mesh file="gone.stl"/></asset></mujoco>', "there is no file 'gone.stl'"),
        ('<mujoco><asset><mesh file="../out.stl"/></asset></mujoco>', "lies outside of"),
        ('<mujoco><include file="../out.stl"/></mujoco>', "lies outside of"),
        ('<mujoco><include file="bad.xml"/></mujoco>', "already included"),
        ('<mujoco><worldbody><body pos="nan 0 0"><geom size="1"/></body></worldbody></mujoco>', "pos is 'nan 0 0'"),
        ('<mujoco><worldbody><geom size="-1"/></worldbody></mujoco>', "MuJoCo can't read this"),
        ('<mujoco><asset><texture builtin="flat" width="99999" height="99999"/></asset></mujoco>', "memory"),
        ('<mujoco><asset><texture name="t" builtin="flat" width="99999"/></asset></mujoco>', "<texture> t would take"),
        ('<mujoco><asset><hfield nrow="99999" ncol="99999" size="1 1 1 1"/></asset></mujoco>', "<hfield> would take"),
        (REPLICATED, "copies of its elements would take"),
    ],
)
def test_bad_models_get_one_line(tmp_path, text, message):
    (tmp_path / "in").mkdir()
    (tmp_path / "out.stl").write_text("solid\nendsolid\n")
    (tmp_path / "in/bad.xml").write_text(text)
    with pytest.raises(sv.SolariError, match=message) as caught:
        sv.load(tmp_path / "in/bad.xml")
    assert "\n" not in str(caught.value)
    assert "bad.xml" in str(caught.value)


def test_what_mujocos_compiler_raises_gets_one_line():
    def fail():
        raise RuntimeError("out of\nluck")

    with pytest.raises(sv.SolariError, match=r"a\.xml: MuJoCo can't read this: out of luck"):
        compile_spec("a.xml", mujoco, fail)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("meshes/tip.obj", "meshes/none.obj"), "no file 'meshes/none.obj' in a package 'pack'"),
        (("package://pack/meshes/tip.obj", "../../../etc/passwd.obj"), "no file"),
        (('child link="b"', 'child link="c"'), "MuJoCo can't read this"),
        (('scale="2 2 2"', 'scale="0 2 2"'), "scale of a mesh"),
        (('rgba="0 0 1 1"', 'rgba="blue"'), "bad format in attribute .rgba"),
        (('<box size="2 4 1"/>', ""), "no <geometry>"),
        (("<robot", "<model"), "no URDF"),
        (('box size="2 4 1"', 'box size="${w} 4 1"'), "expand it first"),
        (('filename="package://pack/meshes/tip.obj"', ""), "the mesh of link 'b' has no filename"),
    ],
)
def test_bad_urdf_gets_one_line(package, change, message):
    text = URDF.replace(*change)
    package.write_text(text.replace("</robot>", "</model>") if change[0] == "<robot" else text)
    with pytest.raises(sv.SolariError, match=message) as caught:
        sv.load(package, strict=True)
    assert "\n" not in str(caught.value)


def test_urdf_with_what_robots_have(package):
    """A texture or a mesh that is missing is left out, and said, unless strict; a floating joint keeps its initial
    pose; a file without meshes leaves nothing."""
    textured = '<material name="m"><texture filename="none.png"/></material></visual>'
    text = URDF.replace('<material name="blue"/></visual>', textured).replace("revolute", "floating")
    package.write_text(text)
    scene = sv.load(package)
    assert "no file 'none.png'" in scene.warnings[0]
    assert len(scene) == 3
    tip = next(one for one in scene if one.material.name == "red")
    assert tip.transform[1, 3] == pytest.approx(1.5)
    with pytest.raises(sv.SolariError, match=r"none\.png"):
        sv.load(package, strict=True)
    package.write_text(URDF.replace("tip.obj", "none.obj"))
    scene = sv.load(package)
    assert "the mesh of link 'b'" in scene.warnings[0]
    assert len(scene) == 2
    sv.Scene().save(package.parent.parent / "meshes/tip.glb")
    package.write_text(URDF.replace("tip.obj", "tip.glb"))
    scene = sv.load(package)
    assert len(scene) == 2
    assert len(scene.groups["b"]) == 1


def test_a_robot_without_any_of_its_meshes_is_an_error(package):
    visual = '<visual><geometry><mesh filename="none.obj"/></geometry></visual>'
    package.write_text(f'<robot name="r"><link name="a">{visual}</link></robot>')
    with pytest.raises(sv.SolariError, match=r"no file 'none\.obj'"):
        sv.load(package)


def test_visuals_of_urdf_have_names_of_their_own(package, capfd):
    """Those of the file where they are each once, else of the link and the shape or the mesh's file."""
    ball, tip = '<sphere radius="1"/>', '<mesh filename="../meshes/tip.obj"/>'
    shapes = (("x", ball), ("", tip), ("x", ball), ("", tip), ("y", tip))
    visuals = "".join(f'<visual name="{name}"><geometry>{shape}</geometry></visual>' for name, shape in shapes)
    package.write_text(f'<robot name="r"><link name="world">{visuals}</link></robot>')
    (package.parent.parent / "package.xml").write_text("<package/>")
    found = {one.name: one.label for one in sv.load(package)}
    assert found == {"x": "x", "world/sphere": "x", "world/tip": "tip", "world/tip 2": "tip", "y": "y"}
    assert "duplicate" not in "".join(capfd.readouterr())  # of MuJoCo


def test_a_spent_budget_leaves_no_mesh_out(package, monkeypatch):
    def fail(*_):
        raise BudgetError("spent")

    monkeypatch.setattr(urdf, "_mesh_scene", fail)
    with pytest.raises(BudgetError, match="spent"):
        sv.load(package)


def test_folders_above_are_packages_by_what_they_have(package):
    """Not by their name alone: package:// of any folder above would read what lies there."""
    outer = package.parent.parent.parent
    (outer / "tip.obj").write_bytes((outer / "pack/meshes/tip.obj").read_bytes())
    package.write_text(URDF.replace("pack/meshes/tip.obj", f"{outer.name}/tip.obj"))
    with pytest.raises(sv.SolariError, match=r"package\.xml"):
        sv.load(package, strict=True)
    (outer / "package.xml").write_text("<package/>")
    assert len(sv.load(package)) == 3
    with pytest.raises(sv.SolariError, match=r"no file 'tip\.obj'"):
        sv.load(package, folder=outer / "pack", strict=True)
    assert len(sv.load(package, folder=outer)) == 3
    package.write_text(URDF.replace("pack/meshes/tip.obj", "pack/%00.obj"))
    with pytest.raises(sv.SolariError, match="no file"):
        sv.load(package, strict=True)


def test_a_folder_allows_what_lies_beside(package):
    (package.parent.parent.parent / "tip.obj").write_bytes((package.parent.parent / "meshes/tip.obj").read_bytes())
    package.write_text(URDF.replace("package://pack/meshes/tip.obj", "../../tip.obj"))
    with pytest.raises(sv.SolariError, match="folder="):
        sv.load(package, strict=True)
    assert len(sv.load(package, folder=package.parent.parent.parent)) == 3
    with pytest.raises(sv.SolariError, match="folder"):
        sv.load(package.parent.parent / "meshes/tip.obj", folder=".")


def test_what_simulations_alone_depend_on_is_not_said(tmp_path, monkeypatch, capfd):
    """MuJoCo warns of parts with other settings, and writes a log into the current folder."""
    monkeypatch.chdir(tmp_path)
    ball = '<worldbody><body name="ball"><geom size="1"/></body></worldbody>'
    (tmp_path / "part.xml").write_text(f'<mujoco><visual><map zfar="20"/></visual>{ball}</mujoco>')
    (tmp_path / "robot.xml").write_text(
        '<mujoco><asset><model name="part" file="part.xml"/></asset><worldbody>'
        '<light cutoff="0" diffuse="-1 0 0"/><attach model="part" body="ball" prefix="p_"/></worldbody></mujoco>'
    )
    assert len(sv.load("robot.xml").instances) == 1
    assert capfd.readouterr().err == ""
    assert {file.name for file in tmp_path.iterdir()} == {"part.xml", "robot.xml"}
