"""The user's numbers of the triangles that the device has in another order."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device


class TriangleOrders:
    """The buffers `triangle_orders`, the user's number of each triangle in the device's order, and `order_starts`, the
    index of each mesh's first triangle in it."""

    def __init__(self, device: Device, binder: SceneBinder) -> None:
        self._device = device
        self._binder = binder
        self._seen = 0  # the revision of the scene
        self._orders: dict[int, NDArray[np.int64]] | None = None
        self.buffers: dict[str, Buffer] = {}
        """Both by name, as of the latest `update`."""

    def update(self) -> bool:
        """Apply the binder's latest update; returns whether the buffers are other ones now."""
        if self._orders is not None and self._seen == self._binder.scene_revision:
            return False
        self._seen = self._binder.scene_revision
        orders = self._binder.triangle_orders
        # A mesh that was uploaded again has another array.
        known = self._orders
        if known is not None and orders.keys() == known.keys() and all(orders[row] is known[row] for row in orders):
            return False
        starts = np.zeros(max(orders, default=0) + 1, np.uint32)
        # Equal meshes share an order, which stands in the buffer once.
        distinct = {id(order): order for order in orders.values()}
        begins = dict(zip(distinct, np.cumsum([0, *map(len, distinct.values())]).tolist(), strict=False))
        starts[list(orders)] = [begins[id(order)] for order in orders.values()]
        numbers = np.concatenate([np.zeros(0, np.int64), *distinct.values()]).astype(np.uint32)
        self.destroy()
        arrays: dict[str, NDArray[Any]] = {"triangle_orders": numbers, "order_starts": starts}
        for name, values in arrays.items():
            self.buffers[name] = self._device.buffer(values.nbytes, name)
            self.buffers[name].upload(values)
        self._orders = orders
        return True

    def destroy(self) -> None:
        """Free the buffers when the work submitted so far is done. Safe to call twice."""
        for buffer in self.buffers.values():
            buffer.destroy()
        self.buffers.clear()
        self._orders = None
