"""Data sets of views: cameras around or in a scene, and `transforms.json` in the convention of NeRF.

Mildenhall et al., "NeRF: Representing Scenes as Neural Radiance Fields for View Synthesis" (2020); the fields are those
of instant-ngp and Nerfstudio: world from camera as in OpenGL, which looks along -z with +y up, and the lens in pixels.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.cluster.tasks import Style, View
from solari_vk.errors import SolariError
from solari_vk.files import read_json, remove_unfinished, write_whole
from solari_vk.output.animation import MAX_CAMERAS, orbit
from solari_vk.scene.enclosures import extent, find_room, trace
from solari_vk.scene.framing import ROOM_FOV, fit
from solari_vk.scene.model import Camera, Scene

LOWEST, HIGHEST = math.radians(5), math.radians(75)  # of random cameras above the horizon
INSIDE = 0.7  # of the way from a room's center to what is there, random cameras stay within
LEAST_APART = 1.0  # the two places that decide on a camera in a room, relative to the first one's distance
NAME = "transforms.json"
Floats = NDArray[np.float64]


def cameras_for(kind: str, scene: Scene, camera: Camera, count: int | None, aspect: float, seed: int) -> list[Camera]:
    """The cameras of a data set.

    kind: "orbit", once around the scene from `camera`; "random", where a seed and a camera's number mean one place, so
    that a longer list begins with a shorter one; or a JSON file of poses. count: the number of cameras; None for all of
    a file. aspect: width / height of the pictures. Raises SolariError for a file that can't be read or has fewer poses,
    and without a count.
    """
    if kind not in ("orbit", "random"):
        return _read_poses(Path(kind), count, aspect)
    if count is None:
        raise SolariError(f"--cameras {kind}: give the number of views by --views")
    if count > MAX_CAMERAS:
        raise SolariError(f"--views {count}: a data set has at most {MAX_CAMERAS:,} views")
    if kind == "orbit":
        return orbit(camera, scene.bounds.center, count)
    shown = [instance for instance in scene if instance.visible and instance is not scene.backdrop]
    if not shown:
        raise SolariError(f"--cameras random: {scene.describe()} has no visible instance")
    points = extent(shown)
    room = find_room(shown, points)
    randoms = (np.random.default_rng((seed, number)) for number in range(count))
    if room is None:
        return [fit(points, _from_above(random), aspect) for random in randoms]
    return [_in_room(room.center, room.triangles, random) for random in randoms]


def _from_above(random: np.random.Generator) -> tuple[float, float, float]:
    """A view direction, uniform over the part of the sphere between LOWEST and HIGHEST."""
    turn = random.uniform(0, 2 * math.pi)
    height = random.uniform(math.sin(LOWEST), math.sin(HIGHEST))
    across = math.sqrt(1 - height * height)
    return across * math.sin(turn), -height, across * math.cos(turn)


def _in_room(center: Floats, triangles: Floats, random: np.random.Generator) -> Camera:
    """A camera between the center of a room and a place on its walls or on what stands in it, towards another one."""
    near, far, places = np.zeros(3), np.zeros(3), list[Floats]()
    while len(places) < 2 or np.linalg.norm(far - near) < LEAST_APART * np.linalg.norm(near - center):
        direction = random.normal(size=3)
        direction /= np.linalg.norm(direction)
        distance = float(trace(center, direction[None], triangles).distance[0])
        if math.isfinite(distance):  # no window or door
            near, far = far, center + distance * direction
            places.append(far)
    eye = center + INSIDE * random.uniform() ** (1 / 3) * (near - center)
    return Camera.look_at(eye, far, vertical_fov=ROOM_FOV, near=max(1e-3 * float(np.linalg.norm(far - eye)), 1e-9))


def _read_poses(path: Path, count: int | None, aspect: float) -> list[Camera]:
    given = read_json(path, f"--cameras {path}: neither orbit nor random, nor a JSON file of poses")
    poses = _poses_of_nerf(given, path, aspect) if isinstance(given, dict) else given
    if not isinstance(poses, list) or not poses:
        raise SolariError(f"--cameras {path}: must be a JSON list of poses, or have the fields of {NAME}")
    if min(len(poses), count or len(poses)) > MAX_CAMERAS:
        raise SolariError(f"--cameras {path}: it has {len(poses):,} poses, of which at most {MAX_CAMERAS:,} are read: "
                          "give --views")
    if count is not None and count > len(poses):
        raise SolariError(f"--cameras {path}: it has {len(poses)} poses, --views asks for {count}")
    cameras = []
    for number, pose in enumerate(poses[:count]):
        try:
            cameras.append(Camera.from_pose(pose))
        except SolariError as error:
            raise SolariError(f"--cameras {path}: pose {number}: {error}") from None
    return cameras


def _poses_of_nerf(given: dict[str, Any], path: Path, aspect: float) -> list[dict[str, Any]]:
    """Poses as Camera.from_pose takes them, of a file such as `write_transforms` writes.

    The files of the paper have neither focal lengths nor a size, only the horizontal field of view: then the pictures
    have the aspect that was asked for.
    """
    try:
        poses = []
        for frame in given["frames"]:
            lens = {**given, **frame}
            if "fl_x" in lens or "fl_y" in lens:
                slope = lens["h"] / (2 * (lens["fl_y"] if "fl_y" in lens else lens["fl_x"]))
            else:
                across = lens["w"] / lens["h"] if "w" in lens else aspect
                slope = math.tan(lens["camera_angle_x"] / 2) / across
            poses.append({"transform": frame["transform_matrix"],
                          "vertical_fov_degrees": math.degrees(2 * math.atan(slope))})  # fmt: skip
        return poses
    except (KeyError, TypeError, ValueError, ArithmeticError) as error:
        raise SolariError(f"--cameras {path}: it lacks a field of {NAME}, or has a wrong one: {error}") from None


def views_of(cameras: Sequence[Camera], suffix: str) -> list[View]:
    """Numbered views of the cameras. Raises SolariError for a camera that a pinhole doesn't describe."""
    for number, camera in enumerate(cameras):
        if camera.orthographic_height:
            raise SolariError(f"view {number}: {camera.describe()} is orthographic: {NAME} describes perspective ones")
    return [View(f"{number:05}{suffix}", camera) for number, camera in enumerate(cameras)]


def write_transforms(folder: Path, style: Style, views: Sequence[View]) -> None:
    """Write `transforms.json` for views in a folder; `layer_paths` of a frame names the files of its layers."""
    remove_unfinished(folder, [NAME])
    write_whole(folder / NAME, json.dumps(_transforms(style, views), indent=1))


def _transforms(style: Style, views: Sequence[View]) -> dict[str, Any]:
    width, height = style.size
    frames = []
    for view in views:
        camera = view.camera
        transform = camera.transform.copy()
        transform[:3, :3] /= np.linalg.norm(transform[:3, :3], axis=0)
        length = height / (2 * math.tan(camera.vertical_fov / 2))
        beside = style.files_of(view)[1:]
        frames.append({
            "file_path": view.name, "transform_matrix": transform.tolist(),
            "fl_x": length, "fl_y": length, "camera_angle_x": 2 * math.atan(width / (2 * length)),
            "exposure": camera.exposure, "layer_paths": dict(zip(style.layers, beside, strict=False)),
        })  # fmt: skip
    first = frames[0]
    return {
        "camera_model": "OPENCV", "w": width, "h": height, "cx": width / 2, "cy": height / 2,
        "fl_x": first["fl_x"], "fl_y": first["fl_y"], "camera_angle_x": first["camera_angle_x"],
        "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0, "layers": list(style.layers), "frames": frames,
    }  # fmt: skip
