"""Many rays whose hits are known: closed surfaces, many instances, extreme sizes, and invalid rays."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from solari_vk import rt
from solari_vk.bound.spatial_order import spatial_order
from solari_vk.lab.conformance.outcomes import SUITE, VULKAN, WGPU, Measurement, Rule, count_wrong
from solari_vk.lab.conformance.probe_checks import run_rays
from solari_vk.lab.shader_runner import ShaderRunner
from solari_vk.lab.structures import (
    IDENTITY,
    Boxes,
    Placement,
    Shapes,
    Structures,
    Triangles,
    build_and_trace,
    bumpy_ball,
    random_rotation,
    trace,
)
from solari_vk.scene.matrices import transform_directions, transform_points

Floats = NDArray[np.floating]
_WATERTIGHT = "no ray gets through"
PLACES = ("plain", "turned and far", "stretched and mirrored", "small")
_CUSTOM = Rule("hits return the custom data and index of each of many instances", WGPU, "wgpu's raytracing API")
_EXTREME = Rule(
    "triangles of sizes 1e-6 to 1e6 are hit up to 1e6 and 100,000 sizes from the origin", VULKAN, "Ray Traversal"
)
_THIN = Rule("t of triangles a thousandth as wide as long", SUITE, "ray offsets")
_THIN_HIT = Rule("rays at the middle of such triangles hit them, or what stands before", VULKAN, "Ray Traversal")
_NOT_FINITE = Rule("only invalid rays (NaN, infinity, no direction, empty range) hit nothing", SUITE, "ray_query.glsl")
_REPLACED = Rule("Vulkan gets a ray that hits nothing in place of each invalid ray", SUITE, "ray_query.glsl")
_CAUGHT = Rule("the debug build counts each invalid ray", SUITE, "ray_query.glsl")
NOT_FINITE_RULES = (_NOT_FINITE, _REPLACED, _CAUGHT)
_ONE: Shapes = {"one": [Triangles(np.array([[(-1, -1, 0), (1, -1, 0), (0, 1.5, 0)]]))]}
_INVALID_RAY = next(row for row, text in enumerate(rt.RULES) if text.startswith("a ray with NaN"))


def _place(name: str) -> NDArray[np.float64]:
    matrix = IDENTITY.copy()
    if name == "turned and far":
        matrix[:, :3] = random_rotation(np.random.default_rng(3))
        matrix[:, 3] = 100, -30, 50
    elif name == "stretched and mirrored":
        matrix[:, :3] = random_rotation(np.random.default_rng(4)) @ np.diag((-10, 0.1, 1.0))
    elif name == "small":
        matrix[:, :3] *= 1e-3
    return matrix


def measure_watertight(shaders: ShaderRunner) -> Iterator[Measurement]:
    """Traces rays at edges and vertices: from the inside of a closed surface, and at a fan of triangles."""
    random = np.random.default_rng(7)
    # A fan of 200 triangles around one vertex, with uneven angles and lengths.
    angles = np.cumsum(random.uniform(0.2, 1.0, 200))
    angles *= 2 * np.pi / angles[-1]
    # The fan is flat, so that rays from above meet no triangle edge-on: there, a ray beside an edge may miss it.
    rim = np.stack([np.cos(angles), np.sin(angles), 0.2 * np.sin(3 * angles) - 0.2], 1)
    rim = rim * random.uniform(0.5, 2, (200, 1)) + (0.1, 0.2, 0.3)
    apex = np.tile((0.1, 0.2, 0.3), (200, 1))
    fan = np.stack([apex, rim, np.roll(rim, -1, axis=0)], 1).astype(np.float32)
    ball = bumpy_ball(64, 0.05)
    shapes = {"ball": [Triangles(ball)], "fan": [Triangles(fan)]}
    targets: dict[str, Target] = {
        "closed surface: edges": ("ball", _edge_points(ball, np.linspace(0.05, 0.95, 11)), (0.05, -0.1, 0.02)),
        "closed surface: vertices": ("ball", np.unique(ball.reshape(-1, 3), axis=0), (0.05, -0.1, 0.02)),
        "fan: edges": ("fan", _edge_points(fan, np.linspace(0.05, 0.95, 64), [(0, 1)]), (0.1, 0.2, 2.0)),
        "fan: vertex": ("fan", np.tile(fan[0, 0], (10_000, 1)), (0.1, 0.2, 2.0)),
    }
    # From inside a closed surface each ray must hit. Rays that miss went between two triangles.
    through = dict.fromkeys(targets, 0)
    for place in PLACES:
        matrix = Placement("ball", _place(place)).matrix
        for shape in shapes:
            with Structures(shaders.device, shapes, [Placement(shape, matrix)]) as structures:
                for name, (_, points, eye) in _of_shape(targets, shape):
                    origins = random.normal(size=points.shape) * 0.05 + eye
                    directions = transform_directions(matrix, points - origins)
                    hits = trace(shaders, structures.tlas, transform_points(matrix, origins), directions)
                    through[name] += int((hits["t"] < 0).sum())
    for name, (_, points, _) in targets.items():
        rule = Rule(f"{_WATERTIGHT}: {name}", VULKAN, "Ray Traversal: Watertightness")
        yield Measurement(rule, float(through[name]), unit=f"of {len(points) * len(PLACES):,}")


# The shape that rays are aimed at, the points on it, and where the rays come from.
Target = tuple[str, Floats, tuple[float, float, float]]


def _of_shape(targets: Mapping[str, Target], shape: str) -> list[tuple[str, Target]]:
    return [(name, target) for name, target in targets.items() if target[0] == shape]


def _edge_points(corners: Floats, along: Floats, edges: Sequence[tuple[int, int]] = ((0, 1), (1, 2), (2, 0))) -> Floats:
    """Points on the edges of triangles; `along` gives their positions, from 0 to 1."""
    corners = corners.astype(np.float64)
    part = along[:, None, None]
    points = [corners[:, i] * (1 - part) + corners[:, j] * part for i, j in edges]
    return np.concatenate(points).reshape(-1, 3)


def measure_many_instances(shaders: ShaderRunner, count: int) -> Iterator[Measurement]:
    """Traces a ray from close by at each of many small, scattered triangles."""
    random = np.random.default_rng(9)
    # 0 without acceleration structures.
    count = min(count, int(shaders.device.properties.acceleration.maxInstanceCount) or count)
    side = int(np.ceil(count ** (1 / 3)))
    places = np.stack(np.unravel_index(np.arange(count), (side, side, side)), 1) * 4.0
    places = places[spatial_order(places)]
    custom = (np.arange(count) * 2654435761) & 0xFFFFFF  # Knuth's multiplicative hash spreads the 24 bits
    placed = []
    origins = []
    directions = []
    for at, data in zip(places, custom, strict=True):
        matrix = np.concatenate([random_rotation(random) * random.choice((-1, 1)), at[:, None]], axis=1)
        placed.append(Placement("one", matrix, custom=int(data)))
        origins.append(at + matrix[:, 2] * 1.5)
        directions.append(-matrix[:, 2])
    hits = build_and_trace(shaders, _ONE, placed, np.array(origins), np.array(directions))
    wrong = (hits["instance"] != np.arange(count)) | (hits["custom_data"] != custom) | (hits["t"] < 0)
    wrong |= np.abs(hits["t"] - 1.5) > 1e-3
    yield Measurement(_CUSTOM, float(wrong.sum()), unit=f"of {count:,}")


def _extreme_cases() -> Iterator[tuple[float, float, float]]:
    """Sizes, stretches and distances from the origin, in meters.

    A float32 ray can't be aimed at a triangle that lies farther off than 100,000 times its narrow side."""
    for exponent, stretch, far in itertools.product(range(-6, 7), (1.0, 1e3, 1e-3), (0.0, 1.0, 100.0, 1e4, 1e6)):
        size = 10.0**exponent
        if far <= 1e5 * size * min(stretch, 1.0):
            yield size, stretch, far


def measure_extreme_transforms(shaders: ShaderRunner) -> Iterator[Measurement]:
    """Compare t with float64: relative to the rounding of world-space rays, and in meters for three sizes."""
    random = np.random.default_rng(12)
    relative = (0.0, "")
    missed = []
    meters = dict.fromkeys((1e-6, 1.0, 1e6), (0.0, 0.0, 0.0, ""))  # error / bar, error in meters, bar, case
    for size, stretch, far in _extreme_cases():
        matrix = np.zeros((3, 4))
        matrix[:, :3] = random_rotation(random) @ np.diag((1.0, stretch, 1.0)) * size
        matrix[:, 3] = np.array((1.0, -0.6, 0.3)) * far
        placed = Placement("one", matrix)
        exact = placed.matrix
        origins = transform_points(exact, np.array([(0.1, 0.05, 1.5)]))
        directions = transform_directions(exact, np.array([(0.02, -0.05, -1.0)]))
        label = f"size {size:g}, stretch {stretch:g}, place {far:g}"
        (hit,) = build_and_trace(shaders, _ONE, [placed], origins, directions)
        if not hit["t"] >= 0:
            missed.append(label)
            continue
        # In object space the triangle lies in z = 0, so t is the height of the origin over the descent of the ray.
        inverse = np.linalg.inv(exact[:, :3])
        origin = inverse @ (origins[0].astype(np.float32).astype(np.float64) - exact[:, 3])
        direction = directions[0].astype(np.float32).astype(np.float64)
        error = float(abs(hit["t"] + origin[2] / (inverse @ direction)[2]))
        # The error is relative to what cancels when the ray is moved to object space.
        relative = max(relative, (error / max(1.5, np.abs(inverse).max() * np.abs(exact).max()), label))
        if size in meters:
            off = error * float(np.linalg.norm(direction))
            # The factor allows for rays that meet stretched triangles at a slant, which magnifies rounding.
            bar = 256 * 2.0**-24 * float(max(np.abs(exact).max(), np.abs(origins).max()))
            meters[size] = max(meters[size], (off / bar, off, bar, label))
    yield count_wrong(_EXTREME, missed)
    rule = Rule(f"{_EXTREME.name}: t", VULKAN, _EXTREME.section)
    yield Measurement(rule, relative[0], 1e-6, "relative error", relative[1])
    for size, (_, off, bar, label) in meters.items():
        rule = Rule(f"size {size:g} at all these distances: error of the hit's position", VULKAN, _EXTREME.section)
        yield Measurement(rule, off, bar, "m", label)


def measure_thin_triangles(shaders: ShaderRunner) -> Iterator[Measurement]:
    """t of thin triangles at a distance of 1, against float64. An error of t lets rays meet the triangle they leave."""
    random = np.random.default_rng(13)
    shape = np.array([(-0.4, 0, 0), (0.6, 0, 0), (0, 1e-3, 0)])
    soup = [shape @ random_rotation(random) + random.normal(size=3) for _ in range(2000)]
    corners = np.array(soup, np.float32).astype(float)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    directions = (0.3 * random.normal(size=normals.shape) - normals).astype(np.float32)
    origins = (corners.mean(axis=1) - directions).astype(np.float32)
    hits = build_and_trace(shaders, {"soup": [Triangles(corners)]}, [Placement("soup")], origins, directions)
    exact = np.sum((corners[:, 0] - origins) * normals, axis=1) / np.sum(directions * normals, axis=1)
    missed = hits["t"] < 0
    own = hits["primitive"] == np.arange(len(corners))
    found = corners[np.minimum(hits["primitive"], len(corners) - 1)]
    # Solves origin + t direction = (1 - u - v) a + u b + v c for the triangle that each ray hit.
    edges = np.stack([found[:, 1] - found[:, 0], found[:, 2] - found[:, 0], -directions.astype(float)], -1)
    u, v, t = np.linalg.solve(edges, (origins - found[:, 0])[..., None])[..., 0].T
    # A triangle that the ray crosses in float64 too, up to a hundredth of its size, and not behind the aimed one.
    crossed = (np.minimum(np.minimum(u, v), 1 - u - v) > -0.01) & (t > 0) & (own | (t < exact))
    wrong = missed | ~crossed
    yield Measurement(_THIN_HIT, float(wrong.sum()), unit=f"of {len(corners):,}")
    errors = np.abs(hits["t"] - exact)[own & ~wrong]
    yield Measurement(_THIN, float(errors.max(initial=0)), 1e-6, "relative error")


def measure_not_finite(shaders: ShaderRunner) -> Iterator[Measurement]:
    """Traces rays at a wall and a box, each made invalid by another component."""
    wall = np.array([[(-9, -9, 0), (9, -9, 0), (0, 9, 0)]])
    shapes: Shapes = {"wall": [Triangles(wall)], "box": [Boxes(np.array([[(-1, -1, 1), (1, 1, 2)]]))]}
    # Eight numbers of a ray; all but the first two rays are invalid.
    changes: dict[str, dict[int, float]] = {"a plain ray": {}, "an endless ray": {7: np.inf}}
    names = ("origin.x", "origin.y", "origin.z", "dir.x", "dir.y", "dir.z", "t_min", "t_max")
    for i, name in enumerate(names):
        changes |= {f"{name} = {value}": {i: value} for value in (np.nan, np.inf, -np.inf)}
    del changes["t_max = inf"]
    changes |= {
        "dir = 0": {5: 0.0},
        "t_max < t_min": {6: 9.0, 7: 1.0},
        "t_max < 0": {7: -1.0},
        "t_min < 0": {6: -1.0},
        "t_min = t_max = inf": {6: np.inf, 7: np.inf},
        "t_min = -inf, t_max = inf": {6: -np.inf, 7: np.inf},
    }
    table = np.tile(np.array((0.1, 0.2, 5.0, 0.0, 0.0, -1.0, 0.0, 100.0)), (len(changes), 1))
    for ray, change in zip(table, changes.values(), strict=True):
        ray[list(change)] = list(change.values())
    labels = list(changes)
    valid = np.arange(len(table)) < 2
    rays = np.zeros(len(table), shaders.element("conformance/probe", "probes"))
    rays["origin"] = table[:, :3]
    rays["direction"] = table[:, 3:6]
    rays["t_min"], rays["t_max"] = table[:, 6:].T
    rays["cull_mask"] = 0xFF
    with Structures(shaders.device, shapes, [Placement("wall"), Placement("box")]) as structures:
        released, _ = run_rays(shaders, structures, rays)
        caught, faults = run_rays(shaders, structures, rays, "debug build")
    wrong, missed = (np.flatnonzero((found["committed"]["kind"] != 0) != valid) for found in (released, caught))
    yield count_wrong(_NOT_FINITE, [labels[i] for i in wrong])
    replaced = np.column_stack([released[name] for name in ("world_origin", "world_direction", "t_min")])
    # The ray that ray_query.glsl puts in place of invalid ones: along z, from the origin, with an empty range.
    right = np.where(valid[:, None], table[:, :7].astype(np.float32), (0, 0, 0, 0, 0, 1, 0))
    passed_on = np.flatnonzero((replaced != right).any(axis=1))
    yield count_wrong(_REPLACED, [labels[i] for i in passed_on])
    miscounted = int(faults[_INVALID_RAY]) != (~valid).sum()
    yield count_wrong(_CAUGHT, [labels[i] for i in missed] + ["count"] * int(miscounted))
