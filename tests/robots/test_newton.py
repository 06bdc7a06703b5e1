"""`sv.newton.SensorCamera` beside Newton's own sensor on the processor: depth, normals, shapes and colors."""

from __future__ import annotations

import abc
import math
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import solari_vk as sv

newton, wp = pytest.importorskip("newton"), pytest.importorskip("warp")
sensors = pytest.importorskip("newton.sensors")

SIZE = 48, 36
WORLDS = 3
COLORS = ((0.9, 0.2, 0.1), (0.1, 0.8, 0.2), (0.2, 0.3, 0.9))


@pytest.fixture(scope="module")
def model():
    builder = newton.ModelBuilder()
    builder.add_ground_plane(color=(0.8, 0.8, 0.8))
    for world in range(WORLDS):
        one = newton.ModelBuilder()
        turned = wp.transform(wp.vec3(-0.8, 0.0, 0.6), wp.quat_rpy(0.3, 0.2, 0.5 + 0.3 * world))
        one.add_shape_box(one.add_body(xform=turned), hx=0.3, hy=0.2, hz=0.4, color=COLORS[world])
        one.add_shape_sphere(one.add_body(xform=wp.transform(wp.vec3(0.1, 0.2, 0.5 + 0.2 * world))), radius=0.3)
        body = one.add_body(xform=wp.transform(wp.vec3(0.9, 0.0, 0.7), wp.quat_rpy(0.4, 0.0, 0.0)))
        one.add_shape_capsule(
            body, xform=wp.transform(wp.vec3(0.0, 0.0, 0.1), wp.quat_identity()), radius=0.15, half_height=0.3
        )
        one.add_shape_mesh(one.add_body(xform=wp.transform(wp.vec3(0.0, -0.8, 0.1))), mesh=MESH)
        builder.add_world(one)
    return builder.finalize(device="cpu")


MESH = newton.Mesh(
    np.array([(0, 0, 0), (0.5, 0, 0), (0, 0.5, 0), (0, 0, 0.8)], np.float32),
    np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)], np.int32).ravel(),
)


def cameras():
    """Two of the first world and one of the last."""
    tilt = np.array([math.sin(math.radians(40)), 0, 0, math.cos(math.radians(40))])  # looks along y, and down
    poses = [(0, -3.2, 1.3, *tilt), (0, -3.0, 1.0, *tilt), (0.2, -3.4, 1.5, *tilt)]
    return wp.array(np.array(poses, np.float32), dtype=wp.transformf, device="cpu"), wp.array(
        [0, 0, 2], dtype=wp.int32, device="cpu"
    )


NAMES = {
    "depth_image": "depth", "forward_depth_image": "depth_forward", "normal_image": "normal",
    "shape_index_image": "shape_index", "albedo_image": "albedo", "color_image": "color",
    "hdr_color_image": "color_hdr",
}  # fmt: skip


def taken(sensor, model, names, **options):
    transforms, worlds = cameras()
    rays = type(sensor).compute_camera_rays_pinhole(*SIZE, camera_fov=math.radians(50), device="cpu")
    images = {name: getattr(sensor, f"allocate_image_{NAMES[name]}")(3, *SIZE) for name in names}
    state = model.state()
    sensor.update(state, transforms, rays, world_indices=worlds, **images, **options)
    return {name: image.numpy() for name, image in images.items()}


def test_first_hits_are_newtons(device, model):
    names = [name for name in NAMES if "color" not in name]
    theirs = taken(sensors.SensorCamera(model), model, names)
    with sv.newton.SensorCamera(model, device=device) as sensor:
        ours = taken(sensor, model, names)
    same = ours["shape_index_image"] == theirs["shape_index_image"]
    assert same.mean() > 0.985
    assert len(np.unique(theirs["shape_index_image"])) >= 9
    for name in ("depth_image", "forward_depth_image"):
        hit = same & (theirs[name] > 0)
        assert np.median(np.abs(ours[name] / np.where(hit, theirs[name], 1) - 1)[hit]) < 1e-4
        assert np.quantile(np.abs(ours[name] - theirs[name])[hit], 0.99) < 0.02
        assert (ours[name] == 0)[same & (theirs[name] == 0)].all()
    cosine = (ours["normal_image"] * theirs["normal_image"]).sum(axis=-1)
    assert np.quantile(cosine[same & (theirs["depth_image"] > 0)], 0.02) > 0.99
    bytes_of = [
        found["albedo_image"][same].copy().view(np.uint8).reshape(-1, 4).astype(int) for found in (ours, theirs)
    ]
    assert np.quantile(np.abs(bytes_of[0] - bytes_of[1]), 0.99) <= 2


def test_colors_are_lit(device, model):
    """Where a light shines straight on, a color is as bright as with Newton's sensor; what is below is in shadow."""
    names = ["color_image", "hdr_color_image", "shape_index_image"]
    sensor = sensors.SensorCamera(model)
    sensor.create_default_light()
    theirs = taken(sensor, model, names)
    with sv.newton.SensorCamera(model, device=device, frames=6) as sensor:
        sensor.create_default_light()
        ours = taken(sensor, model, names)
    assert ours["color_image"].dtype == np.uint32
    assert (ours["color_image"] >> 24 == 255).all()
    ground = theirs["shape_index_image"][0] == 0
    lit = ours["hdr_color_image"][0][ground].mean(axis=-1), theirs["hdr_color_image"][0][ground].mean(axis=-1)
    assert np.quantile(lit[0], 0.8) == pytest.approx(np.quantile(lit[1], 0.8), rel=0.25)
    boxes = [ours["hdr_color_image"][view][ours["shape_index_image"][view] % 4 == 1] for view in (0, 2)]
    means = [box.mean(axis=0) for box in boxes]
    assert means[0][0] > 2 * means[0][2]  # red in the first world, blue in the last
    assert means[1][2] > 2 * means[1][0]


def test_views_that_are_off_and_wrong_arguments(device, model):
    transforms, _ = cameras()
    flag = sensors.SensorCamera.WorldRenderFlag
    with sv.newton.SensorCamera(model, device=device) as sensor:
        rays = sensor.compute_camera_rays_pinhole(*SIZE, camera_fov=1.0, device="cpu")
        depth = sensor.allocate_image_depth(3, *SIZE)
        depth.fill_(7.0)
        which = wp.array([int(flag.DISABLE_PRESERVE), 1, int(flag.DISABLE_CLEAR)], dtype=wp.int32, device="cpu")
        sensor.update(model.state(), transforms, rays, world_indices=which, depth_image=depth)
        found = depth.numpy()
        assert (found[0] == 7).all()
        assert (found[1] > 0).any()
        assert not found[2].any()
        with pytest.raises(sv.SolariError, match=r"must be \(3, 36, 48\)"):
            sensor.update(model.state(), transforms, rays, depth_image=sensor.allocate_image_depth(2, *SIZE))
        bent = wp.array(rays.numpy() + np.float32(0.1), dtype=wp.vec3f, device="cpu")
        with pytest.raises(sv.SolariError, match="pinhole"):
            sensor.update(model.state(), transforms, bent, depth_image=depth)
        with pytest.raises(sv.SolariError, match="no 'depth'"):
            sensor.update(model.state(), transforms, rays, depth=depth)


def test_worlds_with_other_shapes_are_refused(device):
    builder = newton.ModelBuilder()
    for radius in (0.2, 0.3):
        one = newton.ModelBuilder()
        one.add_shape_sphere(one.add_body(), radius=radius)
        builder.add_world(one)
    with pytest.raises(sv.SolariError, match="different shapes"):
        sv.newton.SensorCamera(builder.finalize(device="cpu"), device=device)


class _Buffer:
    """As Isaac Lab's ProxyArray."""

    def __init__(self, values, dtype):
        self.warp = wp.array(values, dtype=dtype, device="cpu")


def test_isaac_labs_interface_is_filled(device, model, monkeypatch):
    """By a stand-in for the interface, with the methods of its public text: Isaac Lab itself isn't tried."""
    names = (
        "supported_output_types", "prepare_stage", "create_render_data", "set_outputs", "update_transforms",
        "update_geometries", "update_camera", "render", "read_output", "cleanup",
    )  # fmt: skip
    base = abc.ABCMeta("BaseRenderer", (), {name: abc.abstractmethod(lambda *_: None) for name in names})
    fake = SimpleNamespace(BaseRenderer=base, RenderBufferKind=str, RenderBufferSpec=lambda *spec: spec)
    monkeypatch.setitem(sys.modules, "isaaclab", SimpleNamespace(renderers=fake))
    monkeypatch.setitem(sys.modules, "isaaclab.renderers", fake)
    renderer = sv.isaac_lab.renderer(model, model.state(), device=device, frames=1)
    assert renderer.supported_output_types()["depth"] == (1, wp.float32)
    data = renderer.create_render_data(SimpleNamespace(cfg=SimpleNamespace(width=SIZE[0], height=SIZE[1])))
    outputs = {
        "rgb": _Buffer(np.zeros((3, *SIZE[::-1], 3)), wp.uint8),
        "depth": _Buffer(np.zeros((3, *SIZE[::-1], 1)), wp.float32),
    }
    renderer.set_outputs(data, outputs)
    # Isaac Lab's cameras look along x with z up: a quarter of a turn about z looks along y.
    half = math.sqrt(0.5)
    focal = SIZE[1] / 2 / math.tan(math.radians(25))
    turns = _Buffer(np.tile([0, 0, half, half], (3, 1)), wp.quatf)
    lens = _Buffer(np.tile([[focal, 0, 24], [0, focal, 18], [0, 0, 1]], (3, 1, 1)), wp.mat33f)
    renderer.update_camera(data, _Buffer(np.tile([0, -3.2, 0.6], (3, 1)), wp.vec3f), turns, lens)
    renderer.render(data)
    renderer.close()
    depth = outputs["depth"].warp.numpy()[..., 0]
    rays = sensors.SensorCamera.compute_camera_rays_pinhole(*SIZE, camera_fov=math.radians(50), device="cpu")
    level = np.tile([0, -3.2, 0.6, half, 0, 0, half], (3, 1)).astype(np.float32)
    theirs = sensors.SensorCamera(model)
    expected = theirs.allocate_image_depth_forward(3, *SIZE)
    transforms = wp.array(level, dtype=wp.transformf, device="cpu")
    theirs.update(model.state(), transforms, rays, forward_depth_image=expected)
    assert np.quantile(np.abs(depth - expected.numpy()), 0.97) < 0.02
    assert outputs["rgb"].warp.numpy().std() > 5
    with pytest.raises(sv.SolariError, match="motion"):
        renderer.set_outputs(data, {"motion": None})
