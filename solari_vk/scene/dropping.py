"""Things that fall until they rest: by MuJoCo, a maintained engine of rigid bodies with wheels for all platforms.

It is part of the room `scene`, not of a wing for physics, because `Scene.drop` is a method of the scene, which must not
import wings: it reads meshes and writes transforms. The first call imports MuJoCo.

pybullet, the other candidate, has no wheels for current Pythons. MuJoCo's bodies are convex: what falls collides as its
convex hull, which contains the mesh, so that meshes don't meet either. What lies still is exact: a convex mesh is
itself, and of others each triangle is a slab behind its front.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.errors import SolariError, quoted
from solari_vk.scene import checks
from solari_vk.scene.bounds import bounds_of
from solari_vk.scene.group import Group
from solari_vk.scene.matrices import quaternion_rotation, transform_points
from solari_vk.scene.objects import Instance, objects_of

Floats = NDArray[np.float64]
SLAB = 0.05  # meters behind the front of a triangle that isn't part of a convex mesh
MARGIN = 4e-4  # meters, of which each of two things begins to push, so that nothing penetrates
STEP = 0.002  # seconds
SLOW = 0.02  # m/s or rad/s
RESTING = 50  # steps: things that are slow for so long count as resting
MOST_TRIANGLES = 5000
TRIES = 200  # of places for one thing in a layer
FRICTION = "0.8 0.02 0.005"  # sliding, turning, rolling
FLAT = 1e-5  # of a mesh's size, by which a convex mesh's vertices may stand before its planes


def drop(
    scene: Any,
    items: Sequence[Instance | Group | str],
    *,
    on: Sequence[Instance | Group | str] | None,
    region: ArrayLike | None,
    seed: int,
    upright: bool,
    seconds: float,
) -> None:
    """`Scene.drop`."""
    checks.check_whole("Scene.drop: seed", seed)
    try:
        checks.number(STEP, 1e5, "s")(seconds)
    except (TypeError, ValueError) as error:
        raise SolariError(f"Scene.drop: seconds {error}") from None
    falling = _falling_objects(scene, items)
    supports = scene.instances[:]
    if on is not None:
        supports = _instances_of(scene, _as_list(on))
    try:
        import mujoco
    except ImportError:
        raise SolariError('Scene.drop: needs MuJoCo: install it by "pip install solari-vk[physics]"') from None
    moved = {part for thing in falling for part in _parts_of(thing)}
    supports = [one for one in supports if one.visible and one not in moved]
    low, high = _region(region, supports)
    bodies = [_Body(thing) for thing in falling]
    _place(bodies, low, high, np.random.default_rng(seed), upright)
    still = _still(supports, high[1])
    poses = _simulate(mujoco, bodies, still, _document(bodies, [part for _, part in still], low, high), seconds)
    for body, pose in zip(bodies, poses, strict=True):
        # MuJoCo's quaternions have w first.
        w, x, y, z = pose[3:].tolist()
        body.apply(pose[:3], np.array(quaternion_rotation(x, y, z, w)))


def _falling_objects(scene: Any, items: Sequence[Instance | Group | str]) -> list[Sequence[Instance] | Group]:
    """What falls: each group, and each object with all its parts. Raises SolariError for what is named twice."""
    groups = [item for item in items if isinstance(item, Group)]
    grouped = _instances_of(scene, groups)
    alone = _instances_of(scene, [item for item in items if not isinstance(item, Group)])
    for instance, count in Counter(alone + grouped).items():
        if count > 1:
            raise SolariError(f"Scene.drop: {instance.describe()} is given twice: it falls once")
    numbered = dict(enumerate(alone))
    objects = [[numbered[part] for part in parts] for parts in objects_of(numbered).values()]
    return [*groups, *objects]


def _instances_of(scene: Any, items: Sequence[Instance | Group | str]) -> list[Instance]:
    """The instances of the scene that items are or hold."""
    found = list[Instance]()
    for item in items:
        instances = [one for one in _named_by(scene, item) if isinstance(one, Instance)]
        if not instances:
            raise SolariError(f"{scene.describe()}: drop takes instances, not {quoted(item)}")
        for instance in instances:
            if instance not in scene.instances:
                raise SolariError(f"Scene.drop: {instance.describe()} is not in the scene: add it first")
        found += instances
    return found


def _named_by(scene: Any, item: Instance | Group | str) -> Sequence[Any]:
    """What an item means: the parts of the object of this name, or the instance, or what a group holds."""
    if isinstance(item, str):
        parts = [instance for instance in scene.instances if instance.part_of == item]
        return parts or [scene.instances[item]]
    return _parts_of(item) if isinstance(item, Group) else [item]


def _as_list(on: Any) -> Sequence[Any]:
    """Several things, or one of them alone: a group, which one can iterate over too, and a name are one."""
    if isinstance(on, (Group, str)) or not np.iterable(on):
        return [on]
    return list(on)


def _parts_of(thing: Sequence[Instance] | Group) -> Sequence[Any]:
    return thing.items if isinstance(thing, Group) else thing


def _simulate(
    mujoco: Any, bodies: list[_Body], still: list[tuple[Instance, Floats]], document: str, seconds: float
) -> Floats:
    """The positions and quaternions (N, 7) in which bodies rest. Raises SolariError for those that don't."""
    # The height of each body's middle at which nothing of it can touch what lies still any more.
    lowest = min((part[:, 1].min() for _, part in still), default=math.inf)
    lost = np.array([lowest - body.radius for body in bodies])
    try:
        model = mujoco.MjModel.from_xml_string(document)
        data = mujoco.MjData(model)
        poses: Floats = data.qpos.reshape(-1, 7)  # a view, which each step changes
        quiet_steps = 0
        for _ in range(math.ceil(seconds / STEP)):
            mujoco.mj_step(model, data)
            # One quiet step isn't rest: a body is slow at the top of a bounce too.
            quiet_steps = quiet_steps + 1 if np.abs(data.qvel).max(initial=0.0) < SLOW else 0
            # Written so that a position of NaN ends the loop too.
            if quiet_steps >= RESTING or not (poses[:, 1] >= lost).all():
                break
    except (ValueError, mujoco.FatalError) as error:
        raise SolariError(_of_mujoco(str(error), bodies, still)) from None
    for body, pose, depth in zip(bodies, poses, lost, strict=True):
        if not pose[1] >= depth:
            raise SolariError(f"Scene.drop: {body.instance.describe()} fell through: nothing is below it in the region")
    if quiet_steps < RESTING:
        raise SolariError(
            f"Scene.drop: {len(bodies)} things don't rest after {seconds:g} s: give more seconds, or a larger region"
        )
    return poses.copy()


class _Body:
    """A thing that falls, of one part or several: their points about the middle of all, in the world's scale, and where
    it starts."""

    def __init__(self, thing: Sequence[Instance] | Group) -> None:
        self.group = thing if isinstance(thing, Group) else None
        self.parts = parts = [one for one in _parts_of(thing) if isinstance(one, Instance)]
        self.instance = parts[0]
        # Relative to the first part, so that far from the world's origin no digits are lost.
        start = self.instance.transform[:3, 3]
        hulls = [_points_from(part, start) for part in parts]
        points = np.concatenate(hulls)
        middle = (points.min(axis=0) + points.max(axis=0)) / 2
        self.middle = start + middle
        # MuJoCo makes no hull of a flat part: the thing is then one hull of all parts.
        if not all(_has_volume(hull) for hull in hulls):
            hulls = [points]
        self.hulls = [hull - middle for hull in hulls]
        self.radius = float(np.linalg.norm(points - middle, axis=1).max())
        if not _has_volume(points):
            raise SolariError(f"Scene.drop: {self.instance.describe()} is flat: only things with a volume fall")
        self.position = np.zeros(3)
        self.quaternion = np.array((0.0, 0.0, 0.0, 1.0))

    def apply(self, position: Floats, turn: Floats) -> None:
        move = np.eye(4)
        move[:3, :3] = turn
        move[:3, 3] = position - turn @ self.middle
        for thing in [self.group] if self.group is not None else self.parts:
            thing.transform = move @ thing.transform


def _points_from(part: Instance, start: Floats) -> Floats:
    """The different vertices of a part in its pose, relative to a point, with the world's axes and scale."""
    points = part.posed_mesh().positions.astype(np.float64) @ part.transform[:3, :3].T
    return np.unique(points + (part.transform[:3, 3] - start), axis=0)


def _has_volume(points: Floats) -> bool:
    # The smallest singular value is the extent along the direction in which points spread least.
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return len(points) >= 4 and bool(spread[-1] >= 1e-6 * spread[0])


def _of_mujoco(text: str, bodies: list[_Body], still: list[tuple[Instance, Floats]]) -> str:
    """MuJoCo's error, with the thing that it means by the name of a mesh."""
    who = f"{len(bodies)} things"
    named = re.search(r"(still|body)(\d+)", text)  # as `_document` names meshes
    if named:
        number = int(named[2])
        instance = still[number][0] if named[1] == "still" else bodies[number].instance
        who = instance.describe()
    return f"Scene.drop: {who}: MuJoCo can't move or hold this: {' '.join(text.split())}"


def _region(region: Any, supports: list[Instance]) -> tuple[Floats, Floats]:
    found = bounds_of(supports)
    if found is None:
        raise SolariError("Scene.drop: there is nothing to fall on: add a floor")
    try:
        corners = np.asarray([found.min, found.max] if region is None else region, np.float64)
        if corners.shape != (2, 3) or not np.isfinite(corners).all() or not (corners[0] <= corners[1]).all():
            raise ValueError
    except (TypeError, ValueError):
        raise SolariError(
            f"Scene.drop: region is a box, its lowest and its highest corner (2, 3) in meters, not {quoted(region)}"
        ) from None
    return corners[0], corners[1]


def _place(bodies: list[_Body], low: Floats, high: Floats, rng: np.random.Generator, upright: bool) -> None:
    """Random places in layers above the region, without overlaps: of spheres around the bodies."""
    bottom = high[1] + MARGIN
    layer: list[_Body] = []
    tallest = 0.0
    at = low
    for body in bodies:
        body.quaternion = _random_rotation(rng, upright)
        room = high - low - 2 * body.radius
        if not min(room[0], room[2]) > 0:
            raise SolariError(
                f"Scene.drop: {body.instance.describe()}, {2 * body.radius:.3g} m long, doesn't fit into "
                f"a region of {high[0] - low[0]:.3g} x {high[2] - low[2]:.3g} m"
            )
        # Seen from above, spheres of one layer mustn't overlap. Without a place among TRIES a new layer begins.
        for _ in range(TRIES):
            at = low + body.radius + rng.uniform(size=3) * room
            if all(math.dist(at[::2], other.position[::2]) > body.radius + other.radius + MARGIN for other in layer):
                break
        else:
            bottom += 2 * tallest + MARGIN
            layer = []
            tallest = 0.0
        body.position = np.array((at[0], bottom + body.radius, at[2]))
        layer.append(body)
        tallest = max(tallest, body.radius)


def _random_rotation(rng: np.random.Generator, upright: bool) -> Floats:
    """A uniformly distributed unit quaternion (x, y, z, w): four normal numbers, divided by their length (Marsaglia,
    1972), or two of them for rotations about the vertical axis."""
    numbers = rng.normal(size=2 if upright else 4)
    if upright:
        numbers = np.array((0, numbers[0], 0, numbers[1]))
    quaternion: Floats = numbers / np.linalg.norm(numbers)
    return quaternion


def _still(supports: list[Instance], top: float) -> list[tuple[Instance, Floats]]:
    """The points of convex parts of what lies still and isn't wholly above the region."""
    parts: list[tuple[Instance, Floats]] = []
    count = 0
    for instance in supports:
        mesh = instance.posed_mesh()
        points = transform_points(instance.transform, mesh.positions.astype(np.float64))
        corners = points[mesh.triangles]
        if np.linalg.det(instance.transform[:3, :3]) < 0:
            corners = corners[:, ::-1]  # a mirroring transform turns the winding order around
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(normals, axis=1)
        # What lies above the region, such as a ceiling, doesn't count. By default the region ends at the top of the
        # supports, where upper faces aren't below it but count.
        below = corners[..., 1].min(axis=1) <= top - MARGIN
        upward = (normals[:, 1] > 0) & (corners[..., 1].max(axis=1) <= top + MARGIN)
        keep = (area > 1e-12) & (below | upward)
        corners = corners[keep]
        normals = normals[keep] / area[keep, None]
        if not len(corners):
            continue
        if keep.all() and _is_convex(points, corners, normals):
            parts.append((instance, np.unique(points, axis=0)))
            continue
        count += len(corners)
        if count > MOST_TRIANGLES:
            raise SolariError(
                f"Scene.drop: more than {MOST_TRIANGLES:,} triangles, with those of "
                f"{instance.describe()}: give `on`, what to fall on, or simpler meshes"
            )
        behind = corners - SLAB * normals[:, None]
        parts += [(instance, part) for part in np.concatenate([corners, behind], axis=1)]
    return parts


def _is_convex(points: Floats, corners: Floats, normals: Floats) -> bool:
    """Whether a closed mesh is the hull of its points: none stands before the plane of a triangle."""
    # The matrix of all distances takes 8 bytes an entry, so larger meshes count as not convex.
    if len(corners) * len(points) > 4_000_000:
        return False
    size = float(np.ptp(points, axis=0).max())
    before = points @ normals.T - np.einsum("ti,ti->t", corners[:, 0], normals)
    has_volume = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[-1] > FLAT * size
    return bool(has_volume and before.max() <= FLAT * size)


def _numbers(values: ArrayLike) -> str:
    return " ".join(f"{number:.9g}" for number in np.ravel(values))


def _document(bodies: list[_Body], still: list[Floats], low: Floats, high: Floats) -> str:
    """The model as MuJoCo's XML. Planes around the region keep things in it."""
    assets: list[str] = []
    world: list[str] = []
    for number, points in enumerate(still):
        # Relative to their middle, because the text has nine digits of each coordinate.
        middle = points.mean(axis=0)
        assets.append(f'<mesh name="still{number}" inertia="shell" vertex="{_numbers(points - middle)}"/>')
        world.append(f'<geom type="mesh" mesh="still{number}" pos="{_numbers(middle)}"/>')
    # A plane's front is its +z: two turned ones at each corner face the inside along x and along z.
    for corner, turns in ((low, ((0, 90, 0), (0, 0, 0))), (high, ((0, -90, 0), (0, 180, 0)))):
        at = _numbers(corner)
        world += [f'<geom type="plane" size="1 1 1" pos="{at}" euler="{_numbers(turn)}"/>' for turn in turns]
    for number, body in enumerate(bodies):
        x, y, z, w = body.quaternion
        geoms = ""
        for part, points in enumerate(body.hulls):
            assets.append(f'<mesh name="body{number}_{part}" inertia="convex" vertex="{_numbers(points)}"/>')
            geoms += f'<geom type="mesh" mesh="body{number}_{part}"/>'
        place = f'pos="{_numbers(body.position)}" quat="{_numbers((w, x, y, z))}"'
        world.append(f"<body {place}><freejoint/>{geoms}</body>")
    # Contacts of six dimensions have friction against rolling and turning too, without which balls never rest. Density
    # and viscosity of the air, the latter exaggerated, slow down what spins.
    return (
        f'<mujoco><compiler angle="degree"/><option timestep="{STEP}" gravity="0 -9.81 0" integrator="implicitfast" '
        'density="1.2" viscosity="0.5"/>'
        f'<default><geom condim="6" friction="{FRICTION}" margin="{MARGIN}" solref="0.01 1.2" '
        'solimp="0.95 0.99 0.0005"/></default>'
        f"<asset>{''.join(assets)}</asset><worldbody>{''.join(world)}</worldbody></mujoco>"
    )
