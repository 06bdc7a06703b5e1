"""`sv.mujoco`: depth and segmentation beside MuJoCo's own renderer, worlds beside single pictures."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.robots import poses

mujoco = pytest.importorskip("mujoco")

MODEL = """<mujoco>
  <asset><mesh name="tip" vertex="0 0 0 .5 0 0 0 .5 0 0 0 .8"/>
    <hfield name="hill" nrow="3" ncol="3" size=".6 .6 .3 .1" elevation="0 0 0 0 1 0 0 0 0"/></asset>
  <worldbody>
    <light pos="0 -1 3"/>
    <camera name="front" pos="0 -3 1.2" xyaxes="1 0 0 0 .3 1" fovy="50"/>
    <camera name="shifted" pos="1 -3 1.5" xyaxes="1 .3 0 0 .3 1" sensorsize=".004 .003" resolution="40 30"
      focal=".004 .005" principal=".0004 -.0003"/>
    <camera name="flat" pos="0 -3 1.2" xyaxes="1 0 0 0 .3 1" fovy="3" projection="orthographic"/>
    <geom name="floor" type="plane" size="0 0 1"/>
    <geom type="hfield" hfield="hill" pos="1.2 1 .11"/>
    <body pos="-.6 0 .8"><freejoint/><geom type="box" size=".3 .1 .2" rgba=".8 .2 .1 .5"/>
      <camera name="eye" pos=".5 -1 0" xyaxes="1 0 0 0 0 1"/></body>
    <body pos=".3 0 1"><freejoint/><geom type="capsule" size=".1 .15" euler="0 40 0" rgba=".1 .3 .8 1"/></body>
    <body pos="0 .5 .6"><freejoint/><geom type="ellipsoid" size=".2 .1 .3" group="1"/>
      <site size=".1" pos=".5 0 0"/></body>
    <body pos=".9 0 .3"><freejoint/><geom type="mesh" mesh="tip"/><geom type="sphere" size=".5" group="3"/></body>
    <body pos="-.2 -.6 .3"><freejoint/><geom type="cylinder" size=".1 .2"/></body>
  </worldbody>
</mujoco>"""
SIZE = 96, 128

CHILD = """
import sys
import mujoco, numpy as np
model = mujoco.MjModel.from_xml_string(sys.stdin.read())
data = mujoco.MjData(model)
mujoco.mj_step(model, data, 50)
found = {}
for camera in (-1, 0, 1, 2):
    with mujoco.Renderer(model, 96, 128) as renderer:
        renderer.update_scene(data, camera)
        renderer.enable_depth_rendering()
        found[f"depth{camera}"] = renderer.render()
        renderer.enable_segmentation_rendering()
        found[f"ids{camera}"] = renderer.render()
np.savez(sys.argv[1], **found)
"""


@pytest.fixture(scope="module")
def state():
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 50)
    return model, data


@pytest.fixture(scope="module")
def judge(tmp_path_factory):
    """What MuJoCo's renderer shows, in a process of its own, which has a GL of its own."""
    path = tmp_path_factory.mktemp("judge") / "found.npz"
    given = {**os.environ, "MUJOCO_GL": "egl"}
    child = subprocess.run([sys.executable, "-c", CHILD, path], input=MODEL, text=True, env=given, capture_output=True)
    if not path.exists():
        pytest.skip(f"MuJoCo can't render here: {child.stderr[-200:]}")
    return np.load(path)


@pytest.mark.parametrize("camera", [-1, 0, "shifted", 2])
def test_depth_and_segmentation_are_mujocos(device, state, judge, camera):
    """But at edges, where a pixel shows one or the other, and on round geoms, which MuJoCo draws with fewer faces."""
    model, data = state
    key = {"shifted": 1}.get(camera, camera)
    with sv.mujoco.Renderer(model, *SIZE, device=device) as renderer:
        renderer.update_scene(data, camera)
        renderer.enable_depth_rendering()
        depth = renderer.render()
        renderer.enable_segmentation_rendering()
        ids = renderer.render()
    assert (depth.dtype, ids.dtype) == (np.float32, np.int32)
    expected, wanted = judge[f"depth{key}"], judge[f"ids{key}"]
    assert len(np.unique(wanted[..., 0])) >= 6
    same = (ids == wanted).all(axis=-1)
    assert same.mean() > 0.99
    error = np.abs(depth - expected)[same] / expected[same]
    assert np.median(error) < 2e-5
    assert np.quantile(error, 0.99) < 0.01


def test_the_interface_is_mujocos(device, state):
    model, data = state
    with sv.mujoco.Renderer(model, 24, 32, device=device, frames=2) as renderer:
        assert (renderer.height, renderer.width, renderer.model) == (24, 32, model)
        with pytest.raises(sv.SolariError, match="update_scene"):
            renderer.render()
        renderer.update_scene(data, "front")
        first = renderer.render()
        assert (first.shape, first.dtype) == ((24, 32, 3), np.uint8)
        assert first.std() > 10
        out = np.zeros_like(first)
        assert renderer.render(out=out) is out
        assert out.any()
        with pytest.raises(sv.SolariError, match=r"shape \(24, 32, 3\)"):
            renderer.render(out=np.zeros((2, 2)))
        renderer.enable_segmentation_rendering()
        assert 4 in renderer.render()[..., 0]  # the ellipsoid, which the option hides
        option = mujoco.MjvOption()
        option.geomgroup[:] = 0
        option.sitegroup[:] = 0
        renderer.update_scene(data, "front", option)
        assert (renderer.render() == -1).all()
        # A geom that the user adds.
        scene = renderer.scene
        mujoco.mjv_initGeom(
            scene.geoms[scene.ngeom],
            mujoco.mjtGeom.mjGEOM_SPHERE,
            [0.3, 0, 0],
            [0, 0, 1],
            np.eye(3).ravel(),
            [1, 0, 0, 1],
        )
        scene.ngeom += 1
        renderer.enable_depth_rendering()
        assert (renderer.render() < 4).any()
        renderer.disable_depth_rendering()
        assert renderer.render().dtype == np.uint8
        for camera in ("none", 9, -2):
            with pytest.raises(sv.SolariError, match="camera"):
                renderer.update_scene(data, camera)
    with pytest.raises(sv.SolariError, match="after close"):
        renderer.render()


def test_what_moves_and_changes_is_shown(device, state):
    """Two states, a color that is edited, and a light: each changes the next picture where it should."""
    model, data = mujoco.MjModel.from_xml_string(MODEL), state[1]
    with sv.mujoco.Renderer(model, 24, 32, device=device, renderer="reference", samples=64) as renderer:
        renderer.update_scene(data, "front")
        before = renderer.render().astype(int)
        other = mujoco.MjData(model)
        other.qpos[0] += 0.8
        mujoco.mj_forward(model, other)
        renderer.update_scene(other, "front")
        assert np.abs(renderer.render().astype(int) - before).max() > 60
        model.geom_rgba[model.geom("floor").id] = (1, 0, 0, 1)
        renderer.update_scene(data, "front")
        red = renderer.render().astype(int)
        floor = np.s_[-3:]
        assert red[floor][..., 1].mean() < 0.5 * before[floor][..., 1].mean()
        renderer.lit.environment = sv.Environment(20.0)
        assert renderer.render().mean() > red.mean() + 40


@pytest.fixture(scope="module")
def worlds(state):
    model, _ = state
    states = [mujoco.MjData(model) for _ in range(3)]
    for number, data in enumerate(states):
        data.qvel[:] = np.random.default_rng(number).normal(size=model.nv)
        mujoco.mj_step(model, data, 40)
    return states


OUTPUTS = ("depth", "instance_id")


def test_worlds_show_their_states(device, state, worlds):
    """Depth and objects of each world and camera are those of a renderer of its state alone."""
    model, _ = state
    cameras = ["eye", "shifted"]
    options = {"cameras": cameras, "renderer": "labels", "outputs": OUTPUTS, "device": device}
    with sv.mujoco.Batch(model, 3, 30, 40, **options) as batch:
        found = batch.render(worlds)
        depth, ids = found["depth"], found["segmentation"]
    assert depth.shape == (3, 2, 30, 40)
    with sv.mujoco.Renderer(model, 30, 40, device=device) as renderer:
        for world, data in enumerate(worlds):
            for number, camera in enumerate(cameras):
                renderer.update_scene(data, camera)
                renderer.enable_segmentation_rendering()
                expected = renderer.render()
                seen = expected[..., 0] >= 0
                # The box is half transparent, which labels show by chance.
                solid = seen & ~(expected == (2, 5)).all(axis=-1)
                assert (ids[world, number] == expected)[solid].mean() > 0.98
                renderer.enable_depth_rendering()
                np.testing.assert_allclose(
                    np.median(depth[world, number][solid] / renderer.render()[solid]), 1, atol=1e-4
                )
    assert len({one.tobytes() for one in depth[:, 1]}) == 3


def test_arrays_and_lists_are_the_same(device, state, worlds):
    model, _ = state
    names = ("geom_xpos", "geom_xmat", "cam_xpos", "cam_xmat", "site_xpos", "site_xmat")
    arrays = {name: np.stack([getattr(one, name) for one in worlds]) for name in names}
    with sv.mujoco.Batch(model, 3, 24, 32, renderer="labels", outputs=OUTPUTS, device=device, cameras=["eye"]) as batch:
        expected = batch.render(worlds)["depth"]
        batch.render([worlds[0]] * 3)
        np.testing.assert_array_equal(batch.render(arrays)["depth"], expected)
        with pytest.raises(sv.SolariError, match=r"geom_xpos has the shape \(2, 8, 3\)"):
            batch.render({name: values[:2] for name, values in arrays.items()})
        with pytest.raises(sv.SolariError, match="no geom_xpos"):
            batch.render({})
    with pytest.raises(sv.SolariError, match="no camera 'nose'"):
        sv.mujoco.Batch(model, 3, device=device, cameras=["nose"])


def test_arrays_of_warp_are_turned_where_they_are(device, state, worlds):
    """As those of MuJoCo Warp: on a GPU they would stay there."""
    wp = pytest.importorskip("warp")
    model, _ = state
    with sv.mujoco.Batch(model, 3, 24, 32, renderer="labels", outputs=OUTPUTS, device=device, cameras=["eye"]) as batch:
        expected = batch.render(worlds)["depth"]
        batch.render([worlds[0]] * 3)
        data = {}
        for kind in ("geom", "cam", "site"):
            places, axes = (np.stack([getattr(one, f"{kind}_{what}") for one in worlds]) for what in ("xpos", "xmat"))
            data[f"{kind}_xpos"] = wp.array(places, dtype=wp.vec3f, device="cpu")
            data[f"{kind}_xmat"] = wp.array(axes.reshape(*places.shape[:2], 3, 3), dtype=wp.mat33f, device="cpu")
        found = batch.render(data)["depth"]
    finite = np.isfinite(expected)
    assert (finite == np.isfinite(found)).mean() > 0.999
    assert np.median(np.abs(found - expected)[finite & np.isfinite(found)]) < 1e-4


def test_poses_of_warp_keep_their_memory():
    """Of numbers that aren't contiguous, which are copied first; and nothing but float32."""
    wp = pytest.importorskip("warp")
    values = np.random.default_rng(1).normal(size=(2, 50, 3)).astype(np.float32)
    parts = wp.array(np.repeat(values, 2, axis=1), dtype=wp.float32, device="cpu")[:, ::2]
    turns = wp.array(np.tile(np.eye(3, dtype=np.float32).ravel(), (2, 50, 1)), dtype=wp.float32, device="cpu")
    found = poses._array(wp, parts, wp.vec3f)
    for _ in range(100):  # what would take freed memory
        wp.array(np.zeros((2, 50, 3), np.float32), device="cpu")
    np.testing.assert_array_equal(found.numpy(), values)
    assert found.memory_of is not parts
    moved = poses.scene_poses(parts, turns, [3]).numpy()
    np.testing.assert_allclose(moved[:, 0, :3, 3], values[:, 3] @ poses.UP.T)
    with pytest.raises(sv.SolariError, match="float32, not float64"):
        poses.scene_poses(wp.array(values, dtype=wp.float64, device="cpu"), turns, [3])


def test_bodies_without_joints_move_with_their_world(device):
    model = mujoco.MjModel.from_xml_string('<mujoco><worldbody><body><geom size=".2"/></body></worldbody></mujoco>')
    places = np.array([(0, 0, 0.0), (0, 0, 3)]).reshape(2, 1, 3)
    given = {"geom_xpos": places, "geom_xmat": np.tile(np.eye(3), (2, 1, 1, 1))}
    with sv.mujoco.Batch(model, 2, 8, 8, renderer="labels", outputs=("depth",), device=device) as batch:
        depth = batch.render(given)["depth"]
    assert np.isfinite(depth[0]).any()
    assert not np.isfinite(depth[1]).any()


def test_wrong_models_and_states_get_one_line(device, state):
    model, data = state
    for wrong in (None, "robot.xml", mujoco.MjSpec()):
        for make in (sv.mujoco.scene, sv.mujoco.Renderer, lambda one: sv.mujoco.Batch(one, 2)):
            with pytest.raises(sv.SolariError, match="the model is an MjModel, not"):
                make(wrong)
    other = mujoco.MjModel.from_xml_string("<mujoco/>")
    with pytest.raises(sv.SolariError, match="no geoms that are shown"):
        sv.mujoco.Batch(other, 1, device=device)
    with pytest.raises(sv.SolariError, match="another model"):
        sv.mujoco.scene(model, mujoco.MjData(other))
    with pytest.raises(sv.SolariError, match="mj_forward"):
        sv.mujoco.scene(model, mujoco.MjData(model))
    arrays = {"geom_xpos": data.geom_xpos[None], "geom_xmat": data.geom_xmat[None]}
    options = {"renderer": "labels", "outputs": ("depth",), "device": device, "cameras": ["front"]}
    with sv.mujoco.Batch(model, 1, 8, 8, **options) as batch:
        for wrong, message in (
            ([1], "an MjData, not int"),
            (arrays | {"geom_xmat": np.zeros((1, 8, 4))}, "geom_xmat has the shape"),
            (arrays | {"geom_xpos": [[1], [2, 3]]}, "geom_xpos isn't an array of numbers"),
        ):
            with pytest.raises(sv.SolariError, match=message):
                batch.render(wrong)
        alone = batch.render(data)["depth"]
        np.testing.assert_array_equal(alone, batch.render([data])["depth"])
        nested = {name: values.tolist() for name, values in arrays.items()}
        np.testing.assert_array_equal(alone, batch.render(nested)["depth"])


def test_worlds_are_lit(device, state, worlds):
    model, _ = state
    with sv.mujoco.Batch(model, 3, 24, 32, cameras=["front"], device=device) as batch:
        batch.render(worlds)
        pictures = batch.render(worlds, reset=False)["display"]
        same = np.from_dlpack(batch.tensor("radiance"))
    assert pictures.shape == (3, 1, 24, 32, 4)
    assert same.shape == (3, 1, 24, 32, 3)
    assert pictures[..., :3].std() > 20
    assert len({one.tobytes() for one in pictures}) == 3


def test_one_world_and_no_camera(device):
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><freejoint/><geom size=".2"/></body></worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    data.qpos[2] = 0.1
    mujoco.mj_forward(model, data)
    with sv.mujoco.Batch(model, 1, 24, 32, renderer="labels", outputs=OUTPUTS, device=device) as batch:
        assert np.isfinite(batch.render([data])["depth"]).any()
        assert batch.scene.instances[0].position[1] == pytest.approx(0.1)
