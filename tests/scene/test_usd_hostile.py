"""Damaged and hostile USD files: one clear SolariError that names the file, the place and the remedy."""

from __future__ import annotations

import os
import random
from importlib import util

import numpy as np
import pytest
from support.files import image_file

import solari_vk as sv
from solari_vk.base.errors import SolariError

pytest.importorskip("pxr")
from pxr import Gf, Sdf, UsdGeom, UsdUtils
from test_usd import loaded, new, polygons
from test_usd_lights import PIXELS, surface, texture

CUBE = 'def Cube "cube" {}\n'


def write(path, text):
    path.parent.mkdir(exist_ok=True)
    path.write_text(f"#usda 1.0\n{text}")
    return path


def test_without_the_library_one_line_says_what_to_install(tmp_path, monkeypatch):
    file = write(tmp_path / "a.usda", CUBE)
    monkeypatch.setattr(util, "find_spec", lambda name, *_: None)
    with pytest.raises(SolariError, match=r"a\.usda: .*pip install 'solari-vk\[usd\]'"):
        sv.load(file)


@pytest.mark.parametrize(("text", "words"), [
    ('def "a" (references = @./missing.usda@) {}', "missing.usda' of </a> is missing"),
    ('def "a" (payload = @./missing.usda@) {}', "missing.usda' of </a> is missing"),
    ("(subLayers = [@./missing.usda@])", "missing.usda"),
    ('def "a" (references = </b>) {}\ndef "b" (references = </a>) {}', "in a circle"),
    ('def "a" (references = @./self.usda@</a>) {}', "in a circle"),
    ('def "a" (references = @../outside/x.usda@) {}', "outside the file's own folder"),
    ('def "a" (references = @/etc/hostname@) {}', "outside the file's own folder"),
    ('def "a" (payload = @./link.usda@</cube>) {}', "outside the file's own folder"),
    ("def Xform {", "can't be read as USD"),
    ("(metersPerUnit = 0)", "meters per unit"),
])  # fmt: skip
def test_layers(tmp_path, text, words):
    write(tmp_path / "outside" / "x.usda", CUBE)
    (tmp_path / "in").mkdir()
    os.symlink(tmp_path / "outside" / "x.usda", tmp_path / "in" / "link.usda")
    file = write(tmp_path / "in" / "self.usda", f"{text}\n{CUBE}")
    with pytest.raises(SolariError) as caught:
        sv.load(file)
    said = str(caught.value)
    assert words in said
    assert str(file) in said
    assert "\n" not in said


def test_expressions_and_variants_lead_nowhere_outside(tmp_path):
    write(tmp_path / "outside" / "x.usda", CUBE)
    text = '(expressionVariables = {string V = "../outside/x.usda"})\ndef "a" (references = @`"${V}"`@</cube>) {}'
    with pytest.raises(SolariError, match="outside the file's own folder"):
        sv.load(write(tmp_path / "in" / "a.usda", text))


def test_repeated_references_are_counted_before_they_are_made(tmp_path):
    """Thirty levels of two references each would be a billion prims."""
    levels = [
        f'def "l{n}" {{\n def "a" (references = </l{n + 1}>) {{}}\n def "b" (references = </l{n + 1}>) {{}}\n}}'
        for n in range(30)
    ]
    file = write(tmp_path / "a.usda", "\n".join([*levels, 'def Cube "l30" {}']))
    with pytest.raises(SolariError, match="prims that its references make"):
        sv.load(file)


def test_instances_count_once_where_usd_shares_them(tmp_path):
    text = "\n".join(f'def "i{n}" (instanceable = true\n references = </p>) {{}}' for n in range(50))
    many = "\n".join(f'def "s{n}" {{}}' for n in range(100))
    sv.load(write(tmp_path / "a.usda", f'{text}\ndef "p" {{\n{CUBE}\n{many}\n}}'), memory=4_000_000)


@pytest.mark.parametrize(("fault", "words"), [
    (lambda mesh: mesh.GetPointsAttr().Set([Gf.Vec3f(float("nan"), 0, 0)] * 4), "aren't finite"),
    (lambda mesh: mesh.GetFaceVertexIndicesAttr().Set([0, 1, 2, 9]), "points that don't exist"),
    (lambda mesh: mesh.GetFaceVertexCountsAttr().Set([7]), "corners"),
    (lambda mesh: mesh.GetFaceVertexCountsAttr().Set([-1, 5]), "corners"),
    (lambda mesh: mesh.AddTranslateOp().Set((float("inf"), 0, 0)), "isn't finite"),
    (lambda mesh: mesh.AddScaleOp().Set((0, 0, 1)), "scale of 0"),
])  # fmt: skip
def test_wrong_data_costs_its_prim_and_is_an_error_where_nothing_is_left(tmp_path, fault, words):
    stage = new(tmp_path / "a.usda")
    fault(polygons(stage, "/wrong"))
    with pytest.raises(SolariError, match=f"a.usda: .*/wrong.*{words}"):
        loaded(stage)
    UsdGeom.Cube.Define(stage, "/right")
    scene = loaded(stage)
    assert [instance.name for instance in scene] == ["right"]
    assert any(words in line for line in scene.warnings)
    with pytest.raises(SolariError, match=words):
        loaded(stage, strict=True)


def test_pictures_outside_the_folder_and_in_packages(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "t.png").write_bytes(image_file(PIXELS))
    os.symlink(tmp_path / "t.png", tmp_path / "in" / "link.png")
    for name in ("../t.png", "./link.png", str(tmp_path / "t.png")):
        found, scene = surface(tmp_path / "in", lambda *two: texture(*two, "diffuseColor", "rgb", file=name))  # noqa: B023
        assert found.base_color_texture is None
        assert any("outside" in line for line in scene.warnings)
    surface(tmp_path, lambda *two: texture(*two, "diffuseColor", "rgb", space="sRGB"))
    assert UsdUtils.CreateNewUsdzPackage(str(tmp_path / "material.usda"), str(tmp_path / "in" / "p.usdz"))
    packed = sv.load(tmp_path / "in" / "p.usdz")
    assert np.array_equal(packed.instances[0].material.base_color_texture.image.pixels[..., :3], PIXELS[..., :3])
    assert packed.warnings == []


def test_instancers_that_hold_themselves(tmp_path):
    stage = new(tmp_path / "a.usda")
    points = UsdGeom.PointInstancer.Define(stage, "/points")
    points.GetPrototypesRel().SetTargets(["/points"])
    points.GetProtoIndicesAttr().Set([0])
    points.GetPositionsAttr().Set([(0, 0, 0)])
    with pytest.raises(SolariError, match="repeats itself"):
        loaded(stage)
    points.GetPrototypesRel().SetTargets(["/nowhere"])
    with pytest.raises(SolariError, match="isn't there"):
        loaded(stage)


@pytest.mark.parametrize("ending", ["usda", "usdc"])
def test_damaged_files_are_refused(tmp_path, ending):
    """Files that are cut off, and texts with changed bytes, end in an error of ours or in a scene."""
    stage = new(tmp_path / "a.usda")
    polygons(stage, "/mesh")
    stage.GetRootLayer().Export(str(tmp_path / f"good.{ending}"))
    whole = (tmp_path / f"good.{ending}").read_bytes()
    rng = random.Random(7)
    said = []
    for number in range(40):
        data = bytearray(whole)
        if ending == "usdc" or number % 2:
            del data[rng.randrange(1, len(whole)) :]
        else:
            data[rng.randrange(len(data))] = rng.randrange(256)
        file = tmp_path / f"bad{number}.{ending}"
        file.write_bytes(data)
        try:
            sv.load(file)
        except SolariError as error:
            said.append(str(error).replace(str(file), "FILE", 1))
    assert len(said) > 15
    assert all(line.startswith("FILE") and "\n" not in line for line in said)


def test_budget(tmp_path):
    stage = new(tmp_path / "a.usda")
    polygons(stage, "/mesh")
    points = UsdGeom.PointInstancer.Define(stage, "/points")
    UsdGeom.Cube.Define(stage, "/points/c")
    points.GetPrototypesRel().SetTargets(["/points/c"])
    points.GetProtoIndicesAttr().Set([0] * 5000)
    points.GetPositionsAttr().Set([(0, 0, 0)] * 5000)
    with pytest.raises(SolariError, match="may take"):
        loaded(stage, memory=8_000_000)
    assert Sdf.Layer.Find(str(tmp_path / "a.usda"))
