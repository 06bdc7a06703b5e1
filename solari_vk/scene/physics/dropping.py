"""Things that fall until they rest: by MuJoCo, a kept engine of rigid bodies with wheels for all platforms.

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

from solari_vk.base.errors import SolariError, checked_keywords, quoted
from solari_vk.scene import checks
from solari_vk.scene.bounds import bounds_of
from solari_vk.scene.group import Group
from solari_vk.scene.matrices import quaternion_rotation, transform_points
from solari_vk.scene.objects import Instance, objects_of

Floats = NDArray[np.float64]
SLAB = 0.05  # meters behind the front of a triangle that isn't part of a convex mesh
MARGIN = 4e-4  # meters, of which each of two things begins to push, so that nothing penetrates
STEP = 0.002  # seconds
SLOW, RESTING = 0.02, 50  # m/s or rad/s, and for how many steps, until things count as resting
MOST_TRIANGLES = 5000
TRIES = 200  # of places for one thing in a layer
FRICTION = "0.8 0.02 0.005"  # sliding, turning, rolling
FLAT = 1e-5  # of a mesh's size, by which a convex mesh's vertices may stand before its planes


def drop(
    falling: Sequence[Sequence[Instance] | Group],
    *,
    on: Sequence[Instance],
    region: Any,
    seed: int,
    upright: bool,
    seconds: float,
) -> None:
    """The work of `Scene.drop`; falling: the parts of each thing. on: what they fall on, and the things themselves,
    which don't count."""
    try:
        import mujoco
    except ImportError:
        raise SolariError('Scene.drop: needs MuJoCo: install it by "pip install solari-vk[physics]"') from None
    moved = {part for thing in falling for part in (thing.items if isinstance(thing, Group) else thing)}
    supports = [one for one in on if one.visible and one not in moved]
    low, high = _region(region, supports)
    bodies = [_Body(thing) for thing in falling]
    _place(bodies, low, high, np.random.default_rng(seed), upright)
    still = _still(supports, high[1])
    # Where nothing of a thing can touch what lies still any more.
    lost = np.array([min((part[:, 1].min() for _, part in still), default=math.inf) - one.radius for one in bodies])
    try:
        model = mujoco.MjModel.from_xml_string(_document(bodies, [part for _, part in still], low, high))
        data = mujoco.MjData(model)
        poses, quiet = data.qpos.reshape(-1, 7), 0  # a view
        for _ in range(math.ceil(seconds / STEP)):
            mujoco.mj_step(model, data)
            quiet = quiet + 1 if np.abs(data.qvel).max(initial=0.0) < SLOW else 0
            if quiet >= RESTING or not (poses[:, 1] >= lost).all():  # also if a place is NaN
                break
    except (ValueError, mujoco.FatalError) as error:
        raise SolariError(_of_mujoco(str(error), bodies, still)) from None
    for body, pose, depth in zip(bodies, poses, lost, strict=True):
        if not pose[1] >= depth:
            raise SolariError(f"Scene.drop: {body.instance.describe()} fell through: nothing is below it in the region")
    if quiet < RESTING:
        raise SolariError(
            f"Scene.drop: {len(bodies)} things don't rest after {seconds:g} s: give more seconds, or a larger region"
        )
    for body, pose in zip(bodies, poses, strict=True):
        w, x, y, z = pose[3:].tolist()
        body.apply(pose[:3], np.array(quaternion_rotation(x, y, z, w)))


class _Body:
    """A thing that falls, of one part or several: their points about the middle of all, in the world's scale, and where
    it starts."""

    def __init__(self, thing: Sequence[Instance] | Group) -> None:
        self.group = thing if isinstance(thing, Group) else None
        held = thing.items if isinstance(thing, Group) else thing
        self.parts = parts = [one for one in held if isinstance(one, Instance)]
        self.instance, start = parts[0], parts[0].transform[:3, 3]
        hulls = [
            np.unique(
                part.posed_mesh().positions.astype(np.float64) @ part.transform[:3, :3].T
                + (part.transform[:3, 3] - start),
                axis=0,
            )
            for part in parts
        ]
        points = np.concatenate(hulls)
        middle = (points.min(axis=0) + points.max(axis=0)) / 2
        self.middle = start + middle
        self.hulls = [hull - middle for hull in (hulls if all(map(_has_volume, hulls)) else [points])]
        self.radius = float(np.linalg.norm(points - middle, axis=1).max())
        if not _has_volume(points):
            raise SolariError(f"Scene.drop: {self.instance.describe()} is flat: only things with a volume fall")
        self.position, self.quaternion = np.zeros(3), np.array((0.0, 0.0, 0.0, 1.0))

    def apply(self, position: Floats, turn: Floats) -> None:
        move = np.eye(4)
        move[:3, :3], move[:3, 3] = turn, position - turn @ self.middle
        for thing in [self.group] if self.group is not None else self.parts:
            thing.transform = move @ thing.transform


def _has_volume(points: Floats) -> bool:
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return len(points) >= 4 and bool(spread[-1] >= 1e-6 * spread[0])


def _of_mujoco(text: str, bodies: list[_Body], still: list[tuple[Instance, Floats]]) -> str:
    """MuJoCo's error, with the thing that it means by the name of a mesh."""
    named, who = re.search(r"(still|body)(\d+)", text), f"{len(bodies)} things"
    if named:
        at = int(named[2])
        who = (still[at][0] if named[1] == "still" else bodies[at].instance).describe()
    return f"Scene.drop: {who}: MuJoCo can't move or hold this: {' '.join(text.split())}"


def _region(region: Any, supports: list[Instance]) -> tuple[Floats, Floats]:
    found = bounds_of(supports)
    if found is None:
        raise SolariError("Scene.drop: there is nothing to fall on: add a floor")
    try:
        given = np.asarray([found.min, found.max] if region is None else region, np.float64)
        if given.shape != (2, 3) or not np.isfinite(given).all() or not (given[0] <= given[1]).all():
            raise ValueError
    except (TypeError, ValueError):
        raise SolariError(
            f"Scene.drop: region is a box, its lowest and its highest corner (2, 3) in meters, not {quoted(region)}"
        ) from None
    return given[0], given[1]


def _place(bodies: list[_Body], low: Floats, high: Floats, rng: np.random.Generator, upright: bool) -> None:
    """Random places in layers above the region, without overlaps: of spheres around the bodies."""
    bottom, layer, tallest = high[1] + MARGIN, list[_Body](), 0.0
    at = low
    for body in bodies:
        numbers = rng.normal(size=4) if not upright else np.array((0, *rng.normal(size=1), 0, *rng.normal(size=1)))
        body.quaternion = numbers / np.linalg.norm(numbers)
        room = high - low - 2 * body.radius
        if not min(room[0], room[2]) > 0:
            raise SolariError(
                f"Scene.drop: {body.instance.describe()}, {2 * body.radius:.3g} m long, doesn't fit into "
                f"a region of {high[0] - low[0]:.3g} x {high[2] - low[2]:.3g} m"
            )
        for _ in range(TRIES):
            at = low + body.radius + rng.uniform(size=3) * room
            if all(math.dist(at[::2], other.position[::2]) > body.radius + other.radius + MARGIN for other in layer):
                break
        else:
            bottom, layer, tallest = bottom + 2 * tallest + MARGIN, [], 0.0
        body.position = np.array((at[0], bottom + body.radius, at[2]))
        layer.append(body)
        tallest = max(tallest, body.radius)


def _still(supports: list[Instance], top: float) -> list[tuple[Instance, Floats]]:
    """The points of convex parts of what lies still and isn't wholly above the region."""
    parts, count = list[tuple[Instance, Floats]](), 0
    for instance in supports:
        mesh = instance.posed_mesh()
        points = transform_points(instance.transform, mesh.positions.astype(np.float64))
        corners = points[mesh.triangles]
        if np.linalg.det(instance.transform[:3, :3]) < 0:
            corners = corners[:, ::-1]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(normals, axis=1)
        below = corners[..., 1].min(axis=1) <= top - MARGIN
        upward = (normals[:, 1] > 0) & (corners[..., 1].max(axis=1) <= top + MARGIN)
        keep = (area > 1e-12) & (below | upward)
        corners, normals = corners[keep], normals[keep] / area[keep, None]
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
    assets, world = [], []
    for number, points in enumerate(still):
        middle = points.mean(axis=0)
        assets.append(f'<mesh name="still{number}" inertia="shell" vertex="{_numbers(points - middle)}"/>')
        world.append(f'<geom type="mesh" mesh="still{number}" pos="{_numbers(middle)}"/>')
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
    return (
        f'<mujoco><compiler angle="degree"/><option timestep="{STEP}" gravity="0 -9.81 0" integrator="implicitfast" '
        'density="1.2" viscosity="0.5"/>'
        f'<default><geom condim="6" friction="{FRICTION}" margin="{MARGIN}" solref="0.01 1.2" '
        'solimp="0.95 0.99 0.0005"/></default>'
        f"<asset>{''.join(assets)}</asset><worldbody>{''.join(world)}</worldbody></mujoco>"
    )


class Dropping:
    """The part of `Scene` in which things fall."""

    @checked_keywords()
    def drop(
        self: Any,
        *items: Instance | Group | str,
        on: Sequence[Instance | Group | str] | None = None,
        region: ArrayLike | None = None,
        seed: int = 0,
        upright: bool = False,
        seconds: float = 20.0,
    ) -> None:
        """Let things fall until they rest on what is there and on each other, without meeting.

        items: instances, groups and names, of those in the scene. A Group, such as `scene.add` makes of a file, is one
        thing; `scene.drop(*group)` are its objects one by one. Parts of one object are one thing too
        (`Instance.part_of`, whose name means all of them). on: what things fall on, likewise, by default all other
        visible instances. region: a box, its lowest and its highest corner (2, 3) in meters; things start at random
        places above its top and stay within its sides, and what lies above it, such as a ceiling, doesn't count. By
        default it is the bounds of what they fall on. seed: of the places, and of the rotations, with upright about the
        vertical axis only. seconds: the longest that they may take.

        Things, and parts of them, collide as their convex hulls, all of one density, with friction, and rest within
        1 mm; an object with a flat part is one hull. The same seed gives the same transforms on one machine. Needs the
        extra `physics` (MuJoCo). Raises SolariError for things that are named twice, aren't in the scene, are flat,
        don't fit into the region, find nothing below them or don't rest, and what MuJoCo says of a thing; all is then
        as it was.
        """
        checks.check_whole("Scene.drop: seed", seed)
        try:
            checks.number(STEP, 1e5, "s")(seconds)
        except (TypeError, ValueError) as error:
            raise SolariError(f"Scene.drop: seconds {error}") from None
        groups = [item for item in items if isinstance(item, Group)]
        held = self._instances_of(groups)
        alone = self._instances_of([item for item in items if not isinstance(item, Group)])
        numbered = dict(enumerate(alone))
        falling: list[Sequence[Instance] | Group] = [*groups]
        falling += [[numbered[part] for part in parts] for parts in objects_of(numbered).values()]
        times = Counter(alone + held)
        for one in (one for one, count in times.items() if count > 1):
            raise SolariError(f"Scene.drop: {one.describe()} is given twice: it falls once")
        given = [on] if isinstance(on, (Group, str)) or not np.iterable(on) else on
        supports = self.instances[:] if on is None else self._instances_of(given)
        drop(falling, on=supports, region=region, seed=seed, upright=upright, seconds=seconds)

    def _instances_of(self: Any, items: Sequence[Instance | Group | str]) -> list[Instance]:
        """The instances of the scene that items are or hold."""
        found = list[Instance]()
        for item in items:
            parts = [thing for thing in self.instances if isinstance(item, str) and thing.part_of == item]
            one = self.instances[item] if isinstance(item, str) and not parts else item
            held = parts or (one.items if isinstance(one, Group) else [one])
            things = [thing for thing in held if isinstance(thing, Instance)]
            if not things:
                raise SolariError(f"{self.describe()}: drop takes instances, not {quoted(item)}")
            for thing in things:
                if thing not in self.instances:
                    raise SolariError(f"Scene.drop: {thing.describe()} is not in the scene: add it first")
            found += things
        return found
