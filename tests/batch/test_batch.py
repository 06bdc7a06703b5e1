"""Batches: each view is bit by bit that of a renderer of its own; arrays in and out; edits, cuts, wrong input."""

from __future__ import annotations

import math
import threading
from unittest.mock import Mock

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.batch import view_cameras
from solari_vk.batch.batch import SHADER
from solari_vk.batch.options import check_realtime
from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.projection import Projection
from solari_vk.cli import main
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.gpu.shaders.spirv import reflect
from solari_vk.lab.measure import dataset as measure_dataset
from solari_vk.passes import batch as passes
from solari_vk.passes import first_hits
from solari_vk.passes.reference import numbered_seed
from solari_vk.renderers.first_hit_reader import FirstHitReader

SIZE = (13, 7)  # views begin within workgroups
FIRST_HITS = [name for name in passes.OUTPUTS if name in first_hits.FIRST_HITS]


def box_cameras(count, **fields):
    """Cameras around and within the Cornell box, which look at points within it."""
    rng = np.random.default_rng(count)
    places, aims = rng.uniform((0, 0, -2), (2, 2, 1), (count, 3)), rng.uniform(0.2, 1.8, (count, 3))
    return [sv.Camera.look_at(place, aim, **fields) for place, aim in zip(places, aims, strict=True)]


def poses_of(cameras):
    return np.stack([camera.transform for camera in cameras])


def check_first_hits(device, batch, cameras):
    """Each view is what the path tracer and the renderer find with a camera."""
    found = {name: batch[name] for name in FIRST_HITS}
    single = FirstHitReader(device, batch.binder, {})
    for index, camera in enumerate(cameras):
        for name, values in found.items():
            expected = single.read(name, Projection.of(camera, batch.size), batch.size)
            assert values.dtype == expected.dtype
            np.testing.assert_array_equal(values[index], expected, err_msg=f"{name} of view {index}")
    single.close()
    assert np.isfinite(found["depth"]).any()
    return found


@pytest.fixture(scope="module")
def scene():
    return sv.builtin("cornell_box")


@pytest.fixture(scope="module")
def binder(device, scene):
    bound = SceneBinder(device, scene)
    yield bound
    bound.destroy()


@pytest.fixture(scope="module")
def three(device, binder):
    """A batch of three views with all outputs but the light."""
    with sv.Batch(device, binder, SIZE, 3, outputs=sv.Batch.OUTPUTS) as batch:
        yield batch


# ---- views are those of renderers of their own ------------------------------------------------------


@pytest.mark.parametrize(("size", "count"), [((16, 16), 1), (SIZE, 5), ((3, 24), 3), ((1, 1), 17)])
@pytest.mark.parametrize("outputs", [passes.GEOMETRY, passes.OUTPUTS], ids=["geometry", "all"])
def test_first_hits_are_those_of_single_views(device, binder, size, count, outputs, monkeypatch):
    monkeypatch.setattr(passes, "MAX_PIXELS", size[0] * 9)  # several dispatches
    cameras = box_cameras(count, fov=70)
    with sv.Batch(device, binder, size, count, outputs=outputs) as batch:
        assert batch.render(poses_of(cameras), fov=70) is batch
        assert list(batch) == batch.keys() == list(outputs)
        monkeypatch.undo()
        monkeypatch.setattr(f"{__name__}.FIRST_HITS", [name for name in FIRST_HITS if name in outputs])
        check_first_hits(device, batch, cameras)


def test_pictures_are_those_of_single_views(device, binder):
    cameras, seeds = box_cameras(3, fov=70), [7, 0, 2**32 - 1]
    with sv.Batch(device, binder, SIZE, 3, renderer="reference", seed=5, max_bounces=3, outputs=["depth"]) as batch:
        assert batch.keys() == ["radiance", "depth"]
        given = batch.render(poses_of(cameras), fov=70, samples=3, seeds=seeds)["radiance"]
        dispatch = batch._paths._dispatch
        dispatch.samples, dispatch.rows = 2, 8  # as its own choice after some frames
        batch._paths._frame.rebuild(batch._paths._stages(batch._strip))
        dispatch.next_measurement = 10**9
        own = batch.render(cameras, samples=3)["radiance"]
        assert np.isfinite(batch["depth"]).any()
        assert own.shape == (3, 7, 13, 3)
    with sv.PathTracer(device, binder, SIZE, max_bounces=3) as tracer:
        for pictures, used in ((given, seeds), (own, [numbered_seed(5, index) for index in range(3)])):
            for index, camera in enumerate(cameras):
                tracer.seed = used[index]
                np.testing.assert_array_equal(pictures[index], tracer.render(camera, samples=3)["radiance"])
    assert (given[0] != own[0]).any()


def test_cameras_may_have_lenses(device):
    """Of any kind, in one batch: the feature comes with the first one."""
    size, fields = (16, 12), {"transform": sv.Camera.look_at((1, 1, 0.3), (1, 1, 1)).transform}
    cameras = [
        sv.Camera(**fields, projection="fisheye", vertical_fov=3.0, image_circle=2.5),
        sv.Camera(**fields, distortion=(-0.2, 0.05, 0.001, 0.0)),
        sv.Camera(**fields, orthographic_height=1.5, jitter=(0.3, -2)),
        sv.Camera(**fields, projection="equirectangular"),
        *box_cameras(1, principal_point=(0.4, 0.7), pixel_aspect=1.3),
    ]
    scene = sv.builtin("cornell_box")
    with sv.Batch(device, scene, size, 5, outputs=FIRST_HITS) as batch:
        batch.render(poses_of(cameras))
        plain = batch["depth"]
        found = check_first_hits(device, batch.render(cameras), cameras)
    assert np.isinf(found["depth"][0, 0, 0]) != np.isinf(plain[0, 0, 0])
    assert not np.array_equal(found["depth"], plain)


def test_primitives_are_the_users_triangles(three):
    three.render(poses_of(box_cameras(3)))
    primitive, instance_id, position = (three[name] for name in ("primitive", "instance_id", "position"))
    assert (primitive == -1).tolist() == (instance_id == 2**32 - 1).tolist()
    seen = primitive >= 0
    assert len(np.unique(primitive[seen])) > 4
    for row, instance in three.instances.items():
        pixels = seen & (instance_id == row)
        corners = instance.mesh.positions[instance.mesh.triangles[primitive[pixels]]] @ instance.transform[:3, :3].T
        corners += instance.transform[:3, 3]
        edges, apart = (corners[:, 1:] - corners[:, :1]).swapaxes(1, 2), (position[pixels] - corners[:, 0])[..., None]
        weights = np.linalg.pinv(edges) @ apart
        assert (weights > -1e-4).all()
        assert (weights.sum(axis=1) < 1 + 1e-4).all()
        assert np.abs(edges @ weights - apart).max(initial=0) < 1e-5


# ---- motion -----------------------------------------------------------------------------------------


def expected_motion(batch, before, now, moved=None):
    """By projecting the positions; moved: (instance, its world now from its world before)."""
    position, motion = batch["position"].astype(np.float64), []
    for index in range(batch.views):
        previous = position[index].copy()
        if moved is not None:
            instance, transform = moved
            rows = [row for row, other in batch.instances.items() if other is instance]
            pixels = np.isin(batch["instance_id"][index], rows)
            back = np.linalg.inv(transform)
            previous[pixels] = position[index][pixels] @ back[:3, :3].T + back[:3, 3]
        places = (
            camera.project(points, batch.size)
            for camera, points in ((before[index], previous), (now[index], position[index]))
        )
        motion.append(np.subtract(*places) / batch.size)
    return np.array(motion)


def check_motion(batch, before, now, moved=None):
    found = batch["motion_vectors"]
    expected = expected_motion(batch, before, now, moved)
    seen = batch["primitive"] >= 0
    seen &= np.isfinite(expected).all(axis=-1)
    assert seen.mean() > 0.2
    np.testing.assert_allclose(found[seen], expected[seen], atol=2e-5, rtol=1e-4)
    return np.abs(found[seen]).max()


@pytest.fixture
def many_dispatches(monkeypatch):
    """Of 11 rows each in pictures of 24x20."""
    monkeypatch.setattr(passes, "MAX_PIXELS", 24 * 11)


def test_motion_is_that_of_cameras_and_instances(device, many_dispatches):
    scene = sv.builtin("cornell_box")
    first = [sv.Camera.look_at((1 + 0.1 * i, 1, -2.5), (1, 1, 0)) for i in range(3)]
    second = [sv.Camera.look_at((1 + 0.1 * i, 1.1, -2.4), (1, 0.9, 0), fov=50) for i in range(3)]
    second[0] = sv.Camera.look_at((1, 1, -2.5), (1, 1, 0), principal_point=(0.6, 0.45))
    block = scene.instances["tall block"]
    with sv.Batch(device, scene, (24, 20), 3, outputs=sv.Batch.OUTPUTS) as batch:
        assert check_motion(batch.render(first), first, first) == 0
        assert check_motion(batch.render(second), first, second) > 0.01
        mixed = [first[0], second[1], first[2]]
        cut = batch.render(mixed, reset=np.array([True, False, False]))
        check_motion(cut, [first[0], second[1], second[2]], mixed)
        assert not cut["motion_vectors"][0].any()
        move = sv.Camera.look_at((0.1, 0, 0.05), (0.05, 0.05, -1)).transform
        block.transform = move @ block.transform
        rows = batch.binder.instance_capacity
        for index in range(rows):  # more than the table of instances has
            scene.add(sv.Instance(block.mesh, block.material, transform=(9 + index, 0, 0)))
        assert check_motion(batch.render(mixed), mixed, mixed, (block, move)) > 0.01
        assert batch.binder.instance_capacity > rows
        check_first_hits(device, batch, mixed)
        assert check_motion(batch.render(mixed), mixed, mixed) == 0
        assert check_motion(batch.render(first, reset=True), first, first) == 0


def test_a_rebuild_that_failed_is_done_again(device, monkeypatch):
    scene, camera = sv.builtin("cornell_box"), sv.Camera.look_at((1, 1, -2.5), (1, 1, 0))
    block = scene.instances["tall block"]
    with sv.Batch(device, scene, SIZE, 1, outputs=["motion_vectors"]) as batch:
        batch.render([camera])
        for index in range(batch.binder.instance_capacity):
            scene.add(sv.Instance(block.mesh, block.material, transform=(9 + index, 0, 0)))
        with monkeypatch.context() as patched:
            patched.setattr(batch._labels, "rebuild", Mock(side_effect=MemoryError))
            with pytest.raises(MemoryError):
                batch.render([camera])
        batch.render([camera])
        rows = batch._labels.binding("previous_instances").element.itemsize * batch.binder.instance_capacity
        assert batch._labels.resource("previous_instances").size >= rows


@pytest.mark.parametrize("proxy", [False, True])
def test_motion_is_that_of_edited_meshes(device, many_dispatches, proxy):
    scene, camera = sv.builtin("cornell_box"), sv.Camera.look_at((1, 1, -2.5), (1, 1, 0))
    with sv.Batch(device, scene, (24, 20), 2, outputs=sv.Batch.OUTPUTS) as batch:
        block = scene.instances["tall block"]
        if proxy:
            block.ray_mesh = sv.Mesh(block.mesh.positions, block.mesh.triangles)
        mesh = block.ray_mesh or block.mesh
        batch.render([camera, camera])
        shift, place = np.eye(4), block.transform
        shift[:3, 3] = 0.1, -0.05, 0.02
        mesh.positions = mesh.positions + shift[:3, 3]
        batch.render([camera, camera])
        move = place @ shift @ np.linalg.inv(place)
        assert check_motion(batch, [camera] * 2, [camera] * 2, (block, move)) > 0.01


# ---- arrays in --------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["fov", "K"])
def test_arrays_give_the_numbers_of_cameras(kind):
    rng, size = np.random.default_rng(2), (64, 48)
    count = 2000
    cameras = box_cameras(count)
    poses = poses_of(cameras) @ np.diag([2.0, 0.5, 3.0, 1.0])  # axes of any length
    K = np.zeros((count, 3, 3))
    K[:, 0, 0], K[:, 1, 1], K[:, 2, 2] = *rng.uniform(20, 200, (2, count)), 1.0
    K[:, :2, 2] = rng.uniform(-10, 70, (count, 2))
    fov = rng.uniform(1, 170, count)
    for index, camera in enumerate(cameras):
        if kind == "K":
            other = sv.Camera.from_opencv(K[index], np.eye(3), np.zeros(3), size)
            camera.update(
                vertical_fov=other.vertical_fov, pixel_aspect=other.pixel_aspect, principal_point=other.principal_point
            )
        else:
            camera.update(fov=float(fov[index]))
        camera.update(transform=poses[index])
    element = reflect(compile_shader(SHADER), SHADER).bindings["views"].element["current"]
    origins = rng.choice([0.0, 1e6], (count, 3))
    reader = view_cameras.CameraReader(element, count, size, origins)
    one_by_one, together = reader.read(cameras, {}, ""), reader.read(poses, {kind: K if kind == "K" else fov}, "")
    assert one_by_one.lenses == []
    np.testing.assert_array_equal(together.matrices, one_by_one.matrices)
    for name in element.names[2:]:
        np.testing.assert_array_equal(together.records[name], one_by_one.records[name], err_msg=name)
    same = reader.read(poses, {kind: np.array(K if kind == "K" else fov)}, "")  # equal lenses aren't made again
    assert same.records is together.records
    other = reader.read(poses, {kind: K[::-1] if kind == "K" else fov[::-1], "near": 0.5}, "")
    assert other.records["near"][0] == 0.5 != same.records["near"][0]


class Tensor:
    """What has __dlpack__ alone."""

    def __init__(self, array):
        self.array = array

    def __dlpack__(self, **options):
        return self.array.__dlpack__(**options)

    def __dlpack_device__(self):
        return self.array.__dlpack_device__()


def test_any_array_will_do(three):
    poses = poses_of(box_cameras(3))
    depth = three.render(poses)["depth"]
    K = sv.Camera().intrinsics(SIZE)
    for cameras, options in (
        (Tensor(poses), {"vertical_fov": np.float32(math.pi / 4)}),
        (poses.tolist(), {"fov": 45}),
        (poses, {"K": K}),
        (poses, {"K": np.tile(K, (3, 1, 1)), "near": [0.01] * 3}),
    ):
        np.testing.assert_allclose(three.render(cameras, **options)["depth"], depth, rtol=1e-5)
    assert not np.array_equal(three.render(poses, near=1.5)["depth"], depth)


# ---- arrays out -------------------------------------------------------------------------------------


def test_tensors_are_the_memory_itself(three, monkeypatch):
    cameras = box_cameras(3)
    three.render(cameras)
    tensors = {name: three.tensor(name) for name in three}
    for name, tensor in tensors.items():
        if not name.startswith("motion"):
            np.testing.assert_array_equal(tensor, three[name])
        other = np.from_dlpack(tensor)
        assert other.ctypes.data == tensor.ctypes.data == three.tensor(name).ctypes.data
        assert three[name].ctypes.data != tensor.ctypes.data
    three.render(cameras[::-1])
    np.testing.assert_array_equal(three.tensor("depth"), tensors["depth"])
    np.testing.assert_array_equal(three["depth"], tensors["depth"])
    monkeypatch.setattr(three._labels.resource("aov_depth"), "mapped", False)
    assert three.tensor("depth").ctypes.data != tensors["depth"].ctypes.data


def test_a_tensor_keeps_its_memory(device, scene):
    """Closing the batch frees it when nothing made of its tensors is left."""
    device.wait_idle()
    before = device.objects_in_use
    with sv.Batch(device, scene, SIZE, 3) as batch:
        depth = batch.render(box_cameras(3))["depth"]
        shared = np.from_dlpack(batch.tensor("depth"))[1:]
    device.wait_idle()
    assert device.objects_in_use > before
    np.testing.assert_array_equal(shared, depth[1:])
    held = [shared]
    del shared
    dropper = threading.Thread(target=held.clear)
    dropper.start()
    dropper.join()
    assert device.objects_in_use > before, "other threads leave the device alone"
    device.wait_idle()
    assert device.objects_in_use == before


def test_pictures_without_labels(device, scene):
    """The radiance is the same without the frame of first hits."""
    cameras, pictures = box_cameras(2), []
    for outputs in ((), ("depth",)):
        with sv.Batch(device, scene, SIZE, 2, renderer="reference", outputs=outputs) as batch:
            pictures.append(batch.render(cameras, samples=1)["radiance"])
            assert list(batch) == ["radiance", *outputs]
    np.testing.assert_array_equal(*pictures)


def test_a_tensor_outlives_its_device(scene):
    with sv.Device() as device, sv.Batch(device, scene, SIZE, 3) as batch:
        depth = batch.render(box_cameras(3))["depth"]
        tensors = [batch.tensor("depth") for _ in range(2)]
    del tensors[0]
    assert device.closed
    np.testing.assert_array_equal(tensors[0], depth)
    device.close()
    batch.close()
    assert device.live_objects > 0
    tensors.clear()
    assert device.live_objects == 0


# ---- wrong input ------------------------------------------------------------------------------------

POSES = np.tile(np.eye(4), (3, 1, 1))


def changed(index, value):
    poses = POSES.copy()
    poses[index] = value
    return poses


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"cameras": POSES[:2]}, r"cameras must have the shape \(3, 4, 4\), not \(2, 4, 4\)"),
        ({"cameras": "three"}, "cameras must be real numbers"),
        ({"cameras": None}, "cameras must be real numbers"),
        ({"cameras": changed((1, 0, 3), np.nan)}, r"cameras must be finite, but element \(1, 0, 3\) is nan"),
        ({"cameras": changed((1, 3, 0), 1)}, "the pose of view 1 must be affine"),
        ({"cameras": changed((slice(1, 3), 0, 0), 0)}, "the pose of view 1 must be invertible.*as of 1 more views"),
        ({"cameras": changed((2, 0, 3), 1e13)}, "the pose of view 2 must lie within"),
        ({"cameras": [sv.Camera()] * 2}, "give 3 cameras, one for each view; there are 2"),
        ({"cameras": [sv.Camera(), sv.Camera(), 3]}, "one is 3"),
        ({"cameras": [sv.Camera()] * 3, "fov": 3}, "have their own fov"),
        ({"fov": 30, "K": np.eye(3)}, "give one of fov, K"),
        ({"fov": [30, 200, 30]}, "field of view of view 1 must lie between"),
        ({"fov": [30, 30]}, r"fov must have the shape \(3,\) or \(\)"),
        ({"K": np.ones((3, 3))}, "K of view 0 must be .* no skew"),
        ({"K": np.diag((1e9, 1.0, 1.0))}, "K of view 0 must have a principal point"),
        ({"near": 0}, "near of view 0 must lie between"),
        ({"reset": [True]}, r"reset is True, False or an array \(3,\)"),
        ({"reset": 1}, "reset is True"),
        ({"samples": 4}, "labels have no samples"),
        ({"seeds": [1, 2, 3]}, "labels have no seeds"),
        ({"exposure": 4}, "has no option 'exposure'"),
    ],
)
def test_wrong_input_is_named(three, arguments, said):
    three.render(POSES)
    before = three["depth"]
    with pytest.raises(sv.SolariError, match=said):
        three.render(**{"cameras": POSES[:, [1, 0, 2, 3]], **arguments})
    np.testing.assert_array_equal(three["depth"], before)


def test_what_the_device_refuses_meanwhile_is_said_by_the_next_call(three, monkeypatch):
    """A frame whose arguments were checked is rendered whole."""
    port, read = three.binder.tensors, three._read
    number = port.refusal("a target", lambda index: f"number {index} is wrong")["what"]

    def read_late(*arguments):
        port._refusals.view(np.uint32)[number] = number << 20 | 5
        return read(*arguments)

    monkeypatch.setattr(three, "_read", read_late)
    three.render(POSES)
    monkeypatch.undo()
    with pytest.raises(sv.SolariError, match="number 5 is wrong"):
        three.render(POSES)
    for cameras in (sv.Camera(auto_exposure=True), [sv.Camera(auto_exposure=True)]):
        with pytest.raises(sv.SolariError, match="set auto_exposure to False"):
            check_realtime(cameras, "Batch.render")


def test_wrong_options_are_named(device, binder, three):
    limit = device.properties.limits.maxStorageBufferRange
    most, records = limit // 12 // (64 * 64), limit // three._views_binding.element.itemsize
    for options, said in (
        ({"renderer": "real"}, "renderer is one of labels, reference, realtime"),
        ({"renderer": ["labels"]}, r"renderer is one of labels, reference, realtime, not \['labels'\]"),
        ({"outputs": [["depth"]]}, r"no output \['depth'\]"),
        ({"seed": 4}, "renderer='labels' has no option 'seed'"),
        ({"renderer": "reference", "sead": 4}, "did you mean 'seed'"),
        ({"renderer": "reference", "seed": -1}, "seed must lie between"),
        ({"outputs": ["depht"]}, "did you mean 'depth'"),
        ({"outputs": 5}, "outputs is a list of names, not 5"),
        ({"views": 0}, "views is 0"),
        ({"views": most + 1}, f"at most {most:,} views of this size"),
        ({"views": records + 1, "size": (2, 2)}, f"at most {records:,} views of this size"),
        ({"outputs": []}, "outputs names nothing"),
        ({"outputs": [["depth"]]}, "there is no output"),
        ({"size": (64, 0)}, "hold none of this size"),
        ({"size": 64}, "two whole numbers"),
    ):
        with pytest.raises(sv.SolariError, match=said):
            sv.Batch(device, binder, **{"size": (64, 64), "views": 3, **options})
    with pytest.raises(sv.SolariError, match="no result 'radiance'"):
        three["radiance"]
    with sv.Batch(device, binder, SIZE, 2) as batch:
        assert "2 views 13x7" in repr(batch)
        with pytest.raises(sv.SolariError, match="render before asking"):
            batch["depth"]
    for use in (lambda: batch.render(POSES[:2]), lambda: batch["depth"], lambda: batch.tensor("depth")):
        with pytest.raises(sv.SolariError, match="closed"):
            use()
    batch.close()


@pytest.mark.slow
def test_bench(lent_device, tmp_path, monkeypatch):
    monkeypatch.setattr("solari_vk.lab.measure.batch.STEADY_SECONDS", 0.0)
    page = tmp_path / "page.md"
    words = ["--views", "2", "--size", "8x8", "--worlds", "--tensors", "--markdown", str(page)]
    assert main(["bench", "batch", *words]) == 0
    rows = [line.split("|")[1].strip() for line in page.read_text().splitlines() if ", 2 |" in line]
    assert rows == [
        "labels, 2",
        "labels, worlds, 2",
        "reference, 2",
        "reference, worlds, 2",
        "realtime, moving, 2",
        "realtime, cut, 2",
        "realtime, worlds, 2",
    ]
    one_view = [line.split("|")[-3].strip() for line in page.read_text().splitlines() if ", 2 |" in line]
    assert all(cell == "-" if "worlds" in row else float(cell) > 0 for row, cell in zip(rows, one_view, strict=True))
    spreads = [float(line.split("|")[-2]) for line in page.read_text().splitlines() if ", 2 |" in line]
    assert min(spreads) >= 1
    assert main(["bench", "batch", "--renderers", "labels,none"]) == 2


def test_a_bench_that_fails_frees_everything(device, monkeypatch):
    monkeypatch.setattr(measure_dataset, "warm", lambda *_: 1 / 0)
    held = []
    for _ in range(2):  # the first one leaves the device's memory for uploads
        with pytest.raises(ZeroDivisionError):
            measure_dataset.measured(device, sv.builtin("cornell_box"), 1, (16, 8))
        device.wait_idle()
        held.append(device.memory.bytes_used)
    assert held[0] == held[1]


@pytest.mark.slow
def test_bench_of_outputs(lent_device, tmp_path, monkeypatch):
    monkeypatch.setattr("solari_vk.lab.measure.dataset.SCENES", ("cornell_box",))
    page = tmp_path / "page.md"
    assert main(["bench", "dataset", "--views", "2", "--size", "16x8", "--markdown", str(page)]) == 0
    rows = [line.strip("| ").split(" | ") for line in page.read_text().splitlines() if line.startswith("| ")][2:]
    assert {row[0] for row in rows} > {"depth, instance_id", "all first hits", "silhouettes", "optical flow"}
    lit = {row[0]: row for row in rows if row[0].startswith("lit")}
    assert [row[2] for row in rows if row[0].startswith("lit: path tracer")] == ["1"]
    assert len(lit) == 2
    assert all(float(cell.replace(",", "")) > 0 for row in rows for cell in row[1:])
