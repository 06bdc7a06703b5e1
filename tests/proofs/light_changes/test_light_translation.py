"""Lights that are added, removed or reordered between frames: the samples in the reservoirs stay valid."""

from __future__ import annotations

import numpy as np
import pytest
from support.frames import direct_light, direct_renderer, replicate
from support.seeded_bugs import Bug, bug_tests
from support.statistics import compare_runs

import solari_vk as sv
from solari_vk.bound.constants import NO_INDEX
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte, place

# The colors have equal luminance, so that each lamp is chosen equally often.
RED, GREEN, BLUE = (9.0 * np.eye(3) / np.array((0.2126, 0.7152, 0.0722))).tolist()
SIZE, RUNS = (48, 48), 16
QUAD = shapes.quad((0, 0, 0), (0.3, 0, 0), (0, 0, 0.3))


def hang(color, x, scale=1.0):
    """A lamp at height 2 that emits downwards."""
    return sv.Instance(mesh=QUAD, material=lamp(color), transform=place((scale, 1, scale), (x, 2, 0)))


def floor_under(*lights):
    ground = sv.Instance(mesh=shapes.quad((0, 0, 0), (0, 0, 3), (3, 0, 0)), material=matte(0.5))
    camera = sv.Camera.look_at((0, 1.9, 0), (0, 0, 0), up=(0, 0, 1), vertical_fov=1.4)
    return sv.Scene(ground, camera, *lights)


def means(renderer, frames):
    """The mean direct light of each frame, (frames, 3)."""
    return np.stack([direct_light(renderer.render()).mean(axis=(0, 1)) for _ in range(frames)])


def check_colors(device, scene, run, bar=0.02, colors=np.s_[:]):
    """Requires that the light (3,) of `run(renderer)`, by many seeds, is the light that the scene has in the end when
    it is rendered without reuse between frames or pixels."""
    # In a picture this small, the default radius of 30 pixels would make all pixels share a few samples.
    with direct_renderer(device, scene, SIZE, di_spatial_radius=4.0) as renderer:
        observed = replicate(renderer, RUNS, lambda: run(renderer))[:, colors]
    with direct_renderer(device, scene, SIZE, di_temporal=False, di_spatial=False) as renderer:
        expected = means(renderer, 128).mean(axis=0)[colors]
    assert compare_runs(observed / expected, np.ones(len(expected)), bar) == (0, True), (
        observed.mean(axis=0),
        expected,
    )


def check_removed(device):
    """Removes the first of three lights, whose index the third one takes: the next frame has none of its light, and the
    others' light is neither missing nor doubled."""
    scene = floor_under(*(hang(color, x) for color, x in ((RED, -1), (GREEN, 0), (BLUE, 1))))
    first = scene.instances[1]

    def run(renderer):
        if first not in scene.instances:
            scene.add(first)
        assert (means(renderer, 12)[-1] > 0).all()
        scene.remove(first)
        after = means(renderer, 6)
        assert (after[:, 0] == 0).all(), "a removed light still shines"
        return after.mean(axis=0)

    check_colors(device, scene, run, 0.04, np.s_[1:])


def check_added(device):
    """An added light has its full brightness from its first frame on, and the other light keeps its brightness."""
    scene, new = floor_under(hang(RED, -1)), hang(GREEN, 1)

    def run(renderer):
        if new in scene.instances:
            scene.remove(new)
        means(renderer, 12)
        scene.add(new)
        return means(renderer, 2).mean(axis=0)

    check_colors(device, scene, run, 0.04, np.s_[:2])


def check_new_indices(device):
    """Each frame removes one of nine lights and adds it again; all keep the right brightness."""
    lamps = [hang(color, 0.5 * i - 2) for i, color in enumerate((RED, GREEN, BLUE) * 3)]
    scene = floor_under(*lamps)

    def run(renderer):
        means(renderer, 9)
        observed = []
        for gone in lamps:
            scene.remove(gone)
            scene.add(gone)  # at the end of the list, with a new id
            observed.append(means(renderer, 1)[0])
        return np.mean(observed, axis=0)

    check_colors(device, scene, run, 0.04)


def check_growth(device):
    """Samples of earlier frames stay valid when the area of their light changes."""
    only = hang(GREEN, 0.3)

    def run(renderer):
        only.transform = place((0.25, 1, 0.25), (0.3, 2, 0))
        means(renderer, 8)
        only.transform = place(1.0, (0.3, 2, 0))
        return means(renderer, 1)[0]

    check_colors(device, floor_under(only), run, colors=np.s_[1:2])


def check_changed_probability(device):
    """In each frame another lamp, which shines away from the floor, becomes 10,000 times as bright or dark: reservoirs
    of earlier frames chose the floor's lamp three times as often as this frame, or seldomer."""
    above = sv.Instance(mesh=QUAD, material=lamp(RED), transform=place((1, -1, 1), (0, 4, 0)))

    def run(renderer):
        observed = []
        for frame in range(16):
            above.material.emissive = np.array(RED) * (1e4 if frame % 2 else 1.0)
            observed.append(means(renderer, 1)[0])
        return np.mean(observed[4:], axis=0)

    check_colors(device, floor_under(hang(GREEN, 0.3), above), run, colors=np.s_[1:2])


@pytest.mark.parametrize(
    "check",
    [
        check_removed,
        *(
            pytest.param(check, marks=pytest.mark.slow)
            for check in (check_added, check_new_indices, check_growth, check_changed_probability)
        ),
    ],
)
def test_light_is_right_at_once(device, check):
    check(device)


def test_all_lights_are_removed_and_added_again(device):
    scene = floor_under(hang(GREEN, 0))
    light, sun = scene.instances[1], sv.DirectionalLight((0.1, -1, 0), illuminance=3.0, angular_diameter=0.3)
    with direct_renderer(device, scene, SIZE) as renderer:
        means(renderer, 8)
        scene.remove(light)
        assert (means(renderer, 3) == 0).all()
        scene.add(sun)
        shining = means(renderer, 12)
        assert (shining > 0).all()
        scene.remove(sun)
        assert (means(renderer, 2) == 0).all()
        scene.add(sun)
        np.testing.assert_allclose(means(renderer, 12).mean(axis=0), shining.mean(axis=0), rtol=0.02)


def test_many_lights_shrink_to_one(device):
    """Samples of removed lights with high indices are dropped, and not mistaken for samples of another light."""
    lamps = [hang(RED, 0.01 * i - 1.5, scale=0.1) for i in range(299)]
    scene = floor_under(*lamps, hang(BLUE, 0))
    with direct_renderer(device, scene, SIZE) as renderer:
        assert (means(renderer, 4)[:, 0] > 0).all()
        for gone in lamps:
            scene.remove(gone)
        after = means(renderer, 12)
        held = renderer["di_reservoirs"]["light_sample"]["light_index"]
    assert set(np.unique(held)) <= {0, NO_INDEX}
    assert (after[:, :2] == 0).all()
    assert (after[:, 2] > 0).all()


test_a_seeded_bug_is_noticed = bug_tests(
    {
        "removed lights: reservoirs keep the old index": (
            check_removed,
            Bug(
                "passes/solari019/restir_di/initial_and_temporal.glsl",
                "load_previous_reservoir",
                "DiReservoir reservoir = correct(pixel); "
                "uint index = di_reservoirs.at[pixel.y * camera.size.x + pixel.x].light_sample.light_index; "
                # An index beyond the lights may end the process.
                "if (index != NO_INDEX) { "
                "reservoir.light_sample.light_index = min(index, scene_info.light_count - 1u); } "
                "return reservoir;",
            ),
        ),
        "added lights: taken for old ones": (
            check_added,
            Bug(
                "passes/solari019/restir_di/target.glsl", "previous_di_target", "return di_target(surface, reservoir);"
            ),
        ),
        "changed probabilities: weights of another frame": (
            check_changed_probability,
            Bug("scene/sampling.glsl", "light_sample_probability", "return 1.0;"),
        ),
    }
)
