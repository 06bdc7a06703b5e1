"""Whether two scenes are equal in all that pictures show of them: `check_same`."""

import dataclasses

import numpy as np

from solari_vk.scene.material import TEXTURES, Texture
from solari_vk.scene.matrices import transform_points

OF_UNLIT = ("base_color", "base_color_texture", "alpha", "alpha_mode", "double_sided", "unlit", "name")
POSES = (0, 0.13, 0.5, 0.71, 1.0)  # of clips, in parts of their duration


def check_same(scene, other):
    """AssertionError unless the scenes are the same, in poses of their clips too."""
    assert other.name == scene.name
    assert list(other.variants) == list(scene.variants)
    check_objects(scene, other)
    for name in scene.variants:
        for one in (scene, other):
            one.use_variant(name)
        check_objects(scene, other)
    assert other.animations.names == scene.animations.names
    for number, clip in enumerate(scene.animations):
        assert abs(other.animations[number].duration - clip.duration) <= 1e-6 * clip.duration
        for seconds in np.array(POSES) * clip.duration:
            for one in (scene, other):
                one.animate(seconds, number, loop=False)
            check_objects(scene, other)


def check_objects(scene, other):
    for kind in ("instances", "cameras", "lights"):
        found, wanted = ([item for item in getattr(one, kind) if item is not one.environment] for one in (other, scene))
        if all(item.name for item in wanted):  # what follows clips is read in another order
            found, wanted = (sorted(items, key=lambda item: item.name) for items in (found, wanted))
        for a, b in zip(found, wanted, strict=True):
            assert a.name == b.name or not b.name, kind
            assert (a is other.backdrop, a is default_of(other)) == (b is scene.backdrop, b is default_of(scene)), kind
            {"instances": check_instance, "cameras": check_fields, "lights": check_fields}[kind](a, b)
    assert (scene.environment is None) == (other.environment is None)
    if scene.environment is not None:
        directions = np.random.default_rng(1).normal(size=(500, 3))
        found, wanted = (light(one.environment, directions) for one in (other, scene))
        inside = np.isfinite(found) & np.isfinite(wanted)
        assert inside.mean() > 0.9
        near(found[inside], wanted[inside], 1e-6)


def default_of(scene):
    return scene._camera or next(iter(scene.cameras), None)


def check_instance(found, wanted):
    assert found.visible == wanted.visible
    check_material(found.material, wanted.material)
    if not wanted.visible:
        return
    a, b = found.posed_mesh(), wanted.posed_mesh()
    corners, others = (
        one.triangles[(np.roll(one.triangles, 1, axis=1) != one.triangles).all(axis=1)] for one in (a, b)
    )
    if np.linalg.det(found.transform) * np.linalg.det(wanted.transform) < 0:  # of a skin, which then is inside out
        others = others[:, ::-1]
    places = [transform_points(one.transform, mesh.positions) for one, mesh in ((found, a), (wanted, b))]
    near(places[0][corners], places[1][others], 1e-5)
    for name in ("normals", "tangents"):
        if getattr(b, name) is not None and not wanted.posed:
            near(getattr(a, name)[corners], getattr(b, name)[others], 1e-5)
    assert a.colors is b.colors is None or np.array_equal(a.colors[corners], b.colors[others])
    for name in TEXTURES if not wanted.material.unlit else OF_UNLIT[1:2]:
        ours, theirs = getattr(found.material, name), getattr(wanted.material, name)
        if theirs is not None:
            uvs, given = a.uvs_for(ours.uv_set)[corners], b.uvs_for(theirs.uv_set)
            assert np.array_equal(uvs, np.zeros_like(uvs) if given is None else given[others]), name


def check_material(found, wanted):
    for name in OF_UNLIT if wanted.unlit else wanted._names:
        a, b = getattr(found, name), getattr(wanted, name)
        texture = name.replace("_scale", "_texture")
        if isinstance(b, Texture):
            assert np.array_equal(a.image.pixels, b.image.pixels), name
            near(a.uv_transform, b.uv_transform, 1e-5)
            fields = ("wrap_u", "wrap_v", "magnification", "minification", "mipmaps")
            assert [getattr(a, field) for field in fields] == [getattr(b, field) for field in fields], name
        elif name == "alpha_cutoff" and wanted.alpha_mode != "mask":
            continue
        elif not (texture != name and getattr(wanted, texture) is None):  # a scale matters to its texture only
            assert np.array_equal(a, b), f"{wanted.describe()}: {name}: {a} in place of {b}"


def check_fields(found, wanted):
    """Cameras and lights."""
    assert type(found) is type(wanted)
    strength = next((name for name in ("intensity", "illuminance") if hasattr(wanted, name)), None)
    for name in (field.name for field in dataclasses.fields(wanted) if field.name not in ("name", "color", strength)):
        a, b = getattr(found, name), getattr(wanted, name)
        assert (a is None) == (b is None), name
        if isinstance(b, str):
            assert a == b, name
        elif b is not None:
            near(np.asarray(a, np.float64), np.asarray(b, np.float64), 1e-5)
    if strength:
        near(getattr(found, strength) * found.color, getattr(wanted, strength) * wanted.color, 1e-6)


def light(environment, directions):
    """The radiance from directions (N, 3) in the world, NaN near the edges of texels."""
    x, y, z = (directions @ environment.rotation.astype(np.float64)).T  # by the inverse
    height, width = environment.image.shape[:2]
    row = np.arctan2(np.hypot(x, z), y) / np.pi * height
    column = (np.arctan2(z, x) / (2 * np.pi) + 0.5) * width
    near_edge = (np.minimum(row % 1, 1 - row % 1) < 1e-3) | (np.minimum(column % 1, 1 - column % 1) < 1e-3)
    found = environment.image[row.astype(int).clip(0, height - 1), column.astype(int) % width] * environment.intensity
    return np.where(near_edge[:, None], np.nan, found)


def near(found, wanted, error):
    assert np.shape(found) == np.shape(wanted)
    assert np.abs(found - wanted).max(initial=0) <= error * max(1.0, np.abs(wanted).max(initial=0))
