"""`solari-vk info`, or `doctor`: what this machine can do, what is missing, and the command that mends it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from solari_vk import __version__
from solari_vk.base.errors import DeviceError, SolariError
from solari_vk.cli.commands import WHY_NO_WINDOW
from solari_vk.cli.options import resolve
from solari_vk.gpu.device.measured_rays import known_speeds
from solari_vk.gpu.device.rays import AUTO, DRIVER, IN_WORDS, automatic_method, is_unlisted

if TYPE_CHECKING:
    from solari_vk.gpu.device.physical import DeviceReport

_DRIVER = (
    f"no device can be used: install a driver with {DRIVER}: that of your graphics card, or Mesa's software device "
    "(Debian: apt-get install mesa-vulkan-drivers; tools/demo does it, on Debian 12 from the faster backports)"
)

TRIAL_SECONDS = 60.0  # libraries are large, and disks may be slow
# Without site-packages (-S) and the current folder (-I), since only the libraries are tried, not their modules.
# Wheels for Windows have what their files need in a folder beside their own, which the package adds at its import.
_LOAD = """
import ctypes, os, sys
for path in sys.argv[1:]:
    beside = os.path.dirname(path) + ".libs"
    if hasattr(os, "add_dll_directory") and os.path.isdir(beside):
        os.add_dll_directory(beside)
    ctypes.CDLL(path)
"""


class Part(NamedTuple):
    """An optional part: what it does, the extra of the package that brings it, and the module that it needs."""

    what: str
    extra: str
    module: str
    works: Callable[[], bool] = lambda: False
    """Whether it works without the module."""
    libraries: tuple[str, ...] = ("_*.so", "_*.pyd")
    """Patterns of the compiled files in the module's folder, which must load. Python itself is taken to work."""


PARTS = (
    Part(
        "clean pictures of the path tracer (Open Image Denoise)",
        "oidn",
        "pyoidn",
        libraries=(
            "oidn/lib/libOpenImageDenoise.so.2",
            "oidn/lib/libOpenImageDenoise_device_cpu.so*",
            "oidn/bin/OpenImageDenoise.dll",
        ),
    ),
    Part("KTX2 textures of Basis Universal", "formats", "opengl_basisu"),
    Part("KTX2 textures of Zstandard", "formats", "backports.zstd", lambda: bool(find_spec("compression"))),
    Part("meshes of meshopt", "formats", "meshopt"),
    Part("meshes of Draco", "formats", "DracoPy"),
    Part("OBJ, PLY and STL files", "formats", "trimesh"),
    Part("USD files", "usd", "pxr"),
    Part(".mp4 files", "video", "imageio_ffmpeg", lambda: bool(shutil.which("ffmpeg"))),
    Part("panels in the viewer", "viewer", "imgui_bundle"),
    Part("interactive pictures in notebooks", "notebook", "anywidget"),
    Part("pictures in browsers", "serve", "aiohttp"),
    Part("pictures in terminals", "terminal", "textual_image"),
    Part("several devices and machines", "cluster", "distributed"),
    Part(
        "passes in Slang",
        "slang",
        "slangpy",
        libraries=("libslang-compiler.so*", "libslang-compiler*.dylib", "slang-compiler*.dll"),
    ),
)


def run(job: object) -> None:
    """Print the report. Raises DeviceError if no device can be used."""
    files = {part: _files(part) for part in PARTS if not part.works()}
    # Another process loads their libraries, beside the imports and queries of this one, which take as long.
    with ThreadPoolExecutor() as pool:
        tried = pool.submit(_reasons, files)
        compiler = _compiler()
        why_no_window = _why_no_window()
        reports = _devices()
    reasons = tried.result()
    print(f"solari_vk {__version__}\ncompiler: {compiler}\n{_cache()}")
    for part in PARTS:
        print(f"{part.what}: {_state(part, reasons)}")
    if why_no_window:
        hint = "" if sys.platform == "win32" else " (without a display: xvfb-run solari-vk view ...)"
        print(f"windows: {why_no_window}{hint}")
    else:
        print("windows: yes")
    # Last, so that what doesn't need a device is known also where there is none.
    if isinstance(reports, SolariError):
        raise reports
    for report in reports:
        _print_device(report)
    if all(report.missing for report in reports):
        raise DeviceError(_DRIVER)


def _compiler() -> str:
    from solari_vk.gpu.shaders import shaderc

    try:
        return shaderc.version().rsplit(" ", 2)[0]  # without size and time
    except SolariError as error:
        return str(error)


def _why_no_window() -> str:
    reason: str = resolve(WHY_NO_WINDOW)()
    return reason


def _devices() -> list[DeviceReport] | SolariError:
    from solari_vk.gpu.device.device import list_devices

    try:
        return list_devices()
    except SolariError as error:
        return error


def _state(part: Part, reasons: Mapping[Part, str]) -> str:
    if part.works():
        return "yes"
    if not _is_there(part.module):
        return f"missing: pip install 'solari-vk[{part.extra}]'"
    reason = reasons.get(part)
    return f"installed, but it doesn't work: {reason}" if reason else "yes"


def _files(part: Part) -> list[str]:
    """The compiled files of a part that is installed."""
    spec = find_spec(part.module) if _is_there(part.module) else None
    if spec is None or spec.origin is None:
        return []
    # A module is one library, or a folder with some.
    module = Path(spec.origin)
    if module.suffix in (".so", ".pyd"):
        return [str(module)]
    return [str(path) for pattern in part.libraries for path in sorted(module.parent.glob(pattern))]


def _reasons(files: Mapping[Part, list[str]]) -> dict[Part, str]:
    """Why parts don't load, "" for those that do: all in one process, and one by one only if that fails."""
    if not _why_not([path for paths in files.values() for path in paths]):
        return dict.fromkeys(files, "")
    return {part: _why_not(paths) for part, paths in files.items()}


def _why_not(paths: Sequence[str]) -> str:
    """Why libraries don't load, "" if they do; in another process, because a damaged one may end its process."""
    try:
        done = subprocess.run(
            [sys.executable, "-I", "-S", "-c", _LOAD, *paths],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            check=False,
            timeout=TRIAL_SECONDS,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error)
    if not done.returncode:
        return ""
    return (done.stderr.strip().splitlines() or [f"it ends Python with code {done.returncode}"])[-1]


def _is_there(module: str) -> bool:
    # `find_spec` raises for a module below a package that is missing.
    package, _, below = module.partition(".")
    return find_spec(package) is not None and (not below or find_spec(module) is not None)


def _cache() -> str:
    from solari_vk.base import disk_cache

    folder = disk_cache.folder()
    if not folder:
        return "cache: off"
    shaders = list(folder.glob("*.spv"))
    pipelines = list(folder.glob("*.pipelines"))
    size = sum(file.stat().st_size for file in [*shaders, *pipelines])
    counts = f"shaders: {len(shaders)}, pipeline caches: {len(pipelines)}"
    return f"cache: {folder}, {counts}, {size / 1e6:.1f} MB"


def _print_device(report: Any) -> None:
    from solari_vk.passes.gbuffer import chosen_method

    version = ".".join(map(str, report.api_version))
    print(f"device {report.index}: {report.name} ({report.kind}), {report.driver}, Vulkan {version}, {report.uuid}")
    print("  usable" if not report.missing else f"  lacks: {', '.join(report.missing)}")
    for rays, missing in report.missing_rays.items():
        print(f"  --rays {rays}: {'lacks ' + ', '.join(missing) if missing else 'yes'}")
    if report.missing_rays:
        print(f"  without --rays: {_rays_without_option(report)}")
    print(f"  --settings gbuffer=auto: {chosen_method(report.kind)}")


def _rays_without_option(report: Any) -> str:
    wanted = os.environ.get("SOLARI_VK_RAYS") or AUTO
    unlisted = is_unlisted(report.missing_rays, report.kind, report.driver_id)
    speeds = known_speeds(report.uuid, report.driver) if unlisted else None
    if wanted == AUTO and unlisted and speeds is None:
        return "by ray queries or compute shaders, whichever is faster: measured at first use"
    if wanted == AUTO:
        rays, why = automatic_method(report.missing_rays, report.kind, speeds)
    else:
        works = report.missing_rays.get(wanted) == []
        rays, why = (wanted if works else "", f"SOLARI_VK_RAYS is {wanted!r}")
    return f"by {IN_WORDS[rays]}, because {why}" if rays else f"none, because {why}"
