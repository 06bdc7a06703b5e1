"""EXT_lights_image_based: the cube's faces lie where the extension says, its values are unpacked, errors are named."""

from __future__ import annotations

import numpy as np
from support.oracles import environments

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
    np.testing.assert_allclose(environments.radiance(scene.environment, AXES)[:, 0], expected, rtol=1e-5)


def test_rotation_turns_the_cube(writer):
    half = np.sqrt(0.5)
    scene = environment_of(writer, flat_faces(), rotation=[0, half, 0, half])  # +z goes to +x
    seen = environments.radiance(scene.environment, AXES[:1])
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
            seen = environments.radiance(environment, [forward + aside, forward - aside])
            np.testing.assert_allclose(seen[:, channel], (1, 0), atol=1e-6)
    # The rows of the upper face end at +z, and those of the lower face begin there.
    seen = environments.radiance(environment, [(0, 1, -0.5), (0, 1, 0.5), (0, -1, 0.5), (0, -1, -0.5)])
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
