"""`solari-vk info`, or `doctor`: what this machine can do, what is missing, and the command that mends it."""

from __future__ import annotations

import argparse
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from typing import Any, NamedTuple

from solari_vk.errors import DeviceError, SolariError
from solari_vk.gpu.device.rays import AUTO, EXTENSIONS, IN_WORDS

_DRIVER = (
    f"no device can be used: install a driver with {EXTENSIONS}: that of your graphics card, or Mesa's software device "
    "of version 24.1 or later (Debian 13: apt-get install mesa-vulkan-drivers; Debian 12: the same with "
    "-t bookworm-backports; tools/demo does it)"
)


class Part(NamedTuple):
    """An optional part: what it does, the extra of the package that brings it, and the modules that it needs."""

    what: str
    extra: str
    modules: tuple[str, ...]
    works: Callable[[], bool] = lambda: False
    """Whether it works without the modules."""


PARTS = (
    Part("clean pictures of the path tracer (Open Image Denoise)", "oidn", ("pyoidn",)),
    Part("KTX2 textures of Basis Universal", "formats", ("opengl_basisu",)),
    Part("KTX2 textures of Zstandard", "formats", ("backports.zstd",), lambda: bool(find_spec("compression"))),
    Part("meshes of meshopt", "formats", ("meshopt",)),
    Part("meshes of Draco", "formats", ("DracoPy",)),
    Part("OBJ, PLY and STL files", "formats", ("trimesh",)),
    Part(".mp4 files", "video", ("imageio_ffmpeg",), lambda: bool(shutil.which("ffmpeg"))),
    Part("panels in the viewer", "viewer", ("imgui_bundle",)),
    Part("interactive pictures in notebooks", "notebook", ("anywidget",)),
    Part("several devices and machines", "cluster", ("distributed",)),
)


def add_parser(commands: Any) -> None:
    """Add the command to the parser of the command line."""
    parser = commands.add_parser(
        "info", aliases=["doctor"], help="what this machine can do, what is missing, and the command that mends it"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> None:
    """Print the report. Raises DeviceError if no device can be used."""
    from solari_vk import __version__
    from solari_vk.gpu.device.device import list_devices
    from solari_vk.gpu.shaders import shaderc
    from solari_vk.viewer.window import why_none_opens

    print(f"solari_vk {__version__}")
    try:
        print(f"compiler: {shaderc.version().split(' ')[0]}")
    except SolariError as error:
        print(f"compiler: {error}")
    print(_cache())
    for part in PARTS:
        there = part.works() or all(_is_there(module) for module in part.modules)
        remedy = f"missing: pip install 'solari-vk[{part.extra}]'"
        print(f"{part.what}: {'yes' if there else remedy}")
    reason = why_none_opens()
    print(f"windows: {reason + ' (without a display: xvfb-run solari-vk view ...)' if reason else 'yes'}")
    reports = list_devices()
    for report in reports:
        _print_device(report)
    if all(report.missing for report in reports):
        raise DeviceError(_DRIVER)


def _is_there(module: str) -> bool:
    package, _, below = module.partition(".")
    return find_spec(package) is not None and (not below or find_spec(module) is not None)


def _cache() -> str:
    from solari_vk import disk_cache

    folder = disk_cache.folder()
    if not folder:
        return "cache: off"
    kept = {what: list(folder.glob(f"*.{what}")) for what in ("spv", "pipelines")}
    size = sum(file.stat().st_size for files in kept.values() for file in files)
    counts = f"shaders: {len(kept['spv'])}, pipeline caches: {len(kept['pipelines'])}"
    return f"cache: {folder}, {counts}, {size / 1e6:.1f} MB"


def _print_device(report: Any) -> None:
    from solari_vk.passes.gbuffer import way_on

    version = ".".join(map(str, report.api_version))
    print(f"device {report.index}: {report.name} ({report.kind}), {report.driver}, Vulkan {version}, {report.uuid}")
    print("  usable" if not report.missing else f"  lacks: {', '.join(report.missing)}")
    for rays, missing in report.missing_rays.items():
        print(f"  --rays {rays}: {'lacks ' + ', '.join(missing) if missing else 'yes'}")
    if report.missing_rays:
        print(f"  without --rays: {_way_without_option(report.missing_rays)}")
    print(f"  --settings gbuffer=auto: {way_on(report.kind)}")


def _way_without_option(missing_rays: Mapping[str, Sequence[str]]) -> str:
    wanted = os.environ.get("SOLARI_VK_RAYS") or AUTO
    ways = [IN_WORDS[rays] for rays, missing in missing_rays.items() if not missing and wanted in (AUTO, rays)]
    because = "" if wanted == AUTO else f", because SOLARI_VK_RAYS is {wanted!r}"
    return (f"by {ways[0]}" if ways else "none") + because
