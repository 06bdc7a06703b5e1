"""Lists of the lights that cells see: they change no mean, equal seeds give equal bits, and lights may come and go."""

from __future__ import annotations

import numpy as np
from support.frames import differing, settle, snapshot
from support.measured import hold
from support.realtime import PATHS, make_renderer, measure_significance, read_radiance
from support.replication import observe_runs
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.conformance.rules import SUITE, Rule
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte, place

SAME = Rule("lists of the lights that cells see leave each tile of the picture as it is", SUITE, "Paths")
SIZE = (32, 32)
LISTS = {"paths_light_lists": True, "jitter": False}
LEAF_BITS = 20


def two_rooms():
    """Two rooms, open towards the camera, with twelve large lamps each, which BRDF samples find as often as light
    samples do. Walls hide each room's lamps from the other."""
    scene = sv.Scene(sv.Camera.look_at((0, 1, 6), (0, 1, 0), vertical_fov=0.7))
    ball, random = shapes.sphere(1.0, 8), np.random.default_rng(4)
    for left in (-2.05, 0.05):
        room = shapes.box((left, 0, -2), (left + 2, 2, 1), inward=True)
        scene.add(sv.Mesh(room.positions, room.triangles[:-2]), matte(0.6))
        for x, z in np.ndindex(3, 4):
            at = (left + 0.4 + 0.6 * x, random.uniform(0.4, 1.7), -1.6 + 0.6 * z)
            scene.add(ball, lamp(random.uniform(1, 20, 3)), place(0.12, at), name=f"lamp {left} {x} {z}")
    return scene


def measure_means(device):
    """Frames with lists and without, by independent runs; lights are found by light samples and by BRDF samples."""
    scene, found = two_rooms(), []
    for lists in (True, False):
        settings = {**LISTS, "paths_light_lists": lists, "world_cache_leak_prevention": "finest"}
        with make_renderer(device, scene, SIZE, passes=PATHS, **settings) as renderer:
            found.append(observe_runs(renderer, scene.camera, read_radiance, runs=12, warm_up=24, observed=48))
    yield measure_significance(SAME, *found)


def test_means_are_the_same(device):
    hold(measure_means(device))


def test_equal_seeds_give_equal_bits(device, monkeypatch):
    scene, taken = two_rooms(), []
    for barriers in ("", "all"):
        monkeypatch.setenv("SOLARI_VK_BARRIERS", barriers)
        with make_renderer(device, scene, SIZE, seed=3, world_cache_cells=1 << 20, **LISTS) as renderer:
            frames = [snapshot(renderer.render()) for _ in range(12)]
            lists = renderer["world_cache_light_lists"]
            lists = np.sort([entries.tobytes() for entries in lists["entries"] if entries.any()])
            taken.append((frames, lists))
    (frames, lists), (others, other_lists) = taken
    assert len(lists) > 20, "there are lists"
    assert np.array_equal(lists, other_lists)
    assert not [differing(frame, other) for frame, other in zip(frames, others, strict=True) if differing(frame, other)]


def listed_leaves(renderer):
    """The leaves in lists (N,)."""
    entries = renderer["world_cache_light_lists"]["entries"].ravel()
    return (entries[entries != 0] >> (32 - LEAF_BITS)).astype(np.int64) - 1


def check_removed_lights(device):
    """Lists never name a light that is gone, nor another one in its place: the lamps of the left room are removed, and
    the right room's keep their lists."""
    scene = two_rooms()
    with make_renderer(device, scene, SIZE, **LISTS) as renderer:
        settle(renderer, scene.camera, 16)
        first = renderer.binder.lights.leaf_ids[np.unique(listed_leaves(renderer))]
        gone = [instance for instance in scene if instance.name.startswith("lamp -")]
        removed = {renderer.binder.lights.ids[renderer.binder.lights.index(instance)] for instance in gone}
        for instance in gone:
            scene.remove(instance)
        frame = renderer.render()
        left = np.asarray(frame["diffuse_radiance"])[:, : SIZE[0] // 2 - 2]
        found = listed_leaves(renderer)
        assert len(found) > 0
        assert found.max() < renderer.binder.lights.leaves.count
        ids = renderer.binder.lights.leaf_ids[np.unique(found)]
        stayed = [number for number in first if number >> np.uint64(32) not in removed]
        assert set(stayed) <= set(ids), "the lists of the other room are as they were"
    assert left.max() < 1e-3, "a light that is gone still shines"


def test_lights_that_are_removed(device):
    check_removed_lights(device)


def test_lights_that_move(device):
    """Right after all lamps have moved, frames are as bright as without lists."""
    scene = two_rooms()
    lamps = [instance for instance in scene if instance.name.startswith("lamp")]
    before = [instance.transform.copy() for instance in lamps]
    means = []
    for lists in (True, False):
        with make_renderer(device, scene, SIZE, passes=PATHS, **{**LISTS, "paths_light_lists": lists}) as renderer:
            runs = []
            for seed in range(8):
                renderer.seed = seed
                renderer.reset()
                for instance, transform in zip(lamps, before, strict=True):
                    instance.transform = transform
                settle(renderer, scene.camera, 12)
                for instance, transform in zip(lamps, before, strict=True):
                    instance.transform = place(at=(-0.3, 0.1, 0.2)) @ transform
                runs.append(np.mean([read_radiance(renderer.render()) for _ in range(8)], axis=0))
            means.append(np.stack(runs))
    hold([measure_significance(SAME, *means)])


LISTS_FILE = "passes/world_cache/light_lists.glsl"
test_a_seeded_bug_is_noticed = bug_tests({
    SAME: (measure_means, Bug(LISTS_FILE, "listed_leaf_probability", """
        float probability = correct(row, receiver);
        LightList list = find_light_list(receiver, false);
        return find_entry(list, row) < list.count ? probability / list.share : probability;
        """)),  # the density without the tree's share
    "removed lights": (check_removed_lights, Bug(
        "passes/world_cache/update_light_lists.comp", "translated", "return min(leaf, scene_info.leaf_count - 1u);")),
})  # fmt: skip
