"""`solari-vk dataset`: many views of a scene, with their cameras, for learning from pictures."""

from __future__ import annotations

import dataclasses
import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.base.files import make_folder, read_json, write_whole
from solari_vk.cli.devices import open_pool
from solari_vk.cli.loading import LoadedScene, check_aovs, load_scene, set_exposure
from solari_vk.cli.progress import check_time_limit
from solari_vk.cli.realtime import check_parts
from solari_vk.data.annotate.keypoints import find_keypoints
from solari_vk.data.cli.annotations import ANNOTATIONS, AnnotationWriter, write_shards
from solari_vk.data.cli.rendering import metered, render_files
from solari_vk.data.cluster import RenderTask, Style, View, blocks
from solari_vk.data.datasets.dataset import are_named, cameras_for, views_of, write_transforms
from solari_vk.data.datasets.journal import open_journal
from solari_vk.data.datasets.tasks import FLOW, FLOW_BACK, KEYPOINTS, RAW, SILHOUETTES, TRACED
from solari_vk.data.randomize.randomizer import Randomizer
from solari_vk.data.sensors.sensor import Sensor
from solari_vk.output import oidn
from solari_vk.output.annotations import Annotations, instance_table
from solari_vk.scene.files.colmap import check_colmap, save_colmap
from solari_vk.scene.labels import find_labels
from solari_vk.scene.objects import objects_of

if TYPE_CHECKING:
    from solari_vk.data.cli.jobs import DatasetJob
    from solari_vk.scene.model import Camera, Scene

METERED = 8  # views whose mean exposure is that of all
FLOWS = {FLOW, FLOW_BACK}
BOP_SPLITS = {"png": "train", "jpg": "train_pbr"}  # where bop_toolkit looks for such pictures
JOURNAL = "views.jsonl"
COLMAP = Path("sparse", "0")
INSTANCES = "instances.json"


def run(job: DatasetJob) -> int:
    """Render the views that aren't in the folder yet; returns the exit code, 1 if some are missing."""
    check_time_limit(job.time_limit)
    randomizer = None if job.randomize is None else Randomizer.load(job.randomize, job.seed)
    if randomizer is not None:
        job = dataclasses.replace(job, seed=randomizer.seed)  # of cameras and noise too
    style = _style(_with_layers(job), randomizer)
    folder = job.output.resolve()
    make_folder(folder)
    loaded = load_scene(job, time=job.time, seen_all_round=job.cameras == "orbit")
    # The cameras are placed before the randomizer adds objects, so that they look at the scene and not at distractors.
    found, metered_numbers = _cameras(loaded, job)
    cameras = found[: job.views]
    if randomizer is not None:
        randomizer.prepare(loaded.scene)
    labels = _label_instances(job, style, loaded.scene)
    style, keypoints = _with_keypoints(job, style, loaded.scene)
    writer = None
    if job.annotations:
        writer = _annotation_writer(job, style, loaded.scene, labels, keypoints)
        writer.check(job.annotations, cameras)
    with open_pool(job) as pool:
        # Poses of a file may have exposures, which --exposure overrides.
        keeps = job.exposure is None and job.cameras not in ("orbit", "random")
        unexposed = [camera for camera in cameras if not (keeps and camera.has_exposure)]
        ev100 = loaded.cameras[0].ev100
        if unexposed and loaded.auto_exposure:
            shown = [found[number] for number in metered_numbers]
            ev100 = metered(pool, loaded, shown, job.size, randomizer, metered_numbers)
        set_exposure(unexposed, ev100)
        exposure = f"EV100 {ev100:.2f}" if unexposed else "with the exposures of their poses"
        _randomize_cameras(cameras, randomizer)
        print(f"{len(cameras)} views of {job.source}, {exposure}", file=sys.stderr)
        views = _views(job, style, cameras)
        are_alone = job.cameras == "random" or are_named(job.cameras, loaded.scene) or randomizer is not None
        tasks = _tasks(style, views, are_alone)
        # The journal is opened before any file is written: it refuses a folder that holds another data set.
        journal = open_journal(folder / JOURNAL, pool, loaded.scene, tasks)
        _write_tables(job, style, views, loaded.scene, labels)
        if not render_files(pool, loaded.scene, tasks, journal, job):
            return 1
    if writer is not None:
        writer.write(job.annotations, views)
    if job.shards is not None:
        write_shards(folder, job.shards)
    return 0


def _randomize_cameras(cameras: list[Camera], randomizer: Randomizer | None) -> None:
    """Change the cameras as a recipe has them: their exposure too, and so after it is set."""
    if randomizer is not None:
        for number, camera in enumerate(cameras):
            randomizer.camera(camera, number)


def _label_instances(job: DatasetJob, style: Style, scene: Scene) -> dict[int, str]:
    """The classes of all instances, by their numbers: those of --labels, or else their own. A pattern of --labels may
    also say which instances are parts of one object."""
    instances = dict(enumerate(scene.instances))
    labels = {number: instance.label for number, instance in instances.items()}
    if job.labels is None:
        return labels
    found = find_labels(style.objects(scene), job.labels, scene.backdrop)
    for number, instance in instances.items():
        if instance in found:
            labels[number], whole = found[instance]
            if whole is not None:
                instance.part_of = whole
    return labels


def _with_keypoints(job: DatasetJob, style: Style, scene: Scene) -> tuple[Style, dict[int, tuple[str, ...]]]:
    """The style with the points of --keypoints, and the names of each instance's points."""
    points = {} if job.keypoints is None else read_json(job.keypoints, f"--keypoints {job.keypoints}")
    found = find_keypoints(style.objects(scene), points)
    names = {number: tuple(found[instance]) for number, instance in enumerate(scene.instances) if instance in found}
    return dataclasses.replace(style, points=json.dumps(points)), names


def _annotation_writer(
    job: DatasetJob, style: Style, scene: Scene, labels: dict[int, str], keypoints: dict[int, tuple[str, ...]]
) -> AnnotationWriter:
    instances = dict(enumerate(scene.instances))
    annotations = Annotations(labels, keypoints, objects_of(instances, labels), job.classes or None)
    return AnnotationWriter(
        job.output.resolve(), annotations, instances, style, scene, split=BOP_SPLITS.get(job.format, "")
    )


def _views(job: DatasetJob, style: Style, cameras: list[Camera]) -> list[View]:
    """The views of the cameras. Raises SolariError for cameras that a format of the data set can't describe."""
    views = views_of(cameras, f".{job.format}")
    if job.colmap:
        check_colmap(cameras, job.size)
    if not FLOWS & set(style.layers):
        return views
    # The first and the last view have a neighbor on one side only; their flow to the other side is "outside".
    neighbors = [None, *cameras, None]
    return [
        dataclasses.replace(view, before=neighbors[number], after=neighbors[number + 2])
        for number, view in enumerate(views)
    ]


def _write_tables(job: DatasetJob, style: Style, views: list[View], scene: Scene, labels: dict[int, str]) -> None:
    """Write what describes the whole data set: cameras, and the names and classes of instances."""
    folder = job.output.resolve()
    write_transforms(folder, style, views)
    if job.colmap:
        save_colmap(folder / COLMAP, [view.camera for view in views], job.size, [view.name for view in views])
    if "instance_id" in style.layers:
        instances = dict(enumerate(scene.instances))
        write_whole(folder / INSTANCES, json.dumps(instance_table(instances, labels)))


def _with_layers(job: DatasetJob) -> DatasetJob:
    """The job with the outputs that its annotations need."""
    needed = list[str]()
    for name in job.annotations:
        if name not in ANNOTATIONS:
            raise SolariError(f"--annotations {name}: take some of {', '.join(ANNOTATIONS)}")
        needed += ANNOTATIONS[name]
    # All options are checked here, before a scene is loaded or a device is opened.
    _check_formats(job, needed)
    if job.labels is not None and "instance_id" not in (*job.aov, *needed):
        raise SolariError("--labels: are part of --annotations and --aov instance_id: give one of them")
    if job.keypoints is not None:
        if not {"coco", "objects"} & set(job.annotations):
            raise SolariError("--keypoints: are part of --annotations coco or objects: give one of them")
        needed.append(KEYPOINTS)
    return dataclasses.replace(job, aov=tuple(dict.fromkeys((*job.aov, *needed))))


def _check_formats(job: DatasetJob, needed: list[str]) -> None:
    """Raise SolariError for outputs that can't be written beside pictures of the job's format."""
    # .exr and .npz files hold all layers of a view, and have no place for runs of pixels and lists of points.
    whole = job.format in ("exr", "npz")
    if whole and (needed or SILHOUETTES in job.aov):
        raise SolariError("--annotations, --aov silhouettes: are .npy files: give --format png, jpg or npy")
    if "bop" in job.annotations and job.format not in BOP_SPLITS:
        raise SolariError("--annotations bop: its pictures are .png or .jpg files: give --format png or jpg")
    if FLOWS & set(job.aov) and (job.randomize is not None or whole):
        raise SolariError(
            "--aov optical_flow: leads from one view to the next of one scene, and is an .npy file: "
            "leave --randomize out, and give --format png, jpg or npy"
        )


def _style(job: DatasetJob, randomizer: Randomizer | None) -> Style:
    """How views are rendered. Raises SolariError for options that contradict each other."""
    style = dataclasses.replace(_renderer_style(job), randomizer=randomizer)
    if job.sensor is not None:
        style = dataclasses.replace(style, sensor=Sensor.load(job.sensor), layers=(*style.layers, RAW))
    return style


def _renderer_style(job: DatasetJob) -> Style:
    """The style by what the renderer does, without randomizer and sensor."""
    if job.view != "picture":
        raise SolariError(f"--view {job.view}: a data set has pictures of light: see --aov")
    if job.mode == "reference":
        check_aovs(job.aov, job.mode, (*sv.PathTracer.OUTPUTS[1:], *TRACED))
        if job.denoise:
            oidn.check_installed()
        return Style(
            job.size,
            job.seed,
            job.aov,
            job.tonemap,
            samples=job.samples,
            max_bounces=job.max_bounces,
            denoise=job.denoise,
        )
    if job.denoise:
        raise SolariError("--denoise: is an option of --mode reference: give --settings denoise=on")
    settings = job.make_settings()
    check_parts([name for name in job.aov if name not in TRACED], job.size, settings)
    return Style(job.size, job.seed, job.aov, job.tonemap, settings=settings, frames=job.average, warm_up=job.warm_up)


def _tasks(style: Style, views: list[View], are_alone: bool) -> list[RenderTask]:
    """Each view alone; or, of cameras that follow a path in realtime mode, blocks, whose motion is that of the path."""
    if style.settings is not None and not are_alone:
        return blocks(style, views)
    # Views that don't follow each other have no common history: each warms up by itself.
    warm_up = style.warm_up if style.settings is not None else 0
    return [RenderTask(style, number, (view,), (view,) * warm_up) for number, view in enumerate(views)]


def _cameras(loaded: LoadedScene, job: DatasetJob) -> tuple[list[Camera], list[int]]:
    """The cameras of the views, and perhaps more, and the numbers of those whose exposures are measured.

    At random places these are the first ones of the seed, used or not, so that any number of views has one exposure.
    """
    is_random = job.cameras == "random"
    most = max(job.views, METERED) if is_random and job.views is not None else job.views
    aspect = job.size[0] / job.size[1]
    found = cameras_for(job.cameras, loaded.scene, loaded.cameras[0], most, aspect, job.seed)
    # Of cameras along a path, METERED at the most, evenly spread.
    step = 1 if is_random else math.ceil(len(found) / METERED)
    return found, list(range(len(found)))[::step][:METERED]
