"""Objects of a scene that move together: `Group`."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.errors import Hints, SolariError, unknown_name
from solari_vk.scene import checks
from solari_vk.scene.camera import Camera
from solari_vk.scene.collection import Collection
from solari_vk.scene.lights.directional import DirectionalLight
from solari_vk.scene.lights.light import Light
from solari_vk.scene.lights.portal import Portal
from solari_vk.scene.lights.punctual import PunctualLight
from solari_vk.scene.matrices import rotation, transform_directions, transform_points
from solari_vk.scene.objects import Instance
from solari_vk.scene.placement import PARTS, Scaled, parts, placed

KINDS = (Instance, PunctualLight, DirectionalLight, Portal, Camera)
NAMES = ("label", "part_of", "visible")  # of instances
_FINITE = checks.number()
SHOWN = 4  # objects that the repr of a group names


class Group(Scaled, Hints):
    """Instances, lights, cameras and other groups of a scene that move together, as `Scene.group` and `Scene.add` make.

    transform (4, 4) is the matrix from the group's space to the world. Assign it, or `position`, `rotation` or `scale`,
    and all objects move with it; they keep what was assigned to them alone. `turn` and `slide` move the groups of a
    robot's joints. Lights and cameras move and turn, but keep their size. `label`, `part_of` and `visible` are those of
    all instances: `group.update(label="car", part_of="car 1")` makes them one object. A loop over a group gives its
    objects. The constructor's transform and parts say where the group's origin is, without moving anything. Clips of
    `animations` place the instances of their file in the world, so they don't follow a group. Raises SolariError for
    objects that have no place, such as an Environment.
    """

    _joint = (0.0, 0.0)  # what `turn` and `slide` were given last

    def __init__(self, items: Iterable[Any] = (), *, name: str = "", **where: Any) -> None:
        self.name = name
        self._items: dict[Any, None] = {}  # a set that keeps the order
        self._place(self._changed(where))
        for item in items:
            self.add(item)

    def add(self, item: Any) -> Any:
        """Append an object, where it is, and return it. The scene isn't changed."""
        if not isinstance(item, (*KINDS, Group)):
            raise SolariError(
                f"{self.describe()}: a group holds instances, lights with a place or direction, cameras "
                f"and other groups, not {type(item).__name__}"
            )
        # Moves go down to all members, so that a group within itself would never end.
        if item is self or (isinstance(item, Group) and self in item._members()):
            raise SolariError(f"{self.describe()}: a group can't be in itself: leave {item.describe()} out")
        self._items[item] = None
        return item

    @property
    def label(self) -> str:
        """The label of all instances, "" if they have several. May be assigned."""
        return self._common("label")

    @property
    def part_of(self) -> str:
        """The object that all instances are parts of, "" if there are several. May be assigned."""
        return self._common("part_of")

    @property
    def visible(self) -> bool:
        """Whether any instance is seen. May be assigned, to all of them."""
        return any(item.visible for item in self.items if isinstance(item, Instance))

    def _common(self, name: str) -> str:
        found = {getattr(item, name) for item in self.items if isinstance(item, Instance)}
        return found.pop() if len(found) == 1 else ""

    def __iter__(self) -> Iterator[Any]:
        return iter(list(self._items))

    def __len__(self) -> int:
        return len(self._items)

    @property
    def items(self) -> list[Any]:
        """The objects, each once, those of groups in the group in their place."""
        return list(dict.fromkeys(self._objects()))

    def _objects(self) -> Iterator[Any]:
        """The objects, as often as groups in the group have them."""
        for item in self._items:
            if isinstance(item, Group):
                yield from item._objects()
            else:
                yield item

    def _members(self) -> dict[Any, None]:
        """The objects and groups in the group, and in those groups, each once."""
        found: dict[Any, None] = {}
        for item in self._items:
            found |= {item: None} | (item._members() if isinstance(item, Group) else {})
        return found

    @property
    def transform(self) -> NDArray[np.float64]:
        """The matrix (4, 4) from the group's space to the world. May be assigned."""
        return self._transform

    @transform.setter
    def transform(self, transform: ArrayLike) -> None:
        self.update(transform=transform)

    def update(self, **fields: Any) -> None:
        """Assign the transform, or several of its parts at once; nothing moves if one object can't. And `label`,
        `part_of` and `visible` of all instances."""
        names = {name: fields.pop(name) for name in NAMES if name in fields}
        # Everything is checked before the first object changes.
        self._check_names(names)
        moves = bool(fields)
        after = self._changed(fields, self._transform)
        if moves:
            _move_all(self._members(), after @ np.linalg.inv(self._transform))
        self._place(after)
        if names:
            for item in self.items:
                if isinstance(item, Instance):
                    item.update(**names)

    def turn(self, radians: float) -> None:
        """Turn the group about its own z axis, which is that of a robot's joint, to an angle.

        radians: from the pose in which the group was made or loaded, so that a second call with the same angle moves
        nothing; what else has moved the group, such as a joint before it, stays. turn(0) puts it back, not an assigned
        transform. Raises SolariError for an angle that isn't finite.
        """
        self._move_joint("turn: radians", radians, self._joint[1])

    def slide(self, meters: float) -> None:
        """Move the group along its own z axis, which is that of a robot's joint, to a distance.

        meters: from the pose in which the group was made or loaded, as for `turn`. Raises SolariError for a distance
        that isn't finite.
        """
        self._move_joint("slide: meters", self._joint[0], meters)

    def _move_joint(self, what: str, radians: float, meters: float) -> None:
        try:
            after = _FINITE(radians), _FINITE(meters)
        except (TypeError, ValueError) as error:
            raise SolariError(f"{self.describe()}.{what} {error}") from None
        change = np.eye(4)
        change[:3, :3] = rotation((0, 0, 1), after[0] - self._joint[0])
        change[2, 3] = (after[1] - self._joint[1]) / np.linalg.norm(self._transform[:3, 2])
        self.update(transform=self._transform @ change)
        self._joint = after

    def _check_names(self, names: dict[str, Any]) -> None:
        for name, value in names.items():
            try:
                Instance._converters[name](value)
            except (TypeError, ValueError) as error:
                raise SolariError(f"{self.describe()}: {name} {error}") from None

    def _place(self, transform: NDArray[np.float64]) -> None:
        transform.setflags(write=False)
        self._transform = transform

    def _changed(self, fields: dict[str, Any], before: Any = None) -> NDArray[np.float64]:
        for name in fields:
            if name not in ("transform", *PARTS):
                raise self._unknown(name)
        return placed(fields.pop("transform", before), self.describe(), **fields, may_flatten=True)

    def __setattr__(self, name: str, value: Any) -> None:
        if name in NAMES:
            self.update(**{name: value})
            return
        if name not in ("name", "transform", *PARTS) and not name.startswith("_"):
            raise self._unknown(name)
        super().__setattr__(name, value)

    def _unknown(self, name: str) -> SolariError:
        return unknown_name(f"{self.describe()} has no field", name, ("transform", *PARTS, "name", *NAMES))

    def describe(self) -> str:
        """The group's kind and name, for messages."""
        return f"Group '{self.name}'" if self.name else "Group"

    def __repr__(self) -> str:
        shown = [item.describe() for item in list(self._items)[:SHOWN]]
        more = f" and {len(self._items) - SHOWN} more" if len(self._items) > SHOWN else ""
        x, y, z = self._transform[:3, 3]
        return f"<{self.describe()} at ({x:.4g}, {y:.4g}, {z:.4g}): {', '.join(shown) or 'empty'}{more}>"


class Grouping:
    """What a scene can do with groups."""

    _groups: dict[Group, None]
    _paths: dict[str, Any]

    @property
    def groups(self) -> Collection[Any]:
        """The groups that `group` and `add` have made, and those of a file: nodes and prims that hold several objects,
        and the bodies and joints of robots.

        By number or name, as `instances` are: a loop gives the groups, `groups.names` their names. Not those that have
        nothing in the scene.
        """
        scene: Any = self

        def holds(item: Any) -> bool:
            return item in scene._holder(item)

        # The first object is there for most groups, so that few are looked at.
        present = [group for group in self._groups if any(map(holds, group._objects())) or not group.items]
        return Collection("group", present)

    def group(self, *items: Instance | Light | Camera | Group | str, name: str = "", **where: Any) -> Group:
        """A Group of objects that move together, such as the parts of a car; those that aren't in the scene are added.

        items: objects, or names of instances, lights, cameras and groups. name and where are those of Group, as is the
        error for objects without a place.
        """
        scene: Any = self
        group = Group([self._named(item) if isinstance(item, str) else item for item in items], name=name, **where)
        for item in group.items:
            if item not in scene._holder(item):
                scene.add(item)
        self._groups[group] = None
        return group

    def _named(self, name: str) -> Any:
        """The first instance of this name, else the first light, camera or group; or what is at a path of USD."""
        scene: Any = self
        holders = [scene.instances, scene.lights, scene.cameras]
        for holder in holders:
            if name in holder:
                return holder[name]
        # Groups come last: what they hold is asked for anew each time.
        groups = self.groups
        if name in groups:
            return groups[name]
        if name.startswith("/") and self._paths:
            return self._at(name)
        holders.append(groups)
        raise unknown_name("there is no object", name, [known for holder in holders for known in holder.names])

    def _at(self, path: str) -> Any:
        """What the prim of a USD file at this path has become: an object or a group, also one alone below the prim."""
        scene: Any = self
        groups = self.groups
        present = {
            place: item
            for place, item in self._paths.items()
            if item in (groups if isinstance(item, Group) else scene._holder(item))
        }
        inside = [place for place in present if _is_within(place, path)]
        top = min(inside, key=len, default="")
        if top and all(_is_within(place, top) for place in inside):
            return present[top]
        raise unknown_name("there is no object at the path", path, present)


def _is_within(place: str, path: str) -> bool:
    """Whether a place in a file is at or below a path."""
    return f"{place}/".startswith(f"{path.rstrip('/')}/")


_PLACES = ("position", "direction", "horizontal", "center", "half_u", "half_v")  # fields of lights


def _where(item: Any) -> dict[str, Any]:
    """The fields of an object that `_move` changes."""
    names = ("transform",) if isinstance(item, Group | Instance | Camera) else _PLACES
    return {name: getattr(item, name) for name in names if hasattr(item, name)}


def _move_all(items: Iterable[Any], move: NDArray[np.float64]) -> None:
    """Move objects, or none of them if one refuses, such as for coordinates that are too large."""
    before = []
    try:
        for item in items:
            before.append((item, _where(item)))
            _move(item, move)
    except SolariError:
        for item, fields in before:
            if isinstance(item, Group):
                item._place(fields["transform"])
            else:
                item.update(**fields)
        raise


def _move(item: Any, move: NDArray[np.float64]) -> None:
    if isinstance(item, Group):
        item._place(move @ item.transform)
    if isinstance(item, Instance):
        item.update(transform=move @ item.transform)
    if isinstance(item, Camera):
        # A camera can't be scaled.
        position, turn, _ = parts(move @ item.transform)
        item.update(position=position, rotation=turn)
    if isinstance(item, Portal):
        item.update(**Portal.placed(move @ item.transform))
    if isinstance(item, PunctualLight):
        item.position = transform_points(move, item.position).astype(np.float32)
    if isinstance(item, Light):
        item.update(**{name: transform_directions(move, getattr(item, name)).astype(np.float32) for name in item.axes})


def distinct(name: str, used: dict[str, int]) -> str:
    """The name, with a number if it is in use, and adds it to `used`: names, and the last number that each got."""
    # The last number of each name is remembered: thousands of equal names take linear time.
    number = used.get(name, 0)
    found = name
    while found in used:
        number += 1
        found = f"{name} {number}"
    used[name] = max(number, 1)
    used[found] = 1
    return found


def copies(instances: Iterable[Instance], lights: Iterable[Any], name: str, reserved: Iterable[str] = ()) -> list[Any]:
    """Copies of instances, which share meshes and materials, and of lights that have a place or a direction.

    name: of a single instance; it precedes those of several. reserved: the names of objects that they aren't parts of.
    """
    # Instances are copied, meshes and materials shared: they are most of the memory.
    made: list[Any] = [dataclasses.replace(instance) for instance in instances]
    used = dict.fromkeys(reserved, 1)
    objects = {"": ""}
    for instance in made:
        whole = instance.part_of
        if whole not in objects:
            objects[whole] = distinct(f"{name}/{whole}" if name else whole, used)
        instance.part_of = objects[whole]
    for instance in made if name else ():
        instance.name = name if len(made) == 1 else f"{name}/{instance.name}"
    return made + [dataclasses.replace(light) for light in lights if isinstance(light, KINDS)]
