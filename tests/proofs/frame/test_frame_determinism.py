"""The seed determines whole frames bit by bit, for any order of threads and any number of barriers."""

from __future__ import annotations

import pytest
from support.frames import denoised_first, differing_outputs, make_renderer, snapshot

import solari_vk as sv

FRAMES = 8
SCENES = {"cornell_box": {}, "many_lights": {"box_count": 300, "sphere_count": 49}}


def take(device, name, lighting, seed=3):
    """The outputs of FRAMES frames of a new renderer and of 3 frames after a reset."""
    scene = sv.builtin(name, **SCENES[name])
    # The map has its default size: in an overfull map, the order of threads decides which keys find no entry.
    with make_renderer(device, scene, seed=seed, world_cache_cells=1 << 20, **lighting) as renderer:
        frames = [snapshot(renderer.render(scene.camera)) for _ in range(FRAMES)]
        assert renderer["world_cache/insert_failures"] == 0
        renderer.reset()
        return frames + [snapshot(renderer.render(scene.camera)) for _ in range(3)]


@denoised_first
@pytest.mark.parametrize("name", ["cornell_box", pytest.param("many_lights", marks=pytest.mark.slow)])
def test_one_seed_gives_the_same_bits(device, name, lighting, monkeypatch):
    """Every output has the same bits in another new renderer and with a barrier before every pass, also after a reset.
    The fixture `device` checks that validation and synchronization validation report nothing."""
    first = take(device, name, lighting)
    for barriers in ("", "all"):
        monkeypatch.setenv("SOLARI_VK_BARRIERS", barriers)
        for index, (frame, other) in enumerate(zip(first, take(device, name, lighting), strict=True)):
            assert not differing_outputs(frame, other), (
                f"frame {index}, barriers {barriers!r}: {differing_outputs(frame, other)}"
            )


def test_another_seed_gives_other_noise(device):
    pictures = []
    with make_renderer(device, sv.builtin("cornell_box"), jitter=False) as renderer:
        for renderer.seed in (5, 6):
            renderer.reset()
            renderer.frame_count = 0
            pictures.append(renderer.render()["radiance"].tobytes())
    assert pictures[0] != pictures[1]
