"""How well several workers share the work, and what a scheduler has to do for many more of them.

Workers of a pool are compared with as many processes that know nothing of each other and render the same number of
views at the same time: what is lost is what dask, sending results and waiting for the last view cost. Both are warm,
and take turns, so that other work on the machine slows both; the efficiency is the median of the rounds' ratios.

Other work still decides who waits longer. Processor time hardly depends on it: that of the processes apart, over that
of the workers, the scheduler and this process, is the efficiency that a quiet software device would have if waiting
cost nothing.

The scheduler is a real one of dask. Its many workers are real ones too, but all in this process, and their jobs wait.
"""

from __future__ import annotations

import asyncio
import logging
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import solari_vk as sv
from solari_vk.lab.measure.report import Report
from solari_vk.output.animation import orbit
from solari_vk.renderers.cluster.device_session import DeviceOptions, Results
from solari_vk.renderers.cluster.local import software_threads
from solari_vk.scene.builtin import builtin
from solari_vk.scene.model import Scene

SCENE = "cornell_box"
ROUNDS = 11
Floats = NDArray[np.float64]
SIMULATED_WORKERS = (50, 100)
SIMULATED_SECONDS = 4.0  # of a job
SIMULATED_JOBS = 5  # of a worker
INTRO = (
    "What `solari-vk bench cluster` measured. Views are rendered by N workers of a pool, and by N processes that know "
    "nothing of each other, in turns. Figures are medians of the rounds; the efficiency is that of their ratios, in "
    "time and in processor time, of which a pool spends that of its workers, its scheduler and the command.",
)


def run(
    device: str | None,
    workers: Sequence[int],
    views: int,
    size: tuple[int, int],
    samples: int,
    markdown: Path | None,
    simulate: bool = False,
    *,
    rays: str | None = None,
) -> None:
    """Measure and report. views: of each round. simulate: the load of the scheduler too."""
    options = DeviceOptions(device, rays)
    with options.open() as opened:
        report = Report(opened, markdown, "Several devices", INTRO)
    rows = list[tuple[str, ...]]()
    for count in workers:
        report.progress(f"{count} workers, {views} views of {size[0]}x{size[1]} with {samples} samples a pixel")
        apart, together = _measure(options, count, views, size, samples)
        (speed_apart, spent_apart), (speed, spent) = (np.median(found / views, axis=0) for found in (apart, together))
        # By the ratios of rounds, in which both sides met the same load.
        in_time, in_processor_time = np.median(apart / together, axis=0)
        rows.append(
            (
                str(count),
                f"{1 / speed_apart:.2f}",
                f"{1 / speed:.2f}",
                f"{in_time:.3f}",
                f"{spent_apart:.3f}",
                f"{spent:.3f}",
                f"{in_processor_time:.3f}",
            )
        )
    head = (
        "workers",
        "views/s of processes apart",
        "views/s of a pool",
        "efficiency",
        "processor s a view apart",
        "processor s a view of a pool",
        "efficiency in processor time",
    )
    report.table(f"{views} views of {SCENE}, {size[0]}x{size[1]}, {samples} samples a pixel", head, rows)
    if simulate:
        logging.getLogger("distributed").setLevel(logging.ERROR)
        rows = []
        for count in SIMULATED_WORKERS:
            report.progress(f"a scheduler with {count} simulated workers")
            cpu, delay = asyncio.run(_simulate(count))
            rows.append((str(count), f"{1e3 * cpu:.2f}", f"{1e3 * delay:.1f}", f"{1 / cpu:,.0f}"))
        facts = ("workers", "scheduler's processor ms a job", "delay of an answer, ms", "jobs/s at most")
        report.table(f"A scheduler whose workers' jobs take {SIMULATED_SECONDS:g} s", facts, rows)


def _tasks(scene: Scene, folder: str, views: int, size: tuple[int, int], samples: int) -> list[sv.cluster.RenderTask]:
    cameras = orbit(scene.camera, scene.bounds.center, views, 40.0)
    style = sv.cluster.Style(size, samples=samples)
    return [
        sv.cluster.RenderTask(style, number, (sv.cluster.View(f"{number}.npy", camera),), folder=folder)
        for number, camera in enumerate(cameras)
    ]


def _measure(
    options: DeviceOptions, count: int, views: int, size: tuple[int, int], samples: int
) -> tuple[Floats, Floats]:
    """Seconds and processor seconds of each round (ROUNDS, 2), by processes apart and by a pool."""
    spawn = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        scene = builtin(SCENE)
        tasks = _tasks(scene, folder, views, size, samples)
        pool = stack.enter_context(sv.cluster.WorkerPool(count, device=options.device, rays=options.rays))
        lines = []
        for number in range(count):
            line, other = spawn.Pipe()
            process = spawn.Process(target=_apart, args=(other, options, count, tasks[:1], tasks[number::count]))
            process.start()
            # Callbacks run in reverse order: a process is told to end before it is waited for.
            stack.callback(process.join)
            stack.callback(line.send, False)
            lines.append(line)
        # Both sides are warm before the first round.
        for line in lines:
            line.recv()  # it has compiled its shaders
        # Enough tasks that each worker gets one.
        _finish(pool.map(scene, tasks[: 4 * count]))
        apart, together = [], []
        for _ in range(ROUNDS):
            started = time.perf_counter()
            for line in lines:
                line.send(True)
            spent = sum(line.recv() for line in lines)
            apart.append((time.perf_counter() - started, spent))
            # The pool's own processes count too: what they spend is lost for rendering.
            before = _spent(pool)
            started = time.perf_counter()
            _finish(pool.map(scene, tasks))
            together.append((time.perf_counter() - started, _spent(pool) - before))
    return np.array(apart), np.array(together)


def _apart(
    line: Any,
    options: DeviceOptions,
    count: int,
    first: list[sv.cluster.RenderTask],
    share: list[sv.cluster.RenderTask],
) -> None:
    """One of `count` processes, which renders its share of the tasks whenever it is told to."""
    # These processes share the machine's cores as workers of a pool do.
    os.environ.update(software_threads(count))
    scene = builtin(SCENE)
    with sv.cluster.OneDevice(options.device, options.rays) as one:
        _finish(one.map(scene, first))
        line.send(None)
        while line.recv():
            before = time.process_time()
            _finish(one.map(scene, share))
            line.send(time.process_time() - before)


def _spent(pool: sv.cluster.WorkerPool) -> float:
    """Processor seconds of the workers and of this process, which has the scheduler."""
    return time.process_time() + float(sum(pool.client.run(time.process_time).values()))


def _finish(results: Results[sv.cluster.RenderTask]) -> None:
    with closing(results):
        for _ in results:
            pass


async def _simulate(count: int) -> tuple[float, float]:
    """Processor seconds of the scheduler a job, and the time that it took to answer, in seconds."""
    from distributed import Client, Worker

    with tempfile.TemporaryDirectory() as folder:
        file = os.path.join(folder, "scheduler.json")
        options = ("--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", file)
        scheduler = subprocess.Popen(
            [sys.executable, "-m", "distributed.cli.dask_scheduler", *options], stderr=subprocess.DEVNULL
        )
        try:
            # The scheduler writes the file when it can be reached.
            while not os.path.exists(file):
                await asyncio.sleep(0.1)
            async with Client(scheduler_file=file, asynchronous=True) as client:
                address = client.scheduler.address
                workers = [Worker(address, nthreads=1, memory_limit=0, dashboard=False) for _ in range(count)]
                await asyncio.gather(*workers)
                before = await client.run_on_scheduler(time.process_time)
                names = [worker.address for worker in workers]  # as a pool names those that may do a job
                jobs = client.map(_wait, range(count * SIMULATED_JOBS), workers=names, pure=False)
                delays = []
                while not all(job.done() for job in jobs):
                    asked = time.perf_counter()
                    await client.run_on_scheduler(time.process_time)
                    delays.append(time.perf_counter() - asked)
                    await asyncio.sleep(0.2)
                spent = await client.run_on_scheduler(time.process_time) - before
                await asyncio.gather(*(worker.close() for worker in workers))
        finally:
            scheduler.kill()
            scheduler.wait()
    return spent / len(jobs), float(np.median(delays))


async def _wait(number: int) -> None:
    """A job that takes as long as one of a device, and no processor time."""
    await asyncio.sleep(SIMULATED_SECONDS)
