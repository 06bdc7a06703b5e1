"""Prints what this system lacks for a job of tools/setup.sh, one thing a line: missing.py demo|test."""

import ctypes
import os
import shutil
import sys
from pathlib import Path

LOADER = ("libvulkan.so.1", "libvulkan.1.dylib")
COMPILER = ("libshaderc.so.1", "libshaderc_shared.so.1", "libshaderc_shared.so", "libshaderc_shared.1.dylib")
LLVM = ("libLLVM.so.19.1", "libLLVM-19.so", "libLLVM.so.19.0")
FOLDERS = ("", "/opt/homebrew/lib/", "/usr/local/lib/")
LAYER = b"VK_LAYER_KHRONOS_validation"


class LayerProperties(ctypes.Structure):
    """VkLayerProperties."""

    _fields_ = [("name", ctypes.c_char * 256), ("versions", ctypes.c_uint32 * 2), ("description", ctypes.c_char * 256)]


def library(names):
    """The first of these libraries that can be loaded, or None."""
    # The linker's own folders first, then those where Homebrew puts libraries on macOS.
    for path in (folder + name for name in names if name for folder in FOLDERS):
        try:
            return ctypes.CDLL(path)
        except OSError:
            continue
    return None


def has_layer(loader):
    """Whether the loader finds the validation layer."""
    count = ctypes.c_uint32()
    loader.vkEnumerateInstanceLayerProperties(ctypes.byref(count), None)
    layers = (LayerProperties * count.value)()
    loader.vkEnumerateInstanceLayerProperties(ctypes.byref(count), layers)
    return any(layer.name == LAYER for layer in layers)


def missing(job):
    """Yields the name of each missing thing."""
    loader = library(LOADER)
    if loader is None:
        yield "the Vulkan loader"
    if library((os.environ.get("SOLARI_VK_SHADERC", ""), *COMPILER)) is None and shutil.which("glslc") is None:
        yield "shaderc (its library or glslc)"
    if job == "test":
        yield from missing_for_tests(loader)


def missing_for_tests(loader):
    """Yields the name of each missing thing that only tests need."""
    if loader is None or not has_layer(loader):
        yield "the Vulkan validation layer"
    if library(COMPILER) is None and not (shutil.which("ld") and any(Path("/usr/lib").rglob("libglslang.a"))):
        yield "a libshaderc that can be loaded (or what makes one of Debian 12's: glslang-dev and binutils)"
    for program in ("spirv-val", "Xvfb", "xdotool"):
        if shutil.which(program) is None:
            yield program
    # Mitsuba, which some tests compare with, needs these two.
    if library(LLVM) is None:
        yield "LLVM 19"
    if library(("libatomic.so.1", "libSystem.dylib")) is None:
        yield "libatomic"


if __name__ == "__main__":
    print("\n".join(missing(sys.argv[1])))
