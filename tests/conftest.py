"""Fixtures for all tests: one validated device, and no test passes with a validation message."""

from __future__ import annotations

import gc
import os
import signal

import pytest
from hypothesis import HealthCheck, Phase, settings
from support.files import GltfWriter, find_asset

# Every Device of the suite validates, also those that tests make through the command line in this process.
os.environ.setdefault("SOLARI_VK_VALIDATION", "1")
# With shaders as users run them, which are compiled in a fifth of the time. Synchronization validation sees no access
# of their buffers: tests/gpu and tests/documentation/test_buffers.py are about barriers, and take `bound_device`.
os.environ.setdefault("SOLARI_VK_ADDRESSES", "1")


from solari_vk.base.errors import DeviceError
from solari_vk.gpu.device import instance as instance_module
from solari_vk.gpu.device.device import Device, list_devices

# Random tests find the same failures in every run and on every machine.
settings.register_profile(
    "suite",
    derandomize=True,
    database=None,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
    phases=set(Phase) - {Phase.explain},  # which takes minutes
)
settings.load_profile("suite")

MOST_MEMORY = 2 << 30  # bytes, after a file's tests

_messages = []
_devices = []


def pytest_configure(config):
    # A shell ignores Ctrl-C in what it runs in the background; tests send it to themselves and to their children.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    config.addinivalue_line("markers", "provokes_validation: the test makes validation messages on purpose")
    config.addinivalue_line("markers", "posix: for links, pipes, modes or signals that Windows doesn't have")
    note = instance_module.record_message

    def note_and_log(messages, text):
        _messages.append(text)
        note(messages, text)

    instance_module.record_message = note_and_log


def pytest_runtest_setup(item):
    if os.name != "posix" and item.get_closest_marker("posix"):
        pytest.skip("this system has no such links, pipes, modes or signals")


def pytest_collection_finish():
    gc.freeze()  # what imports have made stays: collections needn't look through it


def _find_reason_to_skip():
    """Why tests must be skipped: there is no Vulkan device. A device that lacks a feature is a failure instead."""
    try:
        if list_devices():
            return None
        return "no Vulkan device is present"
    except DeviceError as error:
        return f"no Vulkan device is present: {error}"


@pytest.fixture(scope="session")
def any_device():
    """Skip without a Vulkan device; with SOLARI_VK_REQUIRE_DEVICE=1 that is a failure."""
    reason = _find_reason_to_skip()
    if reason is not None:
        if os.environ.get("SOLARI_VK_REQUIRE_DEVICE") == "1":
            pytest.fail(f"SOLARI_VK_REQUIRE_DEVICE=1, but {reason}")
        pytest.skip(reason)


@pytest.fixture(scope="session")
def device(any_device):
    """A device with core and synchronization validation, unless SOLARI_VK_VALIDATION is 0, shared by the session."""
    opened = Device()
    _devices.append(opened)
    yield opened
    _devices.remove(opened)
    opened.close()


@pytest.fixture(scope="session")
def bound_device(any_device):
    """`device` with buffers that are bound by descriptors, so that validation sees missing barriers."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SOLARI_VK_ADDRESSES", "0")
        opened = Device()
    _devices.append(opened)
    yield opened
    _devices.remove(opened)
    opened.close()


@pytest.fixture(scope="module")
def device_of_file(any_device):
    """A device that the tests of a file share. What they leave on it goes with it."""
    with Device() as opened:
        _devices.append(opened)
        yield opened
        _devices.remove(opened)


@pytest.fixture
def lent_device(device_of_file, monkeypatch):
    """What programs and commands open that name no device: so pipelines are made once. It stays open."""
    device = device_of_file

    def lend(name=None, *, validation=None, rays=None, on_compile=None):
        if name or validation or rays not in (None, device.rays):
            return Device(name, validation=validation, rays=rays, on_compile=on_compile)
        monkeypatch.setattr(device, "on_compile", on_compile)
        return device

    monkeypatch.setattr(device, "close", lambda: None)
    for module in ("solari_vk", "solari_vk.lab.measure.report"):
        monkeypatch.setattr(f"{module}.Device", lend)
    for module in ("cli.realtime", "cli.reference", "studio.commands"):
        monkeypatch.setattr(
            f"solari_vk.{module}.open_device",
            lambda job, notes=None: lend(job.device, validation=job.validation, rays=job.rays, on_compile=notes),
        )
    return device


@pytest.fixture(scope="session")
def pool(any_device):
    """Two workers, in processes of their own, which validate as all devices of the suite do."""
    from solari_vk.renderers.cluster.worker_pool import WorkerPool  # late: it imports the renderers

    with WorkerPool(workers=2) as opened:
        yield opened


@pytest.fixture
def asset():
    """asset(name) -> the path of an asset; without it the test is skipped."""
    return find_asset


@pytest.fixture
def writer(tmp_path):
    """A glTF file without contents, which `load` saves as file.glb."""
    return GltfWriter(tmp_path / "file.glb")


@pytest.fixture
def moving(tmp_path):
    """The file of a triangle that moves sideways for a second, and has another clip in which it grows, before a
    camera."""
    writer = GltfWriter(tmp_path / "moving.glb")
    node = writer.node(mesh=writer.mesh())
    camera = writer.add("cameras", type="perspective", perspective={"yfov": 0.9, "znear": 0.1})
    writer.node(camera=camera, translation=[0.5, 0.3, 3])
    ways = ("slide", "translation", [[-1, 0, 0], [1, 0, 0]]), ("grow", "scale", [[0, 0, 0], [3, 3, 3]])
    for name, path, values in ways:
        sampler = {"input": writer.accessor([0, 1]), "output": writer.accessor(values)}
        target = {"node": node, "path": path}
        writer.add("animations", name=name, samplers=[sampler], channels=[{"sampler": 0, "target": target}])
    return writer.save(tmp_path / "moving.glb")


@pytest.fixture(autouse=True)
def no_validation_messages(request):
    """Fail the test that caused a validation message, even if the test caught the exception."""
    _messages.clear()
    yield
    for opened in _devices:
        opened.wait_idle()
    messages = list(_messages)
    _messages.clear()
    if request.node.get_closest_marker("provokes_validation") is None:
        assert not messages, "validation messages:\n" + "\n".join(messages)
    else:
        assert messages, "the test was to provoke validation, but there was no message"


@pytest.fixture(autouse=True, scope="module")
def bounded_memory():
    """Compiled pipelines take megabytes each on software devices: let them go when a file's tests leave too many."""
    from support.frames import resident_bytes  # late: it imports the renderers, which set-up doesn't need

    yield
    if resident_bytes() > MOST_MEMORY:
        for opened in _devices:
            opened.trim()


def pytest_sessionfinish(session):
    """Fail the session for validation messages while its device is destroyed; processes of xdist hand them on."""
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["validation_messages"] = list(_messages)
    elif _messages:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
        print("\nvalidation messages at the end of the session:\n" + "\n".join(_messages))


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node):
    """Take the messages of a process of pytest-xdist that has ended."""
    _messages.extend(getattr(node, "workeroutput", {}).get("validation_messages", ()))
