"""Real files load with exactly the expected warnings, and are visible in pictures."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from support.files import ASSETS

import solari_vk as sv
from solari_vk.scene.files.gltf import load_gltf

FILES = sorted([*ASSETS.glob("*/*.glb"), *ASSETS.glob("*/*.gltf")]) if ASSETS.is_dir() else []

pytestmark = pytest.mark.skipif(not FILES, reason="no assets: set SOLARI_VK_ASSETS to a folder that has them")


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_assets_load(path):
    scene = load_gltf(path, strict=True)
    assert scene.instances
    assert np.isfinite(scene.bounds).all()
    assert not scene.warnings


def test_flight_helmet(asset):
    scene = load_gltf(asset("FlightHelmet/FlightHelmet.gltf"))
    assert len(scene.instances) == 6
    materials = {instance.material for instance in scene}
    textures = [m.normal_texture for m in materials] + [m.base_color_texture for m in materials]
    images = {texture.image for texture in textures if texture is not None}
    assert len(images) == 10, "the hose and the wood share theirs"
    for instance in scene:
        mesh = instance.mesh
        assert mesh.tangents is not None
        np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-5)


def test_the_fox_stands_on_its_paws(asset):
    low, high = load_gltf(asset("Fox/Fox.glb")).bounds
    assert abs(low[1]) < 1
    assert high[1] - low[1] == pytest.approx(79, abs=2)


def visible_count(device, scene, camera):
    """The number of instances in a picture, which must show light, shadow and no NaN."""
    with sv.PathTracer(device, scene, (48, 32), max_bounces=2) as renderer:
        radiance = renderer.render(camera, samples=2)["radiance"]
        assert np.isfinite(radiance).all()
        assert (radiance.max(axis=2) > 0).mean() > 0.2
        assert radiance.std() > 0
        return len(np.unique(renderer["instance_id"]))


@pytest.mark.parametrize("name", ["FlightHelmet/FlightHelmet.gltf", "CornellBox/CornellBox.glb"])
def test_assets_are_visible(device, name, asset):
    scene = load_gltf(asset(name))
    direction = (0, 0, -1) if "Cornell" in name else (-0.45, -0.3, -1)
    camera = sv.Camera.framing(scene.bounds, direction, aspect=1.5)
    if not any(instance.material.emits for instance in scene):
        sv.studio_lights(scene, camera=camera)
    assert visible_count(device, scene, camera) >= 5


def test_a_room_of_the_dungeon_kit_is_visible(device, asset):
    kit = asset("kaykit_dungeon")
    file = Path(__file__).parents[2] / "tools" / "dungeon_room.py"
    spec = importlib.util.spec_from_file_location("dungeon_room", file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    room = module.dungeon_room(kit)
    assert not room.warnings
    assert visible_count(device, room, room.camera) > 20
