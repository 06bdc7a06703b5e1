"""Realtime batches: each view is bit by bit that of a `Renderer` of its own, and takes nothing from its neighbors."""

from __future__ import annotations

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.cli import main
from solari_vk.passes.reference import numbered_seed
from solari_vk.settings import Settings

OUTPUTS = ("radiance", "raw_radiance", "display")
ALONE = {"gbuffer": "traced", "world_cache": False}  # what a renderer of its own has in common with a view


def orbit(count, frame, **fields):
    """Cameras around the Cornell box, which move a little in each frame."""
    rng = np.random.default_rng(count)
    places, aims = rng.uniform((0.4, 0.4, -2.4), (1.6, 1.6, -1.6), (count, 3)), rng.uniform(0.6, 1.4, (count, 3))
    return [sv.Camera.look_at(place + 0.02 * frame, aim, **fields) for place, aim in zip(places, aims, strict=True)]


def poses_of(cameras):
    return np.stack([camera.transform for camera in cameras])


def check_views(device, scene, size, count, frames, settings, edit=None):
    """Views are those of renderers that are given the same cameras. frames: for each the cameras, the options of
    `render`, and which views are cut. edit(scene, frame) changes the scene before a frame."""

    def each(renderer, render):
        with renderer:
            for index, frame in enumerate(frames):
                if edit is not None:
                    edit(renderer.binder.scene, index)
                yield render(renderer, index, *frame)

    def together(batch, index, cameras, options, cut):
        batch.render(cameras, **options, reset=cut)
        return {name: batch[name] for name in OUTPUTS}

    batch = sv.Batch(device, scene(), size, count, renderer="realtime", seed=3, settings=Settings(**settings))
    pictures = list(each(batch, together))
    assert pictures[0]["radiance"].shape == (count, size[1], size[0], 3)
    for view in range(count):

        def alone(renderer, index, cameras, options, cut, view=view):
            if np.broadcast_to(cut, count)[view]:
                renderer.reset()
            camera = cameras[view]
            if not isinstance(camera, sv.Camera):
                fov, ev100 = (np.broadcast_to(options.get(name, 0), count)[view] for name in ("fov", "ev100"))
                camera = sv.Camera(transform=camera, fov=fov, ev100=ev100)
            frame = renderer.render(camera)
            return {name: frame[name].copy() for name in OUTPUTS}

        single = sv.Renderer(device, scene(), size, Settings(**settings), seed=numbered_seed(3, view))
        for index, expected in enumerate(each(single, alone)):
            for name, picture in expected.items():
                said = f"{name}, view {view}, frame {index}"
                np.testing.assert_array_equal(pictures[index][name][view], picture, said)
    return pictures


def moving(count, frames=4, **options):
    """Frames with a cut of the first view, or the only one, in the third."""
    cut = np.arange(count) == 0
    return [(poses_of(orbit(count, index)), dict(options), cut if index == 2 else False) for index in range(frames)]


@pytest.mark.parametrize(("size", "count"), [pytest.param((13, 7), 5, marks=pytest.mark.slow), ((16, 24), 3)])
def test_views_are_those_of_renderers(device, size, count):
    options = {"fov": np.linspace(40, 80, count), "ev100": np.linspace(-2, 1.3, count)}
    frames = moving(count, **options)
    pictures = check_views(device, lambda: sv.builtin("cornell_box"), size, count, frames, ALONE)
    assert len({picture.tobytes() for picture in pictures[3]["radiance"]}) == count


FISHEYE = {"projection": "fisheye", "vertical_fov": 3.0, "image_circle": 2.5, "aperture": 0.1}


@pytest.mark.parametrize("first", [{"jitter": (-1, 0.2)}, pytest.param(FISHEYE, marks=pytest.mark.slow)])
def test_cameras_of_any_kind_and_upscaling(device, first):
    def frame(index):
        fields = {"transform": sv.Camera.look_at((1, 1, 0.3 - 0.02 * index), (1, 1, 1)).transform}
        return [
            sv.Camera(**fields, **first),
            sv.Camera(**fields, orthographic_height=1.5, jitter=(0.3 * index, -2)),
            sv.Camera.look_at(
                (1, 1, -2.4), (1, 1 + 0.02 * index, 0), principal_point=(0.4, 0.7), ev100=-1, aperture=0.2
            ),
        ]

    frames = [(frame(index), {}, False) for index in range(3)]
    check_views(device, lambda: sv.builtin("cornell_box"), (14, 9), 3, frames, ALONE | {"upscale": 1.5})


def test_lights_and_instances_change(device):
    """Also in the frame of a cut."""

    def edit(scene, index):
        scene.instances["tall block"].position += (0.03, 0, 0)
        if index in (1, 2):
            lamp = scene.instances["lamp"]
            lamp.material.emissive = lamp.material.emissive * 3

    check_views(device, lambda: sv.builtin("cornell_box"), (13, 7), 2, moving(2, fov=60), ALONE, edit)


def test_light_changes_before_a_cut(device):
    """A view that is cut then begins without the change, and the others go on with it."""

    def scene():
        made = sv.builtin("cornell_box")
        made.add(sv.DirectionalLight(direction=(0.1, -0.3, 1), illuminance=30))
        made.add(sv.PointLight((1, 1, 0.5), intensity=0.1, name="small"))
        return made

    def edit(scene, index):
        if index == 1:
            scene.lights[0].illuminance = 12
        if index == 6:
            scene.lights["small"].intensity = 0

    frames = moving(2, 8, fov=60)
    frames[6][1]["reset_cache"] = True  # which views that go on have nothing to do with
    check_views(device, scene, (13, 7), 2, frames, ALONE, edit)


@pytest.mark.slow
def test_reuse_between_pixels_stays_within_views(device):
    frames = moving(3, fov=60)
    check_views(device, lambda: sv.builtin("cornell_box"), (16, 9), 3, frames, ALONE | {"restir": True})


def test_the_world_cache_of_one_view(device):
    """Is that of a renderer; a reset of the renderer begins it anew."""
    settings = ALONE | {"world_cache": True, "world_cache_cells": 1 << 14}
    frames = [(poses_of(orbit(1, index)), {"fov": 60, "reset_cache": index == 3}, index == 3) for index in range(5)]
    check_views(device, lambda: sv.builtin("cornell_box"), (24, 16), 1, frames, settings)


@pytest.mark.parametrize("settings", [{}, {"antialiasing": False}], ids=["default", "without antialiasing"])
def test_a_white_neighbor_leaves_no_trace(device, settings):
    """A view of a black wall between views of a white lamp, or of black walls."""
    scene = sv.Scene()
    black, lamp = sv.Material(base_color=(0, 0, 0)), sv.Material(emissive=(100, 100, 100))
    scene.add(sv.shapes.plane(4), black, position=(0, -1, 0))
    scene.add(sv.shapes.box((-1, -1, -3), (1, 1, -2)), black)
    scene.add(sv.shapes.box((-1, -1, 2), (1, 1, 3)), lamp)
    away, towards = np.eye(4), np.diag((-1.0, 1, -1, 1))
    with sv.Batch(
        device, scene, (16, 16), 5, renderer="realtime", outputs=(), settings=Settings(world_cache=False, **settings)
    ) as batch:
        pictures = []
        for others in (away, towards):
            batch.render([others, others, away, others, others], reset=True)
            for index in range(3):
                turned = others @ sv.Camera.look_at((0, 0, 0), (0.02 * index, 0, -1)).transform
                batch.render([turned, turned, away, turned, turned])
            pictures.append([batch[name] for name in OUTPUTS])
            seeds = batch._realtime.frame_count
            batch._realtime.frame_count = 0  # the same noise
        assert seeds == 4
    for dark, bright in zip(*pictures, strict=True):
        np.testing.assert_array_equal(dark[2], bright[2])
    dark, bright = (found[0] for found in pictures)
    assert bright[[1, 3]].min() > 10 * dark.max()


def test_views_share_the_world_cache(device):
    """A view's first frame has less error where others have seen its surroundings before; a cut leaves them there."""
    scene = sv.builtin("cornell_box")
    size = (32, 32)
    cameras = orbit(8, 0, vertical_fov=1.0)
    settings = Settings(world_cache_cells=1 << 15, jitter=False)
    with sv.PathTracer(device, scene, size) as tracer:
        truth = np.stack([tracer.render(camera, samples=128)["radiance"] for camera in cameras[:3]])

    def error(pictures):
        return (np.square(pictures - truth) / (np.square(truth) + 1e-2 * np.square(truth).mean())).mean()

    with sv.Batch(device, scene, size, 8, renderer="realtime", outputs=(), settings=settings) as batch:

        def first_frame(**options):
            return error(batch.render(cameras, reset=True, **options)["raw_radiance"][:3])

        cold = first_frame()
        for index in range(12):
            batch.render(orbit(8, 5 + index, vertical_fov=1.0)[::-1], reset=True)
        warm, cold_again = first_frame(), first_frame(reset_cache=True)
    assert warm < 0.8 * min(cold, cold_again)


def test_tensors_and_pictures(device):
    with sv.Batch(device, sv.builtin("cornell_box"), (13, 7), 3, renderer="realtime", outputs=["depth"]) as batch:
        batch.render(poses_of(orbit(3, 0)))
        assert list(batch) == [*OUTPUTS, "depth"]
        tensor = batch.tensor("radiance")
        assert tensor.shape == (3, 7, 13, 3)
        np.testing.assert_array_equal(tensor, batch["radiance"])
        assert batch["display"].shape == (3, 7, 13, 4)
        assert np.isfinite(batch["depth"]).any()
        with pytest.raises(sv.SolariError, match="'display' is an image: batch\\['display'\\] copies it"):
            batch.tensor("display")


@pytest.mark.parametrize(
    ("options", "arguments", "said"),
    [
        ({"settings": Settings(lighting="split")}, {}, "the setting lighting=paths"),
        ({"settings": Settings(gbuffer="raster")}, {}, "the setting gbuffer=traced"),
        ({"settings": 3}, {}, "settings must be a Settings, not 3"),
        ({"max_bounces": 3}, {}, "no option 'max_bounces'"),
        ({}, {"samples": 3}, "the realtime renderer takes no samples"),
        ({}, {"cameras": [sv.Camera(auto_exposure=True)] * 2}, "set auto_exposure to False"),
        ({}, {"cameras": np.tile(np.eye(4), (2, 1, 1)), "ev100": [0, 101]}, "ev100 of view 1 must lie between"),
        ({"views": 100_000_000}, {}, "at most .* views of this size"),
    ],
)
def test_wrong_input_is_named(device, options, arguments, said):
    options = {"views": 2, "renderer": "realtime", **options}
    with pytest.raises(sv.SolariError, match=said):  # noqa: SIM117
        with sv.Batch(device, sv.builtin("cornell_box"), (16, 9), **options) as batch:
            batch.render(**{"cameras": [sv.Camera()] * 2, **arguments})


@pytest.mark.slow
def test_bench_of_first_frames(lent_device, tmp_path):
    page, small = tmp_path / "page.md", ["--views", "2", "--size", "8x8", "--samples", "2"]
    assert main(["bench", "first-frames", *small, "--scenes", "cornell_box", "--markdown", str(page)]) == 0
    [row] = [line for line in page.read_text().splitlines() if line.startswith("| cornell_box")]
    assert len([float(cell) for cell in row.split("|")[2:-1]]) == 11
