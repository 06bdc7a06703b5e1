"""What a frame is made of, as data: stages that name their buffers and images and list their passes in order."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from solari_vk.errors import SolariError

if TYPE_CHECKING:
    from solari_vk.gpu.device import raw

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
class DrawList:
    """Up to `most` VkDrawIndirectCommand from the start of buffer `commands`; how many of them count is the uint at
    `count_offset` bytes of buffer `count`. Those after it draw nothing either (instanceCount 0), since not every device
    reads counts from buffers. `culls_backs`: clockwise triangles are left out.
    """

    commands: str
    count: str
    most: int
    count_offset: int = 0
    culls_backs: bool = True


@dataclass(frozen=True)
class Draw:
    """Triangles drawn by glsl/passes/NAME.vert and NAME.frag, which fetch their vertices from buffers by themselves.

    `colors` are the images that outputs 0, 1, ... of the fragment shader go to: storage images of the frame's shaders,
    which give their formats. `depth` is an image of 32-bit depths that a stage declares; what is larger is nearer.
    `clears`: the images start from zeros, else from what they hold.
    """

    name: str
    draws: Sequence[DrawList]
    colors: Sequence[str]
    depth: str
    clears: bool = True
    constants: Mapping[str, int | float | bool] = field(default_factory=dict)
    header: str = ""


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
    formats are the shaders', but for a Draw's depth. All start as zeros.
    """

    name: str
    buffers: Mapping[str, int | History] = field(default_factory=dict)
    images: Mapping[str, Size | History] = field(default_factory=dict)
    passes: Sequence[Pass | Draw | Step] = ()
