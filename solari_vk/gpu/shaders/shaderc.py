"""Two methods of running shaderc: its library through cffi, or its command `glslc` where the library can't be loaded.

Debian 12's libshaderc.so.1 can't be loaded: it leaves symbols of glslang and SPIRV-Tools undefined and names no
library that defines them. Both methods run the same compiler and give the same modules.
"""

from __future__ import annotations

import itertools
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from solari_vk.base.errors import SolariError

VULKAN_1_3 = 1 << 22 | 3 << 12
SPIRV_1_6 = 0x010600
STAGES = {"vert": 0, "frag": 1, "comp": 2, "geom": 3, "tesc": 4, "tese": 5, "rgen": 14, "rahit": 15, "rchit": 16,
          "rmiss": 17, "rint": 18}  # fmt: skip
LANGUAGES = {"glsl": 0, "hlsl": 1}
OPTIMIZATIONS = {"zero": 0, "size": 1, "performance": 2}
_STANDARD_INCLUDE = 1
DEEPEST_INCLUDE, MOST_INCLUDES = 200, 20_000
LONGEST = 600.0  # seconds of the command glslc, which has no such limits
ENDLESS = "there are too many includes, or a file includes itself"
_NAMES = {
    "linux": ("libshaderc.so.1", "libshaderc_shared.so.1", "libshaderc_shared.so"),
    "darwin": (
        "libshaderc.1.dylib",
        "libshaderc_shared.1.dylib",
        "libshaderc_shared.dylib",
        "/opt/homebrew/lib/libshaderc_shared.1.dylib",
        "/usr/local/lib/libshaderc_shared.1.dylib",
    ),
    "win32": ("shaderc_shared.dll", "libshaderc_shared.dll"),
}

_declaring = threading.Lock()
_DECLARATIONS = """
typedef struct shaderc_include_result {
    const char* source_name; size_t source_name_length; const char* content; size_t content_length; void* user_data;
} shaderc_include_result;
typedef shaderc_include_result* (*resolve)(void*, const char* wanted, int type, const char* wanting, size_t depth);
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
void shaderc_compile_options_set_auto_bind_uniforms(void*, _Bool);
void shaderc_compile_options_add_macro_definition(void*, const char*, size_t, const char*, size_t);
void shaderc_compile_options_set_include_callbacks(void*, resolve, release, void*);
void* shaderc_compile_into_spv(void*, const char*, size_t, int kind, const char* name, const char* entry, void*);
void shaderc_result_release(void*);
size_t shaderc_result_get_length(void*);
const char* shaderc_result_get_bytes(void*);
const char* shaderc_result_get_error_message(void*);
int shaderc_result_get_compilation_status(void*);
typedef struct { const char* file; void* base; const char* symbol; void* address; } Dl_info;
int dladdr(const void*, Dl_info*);
"""


class Failure(Exception):
    """shaderc refused the source; the text is its log."""


@cache
def _ffi() -> Any:
    """A cffi.FFI. cffi's parser takes 20 ms to import, and installed packages need no compiler."""
    from cffi import FFI

    return FFI()


@cache
def library() -> Any:
    """libshaderc, or None if it can't be loaded. SOLARI_VK_SHADERC names the file of another build."""
    for name in _library_names():
        try:
            found = _ffi().dlopen(name)
        except OSError as error:
            if "SOLARI_VK_SHADERC" in os.environ:
                why = str(error).split(". ")[0]
                raise SolariError(f"SOLARI_VK_SHADERC names {name}, which can't be loaded ({why})") from None
            continue
        with _declaring:  # `cache` lets several threads in
            _declare()
        return found
    return None


@cache
def _declare() -> None:
    """Parse the declarations: only when they are needed, since it takes a tenth of a second."""
    _ffi().cdef(_DECLARATIONS)


def _library_names() -> list[str]:
    named = os.environ.get("SOLARI_VK_SHADERC")
    if named:
        return [named]
    names = list(_NAMES.get(sys.platform, _NAMES["linux"]))
    # On Windows the SDK is where the library is, and no search path leads there.
    if "VULKAN_SDK" in os.environ:
        folder = Path(os.environ["VULKAN_SDK"])
        names += [str(folder / part / Path(name).name) for part in ("lib", "Bin") for name in names]
    return names


@cache
def version() -> str:
    """A string that identifies the compiler: path, size and time of its library (which has no version call) or glslc.

    Raises SolariError with the remedy when there is no compiler.
    """
    loaded = library()
    if loaded is not None:
        return identity(_file_of(loaded))
    return identity(_glslc())


def _file_of(loaded: Any) -> str:
    """The file of the library, whose size and time change with each update."""
    try:
        # The loader knows the file of a function.
        info = _ffi().new("Dl_info*")
        _ffi().dlopen(None).dladdr(_ffi().cast("void*", loaded.shaderc_compiler_initialize), info)
        return os.fsdecode(_ffi().string(info.file))
    except (OSError, AttributeError, TypeError):  # Windows has no dladdr, and looks for libraries on the PATH
        from ctypes.util import find_library

        names = _library_names()
        return next((path for path in map(find_library, names) if path), names[0])


def identity(path: str) -> str:
    """A string that differs between builds of a compiler, by its file."""
    file = Path(path).resolve()
    if not file.is_file():  # a name that the loader found elsewhere
        return f"{path} 0 0"
    status = file.stat()
    return f"{file} {status.st_size} {status.st_mtime_ns}"


def _glslc() -> str:
    command = shutil.which("glslc")
    if command is None:
        raise SolariError(
            f"no GLSL compiler: none of {', '.join(_library_names())} can be loaded and there is no glslc. Install "
            "shaderc (Debian: apt-get install glslc; macOS: brew install shaderc; Windows: the Vulkan SDK), or name "
            "its library in SOLARI_VK_SHADERC. Without it only unchanged shaders that came compiled can run"
        )
    return command


def compile_source(
    source: bytes,
    stage: str,
    name: str,
    include_paths: Sequence[str],
    generated: Mapping[str, bytes] | None = None,
    *,
    macros: Mapping[str, int] | None = None,
    language: str = "glsl",
    optimization: str = "performance",
    suppress_warnings: bool = False,
    warnings_as_errors: bool = False,
) -> bytes:
    """SPIR-V 1.6 for Vulkan 1.3 with debug information. Raises Failure, or SolariError without a compiler.

    `generated` are texts of includes that aren't files, by the paths that the sources include them by. Resources that
    are declared without a binding get some number.
    """
    texts = generated or {}
    macros = macros or {}
    loaded = library()
    if loaded is None:
        return _by_command(
            source,
            stage,
            name,
            include_paths,
            texts,
            macros,
            language,
            optimization,
            suppress_warnings,
            warnings_as_errors,
        )
    # shaderc reads an include's text until it calls `release`: the strings must live until then.
    references: dict[Any, Any] = {}

    includes = itertools.count(1)

    @_ffi().callback("resolve")  # type: ignore[untyped-decorator]
    def resolve(_data: Any, requested: Any, kind: int, requesting: Any, depth: int) -> Any:
        wanted = os.fsdecode(_ffi().string(requested))
        # A file that includes itself would never end, nor one that includes two that include two others, and so on.
        if depth > DEEPEST_INCLUDE or next(includes) > MOST_INCLUDES:
            found, content = "", f"{wanted}: {ENDLESS}".encode()
        elif wanted in texts:
            found, content = wanted, texts[wanted]
        else:
            found, content = _include(wanted, kind, os.fsdecode(_ffi().string(requesting)), include_paths)
        strings = _ffi().new("char[]", os.fsencode(found)), _ffi().new("char[]", content)
        names = (strings[0], len(strings[0]) - 1, strings[1], len(content), _ffi().NULL)
        result = _ffi().new("shaderc_include_result*", names)
        references[result] = strings
        return result

    @_ffi().callback("release")  # type: ignore[untyped-decorator]
    def release(_data: Any, result: Any) -> None:
        references.pop(result, None)

    compiler = loaded.shaderc_compiler_initialize()
    options = loaded.shaderc_compile_options_initialize()
    result = _ffi().NULL
    try:
        loaded.shaderc_compile_options_set_source_language(options, LANGUAGES[language])
        loaded.shaderc_compile_options_set_optimization_level(options, OPTIMIZATIONS[optimization])
        # Reflection finds resources by name, which only debug information has.
        loaded.shaderc_compile_options_set_generate_debug_info(options)
        loaded.shaderc_compile_options_set_target_env(options, 0, VULKAN_1_3)
        loaded.shaderc_compile_options_set_target_spirv(options, SPIRV_1_6)
        loaded.shaderc_compile_options_set_include_callbacks(options, resolve, release, _ffi().NULL)
        # GLSL for Vulkan wants a binding on every resource; the interface gives its own numbers afterwards.
        loaded.shaderc_compile_options_set_auto_bind_uniforms(options, True)
        for macro, value in macros.items():
            text = macro.encode(), str(value).encode()
            loaded.shaderc_compile_options_add_macro_definition(options, text[0], len(text[0]), text[1], len(text[1]))
        if suppress_warnings:
            loaded.shaderc_compile_options_set_suppress_warnings(options)
        if warnings_as_errors:
            loaded.shaderc_compile_options_set_warnings_as_errors(options)
        result = loaded.shaderc_compile_into_spv(
            compiler, source, len(source), STAGES[stage], os.fsencode(name), b"main", options
        )
        if loaded.shaderc_result_get_compilation_status(result) != 0:
            raise Failure(_ffi().string(loaded.shaderc_result_get_error_message(result)).decode(errors="replace"))
        size = loaded.shaderc_result_get_length(result)
        return bytes(_ffi().buffer(loaded.shaderc_result_get_bytes(result), size))
    finally:
        if result != _ffi().NULL:
            loaded.shaderc_result_release(result)
        loaded.shaderc_compile_options_release(options)
        loaded.shaderc_compiler_release(compiler)


def _include(requested: str, kind: int, requesting: str, include_paths: Sequence[str]) -> tuple[str, bytes]:
    """Name and text of an included file. With an empty name, shaderc reports the text as an error."""
    # #include <...> isn't looked up beside the including file.
    beside = [] if kind == _STANDARD_INCLUDE else [os.path.dirname(requesting)]
    for folder in (*beside, *include_paths):
        path = os.path.join(folder, requested)
        if os.path.isfile(path):
            try:
                return path, Path(path).read_bytes()
            except OSError as error:  # must not escape into C
                return "", f"{path} can't be read: {error.strerror}".encode()
    return "", f"{requested} is not found in {', '.join((*beside, *include_paths)) or 'any include path'}".encode()


def _by_command(
    source: bytes,
    stage: str,
    name: str,
    include_paths: Sequence[str],
    generated: Mapping[str, bytes],
    macros: Mapping[str, int],
    language: str,
    optimization: str,
    suppress_warnings: bool,
    warnings_as_errors: bool,
) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        for path, text in generated.items():
            file = Path(folder, path)
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(text)
        command = [
            _glslc(),
            f"-fshader-stage={stage}",
            "-x",
            language,
            "--target-env=vulkan1.3",
            "--target-spv=spv1.6",
            "-g",
            "-fauto-bind-uniforms",
            *(f"-D{macro}={value}" for macro, value in macros.items()),
            {"zero": "-O0", "size": "-Os", "performance": "-O"}[optimization],
            *(("-w",) if suppress_warnings else ()),
            *(("-Werror",) if warnings_as_errors else ()),
            *(f"-I{path}" for path in (os.path.dirname(name) or ".", folder, *include_paths)),
            "-o",
            "-",
            "-",
        ]
        try:
            done = subprocess.run(command, input=source, capture_output=True, check=False, timeout=LONGEST)
        except subprocess.TimeoutExpired:
            busy = f"glslc took more than {LONGEST:g} s, on a busy machine or because {ENDLESS}"
            raise Failure(f"{name}: error: {busy}") from None
    if done.returncode != 0:
        log = done.stderr.decode(errors="replace").replace("<stdin>:", f"{name}:").replace("glslc: error: ", "error: ")
        log = log.replace(folder + os.sep, "")  # generated headers are called by the paths that include them
        raise Failure(re.sub(r"(?m)^\d+ (error|warning)s?.* generated\.$", "", log))
    return done.stdout
