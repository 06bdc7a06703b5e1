"""A model of MuJoCo, or a robot in URDF, as a scene, saved. `python mujoco_scene.py [model.xml | robot.urdf]`."""

import sys

import mujoco
import numpy as np

import solari_vk as sv

MODEL = f"{__file__.removesuffix('.py')}.xml"
BRIGHT = 6e4  # lux, as of a sun: what EV100 14 is for
UP = np.array([(1.0, 0, 0, 0), (0, 0, 1, 0), (0, -1, 0, 0), (0, 0, 0, 1)])  # MuJoCo's z axis is up, ours is y
SHAPES = {"PLANE": lambda x, z, _: sv.shapes.plane(2 * x, 2 * z), "SPHERE": lambda r, *_: sv.shapes.sphere(r),
          "CAPSULE": lambda r, y, _: sv.shapes.capsule(r, 2 * y), "CYLINDER": lambda r, y, _:
          sv.shapes.cylinder(r, 2 * y), "BOX": lambda x, z, y: sv.shapes.box((-x, -y, -z), (x, y, z))}  # fmt: skip


def poses(data, kind):
    """Of geoms ("geom") or cameras ("cam") in the states of one or more worlds, (worlds, number, 4, 4)."""
    places, axes = (np.stack([getattr(one, f"{kind}_{what}") for one in data]) for what in ("xpos", "xmat"))
    found = np.tile(UP, (*places.shape[:2], 1, 1))
    found[..., :3, :] = UP[:3, :3] @ np.concatenate([axes.reshape(*places.shape, 3), places[..., None]], axis=-1)
    return found @ UP.T if kind == "geom" else found


def mesh_of(model, geom):
    kind = mujoco.mjtGeom(model.geom_type[geom]).name[7:]
    if kind != "MESH":
        return SHAPES[kind](*model.geom_size[geom])
    mesh = model.mesh(model.geom_dataid[geom])
    vertices, faces = model.mesh_vert[mesh.vertadr[0] :] @ UP[:3, :3].T, slice(mesh.faceadr[0], None)
    corners = model.mesh_face[faces][: mesh.facenum[0]]
    if mesh.texcoordadr[0] < 0:
        return sv.Mesh(vertices[: mesh.vertnum[0]], corners)
    uvs = model.mesh_texcoord[mesh.texcoordadr[0] :][model.mesh_facetexcoord[faces][: mesh.facenum[0]]]
    return sv.Mesh(vertices[corners].reshape(-1, 3), uvs=uvs.reshape(-1, 2))


def material_of(model, geom):
    """With a picture of 2D as it is, and of a cube its first side on all."""
    number = model.geom_matid[geom]
    rgba = model.geom_rgba[geom] if number < 0 else model.mat_rgba[number]
    fields = {"base_color": rgba[:3], "alpha": rgba[3], "alpha_mode": "blend" if rgba[3] < 1 else "opaque"}
    if number < 0:
        return sv.Material(roughness=0.6, **fields)
    texture = model.mat_texid[number, mujoco.mjtTextureRole.mjTEXROLE_RGB]
    if texture >= 0:
        width, height, channels = model.tex_width[texture], model.tex_height[texture], model.tex_nchannel[texture]
        pixels = model.tex_data[model.tex_adr[texture] :][: width * height * channels].reshape(height, width, channels)
        across = model.mat_texrepeat[number] * (2 * model.geom_size[geom, :2] if model.mat_texuniform[number] else 1)
        image = sv.TextureImage(pixels if model.tex_type[texture] == mujoco.mjtTexture.mjTEXTURE_2D else pixels[:width])
        fields["base_color_texture"] = sv.Texture(image, uv_transform=np.c_[np.diag(across), [0, 0]])
    fields |= {"emissive": BRIGHT / np.pi * model.mat_emission[number] * rgba[:3]}
    return sv.Material(roughness=0.6, metallic=max(model.mat_metallic[number], 0.0), **fields)


def add_lights(scene, model, data):
    """The model's own, else a sky. A diffuse color of 1 gives BRIGHT lux in the middle of the model."""
    for index, color in enumerate(model.light_diffuse):
        place, along = data.light_xpos[index] @ UP[:3, :3].T, data.light_xdir[index] @ UP[:3, :3].T
        kind = mujoco.mjtLightType(model.light_type[index]).name[8:]
        candela = BRIGHT * np.sum((data.light_xpos[index] - model.stat.center) ** 2)
        if kind == "DIRECTIONAL":
            scene.add(sv.DirectionalLight(along, illuminance=BRIGHT, color=color))
        elif kind == "SPOT":
            cone = np.radians(min(model.light_cutoff[index], 89.0))
            scene.add(sv.SpotLight(place, along, intensity=candela, color=color, outer_cone_angle=cone))
        elif kind == "POINT":
            scene.add(sv.PointLight(place, intensity=candela, color=color))
    scene.environment = sv.Environment(np.full((2, 4, 3), 0.1 * BRIGHT / np.pi)) if model.nlight else sv.Sky()


def make_scene(model):
    """With an instance for each geom, whose number is its name."""
    scene, data = sv.Scene(), mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    add_lights(scene, model, data)
    for index, pose in enumerate(poses([data], "geom")[0]):
        scene.add(mesh_of(model, index), material_of(model, index), pose, name=str(index))
    for pose, fov in zip(poses([data], "cam")[0], model.cam_fovy, strict=True):
        scene.add(sv.Camera(transform=pose, fov=float(fov), ev100=14))
    return scene


if __name__ == "__main__":
    make_scene(mujoco.MjModel.from_xml_path((sys.argv[1:] or [MODEL])[0])).save("model.glb")
