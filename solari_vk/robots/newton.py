"""`sv.newton.SensorCamera`: Newton's camera sensor, with this renderer's light."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.color import decode_srgb
from solari_vk.base.errors import SolariError, quoted, warn
from solari_vk.batch.batch import Batch
from solari_vk.gpu.acceleration.checks import whole_number
from solari_vk.gpu.device.device import Device
from solari_vk.output.tone_mapping import encode_srgb
from solari_vk.robots.poses import scene_transforms, up_matrix
from solari_vk.scene import shapes
from solari_vk.scene.files.libraries import library
from solari_vk.scene.files.mujoco import geoms
from solari_vk.scene.files.mujoco.lights import FULL
from solari_vk.scene.files.mujoco.surfaces import WHITE
from solari_vk.scene.lights.directional import DirectionalLight
from solari_vk.scene.lights.environment import Environment
from solari_vk.scene.material import Material
from solari_vk.scene.matrices import unit
from solari_vk.scene.meshes.smoothing import smooth_normals
from solari_vk.scene.model import Instance, Mesh, Scene

INSTALL = "pip install newton"
SKY, GROUND = (0.2, 0.2, 0.225), (0.05, 0.05, 0.06)  # Newton's ambient light
FAR = 1000.0  # meters: half the width of a plane without end, divided by geoms.INFINITE
_VISIBLE = 1  # of newton.ShapeFlags
_ROWS = 16  # of the picture of the ambient light
_STRAIGHT = 1e-4  # of a ray's direction: more isn't a pinhole's
# The outputs of `update`, and the results of Batch that they are made of.
_LABELS = {
    "depth_image": "distance",
    "forward_depth_image": "depth",
    "normal_image": "shading_normal",
    "shape_index_image": "instance_id",
    "albedo_image": "albedo",
}
_LIT = ("color_image", "hdr_color_image")


def _newton(module: str) -> Any:
    return library(module, "newton.SensorCamera", INSTALL)


def _helper(name: str) -> Any:
    """A static function of Newton's own sensor."""

    def function(*values: Any, **options: Any) -> Any:
        return getattr(_newton("newton.sensors").SensorCamera, name)(*values, **options)

    return staticmethod(function)


def _allocate(dtype: str) -> Any:
    """A method that makes a zeroed array of Warp (view_count, height, width) of this type."""

    def method(self: SensorCamera, view_count: int, width: int, height: int) -> Any:
        return self.allocate_image(view_count, width, height, getattr(_newton("warp"), dtype))

    return method


class SensorCamera:
    """Newton's `SensorCamera`, drawn by this renderer: the same constructor, helpers and `update`.

    model: a `newton.Model`, whose worlds have the same shapes, each with its own poses and colors. device: one that is
    open, else the sensor opens its own. renderer: "realtime", of which each `update` renders `frames`, or "reference"
    with `samples` a pixel. Depth, normals, shape indices and albedo are those that Newton's sensor writes. Colors are
    lit: by the sky and ground of `set_ambient_light` and the sun of `create_default_light`, with bounces and shadows,
    where a light of 1 shows a white surface as 1. Results are copied by the host.

    Rays must be those of a pinhole, one a pixel. Particles, cloth and splats aren't drawn, of which a warning tells.
    Raises SolariError for worlds with different shapes, rays of other lenses, and arrays of another shape.
    """

    def __init__(
        self,
        model: Any,
        *,
        default_clear_data: Any = None,
        default_render_config: Any = None,
        load_textures: bool = True,
        device: Device | None = None,
        renderer: str = "realtime",
        frames: int = 4,
        samples: int = 64,
        seed: int = 0,
    ) -> None:
        types = _newton("newton.sensors").SensorCamera
        self.model = model
        self.default_clear_data = types.ClearData() if default_clear_data is None else default_clear_data
        self.default_render_config = types.RenderConfig() if default_render_config is None else default_render_config
        self._load_textures = load_textures
        self._renderer = renderer
        self._frames = whole_number(frames, "newton.SensorCamera: frames", 1)
        self._samples = whole_number(samples, "newton.SensorCamera: samples", 1)
        self._seed = seed
        self._up = up_matrix(int(model.up_axis))
        self.scene = Scene()
        """The Scene of one world, whose lights may be changed."""
        self._shapes = self._add_shapes()
        self.set_ambient_light(SKY, GROUND)
        self._owned = ExitStack()
        self._device = self._owned.enter_context(Device()) if device is None else device
        self._batches: dict[Any, Batch] = {}

    # ---- the model ----------------------------------------------------------------------------------

    def _add_shapes(self) -> NDArray[np.int32]:
        """Add the instances of a world. Returns the numbers (worlds, K) of their shapes in each."""
        model = self.model
        worlds = max(int(model.world_count), 1)
        kinds = {int(kind): kind.name for kind in _newton("newton").GeoType}
        flags, of_world = model.shape_flags.numpy(), model.shape_world.numpy()
        types, scales, colors = (values.numpy() for values in (model.shape_type, model.shape_scale, model.shape_color))
        visible = np.flatnonzero(flags & _VISIBLE)
        shared = visible[of_world[visible] < 0]
        each = [visible[of_world[visible] == world] for world in range(worlds)]
        table = np.array([np.concatenate([shared, own]) for own in each if len(own) == len(each[0])], np.int32)
        same = len(table) == worlds and all(
            (values[table] == values[table[0]]).all() for values in (types, scales.round(6))
        )
        if not same or any(
            model.shape_source[shape] is not model.shape_source[table[0, k]]
            for row in table[1:]
            for k, shape in enumerate(row)
        ):
            raise SolariError("newton.SensorCamera: worlds have different shapes: make a sensor for each kind of world")
        left_out = set()
        keep = []
        for column, shape in enumerate(table[0].tolist()):
            kind = kinds[int(types[shape])]
            mesh = _mesh(kind, scales[shape], model.shape_source[shape])
            if mesh is None:
                left_out.add(kind.lower())
                continue
            keep.append(column)
            material = _material(model, shape, colors[shape], self._load_textures)
            self.scene.add(Instance(mesh, material, name=f"{model.shape_label[shape]} {shape}"))
        if getattr(model, "particle_count", 0):
            left_out.add("particles")
        if left_out:
            warn(f"newton.SensorCamera: not drawn: {', '.join(sorted(left_out))}")
        self._world_materials = {
            instance: [_material(model, int(row), colors[row], self._load_textures) for row in table[:, column]]
            for instance, column in zip(self.scene, keep, strict=True)
            if np.ptp(colors[table[:, column]], axis=0).any()
        }
        return table[:, keep]

    # ---- Newton's interface -------------------------------------------------------------------------

    @property
    def device(self) -> Any:
        """The device of the model, as Newton has it."""
        return self.model.device

    def allocate_image(self, view_count: int, width: int, height: int, dtype: Any) -> Any:
        """A zeroed array of Warp (view_count, height, width)."""
        return _newton("warp").zeros((int(view_count), int(height), int(width)), dtype=dtype, device=self.device)

    allocate_image_color = _allocate("uint32")
    allocate_image_color_hdr = _allocate("vec3f")
    allocate_image_depth = _allocate("float32")
    allocate_image_depth_forward = _allocate("float32")
    allocate_image_normal = _allocate("vec3f")
    allocate_image_shape_index = _allocate("uint32")
    allocate_image_albedo = _allocate("uint32")

    compute_camera_rays_pinhole = _helper("compute_camera_rays_pinhole")
    compute_camera_rays_pinhole_opencv = _helper("compute_camera_rays_pinhole_opencv")
    compute_camera_rays_pinhole_usd = _helper("compute_camera_rays_pinhole_usd")
    compute_camera_rays_fisheye_opencv = _helper("compute_camera_rays_fisheye_opencv")
    compute_camera_rays_fisheye_ftheta = _helper("compute_camera_rays_fisheye_ftheta")
    compute_camera_rays_fisheye_kannala_brandt = _helper("compute_camera_rays_fisheye_kannala_brandt")
    compute_camera_transforms_usd = _helper("compute_camera_transforms_usd")

    def create_default_light(self, *, enable_shadows: bool = True, direction: Any = None, color: Any = None) -> None:
        """A sun in place of the one before, as Newton's: by default along (-1, 1, -1) where z is up. It casts shadows
        in any case. color: linear; 1 shows a white surface as 1."""
        along = np.array((-1.0, 1.0, -1.0)) @ geoms.UP.T if direction is None else self._up @ np.array(list(direction))
        fields = {"direction": along, "color": np.array((1.0, 1.0, 1.0) if color is None else list(color))}
        if "sun" in self.scene.lights:
            self.scene.lights["sun"].update(**fields)
        else:
            self.scene.add(DirectionalLight(illuminance=FULL, name="sun", **fields))

    def set_ambient_light(self, sky_color: Any, ground_color: Any = None) -> None:
        """Light from all around: of the sky, and of the ground (the sky's), linear, which blend from up to down."""
        sky = np.array(list(sky_color), np.float64)
        ground = sky if ground_color is None else np.array(list(ground_color), np.float64)
        height = np.cos(np.pi * (np.arange(_ROWS) + 0.5) / _ROWS)[:, None, None]
        self.scene.environment = Environment(WHITE * (ground + (sky - ground) * (height + 1) / 2), name="ambient")

    def update(
        self,
        state: Any,
        camera_transforms: Any,
        camera_rays: Any,
        *,
        world_indices: Any = None,
        clear_data: Any = None,
        render_config: Any = None,
        sync_deformables: bool = True,
        deformable_visuals: Any = None,
        **images: Any,
    ) -> None:
        """Render views into arrays of Warp (views, height, width): color_image, hdr_color_image, depth_image,
        forward_depth_image, normal_image, shape_index_image, albedo_image.

        Arguments are those of Newton's `SensorCamera.update`: poses (views,), rays (height, width, 1, 2), the world of
        each view. render_config, sync_deformables and deformable_visuals have no effect.
        """
        wanted = {name: image for name, image in images.items() if image is not None}
        for name in images.keys() - {*_LABELS, *_LIT}:
            raise SolariError(f"newton.SensorCamera.update has no {quoted(name)}: give {', '.join((*_LABELS, *_LIT))}")
        views = int(camera_transforms.shape[0])
        worlds = len(self._shapes)
        which = np.arange(views) if world_indices is None else world_indices.numpy().astype(np.int64)
        if world_indices is None and views > worlds:
            raise SolariError(f"newton.SensorCamera.update: {views} views of {worlds} worlds need world_indices")
        matrix, size = _lens(camera_rays)
        for name, image in wanted.items():
            if tuple(image.shape) != (views, size[1], size[0]):
                raise SolariError(
                    f"newton.SensorCamera.update: {name} must be {(views, size[1], size[0])}, not {image.shape}"
                )
        shown = (which >= 0) & (which < worlds)
        places, count = _places(np.where(shown, which, 0), shown, worlds)
        cameras = scene_transforms(self._up, camera_transforms)[np.maximum(places, 0)]
        poses = self._poses(state)
        clear = self.default_clear_data if clear_data is None else clear_data
        # Numbers of the batch's views, by those of the caller.
        order = np.zeros(views, np.int64)
        order[places[places >= 0]] = np.flatnonzero(places >= 0)
        for labels in (True, False):
            names = [name for name in wanted if (name in _LABELS) == labels]
            if names:
                batch = self._rendered(labels, size, worlds * count, poses, cameras, matrix)
                for name in names:
                    found = self._result(batch, name, clear, which)[order] if shown.any() else None
                    self._write(wanted[name], found, _clear_value(name, clear), which, shown)

    def _poses(self, state: Any) -> NDArray[np.float64]:
        """The transforms (worlds, K, 4, 4) of the instances."""
        model = self.model
        bodies = None if state.body_q is None or not len(state.body_q) else state.body_q
        found = scene_transforms(self._up, model.shape_transform, bodies, model.shape_body)
        return found[self._shapes]

    def _rendered(
        self, labels: bool, size: tuple[int, int], views: int, poses: Any, cameras: Any, matrix: Any
    ) -> Batch:
        key = labels, size, views
        worlds = len(self._shapes)
        if key not in self._batches:
            kind: dict[str, Any] = {"renderer": self._renderer, "outputs": (), "seed": self._seed}
            if labels:
                kind = {"outputs": tuple(_LABELS.values())}
            batch = Batch(self._device, self.scene, size, views, worlds=worlds, **kind)
            self._batches[key] = self._owned.enter_context(batch)
            for instance, materials in self._world_materials.items() if worlds > 1 else ():
                batch.world_materials[instance] = materials
        batch = self._batches[key]
        instances = self.scene.instances[:]
        if worlds > 1:
            batch.transforms[instances] = poses
        else:
            for instance, transform in zip(instances, poses[0], strict=True):
                instance.transform = transform
        repeats = 1 if labels or self._renderer == "reference" else self._frames
        options: dict[str, Any] = {"samples": self._samples} if not labels and self._renderer == "reference" else {}
        for _ in range(repeats):
            batch.render(cameras, K=matrix, near=1e-4, **options)
        return batch

    def _result(self, batch: Batch, name: str, clear: Any, which: Any) -> NDArray[Any]:
        """An output of all views of a batch, in the order of the batch."""
        if name in _LIT:
            radiance = batch["radiance"] / WHITE
            return radiance if name == "hdr_color_image" else _packed(radiance)
        values = batch[_LABELS[name]]
        if name == "normal_image":
            return np.asarray(values @ self._up)
        if name == "albedo_image":
            return np.where(np.isfinite(batch["depth"]), _packed(values), np.uint32(clear.clear_albedo))
        if name == "shape_index_image":
            rows = np.arange(len(values)) // (len(values) // len(self._shapes))
            numbers = np.minimum(values, self._shapes.shape[1])
            background = np.full((len(self._shapes), 1), clear.clear_shape_index, np.int64)
            table = np.concatenate([self._shapes[:, self._columns(batch)], background], axis=1)
            found: NDArray[np.uint32] = table[rows[:, None, None], numbers].astype(np.uint32)
            return found
        return np.where(np.isfinite(values), values, np.float32(clear.clear_depth))

    def _columns(self, batch: Batch) -> list[int]:
        """The column of `_shapes` of each number in "instance_id"."""
        column = {instance: index for index, instance in enumerate(self.scene)}
        return [column[instance] for _, instance in sorted(batch.instances.items())]

    def _write(self, image: Any, found: Any, clear: Any, which: Any, shown: Any) -> None:
        values = image.numpy()
        flag = _newton("newton.sensors").SensorCamera.WorldRenderFlag.DISABLE_PRESERVE
        values[(which != int(flag)) & ~shown] = clear
        if found is not None:
            values[shown] = found[shown]
        image.assign(values)

    def close(self) -> None:
        """Free everything on the device. Safe to call twice."""
        self._batches.clear()
        self._owned.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _mesh(kind: str, scale: Any, source: Any) -> Mesh | None:
    """The mesh of a shape in its own frame, z along its axis; None for what isn't drawn."""
    a, b, c = (float(value) for value in scale)
    match kind:
        case "PLANE":
            return geoms.primitive("PLANE", np.array([a / 2, b / 2, 0]), FAR)
        case "SPHERE":
            return geoms.primitive("SPHERE", np.array([a, a, a]), FAR)
        case "CAPSULE" | "CYLINDER":
            return geoms.primitive(kind, np.array([a, a, b]), FAR)
        case "ELLIPSOID" | "BOX":
            return geoms.primitive(kind, np.array([a, b, c]), FAR)
        case "CONE":
            return geoms.upright(shapes.cone(a, 2 * b, 48))
        case "MESH" | "CONVEX_MESH":
            return _source_mesh(source, np.array([a, b, c]))
    return None


def _source_mesh(source: Any, scale: NDArray[Any]) -> Mesh:
    positions: Any = np.asarray(source.vertices, np.float64) * scale
    triangles: Any = np.asarray(source.indices, np.int64).reshape(-1, 3)
    uvs = getattr(source, "uvs", None)
    normals = getattr(source, "normals", None)
    if normals is not None:
        turned: Any = unit(np.asarray(normals) / scale)
        return Mesh(positions, triangles, normals=turned, uvs=uvs)
    index, smooth, corners = smooth_normals(positions, triangles)
    placed: Any = positions[index]
    return Mesh(placed, corners, normals=smooth, uvs=None if uvs is None else np.asarray(uvs)[index])


def _material(model: Any, shape: int, color: Any, load_textures: bool) -> Material:
    """Colors and pictures are sRGB in Newton."""
    opacity = 1.0 if model.shape_opacity is None else float(model.shape_opacity.numpy()[shape])
    fields: dict[str, Any] = {"base_color": decode_srgb(color), "alpha": opacity, "name": model.shape_label[shape]}
    fields["alpha_mode"] = "blend" if opacity < 1 else "opaque"
    source = model.shape_source[shape]
    for name in ("roughness", "metallic"):
        value = getattr(source, name, None)
        if value is not None:
            fields[name] = min(max(float(value), 0.0), 1.0)
    texture = getattr(source, "texture", None)
    if load_textures and texture is not None and getattr(source, "uvs", None) is not None:
        fields["base_color_texture"] = texture
    return Material(**fields)


def _lens(rays: Any) -> tuple[NDArray[np.float64], tuple[int, int]]:
    """OpenCV's matrix (3, 3) of rays (height, width, 1, 2), and the width and height."""
    found = rays.numpy().reshape(rays.shape[0], rays.shape[1], -1, 2, 3).astype(np.float64)
    if found.shape[2] != 1:
        raise SolariError("newton.SensorCamera.update: rays must be one a pixel: pictures are antialiased anyway")
    origins, along = found[:, :, 0, 0], found[:, :, 0, 1]
    height, width = along.shape[:2]
    x, y = along[..., 0] / -along[..., 2], along[..., 1] / along[..., 2]
    columns, rows = np.arange(width), np.arange(height)
    # x = (column - cx) / fx, so that a line through all pixels has the slope 1 / fx.
    (slope_x, start_x), (slope_y, start_y) = np.polyfit(columns, x[0], 1), np.polyfit(rows, y[:, 0], 1)
    fits = np.abs(x - (slope_x * columns + start_x)).max(), np.abs(y - (slope_y * rows + start_y)[:, None]).max()
    if origins.any() or not max(fits) < _STRAIGHT or (along[..., 2] >= 0).any() or min(slope_x, slope_y) <= 0:
        raise SolariError(
            "newton.SensorCamera.update: rays aren't a pinhole's: give those of compute_camera_rays_pinhole"
        )
    return np.array([(1 / slope_x, 0, -start_x / slope_x), (0, 1 / slope_y, -start_y / slope_y), (0, 0, 1)]), (
        width,
        height,
    )


def _places(which: NDArray[Any], shown: NDArray[Any], worlds: int) -> tuple[NDArray[np.int64], int]:
    """The caller's view at each place of a batch, whose worlds have as many views each, -1 for none; and how many."""
    counts = np.bincount(which[shown], minlength=worlds)
    most = max(int(counts.max(initial=0)), 1)
    places = np.full((worlds, most), -1, np.int64)
    for world in range(worlds):
        places[world, : counts[world]] = np.flatnonzero(shown & (which == world))
    return places.ravel(), most


def _packed(colors: NDArray[Any]) -> NDArray[np.uint32]:
    """Linear colors as sRGB bytes, red lowest, with an alpha of 255."""
    red, green, blue = np.moveaxis(np.rint(255 * encode_srgb(colors)).astype(np.uint32), -1, 0)
    packed: NDArray[Any] = red | green << 8 | blue << 16 | np.uint32(255 << 24)
    return packed


def _clear_value(name: str, clear: Any) -> Any:
    values = {
        "color_image": clear.clear_color, "hdr_color_image": 0.0, "depth_image": clear.clear_depth,
        "forward_depth_image": clear.clear_depth, "normal_image": clear.clear_normal,
        "shape_index_image": clear.clear_shape_index, "albedo_image": clear.clear_albedo,
    }  # fmt: skip
    return values[name]
