"""From a stage to a `Scene`: each prim that can be seen, with its place, its material and its label."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Tf, Usd, UsdGeom, UsdLux, UsdShade, UsdSkel, UsdUtils

from solari_vk.base.budget import BudgetError, charge
from solari_vk.base.errors import SolariError
from solari_vk.scene import checks
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.usd.cameras import LENS, lens, make_camera
from solari_vk.scene.files.usd.geometry import Geometry
from solari_vk.scene.files.usd.instancers import MOVING, repetitions
from solari_vk.scene.files.usd.labels import Labels
from solari_vk.scene.files.usd.lights import PLAYED, Lights
from solari_vk.scene.files.usd.materials import Materials
from solari_vk.scene.files.usd.motion import Matrix, Motion, matrix, report_unplayed, sampled
from solari_vk.scene.files.usd.places import Hierarchy, Place
from solari_vk.scene.files.usd.skins import Skins
from solari_vk.scene.files.usd.stage import composition_faults, open_stage, reason, variant_sets
from solari_vk.scene.files.usd.textures import Files
from solari_vk.scene.group import distinct
from solari_vk.scene.lights.environment import EnvironmentLight
from solari_vk.scene.lights.punctual import PunctualLight
from solari_vk.scene.matrices import rotation
from solari_vk.scene.model import DirectionalLight, Instance, Light, Mesh, Scene

_BYTES_PER_PRIM, _BYTES_PER_INSTANCE = 512, 4096
_WRONG = "prims with wrong data are left out"
# Also below prims that are only given a place by `over`, where prototypes stand.
_SHARED = Usd.PrimIsActive & Usd.PrimIsLoaded & Usd.PrimHasDefiningSpecifier & ~Usd.PrimIsAbstract
_PRIMS = Usd.TraverseInstanceProxies(_SHARED)
_NO_TURN: Matrix = np.eye(4)


def load_stage(path: str | os.PathLike[str], variants: Any, strict: bool) -> Scene:
    """The scene of a file; `load_usd` has the arguments."""
    # What USD says to the terminal is collected, and said by `Scene.warnings`.
    silence = UsdUtils.CoalescingDiagnosticDelegate()
    try:
        return _Loader(Path(path), variants, strict).load()
    except (MemoryError, RecursionError):
        raise SolariError(f"{path}: is too large for this machine's memory") from None
    except Tf.ErrorException as error:
        raise SolariError(f"{path}: can't be read as USD ({reason(error)}): export it again") from None
    except SolariError as error:
        raise error if str(error).startswith(f"{path}: ") else SolariError(f"{path}: {error}") from None
    finally:
        silence.TakeUncoalescedDiagnostics()


class _Loader:
    def __init__(self, path: Path, variants: Any, strict: bool) -> None:
        self._file = str(path)
        self._report = Report(self._file, strict)
        self._stage, folder = open_stage(path, variants)
        for text, is_fatal in composition_faults(self._stage, folder):
            if is_fatal:
                raise folder.error(text)
            self._report.lost("parts that can't be composed are left out", folder.error(text))
        self._motion = Motion(self._stage, self._report, self._file)
        self._time = self._motion.time
        self._unit = float(UsdGeom.GetStageMetersPerUnit(self._stage))
        if not 1e-12 <= self._unit <= 1e12:
            raise folder.error(f"has {self._unit:g} meters per unit: give it a number from 1e-12 to 1e12")
        files = Files(folder)
        self._lights = Lights(files, self._report, self._time, self._unit)
        self._skins = Skins(self._motion, self._report, self._file)
        materials = Materials(files, self._report, self._time)
        self._geometry = Geometry(materials, self._lights, self._skins, self._report, self._time, self._file)
        self._labels = Labels(self._time)
        self._shown = {"default", "render"}
        self._objects: dict[str, int] = {}
        self._hierarchy = Hierarchy()
        self._placed: dict[Any, Place] = {}  # of skeletons
        self._instancers: list[Any] = []  # from the outermost to the one that is expanded
        self._scene = Scene(name=path.stem)
        self._top = np.diag([self._unit] * 3 + [1.0])
        if UsdGeom.GetStageUpAxis(self._stage) == UsdGeom.Tokens.z:
            self._top[:3, :3] = self._top[:3, :3] @ rotation((1, 0, 0), -np.pi / 2)

    def load(self) -> Scene:
        purposes = self._purposes()
        if not self._shown & purposes.keys() and "proxy" in purposes:
            self._report.add("there are only proxies, which are shown", purposes["proxy"])
            self._shown.add("proxy")
        self._add_below(Place(self._stage.GetPseudoRoot(), self._top))
        for purpose, path in purposes.items() if not self._shown & purposes.keys() else ():
            self._report.add(f"there is nothing to see but prims of the purpose {purpose}, which are left out", path)
        if self._report.first_error and not self._scene.instances:
            raise self._report.first_error
        self._motion.finish(self._scene)
        self._hierarchy.finish(self._scene)
        self._scene._variant_sets = variant_sets(self._stage)
        self._scene.warnings.extend(self._report.lines())
        return self._scene

    # ---- where prims are ----------------------------------------------------------------------------

    def _purposes(self) -> dict[str, str]:
        """The purposes of surfaces and shapes, each with a path, up to the first of one that is shown."""
        found: dict[str, str] = {}
        waiting = [(self._stage.GetPseudoRoot(), "default")]
        seen = set()  # of the prototypes of instances, and of instancers, which may repeat each other
        while waiting and not self._shown & found.keys():
            prim, purpose = waiting.pop()
            charge(0, self._file, "its prims")  # looks at the time
            if prim.IsA(UsdGeom.Gprim):
                found.setdefault(purpose, str(prim.GetPath()))
            if prim.IsA(UsdGeom.PointInstancer):
                targets = UsdGeom.PointInstancer(prim).GetPrototypesRel().GetForwardedTargets()
                children = [self._stage.GetPrimAtPath(path) for path in targets]
            else:
                children = (prim.GetPrototype() if prim.IsInstance() else prim).GetFilteredChildren(_SHARED)
            for child in filter(bool, children):
                key = child.GetPath(), _purpose(child, purpose)
                if key not in seen:
                    seen.add(key)
                    waiting.append((child, key[1]))
        return found

    def _add_below(self, root: Place) -> None:
        """Add what is at and below a prim."""
        self._add_all(list(self._walk(root)))

    def _add_all(self, found: list[Place]) -> None:
        # Meshes may stand before their skeletons.
        self._placed |= {place.prim.GetPath(): place for place in found if place.prim.IsA(UsdSkel.Skeleton)}
        for place in found:
            self._add(place)

    def _walk(self, root: Place) -> Iterator[Place]:
        """Prims with a place at and below a root, parents first."""
        waiting = [root]
        while waiting:
            place = waiting.pop()
            prim = place.prim
            charge(_BYTES_PER_PRIM, self._file, "its prims")  # looks at the time, too
            if prim.IsA(UsdShade.Material) or prim.IsA(UsdShade.Shader) or prim.IsA(UsdGeom.Subset):
                continue
            if place.purpose in self._shown:
                yield place
            if prim.IsA(UsdGeom.PointInstancer):
                continue  # its prototypes are only shown by it
            with self._report.costs(_WRONG):
                below = [self._below(place, child) for child in prim.GetFilteredChildren(_PRIMS)]
                waiting += [child for child in reversed(below) if child is not None]

    def _below(self, parent: Place, prim: Any) -> Place | None:
        """The place of a prim below another one; None (reported) for one with a wrong transform."""
        place = self._moved(parent, prim)
        return None if place is None else self._hierarchy.numbered(place, parent.number)

    def _moved(self, parent: Place, prim: Any) -> Place | None:
        """The same without a number."""
        place: Place = self._labels.place(replace(parent, prim=prim), self._objects)
        imageable = UsdGeom.Imageable(prim)
        if not imageable:
            return place
        place = replace(place, purpose=_purpose(prim, place.purpose))
        local, moves, resets = _NO_TURN, False, False
        xform = UsdGeom.Xformable(prim)
        if xform:
            local = matrix(xform.GetLocalTransformation(self._time))
            moves, resets = xform.TransformMightBeTimeVarying(), xform.GetResetXformStack()
        if not np.isfinite(local).all() or np.abs(local).max() > checks.LARGEST_TRANSFORM:
            error = SolariError(f"{self._file}: <{prim.GetPath()}> has a transform that isn't finite or too large")
            self._report.lost(_WRONG, error)
            return None
        seen = imageable.GetVisibilityAttr()
        blinks = seen.ValueMightBeTimeVarying()
        shown = seen.Get(self._time) != UsdGeom.Tokens.invisible
        base = self._top if resets else parent.world
        row, above = parent.row, parent.visible
        if resets:
            # What is above doesn't move it, but still hides it.
            row, above = None, parent.steady
            for codes, flags in parent.blinks:
                row = self._motion.row(row, _NO_TURN, base, above)
                self._motion.show(row, codes, flags)
        if moves or blinks or row is not None:
            row = self._motion.row(row, local, base, above, shown)
        with np.errstate(over="ignore", invalid="ignore"):
            place = replace(place, world=base @ local, row=row, visible=parent.visible and shown)
        if moves and row is not None:
            self._motion.transforms(prim, row)
        if blinks and row is not None:
            codes = self._motion.codes(seen.GetTimeSamples())
            flags = [seen.Get(code) != UsdGeom.Tokens.invisible for code in codes]
            self._motion.show(row, codes, flags)
            return replace(place, blinks=(*place.blinks, (codes, flags)))
        return replace(place, steady=parent.steady and shown)

    def _place_of(self, prim: Any) -> tuple[Matrix, int | None]:
        """The matrix of a prim to the world, and the row of it or of what is above it that moves."""
        found = self._placed.get(prim.GetPath())
        if found is not None:
            return found.world, found.row
        world = UsdGeom.XformCache(self._time).GetLocalToWorldTransform(prim)
        return self._top @ matrix(world), None

    # ---- what is there ------------------------------------------------------------------------------

    def _add(self, place: Place) -> None:
        """Add what a prim is."""
        prim = place.prim
        with self._report.costs(_WRONG), self._named(prim):
            played: tuple[str, ...] = ()
            if prim.IsA(UsdSkel.Root):
                self._skins.prepare(prim)
            if prim.IsA(UsdGeom.Gprim):
                self._add_geometry(place)
            elif prim.IsA(UsdGeom.PointInstancer):
                self._add_repeated(place)
                played = MOVING
            elif prim.IsA(UsdGeom.Camera):
                self._add_camera(place)
                played = LENS
            elif prim.HasAPI(UsdLux.LightAPI):
                played = self._add_light(place)
            if prim.IsModel() and prim.GetAttribute("model:applyDrawMode").Get():
                self._report.add("draw modes (cards, bounds) have no effect", f"<{prim.GetPath()}>")
            if not prim.IsA(UsdSkel.Animation):
                report_unplayed(self._report, prim, played)

    @contextmanager
    def _named(self, prim: Any) -> Iterator[None]:
        """Errors within this context name the prim."""
        path = f"<{prim.GetPath()}>"
        try:
            yield
        except SolariError as error:
            if "<" in str(error) or isinstance(error, BudgetError):
                raise
            raise SolariError(f"{self._file}: {path}: {str(error).removeprefix(f'{self._file}: ')}") from None

    def _add_camera(self, place: Place) -> None:
        prim = place.prim
        camera = make_camera(prim, place.world, self._time, self._unit, self._report)
        self._follow(place, camera)
        self._change(prim, camera, LENS, lambda time: lens(prim, time, self._unit))

    def _change(self, prim: Any, item: Any, names: Iterable[str], fields: Callable[[Any], dict[str, Any]]) -> None:
        """Have a camera or light take the fields of each time at which one of some attributes has a sample."""
        codes = self._motion.codes(sampled({name: prim.GetAttribute(name) for name in names}))
        with self._report.costs("wrong time samples are left out"):
            rows = [fields(Usd.TimeCode(code)) for code in codes]
            if codes:
                self._motion.change(item, codes, rows)

    def _follow(self, place: Place, item: Any) -> None:
        """Add an object that stands at a place, and have it move with that."""
        row = place.row
        is_dark = isinstance(item, Light) and not place.visible
        if is_dark and row is None:
            return
        if row is not None:
            self._motion.later.append(lambda rig: rig.attach(item, row, shown=place.visible))
        self._hierarchy.add(place, item, self._file)
        if not is_dark:
            self._scene.add(item)

    def _add_light(self, place: Place) -> tuple[str, ...]:
        """Add a light. Returns the names of the inputs that may be animated."""
        where = f"<{place.prim.GetPath()}>"
        light = self._lights.make(place.prim, place.world)
        if isinstance(light, EnvironmentLight):
            if self._scene.environment is not None:
                self._report.add("domes beside the first one are left out", where)
            elif place.visible:
                self._scene.environment = light
            if place.row is not None:
                self._report.add("domes neither move nor blink: they are as at the start", where)
            return ()
        if light is None:
            return ()
        if isinstance(light, Instance):
            light.update(visible=place.visible, label=place.label, part_of=place.part_of)
        self._follow(place, light)
        if not isinstance(light, (DirectionalLight, PunctualLight)):
            return ()
        self._change(place.prim, light, PLAYED, lambda time: self._lights.fields(place.prim, light, place.world, time))
        return PLAYED

    def _add_geometry(self, place: Place) -> None:
        """Add a mesh or a simple shape, an instance for each of its materials."""
        parts = self._geometry.parts(place.prim, place.world)
        part_of = place.part_of
        if len(parts) > 1 and not part_of:
            part_of = distinct(place.prim.GetName(), self._objects)
        for mesh, material, name in parts:
            self._add_instance(place, mesh, material, name, part_of)

    def _add_instance(self, place: Place, mesh: Mesh, material: Any, name: str, part_of: str) -> None:
        """Add an instance of a mesh at a place."""
        charge(_BYTES_PER_INSTANCE, self._file, "its instances")
        try:
            world = checks.placing_transform(place.world)
            visible = place.visible
        except ValueError:
            if place.row is None:
                raise SolariError(
                    f"{self._file}: <{place.prim.GetPath()}> has a transform that isn't finite, or a scale of 0 along "
                    "more than one axis"
                ) from None
            world, visible = np.eye(4), False  # until an animation gives it a size
        instance = Instance(mesh, material, world, visible=visible, name=name, label=place.label, part_of=part_of)
        if mesh.deformation is None:
            self._follow(place, instance)
            return
        self._skins.pose(place.prim, instance, self._place_of)
        row = place.row
        if instance.joint_matrices is None:
            self._follow(place, instance)
            return
        if row is not None:
            self._motion.later.append(lambda rig: rig.attach(instance, row, moves=False))
        self._hierarchy.add(place, instance, self._file)
        self._scene.add(instance)

    # ---- point instancers ---------------------------------------------------------------------------

    def _add_repeated(self, place: Place) -> None:
        """Add the prototypes of a point instancer at its points."""
        prim = place.prim
        if prim.GetPath() in self._instancers:
            raise SolariError(f"{self._file}: <{prim.GetPath()}> repeats itself: take it out of its own prototypes")
        instancer = UsdGeom.PointInstancer(prim)
        targets = instancer.GetPrototypesRel().GetForwardedTargets()
        numbers = np.array(instancer.GetProtoIndicesAttr().Get(self._time) or [], np.int64)
        if len(numbers) and not (0 <= numbers.min() <= numbers.max() < len(targets)):
            raise SolariError(f"{self._file}: <{prim.GetPath()}> has indices of prototypes that don't exist")
        charge(_BYTES_PER_PRIM * len(numbers), f"{self._file}: <{prim.GetPath()}>", f"{len(numbers):,} points")
        moves, codes, matrices = repetitions(instancer, len(numbers), self._motion, self._report, self._file)
        mask = instancer.ComputeMaskAtTime(self._time)
        chosen = np.flatnonzero(np.ones(len(numbers), bool) if not mask else np.array(mask, bool))
        self._instancers.append(prim.GetPath())
        try:
            still: dict[int, list[Place]] = {}
            for point in chosen.tolist():
                number = int(numbers[point])
                at = replace(place, world=place.world @ matrices[0][point])
                if not moves and place.row is None:
                    self._add_still(still, number, targets[number], at)
                    continue
                row = self._motion.row(place.row, matrices[0][point], place.world, place.visible)
                if moves:
                    self._motion.move(row, codes, matrices[:, point], f"<{prim.GetPath()}>")
                self._add_prototype(targets[number], replace(at, row=row))
        finally:
            self._instancers.pop()

    def _prototype(self, path: Any, at: Place) -> Place | None:
        """The place of a prototype's root at a point."""
        prototype = self._stage.GetPrimAtPath(path)
        if not prototype:
            raise SolariError(f"{self._file}: <{at.prim.GetPath()}> repeats <{path}>, which isn't there")
        if prototype.IsAbstract():
            self._report.add("prototypes that are classes show nothing: make them `def` or `over`", f"<{path}>")
        return self._below(at, prototype)

    def _add_prototype(self, path: Any, at: Place) -> None:
        with self._report.costs(_WRONG):
            root = self._prototype(path, at)
            if root is not None:
                self._add_below(root)

    def _add_still(self, still: dict[int, list[Place]], number: int, path: Any, at: Place) -> None:
        """The same where the points don't move: what a prototype holds is found once, unless it moves by itself."""
        if number not in still:
            root = self._prototype(path, replace(at, world=_NO_TURN))
            still[number] = [] if root is None else list(self._walk(root))
        if any(found.row is not None for found in still[number]):
            self._add_prototype(path, at)
            return
        names: dict[str, str] = {at.part_of: at.part_of}  # each point has objects of its own
        places = []
        for found in still[number]:
            if found.part_of not in names:
                names[found.part_of] = distinct(found.part_of, self._objects)
            world = at.world @ found.world
            places.append(replace(found, world=world, part_of=names[found.part_of], number=at.number))
        self._add_all(places)


def _purpose(prim: Any, inherited: str) -> str:
    """The purpose of a prim below one of another."""
    own = UsdGeom.Imageable(prim).GetPurposeAttr()
    return str(own.Get()) if own and own.HasAuthoredValue() else inherited
