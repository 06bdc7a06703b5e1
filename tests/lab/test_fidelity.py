"""`solari-vk fidelity`: the generator's scenarios, its cameras, tone mapping and backgrounds."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image
from support.files import GltfWriter

from solari_vk.base.color import decode_srgb
from solari_vk.base.errors import SolariError
from solari_vk.cli import main
from solari_vk.lab.measure import fidelity
from solari_vk.output.transparency import backdrop
from solari_vk.scene.lights.environment import Environment

RED = (255, 0, 0)
GREEN = (0, 255, 0)
BLUE = (0, 0, 255)
YELLOW = (255, 255, 0)


@pytest.fixture
def folder(tmp_path):
    """As the generator's: an unlit white square from x = 0 on, and an environment with a color for each side."""
    writer = GltfWriter()
    writer.json["extensionsUsed"] = ["KHR_materials_unlit"]
    white = writer.add("materials", extensions={"KHR_materials_unlit": {}}, doubleSided=True)
    corners = [[0, -9, 0], [9, -9, 0], [9, 9, 0], [0, 9, 0]]
    writer.node(mesh=writer.mesh({"POSITION": corners}, [0, 1, 2, 0, 2, 3], material=white))
    (tmp_path / "models").mkdir()
    writer.save(tmp_path / "models/square.glb")
    sides = {"-x": RED, "-z": GREEN, "+x": BLUE, "+z": YELLOW}
    columns = [sides[side] for side in ("-x", "-z", "-z", "+x", "+x", "+z", "+z", "-x")]
    (tmp_path / "environments").mkdir()
    Image.fromarray(np.array([columns] * 4, np.uint8)).save(tmp_path / "environments/lightroom_14b.png")
    (tmp_path / "test").mkdir()
    return tmp_path


def scenario(name="front", **given):
    return {
        "name": name,
        "model": "../../../models/square.glb",
        "lighting": "../../../environments/lightroom_14b.png",
        **given,
    }


def config(folder, *scenarios):
    path = folder / "test/config.json"
    path.write_text(json.dumps({"renderers": [{"name": "three"}], "scenarios": scenarios}), encoding="utf-8")
    return str(path)


def test_a_config_is_read_with_its_defaults(folder):
    given = scenario("side", target={"y": 1.5}, orbit={"theta": 30}, dimensions={"height": 400}, exclude=["solari-vk"])
    (front, side), output = fidelity.read_scenarios(config(folder, scenario(), given))
    assert output is None
    assert front.file("model") == folder / "models/square.glb"
    assert front.file("lighting") == folder / "environments/lightroom_14b.png"
    assert (front.size, front.target, front.radius, front.vertical_fov) == ((768, 768), (0, 0, 0), 1, 45)
    assert (front.theta, front.phi, front.skybox, front.excludes_us) == (0, 90, False, False)
    assert (side.size, side.target, side.theta, side.excludes_us) == ((768, 400), (0, 1.5, 0), 30, True)


def test_what_the_generator_gives_to_renderers_is_read(folder, monkeypatch):
    monkeypatch.chdir(folder)
    text = json.dumps({"scenario": scenario(), "outputFile": "test/goldens/a.png"})
    (found,), output = fidelity.read_scenarios(text)
    assert found.file("model").resolve() == folder / "models/square.glb"
    assert output.as_posix() == "test/goldens/a.png"


@pytest.mark.parametrize(
    ("orbit", "place"),
    [
        ({"theta": 0, "phi": 90, "radius": 2}, (0, 0, 2)),
        ({"theta": 90, "phi": 90, "radius": 2}, (2, 0, 0)),
        ({"theta": -90, "phi": 60, "radius": 2}, (-(3**0.5), 1, 0)),
        ({"theta": 0, "phi": 0, "radius": 2}, (0, 2, 0)),
        ({"theta": 90, "phi": 90, "radius": 0}, (0, 0, 0)),
    ],
)
def test_cameras_orbit(folder, orbit, place):
    target = np.array((1.0, 2, 3))
    given = scenario(target=dict(zip("xyz", target, strict=True)), orbit=orbit, verticalFoV=30)
    camera = fidelity.read_scenarios(config(folder, given))[0][0].camera(extent=0.5)
    assert camera.position == pytest.approx(target + place)
    theta, phi = np.radians((orbit["theta"], orbit["phi"]))
    outward = np.array((np.sin(phi) * np.sin(theta), np.cos(phi), np.sin(phi) * np.cos(theta)))
    assert camera.transform[:3, 2] == pytest.approx(outward)
    assert camera.transform[1, 1] == pytest.approx(np.sin(phi)), "up is as far up as it can be"
    assert (camera.fov, camera.exposure) == pytest.approx((30, 1))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"orbit": {"radius": "far"}}, "scenario 'front': 'orbit': 'radius' must be a number from -1e[+]06 to"),
        ({"orbit": {"radius": -1}}, "scenario 'front': 'orbit' has a radius of -1.0: give one of at least 0"),
        ({"orbit": {"zoom": 1}}, "'orbit' must be an object of theta, phi, radius"),
        ({"dimensions": {"width": 0}}, "'dimensions': 'width' must be a number from 1"),
        ({"renderSkybox": 1}, "'renderSkybox' must be of the type bool, not 1"),
        ({"verticalFov": 30}, "scenario 'front': there is no key 'verticalFov'.*verticalFoV"),
        ({"clearColor": {"a": 1}}, "'clearColor': 'a' must be a number from 0 to 0"),
        ({"model": 3}, "'model' must be the path of a file, not 3"),
        ({"lighting": 3}, "'lighting' must be of the type str, not 3"),
        ({"name": "../x"}, "scenario 0: 'name' must be a name that a file can have"),
    ],
)
def test_errors_name_file_scenario_and_key(folder, changed, said):
    with pytest.raises(SolariError, match=said) as raised:
        fidelity.read_scenarios(config(folder, {**scenario(), **changed}))
    assert "config.json: scenario" in str(raised.value)


def test_files_of_another_kind_are_errors(folder, capsys):
    for text, said in (("{", "not JSON"), ('{"scenarios": []}', "must be a list"), ('{"outputFile": 3}', "'name'")):
        with pytest.raises(SolariError, match=said):
            fidelity.read_scenarios(text)
    two = config(folder, scenario(), scenario())
    with pytest.raises(SolariError, match="another has the same 'name'"):
        fidelity.read_scenarios(two)
    two = config(folder, scenario(), scenario("back", model="no.glb"))
    for given, said in (
        ((), "-o: give"),
        (("-o", "a.png"), "2 scenarios: give a folder"),
        (("-o", "a.png", "--scenario", "bock"), "no scenario 'bock'"),
    ):
        assert main(["fidelity", two, *given]) == 2
        assert said in capsys.readouterr().err


def test_a_missing_model_costs_its_picture_alone(any_device, folder, capsys):
    small = {"dimensions": {"width": 3, "height": 3}}
    both = config(folder, scenario("gone", model="no.glb"), scenario(**small))
    options = ["--samples", "1", "--no-denoise", "-o"]
    assert main(["fidelity", both, *options, str(folder / "out")]) == 2
    said = capsys.readouterr().err
    assert "config.json: scenario 'gone': 'model': there is no file" in said
    assert "1 of 2 scenarios have no picture: gone" in said
    assert [path.name for path in (folder / "out").iterdir()] == ["front.png"]
    assert main(["fidelity", both, *options, str(folder / "one.png"), "--scenario", "front"]) == 0


def test_tone_mapping():
    """Hill's fit of a gray as computed by hand, whose matrices keep grays; Khronos' neutral curve by its definition."""
    gray = np.full(3, 0.18, np.float32)
    assert fidelity.aces(gray) == pytest.approx([0.21310] * 3, abs=2e-4)
    assert fidelity.aces(np.array((4.0, 0, 0), np.float32))[1] > 0.2, "bright red becomes paler"
    assert fidelity.neutral(np.array((0.5, 0.3, 0.2), np.float32)) == pytest.approx([0.46, 0.26, 0.16])
    assert fidelity.neutral(np.full(3, 0.04, np.float32)) == pytest.approx([0.01] * 3)
    top = 1 - 0.24**2 / (1.96 + 0.24 - 0.76)
    assert fidelity.neutral(np.full(3, 2.0, np.float32)) == pytest.approx([top] * 3)
    red = fidelity.neutral(np.array((2.0, 0, 0), np.float32))  # 0 is less than 0.08: nothing is subtracted
    peak = 1 - 0.24**2 / (2 + 0.24 - 0.76)
    assert red == pytest.approx([peak, peak * (1 - 1 / (0.15 * (2 - peak) + 1)), red[1]])


def test_edges_have_the_color_of_surfaces_alone():
    mixed = np.full((1, 1, 3), 0.25 * 0.5 + 0.75 * 8, np.float32)
    found = fidelity.codes(mixed, "none", np.full((1, 1), 0.25, np.float32), 8.0)[0, 0]
    assert decode_srgb(found[:3] / 255) == pytest.approx([0.5] * 3, abs=0.01)
    assert found[3] == 64


def test_what_is_behind_an_edge(folder):
    """A camera that looks from +x sees -x, and more of +z on its left; turned by 90 degrees the environment has -z."""
    camera = fidelity.read_scenarios(config(folder, scenario(orbit={"theta": 90})))[0][0].camera(1)
    texels = np.repeat(np.arange(1.0, 9), 3).reshape(1, 8, 3)
    assert (backdrop(Environment(texels, intensity=2), camera, (2, 1))[0, :, 0] == (16, 2)).all()
    assert (backdrop(Environment(texels, rotation=np.pi / 2), camera, (2, 1))[0, :, 0] == (2, 3)).all()


def test_pictures(any_device, folder, capsys):
    """From +z the square is on the right, before the environment's -z; from -x it is a line, before +x."""
    common = {"dimensions": {"width": 3, "height": 3}, "orbit": {"radius": 2}}
    behind = {**common, "orbit": {"theta": -90, "radius": 2}, "renderSkybox": True}
    given = [
        scenario(**common),
        scenario("sky", **common, renderSkybox=True),
        scenario("side", **behind),
        scenario("not", exclude=["solari-vk"]),
    ]
    options = ["--samples", "4", "--no-denoise", "--tonemap", "none", "-o", str(folder / "out")]
    assert main(["fidelity", config(folder, *given), *options]) == 0
    assert "not: left out" in capsys.readouterr().err
    front, sky, side = (np.asarray(Image.open(folder / f"out/{name}.png")) for name in ("front", "sky", "side"))
    assert sorted(path.name for path in (folder / "out").iterdir()) == ["front.png", "side.png", "sky.png"]
    assert front.shape == (6, 6, 4)
    assert sky.shape == side.shape == (6, 6, 3)
    assert (front[:, :3] == 0).all()
    assert (front[:, 3:] == 255).all()
    assert (sky[:, :3] == GREEN).all()
    assert (sky[:, 3:] == 255).all()
    assert (side == BLUE).all()
