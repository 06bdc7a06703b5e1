"""What goes wrong on a cluster ends in one clear line, and what was finished before stays."""

from __future__ import annotations

import errno
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
import warnings
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.cli import main
from solari_vk.gpu.device.physical import DeviceReport
from solari_vk.renderers.cluster import worker_pool
from solari_vk.renderers.cluster.device_session import OneDevice, pack
from solari_vk.renderers.cluster.identity import Identity, code_hash, device_of_worker
from solari_vk.renderers.cluster.reference import render_reference
from solari_vk.renderers.cluster.worker_pool import WorkerPool

SIZE = 24, 16


@contextmanager
def process(*command, **environment):
    """A process whose lines are read through a pipe."""
    started = subprocess.Popen(
        [sys.executable, "-P", "-m", *command], env=os.environ | environment, stderr=subprocess.PIPE, text=True
    )
    try:
        yield started
    finally:
        started.kill()
        started.communicate()


@contextmanager
def scheduler(**environment):
    """A scheduler of dask in a process of its own, with its address."""
    options = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    with process("distributed.cli.dask_scheduler", *options, **environment) as started:
        for line in started.stderr:
            found = re.search(r"Scheduler at:\s+(tcp://[\d.:]+)", line)
            if found:
                yield started, found[1]
                return
        raise AssertionError("the scheduler didn't start")


def worker(address, **environment):
    """A worker without a process that would start it again."""
    options = ["--no-nanny", "--nthreads", "1", "--no-dashboard"]
    return process("distributed.cli.dask_worker", address, *options, **environment)


def test_workers_that_would_render_other_bits_are_refused(any_device, tmp_path):
    """One has other code, one traces rays in another way, one lacks the package; the last renders alone. Then the
    scheduler goes away."""
    copy = tmp_path / "other"
    package = sv.__path__[0]
    shutil.copytree(package, copy / "solari_vk")
    shutil.copytree(Path(package).parent / "glsl", copy / "glsl")
    (copy / "solari_vk" / "color.py").open("a").write("# changed\n")
    (tmp_path / "solari_vk.py").write_text("raise ImportError")
    said = []
    with ExitStack() as stack:
        started, address = stack.enter_context(scheduler())
        rays = ({"SOLARI_VK_RAYS": "query"}, {"SOLARI_VK_RAYS": "pipeline"})
        for changes in (*rays, {"PYTHONPATH": str(copy)}, {"PYTHONPATH": str(tmp_path)}):
            stack.enter_context(worker(address, **changes))
        pool = stack.enter_context(WorkerPool(address=address, say=said.append))
        deadline = time.monotonic() + 60
        ended = "ended before it said what it is"
        while (len(pool.refused) < 2 or ended not in "".join(said)) and time.monotonic() < deadline:
            render_reference(pool, sv.builtin("cornell_box"), (8, 8), samples=1)
        assert pool.worker_count == 1
        reasons = sorted(pool.refused.values())
        assert "other code of solari_vk" in reasons[0]
        assert code_hash() in reasons[0]
        assert "rays by" in reasons[1]
        assert [line[:22] for line in said if line.startswith("worker tcp://127.0.0.1")]
        assert ended in "".join(said)

        # While a scheduler is stopped, and so can't answer, the caller is asked whether to go on.
        started.send_signal(signal.SIGSTOP)
        goes_on = threading.Timer(20, started.send_signal, [signal.SIGCONT])
        goes_on.start()
        with closing(pool.map(sv.builtin("cornell_box"), [Losing(0, str(tmp_path))])) as answers:
            assert [next(answers) for _ in range(3)] == [None] * 3
        assert goes_on.is_alive()
        started.send_signal(signal.SIGCONT)
        goes_on.cancel()

        def kill(samples, error):
            started.kill()

        with pytest.raises(sv.SolariError, match="the scheduler is gone"):
            render_reference(pool, sv.builtin("cornell_box"), SIZE, samples=10_000, progress=kill)


def test_a_scheduler_without_the_package(tmp_path):
    (tmp_path / "solari_vk.py").write_text("raise ImportError")
    with (
        scheduler(PYTHONPATH=str(tmp_path)) as (_, address),
        pytest.raises(sv.SolariError, match=f"the scheduler at {address} can't load solari_vk"),
        WorkerPool(address=address),
    ):
        pass


def test_a_scheduler_that_does_not_answer(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("solari_vk.renderers.cluster.worker_pool.CONNECT_SECONDS", 1.0)
    command = ["render", "builtin:cornell_box", "-o", str(tmp_path / "x.png")]
    for options, words in (
        ("--cluster tcp://127.0.0.1:9", "no scheduler of dask answers at tcp://127.0.0.1:9"),
        *(
            (f"--cluster={address}", f"{address!r} isn't the address of a scheduler")
            for address in (
                "host",
                "",
                "foo://host:1",
                "tcp://host:x",
                "tcp://:8786",
                "tcp://host:0",
                "inproc://a/b/c",
                "ucx://host:1",
                "tls://host:1",
            )
        ),
        ("--workers 2 --cluster tcp://127.0.0.1:9", "one of the two"),
        ("--shared-folder", "--shared-folder is for"),
        ("--workers 99999999999", "this machine has cores for at most"),
        ("--mode realtime --workers 2", "a still picture in realtime mode"),
    ):
        assert main([*command, *options.split(), *([] if "realtime" in options else ["--no-denoise"])]) == 2
        assert words in capsys.readouterr().err


@pytest.mark.slow
def test_a_job_that_kills_its_workers_is_named(pool):
    """Dask gives up after four workers, and the pool says which job it was."""
    scene = sv.builtin("cornell_box")
    with pytest.raises(sv.SolariError, match="the deadly job ended every worker"):
        for _ in pool.map(scene, [Deadly()]):
            pass
    with OneDevice() as one:
        alone = render_reference(one, scene, SIZE, samples=2)
    assert np.array_equal(alone.radiance, render_reference(pool, scene, SIZE, samples=2).radiance)


class Deadly:
    name = "the deadly job"
    clip = None

    def perform(self, session):
        os._exit(1)


def test_a_job_is_given_to_three_generations_of_workers():
    pool = object.__new__(WorkerPool)
    pool._workers = SimpleNamespace(accepted=set())
    task = worker_pool._Task(Deadly())
    for _ in range(worker_pool.TRIES - 1):
        assert pool._recall_stranded({Mock(): task}) == [task]
    with pytest.raises(sv.SolariError, match="the deadly job ended every worker that had it, 3 times in a row"):
        pool._recall_stranded({Mock(): task})


def test_validation_hides_no_error_of_a_device(monkeypatch):
    """The pool tries a job again only if it sees a DeviceError."""
    from solari_vk.renderers.cluster import worker as module

    said = Mock(side_effect=sv.ValidationError("a message"))
    session = SimpleNamespace(device=SimpleNamespace(check_messages=said), load_scene=Mock(), identity=Mock())
    session.identity.difference.return_value = ""
    monkeypatch.setattr(module, "_session", lambda options: session)
    monkeypatch.setattr(module, "_close_session", said)
    for error, expected in ((sv.DeviceError("lost"), sv.DeviceError), (None, sv.ValidationError)):
        job = SimpleNamespace(clip=None, perform=Mock(side_effect=error))
        with pytest.raises(expected):
            module.perform(None, None, "key", b"", job)


def test_large_scenes_are_sent_without_a_warning(pool, tmp_path, monkeypatch):
    """Dask warns of large tasks. What follows a pickle is ignored."""
    key, data = pack(sv.builtin("cornell_box"))
    monkeypatch.setattr("solari_vk.renderers.cluster.worker_pool.pack", lambda scene: (key, data + bytes(20_000_000)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert list(filter(None, pool.map(sv.builtin("cornell_box"), [Losing(0, str(tmp_path))])))


def test_a_lost_device_is_opened_again(pool, tmp_path, capsys):
    """A job is tried three times."""
    scene = sv.builtin("cornell_box")
    ((_, names),) = filter(None, pool.map(scene, [Losing(2, str(tmp_path))]))
    assert len(names) == 2
    assert capsys.readouterr().err.count("the losing job is tried again: the device is lost") == 2
    with pytest.raises(sv.DeviceError, match="the losing job: the device is lost"):
        list(pool.map(scene, [Losing(3, str(tmp_path / "more"))]))


def test_a_disk_that_fails_is_named_with_its_worker(pool):
    """As that for temporary files, which only the worker's machine has."""
    with pytest.raises(sv.SolariError, match=r"the writing job: worker tcp://127.*: .*No space left on device"):
        list(pool.map(sv.builtin("cornell_box"), [Writing()]))


class Writing:
    name = "the writing job"
    clip = None

    def perform(self, session):
        raise OSError(errno.ENOSPC, "No space left on device")


def test_a_worker_that_dies_while_it_sends_its_result(any_device, tmp_path):
    """The one that takes its place does the job again."""
    with WorkerPool(workers=1) as one:
        results = filter(None, one.map(sv.builtin("cornell_box"), [Sending(str(tmp_path / "died"))]))
        assert [text for _, text in results] == ["sent"]
    assert (tmp_path / "died").exists()


@dataclass
class Sending:
    """Its result, itself, ends the worker when it is pickled for the first time there."""

    path: str
    name: str = "the sending job"
    clip: None = None

    def perform(self, session):
        return Result(self.path)


class Result(str):
    def __reduce__(self):
        if not Path(self).exists():
            Path(self).touch()
            os._exit(1)
        return str, ("sent",)


@dataclass
class Losing:
    """Loses its device some times, which it counts by files in a folder."""

    times: int
    folder: str
    name: str = "the losing job"
    clip: None = None

    def perform(self, session):
        folder = Path(self.folder)
        folder.mkdir(exist_ok=True)
        names = sorted(path.name for path in folder.iterdir())
        if len(names) < self.times:
            (folder / str(len(names))).touch()
            raise sv.DeviceError("the device is lost")
        assert session.device.name
        return names


def test_identities_differ_in_words():
    mine = Identity("1", "a", "GPU", "driver", "query")
    assert not mine.difference(mine)
    for field, other, words in (
        ("version", "2", "version 1 of solari_vk, but version 2"),
        ("code", "b", "other code"),
        ("device", "CPU", "the device GPU, but the device CPU"),
        ("driver", "x", "the driver driver"),
        ("rays", "pipeline", "rays by query"),
    ):
        assert words in mine.difference(replace(mine, **{field: other}))


def test_workers_of_dask_cuda_get_their_own_devices(monkeypatch):
    """CUDA_VISIBLE_DEVICES holds numbers or UUIDs; its first entry counts, and SOLARI_VK_DEVICE wins."""

    def report(number, kind="discrete gpu"):
        return DeviceReport(number, "GPU", kind, f"{number}{number}-aa", "driver", (1, 3, 0), [], {})

    reports = [report(0), report(1), report(2, "cpu")]
    monkeypatch.delenv("SOLARI_VK_DEVICE", raising=False)
    uuids = {"": None, "0": "00-aa", "1,0": "11-aa", "2": None, "GPU-11-AA,GPU-00-aa": "11-aa", "GPU-x": None}
    for visible, uuid in uuids.items():
        monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
        assert device_of_worker(reports) == uuid
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "1")
    monkeypatch.setenv("SOLARI_VK_DEVICE", "0")
    assert device_of_worker(reports) is None


@pytest.mark.slow
def test_ctrl_c_in_a_terminal_keeps_what_is_done(any_device, tmp_path):
    """A terminal sends it to all processes; the workers leave it to the command, which writes its picture."""
    path = tmp_path / "picture.npy"
    options = ["--size", "16x16", "--samples", "1000000", "--no-denoise", "--workers", "2", "-o"]
    command = [sys.executable, "-m", "solari_vk", "render", "builtin:cornell_box", *options, str(path)]
    started = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    try:
        said = ""
        while " of 1000000 samples a pixel" not in said:
            line = started.stderr.readline()
            said += line
            assert line, said
        os.killpg(started.pid, signal.SIGINT)
        said += started.communicate(timeout=60)[1]
    finally:
        started.kill()
    assert started.returncode == 0, said
    assert "interrupted: keeping" in said
    assert "Traceback" not in said
    assert "isn't used" not in said
    assert np.isfinite(np.load(path)).all()
