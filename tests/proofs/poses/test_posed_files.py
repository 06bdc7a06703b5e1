"""Files with skins and morph targets look like files without them, whose vertices numpy has moved by glTF's rules: the
normals that light sees, through a normal map, so that positions, normals and tangents all count."""

import numpy as np
import pytest
from support.files import GltfWriter

import solari_vk as sv
from solari_vk.scene.matrices import rotation

SIDE = 7  # vertices along an edge
CAMERA = sv.Camera.look_at((0.3, 0.4, 3.5), (0, 0, 0), vertical_fov=0.9)
RNG = np.random.default_rng(5)
WEIGHTS = (0.8, -0.4)


def sheet():
    """The attributes of a bumpy sheet, its triangles, and what its two morph targets add."""
    u, v = (part.reshape(-1) for part in np.meshgrid(*[np.linspace(0, 1, SIDE)] * 2))
    position = np.stack([2 * u - 1, 1 - 2 * v, 0.2 * np.sin(5 * u) * np.cos(4 * v)], axis=1)
    normal = np.stack([0.5 * np.cos(3 * u), np.sin(4 * v), np.full_like(u, 2.0)], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    tangent = np.cross([0.0, 1.0, 0.0], normal)
    tangent = np.append(tangent / np.linalg.norm(tangent, axis=1, keepdims=True), np.ones((len(u), 1)), axis=1)
    shares = np.stack([u, 1 - u], axis=1) * RNG.uniform(0.3, 2, (len(u), 1))  # which don't add up to 1
    given = {"POSITION": position, "NORMAL": normal, "TANGENT": tangent, "TEXCOORD_0": np.stack([u, v], axis=1)}
    first = (np.arange(SIDE - 1)[:, None] * SIDE + np.arange(SIDE - 1)).reshape(-1)
    corners = [(first, first + SIDE, first + 1), (first + 1, first + SIDE, first + SIDE + 1)]
    triangles = np.concatenate([np.stack(three, axis=1) for three in corners])
    names = ("POSITION", "NORMAL", "TANGENT")
    targets = [{name: RNG.normal(scale=0.15, size=(len(u), 3)) for name in names} for _ in WEIGHTS]
    for target in targets:
        target["POSITION"][::3] = 0
    return given, triangles, shares, targets


def joints():
    """Places of two joints: turned, and scaled differently along each axis."""
    places = np.tile(np.eye(4), (2, 1, 1))
    for place, angle, scale in zip(places, (0.5, -0.3), ((1.3, 0.7, 1.8), (0.8, 1.2, 0.5)), strict=True):
        place[:3, :3] = rotation((1, 2, 0.5), angle) @ np.diag(scale)
    return places


def sparse(writer, rows):
    """An accessor of rows that are 0 but for some."""
    (some,) = np.nonzero(rows.any(axis=1))
    indices = {"bufferView": writer.view(some.astype("<u2").tobytes()), "componentType": 5123}
    values = {"bufferView": writer.view(rows[some].astype("<f4").tobytes())}
    fields = {"type": "VEC3", "componentType": 5126, "count": len(rows)}
    return writer.add("accessors", sparse={"count": len(some), "indices": indices, "values": values}, **fields)


def write(path, given, triangles, targets=(), shares=None, root=None):
    """A file of the sheet with a normal map, in a pose if it has targets or a skin."""
    writer = GltfWriter(path)
    image = writer.image(np.full((2, 2, 3), (200, 90, 225), np.uint8))
    material = writer.add("materials", normalTexture={"index": image}, doubleSided=False)
    fields = {"material": material}
    if targets:
        write_delta = {True: sparse, False: lambda writer, rows: writer.accessor(rows)}
        fields["targets"] = [{n: write_delta[n == "POSITION"](writer, d) for n, d in t.items()} for t in targets]
    node = {"weights": list(WEIGHTS)} if targets else {}
    if shares is not None:
        numbers = np.tile(np.array([0, 1, 0, 0]), (len(shares), 1))
        given = given | {"JOINTS_0": writer.accessor(numbers, "u1"), "WEIGHTS_0": np.pad(shares, ((0, 0), (0, 2)))}
    node["mesh"] = writer.mesh(given, triangles.reshape(-1), **fields)
    if shares is None:
        writer.node(**node)
        return writer.load()
    bones = [writer.node(matrix=place.T.reshape(-1).tolist()) for place in joints()]
    skin = writer.add("skins", joints=bones)
    writer.node(children=[*bones, writer.node(skin=skin, **node)], scale=root)
    return writer.load()


def bake(given, triangles, targets=(), shares=None, root=None):
    """The sheet's attributes and triangles after it was moved: targets first, then joints."""
    moved = {name: np.float32(values).astype(np.float64) for name, values in given.items()}
    for weight, target in zip(WEIGHTS, targets, strict=False):
        for name in target.keys() & moved.keys():
            moved[name][:, :3] += weight * np.float32(target[name])
    if shares is not None:
        shares = shares / shares.sum(axis=1, keepdims=True)
        matrices = np.einsum("vj,jab->vab", shares, np.diag([*root, 1.0]) @ joints())
        linear = matrices[:, :3, :3]
        moved["POSITION"] = np.einsum("vab,vb->va", linear, moved["POSITION"]) + matrices[:, :3, 3]
        for name, turns in (("NORMAL", np.linalg.inv(linear).transpose(0, 2, 1)), ("TANGENT", linear)):
            if name in moved:
                moved[name][:, :3] = np.einsum("vab,vb->va", turns, moved[name][:, :3])
        if np.prod(root) < 0:  # the node turns the front around, and the hand of tangent frames
            triangles = triangles[:, ::-1]
            if "TANGENT" in moved:
                moved["TANGENT"][:, 3] *= -1
    for name in {"NORMAL", "TANGENT"} & moved.keys():
        moved[name][:, :3] /= np.linalg.norm(moved[name][:, :3], axis=1, keepdims=True)
    return moved, triangles


def normals_seen(device, scene):
    with sv.PathTracer(device, scene, (48, 48)) as tracer:
        tracer.render(CAMERA, samples=1)
        return tracer["shading_normal"].astype(np.float64)


def check_alike(found, expected):
    """A pixel's center may lie at an edge, on other sides of it in the two."""
    assert (expected != 0).any(axis=2).sum() > 300
    assert (np.abs(found - expected).max(axis=2) > 1e-3).sum() <= 3


SKIN, MIRRORED = (1, 1, 1), (1.5, -1, 0.8)


@pytest.mark.parametrize("normals", ["smooth", "flat"])
@pytest.mark.parametrize(
    ("moved_by", "root"),
    [
        ((), SKIN),
        ((), MIRRORED),
        (("POSITION", "NORMAL", "TANGENT"), None),
        (("POSITION",), None),
        (("POSITION", "NORMAL", "TANGENT"), MIRRORED),
    ],
)
def test_posed_files_look_like_baked_ones(device, tmp_path, normals, moved_by, root):
    given, triangles, shares, targets = sheet()
    if normals == "flat":
        given = {name: given[name] for name in ("POSITION", "TEXCOORD_0")}
    pose = {
        "targets": [{name: target[name] for name in moved_by} for target in targets] if moved_by else (),
        "shares": None if root is None else shares,
        "root": root,
    }
    posed = write(tmp_path / "posed.glb", given, triangles, **pose)
    baked = write(tmp_path / "baked.glb", *bake(given, triangles, **pose))
    check_alike(normals_seen(device, posed), normals_seen(device, baked))


@pytest.mark.parametrize("moved_by", [("POSITION",), ("POSITION", "NORMAL")])
def test_tangents_are_made_for_each_target(device, tmp_path, moved_by):
    """Of a file without tangents: a target's weight of 1 shows what a file of the moved mesh shows."""
    given, triangles, _, targets = sheet()
    del given["TANGENT"]
    target = {name: targets[0][name] for name in moved_by}
    moved = {name: np.zeros_like(values) for name, values in target.items()}
    (posed,) = scene = write(tmp_path / "posed.glb", given, triangles, [moved, target])
    posed.morph_weights = [0.3, 1]
    baked = {name: values + target[name] if name in target else values for name, values in given.items()}
    check_alike(normals_seen(device, scene), normals_seen(device, write(tmp_path / "baked.glb", baked, triangles)))
