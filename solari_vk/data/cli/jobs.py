"""What the commands of data sets are asked to do: see cli/options.py."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from solari_vk.cli.jobs import ANIMATION_AVERAGE, SharedPicture
from solari_vk.cli.options import count, flag, option, positive, words


@dataclass(frozen=True, kw_only=True)
class DatasetJob(SharedPicture):
    """Many views of a scene, for learning from pictures."""

    DESCRIPTION: ClassVar = (
        "Render many views of a scene into a folder, with transforms.json in the convention of NeRF. All views have "
        "one exposure, unless a file of poses gives theirs. The command goes on where it was stopped."
    )
    FIRST: ClassVar = (
        "output", "views", "size", "samples", "aov", "annotations", "labels", "randomize", "format", "environment",
    )  # fmt: skip
    GROUPS: ClassVar = {
        "realtime": ("view", "quality", "settings", "warm_up", "average"),
        "several devices": ("workers", "cluster", "shared_folder"),
    }

    output: Path = option("made if it isn't there", "FOLDER", names=("-o", "--output"), type=Path, required=True)
    views: int | None = option("the number of views (all poses of a file)", "N", type=positive)
    cameras: str = option(
        "around the scene; places all around an object, or in a room; the cameras of the scene's file (the word file), "
        "or some of them by name; or a JSON file: a list of poses, or a transforms.json (orbit)",
        "orbit|random|file|NAMES|FILE",
        default="orbit",
    )
    mode: str = option(
        "the path tracer, or realtime lighting, which has motion vectors (reference)",
        choices=("reference", "realtime"),
        default="reference",
    )
    aov: tuple[str, ...] = option(
        "more outputs: layers of .exr or .npz files, otherwise .npy files; such as depth, shading_normal, instance_id, "
        "albedo, variance; in realtime mode guides_motion, error",
        "A,B",
        type=words,
        default=(),
    )
    format: str = option("of the pictures (png)", choices=("png", "jpg", "exr", "npz", "npy"), default="png")
    colmap: bool = flag("write the cameras as COLMAP's text files too, into the folder sparse/0")
    labels: Path | None = option(
        'the classes of instances: a JSON file such as {"Chair*": "chair"}, by patterns of names; null takes away a '
        "class that the scene's file gives",
        "FILE",
        type=Path,
    )
    annotations: tuple[str, ...] = option(
        "labels of instances that have a class: coco (annotations.json: boxes and masks), yolo (boxes: a text file for "
        "each picture), objects (boxes in space, poses and the share that is seen: NUMBER.objects.json), bop (a folder "
        "in the format of that benchmark)",
        "coco,yolo,objects,bop",
        type=words,
        default=(),
    )
    classes: tuple[str, ...] = option(
        "the classes in the order of their numbers, for data sets of several scenes (those that are there, by the "
        "alphabet)",
        "A,B",
        type=words,
        default=(),
    )
    sensor: str | None = option(
        "write the raw digital numbers of an image sensor too, NUMBER.raw.npy: fields of Sensor as JSON, such as "
        '{"iso": 400, "bayer": "RGGB"}, or in a file',
        "JSON|FILE",
    )
    keypoints: Path | None = option(
        "named points of instances for the annotations coco and objects: a JSON file such as "
        '{"Chair*": {"seat": [0, 0.4, 0]}}',
        "FILE",
        type=Path,
    )
    randomize: Path | None = option(
        "what is random in each view: a .yaml file of ranges, or a .py file with a function randomize(scene, random, "
        "number)",
        "FILE",
        type=Path,
    )
    shards: int | None = option("write the files of N views each into tar files too (WebDataset)", "N", type=positive)
    time: float | None = option("pose the scene as it is S seconds into its animation", "S", type=float)
    samples: int = option("samples per pixel (64)", "N", type=positive, default=64)
    max_bounces: int = option("surfaces that a path may leave (16)", "N", type=count, default=16)
    denoise: bool = flag("denoise by Intel Open Image Denoise")
    time_limit: float | None = option(
        "stop after this many seconds of rendering, with exit code 1 if views are missing", "S", type=float
    )
    warm_up: int = option("frames that let light accumulate first (16)", "N", type=count, default=16)
    average: int = option(
        f"each picture is the mean of N frames ({ANIMATION_AVERAGE})", "N", type=positive, default=ANIMATION_AVERAGE
    )
