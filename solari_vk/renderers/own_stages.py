"""A user's own stages inside the frame of a renderer."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Container, Sequence
from typing import Any

from solari_vk.base.errors import SolariError, quoted, unknown_name
from solari_vk.gpu.frame.frame import Frame
from solari_vk.gpu.frame.stages import Aliased, Counter, History, IfUsed, Pass, Size, Stage

AnyStage = Stage | Callable[[Size], Stage]
_SHADER = "display/own_view"
# Of an image's format: its channels with the bits of each, and the type of its values.
_FORMAT = re.compile(r"(R(\d+)(?:G\d+)?(?:B\d+A\d+)?)_(SFLOAT|UNORM|SNORM|SINT|UINT)")
_SUFFIXES = {"SFLOAT": "f", "UNORM": "", "SNORM": "_snorm", "SINT": "i", "UINT": "ui"}
_VECTORS = {"f": ("float", "vec"), "u": ("uint", "uvec"), "i": ("int", "ivec")}


@dataclasses.dataclass(frozen=True)
class _Own:
    given: AnyStage
    name: str
    after: str
    sizes: tuple[Size, ...]  # of pictures when it was added


@dataclasses.dataclass(frozen=True)
class OwnStages:
    """The stages that were added to a frame, in the order of adding. shown: the pass that shows an output of theirs."""

    who: str = ""
    added: tuple[_Own, ...] = ()
    shown: Pass | None = None

    def plus(self, given: Any, after: Any, frame: Frame, sizes: tuple[Size, ...], taken: Container[str]) -> OwnStages:
        """With one more. sizes: of pictures now. taken: names of results. Raises SolariError for what can't be."""
        stage = made_stage(self.who, given, sizes[0])
        known = [one.name for one in frame.stages]
        if after not in known:
            raise unknown_name(f"{self.who}.add_stage: there is no stage", after, known)
        if stage.name in known:
            raise SolariError(f"{self.who}.add_stage: the frame has a stage {quoted(stage.name)}: give it another name")
        for name in (*stage.buffers, *stage.images):
            if name in frame or name in taken:
                raise SolariError(
                    f"{self.who}.add_stage: stage {stage.name}: the frame has {quoted(name)}: shaders read it by that "
                    "name without a stage that declares it; what a stage of your own makes needs another name"
                )
        return dataclasses.replace(self, added=(*self.added, _Own(given, stage.name, after, sizes)))

    def without(self, name: str) -> OwnStages:
        names = [one.name for one in self.added]
        if name not in names:
            raise unknown_name(f"{self.who}.remove_stage: there is no stage of your own", name, names)
        return dataclasses.replace(self, added=tuple(one for one in self.added if one.name != name), shown=None)

    def inserted(self, stages: Sequence[Stage], sizes: tuple[Size, ...]) -> list[Stage]:
        """The stages of a frame with these between them. sizes: of pictures, the renderer's first."""
        found = list(stages)
        own = {one.name for one in self.added}
        for one in self.added:
            names = [stage.name for stage in found]
            if one.after not in names:
                what = f"{self.who}: with these settings stage {one.name} has no place: there is no stage"
                raise unknown_name(f"{what} to follow,", one.after, names)
            stage = made_stage(self.who, one.given, sizes[0])
            if stage.name != one.name:
                raise SolariError(f"{self.who}: stage {one.name} must keep its name, which is now {stage.name}")
            if isinstance(one.given, Stage):
                _check_sizes(self.who, stage, set(one.sizes) - set(sizes))
            at = names.index(one.after) + 1
            while at < len(names) and names[at] in own and names[at] != one.after:  # those that were added before
                at += 1
            found.insert(at, stage)
        if self.shown is not None:
            at = next(at for at, stage in enumerate(found) if stage.name == "show")
            shown = dataclasses.replace(self.shown, threads=sizes[0])
            found[at] = dataclasses.replace(found[at], passes=[*found[at].passes, shown])
        return found

    def outputs(self, frame: Frame) -> list[str]:
        """The names of the buffers and images that these stages declare."""
        own = {one.name for one in self.added}
        declared = [name for stage in frame.stages if stage.name in own for name in (*stage.buffers, *stage.images)]
        return [name for name in declared if name in frame]

    def views(self, frame: Frame, sizes: tuple[Size, ...]) -> dict[str, str]:
        """By the name of each output that can be shown, the GLSL that declares it and says its size and color."""
        declared: dict[str, Any] = {}
        for stage in frame.stages:
            declared |= {**stage.buffers, **stage.images}
        names = [name for name in self.outputs(frame) if frame.is_declared(name)]
        found = {name: _shown_by(name, declared[name], frame, sizes) for name in names}
        return {name: header for name, header in found.items() if header}

    def showing(self, header: str) -> OwnStages:
        """With a pass that draws an output, which `views` has given this header, over the picture; "" for none."""
        return dataclasses.replace(self, shown=Pass(_SHADER, threads=1, header=header) if header else None)


def made_stage(who: str, given: Any, size: Size) -> Stage:
    """What `add_stage` was given, for pictures of a size. Raises SolariError if that is no Stage."""
    stage = given(size) if callable(given) else given
    if not isinstance(stage, Stage):
        raise SolariError(
            f"{who}.add_stage: takes a Stage, or a function that makes one for the picture's (width, height), "
            f"not {quoted(stage)}"
        )
    return stage


def _plain(size: Any) -> Any:
    if isinstance(size, Aliased):
        return size.count
    return size.size if isinstance(size, History | IfUsed | Counter) else size


def _pair(size: Any) -> tuple[Any, ...]:
    """Width and height of a size in pixels or of threads, () for a number."""
    return tuple(size[:2]) if isinstance(size, Sequence) else ()


def _check_sizes(who: str, stage: Stage, old: set[Size]) -> None:
    """Raise SolariError for a stage that was made for pictures of a size that they no longer have."""
    declared = {_pair(_plain(size)) for size in stage.images.values()}
    declared |= {_pair(one.threads) for one in stage.passes if isinstance(one, Pass)}
    for width, height in old:
        if (width, height) in declared:
            raise SolariError(
                f"{who}: stage {stage.name} is made for {width}x{height} pixels, which the picture no longer has: give "
                "add_stage a function of the size, lambda size: Stage(...)"
            )


def _shown_by(name: str, declared: Any, frame: Frame, sizes: tuple[Size, ...]) -> str:
    """The header of the pass that shows an output; "" for one that is no picture."""
    binding = frame.binding(name)
    found = _FORMAT.fullmatch(binding.image_format)
    if found is not None:
        if _pair(_plain(declared)) not in sizes:
            return ""
        channels, bits, kind = found.groups()
        letters = "".join(re.findall("[RGBA]", channels)).lower()
        prefix = "" if kind in ("SFLOAT", "UNORM", "SNORM") else kind[0].lower().replace("s", "i")
        lines = [
            f"layout(set = 1, {letters}{bits}{_SUFFIXES[kind]}) uniform readonly {prefix}image2D {name};",
            f"uvec2 own_view_size() {{ return uvec2(imageSize({name})); }}",
        ]
        value = f"imageLoad({name}, ivec2(own_view_pixel))"
        return "\n".join([*lines, _value(value, len(letters), 4, is_number=bool(prefix))])
    element = binding.element
    size = next((size for size in sizes if size[0] * size[1] == _plain(declared)), None)
    is_plain = element is not None and not element.names and element.base.itemsize == 4 and not binding.element_offset
    if size is None or element is None or not is_plain or element.shape not in ((), (2,), (3,), (4,)):
        return ""
    count = element.shape[0] if element.shape else 1
    scalar, vector = _VECTORS[element.base.kind]
    lines = [
        f"layout(set = 1, scalar) readonly buffer OwnViewBlock {{ {scalar if count == 1 else vector}"
        f"{'' if count == 1 else count} at[]; }} {name};",
        f"uvec2 own_view_size() {{ return uvec2({size[0]}u, {size[1]}u); }}",
    ]
    is_number = element.base.kind != "f"
    value = f"{name}.at[own_view_pixel.y * {size[0]}u + own_view_pixel.x]"
    return "\n".join([*lines, _value(value, count, count, is_number=is_number)])


def _value(value: str, channels: int, components: int, *, is_number: bool) -> str:
    """The function that returns what a pixel shows, whose value has so many components, of which the channels count."""
    first = value if components == 1 else f"{value}.x"
    if is_number:
        color = f"uint({first})"
    elif channels == 1:
        color = f"vec3({first})"
    elif channels == 2:
        color = f"vec3({value}{'' if components == 2 else '.xy'}, 0.0)"
    else:
        color = f"vec3({value}.xyz)"
    kind = "uint" if is_number else "vec3"
    return f"#define OWN_VIEW\n{kind} own_view_value(uvec2 own_view_pixel) {{ return {color}; }}"
