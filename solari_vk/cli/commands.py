"""The commands: of each, its job and the function that does it, as MODULE:NAME below solari_vk.

This table is all that the core knows of the commands of the wings, whose modules are imported when they are asked for.
"""

from __future__ import annotations

from dataclasses import dataclass

from solari_vk.cli.options import Command


@dataclass(frozen=True)
class NoOptions:
    """A command without options."""


# Where the help lists them: what users need first comes first.
COMMANDS = (
    Command(
        "render",
        "render a glTF file or a built-in scene to a picture or an animation",
        "cli.render:run",
        "cli.jobs:RenderOptions",
    ),
    Command(
        "view", "open a window on a scene: fly around, edit, compare", "studio.commands:view", "studio.jobs:ViewJob"
    ),
    Command(
        "serve", "show a scene in browsers: orbit, zoom, pick, compare", "studio.commands:serve", "studio.jobs:ServeJob"
    ),
    Command(
        "dataset",
        "render many views of a scene, with transforms.json and further outputs",
        "data.cli.dataset:run",
        "data.cli.jobs:DatasetJob",
    ),
    Command(
        "denoise",
        "denoise the frames of an animation that any renderer made",
        "cli.denoise:run",
        "cli.denoise:DenoiseJob",
    ),
    Command(
        "compare",
        "how far two pictures are apart: relMSE, means, FLIP",
        "cli.without_device:compare",
        "cli.without_device:CompareJob",
    ),
    Command(
        "settings",
        "list the settings and qualities, with meaning, range and default",
        "cli.without_device:settings",
        NoOptions,
    ),
    Command("views", "list the debug views, with meaning", "cli.without_device:views", NoOptions),
    Command(
        "info",
        "what this machine can do, what is missing, and the command that mends it",
        "cli.info:run",
        NoOptions,
        aliases=("doctor",),
    ),
    Command("bench", "measure speed, loading, or the realtime frame", "lab.cli.bench:run", "lab.cli.bench:Measurement"),
    Command(
        "trial",
        "render glTF files by other renderers too, and compare: Cycles, Mitsuba",
        "lab.cli.trial:run",
        "lab.cli.trial:TrialJob",
    ),
    Command(
        "fidelity",
        "render scenarios of Khronos' glTF render fidelity generator",
        "lab.cli.fidelity:run",
        "lab.cli.fidelity:FidelityJob",
    ),
    Command(
        "conformance",
        "measure whether a device keeps the rules of the specification",
        "lab.cli.conformance:run",
        "lab.cli.conformance:ConformanceJob",
    ),
)

ANIMATION = "data.cli.animation:run"
"""Renders animations with several devices, a shutter, or by the path tracer."""
SENSOR = "data.sensors.sensor:Sensor"
"""The camera model that makes the raw numbers of --sensor."""
WHY_NO_WINDOW = "studio.viewer.window:why_none_opens"
