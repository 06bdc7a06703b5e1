"""Measures checks on one device in this process, and tells what happens as messages."""

from __future__ import annotations

import importlib
import os
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from solari_vk.base.errors import SolariError
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.rays import AUTO, IN_WORDS
from solari_vk.lab.conformance.cases import CheckContext
from solari_vk.lab.conformance.faults import Fault, known_faults
from solari_vk.lab.conformance.outcomes import LOST, UNSUPPORTED, Check, Outcome
from solari_vk.lab.conformance.recorder import Recorder
from solari_vk.lab.page import device_facts, host_load
from solari_vk.lab.shader_runner import ShaderRunner

# The cases under which errors outside of checks are reported.
OPENING, CLOSING = "opening the device", "closing the device"


@dataclass(frozen=True)
class SuiteOptions:
    """What checks are measured with: the device that `select` names, the profile, the way to trace rays (see `Device`),
    and the module that has GROUPS, RAYS and parts."""

    select: str | None = None
    full: bool = False
    rays: str | None = None
    table: str = "solari_vk.lab.conformance.groups"


@dataclass(frozen=True)
class CheckBegan:
    """A check begins."""

    check: Check


@dataclass(frozen=True)
class CheckEnded:
    """A check reached its end after so many seconds."""

    check: Check
    seconds: float


@dataclass(frozen=True)
class DeviceOpened:
    """The device is open: the head of the report, and the known faults of the driver."""

    facts: dict[str, str]
    faults: list[Fault]


# The error is the reason why the device can't be opened, prepared or closed.
Message = CheckBegan | CheckEnded | DeviceOpened | Outcome | SolariError
Send = Callable[[Message], None]


class Worker:
    """A device for a group, with the suite's shaders and the known faults of its driver. A context manager.

    Raises DeviceError when no device fits, SolariError for a wrong SOLARI_VK_RAYS or known_faults.toml."""

    def __init__(self, options: SuiteOptions, group: str) -> None:
        table = importlib.import_module(options.table)
        self._open = ExitStack()
        self._ways = table.RAYS.get(group, tuple(IN_WORDS))
        self.device = self._open.enter_context(_open_device(options, self._ways))
        self.faults = known_faults(f"{self.device.properties.driver} {self.device.name}")
        self._shaders = self._open.enter_context(ShaderRunner(self.device))
        self._full = options.full
        self._groups = table.GROUPS

    def measure(self, check: Check, send: Callable[[Outcome], None]) -> None:
        """Measure one check. An error that it raises becomes an outcome."""
        by_compute = self.device.rays == "compute"
        # Faults of the driver aren't those of the renderer's own trees.
        rule = Recorder(check, [] if by_compute else self.faults, send)
        if by_compute != ("compute" in self._ways) and self.device.rays not in self._ways:
            ways = " or ".join(self._ways)
            rule.unmeasured(
                check.rule, UNSUPPORTED, f"the device is opened for rays by {self.device.rays}, not by {ways}"
            )
            return
        try:
            rule(self._groups[check.group][check.case](CheckContext(rule, self._shaders, self._full, check.part)))
            # What the check has submitted must end within it, and messages of the validation layer are about it.
            self.device.wait_idle()
            self.device.check_messages()
        # Whatever a check raises is its outcome: the other checks must still be measured.
        except Exception as error:
            if self.device.lost:
                rule.died(LOST, "VK_ERROR_DEVICE_LOST", _describe(error))
            else:
                rule.error(_describe(error))
        else:
            rule.finish()

    def close(self) -> None:
        """Close the device. Raises ValidationError if messages of the validation layer are left."""
        self._open.close()

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def measure_checks(options: SuiteOptions, checks: Sequence[Check], send: Send) -> None:
    """Open the device, measure checks of one group up to one that loses the device, and close the device."""
    group = checks[0].group
    worker = None
    with _announced(Check(group, OPENING), send):
        worker = Worker(options, group)
        send(DeviceOpened(_facts(worker.device), worker.faults))
    if worker is None:
        return
    try:
        for check in checks:
            with _announced(check, send):
                worker.measure(check, send)
            # No further check can be measured by a lost device; the parent starts a new process.
            if worker.device.lost:
                break
    finally:
        with _announced(Check(group, CLOSING), send):
            worker.close()


def _open_device(options: SuiteOptions, ways: Sequence[str]) -> Device:
    """The device, opened for the first of these ways to trace rays that it has, if the user didn't choose one."""
    # The first device is needed to learn what it lacks; opening it again costs little.
    device = Device(options.select, rays=options.rays)
    chosen = options.rays or os.environ.get("SOLARI_VK_RAYS") or AUTO
    usable = [way for way in ways if not device.missing_rays[way]]
    if chosen != AUTO or device.rays in ways or not usable:
        return device
    device.close()
    return Device(options.select, rays=usable[0])


def _facts(device: Device) -> dict[str, str]:
    limits = device.properties.acceleration
    return {
        **device_facts(device, host_load()),
        "limits": f"{limits.maxInstanceCount:,} instances, {limits.maxPrimitiveCount:,} primitives, "
        f"{limits.maxGeometryCount:,} geometries",
        "validation": "core and synchronization" if device.validation else "off",
    }


@contextmanager
def _announced(check: Check, send: Send) -> Iterator[None]:
    """Send when a check begins, what it raises, and when it ends."""
    started = time.monotonic()
    send(CheckBegan(check))
    try:
        yield
    except SolariError as error:
        send(error)
    send(CheckEnded(check, time.monotonic() - started))


def _describe(error: Exception) -> str:
    place = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {error} ({Path(place.filename).name}:{place.lineno})"
