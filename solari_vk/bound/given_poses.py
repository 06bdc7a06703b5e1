"""Poses and transforms that tensors give on the device: shaders write them to the records that the host leaves open."""

from __future__ import annotations

from typing import Any

from solari_vk.bound.given_numbers import GivenNumbers, is_takable, take
from solari_vk.errors import SolariError
from solari_vk.gpu.device.barriers import full_barrier, host_read_barrier
from solari_vk.gpu.device.cuda_input import Taken
from solari_vk.gpu.device.device import Device

KEPT_FLOATS = 24  # of a camera: world_from_view and view_from_world


def taken(device: Device, value: Any, what: str, *shapes: tuple[int, ...], where: str) -> Taken | None:
    """A tensor of one of these shapes in the device's memory. None for all that the host must read."""
    if is_takable(device, value) and tuple(value.shape) not in shapes:
        raise SolariError(f"{where}: {what} must have the shape {' or '.join(map(str, shapes))}, not "
                          f"{tuple(value.shape)}")  # fmt: skip
    return take(device, value)


class GivenPoses(GivenNumbers):
    """Writes matrices of tensors to records on the device. where, of: as of `GivenNumbers`."""

    def __init__(self, device: Device, where: str, of: str) -> None:
        super().__init__(device, f"{where}: ", of, "be finite, affine and invertible, and lie within 1e12")

    def write(
        self, given: Taken | None, what: str, count: int, first: tuple[int, int, int], second: tuple[int, int, int],
        kernel: str = "transforms", previous: int = 0, ball: int = 0,
    ) -> None:  # fmt: skip
        """Have a kernel of glsl/scene/given write matrices (count, 4, 4) just before the next submission. first,
        second: where its records are: an address, and in floats the place and the step from one to the next. ball: the
        address that gets the one around the first, which are cameras; 0 for none."""
        source = self._noting(what) if given is None else {
            **self._source(given, what), "step": given.strides[0] // given.dtype.itemsize
        }  # fmt: skip
        pushed = {
            **source, "count": count,
            "first": first[0], "first_place": first[1], "first_step": first[2],
            "second": second[0], "second_place": second[1], "second_step": second[2],
            "previous": previous, "is_given": given is not None,
        }  # fmt: skip
        steps = [(self._kernel(kernel), count, pushed)]
        if ball:
            steps.append((self._kernel("camera_ball"), 1, pushed | {"second": ball}))
        vk = self._device.vk

        def record(commands: Any) -> None:
            vk.vkCmdPipelineBarrier2(commands, full_barrier())
            for step, threads, fields in steps:
                step.record(commands, (threads, 1), **fields)
                vk.vkCmdPipelineBarrier2(commands, full_barrier())
            vk.vkCmdPipelineBarrier2(commands, host_read_barrier())

        self._device.start_with_next(record, what)
