"""`render`, `view` and `serve`: a picture, a window or a page by one line. They open the device themselves."""

from __future__ import annotations

import asyncio
import os
import threading
import weakref
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from solari_vk.base.errors import SolariError, checked_keywords, quoted, unknown_name, warn
from solari_vk.cli.progress import Progress
from solari_vk.gpu.device.device import Device
from solari_vk.output import oidn
from solari_vk.renderers.large_pictures import checked_size
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.renderers.renderer import Renderer
from solari_vk.renderers.results import RenderedFrame
from solari_vk.scene.load import open as open_scene
from solari_vk.scene.model import Camera, Scene

if TYPE_CHECKING:
    from solari_vk.studio.browser.screen import Screens

    ScenePath = Scene | str | os.PathLike[str]

MODES = ("auto", "realtime", "reference")
REALTIME_FRAMES = 48  # light has gathered by then
SAMPLES = 256
DENOISED_SAMPLES = 48


# ---- what is kept between calls ---------------------------------------------------------------------


class KeptDevice:
    """A device that is closed once its thread has ended and its frames are gone, or when Python ends."""

    def __init__(self) -> None:
        self.device = Device()
        weakref.finalize(self, self.device.close)


class _OfThread(threading.local):
    """What a thread keeps: a device is used in one."""

    def __init__(self) -> None:
        self.kept: KeptDevice | None = None
        self.unused: deque[PathTracer | Renderer] = deque()  # renderers of frames that are gone


_here = _OfThread()


def kept_device() -> KeptDevice:
    """The device of `render` and `view`, which the first call in a thread opens. A lost or closed device is replaced by
    a new one. Raises DeviceError when no device fits."""
    kept = _here.kept
    if kept is not None and (kept.device.lost or kept.device.closed):
        _here.kept = None
        kept.device.close()
        kept = None
    if kept is None:
        kept = _here.kept = KeptDevice()
    return kept


class _LastingSource:
    """The renderer of one frame, which is closed once the frame is gone; see `results.Source`.

    owner: what closes the device, for as long as the frame needs it."""

    def __init__(self, renderer: PathTracer | Renderer, owner: object) -> None:
        self.renderer = renderer
        self.owner = owner
        # Collected objects end in any thread, so the renderer is closed by a later call of `render`.
        weakref.finalize(self, _here.unused.append, renderer).atexit = False

    def __getattr__(self, name: str) -> Any:
        return getattr(self.renderer, name)

    def check_latest(self, frame: RenderedFrame, name: str) -> None:
        """Raise SolariError if the device was closed. The renderer makes no other frame."""
        self.renderer.device.check_open()


def _lasting(renderer: PathTracer | Renderer, frame: RenderedFrame, owner: object) -> RenderedFrame:
    """A frame that can be read for as long as somebody has it. owner: see `_LastingSource`."""
    source: Any = _LastingSource(renderer, owner)
    return RenderedFrame(source, frame.camera, frame._projection, frame._timeline_value)


# ---- the functions ----------------------------------------------------------------------------------


def _check(who: str, size: Any, camera: Any, mode: Any, modes: Sequence[str], device: Any = None) -> None:
    """Raise SolariError for an argument that can't be, before anything is opened."""
    if mode not in modes:
        raise unknown_name(f"{who}: there is no mode", mode, modes)
    checked_size(who, size)
    if not (camera is None or isinstance(camera, Camera)):
        raise SolariError(f"{who}: camera must be a Camera, such as one of scene.cameras, not {quoted(camera)}")
    if device is not None:
        if not isinstance(device, Device):
            raise SolariError(f'{who}: device must be a Device, such as solari_vk.Device("cpu"), not {quoted(device)}')
        device.check_open()


def _opened(who: str, scene: ScenePath) -> Scene:
    """The scene, of a path the file framed and lit."""
    if isinstance(scene, Scene):
        return scene
    if isinstance(scene, str | os.PathLike):
        return open_scene(scene)
    raise SolariError(
        f"{who}: the first argument is a Scene, the path of a file or builtin:NAME, not {quoted(scene)}; a mesh is "
        "added to a scene: scene = solari_vk.Scene(); scene.add(mesh); solari_vk.studio_lights(scene)"
    )


@checked_keywords(who="solari_vk")
def render(
    scene: ScenePath,
    size: tuple[int, int] = (640, 360),
    samples: int | None = None,
    *,
    denoise: bool = True,
    camera: Camera | None = None,
    mode: str = "auto",
    seed: int = 0,
    progress: bool = True,
    device: Device | None = None,
) -> RenderedFrame:
    """A picture of a scene, or of a file as `open` frames and lights it: `render("model.glb").save("picture.png")`.

    size: (width, height) in pixels. samples: per pixel, of the path tracer; by default 48 with denoise, else 256.
    denoise: by Intel Open Image Denoise (the extra `oidn`); realtime frames have a denoiser of their own. camera: by
    default the scene's. mode: "reference" is the path tracer, "realtime" the realtime renderer; "auto" is the path
    tracer, but the realtime renderer where neither samples are given nor OIDN is installed. progress: show it on
    standard error, in terminals as a bar. device: by default one that is opened by the first call in a thread and kept
    for later ones. The frame can be read for as long as it exists, also after later calls. Many pictures of one scene
    are quicker with one PathTracer or Renderer. Raises SolariError as these do.
    """
    _check("solari_vk.render", size, camera, mode, MODES, device)
    opened = _opened("solari_vk.render", scene)
    has_oidn = oidn.is_installed()
    if mode == "auto":
        mode = "realtime" if samples is None and denoise and not has_oidn else "reference"
    if mode == "realtime" and samples is not None:
        raise SolariError(
            'solari_vk.render: realtime frames have no samples: leave samples out, or give mode="reference"'
        )
    if mode == "reference" and denoise and not has_oidn:
        warn("the picture isn't denoised: install \"pip install 'solari-vk[oidn]'\", or give denoise=False")
        denoise = False
    if samples is None:
        samples = DENOISED_SAMPLES if denoise else SAMPLES
    owner: object = device
    if device is None:
        owner = kept = kept_device()
        device = kept.device
    while _here.unused:
        _here.unused.popleft().close()
    if mode == "realtime":
        renderer, frame = _render_realtime(device, opened, size, camera, seed, progress)
        return _lasting(renderer, frame, owner)
    tracer = PathTracer(device, opened, size, seed=seed)
    try:
        with Progress("samples a pixel", samples, stops=False, shown=progress) as shown:
            frame = tracer.render(camera, samples, denoise=denoise, progress=shown)
    except BaseException:
        tracer.close()
        raise
    return _lasting(tracer, frame, owner)


def _render_realtime(
    device: Device, scene: Scene, size: tuple[int, int], camera: Camera | None, seed: int, progress: bool
) -> tuple[Renderer, RenderedFrame]:
    renderer = Renderer(device, scene, size, seed=seed)
    try:
        with Progress("frames", REALTIME_FRAMES, stops=False, shown=progress) as shown:
            for number in range(REALTIME_FRAMES):
                frame = renderer.render(camera)
                shown(number + 1)
    except BaseException:
        renderer.close()
        raise
    return renderer, frame


@checked_keywords(who="solari_vk")
def view(
    scene: ScenePath,
    size: tuple[int, int] = (1280, 720),
    *,
    camera: Camera | None = None,
    mode: str = "realtime",
    device: Device | None = None,
) -> None:
    """Show a scene, or a file as `open` gives it, in a window until it is closed. mode: that of `Viewer`, which has
    further options. device: by default that of `render`. Raises SolariError where no window can be opened."""
    from solari_vk.studio.viewer.pictures import MODES as SHOWN

    _check("solari_vk.view", size, camera, mode, SHOWN, device)
    from solari_vk.studio.viewer.app import Viewer

    opened = _opened("solari_vk.view", scene)
    with Viewer(device or kept_device().device, opened, size=size, camera=camera, mode=mode) as viewer:
        viewer.run()


@checked_keywords(who="solari_vk")
def serve(
    scene: ScenePath,
    size: tuple[int, int] = (1280, 720),
    *,
    camera: Camera | None = None,
    mode: str = "realtime",
    host: str = "127.0.0.1",
    port: int = 8765,
    started: Callable[[str], None] | None = None,
) -> None:
    """Show a scene, or a file as `open` gives it, in browsers until Ctrl-C; the address is printed.

    mode: "realtime", "reference" or "split". host, port: where to listen; other addresses than this machine's own get a
    token, which is printed with the address. started: is called with the address. `solari-vk serve` has further
    options. Raises SolariError in a notebook, which has `notebook.show`, for a port in use, and without the extra
    `serve`.
    """
    from solari_vk.studio.browser.serving import serve_screens
    from solari_vk.studio.viewer.pictures import MODES as SHOWN

    _check("solari_vk.serve", size, camera, mode, SHOWN)
    if not (isinstance(port, int) and 0 <= port < 2**16):
        raise SolariError(f"solari_vk.serve: port must be a whole number from 0 to 65535, not {quoted(port)}")
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        pass
    else:
        raise SolariError("solari_vk.serve: a notebook shows solari_vk.notebook.show(renderer), of a Renderer")
    if threading.current_thread() is not threading.main_thread():
        raise SolariError("solari_vk.serve: runs in the main thread only, which receives Ctrl-C; call it there")

    def prepared() -> Callable[[], Screens]:
        opened = _opened("solari_vk.serve", scene)
        return lambda: _open_screens(opened, size, camera, mode)

    serve_screens(prepared, getattr(scene, "name", "") or str(scene), host, port, started=started)


def _open_screens(scene: Scene, size: tuple[int, int], camera: Camera | None, mode: str) -> Screens:
    """A device, opened on the thread of the server that uses it, and what shows the scene on it."""
    from solari_vk.studio.browser.screen import Screens

    with ExitStack() as undo:
        device = undo.enter_context(Device())
        front = camera or scene.camera_for(size[0] / size[1])
        screens = Screens(device, scene, front, size=size, name=scene.name or "scene", mode=mode)
        screens.owned = undo.pop_all()
    return screens
