"""The results of reflection as plain data; `spirv.reflect` makes them from a SPIR-V module."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Binding:
    """A resource that a shader declares. Its number `binding` is the interface's, not the shader's, once it has one.

    `kind` is uniform_buffer, storage_buffer, storage_image, sampled_image, combined_image_sampler, sampler or
    acceleration_structure. `count` is the length of an array of resources, 1 if it is no array, 0 for an array without
    a length. `dtype` is the fixed part of a block (None if there is none), `element` the element type of the runtime
    array at `element_offset` bytes (None without one). `image_format` is a storage image's format without the prefix
    VK_FORMAT_, such as "R32_SFLOAT".
    """

    name: str
    set: int
    binding: int
    kind: str
    count: int = 1
    dtype: np.dtype[Any] | None = None
    element: np.dtype[Any] | None = None
    element_offset: int = 0
    image_format: str = ""
    readonly: bool = False
    writeonly: bool = False

    def size_bytes(self, count: int) -> int:
        """The size in bytes of a buffer for this block with `count` elements in its runtime array."""
        if self.element is not None:
            return self.element_offset + count * self.element.itemsize
        return self.dtype.itemsize if self.dtype else 0


@dataclass(frozen=True)
class SpecConstant:
    """A specialization constant: id, numpy type (u4 for bool, as in Vulkan) and default value."""

    id: int
    dtype: np.dtype[Any]
    default: int | float | bool


@dataclass(frozen=True)
class Entry:
    """An entry point: its stage (comp, vert, ...) and the names of the bindings that it uses, reads and writes."""

    name: str
    stage: str
    uses: frozenset[str]
    reads: frozenset[str]
    writes: frozenset[str]


@dataclass(frozen=True)
class Module:
    """A SPIR-V module with everything that the host needs to know about it. `variables`: the bindings' ids."""

    name: str
    spirv: bytes
    bindings: dict[str, Binding]
    variables: dict[int, str]
    constants: dict[str, SpecConstant]
    entries: dict[str, Entry]
    push_constants: np.dtype[Any] | None
    _local_size: tuple[tuple[int, int | None], ...]

    @property
    def main(self) -> Entry:
        """The entry point called main."""
        return self.entries["main"]

    def local_size(self, constants: Mapping[str, int | float | bool] | None = None) -> tuple[int, int, int]:
        """The workgroup size (x, y, z) with these values of specialization constants, by name."""
        values = {self.constants[name].id: int(value) for name, value in (constants or {}).items()}
        sizes = [default if spec_id is None else values.get(spec_id, default) for default, spec_id in self._local_size]
        x, y, z = (*sizes, 1, 1, 1)[:3]
        return x, y, z
