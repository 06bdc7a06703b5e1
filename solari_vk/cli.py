"""The command line: solari-vk render | info | bench | conformance.

Exit codes: 0 done, 1 an internal error or a conformance rule that doesn't hold, 2 bad input or usage, 3 no device.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
import time
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Any

from solari_vk.errors import DeviceError, SolariError

if TYPE_CHECKING:
    from solari_vk.reference import PathTracer
    from solari_vk.scene.model import Camera, Scene

_CONFORMANCE_EXIT = (
    "Exit code 0: every rule holds, but for those that the device has no feature for, that only --full measures, and "
    "known faults of its driver no worse than listed; all of these are named. 1: a rule doesn't hold, a listed fault "
    "is gone or grew, or something needed to measure is missing, such as embreex. 2: wrong usage. 3: no device."
)


def main(arguments: list[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    options = _parser().parse_args(arguments)
    try:
        code: int = options.run(options) or 0
    except DeviceError as error:
        print(f"solari-vk: {error}", file=sys.stderr)
        return 3
    except SolariError as error:
        print(f"solari-vk: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:  # whoever read our output had enough
        sys.stdout = None
        return 0
    except KeyboardInterrupt:
        print("solari-vk: interrupted, nothing was written", file=sys.stderr)
        return 1
    except Exception:
        traceback.print_exc()
        print("solari-vk: an internal error; please report it with the lines above", file=sys.stderr)
        return 1
    return code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="solari-vk", description="Raytraced lighting on any Vulkan ray-query device.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    render = commands.add_parser("render", help="render a glTF file or a built-in scene to a picture")
    render.set_defaults(run=_render)
    render.add_argument("source", metavar="FILE|builtin:NAME", help="a .gltf or .glb file, or a built-in scene")
    render.add_argument("-o", "--output", type=Path, required=True, help="picture to write: .png, .exr or .npy")
    render.add_argument("--size", type=_size, default=(640, 360), metavar="WxH", help="pixels (640x360)")
    render.add_argument("--samples", type=_positive, default=256, help="samples per pixel (256)")
    render.add_argument("--seed", type=int, default=0, help="another seed gives other noise (0)")
    render.add_argument("--max-bounces", type=_count, default=16, help="surfaces a path may leave (16)")
    render.add_argument("--scene", help="which scene of the file, by index or name (its default)")
    render.add_argument(
        "--camera", metavar="N|NAME|JSON|FILE",
        help="camera of the scene by index or name, or a pose: {'position': [x, y, z], 'target': [x, y, z]}",
    )
    render.add_argument("--exposure", metavar="EV100|auto", help="exposure value (the camera's; auto for files)")
    render.add_argument("--tonemap", choices=("none", "reinhard", "aces", "agx"), default="agx", help="for .png (agx)")
    render.add_argument("--aov", default="", metavar="A,B", help="more outputs: layers of an .exr, else files")
    render.add_argument("--time-limit", type=float, metavar="S", help="stop after so many seconds of rendering")
    render.add_argument("--lights", choices=("auto", "studio", "none"), default="auto",
                        help="add studio lights: auto adds them to a file that has no light of its own")
    render.add_argument("--device", help="part of a device's name, its index or its UUID")
    render.add_argument("--validation", action="store_true", help="run with the Vulkan validation layer")

    info = commands.add_parser("info", help="devices with what each misses, compiler, cache")
    info.set_defaults(run=_info)

    bench = commands.add_parser("bench", help="measure rays, samples, host time and loading; ratios of one run")
    bench.set_defaults(run=_bench)
    bench.add_argument("files", nargs="*", type=Path, help="glTF files whose loading is measured too")
    bench.add_argument("--device", help="part of a device's name, its index or its UUID")
    bench.add_argument("--markdown", type=Path, metavar="FILE", help="write the figures as Markdown")

    conformance = commands.add_parser(
        "conformance", help="measure whether a device keeps the documents' rules",
        description="Measure whether a device keeps the documents' rules. " + _CONFORMANCE_EXIT,
    )  # fmt: skip
    conformance.set_defaults(run=_conformance)
    conformance.add_argument("--device", help="part of a device's name, its index or its UUID")
    conformance.add_argument("--only", action="append", default=[], metavar="GROUP", help="a group (all; repeatable)")
    conformance.add_argument("--full", action="store_true", help="ten times the rays and instances: takes much longer")
    for kind, what in (("junit", "JUnit XML"), ("markdown", "Markdown"), ("html", "HTML")):
        conformance.add_argument(f"--{kind}", type=Path, metavar="FILE", help=f"write the report as {what}")
    return parser


def _size(text: str) -> tuple[int, int]:
    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no size such as 640x360") from None
    if not (1 <= width <= 16384 and 1 <= height <= 16384):
        raise argparse.ArgumentTypeError("a size is 1x1 to 16384x16384 pixels")
    return width, height


def _positive(text: str) -> int:
    return _integer(text, 1)


def _count(text: str) -> int:
    return _integer(text, 0)


def _integer(text: str, least: int) -> int:
    try:
        number = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no integer") from None
    if number < least:
        raise argparse.ArgumentTypeError(f"must be at least {least}, not {number}")
    return number


# ---- render -----------------------------------------------------------------------------------------


def _render(options: argparse.Namespace) -> None:
    import solari_vk as sv

    output: Path = options.output
    sv.check_output(output)
    names = [name.strip() for name in options.aov.split(",") if name.strip()]
    unknown = [name for name in names if name not in sv.AOVS]
    if unknown:
        raise SolariError(f"--aov {unknown[0]}: there is no such output; there are {', '.join(sv.AOVS)}")
    if options.time_limit is not None and not options.time_limit > 0:
        raise SolariError(f"--time-limit {options.time_limit:g}: must be more than 0 seconds")
    scene, camera, exposure = _load(options)
    for warning in scene.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    with sv.Device(options.device, validation=options.validation or None) as device:
        print(f"rendering {options.source} with {device.name}", file=sys.stderr)
        renderer = sv.PathTracer(
            device, scene, options.size, seed=options.seed, max_bounces=options.max_bounces
        )
        started = time.perf_counter()
        radiance = _accumulate(renderer, camera, options)
        seconds = time.perf_counter() - started
        if exposure == "auto":
            camera.ev100 = sv.auto_exposure(radiance)
        layers = {name: renderer[name] for name in names}
        sv.save_image(output, radiance, exposure=camera.exposure, tonemap=options.tonemap, layers=layers)
    print(
        f"wrote {output}: {options.size[0]}x{options.size[1]}, {renderer.samples} samples a pixel "
        f"in {seconds:.1f} s, EV100 {camera.ev100:.2f}",
        file=sys.stderr,
    )


def _load(options: argparse.Namespace) -> tuple[Scene, Camera, str | float]:
    """The scene, the camera and the exposure ("auto" or the camera's own) that the options ask for."""
    import solari_vk as sv

    builtin = options.source.startswith("builtin:")
    if builtin:
        if options.scene is not None:
            raise SolariError(f"--scene {options.scene}: a built-in scene is one scene")
        scene = sv.builtin(options.source.removeprefix("builtin:"))
    else:
        which = options.scene
        scene = sv.load_gltf(options.source, scene=int(which) if which and which.isdecimal() else which)
    camera = _camera(scene, options.camera)
    if camera is None:
        width, height = options.size
        camera = sv.frame_camera(scene, aspect=width / height)
    lit = any(sun.illuminance > 0 and (sun.color > 0).any() for sun in scene.directional_lights)
    lit = lit or any(i.visible and i.material.emits for i in scene.instances)
    if options.lights == "studio" or (options.lights == "auto" and not lit):
        if options.lights == "auto":
            print(f"{options.source} has no light of its own: adding studio lights", file=sys.stderr)
        sv.studio_lights(scene, camera=camera)
    exposure: str | float = options.exposure or ("camera" if builtin else "auto")
    if exposure not in ("auto", "camera"):
        try:
            camera.ev100 = float(exposure)
        except ValueError:
            raise SolariError(f"--exposure {exposure}: give an EV100 such as 9.5, or auto") from None
    return scene, camera, exposure


def _camera(scene: Scene, text: str | None) -> Camera | None:
    """The camera an option names; None when neither the option nor the scene has one."""
    from solari_vk.scene.model import Camera

    cameras = list(scene.cameras)
    if text is None:
        return cameras[0] if cameras else None
    if text.isdecimal():
        if int(text) >= len(cameras):
            raise SolariError(f"--camera {text}: {scene.describe()} has {len(cameras)} cameras, counted from 0")
        return cameras[int(text)]
    named = [camera for camera in cameras if camera.name == text]
    if named:
        return named[0]
    try:
        pose = json.loads(text if text.lstrip().startswith("{") else Path(text).read_text())
    except (OSError, ValueError) as error:
        raise SolariError(f"--camera {text}: no camera's name, no JSON pose and no file of one ({error})") from None
    return Camera.from_pose(pose)


def _accumulate(renderer: PathTracer, camera: Camera, options: argparse.Namespace) -> Any:
    """Render with progress; Ctrl-C ends it between dispatches with what there is, a second one at once."""
    progress = _Progress(options.samples)
    usual = signal.signal(signal.SIGINT, progress.interrupt)
    try:
        return renderer.render(camera, samples=options.samples, time_limit=options.time_limit, progress=progress)
    except _Interrupted:
        print(f"interrupted: keeping {renderer.samples} samples a pixel", file=sys.stderr)
        return renderer["radiance"]
    finally:
        signal.signal(signal.SIGINT, usual)
        progress.close()


class _Interrupted(Exception):
    pass


class _Progress:
    """Called with the samples done: a bar on a terminal, a line every few seconds elsewhere."""

    def __init__(self, total: int) -> None:
        self._total = total
        self._started = self._said = time.monotonic()
        self._interrupted = False
        self._bar: Any = None
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

            self._bar = Progress(
                "samples", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), console=Console(stderr=True)
            )
            self._bar.start()
            self._task = self._bar.add_task("", total=total)

    def interrupt(self, *_: object) -> None:
        """Takes SIGINT."""
        if self._interrupted:
            raise KeyboardInterrupt
        self._interrupted = True

    def __call__(self, done: int) -> None:
        if self._interrupted:
            raise _Interrupted
        if self._bar is not None:
            self._bar.update(self._task, completed=done)
        elif time.monotonic() - self._said > 5:
            self._said = time.monotonic()
            print(f"{done} of {self._total} samples, {self._said - self._started:.0f} s", file=sys.stderr, flush=True)

    def close(self) -> None:
        if self._bar is not None:
            self._bar.stop()


# ---- info and bench ---------------------------------------------------------------------------------


def _info(options: argparse.Namespace) -> None:
    from solari_vk import __version__
    from solari_vk.gpu import shader_cache, shaderc
    from solari_vk.gpu.device import list_devices

    print(f"solari_vk {__version__}")
    try:
        print(f"compiler: {shaderc.version().split(' ')[0]}")
    except SolariError as error:
        print(f"compiler: {error}")
    folder = shader_cache.cache_folder()
    modules = list(folder.glob("*.spv")) if folder and folder.is_dir() else []
    size = sum(module.stat().st_size for module in modules)
    print(f"cache: {folder}, {len(modules)} shaders, {size / 1e6:.1f} MB" if folder else "cache: off")
    reports = list_devices()
    for report in reports:
        version = ".".join(map(str, report.api_version))
        print(f"device {report.index}: {report.name} ({report.kind}), {report.driver}, Vulkan {version}, {report.uuid}")
        print("  usable" if not report.missing else f"  misses: {', '.join(report.missing)}")
    if all(report.missing for report in reports):
        raise DeviceError("no device can be used: install a driver with VK_KHR_ray_query (Mesa lavapipe 24.1 or newer)")


def _bench(options: argparse.Namespace) -> None:
    from solari_vk.bench import run

    run(options.device, options.files, options.markdown)


def _conformance(options: argparse.Namespace) -> int:
    from solari_vk.conformance.run import run

    return run(
        options.device, only=options.only, full=options.full,
        junit=options.junit, markdown=options.markdown, html=options.html,
    )  # fmt: skip
