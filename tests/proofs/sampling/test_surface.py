"""MIS weights of infinite densities, bases, bent normals, and surfaces of degenerate meshes."""

from __future__ import annotations

import numpy as np

from solari_vk.bound.binder import SceneBinder
from solari_vk.scene.model import Instance, Material, Mesh, Scene, Texture, TextureImage

INF = np.float32(np.inf)


def run(shaders, mode, vectors, external=None):
    """Three vectors in, three out: (N, 3, 3)."""
    vectors = np.asarray(vectors, np.float32).reshape(-1, 3, 3)
    count = len(vectors)
    header = f"#define MODE {mode}"
    inputs = {"vectors": vectors, **(external or {})}
    out = shaders.run("test/surface", count, inputs, {"results": 3 * count}, header=header)
    return out["results"].reshape(count, 3, 3)


def test_heuristics(shaders):
    cases = [  # f, g, balance, power
        (0, 0, 0, 0),
        (0, 3, 0, 0),
        (0, INF, 0, 0),
        (3, 0, 1, 1),
        (1, 3, 0.25, 0.1),
        (INF, 3, 1, 1),
        (INF, 0, 1, 1),
        (3, INF, 0, 0),
        (INF, INF, 0.5, 0.5),
        (1e30, 1e30, 0.5, 0.5),
        (1e30, 3e30, 0.25, 0.1),
        (1e-30, 3e-30, 0.25, 0.1),
        (1e-30, 1e30, 0, 0),
        (1e30, 1e-30, 1, 1),
    ]
    vectors = np.zeros((len(cases), 3, 3), np.float32)
    vectors[:, 0, :2] = [case[:2] for case in cases]
    assert np.allclose(run(shaders, 0, vectors)[:, 0, :2], [case[2:] for case in cases], rtol=1e-6, atol=1e-12)


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def test_bases(shaders):
    rng = np.random.default_rng(8)
    normals = rng.normal(size=(10_000, 3))
    normals[:6] = [(0, 0, -1), (0, 0, 1), (1e-8, 0, -1), (1e-4, -1e-4, -1), (1, 0, 0), (0, 1, -1e-9)]
    vectors = np.zeros((len(normals), 3, 3))
    vectors[:, 0] = unit(normals)
    basis = run(shaders, 1, vectors).astype(np.float64)
    assert np.abs(basis @ basis.transpose(0, 2, 1) - np.eye(3)).max() < 1e-6
    assert (np.linalg.det(basis) > 0).all()
    assert (basis[:, 2] == vectors[:, 0].astype(np.float32)).all()


def test_bent_normals(shaders):
    rng = np.random.default_rng(9)
    count = 100_000
    normal, geometric, wo = (unit(rng.normal(size=(count, 3))) for _ in range(3))
    wo[: count // 4] = unit(wo[: count // 4] * (1, 1, 1e-4))
    geometric[: count // 4] = (0, 0, 1)
    normal[1000:2000] = -geometric[1000:2000]
    normal[2000:3000] = geometric[2000:3000]
    wo *= np.sign(np.einsum("ij,ij->i", wo, geometric))[:, None]
    normal[: count // 2] *= np.sign(np.einsum("ij,ij->i", normal, geometric))[: count // 2, None]  # others inverted
    bent = run(shaders, 2, np.stack([normal, geometric, wo], axis=1))[:, 0].astype(np.float64)
    cosine = np.einsum("ij,ij->i", bent, wo)
    mirrored = 2 * cosine[:, None] * bent - wo
    assert np.abs(np.linalg.norm(bent, axis=1) - 1).max() < 1e-5
    assert cosine.min() > -1e-6
    assert np.einsum("ij,ij->i", mirrored, geometric).min() > -1e-6
    facing = np.einsum("ij,ij->i", normal, wo)
    fine = (facing > 1e-6) & (np.einsum("ij,ij->i", 2 * facing[:, None] * normal - wo, geometric) > 0.011)
    assert np.abs(bent - normal)[fine].max() < 1e-6


def test_broken_meshes_resolve_to_numbers(shaders):
    rng = np.random.default_rng(10)
    pixels = rng.integers(0, 256, (4, 4, 4), dtype=np.uint8)
    texture = Texture(image=TextureImage(pixels=pixels))
    material = Material(
        base_color_texture=texture, normal_texture=texture, metallic_roughness_texture=texture, normal_scale=3.0
    )
    corner = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    zeros, ones = np.zeros((3, 3), np.float32), np.ones((3, 2), np.float32)
    uvs = np.array([[0, 0], [1, 0], [0, 1]], np.float32)
    tangents = np.tile(np.array([0, 0, 1, 1], np.float32), (3, 1))
    meshes = [
        Mesh(positions=corner),
        Mesh(positions=corner, normals=zeros, uvs=uvs),
        Mesh(positions=corner, uvs=ones),
        Mesh(positions=corner, uvs=uvs * 1e-20),
        Mesh(positions=corner, normals=np.tile([0, 0, -1], (3, 1)), uvs=uvs),
        Mesh(positions=corner, uvs=uvs, normals=np.tile([0, 0, 1], (3, 1)), tangents=tangents),
        Mesh(positions=corner, uvs=uvs, normals=np.tile([0, 0, 1], (3, 1)), tangents=0 * tangents),
        Mesh(positions=zeros, uvs=uvs),
        Mesh(positions=corner * (1, 0, 0), uvs=uvs),
        Mesh(positions=corner * 1e-20, uvs=uvs),
        Mesh(positions=corner * 1e15, uvs=uvs),
    ]
    binder = SceneBinder(shaders.device, Scene(*(Instance(mesh=mesh, material=material) for mesh in meshes)))
    try:
        binder.update()
        count = 64 * len(meshes)
        vectors = np.zeros((count, 3, 3))
        vectors[:, 0, 0] = np.arange(count) % len(meshes)
        vectors[:, 0, 2] = rng.choice([0, 1e-3, 1, 1e9], count)
        vectors[:, 1, :2] = rng.random((count, 2)) / 2
        vectors[:, 2] = unit(rng.normal(size=(count, 3)) * rng.choice([1, 1, 0], (count, 3)) + (0, 0, 1e-9))
        out = run(shaders, 3, vectors, binder.resources)
    finally:
        shaders.device.wait_idle()
        binder.destroy()
    broken = ~np.isfinite(out).all(axis=(1, 2))
    assert not broken.any(), f"meshes {set((np.flatnonzero(broken) % len(meshes)).tolist())}: {out[broken][0]}"
    assert np.abs(np.linalg.norm(out[:, :2], axis=2) - 1).max() < 1e-4
    assert (np.einsum("ij,ij->i", out[:, 1], vectors[:, 2]) <= 1e-6).all(), "geometric normals face the ray"
