"""EXT_lights_image_based and OMI_environment_sky: what is in a direction, its values, and errors with their place."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.light import environment_radiance
from support.files import exr_file

from solari_vk.base.budget import BudgetError
from solari_vk.base.errors import SolariError
from solari_vk.scene.files.gltf.images import Images
from solari_vk.scene.files.gltf.values import Entry
from solari_vk.scene.images.exr import ExrImage
from solari_vk.scene.images.mip_chain import LINEAR_OF_SRGB

AXES = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)])
SIZE = 8


def environment_of(writer, faces, **fields):
    """The scene of a file whose environment has these faces (6, SIZE, SIZE, 4)."""
    numbers = [writer.image(face) for face in faces]
    light = {"specularImages": [numbers], "specularImageSize": SIZE, "irradianceCoefficients": [[0] * 3] * 9}
    writer.json["extensions"] = {"EXT_lights_image_based": {"lights": [{**light, **fields}]}}
    writer.json["extensionsUsed"] = ["EXT_lights_image_based"]
    writer.add("scenes", nodes=[writer.node(mesh=writer.mesh())], extensions={"EXT_lights_image_based": {"light": 0}})
    return writer.load()


def flat_faces():
    """Each face has its own color; alpha says by what it is divided."""
    faces = np.zeros((6, SIZE, SIZE, 4), np.uint8)
    faces[..., 0] = np.arange(40, 241, 40)[:, None, None]
    faces[..., 3] = np.array((255, 255, 51, 255, 255, 255))[:, None, None]
    return faces


def test_faces_lie_in_the_directions_of_their_axes(writer):
    scene = environment_of(writer, flat_faces(), intensity=2.0)
    assert not scene.warnings
    expected = 2 * LINEAR_OF_SRGB[np.arange(40, 241, 40)] * np.array((1, 1, 5, 1, 1, 1))
    np.testing.assert_allclose(environment_radiance(scene.environment, AXES)[:, 0], expected, rtol=1e-5)


def test_rotation_turns_the_cube(writer):
    half = np.sqrt(0.5)
    scene = environment_of(writer, flat_faces(), rotation=[0, half, 0, half])  # +z goes to +x
    seen = environment_radiance(scene.environment, AXES[:1])
    np.testing.assert_allclose(seen[0, 0], LINEAR_OF_SRGB[200], rtol=1e-5)


def test_faces_are_not_mirrored_seen_from_inside(writer):
    """The right half of each face around the horizon is lit, and the upper half of its blue."""
    faces = np.zeros((6, SIZE, SIZE, 4), np.uint8)
    faces[..., 3] = 255
    faces[:, :, SIZE // 2 :, 0] = 255
    faces[:, : SIZE // 2, :, 2] = 255
    environment = environment_of(writer, faces).environment
    up = np.array((0, 0.5, 0))
    for forward in AXES[[0, 1, 4, 5]]:
        for channel, aside in ((0, 0.5 * np.cross(forward, (0, 1, 0))), (2, up)):
            seen = environment_radiance(environment, [forward + aside, forward - aside])
            np.testing.assert_allclose(seen[:, channel], (1, 0), atol=1e-6)
    # The rows of the upper face end at +z, and those of the lower face begin there.
    seen = environment_radiance(environment, [(0, 1, -0.5), (0, 1, 0.5), (0, -1, 0.5), (0, -1, -0.5)])
    np.testing.assert_allclose(seen[:, 2], (1, 0, 1, 0), atol=1e-6)


def test_a_missing_image_costs_the_environment_only(writer):
    faces = list(flat_faces())
    faces[3] = faces[3][:4]
    scene = environment_of(writer, faces)
    assert scene.environment is None
    assert any("aren't equal squares" in line for line in scene.warnings)


def test_errors_name_the_place(writer):
    environment_of(writer, flat_faces())
    light = writer.json["extensions"]["EXT_lights_image_based"]["lights"][0]
    use = writer.json["scenes"][0]["extensions"]["EXT_lights_image_based"]
    for fields, change, message in (
        (use, {"light": 3}, "refers to light 3"),
        (light, {"specularImages": [[0]]}, "six images"),
        (light, {"specularImages": [7]}, "six images"),
        (light, {"rotation": [1]}, "rotation"),
        (light, {"intensity": -1}, "intensity"),
    ):
        right = dict(fields)
        fields |= change
        assert writer.load_with_loss(message).environment is None
        fields.clear()
        fields |= right


# ---- OMI_environment_sky ----------------------------------------------------------------------------


def sky_of(writer, *skies, scene=True, **use):
    """The scene of a file with these skies."""
    writer.json["extensions"] = {"OMI_environment_sky": {"skies": list(skies)}} | use.pop("extensions", {})
    writer.json["extensionsUsed"] = ["OMI_environment_sky"]
    nodes = [writer.node(mesh=writer.mesh())]
    if scene:
        writer.add("scenes", nodes=nodes, extensions={"OMI_environment_sky": use})
    return writer.load()


def test_plain_skies_and_which_of_several(writer):
    scene = sky_of(writer, {"type": "plain"}, {"type": "plain", "plain": {"color": [1, 2, 3]}}, sky=1)
    assert (scene.environment.image[0, 0].tolist(), scene.warnings) == ([1, 2, 3], [])


def test_the_first_sky_is_that_of_scenes_without_one(writer):
    assert sky_of(writer, {"type": "plain", "plain": {"color": [1, 2, 3]}}, scene=False).environment.image.max() == 3


def test_gradient_skies(writer):
    colors = {"topColor": [1, 0, 0], "horizonColor": [0, 1, 0], "bottomColor": [0, 0, 4]}
    curves = {"topCurve": 1, "bottomCurve": 0.5}
    environment = sky_of(writer, {"type": "gradient", "gradient": {**colors, **curves}}).environment
    half = np.sqrt(0.5)
    seen = environment_radiance(environment, [(0, 1, 0), (half, half, 0), (0, 0, -1), (0, -half, half), (0, -1, 0)])
    share = 1 - 0.5**2  # of the nadir's color, half-way down
    expected = [(1, 0, 0), (0.5, 0.5, 0), (0, 1, 0), (0, 1 - share, 4 * share), (0, 0, 4)]
    np.testing.assert_allclose(seen, expected, atol=0.02)


def test_panoramas_have_z_in_the_middle_and_x_at_its_left(writer):
    """Quarters of the horizon: what is seen from inside along +z lies in the middle, and +x at its left."""
    quarters = np.repeat(np.array([(50, 0, 0), (100, 0, 0), (150, 0, 0), (200, 0, 0)], np.uint8), 8, axis=0)
    picture = np.roll(np.tile(quarters, (16, 1, 1)), -4, axis=1)  # the quarter of 150 around the middle
    scene = sky_of(writer, {"type": "panorama", "panorama": {"equirectangular": writer.image(picture)}})
    seen = environment_radiance(scene.environment, AXES[[0, 4, 1, 5]])[:, 0]
    np.testing.assert_allclose(seen, LINEAR_OF_SRGB[[100, 150, 200, 50]], rtol=1e-5)


@pytest.mark.parametrize(
    ("texel", "lit", "warning"),
    [
        (5e4, True, None),
        (-1e-3, True, "pictures hold a little negative light, which is taken for 0: image 0"),
        (-5, False, "wrong skies are left out: image 0 holds negative light"),
        (np.nan, False, "wrong skies are left out: image 0 holds NaN or infinite values"),
        (1e19, False, "wrong skies are left out: image 0 holds light above"),
    ],
)
def test_exr_skies_are_checked_as_pictures_of_environments_are(writer, texel, lit, warning):
    pixels = np.ones((2, 4, 3), np.float32)
    pixels[1, 2, 0] = texel
    texture = writer.add("textures", source=writer.add("images", bufferView=writer.view(exr_file(RGB=pixels))))
    scene = sky_of(writer, {"type": "panorama", "panorama": {"equirectangular": texture}})
    assert [line[: len(warning or "")] for line in scene.warnings] == ([warning] if warning else [])
    assert (scene.environment is not None) == lit
    if lit:
        np.testing.assert_array_equal(scene.environment.image[1, 2], (max(texel, 0), 1, 1))


def test_images_of_skies_are_opened_once_and_charged_before_they_are_read(writer, monkeypatch):
    opened, run = [], Images._open
    monkeypatch.setattr(Images, "_open", lambda self, *given: opened.append(given) or run(self, *given))
    picture = writer.image(np.zeros((8, 16, 3), np.uint8))
    sky_of(writer, {"type": "panorama", "panorama": {"equirectangular": picture}})
    assert len(opened) == 1

    def charge(self, size, what, *, working=0):
        if what == "the map of its sky":
            raise BudgetError("full")

    monkeypatch.setattr(Entry, "charge", charge)
    monkeypatch.setattr(ExrImage, "colors", lambda self, who: pytest.fail("colors were read first"))
    texture = writer.add("textures", source=writer.add("images", bufferView=writer.view(exr_file((1, 1, 1)))))
    del writer.json["scenes"], writer.json["buffers"]
    with pytest.raises(SolariError, match="full"):
        sky_of(writer, {"type": "panorama", "panorama": {"equirectangular": texture}})


def test_cubes_of_skies(writer):
    faces = [writer.image(face[..., :3]) for face in flat_faces()]
    scene = sky_of(writer, {"type": "panorama", "panorama": {"cubemap": faces}})
    seen = environment_radiance(scene.environment, AXES)[:, 0]
    np.testing.assert_allclose(seen, LINEAR_OF_SRGB[np.arange(40, 241, 40)], rtol=1e-5)


GRADIENT = {key: [1, 1, 1] for key in ("topColor", "horizonColor", "bottomColor")}


@pytest.mark.parametrize(
    ("sky", "use", "warning", "lit"),
    [
        ({"type": "physical"}, {}, "physical skies are left out: give another light", False),
        ({"type": "plain", "ambientSkyContribution": 0.5}, {}, "ambient light apart from that of the sky", True),
        (
            {"type": "gradient", "gradient": GRADIENT},
            {"extensions": {"KHR_lights_punctual": {"lights": []}}},
            "the glow of gradient skies",
            True,
        ),
        ({"type": "gradient"}, {}, "sky 0 has a wrong field: 'horizonColor' is missing", False),
        ({"type": "green"}, {}, "'type' is 'green', but must be one of gradient, panorama, physical, plain", False),
        ({"type": "plain"}, {"sky": 4}, "refers to sky 4, but the file has only 1", False),
        ({"type": "panorama", "panorama": {"cubemap": [0]}}, {}, "a list of six textures", False),
        ({"type": "panorama", "panorama": {"equirectangular": 7}}, {}, "refers to texture 7", False),
    ],
)
def test_what_of_skies_is_left_out_is_named(writer, sky, use, warning, lit):
    scene = sky_of(writer, sky, **use)
    assert (scene.environment is not None) == lit
    assert any(warning in line for line in scene.warnings), scene.warnings


def test_a_sky_without_its_image_is_left_out(writer):
    texture = writer.add("textures", source=writer.add("images", uri="missing.jpg"))
    scene = sky_of(writer, {"type": "panorama", "panorama": {"equirectangular": texture}})
    assert scene.environment is None
    assert any("skies whose images can't be read" in line for line in scene.warnings)
