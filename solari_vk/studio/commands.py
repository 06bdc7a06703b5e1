"""`solari-vk view` and `solari-vk serve`: a scene in a window, or in browsers."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.base.files import followed
from solari_vk.cli.devices import open_device
from solari_vk.cli.loading import LoadedScene, load_scene
from solari_vk.gpu.device.compile_notes import CompileNotes
from solari_vk.gpu.device.rays import IN_WORDS
from solari_vk.output.picture import write_codes
from solari_vk.passes.debug_views import check_view
from solari_vk.studio.jobs import ServeJob, ViewJob
from solari_vk.studio.viewer.layout import Layout

if TYPE_CHECKING:
    from solari_vk.studio.browser.screen import Screens


def view(job: ViewJob) -> None:
    """Show the window until it is closed."""
    if job.screenshot is not None:
        _check_screenshot(job, job.screenshot)
    settings = job.make_settings()
    check_view(job.view, settings.lighting)
    # The first camera frames the scene for the part of the window that the panels leave to the picture.
    area = Layout.of(job.size, panels=not job.no_overlay).picture
    loaded = load_scene(replace(job, size=(area.width, area.height)))
    is_file = not job.source.startswith("builtin:")
    loaded.cameras[0].auto_exposure = loaded.auto_exposure
    beside = None if job.beside is None else load_scene(replace(job, source=job.beside, camera=None)).scene
    with (
        open_device(job, CompileNotes()) as device,
        sv.Viewer(
            device,
            loaded.scene,
            size=job.size,
            camera=loaded.cameras[0],
            mode=job.mode,
            scale=job.scale,
            fps=job.fps,
            settings=settings,
            seed=job.seed,
            overlay=not job.no_overlay,
            source=job.source,
            source_options=job.words(),
            load=(lambda: load_scene(job).scene) if is_file else None,
            folder=job.folder,
            beside=beside,
            beside_name=Path(job.beside).name if job.beside else "",
        ) as viewer,
    ):
        print(f"showing {job.source} with {device.name}, by {IN_WORDS[device.rays]}", file=sys.stderr)
        viewer.pictures.view = job.view
        viewer.pictures.tonemap = job.tonemap
        viewer.run(frames=job.frames)
        if job.screenshot is not None:
            write_codes(followed(job.screenshot), viewer.capture())


def _check_screenshot(job: ViewJob, path: Path) -> None:
    """Raise SolariError, before anything is opened, if the screenshot can't be written."""
    sv.check_output(path)
    if path.suffix.lower() != ".png":
        raise SolariError(f"--screenshot {path}: is a .png file: give such a name")
    if job.frames is None:
        raise SolariError(f"--screenshot {path}: is taken after --frames: give their number too")


def serve(job: ServeJob) -> None:
    """Serve browsers until Ctrl-C."""
    from solari_vk.studio.browser.serving import serve_screens

    check_view(job.view, job.make_settings().lighting)

    def prepared() -> Callable[[], Screens]:
        loaded = load_scene(job)
        return lambda: _open_screens(job, loaded)

    serve_screens(prepared, job.source, job.host, job.port, token=job.token, shared=job.shared)


def _open_screens(job: ServeJob, loaded: LoadedScene) -> Screens:
    """Open the device, on the thread that will own it, and what shows the scene on it."""
    from solari_vk.studio.browser.screen import Screens

    camera = loaded.cameras[0]
    camera.auto_exposure = loaded.auto_exposure
    with ExitStack() as undo:
        device = undo.enter_context(open_device(job, CompileNotes()))
        screens = Screens(
            device,
            loaded.scene,
            camera,
            size=job.size,
            name=Path(job.source).name,
            mode=job.mode,
            view=job.view,
            tonemap=job.tonemap,
            settings=job.make_settings(),
            seed=job.seed,
            scale=job.scale,
            fps=job.fps,
            samples=job.samples,
        )
        screens.owned = undo.pop_all()
    return screens
