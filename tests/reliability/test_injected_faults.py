"""Vulkan calls that can fail fail once, each in its turn: one clear error, nothing lost, and the next call works.

A run of a scenario is counted call by call. Then the scenario runs again and again, and its first, second, third, ...
such call returns an error in place of being made. The scenarios trace by ray queries; the window's swapchain has tests
of its own in tests/studio/viewer.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import solari_vk as sv
from solari_vk.gpu.device import raw

MEMORY = (
    "vkAllocateMemory",
    "vkMapMemory",
    "vkAllocateCommandBuffers",
    "vkAllocateDescriptorSets",
    "vkBindBufferMemory",
    "vkBindImageMemory",
    "vkCreateAccelerationStructureKHR",
    "vkCreateBuffer",
    "vkCreateCommandPool",
    "vkCreateDescriptorPool",
    "vkCreateDescriptorSetLayout",
    "vkCreateFence",
    "vkCreateImage",
    "vkCreateImageView",
    "vkCreatePipelineCache",
    "vkCreatePipelineLayout",
    "vkCreateQueryPool",
    "vkCreateSampler",
    "vkCreateSemaphore",
    "vkBeginCommandBuffer",
    "vkEndCommandBuffer",
    "vkQueueSubmit2",
)
PIPELINES = "vkCreateShaderModule", "vkCreateComputePipelines", "vkCreateGraphicsPipelines"
"""These and MEMORY are the calls that may return VK_ERROR_OUT_OF_DEVICE_MEMORY."""
LOSS = ("vkQueueSubmit2", "vkWaitSemaphores", "vkGetSemaphoreCounterValue", "vkResetFences", "vkWaitForFences")


Attempt = Callable[[Callable[[], Any]], Any]
Scenario = Callable[[sv.Device, Attempt], NDArray[Any]]


class Faults:
    """Counts the calls of some functions of a device, and makes one of them return an error in place of being made."""

    def __init__(self, device: sv.Device, names: Sequence[str], error: int) -> None:
        self.error = error
        self.fail_at = -1
        self.calls = 0
        self.failed = ""
        self.said: list[str] = []
        for name in names:
            function = getattr(device.vk, name)
            setattr(device.vk, name, raw._checked(self._counted(name, function), name, device._on_error))

    def _counted(self, name: str, function: Callable[..., int]) -> Callable[..., int]:
        def call(*arguments: Any) -> int:
            self.calls += 1
            if self.calls - 1 != self.fail_at:
                return function(*arguments)
            self.failed = name
            return self.error

        return call

    def run(
        self, scenario: Scenario, device: sv.Device, fail_at: int, tries: int, compiles: bool = True
    ) -> NDArray[Any]:
        """The result of a scenario whose steps are tried again, if they fail, up to `tries` times in all. compiles:
        whether the run creates its pipelines anew."""
        if compiles:
            device.trim()
        self.fail_at = fail_at
        self.calls = 0
        self.failed = ""
        self.said = []

        def attempt(step: Callable[[], Any]) -> Any:
            for last in (number == tries - 1 for number in range(tries)):
                try:
                    return step()
                except sv.DeviceError as error:
                    self.said.append(str(error))
                    if last:
                        raise

        return scenario(device, attempt)


def reference(device: sv.Device, attempt: Attempt) -> NDArray[Any]:
    """A path tracer over a scene that changes, in two sizes."""
    scene = sv.builtin("cornell_box")
    with attempt(lambda: sv.PathTracer(device, scene, (8, 8), max_bounces=1)) as tracer:
        attempt(lambda: tracer.render(samples=1))
        scene.add(sv.shapes.sphere(0.3, segments=8), sv.Material(base_color=(1, 0.6, 0.1)), (0.7, 0.9, 0.6))
        attempt(lambda: tracer.render(samples=1))
        attempt(lambda: tracer.resize((6, 5)))
        attempt(lambda: tracer.render(samples=2))
        return np.array(attempt(lambda: tracer["radiance"]))


def realtime(device: sv.Device, attempt: Attempt) -> NDArray[Any]:
    """Realtime frames over a scene that changes, in two sizes, with another setting."""
    scene = sv.builtin("cornell_box")
    with attempt(lambda: sv.Renderer(device, scene, (8, 8))) as renderer:
        attempt(renderer.render)
        scene.add(sv.shapes.sphere(0.3, segments=8), sv.Material(base_color=(1, 0.6, 0.1)), (0.7, 0.9, 0.6))
        attempt(renderer.render)
        renderer.settings.restir = not renderer.settings.restir
        attempt(renderer.render)
        attempt(lambda: renderer.resize((6, 5)))
        attempt(renderer.render)
        return np.array(attempt(lambda: renderer.read("radiance")))


def rays(device: sv.Device, attempt: Attempt) -> NDArray[Any]:
    """Rays from Python through a scene that changes."""
    scene = sv.builtin("cornell_box")
    origins = np.tile(np.float32([0, 1, 0.9]), (4, 1))
    directions = np.eye(4, 3, dtype=np.float32) - np.float32([0, 0, 1])
    with attempt(lambda: sv.RayTracer(device, scene)) as tracer:
        attempt(lambda: tracer.trace(origins, directions))
        scene.add(sv.shapes.sphere(0.3, segments=8), sv.Material(), (0.1, 1.0, 0.0))
        return np.array(attempt(lambda: tracer.trace(origins, directions))["t"])


@pytest.mark.parametrize(
    ("scenario", "names", "step"),
    [
        (rays, MEMORY + PIPELINES, 3),
        pytest.param(rays, MEMORY + PIPELINES, 1, marks=pytest.mark.slow),
        pytest.param(reference, MEMORY + PIPELINES, 1, marks=pytest.mark.slow),
        # A realtime run takes seconds to create pipelines. It does so at one place, where some calls fail.
        pytest.param(realtime, MEMORY, 1, marks=pytest.mark.slow),
        pytest.param(realtime, PIPELINES, 37, marks=pytest.mark.slow),
    ],
)
def test_a_call_without_memory_loses_nothing(
    scenario: Scenario, names: Sequence[str], step: int, any_device: None
) -> None:
    compiles = "vkCreateShaderModule" in names
    with sv.Device(validation=True) as device:
        faults = Faults(device, names, raw.VK_ERROR_OUT_OF_DEVICE_MEMORY)
        faults.run(scenario, device, -1, 1)  # makes what stays: command buffers, staging memory, the pipeline cache
        expected = faults.run(scenario, device, -1, 1, compiles)
        device.wait_idle()
        calls, live = faults.calls, device.objects_in_use
        assert calls > 20
        for number in range(0, calls, step):
            found = faults.run(scenario, device, number, 2, compiles)
            where = f"call {number} of {calls}, {faults.failed}: {faults.said}"
            if not faults.failed:  # command buffers of earlier runs served
                assert number > 0.9 * calls, where
                break
            if faults.failed not in ("vkAllocateMemory", "vkMapMemory"):  # tried again when the device is done
                assert len(faults.said) == 1, where
                assert f"{faults.failed}: VK_ERROR_OUT_OF_DEVICE_MEMORY" in faults.said[0], where
            assert np.array_equal(found, expected), where
            device.wait_idle()
            assert device.objects_in_use == live, where
            assert not any(device.pipelines._users.values()), where


@pytest.mark.parametrize(
    ("scenario", "step"),
    [
        (rays, 1),
        pytest.param(reference, 1, marks=pytest.mark.slow),
        pytest.param(realtime, 7, marks=pytest.mark.slow),  # each run creates its pipelines, which takes seconds
    ],
)
def test_a_device_that_is_lost_ends_with_one_error(scenario: Scenario, step: int, any_device: None) -> None:
    with sv.Device(validation=True) as device:
        faults = Faults(device, LOSS, raw.VK_ERROR_DEVICE_LOST)
        expected = faults.run(scenario, device, -1, 1)
        calls = faults.calls
    raised = 0
    for number in range(0, calls, step):
        with sv.Device(validation=True) as device:
            faults = Faults(device, LOSS, raw.VK_ERROR_DEVICE_LOST)
            try:
                faults.run(scenario, device, number, 1)
            except sv.DeviceError:
                raised += 1
            if not faults.failed:
                continue  # the device was faster this time, so that fewer calls asked whether it is done
            [said] = faults.said
            assert re.search("VK_ERROR_DEVICE_LOST.*make a new Device", said)
            assert device.lost
            assert not device.idle
            with pytest.raises(sv.DeviceError, match="lost"):
                device.wait_idle()
    assert raised > 10
    with sv.Device(validation=True) as device:
        assert np.array_equal(Faults(device, LOSS, 0).run(scenario, device, -1, 1), expected)
