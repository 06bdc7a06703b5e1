"""Poses and transforms that tensors give on the device: shaders write them where the host leaves them open."""

from __future__ import annotations

from typing import Any

from solari_vk.base.errors import SolariError
from solari_vk.bound.given_numbers import GivenNumbers, is_takable, take
from solari_vk.gpu.device.barriers import full_barrier, host_read_barrier
from solari_vk.gpu.device.cuda_input import Taken
from solari_vk.gpu.device.device import Device


def taken(device: Device, value: Any, what: str, *shapes: tuple[int, ...], where: str) -> Taken | None:
    """A tensor of one of these shapes in the device's memory. None for all that the host must read."""
    if is_takable(device, value) and tuple(value.shape) not in shapes:
        raise SolariError(
            f"{where}: {what} must have the shape {' or '.join(map(str, shapes))}, not {tuple(value.shape)}"
        )
    return take(device, value)


class GivenPoses(GivenNumbers):
    """Writes transforms and cameras of tensors to memory of the device. where, of: as of `GivenNumbers`."""

    def __init__(self, device: Device, where: str, of: str) -> None:
        super().__init__(device, f"{where}: ", of, "be finite, affine and invertible, and lie within 1e12")

    def write(
        self, given: Taken, what: str, count: int, first: tuple[int, int, int], second: tuple[int, int, int]
    ) -> None:
        """Have the transforms (count, 4, 4) of a tensor written just before the next submission. first, second: where
        the records are of shaders and of rays: an address, and in floats the place and the step from one to the
        next."""
        self._start(
            given,
            what,
            count,
            "transforms",
            {
                "first": first[0],
                "first_place": first[1],
                "first_step": first[2],
                "second": second[0],
                "second_place": second[1],
                "second_step": second[2],
            },
        )

    def write_cameras(self, given: Taken, what: str, count: int, rows: int) -> None:
        """Have the poses (count, 4, 4) of a tensor written just before the next submission: the 24 numbers of matrices,
        each for all cameras, at the address `rows`."""
        self._start(given, what, count, "cameras", {"first": rows})

    def _start(self, given: Taken, what: str, count: int, kernel: str, places: dict[str, int]) -> None:
        pushed = {
            **self._source(given, what),
            "step": given.strides[0] // given.dtype.itemsize,
            "count": count,
            **places,
        }
        step, vk = self._kernel(kernel), self._device.vk

        def record(commands: Any) -> None:
            vk.vkCmdPipelineBarrier2(commands, full_barrier())
            step.record(commands, (count, 1), **pushed)
            vk.vkCmdPipelineBarrier2(commands, full_barrier())
            vk.vkCmdPipelineBarrier2(commands, host_read_barrier())

        self._device.start_with_next(record, what)
