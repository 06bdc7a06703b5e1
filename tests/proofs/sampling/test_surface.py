"""MIS weights of infinite densities, bases, bent normals, surfaces of degenerate meshes, and ray origins that no ray
meets its own triangle from, at any scale."""

import numpy as np
import pytest
from support.frames import bound_scene
from support.seeded_bugs import Bug, bug_tests, with_shaders

from solari_vk.scene.model import Instance, Material, Mesh, Scene, Texture, TextureImage

INF = np.float32(np.inf)


def run(shaders, mode, vectors, external=None):
    """Three vectors in, three out: (N, 3, 3)."""
    vectors = np.asarray(vectors, np.float32).reshape(-1, 3, 3)
    count = len(vectors)
    inputs = {"vectors": vectors, **(external or {})}
    out = shaders.run("test/surface", count, inputs, {"results": 3 * count}, header=f"#define MODE {mode}")
    return out["results"].reshape(count, 3, 3)


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def test_heuristics(shaders):
    cases = np.array([  # f, g, balance, power
        (0, 0, 0, 0), (0, 3, 0, 0), (0, INF, 0, 0), (3, 0, 1, 1), (1, 3, 0.25, 0.1), (INF, 3, 1, 1), (INF, 0, 1, 1),
        (3, INF, 0, 0), (INF, INF, 0.5, 0.5), (1e30, 1e30, 0.5, 0.5), (1e30, 3e30, 0.25, 0.1),
        (1e-30, 3e-30, 0.25, 0.1), (1e-30, 1e30, 0, 0), (1e30, 1e-30, 1, 1),
    ])  # fmt: skip
    vectors = np.zeros((len(cases), 3, 3))
    vectors[:, 0, :2] = cases[:, :2]
    assert np.allclose(run(shaders, 0, vectors)[:, 0, :2], cases[:, 2:], rtol=1e-6, atol=1e-12)


def test_bases(shaders):
    normals = np.random.default_rng(8).normal(size=(10_000, 3))
    normals[:6] = [(0, 0, -1), (0, 0, 1), (1e-8, 0, -1), (1e-4, -1e-4, -1), (1, 0, 0), (0, 1, -1e-9)]
    vectors = np.zeros((len(normals), 3, 3))
    vectors[:, 0] = unit(normals)
    basis = run(shaders, 1, vectors).astype(np.float64)
    assert np.abs(basis @ basis.transpose(0, 2, 1) - np.eye(3)).max() < 1e-6
    assert (np.linalg.det(basis) > 0).all()
    assert (basis[:, 2] == vectors[:, 0].astype(np.float32)).all()


def test_bent_normals(shaders):
    rng, count = np.random.default_rng(9), 100_000
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
    texture = Texture(image=TextureImage(pixels=rng.integers(0, 256, (4, 4, 4), dtype=np.uint8)))
    material = Material(
        base_color_texture=texture, normal_texture=texture, metallic_roughness_texture=texture, normal_scale=3.0
    )
    corner = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    zeros, up = np.zeros((3, 3), np.float32), np.tile([0, 0, 1], (3, 1))
    uvs, tangents = corner[:, :2], np.tile(np.array([0, 0, 1, 1], np.float32), (3, 1))
    meshes = [
        Mesh(**fields)
        for fields in (
            {"positions": corner},
            {"positions": corner, "normals": zeros, "uvs": uvs},
            {"positions": corner, "uvs": np.ones((3, 2))},
            {"positions": corner, "uvs": uvs * 1e-20},
            {"positions": corner, "normals": -up, "uvs": uvs},
            {"positions": corner, "uvs": uvs, "normals": up, "tangents": tangents},
            {"positions": corner, "uvs": uvs, "normals": up, "tangents": 0 * tangents},
            {"positions": zeros, "uvs": uvs},
            {"positions": corner * (1, 0, 0), "uvs": uvs},
            {"positions": corner * 1e-20, "uvs": uvs},
            {"positions": corner * 1e15, "uvs": uvs},
        )
    ]
    count = 64 * len(meshes)
    vectors = np.zeros((count, 3, 3))
    vectors[:, 0, 0] = np.arange(count) % len(meshes)
    vectors[:, 0, 2] = rng.choice([0, 1e-3, 1, 1e9], count)
    vectors[:, 1, :2] = rng.random((count, 2)) / 2
    vectors[:, 2] = unit(rng.normal(size=(count, 3)) * rng.choice([1, 1, 0], (count, 3)) + (0, 0, 1e-9))
    with bound_scene(shaders.device, Scene(*(Instance(mesh=mesh, material=material) for mesh in meshes))) as binder:
        out = run(shaders, 3, vectors, binder.resources)
    broken = ~np.isfinite(out).all(axis=(1, 2))
    assert not broken.any(), f"meshes {set((np.flatnonzero(broken) % len(meshes)).tolist())}: {out[broken][0]}"
    assert np.abs(np.linalg.norm(out[:, :2], axis=2) - 1).max() < 1e-4
    assert (np.einsum("ij,ij->i", out[:, 1], vectors[:, 2]) <= 1e-6).all(), "geometric normals face the ray"


# ---- ray origins: no ray meets the triangle that it leaves, or the one that its shadow ray ends on --

RAYS, GROUP_SIZE = 10_000, 6  # of each kind
KINDS = ["rigid", "far", "scaled", "sheared", "mirrored", "slivers", "axis-aligned"]


def transform_of(kind, rng, scale):
    matrix = np.eye(4)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    shear = np.eye(3)
    shear[0, 1:] = rng.uniform(-5, 5, 2)
    changes = {"scaled": np.diag(10.0 ** rng.uniform(-2, 2, 3)), "sheared": shear, "mirrored": np.diag([-1, 1, 1])}
    matrix[:3, :3] = turn @ changes.get(kind, np.eye(3))
    matrix[:3, 3] = rng.normal(size=3) * scale * (1000 if kind == "far" else 1)
    return np.eye(4) if kind == "axis-aligned" else matrix


def make_instances(kind, scale, rng):
    """Instances of 4 random triangles each."""
    for _ in range(GROUP_SIZE):
        triangles = rng.normal(size=(4, 3, 3)) * scale
        if kind == "slivers":
            triangles[:, 2] = triangles[:, 0] + (triangles[:, 1] - triangles[:, 0]) * 0.4 + triangles[:, 2] * 1e-3
        if kind == "axis-aligned":
            axis = rng.integers(0, 3)
            triangles[:, :, axis] = triangles[:, :1, axis]
        mesh = Mesh(positions=triangles.reshape(-1, 3).astype(np.float32))
        yield Instance(mesh=mesh, material=Material(), transform=transform_of(kind, rng, scale))


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e5])
def test_offsets(shaders, scale):
    rng, count = np.random.default_rng(2), RAYS * len(KINDS)
    scene = Scene(*(instance for kind in KINDS for instance in make_instances(kind, scale, rng)))
    header = f"const uint GROUP_COUNT = {len(KINDS)}u; const uint GROUP_SIZE = {GROUP_SIZE}u;"
    with bound_scene(shaders.device, scene) as binder:
        out = shaders.run("test/offsets", count, binder.resources, {"counts": count}, header=header)["counts"]
    own, ends, relative, broken = out.reshape(RAYS, len(KINDS), 4).transpose(2, 1, 0)
    assert not broken.any()
    for kind, own_count, end_count in zip(KINDS, own.sum(axis=1), ends.sum(axis=1), strict=True):
        assert own_count == 0, f"{kind}: {own_count:.0f} of {RAYS} rays met the triangle they left"
        assert end_count == 0, f"{kind}: {end_count:.0f} of {RAYS} shadow rays met an end of theirs"
    assert np.median(relative) < 1e-4, "offsets stay far below what is visible"


SURFACE = "scene/surface.glsl"
test_a_seeded_bug_is_noticed = bug_tests(
    {
        "bent normals": (with_shaders(test_bent_normals), Bug(SURFACE, "bend_shading_normal", "return normal;")),
        "heuristics": (
            with_shaders(test_heuristics),
            Bug("common/math.glsl", "power_heuristic", "return f * f / (f * f + g * g);"),
        ),
        "offsets": (
            with_shaders(test_offsets, 1e-3),
            Bug(
                SURFACE,
                "world_ray_offset",
                "return 0.1 * correct(reach, object_position, world_from_object, cofactors, object_normal);",
            ),
        ),
        "offsets of lights": (
            with_shaders(test_offsets, 1.0),
            Bug(
                "scene/light_visibility.glsl", "shadow_ray_segment", "return light_sample.world_position - ray_origin;"
            ),
        ),
    }
)
