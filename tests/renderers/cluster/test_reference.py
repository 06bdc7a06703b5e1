"""A reference picture from several workers has the same bits as from one, and the statistics of its samples."""

from __future__ import annotations

import os
import re
import signal

import numpy as np
import psutil
import pytest

import solari_vk as sv
from solari_vk.cli import main
from solari_vk.data.datasets.tasks import RenderTask, Style, View
from solari_vk.renderers.cluster.device_session import OneDevice
from solari_vk.renderers.cluster.reference import ChunkResult, ReferencePicture, chunk_samples, render_reference
from solari_vk.renderers.cluster.worker_pool import WorkerPool

SIZE = 24, 16
LAYERS = ("depth", "variance", "raw_radiance")


@pytest.fixture(scope="module")
def scene():
    return sv.builtin("cornell_box")


@pytest.fixture(scope="module")
def render(any_device, scene):
    """Renders 40 samples in 20 chunks with a pool of workers."""
    return lambda pool, **more: render_reference(pool, scene, SIZE, samples=40, seed=7, layers=LAYERS, **more)


@pytest.fixture(scope="module")
def picture(render):
    """The picture by one device in this process."""
    with OneDevice() as one:
        return render(one)


def same(a, b):
    equal = [np.array_equal(a.radiance, b.radiance), *(np.array_equal(a.layers[n], b.layers[n]) for n in LAYERS)]
    return a.samples == b.samples and a.rays == b.rays and all(equal)


def test_the_chunks_are_samples_of_the_path_tracer(picture, device, scene):
    """Each chunk has the next samples of the seed's sequences."""
    means, deviations = [], []
    with sv.PathTracer(device, scene, SIZE, seed=7) as tracer:
        for index in range(20):
            tracer.first_sample = index * chunk_samples(40)
            frame = tracer.render(samples=chunk_samples(40))
            means.append(frame["radiance"].astype(np.float64))
            deviations.append(tracer.read("luminance_deviations").reshape(SIZE[::-1]).astype(np.float64))
        depth = frame["depth"]
    assert np.array_equal(picture.layers["raw_radiance"], picture.radiance)
    np.testing.assert_allclose(picture.radiance, np.mean(means, axis=0), rtol=1e-6)
    assert np.array_equal(picture.layers["depth"], depth)
    light = np.array(means) @ np.float64([0.2126, 0.7152, 0.0722])
    squares = np.sum(deviations, axis=0) + 2 * light.var(axis=0) * len(light)
    np.testing.assert_allclose(picture.layers["variance"], squares / (40 * 39), rtol=1e-3)


def test_two_workers_give_the_same_bits(pool, render, picture):
    seen = []
    assert same(picture, render(pool, progress=lambda done, error: seen.append(done)))
    assert seen[-1] == 40
    assert pool.worker_count == 2
    assert not pool.refused


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 4])
def test_other_numbers_of_workers_give_the_same_bits(render, picture, workers):
    with WorkerPool(workers=workers) as pool:
        assert same(picture, render(pool))
        assert pool.worker_count == workers


def test_a_clip_leaves_no_pose_behind(any_device, scene, tmp_path):
    """A picture of the scene as it was given has the same bits after pictures of poses."""
    posed = sv.builtin("cornell_box")
    box, place = posed.instances[0], np.eye(4)
    rig = sv.Rig([-1], place[None], [(0, 0, 0)], [(0, 0, 0, 1)], [(1, 1, 1)])
    rig.attach(box, 0, box.transform)
    posed.animations.add(sv.Animation(rig, [sv.Channel(0, "translation", [0, 1], [(0, 0, 0), (0.3, 0.2, 0.1)])]))
    view = View("posed.npy", posed.camera, 0.9)
    tasks = [RenderTask(Style(SIZE, clip=clip, samples=4), 0, (view,)) for clip in (0, None)]
    moved = []
    with OneDevice() as one:
        pictures = [render_reference(one, posed, SIZE, samples=4).radiance]
        for task in tasks:
            ((_, files),) = one.map(posed, [task])
            moved.append(files["posed.npy"].sha256)
            pictures.append(render_reference(one, posed, SIZE, samples=4).radiance)
    assert moved[0] != moved[1]
    assert all(np.array_equal(pictures[0], picture) for picture in pictures)


def test_no_port_is_open_to_the_network(pool):
    """Whoever reaches a port of dask can run code."""
    here = psutil.Process()
    found = [
        connection.laddr.ip
        for process in (here, *here.children(recursive=True))
        for connection in process.net_connections("inet")
        if connection.status == psutil.CONN_LISTEN
    ]
    assert len(found) >= 1 + 2 * pool.worker_count
    assert set(found) == {"127.0.0.1"}


def test_no_worker_is_profiled(pool):
    """Dask would look at each worker's stacks 100 times a second."""
    profiled = pool.client.run(lambda dask_worker: "profile" in dask_worker.periodic_callbacks)
    assert list(profiled.values()) == [False] * pool.worker_count


@pytest.mark.slow  # test_faults.py has other faults
def test_a_killed_worker_changes_no_bit(pool, render, picture):
    """It is killed in the middle; the scheduler gives its jobs to the other, and a new process takes its place."""
    victim = next(iter(pool.client.run(os.getpid).values()))
    killed = []

    def kill_one(done, error):
        if done >= 4 and not killed:
            killed.append(victim)
            os.kill(victim, signal.SIGKILL)

    assert same(picture, render(pool, progress=kill_one))
    assert killed
    assert victim not in pool.client.run(os.getpid, on_error="ignore").values()


def test_a_target_error_ends_after_the_same_chunks(pool, scene):
    with OneDevice() as one:
        alone, together = (
            render_reference(workers, scene, SIZE, samples=None, target_error=0.15) for workers in (one, pool)
        )
    assert alone.error == together.error <= 0.15
    assert alone.samples == together.samples
    assert np.array_equal(alone.radiance, together.radiance)


def test_an_early_end_keeps_what_is_done(pool, scene):
    picture = render_reference(
        pool, scene, SIZE, samples=10_000, layers=LAYERS, progress=lambda done, error: done > 100
    )
    assert 100 < picture.samples < 10_000
    assert np.isfinite(picture.radiance).all()
    assert picture.layers["depth"].shape == SIZE[::-1]


def test_chunks_out_of_order_are_summed_in_order():
    random = np.random.default_rng(1)
    means = random.random((4, 3, 2, 3), np.float32)
    chunks = [ChunkResult(n + 1, mean, mean[..., 0], 1, {}, []) for n, mean in enumerate(means)]
    sums = []
    for order in ((0, 1, 2, 3), (3, 1, 0, 2)):
        picture = ReferencePicture()
        for number, index in enumerate(order):
            picture.receive(index, chunks[index])
            while picture.add_next():
                pass
            assert picture.samples == sum(n + 1 for n in range(4) if {*range(n + 1)} <= {*order[: number + 1]})
        sums.append((picture.raw_radiance, picture.variance))
    assert all(map(np.array_equal, *sums))
    expected = np.average(means.astype(np.float64), axis=0, weights=[1, 2, 3, 4])
    np.testing.assert_allclose(sums[0][0], expected, rtol=1e-6)


def test_wrong_options_are_refused(pool, scene):
    for options, words in (
        ({"samples": None}, "give a number of samples"),
        *(({"samples": None, "target_error": wrong}, "target_error") for wrong in (0, -1, np.nan, np.inf, "small")),
        ({"samples": 0}, "from 1 on"),
        ({"layers": ["nonsense"]}, "chunk 0.*nonsense"),
        ({"max_bounces": -1}, "max_bounces"),
    ):
        with pytest.raises(sv.SolariError, match=words):
            render_reference(pool, scene, SIZE, **options)
    for options in ({}, {"workers": 0}, {"workers": 1, "address": "tcp://127.0.0.1:1"}):
        with pytest.raises(sv.SolariError, match="WorkerPool"):
            WorkerPool(**options)


def test_the_command_renders_with_workers(pool, tmp_path, capsys):
    options = "--size 24x16 --samples 4 --seed 7 --no-denoise --aov depth,variance --cluster"
    command = ["render", "builtin:cornell_box", *options.split(), pool.client.scheduler.address]
    code = main([*command, "-o", str(tmp_path / "picture.exr")])
    said = capsys.readouterr().err
    assert code == 0, said
    assert re.search("with (1 worker|2 workers, each) with", said)  # those that have answered by then
    assert "4 samples a pixel" in said
