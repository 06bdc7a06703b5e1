"""What a frame is made of, as data: stages that name their buffers and images and list their passes in order."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from solari_vk.errors import SolariError
from solari_vk.gpu import raw

Size = tuple[int, int]


@dataclass(frozen=True)
class History:
    """Two of a resource that swap with every frame: `name` is this frame's, `previous_name` the last one's.

    `size` is (width, height) of an image or the element count of a buffer.
    """

    size: int | Size


@dataclass(frozen=True)
class Pass:
    """One dispatch of the compute shader glsl/passes/NAME.comp.

    Either `threads`, how many invocations in x, y and z (rounded up to whole workgroups), or `indirect`, the
    buffer with three group counts at `indirect_offset` bytes. `constants` are specialization constants by name;
    `header` is GLSL put before the shader's first line, for variants.
    """

    name: str
    threads: int | tuple[int, ...] | None = None
    indirect: str | None = None
    indirect_offset: int = 0
    constants: Mapping[str, int | float | bool] = field(default_factory=dict)
    header: str = ""

    def __post_init__(self) -> None:
        if (self.threads is None) == (self.indirect is None):
            raise SolariError(f"pass {self.name}: give either threads or indirect")


@dataclass(frozen=True)
class Step:
    """Commands of any kind inside a frame: `record(command_buffer)` is called when a slot is recorded.

    `reads` and `writes` are names of resources, for the barriers around it.
    """

    name: str
    record: Callable[[raw.CData], None]
    reads: Sequence[str] = ()
    writes: Sequence[str] = ()


@dataclass(frozen=True)
class Stage:
    """A part of the frame: element counts of its buffers, sizes of its images, and what runs, in order.

    A buffer's count is the length of its block's runtime array, 1 for a block without one. Element types and image
    formats are the shaders'. All start as zeros.
    """

    name: str
    buffers: Mapping[str, int | History] = field(default_factory=dict)
    images: Mapping[str, Size | History] = field(default_factory=dict)
    passes: Sequence[Pass | Step] = ()
