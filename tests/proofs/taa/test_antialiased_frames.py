"""Antialiasing and upscaling: single frames against the path tracer, still and in motion, and what they survive."""

from __future__ import annotations

import functools
import itertools

import numpy as np
import pytest
from PIL import Image
from support.frames import differing, left_of, settle
from support.realtime import SPLIT, get_jitter, make_renderer
from support.statistics import sixteenths

import solari_vk as sv
from solari_vk.measure.statistics import relative_mse
from solari_vk.scene import shapes
from solari_vk.scene.builtin import builtin, cornell_box, place

SIZE = (64, 64)
SETTLED = 64  # frames


def make(device, scene, size=SIZE, **settings):
    return make_renderer(device, scene, size, **{"denoise": True, "antialiasing": True, **settings})


def read(frame, name="radiance"):
    return np.asarray(frame[name], np.float64)[..., :3]


def trace(device, scene, camera=None, size=SIZE, samples=512):
    with sv.PathTracer(device, scene, size, seed=99) as tracer:
        return read(tracer.render(camera or scene.camera, samples=samples))


def moved(camera, right):
    """The camera, moved sideways in meters."""
    transform = camera.transform.copy()
    transform[:3, 3] += right * transform[:3, 0]
    return sv.Camera(transform=transform, vertical_fov=camera.vertical_fov, near=camera.near, ev100=camera.ev100)


# ---- a still picture --------------------------------------------------------------------------------

# The lamp's edges are the brightest: 96 x 96 pixels hold enough of them for a stable figure.
SIZE_OF_ERRORS = (96, 96)


@pytest.fixture(scope="module")
def reference(device):
    return trace(device, cornell_box(), size=SIZE_OF_ERRORS, samples=1024)


@functools.cache
def settled(device, **settings):
    """The picture of the Cornell box after 96 frames, and the same frame's samples."""
    size = settings.pop("size", SIZE_OF_ERRORS)
    with make(device, cornell_box(), size, **settings) as renderer:
        frame = settle(renderer, None, 96)
        return read(frame), read(frame, "sample_radiance")


def test_a_single_frame_has_no_aliasing(device, reference):
    """Measured: 0.0032, and 0.051 of a single denoised frame without antialiasing, most of it from aliasing."""
    picture, samples = settled(device)
    errors = relative_mse(picture, reference), relative_mse(samples, reference)
    print("still: {:.4f}, without antialiasing {:.4f}".format(*errors))
    assert errors[0] < 0.006
    assert errors[1] > 0.03


@pytest.mark.slow
def test_upscaled_pictures(device, reference):
    """relMSE of a picture of 2 x 2 pixels for each that is rendered, beside that of bilinear interpolation, and of the
    picture for which all pixels are rendered in as many frames."""
    half = SIZE_OF_ERRORS[0] // 2, SIZE_OF_ERRORS[1] // 2
    small = settled(device, size=half, antialiasing=False)[0].astype(np.float32)
    channels = [Image.fromarray(small[..., i]).resize(SIZE_OF_ERRORS, Image.Resampling.BILINEAR) for i in range(3)]
    bilinear = relative_mse(np.stack(channels, axis=-1), reference)
    native = relative_mse(settled(device)[0], reference)
    error = relative_mse(settled(device, upscale=2)[0], reference)
    print(f"upscaled {error:.4f}, bilinear {bilinear:.4f}, all pixels {native:.4f}")
    assert error < 0.025
    assert error < 5 * native
    assert error < 0.01 * bilinear


def checkers():
    """64 x 64 squares, 0.13 and 0.72 bright."""
    texels = (np.indices((64, 64)).sum(axis=0) % 2 * 120 + 100).astype(np.uint8)
    image = sv.TextureImage(pixels=np.dstack([texels] * 3 + [np.full_like(texels, 255)]))
    return sv.Texture(image=image, magnification="nearest", minification="nearest", mipmaps=False)


CHECKERS = checkers()


def checkerboard(pixels):
    """A wall with squares that are `pixels` wide in a picture of SIZE, lit by the sun."""
    half = 64 * pixels / SIZE[1] / 2
    material = sv.Material(base_color_texture=CHECKERS, reflectance=0.0)
    scene = sv.Scene(sv.Instance(mesh=shapes.quad((0, 0, 0), (half, 0, 0), (0, half, 0)), material=material))
    scene.add(sv.DirectionalLight(direction=(0, 0, -1), illuminance=3.0))
    scene.add(sv.Camera(transform=place(at=(0, 0, 1)), vertical_fov=2 * np.arctan(0.5)))
    return scene


def test_fine_texture_keeps_its_contrast(device):
    """Checkers of 1.5 pixels: the share of the path tracer's picture, from its mean, that is in a settled frame."""
    scene = checkerboard(1.5)
    inner = slice(8, -8), slice(8, -8)
    truth = trace(device, scene)[inner]
    with make(device, scene) as renderer:
        picture = read(settle(renderer, None, SETTLED))[inner]
    contrast = left_of(truth, truth.mean(), picture)
    print(f"contrast {contrast:.3f}")
    assert 0.9 < contrast < 1.05


def test_the_mean_is_that_of_the_samples(device):
    """The mean of settled pictures over that of their samples: as a whole, and in the worst of 16 tiles."""
    with make(device, builtin("mirror_hall")) as renderer:
        settle(renderer, None, SETTLED)
        samples, picture = np.zeros((2, *SIZE, 3))
        for _ in range(64):
            frame = renderer.render()
            samples += read(frame, "sample_radiance")
            picture += read(frame)
    tiles = sixteenths(picture).mean(axis=-1) / sixteenths(samples).mean(axis=-1) - 1
    total = picture.sum() / samples.sum() - 1
    print(f"mean {total:+.4f}, tiles {np.abs(tiles).max():.4f}")
    assert abs(total) < 0.01
    assert np.abs(tiles).max() < 0.03


# ---- what moves and changes -------------------------------------------------------------------------


def glowing(radiance):
    """A material whose light needs no denoiser."""
    return sv.Material(base_color=0.0, reflectance=0.0, emissive=radiance)


def test_what_a_moving_block_uncovers(device):
    """A block that glows moves by 2 pixels a frame for 24 frames in front of a wall with checkers that glow: the share
    of its light that is left where it was 8 frames ago; and relMSE of what it uncovered in 2 frames, over that of the
    samples of what it never covered."""
    scene = checkerboard(4.3)
    wall = next(iter(scene))
    wall.material = glowing(1.0)
    wall.material.emissive_texture = CHECKERS
    block = sv.Instance(mesh=shapes.box((-0.1, -0.1, -0.02), (0.1, 0.1, 0.02)), material=glowing(3.0))
    scene.add(block)

    def put(step):
        block.transform = place(at=(-0.35 + step * 2 / SIZE[0], 0, 0.1))

    put(0)
    with make(device, scene) as renderer:
        settle(renderer, None, 32)
        for step in range(1, 25):
            put(step)
            frame = renderer.render()
        picture, samples = read(frame), read(frame, "sample_radiance")
        masks, pictures = {}, {}
        for steps in (0, 2, 8):
            put(24 - steps)
            masks[steps] = renderer.render().mask(block)
            pictures[steps] = trace(device, scene, samples=128)
    truth, covered = pictures[0], masks[0].copy()
    for axis, by in ((0, 1), (0, -1), (1, 1), (1, -1)):
        covered |= np.roll(masks[0], by, axis)  # and the edges
    left, uncovered = masks[8] & ~covered, masks[2] & ~covered
    never = np.zeros(SIZE, bool)
    never[4:20, 4:-4] = True
    trail = left_of(pictures[8][left], truth[left], picture[left])
    found, usual = relative_mse(picture[uncovered], truth[uncovered]), relative_mse(samples[never], truth[never])
    print(f"trail {trail:+.4f}, uncovered {found:.5f}, samples {usual:.5f}")
    assert abs(trail) < 0.05
    assert found / usual < 3


def test_edges_in_mirrors(device):
    """How far the edge of a lit card in a flat metal mirror is off, in pixels, while the camera moves sideways by 0.7
    pixels a frame."""
    scene = sv.Scene()
    scene.add(shapes.quad((0, 0, 0), (3, 0, 0), (0, 3, 0)), sv.Material(metallic=1.0, perceptual_roughness=0.0))
    scene.add(shapes.quad((0.6, 0, 3.0), (-0.6, 0, 0), (0, 3, 0)), glowing(1.0))
    scene.add(shapes.quad((0, 0, 3.2), (-6, 0, 0), (0, 6, 0)), glowing(0.1))
    scene.add(sv.Camera(transform=place(at=(0, 0, 2)), vertical_fov=0.6))
    step = 0.7 * 2 * np.tan(0.3) * 5 / SIZE[0]  # meters for a point at its virtual distance
    with make(device, scene) as renderer:
        for index in range(32):
            camera = moved(scene.camera, index * step)
            frame = renderer.render(camera)
        picture = read(frame)
    truth = trace(device, scene, camera)
    found, right = (image[16:48].mean(axis=(0, 2)).sum() for image in (picture, truth))
    high, low = truth[16:48].mean(axis=(0, 2)).max(), truth[16:48].mean(axis=(0, 2)).min()
    off = abs(found - right) / (high - low)
    print(f"edge off by {off:.3f} pixels; contrast {left_of(truth, truth.mean(), picture):.3f}")
    assert off < 0.25


def test_a_moving_camera_keeps_edges_smooth(device):
    """The mean square error while the camera moves sideways by about a pixel a frame, over that without antialiasing.
    Highlights are compressed as a display does, or the lamp's edges would be all that counts."""
    scene = cornell_box()
    with make(device, scene) as renderer:
        for index in range(32):
            camera = moved(scene.camera, 0.02 * index)
            frame = renderer.render(camera)
        picture, samples = read(frame), read(frame, "sample_radiance")
    truth, picture, samples = (x / (x + 0.2) for x in (trace(device, scene, camera), picture, samples))
    errors = ((picture - truth) ** 2).mean(), ((samples - truth) ** 2).mean()
    print("moving: {:.5f}, without antialiasing {:.5f}".format(*errors))
    assert errors[0] / errors[1] < 0.3


def test_changes_of_colors_are_followed(device):
    """A wall is painted: after 8 frames the picture shows at most a twentieth of the old color."""
    scene = checkerboard(6.0)
    with make(device, scene) as renderer:
        before = read(settle(renderer, None, 32))
        next(iter(scene)).material.base_color = (0.2, 0.3, 1.0)
        picture = read(settle(renderer, None, 8))
        after = read(settle(renderer, None, 60))
    assert abs(left_of(before, after, picture)) < 0.05


@pytest.mark.parametrize("upscale", [1.0, pytest.param(2.0, marks=pytest.mark.slow)])
def test_a_camera_that_moves_leaves_no_edges_behind(device, upscale):
    """The background doesn't move with the camera, but what is seen before it does."""
    scene = sv.builtin("cornell_box")
    camera = sv.Camera(transform=scene.camera.transform, vertical_fov=scene.camera.vertical_fov)
    settings = sv.Settings(denoise=True, antialiasing=True, upscale=upscale)
    with sv.Renderer(device, scene, (96, 54), settings) as renderer:
        for step in range(10):
            if step > 3:
                transform = camera.transform.copy()
                transform[0, 3] += 0.25
                camera.transform = transform
            frame = renderer.render(camera)
        picture, empty = frame["radiance"].max(axis=2), ~np.isfinite(frame["depth"])
    shapes = [np.roll(empty, (down, right), (0, 1)) for down in range(-3, 4) for right in range(-3, 4)]
    far = np.logical_and.reduce(shapes)  # from all edges
    assert far.mean() > 0.2
    typical = np.median(picture[~empty])
    print(picture[far].max() / typical)
    assert picture[far].max() < 0.05 * typical


# ---- sizes, cuts, hard input ------------------------------------------------------------------------


def soften(samples, jitter, normals, depths):
    """The first picture after a cut: samples (h, w, 3) exchange light with the eight around by a Gaussian of half a
    pixel about the pixel's center, less where luminances are more than 8 times apart, or 16 times where normals
    (h, w, 3) or depths (h, w, 1) tell that the surface is another one."""

    def moved(picture, right, down):
        near = np.pad(picture, ((1, 1), (1, 1), (0, 0)), "edge")  # what is outside has nothing to exchange
        return near[1 + down : 1 + down + picture.shape[0], 1 + right : 1 + right + picture.shape[1]]

    shifts = list(itertools.product((-1, 0, 1), repeat=2))
    weights = np.exp([-2 * ((jitter[0] + right) ** 2 + (jitter[1] + down) ** 2) for right, down in shifts])
    result, own = samples.copy(), samples @ (0.2126, 0.7152, 0.0722)
    for shift, weight in zip(shifts, weights / weights.sum(), strict=True):
        other, depth = moved(samples, *shift), moved(depths, *shift)
        same = (normals * moved(normals, *shift)).sum(axis=-1) > 0.9
        same &= (abs(depth - depths) < 0.1 * np.maximum(depth, depths))[..., 0]
        luminance = other @ (0.2126, 0.7152, 0.0722)
        alike = np.where(same, 8, 16) * np.minimum(own, luminance) / np.maximum(np.maximum(own, luminance), 1e-30)
        result += weight * np.minimum(alike, 1)[..., None] * (other - samples)
    return result


def check_first_picture(frame, renderer):
    samples, depths = read(frame, "sample_radiance"), np.atleast_3d(read(frame, "guides_depth"))
    inside = np.s_[1:-1, 1:-1]
    expected = soften(samples, get_jitter(renderer), read(frame, "guides_normal_roughness")[..., :3], depths)
    assert read(frame)[inside] == pytest.approx(expected[inside], rel=1e-4, abs=1e-6)
    assert (expected != samples).any(axis=-1).sum() > 500


@pytest.mark.parametrize("settings", [{}, SPLIT], ids=["paths", "split"])
def test_off_is_the_frame_of_samples(device, settings):
    """Without antialiasing the picture is the samples, bit by bit; with it, the samples are the same."""
    scene = cornell_box()
    with make(device, scene, **settings) as on, make(device, scene, antialiasing=False, **settings) as off:
        for _ in range(3):
            found, plain = on.render(), off.render()
            assert plain["radiance"].tobytes() == plain["sample_radiance"].tobytes()
            assert found["sample_radiance"].tobytes() == plain["sample_radiance"].tobytes()
        assert found["radiance"].tobytes() != plain["radiance"].tobytes()
        on.reset()
        cut = on.render()
        check_first_picture(cut, on)
        on.settings.antialiasing = False
        on.render()
        on.settings.antialiasing = True
        check_first_picture(on.render(), on)  # the switch is live


# The height of (9, 3) is the number of pixels that are rendered for it.
@pytest.mark.parametrize(("size", "upscale"), [
    ((1, 1), 1.0), ((5, 7), 1.5), ((9, 3), 3.0),
    *(pytest.param(*case, marks=pytest.mark.slow)
      for case in (((1, 1), 3.0), ((16, 3), 2.0), ((5, 7), 2.0), ((4, 4), 2.0))),
])  # fmt: skip
def test_sizes(device, size, upscale):
    scene = cornell_box()
    with make(device, scene, size, upscale=upscale) as renderer:
        for width, height in (size, (9, 4)):
            renderer.resize((width, height))
            rendered = -int(-height // upscale), -int(-width // upscale)
            assert renderer.render_size == rendered[::-1]
            frame = settle(renderer, None, 5)
            assert np.isfinite(read(frame)).all()
            assert frame["radiance"].shape == (height, width, 3)
            assert frame["display"].shape[:2] == frame["depth"].shape == (height, width)
            assert frame["raw_radiance"].shape[:2] == frame["guides_motion"].shape[:2] == rendered


def test_upscale_is_live(device):
    scene = cornell_box()
    with make(device, scene) as renderer, make(device, scene, upscale=2) as other:
        settle(renderer, None, 3)
        renderer.settings.upscale = 2
        renderer.view = "shading_normal"
        assert renderer.render()["display"].shape == (*SIZE, 4)
        renderer.view = "picture"
        found, right = read(settle(renderer, None, 20)), read(settle(other, None, 24))
    assert relative_mse(found, right) < 0.1


@pytest.mark.parametrize("ev100", [-40.0, 40.0])
def test_exposure_changes_nothing(device, ev100):
    scene, other = checkerboard(1.5), checkerboard(1.5)
    other.camera.ev100 = ev100
    with make(device, scene) as renderer, make(device, other) as exposed:
        frame, found = settle(renderer, None, 4), settle(exposed, None, 4)
        assert relative_mse(read(found), read(frame)) < 1e-4


def test_the_cameras_own_jitter_moves_the_picture(device):
    """A camera whose jitter is 3 pixels shows the picture moved by 3 pixels, in one frame as over many."""
    scene = checkerboard(6.0)
    with make(device, scene) as renderer:
        still = read(settle(renderer, None, 32))
        scene.camera.jitter = (3, 0)
        picture = read(renderer.render())
    inside = slice(8, -8)
    assert left_of(still[inside, 11:-5], still.mean(), picture[inside, 8:-8]) == pytest.approx(1, abs=0.1)


def test_same_seed_same_bits(device):
    scene = cornell_box()
    with make(device, scene, upscale=1.5) as first, make(device, scene, upscale=1.5) as second:
        for index in range(5):
            camera = moved(scene.camera, 0.02 * index)
            assert not differing(first.render(camera), second.render(camera))
