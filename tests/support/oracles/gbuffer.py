"""A frame's G-buffer, decoded in float64, and the world positions of its pixels."""

import numpy as np

from support.oracles import closed_forms, encodings

IMAGES = ("gbuffer", "gbuffer_surface", "gbuffer_depth", "motion_vectors")


def decode(frame):
    """Values (h, w[, channels]) of IMAGES in the packed layout, see glsl/passes/gbuffer/gbuffer.glsl.

    `depth` is near / distance along the view axis, 0 where nothing is; `motion` is in parts of the picture's size.
    """
    x, y, z, w = np.moveaxis(frame["gbuffer"].astype(np.int64), -1, 0)
    surface = frame["gbuffer_surface"].astype(np.int64)
    fine_bits = np.array((5, 6, 5))
    coarse = np.stack([x & 255, x >> 8 & 255, x >> 16 & 255], -1)
    fine = np.stack([z >> 16 & 31, z >> 21 & 63, z >> 27 & 31], -1)
    return {
        "color": ((coarse << fine_bits | fine) / ((256 << fine_bits) - 1.0)) ** 2.2,
        "perceptual_roughness": (x >> 24) / 255.0,
        "emissive": encodings.decode_rgb9e5(y),
        "reflectance": (z & 255) / 255.0,
        "metallic": (z >> 8 & 255) / 255.0,
        "normal": encodings.decode_octahedral(w & 0xFFFFFF, 12),
        "geometric_normal": encodings.decode_octahedral(surface[..., 0], 16),
        "instance": surface[..., 1],
        "depth": frame["gbuffer_depth"][..., 0].astype(np.float64),
        "motion": frame["motion_vectors"].astype(np.float64),
    }


def world_positions(camera, depth, jitter):
    """World positions of pixels' surfaces (h, w, 3), very far away without a surface. jitter: (x, y), in pixels."""
    height, width = depth.shape
    origin, directions = closed_forms.camera_rays(camera, width, height, (0.5 + jitter[0], 0.5 + jitter[1]))
    distance = np.where(depth > 0, camera.near / np.where(depth > 0, depth, 1.0), 1e9)
    along_axis = directions @ -camera.transform[:3, 2]
    return origin + directions * (distance / along_axis)[..., None]


def project(camera, positions):
    """Positions (h, w, 2) in the picture, in pixels from the top left, of world positions (h, w, 3)."""
    size = np.array(positions.shape[1::-1])
    view = (positions - camera.transform[:3, 3]) @ np.linalg.inv(camera.transform[:3, :3]).T
    parallel = camera.orthographic_height
    half_height = parallel / 2 if parallel else -view[..., 2:] * np.tan(camera.vertical_fov / 2)
    return (view[..., :2] / (half_height * np.array((size[0] / size[1], -1.0))) + 1) / 2 * size
