"""UsdSkel: the skeletons of a stage, the joints and blend shapes of its meshes, and what animates them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdSkel

from solari_vk.base.budget import charge
from solari_vk.base.errors import SolariError, quoted
from solari_vk.scene.animation.rig import turned_inside_out
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.usd.motion import Matrix, Motion, matrix
from solari_vk.scene.meshes.deformation import Deformation
from solari_vk.scene.model import Instance, Mesh

Integers = NDArray[np.int64]
_INBETWEENS = "inbetweens of blend shapes are left out"
_DUAL = "meshes that ask for dual quaternions are skinned linearly"


class Skeleton(NamedTuple):
    """A skeleton in the rest pose: world from joint (J, 4, 4), joint from the bind pose (J, 4, 4), and the rows of
    joints, None where nothing moves."""

    joints: Matrix
    unbind: Matrix
    rows: list[int] | None


class Skins:
    """Finds the skins of meshes below a SkelRoot."""

    def __init__(self, motion: Motion, report: Report, who: str) -> None:
        self._motion = motion
        self._report = report
        self._who = who
        self._skeletons: dict[Any, Skeleton] = {}
        self._queries: dict[Any, tuple[Any, Any, Any]] = {}
        self._turned: dict[Mesh, Mesh] = {}
        self._caches: list[Any] = []

    def prepare(self, root: Any) -> None:
        """Find what a SkelRoot binds."""
        cache = UsdSkel.Cache()
        predicate = Usd.TraverseInstanceProxies()
        cache.Populate(UsdSkel.Root(root), predicate)
        for binding in cache.ComputeSkelBindings(UsdSkel.Root(root), predicate):
            skeleton = binding.GetSkeleton()
            query = cache.GetSkelQuery(skeleton)
            for target in binding.GetSkinningTargets():
                self._queries[target.GetPrim().GetPath()] = skeleton.GetPrim(), query, target
        self._caches.append(cache)  # its queries live as long

    def skin(self, prim: Any) -> Any:
        """The skeleton's prim, and the skeleton and skinning queries of a mesh, None without."""
        return self._queries.get(prim.GetPath())

    def _skeleton(self, prim: Any, query: Any, world: Matrix, row: int | None) -> Skeleton:
        """world, row: of the skeleton's prim, which point instancers have at many places."""
        key = prim.GetPath(), row, world.tobytes()
        if key not in self._skeletons:
            names = query.GetJointOrder()
            charge(4096 * len(names), f"{self._who}: <{prim.GetPath()}>", "its joints")
            parents = list(query.GetTopology().GetParentIndices())
            local = _matrices(query.ComputeJointLocalTransforms(self._motion.time), len(names))
            bind = _matrices(query.GetJointWorldBindTransforms(), len(names))
            if not np.isfinite(local).all() or (np.abs(np.linalg.det(bind)) < 1e-30).any():
                text = "has joints that aren't finite or bind transforms without an inverse"
                raise SolariError(f"{self._who}: <{prim.GetPath()}> {text}")
            joints = np.empty_like(local)
            for joint, parent in enumerate(parents):
                joints[joint] = (world if parent < 0 else joints[parent]) @ local[joint]
            rows = self._rows(query, parents, local, world, row)
            self._skeletons[key] = Skeleton(joints, np.asarray(np.linalg.inv(bind), np.float64), rows)
        return self._skeletons[key]

    def _rows(self, query: Any, parents: list[int], local: Matrix, world: Matrix, row: int | None) -> list[int] | None:
        animation = query.GetAnimQuery()
        moves = bool(animation) and animation.JointTransformsMightBeTimeVarying()
        if not moves and row is None:
            return None
        rows: list[int] = []
        for joint, parent in enumerate(parents):
            above = row if parent < 0 else rows[parent]
            rows.append(self._motion.row(above, local[joint], world, True))
        codes = self._motion.codes(list(animation.GetJointTransformTimeSamples())) if moves else []
        if codes:
            found = [_matrices(query.ComputeJointLocalTransforms(Usd.TimeCode(code)), len(rows)) for code in codes]
            for joint, own in enumerate(rows):
                self._motion.move(own, codes, np.array(found)[:, joint], f"<{query.GetPrim().GetPath()}>")
        return rows

    def deformation(self, prim: Any, points: Integers, count: int) -> Deformation | None:
        """What moves a Mesh whose vertices are some points of a prim's `count` ones."""
        found = self.skin(prim)
        if found is None:
            return None
        _, query, target = found
        fields: dict[str, Any] = {}
        if target.HasJointInfluences():
            fields |= self._influences(query, target, points, count)
        fields |= self._targets(prim, target, points, count)
        return Deformation(**fields) if fields else None

    def _influences(self, query: Any, target: Any, points: Integers, count: int) -> dict[str, Any]:
        place = f"{self._who}: <{target.GetPrim().GetPath()}>"
        found = target.ComputeJointInfluences(self._motion.time)
        indices, weights = (np.array(values) for values in (found or ((), ())))
        each = target.GetNumInfluencesPerComponent()
        rows = 1 if target.IsRigidlyDeformed() else count
        names = target.GetJointOrder()
        number = len(names) if names else len(query.GetJointOrder())
        if len(indices) != rows * each or len(weights) != len(indices) or not each:
            raise SolariError(f"{place} has {len(indices)} joints and {len(weights)} weights for {count} points")
        if indices.min() < 0 or indices.max() >= number or not np.isfinite(weights).all() or (weights < 0).any():
            raise SolariError(f"{place} has wrong joint indices or weights: export the file again")
        if str(target.GetPrim().GetAttribute("primvars:skel:skinningMethod").Get()) == "dualQuaternion":
            self._report.add(_DUAL, f"<{target.GetPrim().GetPath()}>")
        if names:
            own = {name: joint for joint, name in enumerate(query.GetJointOrder())}
            unknown = [name for name in names if name not in own]
            if unknown:
                text = f"{place} follows the joint {quoted(unknown[0])}, which its skeleton hasn't"
                raise SolariError(f"{text}: export the file again")
            indices = np.array([own[name] for name in names])[indices]
        of = np.zeros(len(points), np.int64) if rows == 1 else points
        joints, shares = indices.reshape(rows, each)[of], weights.reshape(rows, each)[of]
        used = np.flatnonzero((shares > 0).any(axis=0)).tolist() or [0]
        return {"joints": joints[:, used].astype(np.uint32), "joint_weights": shares[:, used].astype(np.float32)}

    def _targets(self, prim: Any, target: Any, points: Integers, count: int) -> dict[str, Any]:
        if not target.HasBlendShapes():
            return {}
        place = f"{self._who}: <{prim.GetPath()}>"
        stage = prim.GetStage()
        shapes = [
            UsdSkel.BlendShape(stage.GetPrimAtPath(path)) for path in target.GetBlendShapeTargetsRel().GetTargets()
        ]
        if len(target.GetBlendShapeOrder()) != len(shapes):
            text = f"{place} has {len(target.GetBlendShapeOrder())} names of blend shapes for {len(shapes)} targets"
            raise SolariError(f"{text}: export the file again")
        charge(24 * len(points) * len(shapes), place, "its blend shapes")
        made = {"targets": np.zeros((len(shapes), len(points), 3), np.float32)}
        for number, shape in enumerate(shapes):
            if not shape:
                raise SolariError(f"{place} has a blend shape that isn't there: export the file again")
            if shape.GetInbetweens():
                self._report.add(_INBETWEENS, f"<{shape.GetPath()}>")
            where = np.array(shape.GetPointIndicesAttr().Get() or [], np.int64)
            for name, attribute in (
                ("targets", shape.GetOffsetsAttr()),
                ("target_normals", shape.GetNormalOffsetsAttr()),
            ):
                offsets = np.array(attribute.Get() or [], np.float32).reshape(-1, 3)
                if not len(offsets):
                    continue
                to = where if len(where) else np.arange(count)
                if len(to) != len(offsets) or to.min() < 0 or to.max() >= count:
                    raise SolariError(f"{place} has a blend shape for other points: export the file again")
                whole = np.zeros((count, 3), np.float32)
                whole[to] = offsets
                made.setdefault(name, np.zeros_like(made["targets"]))[number] = whole[points]
        return made

    def pose(self, prim: Any, instance: Instance, world_of: Any) -> None:
        """Put an instance of a mesh with a deformation in its pose, and have it follow. world_of: the place of another
        prim, as its matrix and row."""
        found = self.skin(prim)
        deformation = instance.mesh.deformation
        if found is None or deformation is None:
            return
        skeleton_prim, query, target = found
        fields: dict[str, Any] = {}
        if deformation.joints is not None:
            skeleton = self._skeleton(skeleton_prim, query, *world_of(skeleton_prim))
            bind = skeleton.unbind @ matrix(target.GetGeomBindTransform(self._motion.time))
            # A mirrored place turns front faces around, which joints don't show.
            if np.linalg.det((skeleton.joints[0] @ bind[0])[:3, :3]) < 0:
                if instance.mesh not in self._turned:
                    self._turned[instance.mesh] = turned_inside_out(instance.mesh)
                instance.mesh = self._turned[instance.mesh]
            fields = {"joint_matrices": (skeleton.joints @ bind)[:, :3], "transform": np.eye(4)}
            if skeleton.rows is not None:
                rows, joints = skeleton.rows, skeleton.joints
                is_mirrored = bool(np.linalg.det(joints[0, :3, :3]) < 0)
                self._motion.later.append(lambda rig: rig.attach_skin(instance, rows, joints, bind))
                self._motion.later.append(lambda rig: rig.attach_side(instance, rows[0], is_mirrored))
        if deformation.targets is not None:
            fields["morph_weights"] = self._weights(query, target, self._motion.time)
        instance.update(**fields)
        animation = query.GetAnimQuery()
        if deformation.targets is not None and animation and animation.BlendShapeWeightsMightBeTimeVarying():
            codes = self._motion.codes(list(animation.GetBlendShapeWeightTimeSamples()))
            row = self._motion.row(None, np.eye(4), np.eye(4), True)
            weights = np.array([self._weights(query, target, Usd.TimeCode(code)) for code in codes])
            self._motion.weigh(row, codes, weights)
            self._motion.later.append(lambda rig: rig.attach_weights(instance, row))

    def _weights(self, query: Any, target: Any, time: Any) -> NDArray[np.float64]:
        """The weights (T,) of a mesh's blend shapes."""
        animation = query.GetAnimQuery()
        names = list(target.GetBlendShapeOrder() or [])
        if not animation:
            return np.zeros(len(names))
        found = dict(zip(animation.GetBlendShapeOrder(), animation.ComputeBlendShapeWeights(time), strict=False))
        return np.asarray(np.nan_to_num([float(found.get(name, 0.0)) for name in names]))


def _matrices(found: Any, count: int) -> Matrix:
    values = np.array(found, np.float64).reshape(-1, 4, 4).swapaxes(1, 2)
    if len(values) != count:
        raise SolariError(f"a skeleton has {len(values)} transforms for {count} joints: export the file again")
    return values
