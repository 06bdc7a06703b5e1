"""The one module that imports the `vulkan` package: its ffi, its constants (corrected), its functions (checked).

The package's Python wrappers free nested temporaries too early and are slow, so only its parsed header is used.
`struct` builds C structures that keep alive what they point to. `Functions` loads entry points once and turns
every negative VkResult into an exception. `VK_*` names, aliases included, are integers.
"""

from __future__ import annotations

import re
import weakref
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from solari_vk.base.errors import DeviceError
from solari_vk.gpu.device.rays import DRIVER

try:
    from vulkan import _vulkan as _package
except OSError as error:
    raise DeviceError(
        f"the Vulkan loader can't be opened ({error}): install it (Debian: apt-get install libvulkan1) "
        f"and a driver with {DRIVER}"
    ) from error

ffi: Any = _package.ffi
lib: Any = _package.lib
NULL: Any = ffi.NULL
CData = Any

# Enumerators come from `lib`, the parsed header. Of the package's Python constants, 492 aliases are None and 40
# values are wrong (extension offsets, signs of error codes), so they are used only for names that `lib` lacks.
_REPAIRED = {"VK_WHOLE_SIZE": 2**64 - 1}

_VENDOR_SUFFIX = re.compile(r"_(KHR|EXT|NV)$")


def __getattr__(name: str) -> int:
    """A Vulkan constant by its name, also by an alias with another suffix (KHR, EXT, NV or none)."""
    if not name.startswith("VK_"):
        raise AttributeError(name)
    base = _VENDOR_SUFFIX.sub("", name)
    for spelling in (name, base, base + "_KHR", base + "_EXT"):
        value: int | None = _REPAIRED.get(spelling, getattr(lib, spelling, getattr(_package, spelling, None)))
        if value is not None:
            globals()[name] = value
            return value
    raise AttributeError(f"{name} is not a Vulkan constant that the `vulkan` package knows")


def api_version(major: int, minor: int, patch: int = 0) -> int:
    """A version number in Vulkan's packed form."""
    return major << 22 | minor << 12 | patch


# ---- structures -------------------------------------------------------------------------------------

# cffi owns what it allocates only while its cdata lives. A structure with pointers needs the targets alive as
# long as itself, so each allocation here is held by the cdata that points to it.
_references: weakref.WeakKeyDictionary[CData, list[Any]] = weakref.WeakKeyDictionary()
_STRUCTURE_TYPES = {
    name.replace("_", "").removeprefix("VKSTRUCTURETYPE"): value
    for name, value in ffi.typeof("enum VkStructureType").relements.items()
}


def struct(type_name: str, **fields: Any) -> CData:
    """A pointer to a new C structure of a type such as "VkBufferCreateInfo".

    `sType` is filled in. Pointer fields take bytes or str (a C string), a list (a C array of what the field points
    to), a structure from this function, a numpy array, or any cdata. What they point to lives as long as the returned
    pointer. Value fields take numbers, dicts, lists, and structures from this function, which are copied.
    Raises TypeError for a field that the structure doesn't have.
    """
    pointer = ffi.new(type_name + "*")
    references = _fill(pointer, ffi.typeof(type_name), fields)
    _references[pointer] = references
    return pointer


def array(type_name: str, items: Sequence[Any]) -> CData:
    """A C array of structures from `struct`, handles, numbers or strings; it keeps alive what they point to."""
    # C has no arrays of length 0; the caller passes the count.
    block = ffi.new(f"{type_name}[]", max(len(items), 1))
    _references[block] = [_assign(block, i, ffi.typeof(type_name), item) for i, item in enumerate(items)]
    return block


def _fill(target: CData, ctype: Any, fields: Mapping[str, Any]) -> list[Any]:
    members = dict(ctype.fields)
    # VkBaseInStructure: what has sType and pNext must say what it is, or drivers ignore or misread the chain.
    if "sType" in members and "pNext" in members and "sType" not in fields:
        target.sType = _STRUCTURE_TYPES[ctype.cname.removeprefix("struct ").removeprefix("Vk").upper()]
    references = []
    for name, value in fields.items():
        if name not in members:
            raise TypeError(f"{ctype.cname} has no field {name}; it has {', '.join(members)}")
        references.append(_assign(target, name, members[name].type, value))
    return references


def _assign(target: CData, key: str | int, ctype: Any, value: Any) -> Any:
    """Assign a value to a field or an array element; returns what must be kept alive with the target."""
    put: Callable[[Any], None]
    if isinstance(key, str):
        put = lambda item: setattr(target, key, item)  # noqa: E731
    else:
        put = lambda item: target.__setitem__(key, item)  # noqa: E731
    if ctype.kind == "pointer":
        made = _pointee(ctype, value)
        put(made)
        return made if made is value else (made, value)
    if ctype.kind in ("struct", "union") and isinstance(value, Mapping):
        made = ffi.new(ctype.cname + "*")
        references = _fill(made, ctype, value)
        put(made[0])
        return references
    if ctype.kind in ("struct", "union") and isinstance(value, ffi.CData) and ffi.typeof(value).kind == "pointer":
        put(value[0])
        return _references.get(value, value)
    put(value)
    return None


def _pointee(ctype: Any, value: Any) -> Any:
    """The cdata for a pointer field that is given as cdata, None, str, bytes, a list or a numpy array."""
    if value is None:
        return NULL
    if isinstance(value, ffi.CData):
        return value
    if isinstance(value, str):
        return ffi.new("char[]", value.encode())
    # A C string ends with a zero byte, which ffi.new adds and from_buffer doesn't.
    if isinstance(value, bytes) and ctype.item.kind == "primitive" and ctype.item.cname == "char":
        return ffi.new("char[]", value)
    if isinstance(value, (list, tuple)):
        if not value:
            return NULL
        return array(ctype.item.cname, value)
    return ffi.from_buffer(value) if ctype.item.kind == "void" else ffi.cast(ctype, ffi.from_buffer(value))


# ---- functions --------------------------------------------------------------------------------------

_RESULT_NAMES = ffi.typeof("enum VkResult").elements
_REMEDY = {
    "VK_ERROR_DEVICE_LOST": "the device was lost (a dispatch ran too long, or the driver failed): make a new Device",
    "VK_ERROR_OUT_OF_DEVICE_MEMORY": "the device is out of memory: use a smaller scene or picture",
    "VK_ERROR_OUT_OF_HOST_MEMORY": "the host is out of memory: use a smaller scene or picture",
    "VK_ERROR_INCOMPATIBLE_DRIVER": f"no Vulkan driver is installed: install one with {DRIVER}",
    "VK_ERROR_LAYER_NOT_PRESENT": "install the Khronos validation layer (Debian: vulkan-validationlayers)",
}


def check(result: int, function: str) -> int:
    """Return a VkResult that isn't an error; otherwise raise DeviceError naming the function and a remedy."""
    if result < 0:
        name = _RESULT_NAMES.get(result, f"VkResult {result}")
        remedy = _REMEDY.get(name)
        raise DeviceError(f"{function}: {name}" + (f": {remedy}" if remedy else ""))
    return result


class Functions:
    """Vulkan functions by name, each looked up once; those that return a VkResult are checked.

    `get_address(name)` returns a function pointer, as vkGetDeviceProcAddr does. The first use of a function that the
    driver doesn't have raises DeviceError. `on_error(result)` is called with every error before it is raised, so that
    the owner can record a lost device.
    """

    def __init__(self, get_address: Callable[[bytes], CData], on_error: Callable[[int], None] | None = None) -> None:
        self._get_address = get_address
        self._on_error = on_error

    def __getattr__(self, name: str) -> Callable[..., Any]:
        if not name.startswith("vk"):
            raise AttributeError(name)
        pointer = self._get_address(name.encode())
        if pointer == NULL:
            raise DeviceError(f"the driver has no function {name}")
        function = ffi.cast("PFN_" + name, pointer)
        result = ffi.typeof(function).result
        if result.cname in ("enum VkResult", "VkResult"):
            function = _checked(function, name, self._on_error)
        setattr(self, name, function)
        loaded: Callable[..., Any] = function
        return loaded


def _checked(function: Any, name: str, on_error: Callable[[int], None] | None) -> Callable[..., int]:
    def call(*arguments: Any) -> int:
        result: int = function(*arguments)
        if result >= 0:
            return result
        if on_error is not None:
            on_error(result)
        return check(result, name)

    return call


def instance_functions(instance: CData) -> Functions:
    """Functions of one instance; with NULL those that need none, such as vkCreateInstance."""
    return Functions(lambda name: lib.vkGetInstanceProcAddr(instance, name))


def device_functions(device: CData, on_error: Callable[[int], None] | None = None) -> Functions:
    """Functions of one device, called without the loader's dispatch."""
    return Functions(lambda name: lib.vkGetDeviceProcAddr(device, name), on_error)


def enumerate_items(function: Callable[..., Any], type_name: str, *arguments: Any) -> list[CData]:
    """All items that an enumerating function gives: one call for the count, one for the items."""
    count = ffi.new("uint32_t*")
    function(*arguments, count, NULL)
    items = ffi.new(f"{type_name}[]", max(count[0], 1))
    if ffi.typeof(type_name).kind == "struct" and "sType" in dict(ffi.typeof(type_name).fields):
        for i in range(count[0]):
            _fill(items[i], ffi.typeof(type_name), {})
    # The number may have changed between the calls; the second call writes at most `count` items.
    function(*arguments, count, items)
    found = [items[i] for i in range(count[0])]
    for item in found:  # an element is a view of the array, which must live as long
        if ffi.typeof(item).kind == "struct":
            _references[item] = [items]
    return found
