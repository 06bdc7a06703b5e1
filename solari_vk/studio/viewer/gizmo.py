"""Handles by which what is picked is moved, turned and scaled: those of ImGuizmo, which imgui-bundle ships."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from imgui_bundle import imgui, imguizmo
from numpy.typing import NDArray

from solari_vk.scene.camera import Camera
from solari_vk.studio.viewer.placing import move_to, pivot_of, transform_of
from solari_vk.studio.viewer.session import Session

gizmo = imguizmo.im_guizmo
OPERATIONS = {"move": gizmo.OPERATION.translate, "turn": gizmo.OPERATION.rotate, "scale": gizmo.OPERATION.scale}
LENGTH = 75.0  # of a handle, in window coordinates at a text scale of 1
FAR = 1e4  # over the near distance, of the projection that the handles are drawn by: theirs needs an end


class Gizmo:
    """The handles of a session. `lay_out` draws them and applies what the user drags."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self.busy = False
        """Whether the mouse is over a handle or drags one."""

    def lay_out(self) -> None:
        """Lay out the handles over the picture, between ImGui's new_frame and end_frame."""
        session = self._session
        item = self._session.selected
        operation = OPERATIONS.get(session.gizmo)
        self.busy = False
        if operation is None or item is None or not self._has_handles(item, operation):
            return
        transform = transform_of(item, session.camera_control.center)
        if transform is None:
            return
        # From where the handles are to the object's space.
        pivot = np.eye(4)
        pivot[:3, 3] = pivot_of(item)
        area = session.layout.picture
        camera = session.camera
        gizmo.set_orthographic(bool(camera.orthographic_height))
        gizmo.set_drawlist(imgui.get_background_draw_list())
        gizmo.set_rect(area.x, area.y, area.width, area.height)
        # Lengths of handles are in clip space, which is 2 across the picture's longer side.
        gizmo.set_gizmo_size_clip_space(2 * LENGTH * session.window.text_scale / max(area.width, area.height))
        view = np.linalg.inv(_without_scale(camera.transform))
        matrix = _matrix16(transform @ pivot)
        # Scaling along the world's axes would shear the object.
        is_local = session.gizmo_is_local or operation == gizmo.OPERATION.scale
        along = gizmo.MODE.local if is_local else gizmo.MODE.world
        seen_by = projection(camera, area.width / max(area.height, 1))
        changed = gizmo.manipulate(_matrix16(view), _matrix16(seen_by), operation, along, matrix)
        self.busy = gizmo.is_over() or gizmo.is_using()
        if changed:
            moved = np.asarray(matrix.values, np.float64).reshape(4, 4).T.copy()
            moved[3] = 0, 0, 0, 1  # float32 leaves rounding errors there, which transforms refuse
            moved = moved @ np.linalg.inv(pivot)
            if np.isfinite(moved).all():
                self._move(item, transform, moved)

    def _has_handles(self, item: Any, operation: Any) -> bool:
        """Whether the object has handles for an operation."""
        session = self._session
        # A camera of the scene from which the user looks would have its handles in the eye.
        if item in session.locked or _is_eye(session, item):
            return False
        # ImGuizmo projects by a matrix, which a lens with distortion hasn't. Lights have no scale.
        can_scale = "transform" in item._names
        return not session.camera.has_lens and (can_scale or operation != gizmo.OPERATION.scale)

    def _move(self, item: Any, before: NDArray[np.float64], after: NDArray[np.float64]) -> None:
        """Move an object, and in the same way all others that are picked."""
        session = self._session
        if len(session.picked) == 1:
            session.edit(item, **move_to(item, after))
            return
        change = after @ np.linalg.inv(before)
        values = []
        for other in session.picked:
            place = transform_of(other, session.camera_control.center)
            if place is not None:
                values.append((other, move_to(other, after if other is item else change @ place)))
        session.edit_all(f"moving {len(values)} objects", values)

    @property
    def drags(self) -> bool:
        """Whether the user drags a handle."""
        return self.busy and bool(gizmo.is_using())


def projection(camera: Camera, aspect: float) -> NDArray[np.float64]:
    """OpenGL's projection matrix (4, 4) of a camera without a lens, for pictures with width / height = aspect."""
    x, y = 2 * camera.principal_point - 1
    made = np.zeros((4, 4))
    if camera.orthographic_height:
        far = FAR * camera.orthographic_height
        made[1, 1] = 2 / camera.orthographic_height
        made[2, 2] = -1 / far
        made[3, 3] = 1
        made[0, 3], made[1, 3] = x, -y
    else:
        near, far = camera.near, FAR * camera.near
        made[1, 1] = 1 / math.tan(camera.vertical_fov / 2)
        made[2, 2] = (far + near) / (near - far)
        made[2, 3] = 2 * far * near / (near - far)
        made[3, 2] = -1
        made[0, 2], made[1, 2] = -x, y
    made[0, 0] = made[1, 1] * camera.pixel_aspect / aspect
    return made


def _is_eye(session: Session, item: Any) -> bool:
    return isinstance(item, Camera) and bool(np.allclose(item.transform, session.camera.transform))


def _without_scale(transform: NDArray[np.float64]) -> NDArray[np.float64]:
    made = transform.copy()
    made[:3, :3] /= np.linalg.norm(made[:3, :3], axis=0)
    return made


def _matrix16(matrix: NDArray[Any]) -> Any:
    """A matrix (4, 4) as ImGuizmo takes it: by columns."""
    return gizmo.Matrix16([float(value) for value in matrix.T.ravel()])
