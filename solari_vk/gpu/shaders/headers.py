"""GLSL headers that Python generates, so that a constant which both sides know is written once, in Python.

A shader that has `#include "generated/settings.glsl"` gets the text that `solari_vk.settings.glsl_header()` returns;
`generated/passes/denoise.glsl` asks the module `solari_vk.passes.denoise`, and so on. The include itself names the
module: there is no list of them. Such a module must be importable without Vulkan, because wheels are built on machines
that have none.

`enumeration` and `constants` make the text of common headers.
"""

from __future__ import annotations

import importlib
import math
import re
from collections.abc import Iterable

from solari_vk.base.errors import CompilationError

FOLDER = "generated/"
_IDENTIFIER = re.compile(r"[A-Za-z_]\w*")


def is_generated(include: str) -> bool:
    """Whether an include's path names a module instead of a file."""
    return include.startswith(FOLDER)


def header_text(include: str, where: str) -> bytes:
    """The text of a generated header, with an include guard. `where` is the including file and line, for errors.

    Raises CompilationError when there is no such module or it has no glsl_header().
    """
    path = include.removeprefix(FOLDER).removesuffix(".glsl")
    name = "solari_vk." + path.replace("/", ".")
    try:
        module = importlib.import_module(name)
    except ModuleNotFoundError as error:
        # An import that fails inside the module is the module's own error, and says more.
        if error.name is None or not name.startswith(error.name):
            raise
        raise CompilationError(f'{where}: error: "{include}": there is no module {name}') from None
    make = getattr(module, "glsl_header", None)
    if make is None:
        raise CompilationError(f'{where}: error: "{include}": the module {name} has no function glsl_header()')
    guard = "GENERATED_" + re.sub(r"\W", "_", path).upper() + "_GLSL"
    return f"#ifndef {guard}\n#define {guard}\n{make()}\n#endif\n".encode()


def enumeration(prefix: str, names: Iterable[str]) -> str:
    """A line `const uint PREFIX_NAME = index;` for each name in order; characters that GLSL forbids become "_"."""
    lines = [constants(**{f"{prefix}_{re.sub(r'[^A-Za-z0-9]', '_', name)}".upper(): i}) for i, name in enumerate(names)]
    return "\n".join(lines)


def constants(**values: bool | int | float) -> str:
    """A line `const TYPE NAME = value;` for each value, exactly: bool, uint (int if negative) or float.

    Raises ValueError for a value that no GLSL constant can hold.
    """
    return "\n".join(_constant(name, value) for name, value in values.items())


def _constant(name: str, value: bool | int | float) -> str:
    if not _IDENTIFIER.fullmatch(name) or name.startswith("gl_"):
        raise ValueError(f"{name} is not a valid name of a GLSL constant")
    if isinstance(value, bool):
        return f"const bool {name} = {str(value).lower()};"
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ValueError(f"{name} is {value}, which GLSL has no literal for")
        return f"const float {name} = {value!r};"
    if not -(2**31) <= value < 2**32:
        raise ValueError(f"{name} is {value}, which has more than 32 bits")
    return f"const int {name} = {value};" if value < 0 else f"const uint {name} = {value}u;"
