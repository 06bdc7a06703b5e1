"""Lights that are added, removed or reordered between frames: the samples in the reservoirs stay valid."""

from __future__ import annotations

import numpy as np
import pytest
from support.direct_light import direct_light, direct_renderer
from support.replication import replicate
from support.seeded_bugs import Bug, bug_tests
from support.statistics import replicates

import solari_vk as sv
from solari_vk.bound.constants import NO_INDEX
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte, place

# The colors have equal luminance, so that each lamp is chosen equally often.
RED, GREEN, BLUE = (9.0 * np.eye(3) / np.array((0.2126, 0.7152, 0.0722))).tolist()
SIZE, RUNS = (48, 48), 16
# In a picture this small, the default radius of 30 pixels would make all pixels share a few samples.
SETTINGS = {"di_spatial_radius": 4.0}
QUAD = shapes.quad((0, 0, 0), (0.3, 0, 0), (0, 0, 0.3))


def hang(color, x, scale=1.0):
    """A lamp at height 2 that emits downwards."""
    return sv.Instance(mesh=QUAD, material=lamp(color), transform=place((scale, 1, scale), (x, 2, 0)))


def floor_without_light():
    ground = sv.Instance(mesh=shapes.quad((0, 0, 0), (0, 0, 3), (3, 0, 0)), material=matte(0.5))
    camera = sv.Camera.look_at((0, 1.9, 0), (0, 0, 0), up=(0, 0, 1), vertical_fov=1.4)
    return sv.Scene(ground, camera)


def means(renderer, scene, frames):
    """The mean direct light of each frame, (frames, 3)."""
    return np.stack([direct_light(renderer.render(scene.camera)).mean(axis=(0, 1)) for _ in range(frames)])


def settled(device, scene):
    """The scene's mean direct light (3,), rendered without reuse between frames or pixels."""
    with direct_renderer(device, scene, SIZE, di_temporal=False, di_spatial=False) as renderer:
        return means(renderer, scene, 128).mean(axis=0)


def assert_agree(observations, expected, bar):
    rejected, within = replicates(observations / expected, np.ones(len(expected)), bar)
    assert rejected == 0, (observations.mean(axis=0), expected)
    assert within, (observations.mean(axis=0), expected)


def test_removed_lights_are_dark_at_once(device):
    """Removes the first of three lights, whose index the third one takes.

    The next frame has none of the removed light, and the others' light is neither missing nor doubled.
    """
    floor = floor_without_light()
    lamps = [floor.add(hang(color, x)) for color, x in ((RED, -1), (GREEN, 0), (BLUE, 1))]
    with direct_renderer(device, floor, SIZE, **SETTINGS) as renderer:

        def run():
            if lamps[0] not in floor.instances:
                floor.add(lamps[0])
            assert (means(renderer, floor, 12)[-1] > 0).all()
            floor.remove(lamps[0])
            after = means(renderer, floor, 6)
            assert (after[:, 0] == 0).all(), "a removed light still shines"
            return after.mean(axis=0)[1:]

        observations = replicate(renderer, RUNS, run)
    assert_agree(observations, settled(device, floor)[1:], 0.04)


@pytest.mark.slow
def test_added_lights_are_bright_at_once(device):
    """An added light has its full brightness from its first frame on, and the other light keeps its brightness."""
    floor = floor_without_light()
    floor.add(hang(RED, -1))
    new = hang(GREEN, 1)
    with direct_renderer(device, floor, SIZE, **SETTINGS) as renderer:

        def run():
            means(renderer, floor, 12)
            floor.add(new)
            after = means(renderer, floor, 2).mean(axis=0)[:2]
            floor.remove(new)
            return after

        observations = replicate(renderer, RUNS, run)
    floor.add(new)
    assert_agree(observations, settled(device, floor)[:2], 0.04)


@pytest.mark.slow
def test_lights_that_change_indices_keep_their_samples(device):
    """Each frame removes one of nine lights and adds it again; all keep the right brightness."""
    floor = floor_without_light()
    lamps = [floor.add(hang(color, 0.5 * i - 2)) for i, color in enumerate((RED, GREEN, BLUE) * 3)]
    with direct_renderer(device, floor, SIZE, **SETTINGS) as renderer:

        def run():
            means(renderer, floor, 9)
            observed = []
            for gone in lamps:
                floor.remove(gone)
                floor.add(gone)  # at the end of the list, with a new id
                observed.append(means(renderer, floor, 1)[0])
            return np.mean(observed, axis=0)

        observations = replicate(renderer, RUNS, run)
    assert_agree(observations, settled(device, floor), 0.04)


@pytest.mark.slow
def test_a_light_that_grows_is_right_at_once(device):
    """Samples of earlier frames stay valid when the area of their light changes."""
    floor = floor_without_light()
    only = floor.add(hang(GREEN, 0.3))
    with direct_renderer(device, floor, SIZE, **SETTINGS) as renderer:

        def run():
            only.transform = place((0.25, 1, 0.25), (0.3, 2, 0))
            means(renderer, floor, 8)
            only.transform = place(1.0, (0.3, 2, 0))
            return means(renderer, floor, 1)[0][1:2]

        observations = replicate(renderer, RUNS, run)
    assert_agree(observations, settled(device, floor)[1:2], 0.02)


@pytest.mark.slow
def test_lights_stay_right_while_another_changes_their_probability(device):
    """In each frame another lamp, which shines away from the floor, becomes 10,000 times as bright or dark: reservoirs
    of earlier frames chose the floor's lamp three times as often as this frame, or seldomer."""
    floor = floor_without_light()
    floor.add(hang(GREEN, 0.3))
    above = floor.add(hang(RED, 0))
    above.transform = place((1, -1, 1), (0, 4, 0))
    with direct_renderer(device, floor, SIZE, **SETTINGS) as renderer:

        def run():
            observed = []
            for frame in range(16):
                above.material.emissive = np.array(RED) * (1e4 if frame % 2 else 1.0)
                observed.append(means(renderer, floor, 1)[0])
            return np.mean(observed[4:], axis=0)[1:2]

        observations = replicate(renderer, RUNS, run)
    assert_agree(observations, settled(device, floor)[1:2], 0.02)


def test_all_lights_are_removed_and_added_again(device):
    floor = floor_without_light()
    sun = sv.DirectionalLight(direction=(0.1, -1, 0), illuminance=3.0, angular_diameter=0.3)
    light = floor.add(hang(GREEN, 0))
    with direct_renderer(device, floor, SIZE) as renderer:
        means(renderer, floor, 8)
        floor.remove(light)
        assert (means(renderer, floor, 3) == 0).all()
        floor.add(sun)
        shining = means(renderer, floor, 12)
        assert (shining > 0).all()
        floor.remove(sun)
        assert (means(renderer, floor, 2) == 0).all()
        floor.add(sun)
        np.testing.assert_allclose(means(renderer, floor, 12).mean(axis=0), shining.mean(axis=0), rtol=0.02)


def test_many_lights_shrink_to_one(device):
    """Samples of removed lights with high indices are dropped, and not mistaken for samples of another light."""
    floor = floor_without_light()
    lamps = [floor.add(hang(RED, 0.01 * i - 1.5, scale=0.1)) for i in range(299)]
    last = floor.add(hang(BLUE, 0))
    with direct_renderer(device, floor, SIZE) as renderer:
        assert (means(renderer, floor, 4)[:, 0] > 0).all()
        for gone in lamps:
            floor.remove(gone)
        after = means(renderer, floor, 12)
        held = renderer["di_reservoirs"]["light_sample"]["light_index"]
    assert last in floor.instances
    assert set(np.unique(held)) <= {0, NO_INDEX}
    assert (after[:, :2] == 0).all()
    assert (after[:, 2] > 0).all()


TARGET = "passes/solari019/restir_di/target.glsl"
test_a_seeded_bug_is_noticed = bug_tests({
    "removed lights: reservoirs keep the old index": (test_removed_lights_are_dark_at_once, Bug(
        "passes/solari019/restir_di/initial_and_temporal.glsl", "load_previous_reservoir",
        "DiReservoir reservoir = correct(pixel); "
        "uint index = di_reservoirs.at[pixel.y * camera.size.x + pixel.x].light_sample.light_index; "
        # An index beyond the lights may end the process.
        "if (index != NO_INDEX) { reservoir.light_sample.light_index = min(index, scene_info.light_count - 1u); } "
        "return reservoir;")),
    "added lights: taken for old ones": (test_added_lights_are_bright_at_once, Bug(
        TARGET, "previous_di_target", "return di_target(surface, reservoir);")),
    "changed probabilities: weights of another frame": (
        test_lights_stay_right_while_another_changes_their_probability, Bug(
            "scene/sampling.glsl", "light_sample_probability", "return 1.0;")),
})  # fmt: skip
