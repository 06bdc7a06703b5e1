"""The light that each triangle of a lamp sends out, and the tables that follow from it, through edits."""

from __future__ import annotations

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.bound.lights.emissive_meshes import MIN_LUMINANCE, Emissions
from solari_vk.scene.emission import luminance_sums, mean_luminances
from solari_vk.scene.images.mip_chain import LINEAR_OF_SRGB

CHOICE = np.dtype([("threshold", "<u4"), ("alias", "<u4"), ("probability", "<f4")])
CORNER = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
WRAPS = ["repeat", "mirrored_repeat", "clamp_to_edge"]


def linear(pixels):
    return LINEAR_OF_SRGB[pixels[..., :3]] @ np.array([0.2126, 0.7152, 0.0722])


def wrapped(index, size, wrap):
    if wrap == "repeat":
        return index % size
    if wrap == "clamp_to_edge":
        return np.clip(index, 0, size - 1)
    index = index % (2 * size)
    return np.where(index < size, index, 2 * size - 1 - index)


@pytest.mark.parametrize(("wrap_u", "wrap_v"), list(zip(WRAPS, WRAPS[1:] + WRAPS[:1], strict=True)))
def test_means_are_those_of_the_texels_under_a_triangle(wrap_u, wrap_v):
    rng = np.random.default_rng(1)
    pixels = rng.integers(0, 256, (5, 7, 4), dtype=np.uint8)
    texels = rng.integers(0, (7, 5), (200, 3, 2)) + rng.uniform(0.05, 0.95, (200, 3, 2))
    uvs = (rng.integers(-3, 4, (200, 1, 2)) + texels / (7, 5)).reshape(-1, 2).astype(np.float32)
    mesh = sv.Mesh(positions=np.tile(CORNER, (200, 1)), uvs=uvs)
    texture = sv.Texture(pixels, wrap_u=wrap_u, wrap_v=wrap_v)
    found = mean_luminances(mesh, mesh.triangles, texture, luminance_sums(texture.image))
    light = linear(pixels)
    for mean, corners in zip(found, uvs.astype(np.float64).reshape(-1, 3, 2), strict=True):
        (left, top), (right, bottom) = np.floor(corners.min(axis=0) * (7, 5)), np.ceil(corners.max(axis=0) * (7, 5))
        x, y = wrapped(np.arange(left, right), 7, wrap_u), wrapped(np.arange(top, bottom), 5, wrap_v)
        if wrap_u == "clamp_to_edge":
            x = np.unique(x)
        if wrap_v == "clamp_to_edge":
            y = np.unique(y)
        assert mean == pytest.approx(light[np.ix_(y.astype(int), x.astype(int))].mean(), rel=1e-4)


def test_means_are_taken_at_the_uvs_of_the_texture():
    """Of the mesh's second uvs, or of its first ones where it has no others."""
    pixels = np.array([[0, 255]], np.uint8)
    dark, bright = [[0.1, 0.1], [0.4, 0.1], [0.1, 0.9]], [[0.6, 0.1], [0.9, 0.1], [0.6, 0.9]]
    texture = sv.Texture(pixels, uv_set=1)
    for second, expected in ((bright, 1.0), (None, 0.0)):
        mesh = sv.Mesh(CORNER, uvs=dark, second_uvs=second)
        assert mean_luminances(mesh, mesh.triangles, texture, luminance_sums(texture.image)) == expected


def test_transforms_huge_coordinates_and_meshes_without_them():
    pixels = np.zeros((2, 2, 4), np.uint8)
    pixels[0, 1] = 255
    moved = sv.Texture(pixels, uv_transform=[[1, 0, 0.5], [0, 1, 0]])
    mesh = sv.Mesh(positions=CORNER, uvs=np.full((3, 2), 0.25))
    sums = luminance_sums(moved.image)
    assert mean_luminances(mesh, mesh.triangles, moved, sums) == pytest.approx(1.0, rel=1e-4)
    assert mean_luminances(sv.Mesh(positions=CORNER), mesh.triangles, moved, sums) == pytest.approx(1.0, rel=1e-4)
    for wrap in WRAPS:
        wide = sv.Texture(pixels, wrap_u=wrap, wrap_v=wrap)
        far = sv.Mesh(positions=CORNER, uvs=[[1e30, -1e30], [-1e30, 1e30], [3e38, 0]])
        assert mean_luminances(far, far.triangles, wide, sums) == pytest.approx(0.25, rel=1e-4)


def strip(bright, count=20):
    """A lamp of `count` triangles in a row, whose texture is white under triangle `bright` and black elsewhere."""
    x = np.arange(count, dtype=np.float32)[:, None]
    positions = np.concatenate([CORNER + np.array((n, 0, 0)) for n in range(count)])
    uvs = np.stack([np.repeat((x + 0.5) / count, 3), np.full(3 * count, 0.5)], axis=1)
    pixels = np.zeros((1, count, 4), np.uint8)
    pixels[0, bright] = 255
    texture = sv.Texture(pixels, magnification="nearest")
    material = sv.Material(emissive=2.0, emissive_texture=texture)
    return sv.Instance(sv.Mesh(positions, uvs=uvs), material)


def probabilities(binder, instance):
    """That of each of a lamp's triangles, in the order of its mesh; None where all are equally likely."""
    binder.update()
    source = binder.lights.sources.records[binder.lights.index(instance)]
    mesh = instance.ray_mesh or instance.mesh
    key = mesh, instance.material.emissive_texture
    buffer = binder.records.emissions._emissions[key].choices
    assert source["part_count"] == len(mesh.triangles)
    assert source["parts"] == (0 if buffer is None else buffer.address)
    if buffer is None:
        return None
    found = np.zeros(len(mesh.triangles))
    found[binder.assets.geometry.orders[mesh]] = buffer.read(CHOICE, len(found))["probability"]
    return found


def test_bright_triangles_are_likely_and_edits_are_taken_up(bound):
    lamp = strip(bright=3)
    binder = bound(lamp)
    dark = MIN_LUMINANCE / 20

    def expect(bright):
        expected = np.full(20, dark)
        expected[bright] = 1
        np.testing.assert_allclose(probabilities(binder, lamp), expected / expected.sum(), rtol=1e-5)

    expect(3)
    np.testing.assert_allclose(binder.lights.powers, [np.pi * 2 * 0.5], rtol=1e-5)
    image = lamp.material.emissive_texture.image
    image.pixels = np.roll(image.pixels, 4, axis=1)
    expect(7)
    lamp.material.emissive_texture.uv_transform = [[1, 0, 0.1], [0, 1, 0]]
    expect(5)
    lamp.material.emissive_texture = strip(bright=9).material.emissive_texture
    expect(9)
    mesh = lamp.mesh
    mesh.positions = mesh.positions * np.where(np.arange(60)[:, None] < 30, 1.0, 2.0)
    areas = np.repeat([1.0, 4.0], 10)
    expected = areas * np.where(np.arange(20) == 9, 1.0, MIN_LUMINANCE * areas[9] / areas.sum())
    np.testing.assert_allclose(probabilities(binder, lamp), expected / expected.sum(), rtol=1e-5)
    lamp.material.emissive_texture = None
    np.testing.assert_allclose(probabilities(binder, lamp), areas / areas.sum(), rtol=1e-5)


def test_equal_triangles_need_no_table(bound):
    plain = sv.Instance(strip(0).mesh, sv.Material(emissive=1.0))
    paper = np.full((2, 2), 255, np.uint8)
    white = sv.Instance(strip(0).mesh, sv.Material(emissive=1.0, emissive_texture=paper))
    binder = bound(plain, white)
    assert probabilities(binder, plain) is None
    assert probabilities(binder, white) is None


def test_instances_share_tables_which_live_as_long_as_their_users(bound, device):
    lamps = [strip(bright=2)]
    lamps.append(sv.Instance(lamps[0].mesh, lamps[0].material, transform=np.diag([2, 2, 2, 1])))
    binder = bound(*lamps, sv.Instance(sv.Mesh(CORNER), sv.Material(emissive=1.0)))
    binder.update()
    tables = {int(address) for address in binder.lights.sources.records["parts"][:2]}
    assert len(tables) == 1
    assert tables != {0}
    held = device.objects_in_use
    for lamp in lamps:
        binder.scene.remove(lamp)
    binder.update()
    device.wait_idle()
    assert device.objects_in_use < held


def test_dark_lights_are_never_chosen(bound):
    black = strip(bright=0)
    black.material.emissive_texture.image.pixels = np.zeros((1, 20, 4), np.uint8)
    lit = sv.Instance(sv.Mesh(CORNER), sv.Material(emissive=(1e-10, 0.0, 0.0)))
    sun, off = (sv.DirectionalLight(direction=(0, -1, 0), illuminance=lux) for lux in (1e15, 0.0))
    binder = bound(black, lit, sun, off)

    def chances():
        binder.update()
        return binder.lights.leaves.table.records["by_power"]["probability"][:4]

    assert ((chances() > 0) == [False, True, True, False]).all()
    assert chances()[1] == pytest.approx(0.25)
    assert chances().sum() == pytest.approx(1)
    ids = dict(zip(("black", "lit", "sun", "off"), binder.lights.ids.tolist(), strict=True))
    black.material.emissive_texture.image.pixels = np.full((1, 20, 4), 255, np.uint8)
    off.illuminance = 3.0
    assert (chances() > 0).all()
    after = dict(zip(ids, binder.lights.ids.tolist(), strict=True))
    assert [name for name in ids if ids[name] != after[name]] == ["black", "off"], "no reservoir could find them before"
    for light in (sun, off):
        light.illuminance = 0.0
    for lamp in (black, lit):
        lamp.material.emissive_texture = np.zeros((1, 1), np.uint8)
    np.testing.assert_allclose(chances(), 0.25)


def test_moving_a_lamp_changes_no_table(bound):
    lamp = strip(bright=3)
    binder = bound(lamp, strip(bright=4))
    binder.update()
    tables, powers = (binder.lights.sources, binder.lights.leaves.table), binder.lights.powers
    before = [table.records.copy() for table in tables]
    lamp.transform = np.array([[0, -1, 0, 3], [1, 0, 0, 4], [0, 0, 1, 5]])
    binder.update()
    assert binder.lights.powers is powers
    for table, records in zip(tables, before, strict=True):
        np.testing.assert_array_equal(table.records, records)


def test_many_textured_triangles_have_a_chance_each(device):
    rng = np.random.default_rng(5)
    count = 100_000
    positions = (rng.random((count, 1, 3)) + 0.01 * rng.random((count, 3, 3))).reshape(-1, 3)
    pixels = rng.integers(0, 256, (256, 256, 3), dtype=np.uint8)
    lamp = sv.Instance(sv.Mesh(positions, uvs=positions[:, :2]), sv.Material(emissive=1.0, emissive_texture=pixels))
    emissions = Emissions(device, CHOICE)
    emission = emissions.acquire(lamp, np.arange(count))
    found, starts = emission.choices.read(CHOICE)["probability"], emission.clusters.starts
    emissions.destroy()
    assert (found > 0).all()
    np.testing.assert_allclose(np.add.reduceat(found, starts), 1, atol=1e-4)
