"""Meshes whose vertices are split, so that each has one tangent."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.matrices import unit
from solari_vk.scene.meshes.smoothing import area_vectors
from solari_vk.scene.meshes.tangents import generate_tangents
from solari_vk.scene.objects import Mesh

_OF_VERTICES = ("positions", "normals", "uvs", "second_uvs", "tangents", "colors")
_OF_DEFORMATIONS = ("joints", "joint_weights", "targets", "target_normals", "target_tangents")


def with_tangents(mesh: Mesh, uv_set: int) -> Mesh:
    """A mesh with the tangents of a set of uvs, as MikkTSpace makes them, and flat normals if it has none.

    Meshes that have tangents or no uvs stay as they are, as do flat ones that are deformed.
    """
    normals, uvs = mesh.normals, mesh.uvs_for(uv_set)
    if mesh.tangents is not None or uvs is None or (normals is None and mesh.deformation is not None):
        return mesh
    rows: NDArray[Any] = np.arange(len(mesh.positions))
    triangles: NDArray[Any] = mesh.triangles
    if normals is None:
        rows, triangles = triangles.reshape(-1), np.arange(triangles.size).reshape(-1, 3)
        normals = np.repeat(unit(area_vectors(mesh.positions, mesh.triangles)), 3, axis=0)
    split = generate_tangents(mesh.positions[rows], normals, uvs[rows], triangles)
    made = _taken(mesh, rows[split.source], split.indices)
    return dataclasses.replace(made, normals=normals[split.source], tangents=split.tangents)


def _taken(mesh: Mesh, rows: NDArray[Any], triangles: NDArray[Any]) -> Mesh:
    """The mesh of these vertices, with triangles over them."""
    parts = {name: values[rows] for name in _OF_VERTICES if (values := getattr(mesh, name)) is not None}
    given = mesh.deformation
    if given is not None:
        parts["deformation"] = dataclasses.replace(
            given,
            **{name: values[..., rows, :] for name in _OF_DEFORMATIONS if (values := getattr(given, name)) is not None},
        )
    return dataclasses.replace(mesh, triangles=triangles, **parts)
