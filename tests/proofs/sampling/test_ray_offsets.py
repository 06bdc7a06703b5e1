"""Error-bounded ray origins: no ray meets the triangle it leaves, or the one its shadow ray ends on, at any scale."""

from __future__ import annotations

import numpy as np
import pytest

from solari_vk.bound.binder import SceneBinder
from solari_vk.scene.model import Instance, Material, Mesh, Scene

COUNT = 10_000  # of each group
GROUP_SIZE = 6
KINDS = ["rigid", "far", "scaled", "sheared", "mirrored", "slivers", "axis-aligned"]


def transform_of(kind, rng, scale):
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    matrix = np.eye(4)
    matrix[:3, :3] = turn
    matrix[:3, 3] = rng.normal(size=3) * scale
    if kind == "far":
        matrix[:3, 3] *= 1000
    if kind == "scaled":
        matrix[:3, :3] = turn @ np.diag(10.0 ** rng.uniform(-2, 2, 3))
    if kind == "sheared":
        shear = np.eye(3)
        shear[0, 1:] = rng.uniform(-5, 5, 2)
        matrix[:3, :3] = turn @ shear
    if kind == "mirrored":
        matrix[:3, :3] = turn @ np.diag([-1, 1, 1])
    if kind == "axis-aligned":
        matrix = np.eye(4)
    return matrix


def make_instances(kind, scale, rng):
    """Instances of 4 random triangles each."""
    for _ in range(GROUP_SIZE):
        positions = rng.normal(size=(12, 3)) * scale
        triangles = positions.reshape(-1, 3, 3)
        if kind == "slivers":
            triangles[:, 2] = triangles[:, 0] + (triangles[:, 1] - triangles[:, 0]) * 0.4 + triangles[:, 2] * 1e-3
        if kind == "axis-aligned":
            axis = rng.integers(0, 3)
            triangles[:, :, axis] = triangles[:, :1, axis]
        mesh = Mesh(positions=positions.astype(np.float32))
        yield Instance(mesh=mesh, material=Material(), transform=transform_of(kind, rng, scale))


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e5])
def test_offsets(shaders, scale):
    rng = np.random.default_rng(2)
    scene = Scene(*(instance for kind in KINDS for instance in make_instances(kind, scale, rng)))
    binder = SceneBinder(shaders.device, scene)
    count = COUNT * len(KINDS)
    header = f"const uint GROUP_COUNT = {len(KINDS)}u; const uint GROUP_SIZE = {GROUP_SIZE}u;"
    try:
        binder.update()
        out = shaders.run("test/offsets", count, binder.resources, {"counts": count}, header=header)["counts"]
    finally:
        shaders.device.wait_idle()
        binder.destroy()
    own, ends, relative, broken = out.reshape(COUNT, len(KINDS), 4).transpose(2, 1, 0)
    assert not broken.any()
    for kind, own_count, end_count in zip(KINDS, own.sum(axis=1), ends.sum(axis=1), strict=True):
        assert own_count == 0, f"{kind}: {own_count:.0f} of {COUNT} rays met the triangle they left"
        assert end_count == 0, f"{kind}: {end_count:.0f} of {COUNT} shadow rays met an end of theirs"
    assert np.median(relative) < 1e-4, "offsets stay far below what is visible"
