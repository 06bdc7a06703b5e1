"""Light profiles: files after ANSI/IES LM-63 light surfaces as the intensities in them say."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.frames import WHOLE
from support.gltf_writer import GltfWriter
from support.measured import hold
from support.realtime import Effort, make_renderer, measure_mean, run_pictures, trace
from support.seeded_bugs import Bug, seeded

import solari_vk as sv
from solari_vk.errors import SolariError
from solari_vk.scene.lights.profile import LightProfile
from solari_vk.scene.matrices import rotation

STEP = 2  # degrees between the angles of files
HALF, WHOLE_TURN = np.arange(0, 181, STEP), np.arange(-90, 91, STEP)
# For each symmetry the horizontal angles of files, and the intensity in cd in a direction of the luminaire: towards the
# angle 0 of the horizontal ones, 90, and of the vertical ones.
KINDS = {
    "C, a plane": ("C", HALF, [0], lambda x, y, forward: 500 * (1 + 0.4 * forward + 0.3 * forward**2)),
    "C, a quarter": ("C", HALF, np.arange(0, 91, STEP),
                     lambda x, y, forward: 500 * (1 + 0.4 * forward + 0.5 * x**2 - 0.3 * y**2)),
    "C, a half": ("C", HALF, HALF, lambda x, y, forward: 500 * (1 + 0.3 * forward + 0.4 * x + 0.2 * y**2)),
    "C, the other half": ("C", HALF, np.arange(90, 271, STEP),
                          lambda x, y, forward: 500 * (1 + 0.3 * forward + 0.4 * y + 0.2 * x**2)),
    "C, whole": ("C", HALF, np.arange(0, 361, STEP),
                 lambda x, y, forward: 500 * (1 + 0.3 * forward + 0.3 * x - 0.35 * y)),
    "C, downwards": ("C", np.arange(0, 91, STEP), [0], lambda x, y, forward: 500 * np.maximum(forward, 0)),
    "B": ("B", WHOLE_TURN, WHOLE_TURN, lambda x, y, forward: 500 * np.maximum(forward, 0) * (1 + 0.5 * x + 0.4 * y)),
    "A": ("A", WHOLE_TURN, WHOLE_TURN, lambda x, y, forward: 500 * np.maximum(forward, 0) * (1 + 0.5 * x + 0.4 * y)),
    "B, a quarter": ("B", np.arange(0, 91, STEP), np.arange(0, 91, STEP),
                     lambda x, y, forward: 500 * np.maximum(forward, 0) * (1 + 0.5 * x**2 - 0.4 * y**2)),
}  # fmt: skip


def make_file(kind, factor=2.0):
    """The text of a file with these intensities, its factor for all of them apart."""
    photometry, vertical, horizontal, intensity = KINDS[kind]
    v, h = np.radians(vertical), np.radians(horizontal)[:, None]
    if photometry == "C":
        direction = np.sin(v) * np.cos(h), np.sin(v) * np.sin(h), np.cos(v) + 0 * h
    elif photometry == "B":
        direction = np.cos(h) * np.sin(v), -np.sin(h) + 0 * v, np.cos(h) * np.cos(v)
    else:
        direction = np.sin(v) + 0 * h, -np.cos(v) * np.sin(h), np.cos(v) * np.cos(h)
    values = [vertical, horizontal, *(intensity(*direction) / factor)]
    return "\n".join([
        "IESNA:LM-63-2002", "[TEST] a file", "TILT=NONE",
        f"1 -1 {factor / 0.8} {len(vertical)} {len(horizontal)} {'CBA'.index(photometry) + 1} 2 .1,.1 0", "0.8 1 60",
        *(" ".join(f"{number:.7g}" for number in row) for row in values),
    ])  # fmt: skip


def light_of(tmp_path, kind, **fields):
    (tmp_path / "lamp.ies").write_text(make_file(kind))
    return sv.PointLight((0.2, 1.5, -0.1), ies=tmp_path / "lamp.ies", **fields)


def measured_and_expected(device, kind, light):
    """Illuminances on surfaces around that face the light."""
    rng = np.random.default_rng(3)
    away = rng.normal(size=(200, 3))
    away /= np.linalg.norm(away, axis=1)[:, None]
    distances = rng.uniform(0.5, 3, 200)
    forward = light.direction.astype(np.float64)
    x = light.horizontal - forward * (forward @ light.horizontal)
    x /= np.linalg.norm(x)
    expected = KINDS[kind][3](away @ x, away @ np.cross(x, forward), away @ forward) / distances**2
    found = sv.illuminance(device, sv.Scene(light), light.position + away * distances[:, None], -away, samples=16)
    return found.lux, expected


@pytest.mark.parametrize("kind", KINDS)
def test_illuminance_is_that_of_the_file(device, tmp_path, kind):
    """In a luminaire that is turned. Intensities are linear between the angles: an error of up to 0.0006 of the
    largest."""
    light = light_of(tmp_path, kind, direction=(0.3, -1, 0.2), horizontal=(0.5, 0.1, 1))
    found, expected = measured_and_expected(device, kind, light)
    np.testing.assert_allclose(found, expected, rtol=0.002, atol=0.7)
    np.testing.assert_allclose(light.lumens, 4 * math.pi * mean_intensity(kind), rtol=0.002)


def mean_intensity(kind):
    """Over all directions, by a Fibonacci lattice."""
    number = np.arange(100_000) + 0.5
    forward, angle = 1 - 2 * number / 100_000, math.pi * (1 + 5**0.5) * number
    radius = np.sqrt(1 - forward**2)
    return KINDS[kind][3](radius * np.cos(angle), radius * np.sin(angle), forward).mean()


def test_a_seeded_bug_is_noticed(device, tmp_path):
    """Horizontal angles that turn the other way."""
    bug = Bug("scene/lights/punctual.glsl", "profile_share",
              "light.profile_axes[1] = -light.profile_axes[1]; return correct(light, direction);")  # fmt: skip
    with seeded(bug):
        found, expected = measured_and_expected(device, "C, whole", light_of(tmp_path, "C, whole"))
    assert np.abs(found - expected).max() > 100


@pytest.mark.slow
def test_frames_have_the_path_tracers_light(device, tmp_path):
    """The Cornell box with a luminaire, as a point and as a ball, in place of its lamp."""
    scene, size, effort = sv.builtin("cornell_box"), (24, 24), Effort(4, 16, 12)
    for lamp in [instance for instance in scene if instance.material.emits]:
        scene.remove(lamp)
    light = light_of(tmp_path, "C, a half", lumens=20)
    light.position = (1, 1.7, 1)
    scene.add(light)
    scene.add(sv.PointLight((0.5, 0.7, 1.4), profile=light.profile, intensity=2, radius=0.1, direction=(1, 0, 0),
                            horizontal=(0, 1, 0)))  # fmt: skip
    expected = trace(device, scene, 512, size, max_bounces=64)
    with make_renderer(device, scene, size) as renderer:
        found = run_pictures(renderer, scene.camera, effort, lambda frame: frame["radiance"])
    hold([measure_mean(WHOLE, found, expected, 0.04, effort)])


def test_profiles_change_while_rendering(device, tmp_path):
    light = light_of(tmp_path, "C, whole")
    scene = sv.Scene(light)
    with sv.PathTracer(device, scene, (8, 8), max_bounces=0) as tracer:
        scene.add(sv.shapes.quad((0, 0, 0), (1, 0, 0), (0, 0, -1)), sv.Material())
        scene.camera = sv.Camera.look_at((0, 3, 0), (0, 0, 0), up=(0, 0, -1))
        for change in ({"horizontal": (0, 0, 1)}, {"ies": LightProfile([0, 90], [0], [[9, 1]])}, {"profile": None}):
            light.update(**change)
            changed = tracer.render(samples=8)["radiance"]
            with sv.PathTracer(device, scene, (8, 8), max_bounces=0) as fresh:
                np.testing.assert_array_equal(changed, fresh.render(samples=8)["radiance"])


def test_intensities_and_lumens(tmp_path):
    light = light_of(tmp_path, "C, downwards")
    assert light.intensity == pytest.approx(500)
    assert light.lumens == pytest.approx(500 * math.pi, rel=1e-3)
    light.lumens = 100
    assert light.intensity == pytest.approx(100 / math.pi, rel=1e-3)
    assert light_of(tmp_path, "C, downwards", intensity=7).intensity == 7
    light.update(ies=LightProfile([0, 180], [0], [[3, 3]]))
    assert (light.intensity, light.solid_angle) == (3, pytest.approx(4 * math.pi, rel=1e-3))
    with pytest.raises(SolariError, match="ies makes profile: give one of them"):
        light.update(ies=tmp_path / "lamp.ies", profile=None)
    with pytest.raises(SolariError, match="horizontal must not have the direction"):
        light.update(horizontal=(0, 1, 0))
    with pytest.raises(SolariError, match="ies must be a path or a LightProfile, not int"):
        sv.PointLight((0, 0, 0), ies=3)


# ---- files ------------------------------------------------------------------------------------------


GOOD = make_file("C, a plane")
NUMBERS = "1 -1 1 2 1 1 2 0 0 0\n1 1 60\n0 90\n0\n"
BAD = {
    "not a light profile": "hello",
    "ends early: 2 further numbers are missing": "TILT=NONE\n" + NUMBERS,
    "has words where numbers belong": "TILT=NONE\n" + NUMBERS + "1 bright",
    "vertical angles must rise": "TILT=NONE\n" + NUMBERS.replace("0 90", "90 0") + "1 1",
    "must be a count of at least 1, not 0": "TILT=NONE\n" + NUMBERS.replace("2 1 1", "0 1 1", 1) + "1 1",
    "type C must reach from 0 to 0, 90, 180 or 360": "TILT=NONE\n1 -1 1 1 2 1 2 0 0 0 1 1 60 0 0 70 1 1",
    "candelas must lie between 0 and": "TILT=NONE\n" + NUMBERS + "1 -1",
    "candelas must be finite": "TILT=NONE\n" + NUMBERS + "1 nan",
    "photometry must be A, B or C": "TILT=NONE\n" + NUMBERS.replace("1 2 0 0 0", "7 2 0 0 0") + "1 1",
    "memory": f"TILT=NONE\n1 -1 1 16000000 16000000 1 2 0 0 0 1 1 60{' 0' * 2**22}",
}


@pytest.mark.parametrize("message", BAD)
def test_wrong_files_end_in_one_error_that_names_them(tmp_path, message, monkeypatch):
    monkeypatch.setenv("SOLARI_VK_LOAD_MEMORY", "256 MiB")
    (tmp_path / "bad.ies").write_text(BAD[message])
    with pytest.raises(SolariError, match=f"bad.ies: .*{message}"):
        LightProfile.read(tmp_path / "bad.ies")


def test_tilt_is_passed_over_with_a_warning(tmp_path):
    (tmp_path / "tilt.ies").write_text("TILT=INCLUDE\n1 2\n0 90\n1 .9\n" + NUMBERS + "5 2")
    with pytest.warns(UserWarning, match="tilt.ies: .*TILT"):
        assert LightProfile.read(tmp_path / "tilt.ies").candelas.tolist() == [[5, 2]]


def test_a_missing_file():
    with pytest.raises(SolariError, match=r"no\.ies: there is no such file"):
        sv.PointLight((0, 0, 0), ies="no.ies")


# ---- glTF and groups --------------------------------------------------------------------------------


def test_luminaires_of_gltf_files(tmp_path):
    """A file's, turned by its node; saved and read back equal."""
    (tmp_path / "a lamp.ies").write_text(make_file("C, whole"))
    file = GltfWriter()
    file.json["extensions"] = {"EXT_lights_ies": {"lights": [{"uri": "a%20lamp.ies"}]}}
    file.json["extensionsUsed"] = file.json["extensionsRequired"] = ["EXT_lights_ies"]
    turn = [0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 3, 2, 1, 1]  # x, y, z to z, x, y
    lamp = {"EXT_lights_ies": {"light": 0, "multiplier": 0.5, "color": [1, 0.5, 0.25]}}
    file.node(matrix=turn, extensions=lamp, name="lamp")
    file.node(extensions={"EXT_lights_ies": {"light": 4}})
    path = file.save(tmp_path / "scene.gltf")
    with pytest.raises(SolariError, match="refers to light profile 4, but the file has only 1"):
        sv.load(path, strict=True)
    scene = sv.load(path)
    [light] = scene.lights
    assert light.intensity == pytest.approx(light.profile.peak / 2)
    np.testing.assert_allclose(light.color, (1, 0.5, 0.25))
    np.testing.assert_allclose((light.position, light.direction, light.horizontal), ((3, 2, 1), (0, -1, 0), (0, 0, 1)))
    light.radius = 0.1
    scene.save(tmp_path / "again.glb")
    [again] = sv.load(tmp_path / "again.glb").lights
    for name in ("position", "direction", "horizontal", "color", "intensity", "radius", "name"):
        np.testing.assert_array_equal(getattr(again, name), getattr(light, name), name)
    np.testing.assert_array_equal(again.profile.shares, light.profile.shares)


def test_groups_turn_luminaires(tmp_path):
    light = light_of(tmp_path, "C, whole")
    group = sv.Scene().group(light)
    group.rotation = rotation((0, 0, 1), math.pi / 2)
    np.testing.assert_allclose((light.direction, light.horizontal), ((1, 0, 0), (0, 1, 0)), atol=1e-6)
