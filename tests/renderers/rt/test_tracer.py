"""RayTracer against a float64 ray-triangle test of all pairs, and the rest of its documented behavior."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from oracles.rays import World, closest_by_brute_force, intersect
from support.frames import leaves_nothing

import solari_vk as sv
from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.device.device import Device
from solari_vk.renderers import ray_tracer as tracer_module

CORNERS = np.array([[0, 0, 0], [0.9, 0, 0], [0, 0.9, 0]])
WIDE = sv.Mesh(positions=np.array([[-9, -9, 0], [9, -9, 0], [0, 9, 0]], np.float32))


@pytest.fixture
def rng():
    return np.random.default_rng(1)


def soup(rng, count, size=0.3):
    """Randomly scattered triangles in random order."""
    corners = rng.uniform(-1, 1, (count, 1, 3)) + rng.normal(0, size, (count, 3, 3))
    return sv.Mesh(positions=corners.reshape(-1, 3).astype(np.float32))


def place(*position, matrix=((1, 0, 0), (0, 1, 0), (0, 0, 1))):
    return np.column_stack([matrix, position])


def make_scene(rng):
    """Moved, mirrored and sheared instances that share a mesh; one has a ray_mesh, and one is invisible."""
    mesh, other = soup(rng, 60), soup(rng, 40)
    return sv.Scene(
        sv.Instance(mesh=mesh),
        sv.Instance(mesh=mesh, transform=place(3, 0, 0, matrix=np.diag([-1, 1, 1]))),
        sv.Instance(mesh=other, transform=place(0, 3, 0), visible=False),
        sv.Instance(mesh=mesh, ray_mesh=other, transform=place(0, 3, 0)),
        sv.Instance(mesh=other, transform=place(3, 3, 0, matrix=[[1, 0.5, 0], [0, 2, 0], [0.1, 0, -1]])),
    )


def make_rays(rng, count):
    origins = rng.uniform(-2, 5, (count, 3))
    return origins, rng.uniform(-1, 4, (count, 3)) - origins  # of any length


def check(tracer, scene, origins, directions):
    """The hits; each field must be the oracle's, except for rays that hit an edge within rounding."""
    origins, directions = origins.astype(np.float32), directions.astype(np.float32)
    hits = tracer.trace(origins, directions)
    world = World(scene)
    exact = origins.astype(np.float64)
    along = directions.astype(np.float64)
    index, distance = closest_by_brute_force(world.corners, exact, along)
    numbers = {instance: i for i, instance in enumerate(scene)}
    instance = np.array([-1 if row < 0 else numbers[tracer.instances[row]] for row in hits["instance"].tolist()])
    found = index >= 0
    expected = np.where(found, world.instance[index], -1)
    triangle = np.where(found, world.triangle[index], -1)
    agree = (instance == expected) & (hits["primitive"] == triangle)
    assert agree.mean() > 0.998  # the others hit edges
    sure = agree & found
    assert found.mean() > 0.2
    assert (hits["t"][agree & ~found] == np.inf).all()
    assert np.allclose(hits["t"][sure], distance[sure], rtol=1e-4, atol=1e-5)
    corners = world.corners[index[sure]]
    _, u, v = intersect(corners, exact[sure], along[sure])
    close = np.isfinite(u)
    assert np.allclose(hits["barycentrics"][sure][close], np.stack([u, v], -1)[close], atol=2e-3)
    assert np.allclose(hits["position"][sure], exact[sure] + distance[sure, None] * along[sure], atol=2e-4)
    normals = world.normals[index[sure]]
    assert np.einsum("ij,ij->i", hits["normal"][sure], normals).min() > 0.999
    facing = np.einsum("ij,ij->i", normals, along[sure])
    clear = np.abs(facing) > 1e-4
    assert np.array_equal(hits["front_face"][sure][clear], (facing < 0)[clear])
    return hits


def test_any_hit_is_some_hit(device, rng):
    scene = make_scene(rng)
    origins, directions = make_rays(rng, 2000)
    with sv.RayTracer(device, scene) as tracer:
        closest = check(tracer, scene, origins, directions)
        anything = tracer.trace(origins, directions, any_hit=True)
    assert np.array_equal(closest["instance"] >= 0, anything["instance"] >= 0)
    assert (anything["t"] >= closest["t"] - 1e-5).all()
    assert (anything["t"] > closest["t"] + 1e-3).any()  # the traversal stops early


def test_triangles_have_the_users_numbers(device, rng):
    x, y = np.divmod(rng.permutation(400), 20)
    corners = CORNERS + np.stack([x, y, 0 * x], -1)[:, None]
    mesh = sv.Mesh(positions=corners.reshape(-1, 3))
    with sv.RayTracer(device, sv.Scene(sv.Instance(mesh))) as tracer:
        hits = tracer.trace(corners.mean(axis=1) + np.array([0, 0, 2]), (0, 0, -2))
        assert np.array_equal(hits["primitive"], np.arange(400))
        assert np.allclose(hits["t"], 1, rtol=1e-6)
        mesh.positions = corners[::-1].reshape(-1, 3)
        hits = tracer.trace(corners.mean(axis=1) + np.array([0, 0, 2]), (0, 0, -2))
        assert np.array_equal(hits["primitive"], np.arange(400)[::-1])


def test_edits_are_taken_up(device, rng):
    scene = make_scene(rng)
    rays = make_rays(rng, 1500)
    with sv.RayTracer(device, scene) as tracer:
        check(tracer, scene, *rays)
        first, second, *_ = scene
        first.transform = place(0, 0, 0.5)
        check(tracer, scene, *rays)
        scene.remove(second)
        mesh = soup(rng, 30)
        added = [scene.add(sv.Instance(mesh=mesh, transform=place(i % 5, i // 5, 1))) for i in range(30)]
        hits = check(tracer, scene, *rays)  # more than the first TLAS holds
        assert {tracer.instances[row] for row in set(hits["instance"].tolist()) - {-1}} & set(added)
        assert second not in tracer.instances.values()
        for item in list(scene):
            scene.remove(item)
        assert (tracer.trace(*rays)["instance"] == -1).all()


@pytest.fixture
def in_a_box(device):
    """A tracer of rays that all hit something when they start inside."""
    with sv.RayTracer(device, sv.builtin("closed_box")) as tracer:
        yield tracer


def test_rays_without_sense_meet_nothing(in_a_box):
    good = np.array([0.0, 0.0, 1.0])
    nan, inf = np.nan, np.inf
    cases = [((v, 0, 0), good) for v in (nan, inf, -inf)] + [((0, 0, 0), (0, v, 1)) for v in (nan, inf, -inf)]
    cases += [((0, 0, 0), (0, 0, 0)), ((0, 0, 0), good)]
    hits = in_a_box.trace(*map(np.array, zip(*cases, strict=True)))
    assert hits["instance"].tolist()[:-1] == [-1] * 7
    assert hits["instance"][-1] >= 0
    limits = in_a_box.trace((0, 0, 0), good, t_min=[0, nan, -1, 2, 0, inf], t_max=[inf, 5, 5, 1, nan, inf])
    assert (limits["instance"] >= 0).tolist() == [True] + [False] * 5
    miss = hits[0]
    assert (miss["t"], miss["primitive"], miss["front_face"]) == (inf, -1, False)
    assert not any(miss[name].any() for name in ("barycentrics", "position", "normal"))


def test_limits_of_rays(device):
    scene = sv.Scene(*(sv.Instance(WIDE, transform=place(0, 0, -z)) for z in (2.0, 4.0)))
    with sv.RayTracer(device, scene) as tracer:
        hits = tracer.trace((0, 0, 0), (0, 0, -2), t_min=[0, 1.5, 2.5, 0], t_max=[9, 9, 9, 0.5])
    assert hits["t"].tolist() == [1, 2, np.inf, np.inf]


def test_numbers_beyond_float32_are_infinite_without_a_warning(in_a_box):
    up = np.array([0.0, 0.0, 1.0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        endless = in_a_box.trace((0, 0, 0), up)
        for t_max in (1e300, 10**300, [1e300], 1e39):
            assert (in_a_box.trace((0, 0, 0), up, t_max=t_max)["t"] == endless["t"]).all()
        wrong = [((0, 0, 0), up, 1e300), ((0, 0, 0), up, -1e300), ((0, 0, -1e300), up, 0), ((0, 0, 0), up * 1e300, 0)]
        for origin, direction, t_min in wrong:
            assert in_a_box.trace(origin, direction, t_min=t_min, t_max=np.inf)["instance"] == -1


def test_rays_hit_blended_surfaces_by_chance(device, monkeypatch):
    """As often as alpha says, by random numbers of each ray's own that only the seed changes."""
    scene = sv.Scene(sv.Instance(WIDE, sv.Material(alpha=0.3, alpha_mode="blend")))
    origins = np.tile([0.0, 0.0, 1.0], (4096, 1))
    with sv.RayTracer(device, scene) as tracer:
        first, second = (tracer.trace(origins, (0, 0, -1), seed=seed)["instance"] >= 0 for seed in (0, 2**32 - 1))
        some = tracer.trace(origins, (0, 0, -1), any_hit=True)["instance"] >= 0
        monkeypatch.setattr(tracer_module, "BATCH", 1000)
        split = tracer.trace(origins, (0, 0, -1))["instance"] >= 0
    np.testing.assert_array_equal(split, first)
    limit = 4 / len(origins) ** 0.5
    for hit in (first, second, some):
        assert abs(hit.mean() - 0.3) < 0.5 * limit
    for other in (second, np.roll(first, 1)):
        assert abs(np.mean((first - 0.3) * (other - 0.3))) < 0.21 * limit


def test_batches_join_without_seams(device, monkeypatch):
    monkeypatch.setattr(tracer_module, "BATCH", 64)
    corners = CORNERS + np.arange(1000)[:, None, None] * np.array([1.0, 0, 0])
    with sv.RayTracer(device, sv.Scene(sv.Instance(sv.Mesh(corners.reshape(-1, 3))))) as tracer:
        for count in (0, 1, 63, 64, 65, 128, 129, 1000):
            hits = tracer.trace(corners.mean(axis=1)[:count] + np.array([0, 0, 1]), (0, 0, -1))
            assert np.array_equal(hits["primitive"], np.arange(count)), count


def test_shapes_and_types(in_a_box):
    assert in_a_box.trace((0, 0, 0), (0, 0, 1)).shape == ()
    assert in_a_box.trace(np.zeros((4, 1, 3)), np.ones((5, 3), int)).shape == (4, 5)
    assert in_a_box.trace([0, 0, 0], [[0, 0, 1]], t_max=[[9], [8]]).shape == (2, 1)
    assert (in_a_box.trace(np.zeros((7, 3), np.float64)[::-1], [0, 0, 1])["instance"] >= 0).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"origins": np.zeros(2)}, r"the shape of origins is \(2,\), not \(..., 3\)"),
        ({"directions": 1.0}, r"the shape of directions is \(\), not \(..., 3\)"),
        ({"origins": np.zeros((2, 3)), "directions": np.zeros((4, 3))}, ".*don't fit"),
        ({"origins": np.zeros((2, 3)), "t_min": [1, 2, 3]}, ".*don't fit"),
        ({"origins": ["a", "b", "c"]}, "origins must be numbers"),
        ({"directions": None}, "directions"),
        ({"t_max": None}, "t_max must be numbers"),
        ({"t_min": "1"}, "t_min must be numbers, not '1'"),
        ({"t_max": 10**400}, "t_max must be numbers"),
        ({"any_hit": "no"}, "any_hit is 'no': give True or False"),
        ({"seed": -1}, "seed"),
        ({"seed": 2**32}, "seed"),
        ({"seed": 0.5}, "seed"),
    ],
)
def test_wrong_arguments(in_a_box, arguments, message):
    with pytest.raises(sv.SolariError, match=f"trace: {message}"):
        in_a_box.trace(**{"origins": np.zeros(3), "directions": np.zeros(3), **arguments})


def test_a_binder_is_shared_and_nothing_is_left(device, monkeypatch):
    scene, buffer = sv.builtin("closed_box"), device.buffer
    with leaves_nothing(device):
        binder = SceneBinder(device, scene)
        tracer = sv.RayTracer(device, binder)
        assert tracer.trace((0, 0, 0), (0, 0, -1))["instance"] >= 0
        tracer.close()
        tracer.close()
        with pytest.raises(sv.SolariError, match="closed"):
            tracer.trace((0, 0, 0), (0, 0, 1))
        binder.update()  # the binder still works
        binder.destroy()

    def fail(size, name, **options):
        if name == tracer_module.ARRAYS[2]:
            raise RuntimeError("no more")
        return buffer(size, name, **options)

    monkeypatch.setattr(device, "buffer", fail)
    with leaves_nothing(device), pytest.raises(RuntimeError, match="no more"):
        sv.RayTracer(device, scene)


def test_with_memory_that_is_not_mapped(any_device, rng):
    with Device(validation=True, staging=True) as device, sv.RayTracer(device, sv.builtin("closed_box")) as tracer:
        hits = tracer.trace(np.zeros((1000, 3)), rng.normal(size=(1000, 3)))
        assert (hits["instance"] >= 0).all()
