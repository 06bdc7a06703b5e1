"""Depth of field in realtime frames: the mean is the path tracer's, and denoised frames converge as sharp ones do."""

from __future__ import annotations

import numpy as np
import pytest
from proofs.path_tracer.test_depth_of_field import APERTURE, CAMERAS, DISTANCE, FOV, SIZE, check_disk, spread_of
from support.frames import GBUFFER, PATHS, make_renderer, path_traced
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.bound.projection import lens_point
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte, place


def balls():
    """Balls before, in and behind the focus, on a floor, in a lit box."""
    scene = sv.builtin("cornell_box")
    for z, color in ((-0.3, (0.8, 0.2, 0.1)), (0.9, (0.2, 0.7, 0.2)), (1.7, (0.2, 0.3, 0.8))):
        scene.add(sv.Instance(shapes.sphere(0.22, 24), matte(color), transform=place(1.0, (0.6 + 0.4 * z, 0.3, z))))
    scene.camera = sv.Camera.look_at((1, 0.9, -2.6), (1, 0.9, 1), vertical_fov=0.8, ev100=scene.camera.ev100)
    scene.camera.update(aperture=0.25, focus_distance=3.5)
    return scene


def relative_error(picture, truth):
    return np.mean((picture - truth) ** 2 / (truth**2 + 1e-2 * truth.mean() ** 2))


@pytest.mark.parametrize(
    ("kind", "focus"),
    [
        ("perspective", 2.0),
        *(
            pytest.param(*others, marks=pytest.mark.slow)
            for others in (("perspective", 4.0), ("orthographic", 2.0), ("fisheye", 2.0))
        ),
    ],
)
def test_the_disk_of_confusion(device, kind, focus):
    """The mean of frames of a small lamp is the disk of confusion that optics gives, with the same light."""
    found = []
    for aperture in (0.0, APERTURE):
        fields = {"projection": kind} if kind == "fisheye" else CAMERAS[kind]
        scene = sv.Scene(sv.Camera(vertical_fov=FOV, aperture=aperture, focus_distance=focus, **fields))
        scene.add(shapes.quad((0, 0, -DISTANCE), (0.06, 0, 0), (0, 0.06, 0)), lamp(1000.0))
        with make_renderer(device, scene, SIZE, passes=PATHS, jitter=True) as renderer:
            light = sum(np.asarray(renderer.render()["sample_radiance"], np.float64)[..., 0] for _ in range(256)) / 256
        found.append(spread_of(light))
    check_disk(*found, focus)


def test_points_are_where_the_lens_shows_them(device):
    """Positions of the G-buffer lie on its surfaces, and motion vectors follow the point of the lens."""
    scene = balls()
    with make_renderer(device, scene, SIZE, passes=GBUFFER, jitter=False) as renderer:
        renderer.render()
        frame = renderer.render()
        assert renderer.gbuffer == "traced"
        motion = np.abs(frame["motion_vectors"] * SIZE).max(axis=-1)
        depth = scene.camera.near / np.maximum(frame["gbuffer_depth"].reshape(SIZE), 1e-9)
    # The parallax of two points of the lens is 0 in focus, and grows with the difference of inverse depths.
    apart = np.abs(1 / depth - 1 / 3.5)
    assert motion[apart < 1e-3].max() < 0.05
    ratio = motion[apart > 0.05] / apart[apart > 0.05]
    assert ratio.min() > 0
    assert np.ptp(ratio) < 0.2 * ratio.mean()


WIDE = {
    "fisheye": {"vertical_fov": 3.0},
    "stereographic": {"vertical_fov": 2.5},
    "equirectangular": {"eye_offset": 0.05},
    "cube": {},
}


def beside(directions, point):
    """A point of the aperture (2,) of wide lenses, y up, as it is for directions in the camera's axes (..., 3): the
    aperture turns from the view axis (-z) by the shortest way."""
    axis = np.cross((0.0, 0.0, -1.0), directions)
    sine, cosine = np.linalg.norm(axis, axis=-1, keepdims=True), -directions[..., 2:]
    unit, flat = axis / np.maximum(sine, 1e-12), np.array((*point, 0.0))
    across = (unit @ flat)[..., None]
    return cosine * flat + sine * np.cross(unit, flat) + (1 - cosine) * across * unit  # Rodrigues


@pytest.mark.parametrize("kind", WIDE)
def test_wide_lenses(device, kind):
    """The motion of a still scene from frame to frame is that of the point of the lens: it leads to a pixel whose line
    through the other point meets the surface."""
    size = (96, 16) if kind == "cube" else (64, 32) if kind == "equirectangular" else (48, 48)
    camera = sv.Camera.look_at(
        (0.9, 1.1, 0.6), (1, 0.9, 2), projection=kind, aperture=0.06, focus_distance=0.9, **WIDE[kind]
    )
    turn = camera.transform[:3, :3]
    with make_renderer(device, sv.builtin("cornell_box"), size, passes=GBUFFER, jitter=False) as renderer:
        renderer.render(camera)
        frame = renderer.render(camera)
        motion = frame["motion_vectors"].astype(np.float64) * size
        depth = camera.near / np.maximum(frame["gbuffer_depth"].reshape(size[::-1]), 1e-9)
    pixels = np.stack(np.meshgrid(np.arange(size[0]), np.arange(size[1])), -1).astype(np.float64)

    def line(number, where):
        origins, directions = camera.rays(where, size)
        offset = beside(directions @ turn, lens_point(camera, number)) @ turn.T
        return origins + offset, directions - offset / camera.focus_distance

    start, along = line(1, pixels)
    points = start + depth[..., None] * along
    start, along = line(0, pixels + motion)
    away = points - start
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    off = np.linalg.norm(away - (away * along).sum(-1, keepdims=True) * along, axis=-1) / depth
    pixel = np.linalg.norm(
        camera.rays((size[0] / 2, size[1] / 2), size)[1] - camera.rays((size[0] / 2 + 1, size[1] / 2), size)[1]
    )
    seen = np.isfinite(off) & (depth < 100)
    if kind == "equirectangular":
        seen[[0, 1, -2, -1]] = False  # above and below the circle of the eye, where a point may be seen from nowhere
    assert seen.mean() > 0.6
    assert np.quantile(np.linalg.norm(motion, axis=-1)[seen], 0.5) > 0.1
    assert np.quantile(off[seen], 0.995) < 0.02 * pixel
    assert off[seen].max() < 0.2 * pixel


@pytest.mark.slow
@pytest.mark.parametrize(
    "fields",
    [
        {},
        {
            "projection": "fisheye",
            "vertical_fov": 1.6,
            "aperture_blades": 3,
            "position": (1, 0.9, -0.9),
            "focus_distance": 1.8,
        },
    ],
    ids=["perspective", "fisheye"],
)
def test_denoised_frames_converge_as_sharp_ones_do(device, fields):
    """The mean of frames within 2 % of the path tracer's, sixteenths nearly as a sharp picture's; the error of frame 32
    at most twice a sharp picture's."""
    errors, worst = {}, {}
    for aperture in (0.0, 0.25):
        scene = balls()
        scene.camera.update(**{"aperture": aperture, **fields})
        truth = path_traced(device, scene, 1024, SIZE)
        with sv.Renderer(device, scene, SIZE) as renderer:
            frames = [np.asarray(renderer.render()["radiance"], np.float64) for _ in range(64)]
        errors[aperture] = relative_error(frames[31], truth)
        mean = np.mean(frames[32:], axis=0)
        off = mean.mean() / truth.mean() - 1
        tiles = [picture.reshape(4, 16, 4, 16, 3).mean(axis=(1, 3, 4)) for picture in (mean, truth)]
        worst[aperture] = np.abs(tiles[0] / tiles[1] - 1).max()
        print(
            f"aperture {aperture}: relMSE of frame 32 {errors[aperture]:.4f}, mean {off:+.2%}, "
            f"tiles {worst[aperture]:.2%}"
        )
        assert abs(off) < 0.02
    assert errors[0.25] <= 2 * errors[0.0]
    assert worst[0.25] < worst[0.0] + 0.04


LENS = ("scene/camera.glsl", "view_ray")
test_a_seeded_bug_is_noticed = bug_tests(
    {
        "a lens twice as wide": (
            lambda device: test_the_disk_of_confusion(device, "perspective", 2.0),
            Bug(
                *LENS,
                "ViewRay ray = correct(position, from); ray.origin.xy += from.lens_offset;\n"
                "    ray.direction.xy -= from.lens_offset / from.focus_distance; return ray;",
            ),
        ),
        "wide lenses whose aperture faces the view axis": (
            lambda device: test_wide_lenses(device, "fisheye"),
            Bug("scene/camera.glsl", "on_aperture", "return vec3(offset.x, -offset.y, 0.0);"),
        ),
        "no steps to wide positions": (
            lambda device: test_wide_lenses(device, "fisheye"),
            Bug("scene/camera.glsl", "LENS_STEPS", "0"),
        ),
        "motion without the lens": (
            test_points_are_where_the_lens_shows_them,
            Bug(
                "scene/camera.glsl",
                "project_to_uv",
                "Camera still = from; still.lens_offset = vec2(0.0); return correct(world_position, still);",
            ),
        ),
    }
)
