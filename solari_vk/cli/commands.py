"""The commands: of each, its job and the function that does it, as MODULE:NAME below solari_vk.

This table is all that the core knows of the commands of the wings, whose modules are imported when they are asked for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from solari_vk.cli.options import Command


@dataclass(frozen=True)
class NoOptions:
    """A command without options."""


# For those who develop renderers and drivers.
LAB = (
    Command(
        "bench",
        "measure speed, loading, or the realtime frame",
        "lab.cli.bench:run",
        "lab.cli.bench:Measurement",
        examples=("solari-vk lab bench", "solari-vk lab bench frame --quick"),
    ),
    Command(
        "trial",
        "render glTF files by other renderers too, and compare: Cycles, Mitsuba",
        "lab.cli.trial:run",
        "lab.cli.trial:TrialJob",
        examples=("solari-vk lab trial model.glb -o trial",),
    ),
    Command(
        "fidelity",
        "render scenarios of Khronos' glTF render fidelity generator",
        "lab.cli.fidelity:run",
        "lab.cli.fidelity:FidelityJob",
        examples=("solari-vk lab fidelity config.json -o pictures",),
    ),
    Command(
        "conformance",
        "measure whether a device keeps the rules of the specification",
        "lab.cli.conformance:run",
        "lab.cli.conformance:ConformanceJob",
        examples=("solari-vk lab conformance",),
    ),
)


@dataclass(frozen=True)
class LabOptions:
    """A command below it is given."""

    DESCRIPTION: ClassVar = "Commands for those who develop renderers and drivers."
    PARTS: ClassVar = LAB


# Where the help lists them: what users need first comes first.
COMMANDS = (
    Command(
        "render",
        "render a glTF file or a built-in scene to a picture or an animation",
        "cli.render:run",
        "cli.jobs:RenderOptions",
        examples=(
            "solari-vk render model.glb -o picture.png",
            "solari-vk render model.glb --size 1920x1080 --samples 256 -o picture.png",
            "solari-vk render model.glb --animate orbit --seconds 4 -o turn.mp4",
        ),
    ),
    Command(
        "view",
        "open a window on a scene: fly around, edit, compare",
        "studio.commands:view",
        "studio.jobs:ViewJob",
        examples=("solari-vk view model.glb", "solari-vk view builtin:cornell_box --quality high"),
    ),
    Command(
        "serve",
        "show a scene in browsers: orbit, zoom, pick, compare",
        "studio.commands:serve",
        "studio.jobs:ServeJob",
        examples=("solari-vk serve model.glb", "solari-vk serve model.glb --host 0.0.0.0 --port 8000"),
    ),
    Command(
        "dataset",
        "render many views of a scene, with transforms.json and further outputs",
        "data.cli.dataset:run",
        "data.cli.jobs:DatasetJob",
        examples=(
            "solari-vk dataset model.glb --views 100 -o views",
            "solari-vk dataset model.glb --views 100 --aov depth,instance_id --annotations coco -o views",
        ),
    ),
    Command(
        "denoise",
        "denoise the frames of an animation that any renderer made",
        "cli.denoise:run",
        "cli.denoise:DenoiseJob",
        examples=(
            "solari-vk denoise render/frame_####.exr -o denoised",
            "solari-vk denoise frames -o denoised --layer albedo=MyAlbedo",
        ),
    ),
    Command(
        "compare",
        "how far two pictures are apart: relMSE, means, FLIP",
        "cli.without_device:compare",
        "cli.without_device:CompareJob",
        examples=("solari-vk compare picture.exr reference.exr",),
    ),
    Command(
        "settings",
        "list the settings and qualities, with meaning, range and default",
        "cli.without_device:settings",
        NoOptions,
        examples=("solari-vk settings",),
    ),
    Command(
        "views",
        "list the debug views, with meaning",
        "cli.without_device:views",
        NoOptions,
        examples=("solari-vk views",),
    ),
    Command(
        "info",
        "what this machine can do, what is missing, and the command that mends it",
        "cli.info:run",
        NoOptions,
        aliases=("doctor",),
        examples=("solari-vk info",),
    ),
    Command(
        "completion",
        "print a script that completes words in bash, zsh or fish",
        "cli.completion:run",
        "cli.completion:CompletionJob",
        examples=('eval "$(solari-vk completion bash)"', "solari-vk completion fish"),
    ),
    Command(
        "lab",
        "measure renderers and drivers: bench, trial, fidelity, conformance",
        "",
        LabOptions,
        examples=("solari-vk lab bench --help", "solari-vk lab conformance"),
    ),
    *(replace(command, hidden=True) for command in LAB),
)

ANIMATION = "data.cli.animation:run"
"""Renders animations with several devices, a shutter, or by the path tracer."""
SENSOR = "data.sensors.sensor:Sensor"
"""The camera model that makes the raw numbers of --sensor."""
WHY_NO_WINDOW = "studio.viewer.window:why_none_opens"
