"""Reflection of SPIR-V: bindings, numpy dtypes of blocks, workgroup size, specialization constants, accesses.

Blocks must be `layout(scalar)`. A vector of n components is a subarray (n,). A GLSL matrix, which is column-major, is
a subarray (columns, rows): a numpy matrix is stored transposed. A buffer reference is a u8, like a 64-bit integer.
SPIR-V has no bool in blocks; GLSL compilers put a uint there.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from solari_vk.base.errors import SolariError
from solari_vk.gpu.shaders import spirv_code as code
from solari_vk.gpu.shaders import spv
from solari_vk.gpu.shaders.module import Binding, Entry, Module, SpecConstant

__all__ = ["Binding", "Entry", "Module", "SpecConstant", "reflect"]

_TYPES = spv.TYPES - {spv.OP_TYPE_VOID, spv.OP_TYPE_FUNCTION, spv.OP_TYPE_RAY_QUERY}
_SPEC_CONSTANTS = (spv.OP_SPEC_CONSTANT_TRUE, spv.OP_SPEC_CONSTANT_FALSE, spv.OP_SPEC_CONSTANT)
_CONSTANTS = (spv.OP_CONSTANT_TRUE, spv.OP_CONSTANT_FALSE, spv.OP_CONSTANT, *_SPEC_CONSTANTS)
_TRUE = (spv.OP_CONSTANT_TRUE, spv.OP_SPEC_CONSTANT_TRUE)
_STORED_IMAGE = 2  # the operand "sampled" of an image type: it is read and written without a sampler
# Shader stages by their execution models, called as glslc calls the files.
_MODELS = {0: "vert", 1: "tesc", 2: "tese", 3: "geom", 4: "frag", 5: "comp", 5313: "rgen", 5314: "rint",
           5315: "rahit", 5316: "rchit", 5317: "rmiss"}  # fmt: skip
# SPIR-V's image formats, by their numbers
_IMAGE_FORMATS = (
    "", "R32G32B32A32_SFLOAT", "R16G16B16A16_SFLOAT", "R32_SFLOAT", "R8G8B8A8_UNORM", "R8G8B8A8_SNORM", "R32G32_SFLOAT",
    "R16G16_SFLOAT", "B10G11R11_UFLOAT_PACK32", "R16_SFLOAT", "R16G16B16A16_UNORM", "A2B10G10R10_UNORM_PACK32",
    "R16G16_UNORM", "R8G8_UNORM", "R16_UNORM", "R8_UNORM", "R16G16B16A16_SNORM", "R16G16_SNORM", "R8G8_SNORM",
    "R16_SNORM", "R8_SNORM", "R32G32B32A32_SINT", "R16G16B16A16_SINT", "R8G8B8A8_SINT", "R32_SINT", "R32G32_SINT",
    "R16G16_SINT", "R8G8_SINT", "R16_SINT", "R8_SINT", "R32G32B32A32_UINT", "R16G16B16A16_UINT", "R8G8B8A8_UINT",
    "R32_UINT", "A2B10G10R10_UINT_PACK32", "R32G32_UINT", "R16G16_UINT", "R8G8_UINT", "R16_UINT", "R8_UINT",
    "R64_UINT", "R64_SINT",
)  # fmt: skip


@lru_cache(maxsize=128)  # modules never change, and reading one takes 50 ms
def reflect(spirv: bytes, name: str = "shader", *, writes_by_address: bool = False) -> Module:
    """Read a module. Raises SolariError with `name` if it isn't valid SPIR-V, has a block without scalar layout, reads
    data of a shader record, or writes through a buffer reference without `writes_by_address`."""
    try:
        return _Reader(spirv, name).module(writes_by_address)
    except (KeyError, IndexError, ValueError, TypeError, OverflowError, RecursionError) as error:
        raise SolariError(f"{name}: the SPIR-V module is damaged or uses unsupported features ({error!r})") from error


class _Reader:
    def __init__(self, spirv: bytes, name: str) -> None:
        self.name = name
        self.spirv = spirv
        self.code = code.instructions(spirv, name)
        self.names: dict[int, str] = {}
        self.member_names: dict[tuple[int, int], str] = {}
        self.decorations: dict[tuple[int, int], tuple[int, ...]] = {}
        self.member_decorations: dict[tuple[int, int, int], tuple[int, ...]] = {}
        self.types: dict[int, code.Instruction] = {}
        self.constants: dict[int, code.Instruction] = {}
        self.variables: list[tuple[int, int, int]] = []
        self.entry_points: list[list[int]] = []
        self.modes: list[code.Instruction] = []
        for item in self.code:
            if item.op == spv.OP_FUNCTION:  # declarations come before all functions
                break
            self._collect(item)

    def _collect(self, item: code.Instruction) -> None:
        op, words = item
        match op:
            case spv.OP_NAME:
                self.names[words[0]] = spv.text(words[1:])
            case spv.OP_MEMBER_NAME:
                self.member_names[words[0], words[1]] = spv.text(words[2:])
            case spv.OP_DECORATE:
                self.decorations[words[0], words[1]] = tuple(words[2:])
            case spv.OP_MEMBER_DECORATE:
                self.member_decorations[words[0], words[1], words[2]] = tuple(words[3:])
            case spv.OP_VARIABLE:
                self.variables.append((words[1], words[0], words[2]))
            case spv.OP_ENTRY_POINT:
                self.entry_points.append(words)
            case spv.OP_EXECUTION_MODE | spv.OP_EXECUTION_MODE_ID:
                self.modes.append(item)
            case _ if op in _TYPES:
                self.types[words[0]] = item
            case _ if op in _CONSTANTS:
                self.constants[words[1]] = item

    def module(self, writes_by_address: bool) -> Module:
        bound = {
            variable: self._binding(variable, pointer, storage)
            for variable, pointer, storage in self.variables
            if storage in spv.RESOURCE_STORAGE
        }
        analysis = code.AccessAnalysis(self.code, self.name, writes_by_address)
        entries = {}
        # A module may have several entry points; each has accesses of its own.
        for words in self.entry_points:
            entry = spv.text(words[2:])
            found = analysis.effects(words[1])
            entries[entry] = Entry(
                entry,
                _MODELS.get(words[0], f"model {words[0]}"),
                *(frozenset(bound[variable].name for variable in part) for part in found),
            )
        if any(storage == spv.STORAGE_SHADER_RECORD for *_, storage in self.variables):
            raise SolariError(
                f"{self.name}: shaderRecordEXT: records of the shader binding table hold no data: read a buffer, for "
                "example at gl_InstanceCustomIndexEXT + gl_GeometryIndexEXT"
            )
        pushed = [pointer for _, pointer, storage in self.variables if storage == spv.STORAGE_PUSH_CONSTANT]
        return Module(
            self.name,
            self.spirv,
            {binding.name: binding for binding in bound.values()},
            {variable: binding.name for variable, binding in bound.items()},
            self._spec_constants(),
            entries,
            self._dtype(self.types[pushed[0]].words[2]) if pushed else None,
            self._sizes(),
        )

    # ---- bindings

    def _binding(self, variable: int, pointer: int, storage: int) -> Binding:
        target = self.types[pointer].words[2]
        count = 1
        if self.types[target].op in (spv.OP_TYPE_ARRAY, spv.OP_TYPE_RUNTIME_ARRAY):
            # An array of resources without a length is bindless: 0 stands for what the host decides.
            count = self._length(target) if self.types[target].op == spv.OP_TYPE_ARRAY else 0
            target = self.types[target].words[1]
        set_number = self.decorations.get((variable, spv.DECORATION_SET), (0,))[0]
        binding = self.decorations.get((variable, spv.DECORATION_BINDING), (0,))[0]
        name, target = self._named_block(variable, target)
        if not name:
            raise SolariError(
                f"{self.name}: the resource at set {set_number}, binding {binding} has no name: the module was stripped"
            )
        flags: dict[str, Any] = {
            "readonly": (variable, spv.DECORATION_NON_WRITABLE) in self.decorations,
            "writeonly": (variable, spv.DECORATION_NON_READABLE) in self.decorations,
        }
        op, words = self.types[target]
        if op == spv.OP_TYPE_STRUCT:
            flags["readonly"] |= self._have_all_members(target, spv.DECORATION_NON_WRITABLE)
            flags["writeonly"] |= self._have_all_members(target, spv.DECORATION_NON_READABLE)
            flags |= self._block(target, name)
            kind = "uniform_buffer" if storage == spv.STORAGE_UNIFORM else "storage_buffer"
        elif op == spv.OP_TYPE_IMAGE:
            stored = words[6] == _STORED_IMAGE
            kind = "storage_image" if stored else "sampled_image"
            flags["image_format"] = _IMAGE_FORMATS[words[7]] if stored else ""
        else:
            kind = {
                spv.OP_TYPE_SAMPLED_IMAGE: "combined_image_sampler",
                spv.OP_TYPE_SAMPLER: "sampler",
                spv.OP_TYPE_ACCELERATION_STRUCTURE: "acceleration_structure",
            }[op]
        return Binding(name, set_number, binding, kind, count, **flags)

    def _named_block(self, variable: int, target: int) -> tuple[str, int]:
        """What GLSL calls a resource, and its type: the name of the instance, or of the block."""
        name = self.names.get(variable)
        if name:
            return name, target
        op, words = self.types[target]
        if op == spv.OP_TYPE_STRUCT and len(words) == 2 and self.types[words[1]].op == op:
            # A block without an instance name that holds one struct: GLSL calls the struct by the member's name.
            return self.member_names[target, 0], words[1]
        return self.names.get(target, ""), target

    def _have_all_members(self, struct: int, decoration: int) -> bool:
        """Whether a struct has members, all with a decoration: `readonly` of a block is one of each member."""
        members = range(len(self.types[struct].words) - 1)
        return len(members) > 0 and all((struct, at, decoration) in self.member_decorations for at in members)

    def _block(self, struct: int, name: str) -> dict[str, Any]:
        members = self.types[struct].words[1:]
        last = self.types[members[-1]]
        if last.op != spv.OP_TYPE_RUNTIME_ARRAY:
            return {"dtype": self._dtype(struct, name)}
        offset = self.member_decorations[struct, len(members) - 1, spv.DECORATION_OFFSET][0]
        fixed = self._struct(struct, len(members) - 1, offset, name) if len(members) > 1 else None
        return {"dtype": fixed, "element": self._strided(members[-1], name), "element_offset": offset}

    # ---- types

    def _dtype(self, type_id: int, where: str = "") -> np.dtype[Any]:
        """The numpy type of a type inside a block; `where` is its path, for messages."""
        op, words = self.types[type_id]
        if op == spv.OP_TYPE_INT:
            return np.dtype(f"{'i' if words[2] else 'u'}{words[1] // 8}")
        if op == spv.OP_TYPE_FLOAT:
            return np.dtype(f"f{words[1] // 8}")
        if op in (spv.OP_TYPE_VECTOR, spv.OP_TYPE_MATRIX):
            return _repeated(self._dtype(words[1], where), words[2])
        if op == spv.OP_TYPE_ARRAY:
            return _repeated(self._strided(type_id, where), self._length(type_id))
        if op == spv.OP_TYPE_STRUCT:
            return self._struct(type_id, len(words) - 1, None, where)
        if op == spv.OP_TYPE_POINTER:
            return np.dtype("u8")
        raise SolariError(f"{self.name}: {where} has a type that no numpy array can hold")

    def _struct(self, struct: int, count: int, size: int | None, where: str) -> np.dtype[Any]:
        names: list[str] = []
        formats: list[np.dtype[Any]] = []
        offsets: list[int] = []
        for at, member in enumerate(self.types[struct].words[1 : count + 1]):
            names.append(self.member_names[struct, at])
            formats.append(self._dtype(member, f"{where}.{names[-1]}"))
            offsets.append(self.member_decorations[struct, at, spv.DECORATION_OFFSET][0])
            # A GLSL matrix is an array of columns: the stride must be a column's size, and row-major is another array.
            stride = self.member_decorations.get((struct, at, spv.DECORATION_MATRIX_STRIDE))
            row_major = (struct, at, spv.DECORATION_ROW_MAJOR) in self.member_decorations
            if stride is not None and (row_major or stride[0] != self._column_bytes(member)):
                raise SolariError(f"{self.name}: {where}.{names[-1]} must be column-major in a layout(scalar) block")
        # In scalar layout a struct ends after its last member, padded to the alignment of its largest scalar.
        end = max((offset + form.itemsize for offset, form in zip(offsets, formats, strict=True)), default=0)
        align = max((_alignment(form) for form in formats), default=1)
        return np.dtype(
            {"names": names, "formats": formats, "offsets": offsets, "itemsize": size or -(-end // align) * align}
        )

    def _column_bytes(self, type_id: int) -> int:
        while self.types[type_id].op == spv.OP_TYPE_ARRAY:
            type_id = self.types[type_id].words[1]
        return self._dtype(self.types[type_id].words[1]).itemsize

    def _strided(self, array: int, where: str) -> np.dtype[Any]:
        """The element type of an array, whose stride must be the element's size, as scalar layout guarantees."""
        element = self._dtype(self.types[array].words[1], where)
        stride = self.decorations.get((array, spv.DECORATION_ARRAY_STRIDE), (element.itemsize,))[0]
        if stride != element.itemsize:
            raise SolariError(
                f"{self.name}: elements of {where} are {stride} bytes apart but {element.itemsize} long: "
                "make it a layout(scalar) block"
            )
        return element

    def _length(self, array: int) -> int:
        return int(self._value(self.types[array].words[2]))

    # ---- constants and sizes

    def _value(self, constant: int) -> Any:
        op, words = self.constants[constant]
        if op not in (spv.OP_CONSTANT, spv.OP_SPEC_CONSTANT):
            return op in _TRUE
        value = np.array(words[2:], np.uint32).view(self._dtype(words[0]))[0]
        return value.item()

    def _spec_constants(self) -> dict[str, SpecConstant]:
        found = {}
        for constant, item in self.constants.items():
            spec_id = self.decorations.get((constant, spv.DECORATION_SPEC_ID))
            name = self.names.get(constant)
            if spec_id is not None and name:
                dtype = self._dtype(item.words[0]) if item.op == spv.OP_SPEC_CONSTANT else np.dtype("u4")
                found[name] = SpecConstant(spec_id[0], dtype, self._value(constant))
        return found

    def _sizes(self) -> tuple[tuple[int, int | None], ...]:
        for item in self.modes:
            mode = item.words[1]
            words = item.words[2:]
            if mode == spv.MODE_LOCAL_SIZE:
                return tuple((size, None) for size in words)
            if mode == spv.MODE_LOCAL_SIZE_ID:
                ids = [self.decorations.get((word, spv.DECORATION_SPEC_ID), (None,))[0] for word in words]
                return tuple((self._value(word), spec_id) for word, spec_id in zip(words, ids, strict=True))
        return ()


def _repeated(dtype: np.dtype[Any], count: int) -> np.dtype[Any]:
    """An array type; an array of arrays becomes one array with more dimensions."""
    return np.dtype((dtype.base, (count, *dtype.shape)))


def _alignment(dtype: np.dtype[Any]) -> int:
    """The size in bytes of the largest scalar in a type."""
    if dtype.subdtype is not None:
        return _alignment(dtype.base)
    return max(_alignment(form) for form, *_ in dtype.fields.values()) if dtype.fields else dtype.itemsize
