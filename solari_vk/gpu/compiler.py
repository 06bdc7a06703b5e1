"""GLSL to SPIR-V through libshaderc, with pyshaderc's calls, exact error positions, a cache, and shipped modules.

`set_include_paths`, `compile_into_spirv`, `compile_file_into_spirv` and `CompilationError` are those of
pyshaderc 1.1. `compile_shader` is what passes use: SPIR-V that came with the package when the sources are
unchanged, else the cache on disk, else the compiler. All modules target Vulkan 1.3 (SPIR-V 1.6).

shaderc's optimizer strips names unless debug information is asked for, and reflection needs the names: so
debug information is always on, and what else it adds (line numbers, source text) is removed afterwards.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from cffi import FFI

from solari_vk.errors import SolariError
from solari_vk.gpu import shader_cache

__all__ = [
    "CompilationError", "compile_file_into_spirv", "compile_into_spirv", "compile_shader", "glsl_root",
    "set_include_paths",
]  # fmt: skip

_ffi = FFI()
_ffi.cdef("""
typedef struct shaderc_include_result {
    const char* source_name; size_t source_name_length; const char* content; size_t content_length; void* user_data;
} shaderc_include_result;
typedef shaderc_include_result* (*resolve)(void*, const char* requested, int type, const char* requesting, size_t depth);
typedef void (*release)(void*, shaderc_include_result*);
void* shaderc_compiler_initialize(void);
void shaderc_compiler_release(void*);
void* shaderc_compile_options_initialize(void);
void shaderc_compile_options_release(void*);
void shaderc_compile_options_set_source_language(void*, int);
void shaderc_compile_options_set_generate_debug_info(void*);
void shaderc_compile_options_set_optimization_level(void*, int);
void shaderc_compile_options_set_target_env(void*, int, uint32_t);
void shaderc_compile_options_set_target_spirv(void*, int);
void shaderc_compile_options_set_suppress_warnings(void*);
void shaderc_compile_options_set_warnings_as_errors(void*);
void shaderc_compile_options_set_include_callbacks(void*, resolve, release, void*);
void* shaderc_compile_into_spv(void*, const char*, size_t, int kind, const char* name, const char* entry, void*);
void shaderc_result_release(void*);
size_t shaderc_result_get_length(void*);
const char* shaderc_result_get_bytes(void*);
const char* shaderc_result_get_error_message(void*);
int shaderc_result_get_compilation_status(void*);
typedef struct { const char* file; void* base; const char* symbol; void* address; } Dl_info;
int dladdr(const void*, Dl_info*);
""")

_STAGES = {"vert": 0, "frag": 1, "comp": 2, "geom": 3, "tesc": 4, "tese": 5, "rgen": 14, "rahit": 15, "rchit": 16,
           "rmiss": 17, "rint": 18}  # fmt: skip
_LANGUAGES = {"glsl": 0, "hlsl": 1}
_OPTIMIZATIONS = {"zero": 0, "size": 1, "performance": 2}
_STANDARD_INCLUDE = 1
_VULKAN_1_3 = 1 << 22 | 3 << 12
_SPIRV_1_6 = 0x010600
_NAMES = {
    "linux": ("libshaderc.so.1", "libshaderc_shared.so.1", "libshaderc_shared.so"),
    "darwin": ("libshaderc.1.dylib", "libshaderc_shared.1.dylib", "libshaderc_shared.dylib",
               "/opt/homebrew/lib/libshaderc_shared.1.dylib", "/usr/local/lib/libshaderc_shared.1.dylib"),
    "win32": ("shaderc_shared.dll", "libshaderc_shared.dll"),
}  # fmt: skip

_include_paths: list[str] = []


class CompilationError(SolariError):
    """A shader doesn't compile; the message has file:line of the file that holds the fault, and that line."""


def glsl_root() -> Path:
    """The folder of the package's GLSL: inside the installed package, or beside it in a working copy."""
    installed = Path(__file__).resolve().parents[1] / "glsl"
    return installed if installed.is_dir() else Path(__file__).resolve().parents[2] / "glsl"


# ---- libshaderc -------------------------------------------------------------------------------------


@cache
def _library() -> Any:
    """libshaderc, or SolariError with the remedy. SOLARI_VK_SHADERC names the file of another build."""
    named = os.environ.get("SOLARI_VK_SHADERC")
    candidates = [named] if named else list(_NAMES.get(sys.platform, _NAMES["linux"]))
    if "VULKAN_SDK" in os.environ and not named:
        folder = Path(os.environ["VULKAN_SDK"])
        candidates += [str(folder / part / Path(name).name) for part in ("lib", "Bin") for name in list(candidates)]
    for name in candidates:
        try:
            return _ffi.dlopen(name)
        except OSError:
            continue
    raise SolariError(
        f"no GLSL compiler: none of {', '.join(candidates)} can be opened. Install libshaderc (Debian: apt-get install "
        "libshaderc1; macOS: brew install shaderc; Windows: the Vulkan SDK), or name the library's file in "
        "SOLARI_VK_SHADERC. Without it only unchanged shaders that were shipped compiled can run"
    )


@cache
def compiler_version() -> str:
    """What tells this libshaderc from another one: it has no version call, so its file, size and time stand in."""
    library = _library()
    try:
        info = _ffi.new("Dl_info*")
        _ffi.dlopen(None).dladdr(_ffi.cast("void*", library.shaderc_compiler_initialize), info)
        file = Path(os.fsdecode(_ffi.string(info.file))).resolve()
        status = file.stat()
        return f"{file} {status.st_size} {status.st_mtime_ns}"
    except (OSError, AttributeError, TypeError):  # Windows has no dladdr
        return str(library)


def set_include_paths(paths: Sequence[str | os.PathLike[str]]) -> None:
    """Set the folders in which includes of `compile_into_spirv` and `compile_file_into_spirv` are looked up."""
    _include_paths[:] = [os.fspath(path) for path in paths]


def compile_file_into_spirv(
    filepath: str | os.PathLike[str], stage: str, optimization: str = "size", warnings_as_errors: bool = False
) -> bytes:
    """SPIR-V of a GLSL file; arguments and errors as for `compile_into_spirv`."""
    try:
        raw = Path(filepath).read_bytes()
    except OSError as error:
        raise SolariError(f"the shader {os.fspath(filepath)} can't be read: {error.strerror}") from error
    return compile_into_spirv(raw, stage, filepath, optimization=optimization, warnings_as_errors=warnings_as_errors)


def compile_into_spirv(
    raw: bytes | str,
    stage: str,
    filepath: str | os.PathLike[str],
    language: str = "glsl",
    optimization: str = "size",
    suppress_warnings: bool = False,
    warnings_as_errors: bool = False,
) -> bytes:
    """SPIR-V of source text, names kept.

    `stage` is vert, tesc, tese, geom, frag, comp, or a ray tracing stage such as rgen; `filepath` is what
    errors show and what `#include "..."` starts from before the include paths; `optimization` is zero, size or
    performance. Raises CompilationError; SolariError for an unknown argument or when libshaderc is missing.
    """
    for value, known, what in (
        (stage, _STAGES, "stage"), (language, _LANGUAGES, "language"), (optimization, _OPTIMIZATIONS, "optimization"),
    ):  # fmt: skip
        if value not in known:
            raise SolariError(f"unknown {what} {value!r}: take one of {', '.join(known)}")
    library = _library()
    source = raw.encode() if isinstance(raw, str) else bytes(raw)
    kept: dict[Any, Any] = {}

    @_ffi.callback("resolve")  # type: ignore[untyped-decorator]
    def resolve(_data: Any, requested: Any, kind: int, requesting: Any, _depth: int) -> Any:
        name, content = _include(os.fsdecode(_ffi.string(requested)), kind, os.fsdecode(_ffi.string(requesting)))
        texts = _ffi.new("char[]", os.fsencode(name)), _ffi.new("char[]", content)
        result = _ffi.new("shaderc_include_result*", (texts[0], len(texts[0]) - 1, texts[1], len(content), _ffi.NULL))
        kept[result] = texts
        return result

    @_ffi.callback("release")  # type: ignore[untyped-decorator]
    def release(_data: Any, result: Any) -> None:
        kept.pop(result, None)

    compiler, options = library.shaderc_compiler_initialize(), library.shaderc_compile_options_initialize()
    result = _ffi.NULL
    try:
        library.shaderc_compile_options_set_source_language(options, _LANGUAGES[language])
        library.shaderc_compile_options_set_optimization_level(options, _OPTIMIZATIONS[optimization])
        library.shaderc_compile_options_set_generate_debug_info(options)
        library.shaderc_compile_options_set_target_env(options, 0, _VULKAN_1_3)
        library.shaderc_compile_options_set_target_spirv(options, _SPIRV_1_6)
        library.shaderc_compile_options_set_include_callbacks(options, resolve, release, _ffi.NULL)
        if suppress_warnings:
            library.shaderc_compile_options_set_suppress_warnings(options)
        if warnings_as_errors:
            library.shaderc_compile_options_set_warnings_as_errors(options)
        result = library.shaderc_compile_into_spv(
            compiler, source, len(source), _STAGES[stage], os.fsencode(filepath), b"main", options
        )
        if library.shaderc_result_get_compilation_status(result) != 0:
            log = _ffi.string(library.shaderc_result_get_error_message(result)).decode(errors="replace")
            raise CompilationError(_with_source_lines(log, os.fspath(filepath), source))
        size = library.shaderc_result_get_length(result)
        return _without_lines(bytes(_ffi.buffer(library.shaderc_result_get_bytes(result), size)))
    finally:
        if result != _ffi.NULL:
            library.shaderc_result_release(result)
        library.shaderc_compile_options_release(options)
        library.shaderc_compiler_release(compiler)


def _include(requested: str, kind: int, requesting: str) -> tuple[str, bytes]:
    """Name and text of an included file; an empty name makes shaderc report the text as the error."""
    beside = [] if kind == _STANDARD_INCLUDE else [os.path.dirname(requesting)]
    for folder in (*beside, *_include_paths):
        path = os.path.join(folder, requested)
        if os.path.isfile(path):
            try:
                return path, Path(path).read_bytes()
            except OSError as error:  # must not escape into C
                return "", f"{path} can't be read: {error.strerror}".encode()
    return "", f"{requested} is not found in {', '.join((*beside, *_include_paths)) or 'any include path'}".encode()


_POSITION = re.compile(r"^(?P<file>.+?):(?P<line>\d+): (?:error|warning): ")


def _with_source_lines(log: str, filepath: str, source: bytes) -> str:
    """shaderc's log with the line of source that each message is about below it."""
    shown = []
    for message in log.strip().splitlines():
        shown.append(message)
        found = _POSITION.match(message)
        if found is None:
            continue
        try:
            text = source if found["file"] == filepath else Path(found["file"]).read_bytes()
        except OSError:
            continue
        lines = text.decode(errors="replace").splitlines()
        # the text of a shader with a header has more lines than its file: the file's numbers count
        if found["file"] == filepath and os.path.isfile(filepath):
            lines = Path(filepath).read_text(errors="replace").splitlines()
        if int(found["line"]) <= len(lines):
            shown.append("    " + lines[int(found["line"]) - 1].strip())
    return "\n".join(shown) or "the compiler failed without a message"


_OP_STRING, _OP_SOURCE, _OP_LINE, _OP_NO_LINE, _OP_MODULE_PROCESSED, _OP_SOURCE_CONTINUED = 7, 3, 8, 317, 330, 2


def _without_lines(spirv: bytes) -> bytes:
    """The module without line numbers, source text and file names, so that paths don't get into what is shipped."""
    words = np.frombuffer(spirv, np.uint32)
    pieces, position = [words[:5]], 5
    dropped = {_OP_STRING, _OP_SOURCE, _OP_LINE, _OP_NO_LINE, _OP_MODULE_PROCESSED, _OP_SOURCE_CONTINUED}
    while position < len(words):
        first = int(words[position])
        if first & 0xFFFF not in dropped:
            pieces.append(words[position : position + (first >> 16)])
        position += first >> 16
    return np.concatenate(pieces).tobytes()


# ---- the package's own shaders ----------------------------------------------------------------------

_OPTIMIZATION = "performance"
_DIRECTIVE = re.compile(r"^\s*#\s*(version|extension)\b")


def compile_shader(path: str, *, header: str = "", root: str | os.PathLike[str] | None = None) -> bytes:
    """SPIR-V of the shader at `path` below the GLSL root, whose suffix names the stage ("passes/x/trace.comp").

    `header` is put after the #version and #extension lines: what makes a variant. Includes start at the root
    (`root`, default `glsl_root()`). Raises CompilationError; SolariError when there is no such file, or no compiler
    and no shipped module for exactly these sources.
    """
    base = Path(root) if root is not None else glsl_root()
    file = base / path
    if not file.is_file():
        raise SolariError(f"there is no shader {path} in {base}")
    options = f"{_OPTIMIZATION} {_VULKAN_1_3:x} {_SPIRV_1_6:x}"
    source_key = shader_cache.source_key(base, path, header, options)
    shipped = shader_cache.shipped(base, source_key)
    if shipped is not None:
        return shipped
    return shader_cache.cached(source_key, compiler_version(), lambda: _compile(base, file, header))


def _compile(base: Path, file: Path, header: str) -> bytes:
    source = _with_header(file.read_text(encoding="utf-8"), header, file)
    before = list(_include_paths)
    set_include_paths([base])
    try:
        return compile_into_spirv(source, file.suffix.lstrip("."), file, optimization=_OPTIMIZATION)
    finally:
        set_include_paths(before)


def _with_header(source: str, header: str, file: Path) -> str:
    if not header:
        return source
    lines = source.splitlines(keepends=True)
    at = max((number for number, line in enumerate(lines, 1) if _DIRECTIVE.match(line)), default=0)
    name = file.as_posix()
    return "".join((*lines[:at], f'#line 1 "{name} (header)"\n{header}\n#line {at + 1} "{name}"\n', *lines[at:]))


def build_all(root: str | os.PathLike[str], out: str | os.PathLike[str]) -> list[str]:
    """Compile every entry point below a GLSL root for shipping: `out` gets the modules and their index.

    Returns the paths below `root`. `out` is the root itself (modules beside sources) or a copy of it made later.
    """
    base, made = Path(root), {}
    for file in sorted(path for path in base.rglob("*") if path.suffix.lstrip(".") in _STAGES):
        made[file.relative_to(base).as_posix()] = compile_shader(file.relative_to(base).as_posix(), root=base)
    options = f"{_OPTIMIZATION} {_VULKAN_1_3:x} {_SPIRV_1_6:x}"
    shader_cache.ship(base, Path(out), made, options)
    return list(made)


if __name__ == "__main__":
    if len(sys.argv) != 4 or sys.argv[1] != "--build":
        sys.exit("usage: python -m solari_vk.gpu.compiler --build GLSL_ROOT OUT_DIR")
    print("\n".join(build_all(sys.argv[2], sys.argv[3])))
