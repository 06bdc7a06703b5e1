"""Data sets of views: cameras around or in a scene, and `transforms.json` in the convention of NeRF.

Mildenhall et al., "NeRF: Representing Scenes as Neural Radiance Fields for View Synthesis" (2020); the fields are those
of instant-ngp and Nerfstudio: world from camera as in OpenGL, which looks along -z with +y up, and the lens in pixels.
"""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.base.files import read_json, remove_unfinished, write_whole
from solari_vk.data.datasets.tasks import Style, View
from solari_vk.output.animation import MAX_CAMERAS, orbit
from solari_vk.scene.files.colmap import MODELS
from solari_vk.scene.matrices import is_rotation
from solari_vk.scene.model import Camera, Scene
from solari_vk.scene.presenting.enclosures import extent, find_room, trace
from solari_vk.scene.presenting.framing import ROOM_FOV, fit

LOWEST, HIGHEST = math.radians(5), math.radians(75)  # of random cameras above the horizon
INSIDE = 0.7  # of the way from a room's center to what is there, random cameras stay within
LEAST_APART = 1.0  # the two places that decide on a camera in a room, relative to the first one's distance
NAME = "transforms.json"
TERMS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")  # of OpenCV's distortion, in its order
FISHEYE_TERMS = ("k1", "k2", "k3", "k4")  # of cv::fisheye
Floats = NDArray[np.float64]


def cameras_for(kind: str, scene: Scene, camera: Camera, count: int | None, aspect: float, seed: int) -> list[Camera]:
    """The cameras of a data set.

    kind: "orbit", once around the scene from `camera`; "random", where a seed and a camera's number mean one place, so
    that a longer list begins with a shorter one; "file", or names with commas between, for the scene's own cameras; or
    a JSON file of poses. count: the number of cameras; None for all of a scene or a file. aspect: width / height of the
    pictures. Raises SolariError for a file that can't be read, for fewer cameras, and without a count.
    """
    if are_named(kind, scene):
        return _own_cameras(kind, scene, count)
    if kind not in ("orbit", "random"):
        return _read_poses(Path(kind), count, aspect)
    if count is None:
        raise SolariError(f"--cameras {kind}: give the number of views by --views")
    if count > MAX_CAMERAS:
        raise SolariError(f"--views {count}: a data set has at most {MAX_CAMERAS:,} views")
    if kind == "orbit":
        return orbit(camera, scene.bounds.center, count)
    return _random_cameras(scene, count, aspect, seed)


def are_named(kind: str, scene: Scene) -> bool:
    """Whether `kind` means cameras of the scene's own."""
    if kind in ("orbit", "random", "file"):
        return kind == "file"
    return all(name in scene.cameras for name in kind.split(","))


def _own_cameras(kind: str, scene: Scene, count: int | None) -> list[Camera]:
    cameras = list(scene.cameras) if kind == "file" else [scene.cameras[name] for name in kind.split(",")]
    if not cameras:
        raise SolariError(f"--cameras file: {scene.describe()} has no camera of its own")
    if (count or 0) > len(cameras):
        raise SolariError(f"--cameras {kind}: that is {len(cameras)} cameras, --views asks for {count}")
    return [copy.copy(camera) for camera in cameras[:count]]


def _random_cameras(scene: Scene, count: int, aspect: float, seed: int) -> list[Camera]:
    """Cameras in a room, if the scene is one, otherwise all around the scene and above its ground."""
    shown = [instance for instance in scene if instance.visible and instance is not scene.backdrop]
    if not shown:
        raise SolariError(f"--cameras random: {scene.describe()} has no visible instance")
    # A room is seen from inside; around it there would be only walls.
    points = extent(shown)
    room = find_room(shown, points)
    # A generator for each number: a camera doesn't depend on how many come before it.
    randoms = (np.random.default_rng((seed, number)) for number in range(count))
    if room is None:
        return [fit(points, np.array(_from_above(random)), aspect) for random in randoms]
    return [_in_room(room.center, room.triangles, random) for random in randoms]


def _from_above(random: np.random.Generator) -> tuple[float, float, float]:
    """A view direction, uniform over the part of the sphere between LOWEST and HIGHEST."""
    # Archimedes: on a sphere, equal steps in height are equal areas.
    turn = random.uniform(0, 2 * math.pi)
    height = random.uniform(math.sin(LOWEST), math.sin(HIGHEST))
    across = math.sqrt(1 - height * height)
    return across * math.sin(turn), -height, across * math.cos(turn)


def _in_room(center: Floats, triangles: Floats, random: np.random.Generator) -> Camera:
    """A camera between the center of a room and a place on its walls or on what stands in it, towards another one."""
    near = far = np.zeros(3)
    count = 0
    # Two places that follow each other and are far enough apart. Normal numbers give a uniform direction.
    while count < 2 or np.linalg.norm(far - near) < LEAST_APART * np.linalg.norm(near - center):
        direction = random.normal(size=3)
        direction /= np.linalg.norm(direction)
        distance = float(trace(center, direction[None], triangles).distance[0])
        if math.isfinite(distance):  # no window or door
            near, far = far, center + distance * direction
            count += 1
    # The cube root makes places uniform in the volume of a cone from the center.
    eye = center + INSIDE * random.uniform() ** (1 / 3) * (near - center)
    return Camera.look_at(eye, far, vertical_fov=ROOM_FOV, near=max(1e-3 * float(np.linalg.norm(far - eye)), 1e-9))


def _read_poses(path: Path, count: int | None, aspect: float) -> list[Camera]:
    content = read_json(
        path, f"--cameras {path}: neither orbit, random nor file, nor a camera's name, nor a JSON file of poses"
    )
    poses = _poses_of_nerf(content, path, aspect) if isinstance(content, dict) else content
    if not isinstance(poses, list) or not poses:
        raise SolariError(f"--cameras {path}: must be a JSON list of poses, or have the fields of {NAME}")
    if min(len(poses), count or len(poses)) > MAX_CAMERAS:
        raise SolariError(
            f"--cameras {path}: it has {len(poses):,} poses, of which at most {MAX_CAMERAS:,} are read: give --views"
        )
    if count is not None and count > len(poses):
        raise SolariError(f"--cameras {path}: it has {len(poses)} poses, --views asks for {count}")
    cameras = []
    for number, pose in enumerate(poses[:count]):
        try:
            cameras.append(Camera.from_pose(pose))
        except SolariError as error:
            raise SolariError(f"--cameras {path}: pose {number}: {error}") from None
    return cameras


def _poses_of_nerf(content: dict[str, Any], path: Path, aspect: float) -> list[dict[str, Any]]:
    """Poses as Camera.from_pose takes them, of a file such as `write_transforms` writes."""
    try:
        poses: list[dict[str, Any]] = []
        # Nerfstudio: what led from the world of the pictures' program, and of its meshes, to that of the poses.
        applied = _applied(content)
        for frame in content["frames"]:
            # Fields of the lens stand once for all frames, or in each frame, which then counts.
            lens = {**content, **frame}
            matrix = np.array(frame["transform_matrix"], np.float64)
            if matrix.shape == (3, 4):
                matrix = np.vstack([matrix, (0, 0, 0, 1)])
            world = np.linalg.solve(applied, matrix)
            lengths = np.linalg.norm(world[:3, :3], axis=0)
            if not (lengths.min() > 0 and lengths.max() < np.inf):  # also for NaN
                raise ValueError(f"frame {len(poses)}: transform_matrix has axes of the lengths {lengths.tolist()}")
            world[:3, :3] /= lengths
            if not is_rotation(world[:3, :3]):
                raise ValueError(
                    f"frame {len(poses)}: transform_matrix isn't a rotation and a place: the axes are sheared or "
                    "left-handed, which would mirror the picture; export right-handed ones as OpenGL has them"
                )
            pose = {"transform": world.tolist(), **_lens_of_nerf(lens)}
            fov = _vertical_fov(lens, pose.get("projection", "perspective"), aspect)
            pose["vertical_fov_degrees"] = math.degrees(fov)
            if "ev100" in frame:
                pose["ev100"] = frame["ev100"]
            poses.append(pose)
        return poses
    except (KeyError, TypeError, ValueError, ArithmeticError) as error:
        raise SolariError(f"--cameras {path}: it lacks a field of {NAME}, or has a wrong one: {error}") from None


def _applied(content: dict[str, Any]) -> Floats:
    """The matrix (4, 4) that a file's `applied_transform` and `applied_scale` mean."""
    given = np.array(content.get("applied_transform", np.eye(4)), np.float64)
    scale = float(content.get("applied_scale", 1))
    if not 0 < scale < math.inf:
        raise ValueError(f"applied_scale is {scale}, not above 0")
    fits = given.shape in ((3, 4), (4, 4)) and np.isfinite(given).all() and (given[3:] == (0, 0, 0, 1)).all()
    # A rotation's three columns have the length 1.
    own_scale = np.linalg.norm(given[:3, :3]) / math.sqrt(3) if fits else 0
    if not own_scale > 0 or not is_rotation(given[:3, :3] / own_scale):
        raise ValueError("applied_transform isn't a rotation, a scale above 0 and a shift, as (3, 4) or (4, 4) numbers")
    return np.vstack([scale * given[:3], (0, 0, 0, 1)])


def _vertical_fov(lens: dict[str, Any], projection: str, aspect: float) -> float:
    """The vertical field of view in radians.

    The files of the paper have neither focal lengths nor a size, only the horizontal field of view: then the pictures
    have the aspect that was asked for.
    """
    # An angle of an equidistant fisheye lens is a length over the focal length; a perspective camera has the tangent.
    is_fisheye = projection == "fisheye"
    if "fl_x" in lens or "fl_y" in lens:
        length = lens["fl_y"] if "fl_y" in lens else lens["fl_x"]
        return float(lens["h"] / length if is_fisheye else 2 * math.atan(lens["h"] / (2 * length)))
    if projection == "equirectangular":
        return math.pi  # without effect: such a picture shows all directions
    if is_fisheye:
        return float(lens["camera_angle_x"] * lens["h"] / lens["w"])
    across = lens["w"] / lens["h"] if "w" in lens else aspect
    return 2 * math.atan(math.tan(lens["camera_angle_x"] / 2) / across)


def _lens_of_nerf(lens: dict[str, Any]) -> dict[str, Any]:
    """The fields of a pose that a frame's camera model, principal point and distortion mean."""
    model = lens.get("camera_model", "OPENCV")
    if model == "EQUIRECTANGULAR":
        return {"projection": "equirectangular"}
    if model not in MODELS or MODELS[model].must_be_0:
        known = ", ".join(name for name, one in MODELS.items() if not one.must_be_0)
        raise ValueError(f"camera_model is {model!r}, not one of {known}, EQUIRECTANGULAR")
    fisheye = MODELS[model].is_fisheye
    found: dict[str, Any] = {"projection": "fisheye"} if fisheye else {}
    if "cx" in lens and "cy" in lens:
        found["principal_point"] = lens["cx"] / lens["w"], lens["cy"] / lens["h"]
    if "fl_x" in lens and "fl_y" in lens:
        found["pixel_aspect"] = lens["fl_x"] / lens["fl_y"]
    found["distortion"] = [float(lens.get(name, 0.0)) for name in (FISHEYE_TERMS if fisheye else TERMS)]
    return found


def views_of(cameras: Sequence[Camera], suffix: str) -> list[View]:
    """Numbered views of the cameras. Raises SolariError for a camera that transforms.json can't describe."""
    for number, camera in enumerate(cameras):
        if camera.orthographic_height or camera.projection in ("stereographic", "cube") or len(camera.distortion) > 8:
            kind = "orthographic" if camera.orthographic_height else camera.projection
            raise SolariError(
                f"view {number}: {camera.describe()} is {kind}: {NAME} describes perspective, fisheye "
                "and equirectangular ones, without thin prism distortion"
            )
        if camera.projection != cameras[0].projection:
            raise SolariError(
                f"view {number}: {camera.describe()} is {camera.projection} and view 0 isn't: {NAME} has "
                "one camera_model"
            )
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
        # Readers take the upper left part for a rotation, so a camera's scale is left out.
        transform = camera.transform.copy()
        transform[:3, :3] /= np.linalg.norm(transform[:3, :3], axis=0)
        beside = style.files_of(view)[1:]
        frames.append(
            {
                "file_path": view.name,
                "transform_matrix": transform.tolist(),
                **_nerf_lens(camera, style.size),
                "exposure": camera.exposure,
                "ev100": camera.ev100,
                "layer_paths": dict(zip(style.layers, beside, strict=False)),
            }
        )
    model = {"fisheye": "OPENCV_FISHEYE", "equirectangular": "EQUIRECTANGULAR"}
    shared = _nerf_lens(views[0].camera, style.size)
    return {
        "camera_model": model.get(views[0].camera.projection, "OPENCV"),
        "w": width,
        "h": height,
        **shared,
        "layers": list(style.layers),
        "frames": frames,
    }


def _nerf_lens(camera: Camera, size: tuple[int, int]) -> dict[str, float]:
    """Focal lengths and principal point in pixels, where the first pixel's center is (0.5, 0.5), and distortion."""
    if camera.projection == "equirectangular":
        return {}
    (fx, _, cx), (_, fy, cy), _ = camera.intrinsics(size).tolist()
    # `intrinsics` counts from the first pixel's center as OpenCV does; instant-ngp counts from its corner.
    lens = {"fl_x": fx, "fl_y": fy, "cx": cx + 0.5, "cy": cy + 0.5}
    names = FISHEYE_TERMS if camera.projection == "fisheye" else TERMS
    if camera.projection == "perspective":
        lens["camera_angle_x"] = 2 * math.atan(size[0] / (2 * fx))
    terms = [*camera.distortion.tolist(), *[0.0] * len(names)][: len(names)]
    # Many readers know the first four terms only, so the others stand in the file where they have an effect.
    if not any(terms[4:]):
        names, terms = names[:4], terms[:4]
    return lens | dict(zip(names, terms, strict=True))
