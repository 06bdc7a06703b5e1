"""Time samples of a stage as one animation: transforms, visibility, weights, and fields of cameras and lights."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Usd, UsdGeom

from solari_vk.base.budget import charge
from solari_vk.base.errors import SolariError
from solari_vk.scene.animation.clip import Animation
from solari_vk.scene.animation.keyframes import Channel
from solari_vk.scene.animation.rig import Rig
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.matrices import compose

Matrix = NDArray[np.float64]
STEP = 10.0  # degrees that a turn by angles, between two samples, is divided into
_MOST_STEPS = 4096  # between two samples
_BYTES_PER_KEY = 400
_SHEAR = 1e-3
# What places a prim, and what pictures don't show.
_UNSEEN = ("visibility", "extent", "velocities", "accelerations", "angularVelocities", "shutter:open", "shutter:close")


class Fields:
    """An object whose fields are animated, as a Rig wants it. fields: those that are."""

    def __init__(self, item: Any) -> None:
        self._item = item
        self._values: dict[str, Any] = {}

    def put(self, path: tuple[str, ...], values: Matrix) -> None:
        """Take the values of a field."""
        self._values[path[-1]] = float(values[0]) if len(values) == 1 else values

    def apply(self) -> None:
        """Assign the fields whose values changed."""
        changed = {name: value for name, value in self._values.items() if np.any(getattr(self._item, name) != value)}
        if changed:
            self._item.update(**changed)


class Motion:
    """Collects what moves. time: of the rest pose."""

    def __init__(self, stage: Any, report: Report, who: str) -> None:
        self._report = report
        self._who = who
        self._rate = stage.GetTimeCodesPerSecond() or 24.0
        self.range = (stage.GetStartTimeCode(), stage.GetEndTimeCode()) if stage.HasAuthoredTimeCodeRange() else None
        self.time = Usd.TimeCode(self.range[0]) if self.range else Usd.TimeCode.EarliestTime()
        self._parents: list[int] = []
        self._local: list[Matrix] = []
        self._bases: list[tuple[Matrix, bool]] = []
        self._visible: list[bool] = []
        self._channels: list[tuple[int, str, list[float], Matrix, str]] = []
        self._fields: list[tuple[Any, list[float], list[dict[str, Any]]]] = []
        self.later: list[Callable[[Rig], None]] = []
        """What hangs on the rows, as calls that a Rig gets when all rows are known."""

    def codes(self, samples: Sequence[float]) -> list[float]:
        """Those time codes of samples that are played, with the ends of the stage's range."""
        if self.range is None or not samples:
            return sorted(samples)
        first, last = self.range
        return sorted({first, *(code for code in samples if first < code < last), last})

    def row(self, parent: int | None, local: Matrix, base: Matrix, shown: bool, visible: bool = True) -> int:
        """A node. base: world from its parent, and shown whether that is visible, where the parent is no row."""
        self._parents.append(-1 if parent is None else parent)
        self._local.append(local)
        self._bases.append((base, shown) if parent is None else (np.eye(4), True))
        self._visible.append(visible)
        return len(self._parents) - 1

    def move(self, row: int, codes: list[float], matrices: Matrix, place: str) -> None:
        """Have a row take transforms (K, 4, 4) at time codes."""
        charge(_BYTES_PER_KEY * len(codes), f"{self._who}: {place}", "its keys")
        with np.errstate(all="ignore"):
            translation, rotation, scale = decompose(matrices)
            error = np.abs(compose(translation, rotation, scale) - matrices).max()
        if not np.isfinite(rotation).all() or not np.isfinite(matrices).all():
            self._report.lost(
                "wrong time samples are left out", SolariError(f"{place} has transforms that aren't finite")
            )
            return
        if error > _SHEAR * max(np.abs(matrices[:, :3, :3]).max(), 1e-30):
            self._report.add("transforms with shear are animated without it", place)
        # Along the shorter arc from key to key.
        for key in range(1, len(rotation)):
            if rotation[key] @ rotation[key - 1] < 0:
                rotation[key] *= -1
        for path, values in (("translation", translation), ("rotation", rotation), ("scale", scale)):
            self._channels.append((row, path, codes, values, "LINEAR"))

    def show(self, row: int, codes: list[float], flags: Sequence[bool]) -> None:
        """Have a row be visible or not from time codes on."""
        self._channels.append((row, "visible", codes, np.array(flags, np.float64)[:, None], "STEP"))

    def weigh(self, row: int, codes: list[float], weights: Matrix) -> None:
        """Have a row's morph targets take weights (K, T) at time codes."""
        self._channels.append((row, "weights", codes, weights, "LINEAR"))

    def change(self, item: Any, codes: list[float], values: list[dict[str, Any]]) -> None:
        """Have a camera or light take fields at time codes."""
        self._fields.append((item, codes, values))

    def transforms(self, prim: Any, row: int) -> None:
        """Read the time samples of a prim's own transform."""
        xform = UsdGeom.Xformable(prim)
        codes = self._stepped(xform, self.codes(xform.GetTimeSamples()), str(prim.GetPath()))
        if codes:
            found = [matrix(xform.GetLocalTransformation(Usd.TimeCode(code))) for code in codes]
            self.move(row, codes, np.array(found), f"<{prim.GetPath()}>")

    def _stepped(self, xform: Any, codes: list[float], place: str) -> list[float]:
        """Time codes with more of them where angles turn far between two."""
        turns = [op for op in xform.GetOrderedXformOps() if "rotate" in op.GetOpName() and op.MightBeTimeVarying()]
        found = codes[:1]
        for first, last in pairwise(codes):
            swept = [np.abs(np.subtract(op.Get(last), op.Get(first))).sum() for op in turns]
            with np.errstate(invalid="ignore"):
                steps = int(min(np.nan_to_num(np.ceil(max(swept, default=0.0) / STEP)), _MOST_STEPS))
            charge(_BYTES_PER_KEY * steps, f"{self._who}: {place}", "its keys")
            found += np.linspace(first, last, max(steps, 1) + 1)[1:].tolist()
        return found

    def finish(self, scene: Any) -> None:
        """Give a scene its animation, if anything moves."""
        times = [codes[0] for _, _, codes, *_ in self._channels] + [codes[0] for _, codes, _ in self._fields]
        if not times:
            return
        start = self.range[0] if self.range else min(times)
        count = len(self._parents)
        rest = np.zeros((count, 3)), np.tile((0.0, 0.0, 0.0, 1.0), (count, 1)), np.ones((count, 3))
        if count:
            rest = decompose(np.array(self._local))
        rig = Rig(self._parents, self._local, *rest, self._bases, self._visible)
        for attach in self.later:
            attach(rig)
        channels = []
        for row, path, codes, values, kind in self._channels:
            channels.append(Channel(row, path, self._seconds(codes, start), values, kind))
        for item, codes, rows in self._fields:
            holder = Fields(item)
            for name in (name for name in rows[0] if all(name in row for row in rows)):
                keys = np.array([np.atleast_1d(row[name]) for row in rows], np.float64)
                if np.ptp(keys, axis=0).any():
                    number = rig.attach_property(holder, (name,), keys[0])
                    channels.append(Channel(number, "property", self._seconds(codes, start), keys))
        if channels:
            scene.animations.add(Animation(rig, channels, name=scene.name))

    def _seconds(self, codes: list[float], start: float) -> list[float]:
        return [max(code - start, 0.0) / self._rate for code in codes]


def report_unplayed(report: Report, prim: Any, played: Collection[str] = ()) -> None:
    """Report the attributes of a prim that vary with time, but those of some names, which are animated. Transforms and
    visibility are for whoever places the prim."""
    for attribute in prim.GetAuthoredAttributes():
        name = attribute.GetName()
        is_seen = name not in (*played, *_UNSEEN) and not name.startswith("xformOp:") and not attribute.IsCustom()
        if is_seen and attribute.ValueMightBeTimeVarying():
            report.add(f"time samples of {name} are left out: it is as at the start", f"<{prim.GetPath()}>")


def matrix(found: Any) -> Matrix:
    """The matrix (4, 4) for columns of one of USD, which is for rows."""
    return np.array(found, np.float64).T


def decompose(matrices: Matrix) -> tuple[Matrix, Matrix, Matrix]:
    """Translations (K, 3), quaternions (K, 4: x, y, z, w) and scales (K, 3); what mirrors does so along x."""
    axes = matrices[:, :3, :3]
    scale = np.linalg.norm(axes, axis=1)
    scale[:, 0] *= np.where(np.linalg.det(axes) < 0, -1, 1)
    turns = []
    for turn in axes / np.where(scale == 0, 1, scale)[:, None, :]:
        rotation = Gf.Matrix3d(*turn.T.ravel().tolist()).GetOrthonormalized(False).ExtractRotation().GetQuat()
        turns.append((*rotation.GetImaginary(), rotation.GetReal()))
    return matrices[:, :3, 3].copy(), np.array(turns).reshape(-1, 4), scale


def sampled(attributes: Mapping[str, Any]) -> list[float]:
    """The time codes at which any of some attributes has a sample, if one of them varies."""
    found: set[float] = set()
    for attribute in attributes.values():
        if attribute and attribute.ValueMightBeTimeVarying():
            found.update(attribute.GetTimeSamples())
    return sorted(found)
