"""`solari-vk view`: the interactive viewer."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.cli.devices import open_device
from solari_vk.cli.loading import load_scene
from solari_vk.gpu.device.compile_notes import CompileNotes
from solari_vk.gpu.device.rays import IN_WORDS
from solari_vk.output.picture import write_codes
from solari_vk.passes.debug_views import check_view
from solari_vk.studio.cli.jobs import ViewJob
from solari_vk.studio.viewer.layout import Layout


def run(job: ViewJob) -> None:
    """Show the window until it is closed."""
    if job.screenshot is not None:
        sv.check_output(job.screenshot)
        if job.screenshot.suffix.lower() != ".png":
            raise SolariError(f"--screenshot {job.screenshot}: is a .png file: give such a name")
        if job.frames is None:
            raise SolariError(f"--screenshot {job.screenshot}: is taken after --frames: give their number too")
    settings = job.make_settings()
    check_view(job.view, settings.lighting)
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
        viewer.pictures.view, viewer.pictures.tonemap = job.view, job.tonemap
        viewer.run(frames=job.frames)
        if job.screenshot is not None:
            write_codes(job.screenshot, viewer.capture())
