"""What a frame is made of, as data: stages that name their buffers and images and list their passes in order."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Integral
from typing import TYPE_CHECKING

from solari_vk.base.errors import SolariError, checked_constructor, quoted

if TYPE_CHECKING:
    from solari_vk.gpu.device import raw
    from solari_vk.gpu.shaders.compiler import Roots

Size = tuple[int, int]


@dataclass(frozen=True)
class History:
    """Two resources that swap with every frame: `name` is the current frame's, `previous_name` the previous frame's.

    `size` is (width, height) in pixels for an image, the element count for a buffer.
    """

    size: int | Size


@dataclass(frozen=True)
class Aliased:
    """The size of a buffer of `count` elements that aliases the memory of the buffer `host`, where the same stage or an
    earlier one declares it, else in memory of its own. A pass that writes one of the two destroys the contents of the
    other. Of a history, `host` is the previous frame's: previous_NAME."""

    host: str
    count: int


@dataclass(frozen=True)
class IfUsed:
    """The size of an image or a buffer that is made only if one of the frame's shaders uses it; those of some scenes
    don't."""

    size: int | Size


@dataclass(frozen=True)
class Counter:
    """The size of a buffer in which the passes of a frame count, such as the length of a list, and whose count the last
    of them sets to zero for the next frame. Where a frame is given up before that, the whole buffer is set to zero."""

    size: int


@checked_constructor
@dataclass(frozen=True)
class Pass:
    """One dispatch of the compute shader passes/NAME.comp below a GLSL root; or passes/NAME.slang, with the extra
    `slang`; or the SPIR-V passes/NAME.spv; or `spirv`, the bytes of a module.

    Give either `threads`, the invocations in x, y and z, which are rounded up to whole workgroups, or `indirect`, the
    name of a buffer with the three workgroup counts at byte `indirect_offset`. `constants` are values of specialization
    constants by name. `header` is GLSL for a variant, put before the shader's first declaration.

    On a device that traces rays by pipelines a shader that traces is launched with exactly `threads` invocations; with
    `indirect`, with the three thread counts that follow the workgroup counts in the buffer.
    """

    name: str
    threads: int | tuple[int, ...] | None = None
    indirect: str | None = None
    indirect_offset: int = 0
    constants: Mapping[str, int | float | bool] = field(default_factory=dict)
    header: str = ""
    spirv: bytes | None = field(default=None, repr=False, kw_only=True)

    def __post_init__(self) -> None:
        if isinstance(self.spirv, bytearray | memoryview):
            object.__setattr__(self, "spirv", bytes(self.spirv))
        if self.spirv is not None and self.header:
            raise SolariError(f"pass {self.name}: a header is text before a shader's own, and SPIR-V has none")
        if (self.threads is None) == (self.indirect is None):
            raise SolariError(f"pass {self.name}: give either threads or indirect")
        if not isinstance(self.indirect_offset, Integral) or self.indirect_offset < 0 or self.indirect_offset % 4:
            given = quoted(self.indirect_offset)
            raise SolariError(
                f"pass {self.name}: indirect_offset is a whole number of bytes, a multiple of 4, not {given}"
            )


@checked_constructor
@dataclass(frozen=True)
class HitGroup:
    """The shaders that run where a ray meets a geometry: their paths below the GLSL root, "" for none.

    A group with an intersection shader is for AABBs, another one for triangles.
    """

    closest_hit: str = ""
    any_hit: str = ""
    intersection: str = ""


@checked_constructor
@dataclass(frozen=True)
class RayPass(Pass):
    """One launch of the ray generation shader glsl/passes/NAME.rgen, whose rays run the pass's own miss and hit
    shaders.

    `misses` are the paths of miss shaders below the GLSL root. `misses` and `hits` are the records of the shader
    binding table in their order; a shader or a group may appear several times. `constants` and `header` are those of
    all shaders of the pass. `max_recursion_depth`: how deep traced rays nest: 1 where the ray generation shader alone
    traces, 2 where the hit and miss shaders of its rays do too. Only for devices that trace rays by pipelines.
    """

    misses: Sequence[str] = ()
    hits: Sequence[HitGroup] = ()
    max_recursion_depth: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.spirv is not None:
            raise SolariError(
                f"pass {self.name}: spirv is of compute shaders: a RayPass names the files of its shaders"
            )


@dataclass(frozen=True)
class DrawList:
    """The first VkDrawIndirectCommand records of the buffer `commands`, at most `max_count`.

    Their number is the uint at byte `count_offset` of the buffer `count`. Devices that can't read it there draw
    `max_count` records, so the records after the last one must draw nothing (instanceCount 0). `culls_backs`: clockwise
    triangles are culled.
    """

    commands: str
    count: str
    max_count: int
    count_offset: int = 0
    culls_backs: bool = True


@dataclass(frozen=True)
class Draw:
    """Triangles drawn by glsl/passes/NAME.vert and NAME.frag; the vertex shader reads vertices from buffers itself.

    `colors` are the images for the fragment shader's outputs 0, 1, ...: storage images of the frame's shaders, which
    declare their formats. `depth` is an image that a stage declares; it holds 32-bit depths, of which larger ones are
    nearer. `clears`: the images are set to zero before drawing.
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
    """Any other commands inside a frame: `record(command_buffer)` is called when a slot is recorded.

    `reads` and `writes` name the resources that the commands access, from which barriers are derived.
    """

    name: str
    record: Callable[[raw.CData], None]
    reads: Sequence[str] = ()
    writes: Sequence[str] = ()


@checked_constructor
@dataclass(frozen=True)
class Stage:
    """A part of the frame: the element counts of its buffers, the sizes of its images, and its passes in order.

    A buffer's count is the length of its block's runtime array, 1 for a block without one. The shaders declare element
    types and image formats, except the format of a Draw's depth. All resources start as zeros. `glsl_root`: one or
    several folders that hold passes/ and are searched before the frame's, for shaders of this stage.
    """

    name: str
    buffers: Mapping[str, int | History | IfUsed | Counter | Aliased] = field(default_factory=dict)
    images: Mapping[str, Size | History | IfUsed] = field(default_factory=dict)
    passes: Sequence[Pass | Draw | Step] = ()
    glsl_root: Roots | None = None
