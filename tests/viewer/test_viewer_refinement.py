"""Pictures that are refined to the window's full size, scenes side by side, and scripts that render pictures again."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import solari_vk as sv
from solari_vk.cli import main
from solari_vk.viewer import refining
from solari_vk.viewer.picking import radiance_at

SIZE = (96, 64)


def until(viewer, holds, frames=400):
    for _ in range(frames):
        viewer.step()
        if holds():
            return
    raise AssertionError(f"after {frames} frames: {viewer.pictures.rendered_size}, {viewer.refining.count} samples")


def test_the_path_tracer_is_refined_to_the_full_size(open_viewer):
    viewer = open_viewer(scale="auto", overlay=False, fps=1e4)  # so that moving pictures are as small as can be
    viewer.refining.samples = 12
    viewer.run(frames=3)
    small = viewer.pictures.size
    assert small[0] < SIZE[0]
    until(viewer, lambda: viewer.refining.rests)
    assert viewer.pictures.size == SIZE
    assert viewer.refining.hides
    assert viewer._rendering.parts()[0].image.width == small[0], "the small picture, until the large one is better"
    until(viewer, lambda: viewer.refining.finished)
    assert "12 samples, finished" in viewer.window.title
    assert (viewer.capture() == viewer.pictures.pixels()).all()
    with sv.PathTracer(viewer.device, viewer.scene, SIZE) as tracer:
        expected = tracer.render(viewer.camera, samples=12)["radiance"]
    assert viewer.pictures.radiance() == pytest.approx(expected, rel=1e-4, abs=1e-5), "bands have no seams"
    count = viewer.pictures.reference.tracer.samples
    before = viewer.pictures.pixels().mean()
    viewer.act("brighter")
    viewer.run(frames=2)
    assert viewer.pictures.reference.tracer.samples == count, "a finished picture needs no more samples"
    assert viewer.pictures.pixels().mean() > before + 2
    viewer.camera_control.look(5, 0)
    viewer.step()
    assert viewer.pictures.size != SIZE
    until(viewer, lambda: viewer.refining.rests)
    viewer.edit(viewer.scene.materials[0], base_color=(0, 0, 1))
    viewer.step()
    assert viewer.pictures.size != SIZE, "an edit moves the picture too"


def test_bands_trace_what_whole_pictures_do(device):
    scene = sv.builtin("cornell_box")
    with sv.PathTracer(device, scene, (40, 30)) as tracer:
        expected = tracer.render(samples=3)["radiance"]
        tracer.resize((40, 30))
        tracer._band_rows = 8
        tracer._frame.rebuild(tracer._stages(tracer.size))
        seen = []
        while tracer.samples < 3:
            tracer.advance(max_samples=1, bands=1)
            seen.append((tracer.samples, *tracer.begun))
        assert (tracer["radiance"] == expected).all()
        assert seen == sorted(seen)
        assert len(seen) == 12, "four bands for each sample"
        tracer.advance(max_samples=1, bands=3)
        tracer.advance()
        assert (tracer.samples, tracer.begun) == (4, (0, 0)), "the rest of the picture"
        tracer.advance(max_samples=1, bands=1)
        tracer.advance(sv.Camera.look_at((0, 1, 3), (0, 1, 0)), 1, bands=1)
        assert (tracer.samples, tracer.begun) == (0, (1, 8)), "another view begins anew"


@pytest.mark.slow
def test_the_realtime_picture_is_refined_to_the_full_size(open_viewer, monkeypatch):
    viewer = open_viewer(scale="auto", mode="realtime", overlay=False, fps=1e4)
    viewer.run(frames=3)
    assert viewer.pictures.rendered_size[0] < SIZE[0]
    until(viewer, lambda: viewer.refining.finished)
    assert viewer.pictures.rendered_size == SIZE
    assert viewer.refining.count == refining.FRAMES
    frames = viewer.pictures.realtime.frame_count
    viewer.run(frames=3)
    assert viewer.pictures.realtime.frame_count == frames, "it rests"


def test_the_pixel_under_the_cursor(open_viewer):
    viewer = open_viewer(overlay=False)
    viewer.run(frames=3)
    radiance = viewer.pictures.radiance()
    for x, y in ((0, 0), (40, 30), (95, 63)):
        found = radiance_at(viewer.pictures, (x + 0.5) / 96, (y + 0.5) / 64)
        assert (found == radiance[y, x]).all()
    assert radiance_at(viewer.pictures, 1.0, 0.5) is None


# ---- side by side -----------------------------------------------------------------------------------


def test_two_scenes_side_by_side(open_viewer):
    other = sv.builtin("cornell_box")
    for material in other.materials:
        material.base_color = (0.1, 0.1, 0.9)
    viewer = open_viewer(beside=other, beside_name="blue", overlay=False, source="builtin:cornell_box")
    viewer.run(frames=4)
    shown = viewer.capture()
    left, right = viewer.pictures.pixels(), viewer.beside.pictures.pixels()
    assert (shown[:, :48] == left[:, :48]).all()
    assert (shown[:, 48:] == right[:, 48:]).all()
    assert viewer.columns() == {"builtin:cornell_box": (0, 0.5), "blue": (0.5, 1)}
    blue = radiance_at(viewer.pictures_at(0.8), 0.8, 0.9)
    assert blue[2] > 2 * blue[0]
    difference = viewer.beside.difference(viewer.camera.exposure)
    assert difference["relMSE"] > 0.1
    assert difference.get("FLIP", 1) > 0.1
    viewer.pictures.divider = 0.25
    viewer.camera_control.look(30, 0)
    viewer.run(frames=2)
    assert (viewer.capture()[:, 24:] == viewer.beside.pictures.pixels()[:, 24:]).all(), "one camera for both"
    for ours, theirs in zip(viewer.scene.materials, other.materials, strict=True):
        theirs.base_color = ours.base_color
    viewer.scale.auto, viewer.refining.samples = True, 6
    until(viewer, lambda: viewer.refining.finished)
    assert viewer.beside.difference(1.0)["relMSE"] == 0, "the same scene with as many samples"


# ---- scripts ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mode", "surroundings"),
    [("reference", "none"), ("reference", "studio"), pytest.param("realtime", "studio", marks=pytest.mark.slow)],
)
def test_a_saved_script_renders_the_picture(open_viewer, tmp_path, mode, surroundings):
    viewer = open_viewer(size=(64, 48), overlay=False, folder=tmp_path, source="builtin:cornell_box", seed=5, mode=mode)
    viewer.run(frames=1)
    viewer.edit(viewer.scene.materials[0], base_color=(0.1, 0.8, 0.2))
    viewer.edit(viewer.scene.instances[-1], visible=False)
    viewer.act("add_light", "point")
    viewer.act("surround", surroundings)
    viewer.act("brighter")
    viewer.camera_control.orbit(30, 10, (0, 1, 0))
    viewer.run(frames=12)
    viewer.act("save")
    assert not viewer.history.unsaved
    shown = viewer.pictures.pixels().astype(int)
    [script] = tmp_path.glob("*.py")
    environment = {**os.environ, "PYTHONPATH": str(Path(sv.__file__).parents[1])}
    done = subprocess.run([sys.executable, script], env=environment, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stderr
    rendered = np.asarray(Image.open(script.with_suffix(".png")))[..., :3].astype(int)
    assert rendered.shape == shown.shape
    if surroundings == "none":
        assert np.abs(rendered - shown).max() <= 1, "the same samples"
    else:  # a map is saved with its columns in another order, so the samples of its light differ
        blocks = (rendered - shown).reshape(6, 8, 8, 8, 3).mean(axis=(1, 3))
        assert np.abs(blocks).mean() < 3
        assert abs(blocks.mean()) < 1


def test_view_shows_two_files(screen, tmp_path, capfd):
    shown = str(tmp_path / "shown.png")
    view = ["view", "builtin:cornell_box", "--beside", "builtin:cornell_box", "--mode", "reference", "--size", "64x48",
            "--scale", "1", "--no-overlay", "--frames", "3", "--screenshot", shown]  # fmt: skip
    assert main(view) == 0, capfd.readouterr().err
    pixels = np.asarray(Image.open(shown))[..., :3].astype(int)
    assert pixels.shape == (48, 64, 3)
    assert main(["view", "builtin:cornell_box", "--beside", "missing.glb"]) == 2
    assert "missing.glb" in capfd.readouterr().err
