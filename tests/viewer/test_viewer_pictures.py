"""The viewer's pictures: upscaled to the window, side by side, and compared with the path tracer."""

from __future__ import annotations

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.viewer.comparison import difference
from solari_vk.viewer.pictures import STRIP
from solari_vk.viewer.presenter import Part

DENOISED = {"denoise": True, "antialiasing": True}


# ---- upscaling --------------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1.0, 0.5, 0.4])
def test_the_realtime_picture_has_the_windows_size(open_viewer, scale):
    """The renderer makes it from fewer pixels; the window shows it texel by texel."""
    viewer = open_viewer(overlay=False, mode="realtime", scale=scale, settings=sv.Settings(**DENOISED))
    viewer.run(frames=3)
    pictures = viewer.pictures
    assert pictures.size == pictures.realtime.size == (96, 64)
    assert pictures.rendered_size == pytest.approx((96 * scale, 64 * scale), abs=1)
    assert viewer.settings.upscale == pytest.approx(1 / scale)
    assert viewer.capture().shape == (64, 96, 3)
    assert (viewer.capture() == pictures.realtime["display"][..., :3]).all()


def test_the_scale_may_change_at_any_time(open_viewer):
    """A change of the setting lasts until the scale changes."""
    viewer = open_viewer(overlay=False, mode="realtime", settings=sv.Settings(**DENOISED))
    for scale, upscale in ((1.0, 1), (0.5, 2), (0.5, 2), (1.0, 1)):
        viewer.scale.fix(scale)
        viewer.run(frames=2)
        assert (viewer.settings.upscale, viewer.pictures.size) == (upscale, (96, 64))
    viewer.settings.upscale = 1.5
    viewer.run(frames=2)
    assert viewer.pictures.rendered_size == (64, 43)


def test_what_is_picked_does_not_depend_on_the_scale(open_viewer):
    viewer = open_viewer(overlay=False, mode="realtime", settings=sv.Settings(**DENOISED))
    points = []
    for scale in (1.0, 0.5):
        viewer.scale.fix(scale)
        viewer.run(frames=2)
        viewer.act("pick", (30.0, 40.0))
        points.append(viewer.pick.point)
    assert np.linalg.norm(points[0] - points[1]) < 0.1


# ---- the split view ---------------------------------------------------------------------------------


def test_raw_denoised_and_reference_side_by_side(open_viewer):
    viewer = open_viewer(overlay=False, mode="split", scale=0.5, settings=sv.Settings(**DENOISED))
    viewer.run(frames=12)
    pictures = viewer.pictures
    middle = (1 - STRIP) / 2
    assert pictures.columns() == {"raw": (0, middle), "denoised": (middle, 1 - middle), "reference": (1 - middle, 1)}
    raw, denoised, reference = (part.image for part in pictures.parts())
    assert [(image.width, image.height) for image in (raw, denoised, reference)] == [(48, 32), (96, 64), (48, 32)]
    shown, whole = viewer.capture(), pictures.pixels()
    assert shown.shape == whole.shape == (64, 96, 3)
    assert (shown[:, 32:64] == denoised.read()[:, 32:64, :3]).all()
    assert (whole[::2, :32:2] == raw.read()[:, :16, :3]).all()
    assert (whole[::2, 64::2] == reference.read()[:, 32:, :3]).all()
    assert np.abs(shown.astype(int) - whole).mean() < 12, "a small image is stretched smoothly"
    errors = pictures.errors()
    assert errors.keys() == {"raw", "denoised"}
    assert errors["denoised"][0] < 0.5 * errors["raw"][0]
    assert abs(errors["denoised"][1]) < 0.3
    viewer.settings.denoise = False
    viewer.run(frames=2)
    assert pictures.columns().keys() == pictures.errors().keys() | {"reference"} == {"realtime", "reference"}


@pytest.mark.parametrize("divider", [0.0, 0.1, 0.5, 1.0])
def test_columns_cover_the_window(open_viewer, divider):
    viewer = open_viewer(overlay=False, mode="split", scale=0.4, settings=sv.Settings(**DENOISED))
    viewer.pictures.divider = divider
    viewer.run(frames=2)
    columns = list(viewer.pictures.columns().values())
    assert [columns[0][0], columns[-1][1]] == [0, 1]
    assert [end for _, end in columns[:-1]] == [begin for begin, _ in columns[1:]]
    assert viewer.capture().shape == viewer.pictures.pixels().shape == (64, 96, 3)


@pytest.mark.parametrize("divider", [0.43, 0.5, 0.61])
def test_columns_are_not_shifted(open_viewer, divider):
    """Each picture is where it is when it fills the window, but for half a pixel of the window."""
    viewer = open_viewer(overlay=False, mode="split", scale=0.4, settings=sv.Settings(**DENOISED))
    viewer.pictures.divider = divider
    viewer.run(frames=4)
    shown = viewer.capture().astype(int)
    for part in viewer.pictures.parts():
        whole = viewer._presenter.capture([Part(part.image)], viewer._draw)
        begin, end = part.columns(96)
        inside = slice(begin + 3, end - 3)  # at its borders, a small picture is interpolated with one less texel
        assert np.abs(shown[:, inside] - whole[:, inside]).mean() < 2  # at most 1.4; 5 with borders within texels


# ---- comparison -------------------------------------------------------------------------------------


def test_a_known_difference_is_found(device):
    """A picture that is 10 % too bright everywhere, against a reference whose noise is larger than that."""
    with sv.PathTracer(device, sv.builtin("cornell_box"), (64, 64)) as tracer, \
            sv.PathTracer(device, sv.builtin("cornell_box"), (64, 64), seed=9) as other:  # fmt: skip
        truth = tracer.render(samples=600)["radiance"]
        other.render(samples=1)
        assert difference(truth, other) is None
        other.render(samples=64)
        error, mean = difference(1.1 * truth, other)
        assert error == pytest.approx(0.1, abs=0.06)
        assert mean == pytest.approx(0.1, abs=0.03)
