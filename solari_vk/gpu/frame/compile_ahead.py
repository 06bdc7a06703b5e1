"""Has the cores of a software device compile a frame's pipelines at the same time.

Lavapipe compiles a pipeline when it first runs, in the one thread of the device's queue, and keeps the machine code on
disk. So further devices, each with a thread, run pipelines from the end of the list while the frame's own device runs
them from the start; what others have compiled it finds on disk.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.commands import Recorded
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.descriptors import DescriptorSets
from solari_vk.gpu.frame.interface import Interface
from solari_vk.gpu.frame.pipelines import Pipeline, Pipelines
from solari_vk.gpu.shaders.spirv import Module

MOST_DEVICES = 4  # each takes some hundred megabytes while it compiles
CPU_QUOTA = Path("/sys/fs/cgroup/cpu.max")  # "QUOTA PERIOD" in microseconds, or "max PERIOD"


def device_count() -> int:
    """How many devices compile: for each core that the driver may use, as LP_NUM_THREADS says to lavapipe too."""
    # Without Mesa's cache on disk, what one device compiles the other never finds.
    if os.environ.get("MESA_SHADER_CACHE_DISABLE", "0").lower() in ("1", "true", "yes", "y"):
        return 1
    # Lavapipe itself obeys this variable, so a user who limits its threads limits these too.
    limit = os.environ.get("LP_NUM_THREADS", "")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    cores = min(cores, _cores_of_group())
    return min(int(limit) if limit.isdigit() else cores, cores, MOST_DEVICES)


def _cores_of_group() -> int:
    """The quota of processor time of a container, in cores, at least 1; MOST_DEVICES without one. Of version 2 of
    Linux's control groups."""
    try:
        quota, period = CPU_QUOTA.read_text(encoding="ascii").split()
        return max(int(quota) // int(period), 1)
    except (OSError, ValueError):  # no such file, or "max"
        return MOST_DEVICES


@contextmanager
def compiling_ahead(
    interface: Interface, modules: Collection[Module], counts: Sequence[int], pipelines: Sequence[Pipeline]
) -> Iterator[Callable[[Pipeline], None]]:
    """A context with a function to call before each of these pipelines runs on the interface's device, in their order:
    it waits while another device compiles that one.

    modules: those of the interface. counts: the lengths of its bindless arrays.
    """
    device = interface.device
    waiting = [pipeline for pipeline in pipelines if pipeline.table is None]  # others compile with their tables
    compiled: dict[Pipeline, threading.Event] = {}
    lock = threading.Lock()

    def next_pipeline() -> Pipeline | None:
        with lock:
            if not waiting:
                return None
            found = waiting.pop()  # from the end: the frame's own device begins at the start
            compiled[found] = threading.Event()
            return found

    def work() -> None:
        made = None
        try:
            with Device(device.properties.uuid, validation=False, rays=device.rays, on_compile=None) as other:
                same = Interface(other, modules, interface.laid_out)
                sets = DescriptorSets(same, counts)
                users = Pipelines(other)
                made = next_pipeline()
                while made is not None:
                    _run_once(users, same, sets, made)
                    compiled[made].set()
                    made = next_pipeline()
        except Exception:  # the frame's own device compiles the rest, and raises what it meets
            pass
        finally:
            if made is not None:
                compiled[made].set()  # else the frame would wait for ever for what failed here

    def wait_for(pipeline: Pipeline) -> None:
        with lock:
            done = compiled.get(pipeline)
            if pipeline in waiting:
                waiting.remove(pipeline)
        if done is not None:
            done.wait()

    # Only where pipelines are compiled at their first run does running them elsewhere help.
    helps = device.buffers_by_address and len(pipelines) > 1
    threads = [threading.Thread(target=work) for _ in range(device_count() - 1 if helps else 0)]
    for thread in threads:
        thread.start()
    try:
        yield wait_for
    finally:
        with lock:
            waiting.clear()
        for thread in threads:
            thread.join()


def _run_once(users: Pipelines, interface: Interface, sets: DescriptorSets, pipeline: Pipeline) -> None:
    """Compile a compute pipeline, by a run without invocations: its descriptors needn't be written."""
    device = interface.device
    [(_, made)] = users.make([pipeline.info], interface)

    def record(commands: raw.CData) -> None:
        sets.bind(commands, made.bind_point)
        device.vk.vkCmdBindPipeline(commands, made.bind_point, made.handle)
        device.vk.vkCmdDispatch(commands, 0, 0, 0)

    empty = Recorded(device, record, pipeline.info.name)
    try:
        device.await_value(device.submit([empty.commands]))
    finally:
        empty.destroy()
