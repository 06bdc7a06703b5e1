"""The buffers and images of a frame's stages, made from declared sizes and the shaders' types."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import Any

from solari_vk.base.errors import SolariError, quoted
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.image import Image
from solari_vk.gpu.frame.interface import Interface
from solari_vk.gpu.frame.stages import Aliased, Counter, Draw, History, IfUsed, Stage
from solari_vk.gpu.shaders.spirv import Binding

PREVIOUS = "previous_"
DEPTH_FORMAT = "D32_SFLOAT"  # of a Draw's depth image


@dataclass(frozen=True)
class _Made:
    """The one resource of a declared name, or the two of a history. They can be kept while `spec` stays the same."""

    spec: tuple[Any, ...]
    items: tuple[Buffer | Image, ...]


class Resources:
    """The resources of a list of stages, by name."""

    def __init__(
        self, device: Device, made: dict[str, _Made] | None = None, aliased: dict[str, Aliased] | None = None
    ) -> None:
        self._device = device
        self._made = {} if made is None else made
        self._aliased = {} if aliased is None else aliased

    def named(self, slot: int) -> dict[str, Any]:
        """The resource of each name in a slot: a history's two resources swap between slots."""
        found: dict[str, Any] = {}
        for name, made in self._made.items():
            found[name] = made.items[slot % len(made.items)]
            if len(made.items) > 1:
                # What one slot writes is what the other one reads as previous: no copy is ever made.
                found[PREVIOUS + name] = made.items[1 - slot]
        return found | {name: found[size.host] for name, size in self._aliased.items()}

    def element_count(self, name: str) -> int | None:
        """The elements of a buffer that aliases another one; None for any other name."""
        return self._aliased[name].count if name in self._aliased else None

    @property
    def sizes(self) -> dict[str, int]:
        """The bytes of each name's resource, or of both that a history has; without names that alias others."""
        return {name: sum(item.size for item in made.items) for name, made in self._made.items()}

    def changed_to(self, stages: Sequence[Stage], interface: Interface) -> Resources:
        """The resources that these stages declare; those of this object that fit are reused.

        Raises SolariError for a name declared twice, that no shader has, or whose size makes no sense.
        """
        made: dict[str, _Made] = {}
        aliased: dict[str, Aliased] = {}
        attachments = _attachments(stages)
        result = Resources(self._device, made, aliased)
        try:
            for stage, name, size in _declared(stages, interface):
                if name in made or name in aliased:
                    raise SolariError(f"stage {stage.name}: {name} is declared by another stage as well")
                host = size.host.removeprefix(PREVIOUS) if isinstance(size, Aliased) else ""
                if host in made:
                    _check_aliased(stage, name, size, interface, made[host].spec)
                    aliased[name] = size
                    continue
                # Without its host, which no stage of this frame declares, an alias has memory of its own.
                count = size.count if isinstance(size, Aliased) else size
                spec = _specification(stage, name, count, interface, attachments.get(name, ""))
                known = self._made.get(name)
                made[name] = known if known and known.spec == spec else self._make(name, spec)
        except BaseException:
            result.destroy_all_but(self)
            raise
        return result

    def _make(self, name: str, spec: tuple[Any, ...]) -> _Made:
        kind, copies, *rest = spec
        labels = [name] if copies == 1 else [f"{name} {slot}" for slot in range(copies)]
        items: list[Buffer | Image] = []
        with self._device.undone_on_error():
            for label in labels:
                if kind == "buffer":
                    buffer = self._device.buffer(rest[0], label)
                    items.append(buffer)
                    buffer.fill(0)  # what the first frame reads as the previous one
                else:
                    width, height, format_name, attachment = rest
                    format = image_format(format_name)
                    image = self._device.image(width, height, format, label, usage=_USAGES[attachment])
                    items.append(image)
                    _clear(image)
        return _Made(spec, tuple(items))

    def destroy_all_but(self, remaining: Resources) -> None:
        """Destroy the resources that `remaining` doesn't have, when the work submitted so far is done."""
        remaining_ids = {id(item) for made in remaining._made.values() for item in made.items}
        for made in self._made.values():
            for item in made.items:
                if id(item) not in remaining_ids:
                    item.destroy()


def image_format(name: str) -> int:
    """The VkFormat of a format's name as reflection gives it, such as "R32_SFLOAT"."""
    return int(getattr(raw, "VK_FORMAT_" + name))


_STORED = raw.VK_IMAGE_USAGE_STORAGE_BIT | raw.VK_IMAGE_USAGE_SAMPLED_BIT
# Storage usage of depth formats is rarely supported, so a depth image is an attachment and nothing else.
_USAGES = {
    "": _STORED,
    "color": _STORED | raw.VK_IMAGE_USAGE_COLOR_ATTACHMENT_BIT,
    "depth": raw.VK_IMAGE_USAGE_DEPTH_STENCIL_ATTACHMENT_BIT,
}


def _declared(stages: Sequence[Stage], interface: Interface) -> Iterator[tuple[Stage, str, Any]]:
    """The stage, name and size of each resource that is declared, but for those `IfUsed` that no shader has."""
    for stage in stages:
        for name, size in (*stage.buffers.items(), *stage.images.items()):
            if isinstance(size, IfUsed) and name not in interface.bindings:
                continue
            yield stage, name, size.size if isinstance(size, IfUsed | Counter) else size


def _attachments(stages: Sequence[Stage]) -> dict[str, str]:
    """The images that the stages draw into, each with "color" or "depth"."""
    draws = [item for stage in stages for item in stage.passes if isinstance(item, Draw)]
    return {name: "color" for draw in draws for name in draw.colors} | {draw.depth: "depth" for draw in draws}


def _specification(stage: Stage, name: str, size: Any, interface: Interface, attachment: str) -> tuple[Any, ...]:
    """Everything that decides whether an existing resource can be kept."""
    copies = 1
    if isinstance(size, History):
        copies = 2
        size = size.size
    if attachment == "depth":
        return ("image", copies, *_image_size(stage, name, size), DEPTH_FORMAT, attachment)
    binding = _binding(stage, interface, name, PREVIOUS + name if copies == 2 else name)
    if name in stage.buffers:
        return ("buffer", copies, _buffer_bytes(stage, binding, size), str(binding.dtype), str(binding.element))
    if binding.kind != "storage_image" or not binding.image_format:
        raise SolariError(f"stage {stage.name}: {name} must be a storage image with a format in the shaders")
    return ("image", copies, *_image_size(stage, name, size), binding.image_format, attachment)


def _check_aliased(stage: Stage, name: str, size: Aliased, interface: Interface, host: tuple[Any, ...]) -> None:
    kind, copies, host_bytes, *_ = host
    if kind != "buffer" or (copies == 2) != size.host.startswith(PREVIOUS):
        raise SolariError(
            f"stage {stage.name}: {name} must be within a buffer, {PREVIOUS}NAME of one with a history, not {size.host}"
        )
    needed = _buffer_bytes(stage, _binding(stage, interface, name), size.count)
    if needed > host_bytes:
        raise SolariError(f"stage {stage.name}: {name} needs {needed} bytes within {size.host}, which has {host_bytes}")


def _binding(stage: Stage, interface: Interface, *names: str) -> Binding:
    """The first of the names that shaders have."""
    for name in names:
        if name in interface.bindings:
            return interface.bindings[name]
    raise SolariError(f"stage {stage.name} declares {names[0]}, which none of the frame's shaders uses")


def _image_size(stage: Stage, name: str, size: Any) -> tuple[int, int]:
    if not (isinstance(size, tuple) and len(size) == 2 and all(isinstance(n, Integral) and int(n) >= 1 for n in size)):
        raise SolariError(f"stage {stage.name}: the size of {name} is (width, height), not {quoted(size)}")
    width, height = size
    return int(width), int(height)


def _buffer_bytes(stage: Stage, binding: Binding, count: Any) -> int:
    if binding.kind != "storage_buffer":
        raise SolariError(f"stage {stage.name}: {binding.name} is a {binding.kind} in the shaders, not a buffer")
    if not isinstance(count, Integral) or count < 1:
        found = quoted(count)
        raise SolariError(f"stage {stage.name}: {binding.name} needs a whole number of elements above 0, not {found}")
    if binding.element is None and count != 1:
        raise SolariError(f"stage {stage.name}: {binding.name} has no runtime array: its count is 1, not {count}")
    return binding.size_bytes(int(count))


def _clear(image: Image) -> None:
    """Set an image to zero just before the next submission."""

    def record(cmd: raw.CData) -> None:
        if image.handle is not None:  # it may be destroyed before the next submission
            part = raw.struct("VkImageSubresourceRange", **image.all_levels)
            vk = image.device.vk
            vk.vkCmdPipelineBarrier2(cmd, full_barrier())
            # Vulkan has a command each for colors and for depth.
            kind = "DepthStencil" if image.aspect == raw.VK_IMAGE_ASPECT_DEPTH_BIT else "Color"
            clear = getattr(vk, f"vkCmdClear{kind}Image")
            zero = raw.struct(f"VkClear{kind}Value")
            clear(cmd, image.handle, image.layout, zero, 1, part)
            vk.vkCmdPipelineBarrier2(cmd, full_barrier())

    image.device.before_next_submit(record)
