"""Light profiles: files after ANSI/IES LM-63 light surfaces as the intensities in them say."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.files import GltfWriter
from support.frames import Effort, measure_frames
from support.seeded_bugs import Bug, require, seeded

import solari_vk as sv
from solari_vk.base.budget import load_budget
from solari_vk.base.errors import SolariError
from solari_vk.scene.lights.profile import LightProfile
from solari_vk.scene.matrices import rotation

STEP = 2  # degrees between the angles of files
HALF, WHOLE_TURN = np.arange(0, 181, STEP), np.arange(-90, 91, STEP)
# For each symmetry the horizontal angles of files, and the intensity in cd in a direction of the luminaire: towards the
# angle 0 of the horizontal ones, 90, and of the vertical ones.
KINDS = {
    "C, a plane": ("C", HALF, [0], lambda x, y, forward: 500 * (1 + 0.4 * forward + 0.3 * forward**2)),
    "C, a quarter": (
        "C",
        HALF,
        np.arange(0, 91, STEP),
        lambda x, y, forward: 500 * (1 + 0.4 * forward + 0.5 * x**2 - 0.3 * y**2),
    ),
    "C, a half": ("C", HALF, HALF, lambda x, y, forward: 500 * (1 + 0.3 * forward + 0.4 * x + 0.2 * y**2)),
    "C, the other half": (
        "C",
        HALF,
        np.arange(90, 271, STEP),
        lambda x, y, forward: 500 * (1 + 0.3 * forward + 0.4 * y + 0.2 * x**2),
    ),
    "C, whole": (
        "C",
        HALF,
        np.arange(0, 361, STEP),
        lambda x, y, forward: 500 * (1 + 0.3 * forward + 0.3 * x - 0.35 * y),
    ),
    "C, downwards": ("C", np.arange(0, 91, STEP), [0], lambda x, y, forward: 500 * np.maximum(forward, 0)),
    "B": ("B", WHOLE_TURN, WHOLE_TURN, lambda x, y, forward: 500 * np.maximum(forward, 0) * (1 + 0.5 * x + 0.4 * y)),
    "A": ("A", WHOLE_TURN, WHOLE_TURN, lambda x, y, forward: 500 * np.maximum(forward, 0) * (1 + 0.5 * x + 0.4 * y)),
    "B, a quarter": (
        "B",
        np.arange(0, 91, STEP),
        np.arange(0, 91, STEP),
        lambda x, y, forward: 500 * np.maximum(forward, 0) * (1 + 0.5 * x**2 - 0.4 * y**2),
    ),
}


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
    return "\n".join(
        [
            "IESNA:LM-63-2002",
            "[TEST] a file",
            "TILT=NONE",
            f"1 -1 {factor / 0.8} {len(vertical)} {len(horizontal)} {'CBA'.index(photometry) + 1} 2 .1,.1 0",
            "0.8 1 60",
            *(" ".join(f"{number:.7g}" for number in row) for row in values),
        ]
    )


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
    bug = Bug(
        "scene/lights/punctual.glsl",
        "profile_intensity",
        "light.profile_axes[1] = -light.profile_axes[1]; return correct(light, direction);",
    )
    with seeded(bug):
        found, expected = measured_and_expected(device, "C, whole", light_of(tmp_path, "C, whole"))
    assert np.abs(found - expected).max() > 100


@pytest.mark.slow
def test_frames_have_the_path_tracers_light(device, tmp_path):
    """The Cornell box with a luminaire, as a point and as a ball, in place of its lamp."""
    scene = sv.builtin("cornell_box")
    for lamp in [instance for instance in scene if instance.material.emits]:
        scene.remove(lamp)
    light = light_of(tmp_path, "C, a half", lumens=20)
    light.position = (1, 1.7, 1)
    scene.add(light)
    scene.add(
        sv.PointLight(
            (0.5, 0.7, 1.4), profile=light.profile, intensity=2, radius=0.1, direction=(1, 0, 0), horizontal=(0, 1, 0)
        )
    )
    require(measure_frames(device, scene, Effort(4, 16, 12), 512, 0.04, size=(24, 24)))


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
    with pytest.raises(SolariError, match=r"horizontal must not have the direction .* set both by update"):
        light.direction = (1, 0, 0)
    light.update(direction=(1, 0, 0), horizontal=(0, 1, 0))
    light.profile = None
    light.direction = (0, 1, 0)  # without a profile both are ignored
    with pytest.raises(SolariError, match="ies must be a path or a LightProfile, not int"):
        sv.PointLight((0, 0, 0), ies=3)
    with pytest.raises(SolariError, match="lumens can't be given with the profile 'off', which is wholly dark: give"):
        light.update(ies=LightProfile([0, 90], [0], [[0, 0]], name="off"), lumens=5)


FINE = np.arange(-10, 10.01, 0.1)
CLOSE = np.array([0, *np.arange(40, 50, 0.1), *np.arange(50, 361, 10)])


@pytest.mark.parametrize(
    ("photometry", "vertical", "horizontal", "aim"),
    [
        ("C", np.arange(0, 10, 0.1), [0], (0, 0)),
        ("C", np.arange(0, 10, 0.25), [0], (0, 0)),
        ("C", np.arange(20, 40, 0.1), CLOSE, (30.03, 45.07)),
        ("A", FINE, FINE, (3.03, -5.02)),
        ("B", FINE, FINE, (0, 0)),
    ],
)
def test_narrow_beams_keep_their_flux(photometry, vertical, horizontal, aim):
    """Of half a degree, where half of the intensity is left."""

    def directions(v, h):
        v, h = np.radians(v), np.radians(h)
        if photometry == "C":
            return np.stack(np.broadcast_arrays(np.sin(v) * np.cos(h), np.sin(v) * np.sin(h), np.cos(v)), -1)
        first, second = (v, h) if photometry == "A" else (h, v)
        return np.stack(
            np.broadcast_arrays(np.sin(first), np.cos(first) * np.sin(second), np.cos(first) * np.cos(second)), -1
        )

    away = directions(vertical, np.reshape(horizontal, (-1, 1))) - directions(*aim)
    candelas = np.exp2(-np.square(np.linalg.norm(away, axis=-1) / math.radians(0.25)))
    profile = LightProfile(vertical, horizontal, candelas, photometry)
    if len(horizontal) == 1:  # as the shader and the file have it: linear between angles
        fine = np.radians(np.linspace(0, vertical[-1], 100_001))
        flux = 2 * math.pi * np.trapezoid(np.interp(np.degrees(fine), vertical, candelas[0]) * np.sin(fine), fine)
    else:
        flux = math.pi * math.radians(0.25) ** 2 / math.log(2)
    assert profile.solid_angle * profile.peak == pytest.approx(flux, rel=0.01)


def test_a_ray_between_the_rows_of_the_table_isnt_lost():
    profile = LightProfile([0, 30, 30.25, 30.5, 90], [0], [[0, 0, 1000, 0, 0]])
    ring = 2 * math.pi * math.sin(math.radians(30.25)) * math.radians(0.25)
    assert profile.solid_angle == pytest.approx(ring, rel=1e-3)
    assert np.flatnonzero(profile.shares).tolist() == [60, 61]
    smooth = LightProfile([0, 10, 20.1, 20.2, 90], [0], [[50, 40, 9, 8, 0]])
    np.testing.assert_allclose(smooth.shares[[0, 10, 20], 0], (1, 0.9, 0.8), rtol=1e-6)  # elsewhere as measured


def test_angles_too_close_together_are_named():
    close = np.linspace(30, 30.01, 21)
    profile = LightProfile([0, *close, 90], [0, 180], np.ones((2, 23)), name="laser")
    with pytest.warns(UserWarning, match="laser: angles only 0.0005 degrees apart are too close"):
        np.testing.assert_allclose(profile.shares[:180], 1, rtol=1e-5)


# ---- files ------------------------------------------------------------------------------------------


GOOD = make_file("C, a plane")
NUMBERS = "1 -1 1 2 1 1 2 0 0 0\n1 1 60\n0 90\n0\n"
BAD = {
    "not a light profile": "hello",
    "ends early: 2 further numbers are missing": "TILT=NONE\n" + NUMBERS,
    "has the word 'bright' where a number belongs": "TILT=NONE\n" + NUMBERS + "1 bright",
    "vertical angles must rise": "TILT=NONE\n" + NUMBERS.replace("0 90", "90 0") + "1 1",
    "must be a count of at least 1, not 0": "TILT=NONE\n" + NUMBERS.replace("2 1 1", "0 1 1", 1) + "1 1",
    "type C must reach from 0 to 0, 90, 180 or 360": "TILT=NONE\n1 -1 1 1 2 1 2 0 0 0 1 1 60 0 0 70 1 1",
    "candelas must lie between 0 and": "TILT=NONE\n" + NUMBERS + "1 -1",
    "candelas must be finite": "TILT=NONE\n" + NUMBERS + "1 nan",
    "has the word '1_00' where a number belongs": "TILT=NONE\n" + NUMBERS + "1 1_00",
    r"type must be 1, 2 or 3 \(C, B or A\), not 9": "TILT=NONE\n" + NUMBERS.replace("1 2 0 0 0", "9 2 0 0 0") + "1 1",
    r"type must be 1, 2 or 3 \(C, B or A\), not 0": "TILT=NONE\n" + NUMBERS.replace("1 2 0 0 0", "0 2 0 0 0") + "1 1",
    "the multiplier must be a finite number of at least 0": "TILT=NONE\n1 -1 nan 2 1 1 2 0 0 0 1 1 60 0 90 0 1 1",
    "memory": f"TILT=NONE\n1 -1 1 16000000 16000000 1 2 0 0 0 1 1 60{' 0' * 2**22}",
}


@pytest.mark.parametrize("message", BAD)
def test_wrong_files_end_in_one_error_that_names_them(tmp_path, message, monkeypatch):
    monkeypatch.setenv("SOLARI_VK_LOAD_MEMORY", "256 MiB")
    (tmp_path / "bad.ies").write_text(BAD[message])
    with pytest.raises(SolariError, match=f"bad.ies: .*{message}"):
        LightProfile.read(tmp_path / "bad.ies")


@pytest.mark.parametrize("separator", " \t\n\r\v\f,\x1c\x85\xa0")
def test_all_that_parts_numbers_is_charged(separator):
    with load_budget(memory=2**20), pytest.raises(SolariError, match="lamp: its numbers would take 11 MiB"):
        LightProfile.parse(f"TILT=NONE\n{f'12{separator}' * 100_000}".encode("latin-1"), "lamp")


@pytest.mark.parametrize(
    ("first", "number", "factor"),
    [
        ("", 0.9, 0.9),
        ("IESNA91\n", 0.9, 0.9),
        ("IESNA:LM-63-1995\n", 0, 1),
        ("IESNA:LM-63-2002\r\n", 0, 1),
        ("IES:LM-63-2019\n", 1.10100, 1),
    ],
)
def test_the_number_after_the_ballast_factor_counts_in_old_files_only(first, number, factor):
    text = f"{first}TILT=NONE\n{NUMBERS.replace('1 1 60', f'0.5 {number} 60')}8 2\n\x1a"  # DOS ends files by \x1a
    assert LightProfile.parse(text.encode(), "lamp").candelas.tolist() == [[4 * factor, factor]]


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
    (tmp_path / "a lamp.ies").write_text(make_file("C, whole").replace("TILT=NONE", "TILT=other.file"))
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
    assert any("(TILT) aren't applied: " in line and "light profile 0" in line for line in scene.warnings)
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
