"""What the worlds of a batch have in place of what their scene has: transforms, materials and lights."""

from __future__ import annotations

import weakref
from collections.abc import Iterable, Iterator, MutableMapping, Sequence
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, quoted
from solari_vk.batch.view_cameras import array, check_all, check_transforms
from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.tensors.imports import DeviceTensor
from solari_vk.scene.group import Group
from solari_vk.scene.lights.portal import Portal
from solari_vk.scene.matrices import thickened
from solari_vk.scene.model import Instance, Light, Material
from solari_vk.scene.observable import Checked, Observable

Item = TypeVar("Item", bound=Checked)
Values = TypeVar("Values")


class Overrides(MutableMapping[str | Item, Values], Generic[Item, Values]):
    """What objects of the scene are in each world, by the name of an object or by itself. Objects without are the
    scene's in all worlds."""

    # Of each subclass: how messages begin, the class of the objects, and the scene's collection that has them.
    where: str
    kind: type[Any]
    among: str

    def __init__(self, binder: SceneBinder, worlds: int) -> None:
        self._binder = binder
        self.worlds = worlds
        self._values: dict[Item, Values] = {}
        self.changed: set[Item] = set()

    def _item(self, key: str | Item) -> Item:
        items = getattr(self._binder.scene, self.among)
        name = self.among.removesuffix("s")
        if isinstance(key, Group):
            raise self._is_group(key)
        if isinstance(key, self.kind):
            if key not in items:
                raise SolariError(f"{self.where}: the scene doesn't have {key.describe()}")
            item: Item = key
            return item
        if not isinstance(key, str):
            article = "an" if self.kind is Instance else "a"
            raise SolariError(
                f"{self.where}: give the name of {article} {name} or {article} {self.kind.__name__}, not {quoted(key)}"
            )
        try:
            found: Item = items[key]
        except SolariError:
            groups = self._binder.scene.groups
            if key in groups:
                raise self._is_group(groups[key]) from None
            raise
        return found

    def _is_group(self, group: Group) -> SolariError:
        return SolariError(
            f"{self.where}: {group.describe()} is a group, which worlds have not: give the {self.among} "
            "among its items theirs (docs/reference/batches.md, Worlds)"
        )

    def _checked(self, item: Item, values: Any) -> Values:
        raise NotImplementedError

    def _by_default(self, item: Item) -> Values:
        raise NotImplementedError

    def replace(self, item: Item, values: Values | None) -> None:
        """Keep what is checked, or None for the scene's."""
        if values is None:
            self._values.pop(item, None)
        else:
            self._values[item] = values
        self.changed.add(item)

    def checked(self, key: str | Item, values: Any) -> tuple[Item, Values]:
        """What `replace` takes."""
        item = self._item(key)
        if self.worlds == 1:
            raise SolariError(f"{self.where}: the batch has one world: change {item.describe()} in the scene")
        return item, self._checked(item, values)

    def __setitem__(self, key: str | Item, values: Any) -> None:
        self.replace(*self.checked(key, values))

    def __getitem__(self, key: str | Item) -> Values:
        """A copy of what an object is in each world."""
        item = self._item(key)
        values: Any = self._values[item] if item in self._values else self._by_default(item)
        copied: Any = values.read() if isinstance(values, DeviceTensor) else values.copy()
        found: Values = copied
        return found

    def __delitem__(self, key: str | Item) -> None:
        """Have all worlds show an object as the scene has it."""
        item = self._item(key)
        if item not in self._values:
            raise KeyError(key)
        self.replace(item, None)

    def __contains__(self, key: object) -> bool:
        """Whether an object has something of its own in each world."""
        try:
            return self._item(key) in self._values  # type: ignore[arg-type]
        except SolariError:
            return False

    def get(self, key: str | Item, default: Any = None) -> Any:
        if key not in self:
            return default
        return self[key]

    def pop(self, key: str | Item, *default: Any) -> Any:
        if default and key not in self:
            return default[0]
        values = self[key]
        del self[key]
        return values

    def setdefault(self, key: str | Item, default: Any = None) -> Any:
        if key not in self:
            self[key] = default
        return self[key]

    def __iter__(self) -> Iterator[Any]:
        return iter(self.current())

    def __len__(self) -> int:
        return len(self.current())

    def current(self) -> dict[Item, Values]:
        """All overrides, of which those of objects that left the scene are dropped."""
        items = getattr(self._binder.scene, self.among)
        for item in [item for item in self._values if item not in items]:
            self.replace(item, None)
        return self._values

    def _checked_list(self, item: Item, values: Any, kind: type[Any], what: str) -> list[Any]:
        found = list(values) if isinstance(values, Sequence) else None
        if found is None or len(found) != self.worlds:
            there = quoted(values) if found is None else f"{len(found)}"
            raise SolariError(
                f"{self.where}: {item.describe()} takes a list of {self.worlds} {what}, one for each world, not {there}"
            )
        for world, value in enumerate(found):
            if not isinstance(value, kind):
                raise SolariError(
                    f"{self.where}: world {world} of {item.describe()} takes one of {what}, not {quoted(value)}"
                )
        return found


class TransformOverrides(Overrides[Instance, NDArray[np.float64]]):
    """The transforms of instances by world, by the name of each instance or by itself: (worlds, 4, 4), world from
    object. Instances without have the scene's in all worlds.

    Assign numpy arrays, or tensors; for a list of K instances (worlds, K, 4, 4). Tensors of a GPU stay on it, but those
    of instances that emit light, on which the host's lists of lights depend. What is wrong with such a tensor is said
    by a later `render`, and isn't shown. Raises SolariError for an instance that the scene doesn't have, and for
    transforms that `Instance.transform` doesn't take.
    """

    where = "Batch.transforms"
    kind = Instance
    among = "instances"

    def __setitem__(self, key: Any, values: Any) -> None:
        if not isinstance(key, (list, tuple)):
            super().__setitem__(key, values)
            return
        what = "of several instances"
        shape = self.worlds, len(key), 4, 4
        tensor = self.accept_tensor(values, what, shape)
        if tensor is not None:
            parts: list[Any] = [tensor.at(index, axis=1) for index in range(len(key))]
        else:
            parts = list(np.moveaxis(array(values, what, shape, where=self.where), 1, 0))
        # All are checked before the first is replaced, so that an error leaves all as they were.
        for item, transforms in [self.checked(*pair) for pair in zip(key, parts, strict=True)]:
            self.replace(item, transforms)

    def accept_tensor(
        self, values: Any, what: str, shape: tuple[int, ...], where: str | None = None
    ) -> DeviceTensor | None:
        """A tensor that stays on the device; None for what the host reads."""
        return self._binder.tensors.accept_shaped(values, what, shape, where=where or self.where)

    def _checked(self, item: Instance, values: Any) -> Any:
        what = f"of {item.describe()}"
        shape = self.worlds, 4, 4
        tensor = values if isinstance(values, DeviceTensor) else self.accept_tensor(values, what, shape)
        return tensor or self._on_host(item, array(values, what, shape, where=self.where))

    def _on_host(self, item: Instance, transforms: NDArray[np.float64]) -> NDArray[np.float64]:
        names = item.describe(), self.where, "world"
        check_all(np.isfinite(transforms), "be finite", *names)
        transforms = thickened(transforms)
        check_transforms(transforms, *names)
        return transforms

    def on_host(self, items: Iterable[Instance]) -> dict[Instance, NDArray[np.float64]]:
        """The transforms of these, from now on in the host's memory; waits for those of tensors."""
        found = {}
        for item in self._values.keys() & set(items):
            values = self._values[item]
            found[item] = self._on_host(item, values.read()) if isinstance(values, DeviceTensor) else values
        # From now on the host has them, and doesn't wait for the tensor again.
        self._values.update(found)
        return found

    def _by_default(self, item: Instance) -> NDArray[np.float64]:
        return np.broadcast_to(item.transform, (self.worlds, 4, 4))


class MaterialOverrides(Overrides[Instance, list[Material]]):
    """The materials of instances by world, by the name of each instance or by itself: a list with one for each world,
    in which materials may occur several times. Instances without have the scene's in all worlds.

    A material may have textures, and emit light. It may be edited, as any other. Raises SolariError for an instance
    that the scene doesn't have, and for wrong lists.
    """

    where = "Batch.world_materials"
    kind = Instance
    among = "instances"

    def _checked(self, item: Instance, values: Any) -> list[Material]:
        return self._checked_list(item, values, Material, "sv.Material")

    def _by_default(self, item: Instance) -> list[Material]:
        return [item.material] * self.worlds

    def replace(self, item: Instance, values: list[Material] | None) -> None:
        before = self._values.get(item, [])
        super().replace(item, values)
        table = self._binder.materials
        # New ones are acquired first, so that those which stay are not uploaded again.
        for material in dict.fromkeys(values or ()):
            table.acquire(material, item)
        for material in dict.fromkeys(before):
            table.release(material, item)
        for material in dict.fromkeys([*before, *(values or ())]):
            self._binder.mark_changed(material)

    def destroy(self) -> None:
        """Let go of the materials."""
        for item in list(self._values):
            self.replace(item, None)


class LightOverrides(Overrides[Light, list[Light | None]]):
    """The lights of the scene by world, by the name of each light or by itself: a list with what takes its place in
    each world, None for nothing. Lights without are the scene's in all worlds.

    They are of any kind but portals, environments with images of their own among them, and may be edited as any other.
    Raises SolariError for a light that the scene doesn't have, and for wrong lists.
    """

    where = "Batch.world_lights"
    kind = Light
    among = "lights"

    def __init__(self, binder: SceneBinder, worlds: int) -> None:
        super().__init__(binder, worlds)
        # Lights of worlds need not be in the scene, so that nobody else is told of their edits.
        self._edits = weakref.WeakKeyDictionary[Light, int]()

    def _checked(self, item: Light, values: Any) -> list[Light | None]:
        lights = self._checked_list(item, values, Light | None, "sv lights, or None")  # type: ignore[arg-type]
        for world, light in enumerate(lights):
            if isinstance(light, Portal):
                raise SolariError(
                    f"{self.where}: world {world} of {item.describe()} can't have a portal: all worlds "
                    "share the scene's"
                )
        return lights

    def _by_default(self, item: Light) -> list[Light | None]:
        return [item] * self.worlds

    def mark_changed(self, changed: Observable) -> None:
        """A light in use was edited."""
        assert isinstance(changed, Light)
        self._edits[changed] = self._edits.get(changed, 0) + 1
        self.changed.add(changed)

    def edits_of(self, light: Light | None) -> int:
        """How often a light was edited since it was first assigned."""
        return 0 if light is None else self._edits.get(light, 0)

    def replace(self, item: Light, values: list[Light | None] | None) -> None:
        before = set(self._values.get(item, ()))
        super().replace(item, values)
        for light in set(values or ()) - before:
            if light is not None:
                light.watch(self)
                self.mark_changed(light)  # it may have been edited while no world had it
        gone = before - set(values or ())
        if gone:
            gone -= {light for lights in self._values.values() for light in lights}
        for light in gone:
            if light is not None:
                light.unwatch(self)


class WorldOverrides:
    """All that the worlds of a scene have in place of what the scene has."""

    def __init__(self, binder: SceneBinder, worlds: int) -> None:
        self.transforms = TransformOverrides(binder, worlds)
        self.materials = MaterialOverrides(binder, worlds)
        self.lights = LightOverrides(binder, worlds)
        self._all: tuple[Overrides[Any, Any], ...] = (self.transforms, self.materials, self.lights)

    @property
    def changed(self) -> bool:
        """Whether something was assigned, deleted or edited since `confirm`."""
        return any(each.changed for each in self._all)

    def forget_removed(self) -> None:
        """Forget those of objects that have left the scene."""
        for each in self._all:
            each.current()

    def confirm(self) -> None:
        """Note that the worlds show all changes."""
        for each in self._all:
            each.changed.clear()

    def destroy(self) -> None:
        """Let go of the materials."""
        self.materials.destroy()
