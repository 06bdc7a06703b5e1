"""Antialiasing and upscaling: single frames against the path tracer, still and in motion, and what they survive."""

import numpy as np
import pytest
from support.frames import SPLIT_LIGHTING, make_renderer, path_traced_runs, render_frames, share_of_earlier
from support.statistics import tile_means_4x4

import solari_vk as sv
from solari_vk.output.compare import relative_mse, true_relative_mse
from solari_vk.scene import shapes
from solari_vk.scene.builtin import builtin, cornell_box, place

SIZE = (64, 64)


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
def references(device):
    """Two pictures of the Cornell box with independent noise."""
    return path_traced_runs(device, cornell_box(), SIZE_OF_ERRORS, 128, runs=2, seed=99).runs


def settled(device, upscale=1):
    """The picture of the Cornell box after 48 frames, and the same frame's samples."""
    with make(device, cornell_box(), SIZE_OF_ERRORS, upscale=upscale) as renderer:
        frame = render_frames(renderer, None, 48)
        return read(frame), read(frame, "sample_radiance")


@pytest.mark.slow
def test_a_single_frame_has_no_aliasing(device, references):
    """Measured: 0.0032, and 0.051 of a single denoised frame without antialiasing, most of it from aliasing."""
    picture, samples = settled(device)
    errors = true_relative_mse(picture, *references), true_relative_mse(samples, *references)
    print("still: {:.4f}, without antialiasing {:.4f}".format(*errors))
    assert errors[0] < 0.006
    assert errors[1] > 0.03


@pytest.mark.slow
def test_upscaled_pictures(device, references):
    """relMSE of a picture in which one of 2 x 2 pixels takes a path in a frame, beside that of one in which all
    do, in as many frames."""
    native, error = (true_relative_mse(settled(device, upscale)[0], *references) for upscale in (1, 2))
    print(f"upscaled {error:.4f}, all pixels {native:.4f}")
    assert error < 0.008
    assert error < 2.5 * native


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


def test_the_mean_is_that_of_the_samples(device):
    """The mean of settled pictures over that of their samples: as a whole, and in the worst of 16 tiles."""
    with make(device, builtin("mirror_hall")) as renderer:
        render_frames(renderer, None, 32)
        samples, picture = np.zeros((2, *SIZE, 3))
        for _ in range(32):
            frame = renderer.render()
            samples += read(frame, "sample_radiance")
            picture += read(frame)
    tiles = tile_means_4x4(picture).mean(axis=-1) / tile_means_4x4(samples).mean(axis=-1) - 1
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
        render_frames(renderer, None, 32)
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
    trail = share_of_earlier(pictures[8][left], truth[left], picture[left])
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
    truth = trace(device, scene, camera, samples=128)
    found, right = (image[16:48].mean(axis=(0, 2)).sum() for image in (picture, truth))
    high, low = truth[16:48].mean(axis=(0, 2)).max(), truth[16:48].mean(axis=(0, 2)).min()
    off = abs(found - right) / (high - low)
    print(f"edge off by {off:.3f} pixels; contrast {share_of_earlier(truth, truth.mean(), picture):.3f}")
    assert off < 0.25


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


@pytest.mark.parametrize("settings", [{}, SPLIT_LIGHTING], ids=["paths", "split"])
@pytest.mark.slow
def test_off_is_the_frame_of_samples(device, settings):
    """Without antialiasing the picture is the samples, bit by bit; with it, the samples are the same. The switch is
    live, and what was on before it is forgotten."""
    scene = cornell_box()
    with make(device, scene, **settings) as on, make(device, scene, antialiasing=False, **settings) as off:
        for _ in range(3):
            found, plain = on.render(), off.render()
            assert plain["radiance"].tobytes() == plain["sample_radiance"].tobytes()
            assert found["sample_radiance"].tobytes() == plain["sample_radiance"].tobytes()
        assert found["radiance"].tobytes() != plain["radiance"].tobytes()
        on.settings.antialiasing = False
        scene.instances["lamp"].material.emissive = (100.0, 80.0, 60.0)
        frame = render_frames(on, None, 8)
        assert frame["radiance"].tobytes() == frame["sample_radiance"].tobytes()
        on.settings.antialiasing = True
        frame = on.render()
        assert read(frame).sum() == pytest.approx(read(frame, "sample_radiance").sum(), rel=0.02)


# The height of (9, 3) is the number of pixels that are rendered for it.
@pytest.mark.parametrize("denoise", [True, False])
@pytest.mark.parametrize(("size", "upscale"), [((1, 1), 1.0), ((5, 7), 1.5), ((9, 3), 3.0)])
def test_sizes(device, size, upscale, denoise):
    scene = cornell_box()
    with make(device, scene, size, upscale=upscale, denoise=denoise) as renderer:
        for width, height in (size, (9, 4)):
            renderer.resize((width, height))
            rendered = (height, width) if denoise else (-int(-height // upscale), -int(-width // upscale))
            assert renderer.render_size == rendered[::-1]
            frame = render_frames(renderer, None, 5)
            assert np.isfinite(read(frame)).all()
            assert frame["radiance"].shape == (height, width, 3)
            assert frame["display"].shape[:2] == frame["depth"].shape == (height, width)
            assert frame["raw_radiance"].shape[:2] == frame["guides_motion"].shape[:2] == rendered


def test_upscale_is_live(device):
    scene = cornell_box()
    with make(device, scene) as renderer, make(device, scene, upscale=2) as other:
        render_frames(renderer, None, 3)
        renderer.settings.upscale = 2
        renderer.view = "shading_normal"
        assert renderer.render()["display"].shape == (*SIZE, 4)
        renderer.view = "picture"
        found, right = read(render_frames(renderer, None, 20)), read(render_frames(other, None, 24))
    assert relative_mse(found, right) < 0.1


def test_exposure_changes_nothing(device):
    pictures = []
    for ev100 in (-40.0, 40.0):
        scene = checkerboard(1.5)
        scene.camera.ev100 = ev100
        with make(device, scene) as renderer:
            pictures.append(read(render_frames(renderer, None, 4)))
    assert relative_mse(*pictures) < 1e-4


def test_the_cameras_own_jitter_moves_the_picture(device):
    """A camera whose jitter is 3 pixels shows the picture moved by 3 pixels, in one frame as over many."""
    scene = checkerboard(6.0)
    with make(device, scene) as renderer:
        still = read(render_frames(renderer, None, 32))
        scene.camera.jitter = (3, 0)
        picture = read(renderer.render())
    inside = slice(8, -8)
    assert share_of_earlier(still[inside, 11:-5], still.mean(), picture[inside, 8:-8]) == pytest.approx(1, abs=0.1)
