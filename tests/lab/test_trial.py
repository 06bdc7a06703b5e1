"""`solari-vk trial`: what other renderers are given, their failures, the page, and what is measured of pictures.

The renderers of most tests are fakes; those that are installed (for Python at SOLARI_VK_TRIAL_PYTHON, or here) are
compared with closed forms, and in a slow test with the path tracer."""

from __future__ import annotations

import html
import json
import math
import os
import re
import runpy
import shutil
import sys
from pathlib import Path
from unittest.mock import MagicMock, Mock
from urllib.parse import unquote

import numpy as np
import pytest
from support.files import GltfWriter

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.lab.cli.trial import TrialJob, _scenes
from solari_vk.lab.trial import compare as trial_compare
from solari_vk.lab.trial import process, scene_files, translation
from solari_vk.lab.trial.compare import Comparison, Goal, Result, distance
from solari_vk.lab.trial.differences import DIFFERENCES, that_apply
from solari_vk.lab.trial.page import Page, error_map
from solari_vk.lab.trial.process import KINDS, OURS, Kind, Process, Render
from solari_vk.lab.trial.run import Plan, pythons_of, run
from solari_vk.lab.trial.scene_files import Conditions, TrialScene
from solari_vk.scene.animation.clip import Animation
from solari_vk.scene.animation.keyframes import Channel
from solari_vk.scene.animation.rig import Rig
from solari_vk.scene.lights.environment import directions
from solari_vk.scene.matrices import rotation

PYTHON = os.environ.get("SOLARI_VK_TRIAL_PYTHON", sys.executable)
SIZE = 24, 16
FAKE = """
import os, time
import numpy as np
def load(job, folder):
    {loading}
    def render(samples, seed):
        if seed == 0: return None
        {rendering}
        noise = np.random.default_rng((seed, samples, {level!r} > 1)).standard_normal((16, 24, 3))
        return {level} * (1 + 0.2 * noise / samples**0.5)
    return render
"""


def quad(writer, corners, color, **fields):
    """A matte square, as all renderers understand it."""
    extensions = {"KHR_materials_specular": {"specularFactor": 0}}
    base = {"baseColorFactor": [*color, 1], "metallicFactor": 0, "roughnessFactor": 1}
    material = writer.add("materials", pbrMetallicRoughness=base, extensions=extensions, **fields)
    uvs = [[0, 1], [1, 1], [1, 0], [0, 0]]
    mesh = writer.mesh({"POSITION": corners, "TEXCOORD_0": uvs}, [0, 1, 2, 0, 2, 3], material=material)
    return writer.node(mesh=mesh)


def floor(path):
    """The file of a floor with an albedo of 0.5."""
    writer = GltfWriter()
    quad(writer, [[-2, 0, 2], [2, 0, 2], [2, 0, -2], [-2, 0, -2]], (0.5, 0.5, 0.5))
    return writer.save(path)


def diffuse_box(path):
    """The file of a matte room under a bright ceiling, with a blue screen in it."""
    writer, gray = GltfWriter(), (0.7, 0.7, 0.7)
    quad(writer, [[-1, -1, 1], [1, -1, 1], [1, -1, -1], [-1, -1, -1]], gray)
    quad(writer, [[-1, 1, -1], [1, 1, -1], [1, 1, 1], [-1, 1, 1]], (0, 0, 0), emissiveFactor=[1, 0.8, 0.6])
    quad(writer, [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1]], gray)
    quad(writer, [[-1, -1, 1], [-1, -1, -1], [-1, 1, -1], [-1, 1, 1]], (0.6, 0.05, 0.05))
    quad(writer, [[1, -1, -1], [1, -1, 1], [1, 1, 1], [1, 1, -1]], (0.1, 0.5, 0.1))
    quad(writer, [[-0.5, -1, 0.3], [0, -1, 0.5], [0, 0, 0.5], [-0.5, 0, 0.3]], (0.3, 0.3, 0.8))
    writer.node(
        camera=writer.add("cameras", type="perspective", perspective={"yfov": 0.8, "znear": 0.01}),
        translation=[0, 0, 3.4],
    )
    return writer.save(path)


@pytest.fixture
def fakes(tmp_path, monkeypatch):
    """Replaces the renderers by fakes whose pictures are 1, 1.1 and 0.9 with noise; returns run(loading=, rendering=),
    code of the fake Cycles, which gives the facts of the page."""
    for name, kind in KINDS.items():
        monkeypatch.setitem(process.KINDS, name, Kind(kind.title, kind.module, "numpy"))
    shutil.copy(process.CHILD, tmp_path)

    def trial(loading="pass", rendering="pass", **plan):
        for kind, level in (("in_solari", 1.0), ("in_cycles", 1.1), ("in_mitsuba", 0.9)):
            code = {"loading": loading, "rendering": rendering} if kind == "in_cycles" else {}
            text = FAKE.format(**({"loading": "pass", "rendering": "pass", "level": level} | code))
            (tmp_path / f"{kind}.py").write_text(text)
        scene = sv.load(floor(tmp_path / "floor.glb"))
        given = [TrialScene("floor", tmp_path / "floor.glb", scene, scene.camera), ("bad", SolariError("bad.glb: no"))]
        run(
            iter(given),
            ("cycles", "mitsuba"),
            Plan(**({"samples": 256, "goals": (), "limit": 20.0} | plan)),
            Conditions(SIZE),
            pythons_of((), sys.executable),
            tmp_path / "page",
            tmp_path / "page.md",
            tmp_path / "child.py",
        )
        return json.loads((tmp_path / "page/trial.json").read_text())

    return trial


# ---- the page and the processes ---------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore:.*twice as wide")
def test_the_page_has_pictures_distances_and_times(fakes, tmp_path):
    found = fakes(goals=[Goal(0.01)])["scenes"]["floor"]
    pairs = {tuple(row["pair"]): row for row in found["distances"]}
    assert list(pairs) == [(OURS, "cycles"), (OURS, "mitsuba"), ("cycles", "mitsuba")]
    for (first, second), a, b in zip(pairs, (1.0, 1.0, 1.1), (1.1, 0.9, 0.9), strict=True):
        row, middle = pairs[first, second], (a + b) / 2
        assert row["ratio"] == pytest.approx([a / b] * 3, rel=5e-3)
        assert row["relative_mse"] == pytest.approx((a - b) ** 2 / middle**2 / 1.01, rel=0.1)  # the noise is 0.0003
    for renderer in found["renderers"].values():
        assert renderer["noise"] == pytest.approx(0.04 / 256, rel=0.2)
        assert renderer["reached"]["samples"] == 4  # 0.04 / 4
        assert renderer["reached"]["error"] == pytest.approx(0.01, rel=0.2)
    page = (tmp_path / "page/index.html").read_text()
    pictures = re.findall(r"<img src='([^']+)'", page)
    assert len(pictures) == 9
    assert all((tmp_path / "page" / picture).stat().st_size > 0 for picture in pictures)
    assert "explained" not in page.partition("<h2>bad")[0].partition("<h2>floor")[2]  # a matte floor has no excuses
    assert "<li>solari_vk: bad.glb: no</li>" in page
    written = sv.Environment(str(tmp_path / "page/floor/cycles.exr")).image
    assert written.mean() == pytest.approx(1.1, rel=5e-3)
    lines = (tmp_path / "page.md").read_text().splitlines()
    assert any(line.startswith("| floor | solari_vk / Cycles | ") for line in lines)
    assert "In 1 of 2 scenes solari_vk is the nearest to Cycles, but not in bad." in " ".join(lines)
    [row] = [line[:-2].split(" | ")[1:] for line in lines if line.startswith("| floor | 0") and "±" in line]
    apart = [pairs[pair]["relative_mse"] for pair in ((OURS, "cycles"), ("cycles", "mitsuba"))]
    assert [float(cell) for cell in row[:2]] == pytest.approx(apart, rel=0.1)
    assert [float(cell) >= 0 for cell in row[3:]] == [True] * 3  # the seconds to equal error
    assert max(map(len, lines)) <= 160


@pytest.mark.parametrize(
    ("loading", "rendering", "limit", "said"),
    [
        ("os.abort()", "pass", 20, "crashed with SIGABRT, while it loads the scene"),
        ("raise ValueError('KHR_texture_basisu')", "pass", 20, "ValueError: KHR_texture_basisu, while it loads"),
        ("time.sleep(60)", "pass", 3, "stopped after 3 s, while it loads the scene"),
        ("pass", "print('dying', flush=True); os._exit(3)", 20, "ended with exit code 3, at 128 samples; its last"),
        ("pass", "time.sleep(60)", 3, "stopped after 3 s, at 128 samples"),
        ("pass", "return np.full((16, 24, 3), np.nan)", 20, "its picture has values that aren't finite"),
        ("pass", "if samples < 100: os.abort()", 20, "crashed with SIGABRT, at 1 sample"),
    ],
)
def test_failures_of_a_renderer_are_lines_of_the_page(fakes, tmp_path, loading, rendering, limit, said):
    found = fakes(loading, rendering, limit=limit, goals=[Goal(0.01)] if "<" in rendering else ())["scenes"]["floor"]
    assert found["failures"]["cycles"].startswith(said)
    assert f"Cycles: {html.escape(said)}" in (tmp_path / "page/index.html").read_text()
    assert found["renderers"].keys() == {OURS, "mitsuba"} | ({"cycles"} if "<" in rendering else set())
    assert (OURS, "mitsuba") in {tuple(row["pair"]) for row in found["distances"]}
    if "dying" in rendering:
        assert "last words: dying" in found["failures"]["cycles"]
        assert "dying" in (tmp_path / "page/floor/cycles.log").read_text()


def test_a_renderer_that_is_missing_is_left_out_with_the_command(fakes, tmp_path, monkeypatch):
    monkeypatch.setitem(process.KINDS, "cycles", Kind("Cycles", "in_cycles", "no_such_package"))
    found = fakes()
    assert found["left out"]["cycles"].endswith("-m pip install no_such_package`")
    assert found["scenes"]["floor"]["renderers"].keys() == {OURS, "mitsuba"}
    assert "Cycles is left out: not installed" in (tmp_path / "page/index.html").read_text()
    assert "there is no Python" in KINDS["mitsuba"].missing(str(tmp_path / "python"))


def test_wrong_options_are_errors(tmp_path):
    assert pythons_of(("cycles=a/python",), "b")["cycles"] == "a/python"
    assert pythons_of((), "b") == {"cycles": "b", "mitsuba": "b", "luxcore": "b", OURS: sys.executable}
    for text, said in (("cycles", "give a renderer and its Python"), ("arnold=x", "there is no renderer")):
        with pytest.raises(SolariError, match=said):
            pythons_of((text,), "b")
    with pytest.raises(SolariError, match="there is no renderer 'arnold'"):
        run(iter(()), ("arnold",), Plan(1, (), 1), Conditions(SIZE), {}, tmp_path)
    for name in ("builtin:cornell_box", "9" * 5000):
        with pytest.raises(SolariError, match=f"^{name[:3]}.*: there is no such file"):
            TrialJob(files=(Path(name),), output=tmp_path).check()


def test_scenes_have_names_of_their_own_and_no_floor(tmp_path):
    (tmp_path / "other").mkdir()
    (tmp_path / "bad.glb").write_bytes(b"glTF")
    files = floor(tmp_path / "floor.glb"), floor(tmp_path / "other/floor.glb"), tmp_path / "bad.glb"
    first, second, (name, error) = _scenes(TrialJob(files=files, output=tmp_path, size=SIZE))
    assert (first.name, second.name, name) == ("floor", "floor-2", "bad")
    assert "bad.glb" in str(error)
    assert len(first.scene.instances) == 1
    assert first.scene.environment is not None  # the studio's


# ---- what is measured -------------------------------------------------------------------------------


def test_noise_cancels_out_of_distances():
    rng = np.random.default_rng(1)
    noisy = [Result([Render(1 + 0.2 * rng.standard_normal((200, 200, 3)), 1, 1) for _ in range(2)], 0) for _ in "ab"]
    far = distance(*noisy, 1.0)
    assert abs(far.relative_mse) < 1e-3  # with the noise it would be 0.04
    assert noisy[0].noise == pytest.approx(0.02, rel=0.1)
    assert abs(noisy[0].error(np.ones((200, 200, 3)))) < 0.005
    assert far.ratio == pytest.approx((1, 1, 1), abs=5 * far.ratio_error)
    assert far.ratio_error == pytest.approx(0.2 / 200, rel=0.1)  # two pictures of two halves of 200 x 200 pixels


def test_distances_are_computed_once_however_often_the_page_is_written(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(trial_compare, "distance", lambda a, b, exposure: seen.append(1) or distance(a, b, exposure))
    page = Page(tmp_path, {}, {})
    for name in "xyz":
        halves = [Render(np.full((2, 2, 3), value), 1.0, 1.0) for value in (1.0, 2.0)]
        page.add(name, Comparison({OURS: Result(halves, 0), "cycles": Result(halves, 0)}), ())
        page.markdown()
    assert len(seen) == 3


def test_error_maps_are_red_where_the_first_is_brighter():
    bright, dark = np.full((1, 1, 3), 2.0), np.full((1, 1, 3), 1.0)
    assert error_map(bright, dark).tolist() == [[[255, 0, 0]]]
    assert error_map(dark, bright).tolist() == [[[0, 0, 255]]]
    assert error_map(dark, dark).tolist() == [[[255, 255, 255]]]


# ---- what the renderers are given -------------------------------------------------------------------


def translated(material, folder):
    return translation.translated(material, translation._Textures(folder))


def test_materials_in_mitsubas_words(tmp_path):
    matte = translated(sv.Material(base_color=0.3, specular=0), tmp_path)
    assert matte == {"type": "diffuse", "parameters": {"reflectance": pytest.approx([0.3] * 3)}}
    layered = translated(sv.Material(ior=1.7, roughness=0.4, metallic=0.2), tmp_path)["parameters"]
    assert (layered["eta"], layered["roughness"], layered["metallic"]) == pytest.approx((1.7, 0.4, 0.2))
    for kind, given in (
        ("thindielectric", {}),
        ("dielectric", {"solid": True, "roughness": 0}),
        ("roughdielectric", {"solid": True}),
    ):
        assert translated(sv.Material(transmission=1, ior=1.3, **given), tmp_path)["type"] == kind
    assert translated(sv.Material(transmission=0.5), tmp_path)["parameters"]["spec_trans"] == 0.5
    cut = {"alpha_mode": "mask", "alpha": 0.4}
    assert translated(sv.Material(**cut), tmp_path)["opacity"] == 0
    assert translated(sv.Material(**cut, alpha_cutoff=0.3), tmp_path)["opacity"] == 1
    assert translated(sv.Material(emissive=(1, 2, 3)), tmp_path)["radiance"] == [1, 2, 3]


def test_textures_are_linear_and_multiplied(tmp_path):
    texture = sv.Texture(np.array([[[188, 255, 0, 51]]], np.uint8), wrap_u="clamp_to_edge", magnification="nearest")
    material = sv.Material(
        base_color=0.5,
        specular=0,
        base_color_texture=texture,
        alpha_mode="blend",
        alpha=0.5,
        normal_texture=np.array([[[255, 128, 128]]], np.uint8),
        normal_scale=0.5,
    )
    made = translated(material, tmp_path)
    color = made["parameters"]["reflectance"]
    assert (color["wrap"], color["filter"]) == ("clamp", "nearest")
    assert np.load(tmp_path / color["file"])[0, 0] == pytest.approx([0.2514, 0.5, 0], abs=1e-3)
    assert np.load(tmp_path / made["opacity"]["file"])[0, 0] == pytest.approx(0.1)
    assert np.load(tmp_path / made["normal"]["file"])[0, 0] == pytest.approx([1, 0.504, 0.5], abs=6e-3)


def test_meshes_are_in_the_world_with_the_uvs_of_their_texture():
    texture = sv.Texture(np.zeros((1, 1, 3), np.uint8), uv_transform=[[2, 0, 0.5], [0, 3, 0]])
    mesh = sv.Mesh(np.eye(3), normals=np.eye(3), uvs=[[0, 0], [1, 0], [0, 1]])
    mirrored = sv.Instance(mesh, sv.Material(base_color_texture=texture), np.diag((-2.0, 1, 1, 1)))
    found = translation.arrays(mirrored)
    assert found["positions"].tolist() == [[-2, 0, 0], [0, 1, 0], [0, 0, 1]]
    assert found["triangles"].tolist() == [[2, 1, 0]]
    assert found["normals"].tolist() == [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]
    assert found["uvs"].tolist() == [[0.5, 0], [2.5, 0], [0.5, 3]]


def test_double_sided_lamps_have_triangles_for_each_side(tmp_path):
    lamp = sv.Instance(sv.Mesh(np.eye(3)), sv.Material(emissive=(1, 1, 1), double_sided=True))
    translation.write(sv.Scene(lamp), tmp_path)
    both = np.load(tmp_path / "mesh0.npz")
    assert both["triangles"].tolist() == [[0, 1, 2], [5, 4, 3]]
    behind = both["positions"][:3] - both["positions"][3:]
    assert behind == pytest.approx(np.full((3, 3), 1e-4 / np.sqrt(3)), rel=1e-2)


def test_cameras_with_a_lens_are_refused(tmp_path):
    scene = sv.load(floor(tmp_path / "floor.glb"))
    for camera in (sv.Camera(aperture=0.1), sv.Camera(principal_point=(0.6, 0.5))):
        with pytest.raises(SolariError, match=r"floor\.glb: the trial has perspective and orthographic cameras"):
            scene_files.write(TrialScene("floor", tmp_path / "floor.glb", scene, camera), Conditions(SIZE), tmp_path)


def test_differences_name_those_that_apply():
    plain = sv.Scene(sv.Instance(sv.Mesh(np.eye(3)), sv.Material(specular=0)))
    assert that_apply(plain) == []
    glass = sv.Material(transmission=1, solid=True, attenuation_color=0.5, sheen_color=1, unlit=False)
    plain.instances[0].material = glass
    plain.add(sv.SpotLight((0, 1, 0), direction=(0, -1, 0), range=2.0))
    assert {(d.renderer, d.what) for d in that_apply(plain)} == {
        ("cycles", "colored glass"),
        ("cycles", "sheen"),
        ("mitsuba", "rough glass"),
        ("mitsuba", "attenuation"),
        ("mitsuba", "sheen"),
        ("mitsuba", "spotlights"),
        ("luxcore", "rough glass"),
        ("luxcore", "attenuation"),
        ("luxcore", "sheen"),
        ("luxcore", "spotlights"),
        ("all", "range of lights"),
    }
    textured = sv.Material(metallic=1, metallic_roughness_texture=np.zeros((1, 1, 3), np.uint8))
    plain.instances[0].material = textured  # not a metal everywhere
    assert ("cycles", "layering") in {(d.renderer, d.what) for d in that_apply(plain)}
    assert all(difference.renderer in {*KINDS, "all"} for difference in DIFFERENCES)


@pytest.mark.parametrize(("parts", "named"), [((1, 1), False), ((-1, -1), False), ((1, -1), True), ((1, 0), False)])
def test_parts_that_face_inwards_are_named(parts, named):
    """Of boxes that face outwards (1), inwards (-1), and inwards without one face (0)."""
    box = sv.shapes.box()
    ways = {1: box.triangles, -1: box.triangles[:, ::-1], 0: box.triangles[2:, ::-1]}
    triangles = [ways[way] + number * len(box.positions) for number, way in enumerate(parts)]
    mesh = sv.Mesh(np.concatenate([box.positions, box.positions + 3]), np.concatenate(triangles))
    for double_sided in (False, True):
        found = that_apply(sv.Scene(sv.Instance(mesh, sv.Material(specular=0, double_sided=double_sided))))
        assert ("back sides" in {d.what for d in found}) == (named and not double_sided)


def in_cycles(monkeypatch):
    """What in_cycles.py defines."""
    for name in ("bpy", "mathutils"):
        monkeypatch.setitem(sys.modules, name, MagicMock())
    return runpy.run_path(str(process.CHILD.with_name("in_cycles.py")))


def test_outputs_without_a_surface_have_no_backs_to_hide(monkeypatch):
    outputs = [
        MagicMock(type="OUTPUT_MATERIAL", inputs={"Surface": Mock(links=links, is_linked=bool(links))})
        for links in ([], [Mock()])
    ]
    material = MagicMock()
    material.node_tree.nodes.__iter__.side_effect = lambda: iter([Mock(type="BSDF_TRANSPARENT"), *outputs])
    in_cycles(monkeypatch)["_hide_backs"](material)
    ends = [call.args[1] for call in material.node_tree.links.new.call_args_list]
    assert [output.inputs["Surface"] in ends for output in outputs] == [False, True]


@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_cycles_is_given_files_without_clips(tmp_path, monkeypatch, suffix):
    """Of which Blender would show the first frame of the first one."""
    still = in_cycles(monkeypatch)["still"]
    scene = sv.Scene(sv.Instance(sv.shapes.box(), name="box"))
    rig = Rig([-1], [np.eye(4)], [[0, 0, 0]], [[0, 0, 0, 1]], [[1, 1, 1]])
    (tmp_path / "a b").mkdir()
    path = tmp_path / "a b" / f"scene.{suffix}"
    scene.save(path)
    assert still(path, tmp_path) == path
    rig.attach(scene.instances[0], 0)
    scene.animations.add(Animation(rig, [Channel(0, "translation", [0, 1], [[0, 0, 0], [0, 2, 0]])], name="lift"))
    scene.save(path)
    made = still(path, tmp_path)
    if suffix == "glb":
        assert (len(sv.load(path).animations), len(sv.load(made).animations)) == (1, 0)
    else:
        content = json.loads(made.read_text())
        assert "animations" not in content
        assert Path(unquote(content["buffers"][0]["uri"])) == path.with_suffix(".bin").resolve()


def test_cycles_is_given_no_occlusion(tmp_path, monkeypatch):
    """Blender reads an image of occlusion as data, also where it is the base color too."""
    path, shared = tmp_path / "a.gltf", {"index": 0}
    colored = {"pbrMetallicRoughness": {"baseColorTexture": shared}}
    path.write_text(json.dumps({"materials": [{**colored, "occlusionTexture": shared}, {}]}))
    assert json.loads(in_cycles(monkeypatch)["still"](path, tmp_path).read_text())["materials"] == [colored, {}]


def test_cycles_is_given_gltfs_default_material(tmp_path, monkeypatch):
    path, primitives = tmp_path / "a.gltf", [{"attributes": {}}, {"attributes": {}, "material": 0}, {"attributes": {}}]
    path.write_text(json.dumps({"meshes": [{"primitives": primitives}], "materials": [{"name": "given"}]}))
    content = json.loads(in_cycles(monkeypatch)["still"](path, tmp_path).read_text())
    assert [primitive["material"] for primitive in content["meshes"][0]["primitives"]] == [1, 0, 1]
    assert content["materials"] == [{"name": "given"}, {}]


def test_the_reference_has_all_differences():
    guide = (Path(__file__).parents[2] / "docs/reference/trial.md").read_text()
    rows = {tuple(cell.strip() for cell in line.strip("|").split("|")) for line in guide.splitlines() if "|" in line}
    titles = {name: kind.title for name, kind in KINDS.items()} | {"all": "all"}
    assert {(titles[d.renderer], d.what, d.why) for d in DIFFERENCES} <= rows


# ---- real renderers ---------------------------------------------------------------------------------


@pytest.fixture(params=["cycles", "mitsuba", "luxcore"])
def renderer(request, tmp_path):
    """Renders by a renderer that is installed: renderer(scene, camera, samples), the picture."""
    why = KINDS[request.param].missing(PYTHON)
    if why:
        pytest.skip(f"{request.param}: {why}")
    file = floor(tmp_path / "floor.glb")

    def render(scene, camera, samples=4):
        scene_files.write(TrialScene("floor", file, scene, camera), Conditions(SIZE), tmp_path)
        process = Process(request.param, tmp_path, 120, PYTHON)
        try:
            return process.render(samples, 1).picture
        finally:
            process.close()

    render.file, render.name = file, request.param
    return render


@pytest.mark.parametrize(
    "turn",
    [pytest.param(0.0, id="as it is", marks=pytest.mark.slow), pytest.param(rotation((1, 2, 3), 1.1), id="turned")],
)
def test_environments_have_our_directions(renderer, turn):
    """Three bright texels, each before a camera that looks there."""
    texels, toward = np.zeros((8, 16, 3), np.float32), directions(8, 16)
    places = [(2, 3), (5, 9), (3, 13)]
    for channel, place in enumerate(places):
        texels[place][channel] = 3
    scene = sv.load(renderer.file)
    scene.environment = sv.Environment(texels, rotation=turn, intensity=2.0)
    for channel, place in enumerate(places):
        look = 5000 * (scene.environment.rotation @ toward[place])  # from afar the floor is small
        seen = renderer(scene, sv.Camera.look_at(look, 2 * look, vertical_fov=0.02)).mean(axis=(0, 1))
        assert seen == pytest.approx(6 * np.eye(3)[channel], abs=0.3)


def test_pictures_lie_where_ours_do(renderer):
    """The middle of a floor, which is darker than what surrounds it, seen from above."""
    scene = sv.load(renderer.file)
    scene.environment = sv.Environment(1.0)
    above = sv.Camera.look_at((0.3, 10, 0.5), (0.3, 0, 0.5), up=(0, 0, -1), vertical_fov=0.7)
    seen = 1 - renderer(scene, above, 64)[..., 0]
    rows, columns = np.mgrid[:16, :24] + 0.5
    middle = [(seen * places).sum() / seen.sum() for places in (rows, columns)]
    pixels_of_meter = 16 / (20 * np.tan(0.35))
    assert middle == pytest.approx([8 - 0.5 * pixels_of_meter, 12 - 0.3 * pixels_of_meter], abs=0.1)


@pytest.mark.parametrize(
    ("light", "illuminance"),
    [
        (sv.PointLight((0, 2, 0), intensity=20, color=(1, 0.5, 0.25)), 5),
        (sv.PointLight((0, 2, 0), intensity=20, color=(1, 0.5, 0.25), radius=0.2), 5),
        (sv.SpotLight((0, 2, 0), direction=(0, -1, 0), intensity=20, color=(1, 0.5, 0.25), inner_cone_angle=0.3), 5),
        (sv.DirectionalLight((0, -1, 1), illuminance=5 * 2**0.5, color=(1, 0.5, 0.25), angular_diameter=1e-3), 5),
    ],
    ids=["point", "sphere", "spot", "sun"],
)
def test_lights_have_our_units(renderer, light, illuminance):
    """Below a lamp a floor with an albedo of 0.5 has the radiance 0.5 E / pi."""
    scene = sv.load(renderer.file)
    scene.add(light)
    seen = renderer(scene, sv.Camera.look_at((0, 1, 1), (0, 0, 0), vertical_fov=0.02), samples=16).mean(axis=(0, 1))
    assert seen == pytest.approx(0.5 * illuminance / np.pi * light.color, rel=0.01)


@pytest.mark.parametrize("both", [False, True])
def test_lamps_shine_on_their_sides(renderer, both):
    """A panel of radiance 1, seen from above, where it shines, and from below, in no other light."""
    writer, shining = GltfWriter(), {"emissiveFactor": [1, 1, 1], "doubleSided": both}
    quad(writer, [[-1, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1]], (0, 0, 0), **shining)
    scene = sv.load(writer.save(renderer.file))
    for height in (1, -1):
        seen = renderer(scene, sv.Camera.look_at((0, height, 0), (0, 0, 0), up=(0, 0, 1), vertical_fov=0.2))
        assert seen == pytest.approx(1.0 if both else max(height, 0), rel=1e-3)


def test_cycles_has_what_gltf_says(renderer):
    """Where Blender's importer differs: the curve of a spotlight, unlit surfaces, absorption, and the middle between a
    black and a white texel."""
    if renderer.name != "cycles":
        pytest.skip("the importer is Blender's")
    scene, angle = sv.load(renderer.file), 0.4
    scene.add(sv.SpotLight((0, 2, 0), direction=(0, -1, 0), intensity=20, inner_cone_angle=0.1, outer_cone_angle=0.6))
    outer, inner = math.cos(0.6), math.cos(0.1)
    expected = 0.5 / np.pi * 5 * math.cos(angle) ** 3 * ((math.cos(angle) - outer) / (inner - outer)) ** 2
    at = np.array((2 * math.tan(angle), 0, 0))
    seen = renderer(scene, sv.Camera.look_at(at + np.array((0, 1, 1)), at, vertical_fov=0.02), 16)
    assert seen.mean() == pytest.approx(expected, rel=0.01)

    pixels = np.zeros((2, 2, 3), np.uint8)
    pixels[:, 1] = 255
    square, black = sv.shapes.quad((0, 0, 0), (1, 0, 0), (0, 0, -1)), {"base_color": 0, "specular": 0}
    clear = sv.Material(base_color=1, transmission=1, solid=True, roughness=0, ior=1, attenuation_color=0.3)
    clear.attenuation_distance = 2
    for mesh, material, radiance in (
        (square, sv.Material(base_color=0.5, unlit=True), 0.5 * 1.2),
        (square, sv.Material(**black, emissive=1, emissive_texture=pixels), 0.5),
        (sv.shapes.box((-1, -1, -1), (1, 0, 1)), clear, 0.3**0.5),
    ):
        sv.Scene(sv.Instance(mesh, material)).save(renderer.file)
        scene = sv.load(renderer.file)
        scene.environment = sv.Environment(1.0)
        seen = renderer(scene, sv.Camera.look_at((0, 1, 0), (0, 0, 0), up=(0, 0, -1), vertical_fov=0.02), 64)
        assert seen.mean() == pytest.approx(radiance, rel=0.02)


def test_dielectrics_reflect_by_fresnel_or_schlick(renderer):
    """A smooth black floor in uniform light at 55 degrees, where both differ most: see differences.py."""
    writer, angle = GltfWriter(), math.radians(55)
    base = {"baseColorFactor": [0, 0, 0, 1], "metallicFactor": 0, "roughnessFactor": 0}
    black = writer.add("materials", pbrMetallicRoughness=base)
    corners, uvs = [[-2, 0, 2], [2, 0, 2], [2, 0, -2], [-2, 0, -2]], [[0, 1], [1, 1], [1, 0], [0, 0]]
    writer.node(mesh=writer.mesh({"POSITION": corners, "TEXCOORD_0": uvs}, [0, 1, 2, 0, 2, 3], material=black))
    scene = sv.load(writer.save(renderer.file))
    scene.environment = sv.Environment(1.0)
    seen = renderer(scene, sv.Camera.look_at((0, math.cos(angle), math.sin(angle)), (0, 0, 0), vertical_fov=0.02), 64)
    assert seen.mean() == pytest.approx(0.0535 if renderer.name == "luxcore" else 0.0697, rel=0.02)


def test_mitsuba_takes_every_kind_of_material(renderer):
    """Cycles takes them from the file."""
    pixels = np.full((2, 2, 4), 128, np.uint8)
    kinds = [
        {"transmission": 1},
        {"transmission": 1, "solid": True},
        {"transmission": 1, "solid": True, "roughness": 0},
        {"transmission": 0.5, "transmission_texture": pixels},
        {"clearcoat": 1, "clearcoat_roughness": 0.2},
        {"alpha_mode": "mask", "base_color_texture": pixels},
        {"alpha_mode": "blend", "alpha": 0.5},
        {"emissive": 3, "emissive_texture": pixels},
        {"normal_texture": pixels, "metallic_roughness_texture": pixels},
        {"unlit": True},
        {"specular": 0, "base_color_texture": pixels},
        {"ior": 1.0},
        {"metallic": 1, "roughness": 0},
    ]
    scene, camera = sv.load(renderer.file), sv.Camera.look_at((0, 3, 3), (0, 0, 0))
    mesh = sv.Mesh(np.eye(3), normals=np.eye(3), uvs=np.eye(3)[:, :2], colors=np.eye(3))
    for index, fields in enumerate(kinds):
        scene.add(mesh, sv.Material(**fields), np.array((index / 5 - 1, 0, 0)))
    scene.environment = sv.Environment(1.0)
    assert renderer(scene, camera).mean() > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("orthographic_height", [0, 2.2])
def test_a_diffuse_box_is_the_same_in_all_renderers(tmp_path, any_device, orthographic_height):
    others = [name for name in KINDS if name != OURS and not KINDS[name].missing(PYTHON)]
    if not others:
        pytest.skip("no other renderer is installed")
    file = diffuse_box(tmp_path / "box.glb")
    scene = sv.load(file)
    scene.cameras[0].update(orthographic_height=orthographic_height)
    run(
        iter([TrialScene("box", file, scene, scene.cameras[0])]),
        others,
        Plan(512, (), 600),
        Conditions((96, 96)),
        pythons_of((), PYTHON),
        tmp_path / "page",
    )
    found = json.loads((tmp_path / "page/trial.json").read_text())["scenes"]["box"]
    assert not found["failures"]
    assert {tuple(row["pair"]) for row in found["distances"]} >= {(OURS, name) for name in others}
    for row in found["distances"]:
        assert row["ratio"] == pytest.approx([1, 1, 1], abs=0.005), row
        assert row["relative_mse"] < 1e-3, row
