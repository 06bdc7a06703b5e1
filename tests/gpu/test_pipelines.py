"""Pipelines: created in threads, and cached on disk by device and driver."""

from __future__ import annotations

import hashlib
import os
import signal
import threading
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from shader_folder import ShaderFolder
from support.frames import leaves_nothing

from solari_vk.base import disk_cache
from solari_vk.base.errors import DeviceError
from solari_vk.gpu.device import pipeline_cache, raw
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.shared_objects import SharedObjects
from solari_vk.gpu.frame import compile_ahead, pipelines
from solari_vk.gpu.frame.frame import Frame, Pass, RayPass, Stage
from solari_vk.gpu.frame.interface import shared_layout
from solari_vk.gpu.frame.slot import Slot
from solari_vk.gpu.shaders import shaderc

COUNT = 6
TEXT = """layout(local_size_x = 1) in;
layout(constant_id = 0) const uint FACTOR = 1;
layout(set = 1, binding = {0}, scalar) buffer Block{0} {{ uint at[]; }} out_{0};
void main() {{ out_{0}.at[0] = FACTOR * ({0}u + 1u); }}
"""


@pytest.fixture
def stage(shaders: ShaderFolder) -> Stage:
    """Passes that each write a buffer of their own. The last two share a shader with different constants."""
    for number in range(COUNT):
        shaders.write(f"write_{number}", TEXT.format(number))
    passes = [Pass(f"write_{number}", threads=1) for number in range(COUNT)]
    passes += [Pass(f"write_{COUNT - 1}", threads=1, constants={"FACTOR": 7})]
    return Stage("writes", buffers={f"out_{number}": 1 for number in range(COUNT)}, passes=passes)


def results(device: Device, stage: Stage, shaders: ShaderFolder) -> list[int]:
    with Frame(device, [stage], glsl_root=shaders.root) as frame:
        frame.submit()
        return [int(frame[f"out_{number}"][0]) for number in range(COUNT)]


EXPECTED = [*range(1, COUNT), 7 * COUNT]


def watch(device: Device, monkeypatch: pytest.MonkeyPatch, call: Callable[..., int]) -> None:
    """Replace the device's vkCreateComputePipelines by `call(the real function, its arguments...)`."""
    real = device.vk.vkCreateComputePipelines
    monkeypatch.setattr(device.vk, "vkCreateComputePipelines", lambda *arguments: call(real, *arguments))


def test_shaders_are_compiled_and_pipelines_created_at_the_same_time(own_device, stage, shaders, monkeypatch):
    """The barriers break unless all shaders, and then all pipelines, are being made at one time."""
    monkeypatch.setattr(os, "cpu_count", lambda: COUNT + 1)
    compiling, creating = threading.Barrier(COUNT), threading.Barrier(COUNT + 1)
    compile_source, threads = shaderc.compile_source, set()

    def compile_together(*arguments: Any, **options: Any) -> bytes:
        compiling.wait(timeout=20)
        return compile_source(*arguments, **options)

    def create(real: Callable[..., int], *arguments: Any) -> int:
        creating.wait(timeout=20)
        threads.add(threading.get_ident())
        return real(*arguments)

    shared_layout(own_device, {})  # on software devices the first frame of a process compiles it, too
    monkeypatch.setattr(shaderc, "compile_source", compile_together)
    watch(own_device, monkeypatch, create)
    assert results(own_device, stage, shaders) == EXPECTED
    assert len(threads) == COUNT + 1


RAYS = """#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_ray_tracing : require
"""


@pytest.mark.parametrize(("fails", "rays"), [(False, "query"), (True, "query"), (False, "pipeline")])
def test_other_devices_compile_from_the_end(any_device, stage, shaders, monkeypatch, fails, rays):
    """While the frame's own device waits before its first pipeline; without them it compiles all, as it does ray
    pipelines."""
    ran, helped = [], threading.Event()
    run_once = compile_ahead._run_once

    def note(users, interface, sets, given):
        helped.set()
        if fails:
            raise DeviceError("no memory")
        run_once(users, interface, sets, given)
        ran.append(given)
        assert given.table is None

    def wait(state):
        if state.what == "machine code" and state.done == 0:
            helped.wait(20)
            time.sleep(0.5)

    monkeypatch.setattr(compile_ahead, "_run_once", note)
    monkeypatch.setattr(compile_ahead, "device_count", lambda: 3)
    if rays == "pipeline":
        shaders.write("passes/rays.rgen", RAYS + "void main() {}")
        shaders.write("passes/miss.rmiss", RAYS + "layout(location = 0) rayPayloadInEXT uint payload; void main() {}")
        stage.passes.insert(3, RayPass("rays", threads=1, misses=["passes/miss.rmiss"]))
    with Device(validation=False, on_compile=wait, rays=rays) as device:
        if not device.buffers_by_address:
            pytest.skip("other devices compile when pipelines are made")
        assert results(device, stage, shaders) == EXPECTED
    assert helped.is_set()
    assert len(set(ran)) == len(ran)
    assert fails != bool(ran)


@pytest.mark.parametrize(("threads", "disabled", "count"), [("", "", 3), ("2", "", 2), ("9", "", 3), ("", "true", 1)])
def test_as_many_devices_compile_as_there_are_cores(monkeypatch, threads, disabled, count):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(3), raising=False)
    monkeypatch.setenv("LP_NUM_THREADS", threads)
    monkeypatch.setenv("MESA_SHADER_CACHE_DISABLE", disabled)
    assert compile_ahead.device_count() == count


def test_devices_without_a_listener_compile_ahead_too(any_device, stage, shaders, monkeypatch):
    counts, run_new = [], Slot.run_new
    monkeypatch.setattr(Slot, "run_new", lambda slot: (counts.append(1), run_new(slot)))
    with Device(validation=False, on_compile=None) as device:
        assert results(device, stage, shaders) == EXPECTED
        assert bool(counts) == (device.properties.kind == "cpu")


@pytest.mark.parametrize(("text", "count"), [("200000 100000", 2), ("50000 100000", 1), ("max 100000", 3), (None, 3)])
def test_devices_keep_to_the_quota_of_a_container(monkeypatch, tmp_path, text, count):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(3), raising=False)
    monkeypatch.setattr(compile_ahead, "CPU_QUOTA", tmp_path / "cpu.max")
    monkeypatch.delenv("LP_NUM_THREADS", raising=False)
    if text is not None:
        (tmp_path / "cpu.max").write_text(text)
    assert compile_ahead.device_count() == count


def test_same_pipelines_are_created_once(own_device, stage, shaders, monkeypatch):
    created = []

    def create(real: Callable[..., int], *arguments: Any) -> int:
        created.append(arguments[2])
        return real(*arguments)

    watch(own_device, monkeypatch, create)
    doubled = Stage("writes", buffers=stage.buffers, passes=[*stage.passes, *stage.passes])
    assert results(own_device, doubled, shaders) == EXPECTED
    assert created == [1] * (COUNT + 1)


def test_pipelines_stay_for_the_next_frame(own_device, stage, shaders, monkeypatch):
    """Frames side by side and one after another have the same ones, until `trim`, or until too many are unused."""
    created = []

    def create(real: Callable[..., int], *arguments: Any) -> int:
        created.append(arguments[2])
        return real(*arguments)

    def count() -> int:
        created.clear()
        assert results(own_device, stage, shaders) == EXPECTED
        return len(created)

    own_device.pipelines = SharedObjects(limit=COUNT)
    watch(own_device, monkeypatch, create)
    name = COUNT - 1
    alone = Stage("alone", buffers={f"out_{name}": 1}, passes=[Pass(f"write_{name}", threads=1)])
    with Frame(own_device, [alone], glsl_root=shaders.root):
        assert count() == COUNT + 1, "the same shader, with other binding numbers"
    own_device.trim()
    assert len(own_device.pipelines) == 0
    created.clear()
    with Frame(own_device, [stage], glsl_root=shaders.root):
        assert len(created) == COUNT + 1
        own_device.trim()
        assert count() == 0
    assert count() == 1  # the one that was given back first had gone
    own_device.trim()
    assert count() == COUNT + 1


def test_frames_share_pipelines_though_they_bind_different_buffers(own_device, shaders, monkeypatch):
    """Software devices do where the common layout has the names, of whatever type; an image in a buffer's place, or one
    of another set, gives a frame a layout of its own."""
    created = []
    watch(own_device, monkeypatch, lambda real, *arguments: created.append(1) or real(*arguments))
    for shader, place, name, kind, value in (
        ("one", 1, "radiance", "vec3", 1),
        ("two", 1, "emission", "vec3", 2),
        ("three", 1, "emission", "float", 3),
        ("four", 0, "depth", "float", 4),
    ):
        shaders.write(
            shader,
            "layout(local_size_x = 1) in;\n"
            f"layout(set = {place}, scalar) buffer B {{ {kind} at[]; }} {name};\n"
            f"void main() {{ {name}.at[0] = {kind}({value}); }}\n",
        )
    counts = []
    for other, name, value in (
        (None, "radiance", 1.0),
        ("two", "emission", 2.0),
        ("three", "emission", 3.0),
        ("four", "depth", 4.0),
    ):
        created.clear()
        passes = [Pass(shader, threads=1) for shader in (other, "one") if shader]
        stage = Stage("all", buffers=dict.fromkeys(("radiance", name), 1), passes=passes)
        with Frame(own_device, [stage], glsl_root=shaders.root) as frame:
            frame.submit()
            assert frame["radiance"].max() == 1.0
            assert frame[name].min() == value
        counts.append(len(created))
    assert counts == ([1, 1, 1, 2] if own_device.properties.kind == "cpu" else [1, 2, 1, 2])


def test_a_frame_that_fails_late_gives_its_pipelines_back(own_device, stage, shaders, monkeypatch):
    def fail(*_: Any) -> None:
        raise DeviceError("no memory for uniforms")

    monkeypatch.setattr(Slot, "renew", fail)
    with leaves_nothing(own_device), pytest.raises(DeviceError, match="no memory for uniforms"):
        Frame(own_device, [stage], glsl_root=shaders.root)
    own_device.trim()
    assert len(own_device.pipelines) == 0


def test_constants_keep_their_order(own_device, shaders, monkeypatch):
    """The driver's and our cache know a pipeline by its constants in their order, which a set changes by process."""
    names = [f"C{number}" for number in range(8)]
    lines = "".join(f"layout(constant_id = {number}) const uint {name} = 0;\n" for number, name in enumerate(names))
    body = f"void main() {{ out_0.at[0] = {' ^ '.join(names)}; }}"
    shaders.write("many", TEXT.format(0).partition("void")[0].replace("id = 0", "id = 9") + lines + body)
    orders = []

    def create(real: Callable[..., int], *arguments: Any) -> int:
        entries = arguments[3].stage.pSpecializationInfo.pMapEntries
        orders.append([entries[number].constantID for number in range(8)])
        return real(*arguments)

    watch(own_device, monkeypatch, create)
    item = Pass("many", threads=1, constants=dict.fromkeys(reversed(names), 1))
    with Frame(own_device, [Stage("many", buffers={"out_0": 1}, passes=[item])], glsl_root=shaders.root):
        assert orders == [list(reversed(range(8)))]


def test_a_failure_names_its_pass_and_leaves_nothing(own_device, stage, shaders, monkeypatch):
    """The first pass whose pipeline fails is named, though the others are made meanwhile."""
    order = iter(range(COUNT + 1))

    def create(real: Callable[..., int], *arguments: Any) -> int:
        return raw.check(raw.VK_ERROR_OUT_OF_DEVICE_MEMORY, "call") if next(order) in (2, 4) else real(*arguments)

    monkeypatch.setattr(os, "cpu_count", lambda: 1)  # so that they are created in the order of the passes
    results(own_device, stage, shaders)
    own_device.trim()
    watch(own_device, monkeypatch, create)
    error = r"^pass write_2: .*VK_ERROR_OUT_OF_DEVICE_MEMORY"
    with leaves_nothing(own_device), pytest.raises(DeviceError, match=error):
        Frame(own_device, [stage], glsl_root=shaders.root)


def test_an_interrupt_waits_for_the_threads_and_leaves_nothing(own_device, stage, shaders, monkeypatch):
    """What a thread uses must not be destroyed before the thread ends."""
    waiting = threading.Event()
    started = []
    ended = []

    def wait(futures: Any) -> None:
        waiting.set()
        real_wait(futures)

    def create(real: Callable[..., int], *arguments: Any) -> int:
        started.append(1)
        assert waiting.wait(20)
        if len(started) == 1:
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
        time.sleep(0.2)
        result = real(*arguments)
        ended.append(1)
        return result

    results(own_device, stage, shaders)
    own_device.trim()
    real_wait = pipelines.wait
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    monkeypatch.setattr(pipelines, "wait", wait)
    watch(own_device, monkeypatch, create)
    with leaves_nothing(own_device):
        with pytest.raises(KeyboardInterrupt):
            Frame(own_device, [stage], glsl_root=shaders.root)
        assert len(ended) == len(started)


# ---- on disk ----------------------------------------------------------------------------------------


def initial_data(monkeypatch: pytest.MonkeyPatch, stage: Stage, shaders: ShaderFolder) -> bytes:
    """The data that a new device's pipeline cache begins with, while a frame runs on the device."""
    found = []
    create = Device.create

    def look(device: Device, type_name: str, info: raw.CData, name: str) -> raw.CData:
        if type_name == "VkPipelineCache":
            found.append(raw.ffi.buffer(info.pInitialData, info.initialDataSize)[:] if info.initialDataSize else b"")
        return create(device, type_name, info, name)

    with monkeypatch.context() as patch:
        patch.setattr(Device, "create", look)
        patch.setattr(compile_ahead, "device_count", lambda: 1)  # other devices have caches of their own
        with Device(validation=True) as device:
            assert results(device, stage, shaders) == EXPECTED
            assert results(device, stage, shaders) == EXPECTED
    (data,) = found  # one cache for all frames of a device
    return data


def entries() -> list[Path]:
    folder = disk_cache.folder()
    assert folder is not None
    return list(folder.glob("*.pipelines"))


def with_hash(content: bytes) -> bytes:
    return hashlib.sha256(content).digest() + content


def other_device(entry: bytes) -> bytes:
    """The entry with another pipelineCacheUUID."""
    return with_hash(entry[32:48] + bytes(255 - byte for byte in entry[48:64]) + entry[64:])


def test_the_cache_outlives_the_device_and_what_is_useless_is_replaced(any_device, stage, shaders, monkeypatch):
    """A file that is damaged, or of another device, and one that has grown too large."""
    assert initial_data(monkeypatch, stage, shaders) == b""
    (file,) = entries()
    good = file.read_bytes()
    kept = good[32:]
    assert disk_cache.load(file.name) == kept
    assert kept[:4] == (32).to_bytes(4, "little")
    assert initial_data(monkeypatch, stage, shaders) == kept
    for damaged in (good[:50] + bytes([good[50] ^ 1]) + good[51:], other_device(good)):
        file.write_bytes(damaged)
        assert initial_data(monkeypatch, stage, shaders) == b""
        assert file.read_bytes() == good
    assert initial_data(monkeypatch, stage, shaders) == kept
    assert not list(file.parent.glob("*.tmp"))
    monkeypatch.setattr(pipeline_cache, "MAX_BYTES", 1)
    assert initial_data(monkeypatch, stage, shaders) == b""


def test_each_driver_version_has_its_own_file(own_device, shaders, monkeypatch):
    names = set()
    real = own_device.instance_vk.vkGetPhysicalDeviceProperties
    for version in range(2):

        def get(handle: raw.CData, out: raw.CData, version: int = version) -> None:
            real(handle, out)
            out.driverVersion = version

        monkeypatch.setattr(own_device.instance_vk, "vkGetPhysicalDeviceProperties", get)
        names.add(pipeline_cache.PipelineCache(own_device).entry)
    assert len(names) == 2


def test_a_write_that_fails_keeps_the_entry_before(shaders, monkeypatch):
    disk_cache.store("entry", b"before")

    def fail(*_: object) -> None:
        raise OSError(28, "no space left")

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", fail)
        with pytest.warns(UserWarning, match=r"can't be kept: .*entry: .*no space left: .* by SOLARI_VK_CACHE"):
            disk_cache.store("entry", b"after")
        with warnings.catch_warnings(action="error"):  # a first start has 30 entries
            disk_cache.store("entry", b"after")
    assert disk_cache.load("entry") == b"before"
    folder = disk_cache.folder()
    assert folder is not None
    assert [file.name for file in folder.iterdir()] == ["entry"]


def test_a_cache_that_the_driver_keeps_to_itself_only_warns(own_device, stage, shaders, monkeypatch):
    def fail(*_: Any) -> int:
        return raw.check(raw.VK_ERROR_OUT_OF_HOST_MEMORY, "vkGetPipelineCacheData")

    monkeypatch.setattr(own_device.vk, "vkGetPipelineCacheData", fail)
    with pytest.warns(UserWarning, match=r"pipelines can't be kept .*vkGetPipelineCacheData: VK_ERROR_OUT_OF_HOST"):
        assert results(own_device, stage, shaders) == EXPECTED
    assert not entries()
