"""`Batch.render_many`: the frames of as many calls of `render`, in one submission."""

from __future__ import annotations

import gc

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.gpu.frame.slot import Slot
from solari_vk.renderers.back_sides import BackSides
from solari_vk.settings import Settings

SIZE = (13, 9)
VIEWS = 2
FRAMES = 5
OPTIONS = {
    "labels": {"outputs": ["depth", "primitive", "motion_vectors"]},
    "reference": {"outputs": ["instance_id"], "seed": 3},
    "realtime": {"outputs": ["depth"], "seed": 3, "settings": Settings(world_cache_cells=1 << 14)},
}


def poses_of(frames=FRAMES):
    return np.stack(
        [
            [
                sv.Camera.look_at((0.7 + 0.5 * view, 1 + 0.02 * frame, -2.5), (1, 0.8, 1)).transform
                for view in range(VIEWS)
            ]
            for frame in range(frames)
        ]
    )


@pytest.fixture
def submissions(device, monkeypatch):
    """The numbers of batches in each call of vkQueueSubmit2 since it was cleared."""
    counts, submit = [], device.vk.vkQueueSubmit2

    def counted(queue, count, infos, fence):
        counts.append(count)
        return submit(queue, count, infos, fence)

    monkeypatch.setattr(device.vk, "vkQueueSubmit2", counted)
    monkeypatch.setattr(BackSides, "is_due", lambda _: False)  # whose looks have submissions of their own
    return counts


@pytest.mark.parametrize("worlds", [1, 2])
@pytest.mark.parametrize("renderer", OPTIONS)
def test_frames_are_those_of_calls(device, submissions, renderer, worlds):
    """Twice, so that slots are used again; with cuts, and with boxes that move in worlds."""
    options = {"renderer": renderer, "worlds": worlds, **OPTIONS[renderer]}
    poses, cuts = poses_of(), np.zeros((FRAMES, VIEWS), bool)
    cuts[2, 1] = True
    place = sv.builtin("cornell_box").instances["short block"].transform
    moves = {"short block": np.tile(place, (FRAMES, worlds, 1, 1))} if worlds > 1 else {}
    for given in moves.values():
        given[:, :, 0, 3] += np.linspace(0, 0.3, FRAMES * worlds).reshape(FRAMES, worlds)
    seeds = {} if renderer == "labels" else {"seeds": np.arange(FRAMES * VIEWS).reshape(FRAMES, VIEWS)}
    with (
        sv.Batch(device, sv.builtin("cornell_box"), SIZE, VIEWS, **options) as one_by_one,
        sv.Batch(device, sv.builtin("cornell_box"), SIZE, VIEWS, **options) as together,
    ):
        for turn in range(2):
            expected = []
            for frame in range(FRAMES):
                for name, given in moves.items():
                    one_by_one.transforms[name] = given[frame]
                own = {name: given[frame] for name, given in seeds.items()}
                one_by_one.render(poses[frame], fov=50, reset=cuts[frame], **own)
                expected.append({name: one_by_one[name] for name in one_by_one})
            device.wait_idle()
            submissions.clear()
            many = together.render_many(poses, frames=FRAMES, fov=50, reset=cuts, transforms=moves, **seeds)
            if turn and renderer != "reference":  # which looks at the time of its dispatches
                assert len(submissions) == 1
                assert submissions[0] > FRAMES
            assert list(many) == list(one_by_one)
            for name in many:
                assert many[name].shape == (FRAMES, *together[name].shape)
                for frame in range(FRAMES):
                    said = f"{name}, frame {frame}, turn {turn}"
                    np.testing.assert_array_equal(many[name][frame], expected[frame][name], said)
                np.testing.assert_array_equal(together[name], expected[-1][name])
            name = next(name for name in many if name != "display")
            np.testing.assert_array_equal(np.from_dlpack(many.tensor(name)), many[name])


@pytest.mark.parametrize(("renderer", "outputs"), [("labels", ["depth"]), ("realtime", [])])
def test_a_frame_of_a_still_scene_is_one_submission(device, submissions, renderer, outputs):
    options = OPTIONS[renderer] | {"renderer": renderer, "outputs": outputs}
    with sv.Batch(device, sv.builtin("cornell_box"), SIZE, VIEWS, **options) as batch:
        for poses in poses_of():
            batch.render(poses, fov=50)
        submissions.clear()
        for _ in range(2):
            batch.render(poses_of(1)[0], fov=50)
        assert submissions == [1, 1]


def test_the_same_cameras_in_all_frames(device):
    """Poses, or cameras, of all frames; or cameras of each. Only the first frame is cut."""
    cameras = [sv.Camera(transform=pose, fov=50) for pose in poses_of(1)[0]]
    options = {"renderer": "realtime", "outputs": (), "settings": Settings(world_cache=False)}
    found = []
    for given, lens in ((poses_of(1)[0], {"fov": 50}), (cameras, {}), ([cameras] * 3, {})):
        with sv.Batch(device, sv.builtin("cornell_box"), SIZE, VIEWS, **options) as batch:
            batch.render(given[0] if isinstance(given[0], list) else given, **lens)
            many = batch.render_many(given, frames=3, outputs="radiance", reset=True, **lens)
            assert list(many) == ["radiance"]
            found.append(many["radiance"])
            batch.render(cameras, reset=True)
            batch.render(cameras)
            assert not np.array_equal(batch["radiance"], found[-1][0])
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[0], found[2])
    error = [np.abs(np.diff(found[0][:, view], axis=0)).mean(axis=(1, 2, 3)) for view in range(VIEWS)]
    assert (np.array(error) > 0).all()


def test_tensors_of_frames_outlive_the_batch(device):
    if device.properties.kind != "cpu":
        pytest.skip("needs a software device")
    with sv.Batch(device, sv.builtin("cornell_box"), SIZE, VIEWS, outputs=["depth"]) as batch:
        many = batch.render_many(poses_of(), frames=FRAMES)
        expected, tensor = many["depth"], many.tensor("depth")
        batch.render_many(poses_of(2), frames=2)  # into other memory
        device.wait_idle()
        others = [device.buffer(tensor.nbytes, "other") for _ in range(256)]
        assert not any(np.shares_memory(other.view(), tensor) for other in others)
        for other in others:
            other.destroy()
    np.testing.assert_array_equal(tensor, expected)
    live = device.objects_in_use
    del tensor
    gc.collect()
    device.poll()
    assert device.objects_in_use < live
    with pytest.raises(sv.SolariError, match="the batch was closed, or has rendered many frames again"):
        many["depth"]


def test_single_frames_take_two_slots(device, monkeypatch):
    recorded, record = set(), Slot.record

    def noted(slot, barriers):
        recorded.add(slot.index)
        record(slot, barriers)

    scene = sv.builtin("cornell_box")
    with sv.Batch(device, scene, SIZE, VIEWS, outputs=["depth"]) as batch:
        batch.render_many(poses_of(), frames=FRAMES)
        monkeypatch.setattr(Slot, "record", noted)
        for index in range(64):  # more than the table of instances has
            scene.add(sv.shapes.box(), sv.Material(), position=(9 + index, 0, 0))
        for _ in range(2 * FRAMES):
            batch.render(poses_of(1)[0])
    assert recorded == {0, 1}


def test_frames_are_over_when_others_are_rendered(device):
    """Also where the others have the same sizes, and so the same memory, which tensors go on to show."""
    with sv.Batch(device, sv.builtin("cornell_box"), SIZE, VIEWS, outputs=["depth"]) as batch:
        first = batch.render_many(poses_of(2), frames=2)
        memory, tensor = first.memory, first.tensor("depth")
        for frames in (2, 3):
            after = batch.render_many(poses_of(frames), frames=frames)
            assert (after.memory is memory) == (frames == 2)
            for name in ("depth", "depht"):
                with pytest.raises(sv.SolariError, match=r"has rendered many frames again|did you mean 'depth'"):
                    first[name]
            assert after["depth"].shape == (frames, VIEWS, *SIZE[::-1])
    assert tensor.min() > 0  # and its memory is still there


def test_what_is_wrong_in_a_later_frame_changes_nothing(device):
    scene = sv.builtin("cornell_box")
    moves = np.tile(scene.instances["short block"].transform, (3, 2, 1, 1))
    moves[:, :, 1, 3] += 5
    with sv.Batch(device, scene, SIZE, VIEWS, worlds=2, outputs=["depth"]) as batch:
        before = batch.render(poses_of(1)[0])["depth"]
        wrong_poses, wrong_moves = poses_of(3), moves.copy()
        wrong_poses[2, 0] = wrong_moves[2, 1] = 0
        for poses, given in ((wrong_poses, moves), (poses_of(3), wrong_moves)):
            with pytest.raises(sv.SolariError, match="must be affine"):
                batch.render_many(poses, frames=3, transforms={"short block": given})
            assert not batch.transforms
            np.testing.assert_array_equal(batch["depth"], before)


def test_frames_have_tensors_where_memory_is_not_mapped(device):
    if device.properties.kind != "cpu":
        pytest.skip("needs a software device")
    with (
        sv.Device(validation=True, staging=True) as device,
        sv.Batch(device, sv.builtin("cornell_box"), SIZE, VIEWS, outputs=["depth"]) as batch,
    ):
        many = batch.render_many(poses_of(2), frames=2)
        np.testing.assert_array_equal(many.tensor("depth"), many["depth"])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"frames": 0}, "frames is 0"),
        ({"frames": 4}, r"must have the shape \(2, 4, 4\) or \(4, 2, 4, 4\)"),
        ({"outputs": ["radience"]}, "no result 'radience'"),
        ({"reset": np.zeros((3, 2))}, r"\(2,\) or \(5, 2\)"),
        ({"outputs": 3}, "outputs is a list of names, not 3"),
        ({"seeds": np.zeros(3)}, "seeds must have the shape"),
        ({"transforms": {"short block": np.eye(4)}}, r"transforms of short block must have the shape \(5, 1, 4, 4\)"),
        ({"cameras": [[sv.Camera()] * 2] * 3}, "give 5 lists of cameras, one for each frame, not 3"),
        ({"cameras": np.zeros((5, 2, 4, 4))}, "the pose of view 0 must be affine"),
        ({"transforms": [1]}, r"transforms is a dictionary of arrays by instance, not \[1\]"),
        ({"fov": 200}, "field of view of view 0"),
        ({"K": np.zeros((3, 3))}, "K of view 0"),
        ({"fov": 30, "vertical_fov": 1}, "give one of"),
        ({"near": 0}, "near of view 0"),
        ({"samples": 4}, "realtime renderer takes no samples"),
        ({"seeds": [0.5, 1]}, "the seed of view 0"),
        ({"cameras": [sv.Camera(auto_exposure=True)] * 2}, "can't choose an exposure"),
        ({"reset_cache": np.array([True, False])}, "reset_cache is True or False, not"),
    ],
)
def test_wrong_frames_are_named(device, options, said):
    with sv.Batch(device, sv.builtin("cornell_box"), SIZE, VIEWS, renderer="realtime", outputs=()) as batch:
        with pytest.raises(sv.SolariError, match=f"^Batch.render_many.*{said}"):
            batch.render_many(**{"cameras": poses_of(), "frames": FRAMES, **options})
        batch.render(poses_of(1)[0])  # goes on
