"""Compiles Slang to SPIR-V, by the compiler's library in the package slangpy, which the extra `slang` installs.

Slang reads GLSL too, so a pass in Slang includes the package's own files: `#include "scene/trace.glsl"`. For a few
things of theirs it has other words, which `_in_slang` puts there: buffer references, blocks of one struct, and
constants that are computed of specialization constants.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import re
import sys
import tempfile
import threading
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from solari_vk.base import disk_cache
from solari_vk.base.errors import CompilationError, SolariError
from solari_vk.base.files import read_regular
from solari_vk.gpu.shaders.compiler import constant_ids
from solari_vk.gpu.shaders.shader_cache import Sources, cache_entry
from solari_vk.gpu.shaders.shaderc import identity

INSTALL = "pip install 'solari-vk[slang]'"
_OPTIONS = (
    "-target", "spirv", "-profile", "sm_6_5", "-capability", "spirv_1_5", "-fvk-use-scalar-layout", "-allow-glsl",
    "-O1", "-warnings-disable", "39001",  # bindings of one number: they are numbered later, by their names
)  # fmt: skip
_LIBRARIES = {"darwin": "libslang-compiler*.dylib", "win32": "slang-compiler*.dll"}
_SLANG = 1  # SLANG_SOURCE_LANGUAGE_SLANG
_LANGUAGE = 2025  # SLANG_LANGUAGE_VERSION_2025
_POINTER, _TEXT, _INT, _SIZE = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, ctypes.c_size_t
_FUNCTIONS: dict[str, tuple[Any, list[Any]]] = {
    "slang_createGlobalSession2": (_INT, [_POINTER, ctypes.POINTER(_POINTER)]),
    "spCreateCompileRequest": (_POINTER, [_POINTER]),
    "spProcessCommandLineArguments": (_INT, [_POINTER, ctypes.POINTER(_TEXT), _INT]),
    "spAddTranslationUnit": (_INT, [_POINTER, _INT, _TEXT]),
    "spAddTranslationUnitSourceString": (None, [_POINTER, _INT, _TEXT, _TEXT]),
    "spCompile": (_INT, [_POINTER]),
    "spGetDiagnosticOutput": (_TEXT, [_POINTER]),
    "spGetCompileRequestCode": (_POINTER, [_POINTER, ctypes.POINTER(_SIZE)]),
    "spDestroyCompileRequest": (None, [_POINTER]),
}
_compiling = threading.Lock()  # a session serves one thread at a time


class _GlobalSession(ctypes.Structure):
    """SlangGlobalSessionDesc of slang.h."""

    _fields_ = (
        ("size", ctypes.c_uint32),
        ("version", ctypes.c_uint32),
        ("language", ctypes.c_uint32),
        ("enables_glsl", ctypes.c_bool),
        ("reserved", ctypes.c_uint32 * 16),
    )


def library_file() -> Path | None:
    """The compiler's library, None without the package. SOLARI_VK_SLANG names the file of another build."""
    named = os.environ.get("SOLARI_VK_SLANG")
    if named:
        return Path(named)
    found = importlib.util.find_spec("slangpy")
    folders = found.submodule_search_locations if found else None
    pattern = _LIBRARIES.get(sys.platform, "libslang-compiler.so*")
    return next((file for folder in folders or () for file in sorted(Path(folder).glob(pattern))), None)


@cache
def _library(file: Path) -> tuple[Any, Any]:
    """The library and a session, which takes half a second to make."""
    try:
        loaded = ctypes.CDLL(os.fspath(file))
        for name, (returns, takes) in _FUNCTIONS.items():
            function = getattr(loaded, name)
            function.restype, function.argtypes = returns, takes
    except (OSError, AttributeError) as error:
        raise SolariError(f"the Slang compiler {file} can't be loaded ({error}): {INSTALL} installs another") from None
    wanted = _GlobalSession(ctypes.sizeof(_GlobalSession), 0, _LANGUAGE, True)
    session = _POINTER()
    if loaded.slang_createGlobalSession2(ctypes.byref(wanted), ctypes.byref(session)) < 0:
        raise SolariError(f"the Slang compiler {file} doesn't start: {INSTALL} installs another")
    return loaded, session


def compile_slang(sources: Sources, path: str, header: str, macros: Sequence[str]) -> bytes:
    """The SPIR-V of the Slang file at `path` below the sources' roots, with some macros and a header before its text.

    Raises CompilationError, and SolariError without the compiler. What was compiled before is in the cache on disk.
    """
    file = sources.find(path)
    if file is None:
        raise SolariError(f"there is no shader {path} in {', '.join(map(str, sources.roots))}")
    library = library_file()
    if library is None:
        raise SolariError(f"{file}: Slang needs its compiler: {INSTALL}")
    try:
        entry = cache_entry(sources.key(path, header, " ".join((*_OPTIONS, *macros))), identity(os.fspath(library)))
    except OSError as error:
        raise SolariError(f"the Slang compiler {library} can't be read: {error.strerror}") from None
    spirv = disk_cache.load(entry)
    if spirv is None:
        with _compiling:
            spirv = _compile(_library(library), sources, path, file, header, macros)
        disk_cache.store(entry, spirv)
    return spirv


def _compile(
    compiler: tuple[Any, Any], sources: Sources, path: str, file: Path, header: str, macros: Sequence[str]
) -> bytes:
    loaded, session = compiler
    text = read_regular(file, f"{file}").decode("utf-8", "replace")
    if header:
        text = f'#line 1 "{file.as_posix()} (header)"\n{header}\n#line 1 "{file.as_posix()}"\n{text}'
    included = sources.closure(path, header=header)
    defined = {**dict.fromkeys(macros, 1), **constant_ids(included.values())}
    with tempfile.TemporaryDirectory() as folder:
        # Files that aren't Slang are included as they are in `folder`; those with absolute paths, where they are.
        texts = {name: text for name, text in _in_slang(included).items() if not Path(name).anchor}
        # So deep in it that paths above the sources' root, which begin with "..", stay in it.
        root = os.path.join(folder, *["root"] * max((Path(name).parts.count("..") for name in texts), default=0))
        for name, content in texts.items():
            target = Path(os.path.normpath(os.path.join(root, name)))
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(content)
        search = [root, *map(os.fspath, sources.roots)]
        arguments = [*_OPTIONS, *(f"-D{name}={value}" for name, value in defined.items())]
        arguments += [word for place in search for word in ("-I", place)]
        request = loaded.spCreateCompileRequest(session)
        try:
            given = (_TEXT * len(arguments))(*map(os.fsencode, arguments))
            done = loaded.spProcessCommandLineArguments(request, given, len(arguments))
            unit = loaded.spAddTranslationUnit(request, _SLANG, b"pass")
            loaded.spAddTranslationUnitSourceString(request, unit, os.fsencode(file), text.encode())
            if done >= 0:
                done = loaded.spCompile(request)
            length = _SIZE()
            made = loaded.spGetCompileRequestCode(request, ctypes.byref(length)) if done >= 0 else None
            if not made:
                log = (loaded.spGetDiagnosticOutput(request) or b"").decode("utf-8", "replace")
                log = _readable(log, file, folder, root, sources)
                raise CompilationError(log or f"{file}: error: Slang made no code of it")
            return ctypes.string_at(made, length.value)
        finally:
            loaded.spDestroyCompileRequest(request)


# ---- errors ------------------------------------------------------------------------------------------

_MESSAGE = re.compile(r"^(?:fatal )?(error|warning)\[(\w+)\]: (.*)(?:\n +--> (.+):(\d+):\d+)?$", re.MULTILINE)
_PART = re.compile(r"^(?=note\b|.+:\d+: (?:error|warning): )", re.MULTILINE)
_NO_ENTRY_POINT = "E57004"


def _readable(log: str, file: Path, folder: str, root: str, sources: Sources) -> str:
    """Slang's messages, each with file and line in front as those of GLSL have them; warnings only beside errors.
    root: in the temporary folder, what paths of files that aren't Slang begin at."""

    def in_front(found: re.Match[str]) -> str:
        kind, code, text, place, line = found.groups()
        if code == _NO_ENTRY_POINT:
            text = 'there is no entry point: [shader("compute")] marks the function that runs'
        if place is None:
            return f"{file}: {kind}: {text} ({code})"
        name = Path(os.path.relpath(place, root)).as_posix() if place.startswith(folder) else ""
        known = sources.find(name) if name else Path(place)
        return f"{known or name}:{line}: {kind}: {text} ({code})"

    parts = _PART.split(_MESSAGE.sub(in_front, log))
    kept = [part for part in parts if not part.startswith("note")]  # which list what else could be meant
    return "\n".join(line for part in kept for line in part.splitlines() if line.strip(" |-'"))


# ---- GLSL as Slang reads it --------------------------------------------------------------------------

_REFERENCE = re.compile(rb"^layout\(buffer_reference\b[^)]*\)[\w ]*\bbuffer (\w+) \{ (\w+) at\[\]; \};", re.MULTILINE)
# A block of one struct, which GLSL calls by the struct.
_BLOCK = re.compile(rb"^layout\(set = (\d), scalar\) uniform \w+ \{ (\w+) (\w+); \};", re.MULTILINE)
_BUFFER = rb"[[vk::binding(0, \1)]] ConstantBuffer<\2> \3;"
# An address, as long as in GLSL, with what GLSL does with it: elements, and a conversion to two words.
_ADDRESS = (
    rb"enum \1 : uint64_t { null_\1 = 0 }; "
    rb"extension \1 { property Ptr<\2> at { get { return Ptr<\2>((uint64_t)this); } } } "
    rb"extension vector<uint, 2> { "
    rb"__init(\1 from) { uint64_t a = (uint64_t)from; this = uint2(uint(a), uint(a >> 32)); } }"
)
_CONSTANT = re.compile(rb"^const \w+ (\w+) = ([^;\n]+);", re.MULTILINE)
_SPECIALIZATION = re.compile(rb"\bconstant_id\s*=[^;]*?\bconst\s+\w+\s+(\w+)")
_WORD = re.compile(rb"\w+")


def _in_slang(texts: Mapping[str, bytes]) -> dict[str, bytes]:
    """The texts of files that aren't Slang, by their paths; lines keep their numbers."""
    variable = {name for text in texts.values() for name in _SPECIALIZATION.findall(text)}

    def as_macro(found: re.Match[bytes]) -> bytes:
        if variable.isdisjoint(_WORD.findall(found[2])):
            return found[0]
        variable.add(found[1])
        return b"#define %s (%s)" % (found[1], found[2])

    return {
        name: _CONSTANT.sub(as_macro, _REFERENCE.sub(_ADDRESS, _BLOCK.sub(_BUFFER, text)))
        for name, text in texts.items()
        if not name.endswith(".slang") and text != Sources.MISSING
    }


def macros_for(features: bool, lacking: Iterable[str]) -> list[str]:
    """The macros of GLSL for scenes with or without features, and for what a device lacks."""
    return [*lacking] if features else ["WITHOUT_FEATURES", *lacking]
