"""Acceleration structures: ways of building that must agree, vertex formats, indices, and empty structures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.spatial_order import spatial_order
from solari_vk.gpu.acceleration.blas_builds import build_blases
from solari_vk.lab.conformance.outcomes import VULKAN, WGPU, Measurement, Rule, count_wrong
from solari_vk.lab.shader_runner import ShaderRunner
from solari_vk.lab.structures import (
    BUILD_MODES,
    COMPACTED,
    FRESH,
    Boxes,
    Placement,
    Shapes,
    Structures,
    Triangles,
    build_and_trace,
    bumpy_ball,
    instance_records,
    random_rotation,
    trace,
    translation,
)

_API = "wgpu's raytracing API"
_COMPACTION = "Blas compaction"
_STRUCTURES = "Acceleration Structures"
_INACTIVE = "Inactive Primitives and Instances"
_DOWN = np.array((0.0, 0.0, -1.0))
_FLAT = np.array([[(0, 0, 0), (2, 0, 0), (0, 2, 0)]], np.float64)
_ONE: Shapes = {"one": [Triangles(_FLAT)]}
Damage = Callable[[np.ndarray], None]


def _row(count: int, height: float = 1.0) -> NDArray[np.float64]:
    """The origins of rays straight down at _FLAT and at copies 4 apart."""
    return np.array([(4.0 * i + 0.5, 0.5, height) for i in range(count)])


def _heap() -> tuple[Shapes, list[Placement], NDArray[np.float64], NDArray[np.float64]]:
    """Many rotated balls that intersect each other, and rays through them."""
    random = np.random.default_rng(20)
    shapes: Shapes = {
        "ball": [Triangles(bumpy_ball(16, 0.1))],
        "two": [Triangles(bumpy_ball(8, 0.3) * 0.5), Triangles(bumpy_ball(8, 0.3), opaque=False)],
    }
    places = random.uniform(-5, 5, (150, 3))
    placed = []
    for i, at in enumerate(places[spatial_order(places)]):
        matrix = np.concatenate([random_rotation(random) @ np.diag(random.uniform(0.3, 1.5, 3)), at[:, None]], axis=1)
        placed.append(Placement(("ball", "two")[i % 2], matrix, custom=i * 7919 & 0xFFFFFF))
    origins = random.uniform(-7, 7, (20_000, 3))
    return shapes, placed, origins, random.uniform(-4, 4, (20_000, 3)) - origins


def measure_build_modes(shaders: ShaderRunner, damage: Damage | None = None) -> Iterator[Measurement]:
    """The same rays meet the same triangles at the same t, however the structures were built. Also compares sizes."""
    shapes, placed, origins, directions = _heap()
    hits: dict[str, np.ndarray] = {}
    sizes: dict[str, tuple[int, int]] = {}
    for mode in (*BUILD_MODES, "fast build"):
        known = mode in BUILD_MODES
        seeded = damage if mode != FRESH else None
        with Structures(
            shaders.device, shapes, placed, mode if known else FRESH, fast_trace=known, damage=seeded
        ) as structures:
            hits[mode] = trace(shaders, structures.tlas, origins, directions)
            sizes |= {name: (size, structures.blases[name].size) for name, size in structures.sizes.items()}
    right = hits.pop(FRESH)
    documents = {"compacted": (WGPU, _COMPACTION)}
    for mode, found in hits.items():
        # Another order of the triangles rounds differently.
        same_t = np.abs(found["t"] - right["t"]) <= 1e-5 * np.abs(right["t"])
        keys = ("custom_data", "instance", "geometry", "primitive")
        same = np.logical_and.reduce([found[key] == right[key] for key in keys])
        # Where two surfaces lie at one distance, either may be the hit.
        wrong = ~same_t | (~same & (np.abs(found["t"] - right["t"]) > 0))
        source = documents.get(mode, (VULKAN, _STRUCTURES))
        rule = Rule(f"hits equal those of a fresh structure: {mode}", *source)
        yield Measurement(rule, float(wrong.sum()), unit=f"of {len(right):,}")
    rule = Rule("a compacted Blas is not larger than before", WGPU, _COMPACTION)
    # The bar is 1, since a driver may have nothing to compact.
    yield Measurement(rule, max(after / before for before, after in sizes.values()), 1.0, "of the size before")
    # Rays that all hit, or all miss, would agree whatever the structures are.
    hit_share = float((right["t"] >= 0).mean())
    assert 0.1 < hit_share < 1, f"the heap must be hit, and missed, not {hit_share:.2f}"


def measure_formats(shaders: ShaderRunner) -> Iterator[Measurement]:
    """The same triangles give the same hits with and without indices, strides and transforms."""
    ball = bumpy_ball(12, 0.2)
    moved = translation(0.25, -0.5, 0.125)
    variants = {
        "no indices": Triangles(ball),
        "uint16": Triangles(ball, index_dtype=np.uint16),
        "uint32": Triangles(ball, index_dtype=np.uint32),
        "stride 20": Triangles(ball, stride=20),
        "uint16, stride 32": Triangles(ball, index_dtype=np.uint16, stride=32),
        "not opaque": Triangles(ball, opaque=False),
        "transform": Triangles(ball - moved[:, 3].astype(np.float32), transform=moved),
        "transform, uint32": Triangles(ball - moved[:, 3].astype(np.float32), transform=moved, index_dtype=np.uint32),
    }
    random = np.random.default_rng(21)
    origins = random.uniform(-1.5, 1.5, (4000, 3))
    directions = random.uniform(-0.7, 0.7, (4000, 3)) - origins
    right = None
    wrong = []
    for name, variant in variants.items():
        hits = build_and_trace(shaders, {"one": [variant]}, [Placement("one")], origins, directions)
        right = hits if right is None else right
        # A transform rounds vertices, so that a ray at an edge may hit the neighbor.
        allowed = 4 if variant.transform is not None else 0
        differs = (hits["primitive"] != right["primitive"]) | (np.abs(hits["t"] - right["t"]) > 1e-5)
        if differs.sum() > allowed:
            wrong.append(f"{name}: {differs.sum()} rays")
    rule = Rule("index formats, vertex strides and geometry transforms give the same hits", VULKAN, _STRUCTURES)
    yield count_wrong(rule, wrong)


def measure_indices(shaders: ShaderRunner, damage: Damage | None = None) -> Iterator[Measurement]:
    """Each bit of custom_data (24) and of masks (8) by itself."""
    # Each bit alone, none, all, and two patterns.
    customs = [1 << bit for bit in range(24)] + [0, 0xFFFFFF, 0xAAAAAA, 0x555555]
    masks = [1 << bit for bit in range(8)]
    fields = [(custom, 0xFF) for custom in customs] + [(0, mask) for mask in masks]
    placed = [Placement("one", translation(4.0 * i), *field) for i, field in enumerate(fields)]
    hits = build_and_trace(shaders, _ONE, placed, _row(len(placed)), _DOWN, damage=damage)
    wrong = [hex(custom) for custom, hit in zip(customs, hits, strict=False) if hit["custom_data"] != custom]
    yield count_wrong(Rule("TlasInstance.custom_data keeps its 24 bits", WGPU, _API), wrong)
    lost = [hex(mask) for mask, hit in zip(masks, hits[len(customs) :], strict=True) if hit["t"] < 0]
    yield count_wrong(Rule("TlasInstance.mask keeps its 8 bits", WGPU, _API), lost)


def measure_nothing(shaders: ShaderRunner) -> Iterator[Measurement]:
    """Empty structures, degenerate triangles and NaN vertices are never hit."""
    empty = np.zeros((0, 3, 3))
    point = np.full((1, 3, 3), 0.5)
    line = np.array([[(0, 0, 0), (1, 1, 0), (2, 2, 0)]])
    gone = np.full((1, 3, 3), np.nan)
    shapes: Shapes = {
        "empty": [Triangles(empty)],
        "point": [Triangles(point)],
        "line": [Triangles(line)],
        "NaN": [Triangles(gone)],
        "no boxes": [Boxes(np.zeros((0, 2, 3)))],
        "one": [Triangles(_FLAT)],
    }
    random = np.random.default_rng(22)
    # Rays straight down, inside of the only triangle that is hit.
    origins = np.stack([*random.uniform(0.05, 0.9, (2, 64)), np.ones(64)], axis=1)
    cases: dict[str, list[Placement]] = {name: [Placement(name)] for name in shapes}
    cases |= {"no instances": [], "inactive": [Placement("one", active=False)], "mask 0": [Placement("one", mask=0)]}
    wrong = []
    for name, placed in cases.items():
        used = {item.shape: shapes[item.shape] for item in placed}
        hits = build_and_trace(shaders, used, placed, origins, _DOWN)
        if ((hits["t"] >= 0) != (name == "one")).any():
            wrong.append(name)
    rule = Rule("empty structures and degenerate or NaN primitives are never hit", VULKAN, _STRUCTURES)
    yield count_wrong(rule, wrong)


def measure_inactive_instances(shaders: ShaderRunner, damage: Damage | None = None) -> Iterator[Measurement]:
    """An instance that no ray can hit hides none of two others, wherever in the list it is."""
    others = [Placement("one"), Placement("one", translation(4))]
    wrong = []
    for name, gone in (("no Blas", Placement("one", active=False)), ("mask 0", Placement("one", mask=0))):
        for place in range(3):
            placed = [*others[:place], gone, *others[place:]]
            found = build_and_trace(shaders, _ONE, placed, _row(2), _DOWN, damage=damage)
            wrong += _hidden(f"{name} at {place}", place, np.where(found["t"] < 0, -1, found["instance"].astype(int)))
    name = "an instance without a Blas or with mask 0 hides no other instance"
    yield count_wrong(Rule(name, VULKAN, _INACTIVE), wrong)


def measure_inactive_primitives(shaders: ShaderRunner, kind: str) -> Iterator[Measurement]:
    """A triangle or a box ("triangle", "box") of NaN hides none of two others, wherever in the list it is."""
    wrong = []
    for place in range(3):
        corners = np.insert(np.concatenate([_FLAT, _FLAT + np.array((4, 0, 0))]), place, np.nan, axis=0)
        boxes = Boxes(np.stack([corners.min(1), corners.max(1)], axis=1))
        part = Triangles(corners) if kind == "triangle" else boxes
        found = build_and_trace(shaders, {"one": [part]}, [Placement("one")], _row(2), _DOWN, box_t=1.0)
        wrong += _hidden(f"NaN at {place}", place, np.where(found["t"] < 0, -1, found["primitive"].astype(int)))
    yield count_wrong(Rule(f"a {kind} of NaN hides no other {kind}", VULKAN, _INACTIVE), wrong)


def _hidden(what: str, place: int, found: np.ndarray) -> list[str]:
    """A line for each of two rays that missed its object. Of three objects, number `place` is one that rays can't hit;
    `found` has the objects' numbers that the rays at the other two have found."""
    others = np.delete(np.arange(3), place)
    return [f"{what} hides {other}" for other in others[found != others]]


def measure_many_blases(shaders: ShaderRunner, count: int) -> Iterator[Measurement]:
    """Builds many Blases in one call, in one batch and in several."""
    shapes = {f"blas {i}": [Triangles(_FLAT + np.array((0, 0, i % 7 * 0.5)))] for i in range(count)}
    placed = [Placement(name, translation(4.0 * i), custom=i) for i, name in enumerate(shapes)]
    expected = 5 - np.arange(count) % 7 * 0.5
    cases = (("one batch", 1 << 28, FRESH), ("many batches", 1 << 12, FRESH), ("compacted", 0, COMPACTED))
    for name, budget, mode in cases:
        with Structures(shaders.device, shapes, placed, mode) as structures:
            # The compacted structures are used as they are; the others are built again, in batches of this size.
            if budget:
                build_blases(shaders.device, list(structures.blases.values()), compact=False, scratch_budget=budget)
                addresses = {key: blas.address for key, blas in structures.blases.items()}
                structures.place(instance_records(placed, addresses))
            hits = trace(shaders, structures.tlas, _row(count, 5.0), _DOWN)
        wrong = (hits["custom_data"] != np.arange(count)) | (np.abs(hits["t"] - expected) > 1e-4)
        rule = Rule(f"many Blases are built in one call: {name}", WGPU, _API)
        yield Measurement(rule, float(wrong.sum()), unit=f"of {count}")


def measure_tlas_rebuilds(shaders: ShaderRunner, damage: Damage | None = None) -> Iterator[Measurement]:
    """A Tlas is built again with fewer, more and other instances."""
    placed = [Placement("one", translation(4.0 * i), custom=i) for i in range(64)]
    wrong = []
    with Structures(shaders.device, _ONE, placed) as structures:
        addresses = {"one": structures.blases["one"].address}
        # Fewer instances, none, others, and all again, in the memory of the first build.
        for step, chosen in enumerate((range(64), range(10), range(0), range(20, 60, 3), range(64))):
            members: Sequence[int] = list(chosen)
            records = instance_records([placed[i] for i in members], addresses)
            if damage is not None and len(records):
                damage(records)
            structures.place(records)
            hits = trace(shaders, structures.tlas, _row(64), _DOWN)
            seen = np.flatnonzero(hits["t"] >= 0).tolist()
            if seen != members or hits["custom_data"][seen].tolist() != members:
                wrong.append(f"build {step + 1}")
    yield count_wrong(Rule("a Tlas holds the instances that it was last built with, and no others", WGPU, _API), wrong)


def large_tlas_rule(count: int) -> Rule:
    """The rule that `measure_large_tlas` measures."""
    return Rule(f"each instance of a Tlas of {count:,} is hit", VULKAN, _STRUCTURES)


def measure_large_tlas(shaders: ShaderRunner, count: int, damage: Damage | None = None) -> Iterator[Measurement]:
    """More instances than 16 bits can number, with a ray at each."""
    side = int(np.ceil(np.sqrt(count)))
    places = np.stack(np.unravel_index(np.arange(count), (side, side)), 1) * 3.0
    # Drivers build large structures faster, and trace them faster, where neighbors in the list are neighbors in space.
    places = places[spatial_order(np.pad(places, ((0, 0), (0, 1))))]
    placed = [Placement("one", translation(x, y), custom=i & 0xFFFFFF) for i, (x, y) in enumerate(places)]
    origins = np.concatenate([places + 0.5, np.ones((count, 1))], axis=1)
    hits = build_and_trace(shaders, _ONE, placed, origins, _DOWN, damage=damage)
    wrong = (hits["custom_data"] != np.arange(count)) | (hits["instance"] != np.arange(count)) | (hits["t"] < 0)
    yield Measurement(large_tlas_rule(count), float(wrong.sum()), unit=f"of {count:,}")
