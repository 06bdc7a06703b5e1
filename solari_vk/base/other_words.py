"""What other programs call things, and what they are called here: errors for unknown names say it."""

from __future__ import annotations

_ENVIRONMENT = "Environment(path) is the light of a .hdr or .exr file: scene.environment = Environment(path)"
_SUN = "DirectionalLight(direction) is a sun, Sky(direction) a sky with one"
_ARRAY = 'frame["radiance"] is the array in cd/m^2, frame.image() the picture in 8 bits'
_EYE = "Camera.look_at(position, target) makes a camera, camera.place(position, target) moves one"
_MOVE = "assign to position, rotation or transform"
_MAKE = "scene.add(mesh, material, position) makes an object of a mesh"
_PARTS = "position, rotation, scale or transform say where it is"
_FLUX = "intensity is in cd, lumens in lm"
_MOVED = "meshes have no place: give position, rotation, scale or transform to scene.add, or assign to the instance's"
_OWN_MATERIAL = "colors are the material's: scene.add(mesh, Material(base_color=...))"
_LENS = "fov is in degrees, vertical_fov in radians, both from the bottom to the top of the picture"
_LOAD = "solari_vk.open(path) is a file framed and lit, solari_vk.load(path) the file as it is"
_SHAPE = "solari_vk.shapes has box, sphere, plane, cylinder, cone, capsule and torus"
_SAMPLES = "samples are given to render: tracer.render(samples=256)"
_SIZE = "the size is one pair: (device, scene, (width, height))"
_PICTURE = "tracer.render(samples=256).save(path) makes a picture and writes it; frame.image() is an array in 8 bits"
_SHADOWS = "everything casts shadows and receives them; visible=False hides an object"
_AMBIENT = "light comes from lights alone: scene.environment = Environment(0.3) is even light from all around"
_ORBIT = "Camera.look_at(position, target) for each picture, or solari-vk render --animate orbit"
_ANNOTATED = "Annotations(frame.labels, objects=frame.objects) has coco and yolo; `solari-vk dataset` writes files"
_PAIR = "CameraRig.stereo(camera, baseline).at() is a pair; Flow has its disparity (optical_flow)"
_GROUP = "group = scene.group(*objects) moves objects together: group.position, group.rotation, group.scale"
_PARENT = dict.fromkeys(("parent", "children", "set_parent", "parent_to", "attach", "add_child"), _GROUP)
_FALL = "scene.drop(...) lets things fall until they rest"
_LABEL = "it is called label here, and is text"
_NOT_HERE = "there are no volumes, curves and node graphs: see docs/explained/limits.md"
_FOCAL = "fov is in degrees: 2 atan(12 mm / focal length), 27 of a lens of 50 mm"
_LIT = 'renderer="reference" gives a batch radiance, renderer="realtime" raw_radiance and display too'
_LAMP = "scene.add(PointLight(position, lumens=800)) adds a lamp; so with SpotLight and DirectionalLight"
_LIGHT_IT = "assign: scene.environment = Environment(path), or Sky()"
_BACKGROUND = (
    "scene.environment = Environment((0.9, 0.9, 1)) is a background of one color, and its light; "
    "scene.backdrop is the floor of studio_lights"
)
_WHOLE = "Camera.framing(scene.bounds) sees the whole scene"
_COPY = "copy.deepcopy(scene) is a copy with objects of its own; scene.add(other_scene) shares meshes and materials"
_COPIED = "copy.copy(instance) shares its mesh and material: scene.add(copy.copy(instance)) adds it"
_LABELS = "give --annotations coco,yolo,objects,bop, with --labels FILE or labels in the model's file"
_QUALITY = "Settings.preset('high') has the settings of a quality: low, medium, high, ultra, solari"
_PRECISE = "exposure takes a factor: exposure=Camera(ev100=12).exposure"
_CURVES = {
    **dict.fromkeys(("ev100", "ev"), _PRECISE),
    **dict.fromkeys(("tonemap", "method", "operator", "kind"), "curve takes the name of a tone curve"),
    "gamma": "tonemap's colors are linear; encode_picture gives sRGB codes",
}
_RESULTS = {
    **dict.fromkeys(
        ("segmentation", "instance", "instances", "mask", "id", "ids", "seg"),
        'frame["instance_id"] numbers what pixels show, frame.mask(name) is where an object is seen',
    ),
    **dict.fromkeys(("normal", "normals"), 'there are "shading_normal" and "geometric_normal"'),
    **dict.fromkeys(("picture", "rgb", "color", "image", "combined", "beauty"), _PICTURE),
    **dict.fromkeys(("points", "point_cloud", "xyz", "positions"), '"position" is (height, width, 3) in the world'),
    **dict.fromkeys(("flow", "motion", "optical_flow"), '"guides_motion" is of realtime frames; see optical_flow'),
}
_OPTIONS = {
    **dict.fromkeys(("--resolution", "--width", "--height", "--res"), "give --size 640x360"),
    **dict.fromkeys(("--outputs", "--layers", "--passes", "--aovs"), "give --aov depth,instance_id"),
    **dict.fromkeys(("--spp", "--num-samples"), "give --samples 64"),
    **dict.fromkeys(("--n", "--count", "--num-views", "--frames"), "dataset takes --views 100"),
}
_COCO = dict.fromkeys(("--coco", "--yolo", "--bop", "--annotation", "--masks", "--boxes"), _LABELS)
_SURFACE = {
    "color": "base_color",
    "albedo": "base_color",
    "diffuse": "base_color",
    "diffuse_color": "base_color",
    "metalness": "metallic",
}

# By what is asked: by lower-case name, what to say.
OTHER_WORDS: dict[str, dict[str, str]] = {
    "solari_vk": {
        **dict.fromkeys(("environmentmap", "envmap", "hdri", "skybox", "background", "imagebasedlight"), _ENVIRONMENT),
        **dict.fromkeys(("sun", "sunlight", "distantlight"), _SUN),
        **dict.fromkeys(("sphere", "box", "cube", "plane", "cylinder", "quad", "torus", "cone", "capsule"), _SHAPE),
        **dict.fromkeys(("studio", "studiolight", "studiolighting"), "studio_lights(scene) adds soft boxes"),
        **dict.fromkeys(
            ("arealight", "rectlight", "quadlight", "rectarealight"),
            "a mesh that emits is an area light: scene.add(shapes.quad(...), Material(emissive=...))",
        ),
        **dict.fromkeys(("light", "pointlights"), "use PointLight, SpotLight, DirectionalLight, Environment, Sky"),
        **dict.fromkeys(
            ("perspectivecamera", "orthographiccamera", "sensor_perspective", "pinholecamera"),
            "Camera(fov=50) is one, Camera(orthographic_height=2) is parallel",
        ),
        **dict.fromkeys(
            ("offscreenrenderer", "webglrenderer", "rasterizer", "integrator", "film"),
            f"Renderer and PathTracer make pictures, without a window; {_SIZE}",
        ),
        **dict.fromkeys(("ambientlight", "hemispherelight"), _AMBIENT),
        **dict.fromkeys(
            ("color", "vec3", "vector3", "vector", "transform", "matrix4", "transform4f"),
            "colors, points and matrices are numpy arrays or tuples; '#ff8000' is a color too",
        ),
        **dict.fromkeys(("boxgeometry", "spheregeometry", "planegeometry", "torusgeometry"), _SHAPE),
        **dict.fromkeys(
            (
                "meshstandardmaterial",
                "meshphysicalmaterial",
                "meshbasicmaterial",
                "principled",
                "bsdf",
                "metallicroughnessmaterial",
                "principledbsdf",
            ),
            "Material is the one surface there is",
        ),
        **dict.fromkeys(("fog", "volume", "medium", "hair", "subsurface"), _NOT_HERE),
        **dict.fromkeys(("bitmap", "util", "write_bitmap", "imwrite"), _PICTURE),
        **dict.fromkeys(("turntable", "orbit"), _ORBIT),
        **dict.fromkeys(("load_dict", "load_string"), "Scene() is empty: scene.add(mesh, material, position) fills it"),
        **dict.fromkeys(
            ("render", "trace", "raytrace"),
            "Renderer(device, scene, size).render() is realtime, PathTracer(...) the reference",
        ),
        **dict.fromkeys(("object", "node", "model", "shape", "entity", "actor"), _MAKE),
        **dict.fromkeys(("cocowriter", "yolowriter", "save_coco", "write_coco", "coco", "annotate"), _ANNOTATED),
        **dict.fromkeys(("stereo", "stereocamera", "stereopair"), _PAIR),
        **dict.fromkeys(("dataset", "datasetwriter", "writer"), "Views(folder) reads what `solari-vk dataset` writes"),
        **dict.fromkeys(("physics", "simulate", "simulation"), _FALL),
        **dict.fromkeys(("rmse", "mse", "relmse", "psnr", "error", "diff", "metrics"), "compare(picture, reference)"),
        **dict.fromkeys(
            ("load_image", "read_image", "imread"),
            "compare takes paths of pictures, Environment and textures too; others are read by PIL",
        ),
        **dict.fromkeys(
            ("rotation", "euler_angles", "quaternion", "rotate"),
            "euler(x, y, z) makes a rotation of angles in degrees, for position, rotation and scale",
        ),
        **dict.fromkeys(("load_scene", "load_file", "load_mesh", "read", "load_obj"), _LOAD),
    },
    "shapes": {
        "cube": "box(low, high) is one",
        "rectangle": "plane, quad and polygons are flat",
        "disk": "see polygons",
        **dict.fromkeys(("icosphere", "uv_sphere", "ball"), "sphere(radius) is one"),
    },
    "shapes.box": dict.fromkeys(("size", "extents", "width"), "low and high are opposite corners, (3,) each"),
    "shapes.plane": dict.fromkeys(("size", "length"), "width is along x and depth along z"),
    "solari_vk.load": dict.fromkeys(
        ("hdri", "environment", "envmap", "lights", "sky"),
        "open(path, environment=...) lights a file; load gives it as it is",
    ),
    "Scene": {
        **dict.fromkeys(("ambient_light", "ambient", "world"), _AMBIENT),
        **dict.fromkeys(("background", "bg_color", "background_color"), _BACKGROUND),
        **dict.fromkeys(("frame", "fit", "frame_all", "center", "zoom", "fit_camera"), _WHOLE),
        **dict.fromkeys(("copy", "clone", "duplicate"), _COPY),
        **dict.fromkeys(("add_light", "add_point_light", "point_light", "add_lamp", "light"), _LAMP),
        **dict.fromkeys(("set_environment", "set_sky", "add_environment", "add_sky"), _LIGHT_IT),
        **dict.fromkeys(("fog", "volume", "medium", "atmosphere"), _NOT_HERE),
        **dict.fromkeys(("add_node", "add_mesh", "add_object", "add_geometry"), _MAKE),
        **dict.fromkeys(("remove_node", "clear", "delete", "remove_mesh"), "remove(object or name) takes one out"),
        **dict.fromkeys(
            ("get_nodes", "get", "find", "get_object_by_name", "getobjectbyname"),
            "scene.instances[name] is an object, scene.lights[name] a light",
        ),
        **dict.fromkeys(
            ("rotate", "rotation", "translate", "position", "scale", "set_pose"),
            "scene.group(*scene.instances) has a position, rotation and scale; so have instances",
        ),
        **dict.fromkeys(("load", "open", "from_file", "from_gltf"), _LOAD),
        **dict.fromkeys(("render", "show", "view"), "Renderer(device, scene, size).render() makes pictures of it"),
        **dict.fromkeys(("simulate", "physics", "fall", "settle", "simulate_physics"), _FALL),
        **dict.fromkeys(("parent", "set_parent", "attach", "link"), _GROUP),
        **dict.fromkeys(("objects", "children", "nodes", "entities"), "instances are its objects, by number or name"),
        **dict.fromkeys(("envmap", "hdri", "sky"), "environment is its light from all around"),
    },
    "Scene.add": _PARENT,
    "Scene.drop": {"gravity": "things fall as on the earth, along -y"},
    "Scene.animate": {"time": "write scene.animate(seconds, clip)"},
    "Material": {
        **{word: f"it is called {ours} here" for word, ours in _SURFACE.items()},
        **dict.fromkeys(("emission", "emit", "emission_color"), "it is called emissive here, and is in cd/m^2"),
        **dict.fromkeys(
            ("emissive_strength", "emission_strength", "emissive_intensity", "emissive_power"),
            "emissive has it: the color times the strength, in cd/m^2",
        ),
        **dict.fromkeys(("opacity", "transparency"), "it is alpha, with alpha_mode='blend'; glass has transmission"),
        **dict.fromkeys(("glass", "refraction"), "transmission=1 is glass, solid=True glass that isn't thin"),
        **dict.fromkeys(("map", "texture", "image"), "base_color_texture takes a path, an array or a Texture"),
        **dict.fromkeys(
            ("lumens", "watts", "power", "lux", "nits"),
            "emissive is in cd/m^2: of a flat panel, lumens / (pi * its area in m^2)",
        ),
        "shininess": "it is called roughness here, and the other way round",
        "side": "see double_sided",
    },
    "Instance": {
        **_PARENT,
        **dict.fromkeys(("translation", "translate", "location", "rotate", "matrix", "pose", "rotation_euler"), _PARTS),
        **dict.fromkeys(("color", "base_color", "texture"), _OWN_MATERIAL),
        **dict.fromkeys(("castshadow", "receiveshadow", "cast_shadow", "hide_render", "hide", "hidden"), _SHADOWS),
        **dict.fromkeys(("rotate_y", "rotate_x", "set_position", "set_pose", "move", "lookat", "look_at"), _PARTS),
        **dict.fromkeys(("remove", "delete"), "scene.remove(object) takes one out"),
        **dict.fromkeys(("copy", "clone", "duplicate"), _COPIED),
        "active_material": "it is called material here",
        **dict.fromkeys(("category_id", "class_id", "category", "semantic", "semantic_id", "set_cp"), _LABEL),
    },
    "Mesh": {
        **dict.fromkeys(("translate", "position", "rotate", "rotation", "scale", "transform"), _MOVED),
        **dict.fromkeys(("to_trimesh", "as_trimesh"), "trimesh.Trimesh(mesh.positions, mesh.triangles) is one"),
        **dict.fromkeys(("load", "open", "from_file", "read"), f"{_LOAD}; scene.meshes are its meshes"),
    },
    "Camera": {
        **_PARENT,
        **dict.fromkeys(("eye", "origin", "target", "up", "lookat", "location", "to_world"), _EYE),
        **dict.fromkeys(("translate", "moved", "move", "move_to", "set_position"), f"{_MOVE}, or call place"),
        **dict.fromkeys(("yfov", "fovy", "angle", "field_of_view", "perspective"), _LENS),
        **dict.fromkeys(("lens", "focal_length", "focal"), _FOCAL),
        **dict.fromkeys(
            ("fx", "fy", "cx", "k", "from_k", "from_intrinsics", "from_matrix", "intrinsic_matrix"),
            "Camera.from_opencv(K, R, t, size), or without a pose (K, size=size), takes OpenCV's matrix",
        ),
        **dict.fromkeys(("panorama", "equirectangular", "spherical"), 'projection="equirectangular" is a panorama'),
        **dict.fromkeys(("orbit", "rotate", "set_pose", "lookat_from"), f"{_MOVE}, or call place"),
        **dict.fromkeys(
            ("width", "height", "resolution", "aspect", "aspect_ratio", "size"),
            "the size is the renderer's: Renderer(device, scene, (width, height))",
        ),
        **dict.fromkeys(("stereo", "baseline", "interocular_distance"), _PAIR),
        **dict.fromkeys(("orthographic", "ortho", "ortho_scale"), "orthographic_height is in meters"),
        **dict.fromkeys(("znear", "clip_start"), "it is called near here"),
        **dict.fromkeys(("fstop", "f_number", "dof"), "camera.focus_on(point, f_number) focuses as photographers do"),
    },
    "PointLight": {**_PARENT, **dict.fromkeys(("power", "energy", "watts", "brightness", "luminance"), _FLUX)},
    "Group": {**_PARENT, "children": "a loop over a group gives its objects, group.items those of groups in it too"},
    "SpotLight": {
        **_PARENT,
        **dict.fromkeys(("power", "energy", "watts", "brightness"), _FLUX),
        **dict.fromkeys(("angle", "spot_size", "cone_angle"), "outer_cone_angle is from the axis, in radians"),
        **dict.fromkeys(("target", "look_at"), "direction is the way it shines: target - position"),
    },
    "DirectionalLight": {
        **_PARENT,
        **dict.fromkeys(
            ("intensity", "strength", "energy", "irradiance", "lux", "lumens", "power"),
            "it is called illuminance here, and is in lux",
        ),
        **dict.fromkeys(("position", "location", "target"), "direction is the way it shines; a sun has no place"),
    },
    "Sky": dict.fromkeys(
        ("elevation", "sun_elevation", "azimuth", "sun_position", "rotation"),
        "sun_direction is towards the sun: (0, 1, 0) at the zenith, (1, 0.2, 0) low in the east",
    ),
    "Environment": {
        **dict.fromkeys(("path", "file", "filename", "url"), "image takes the path: Environment(path)"),
        **dict.fromkeys(("load", "open", "from_file", "read", "from_path"), "Environment(path) reads a file"),
        **dict.fromkeys(("strength", "scale"), "it is called intensity here"),
        **dict.fromkeys(("color", "radiance", "background"), "image takes one color too: Environment((1, 0.9, 0.8))"),
    },
    "Batch": {
        **dict.fromkeys(("radiance", "raw_radiance", "display", "picture", "image", "rgb", "color", "beauty"), _LIT)
    },
    "Settings": dict.fromkeys(("quality", "low", "medium", "high", "ultra", "solari", "from_preset"), _QUALITY),
    "solari_vk.tonemap": _CURVES,
    "solari_vk.encode_picture": _CURVES,
    "solari_vk.save_image": {
        **dict.fromkeys(("ev100", "ev"), _PRECISE),
        **dict.fromkeys(("image", "picture", "array"), "radiance takes the picture, (height, width, 3) in cd/m^2"),
    },
    "CameraRig": dict.fromkeys(("left", "right"), 'left, right = rig.at(); rig.cameras["left"] is on the body'),
    "RenderedFrame": {
        **dict.fromkeys(("motion", "flow", "optical_flow"), "optical_flow(ray_tracer, before, after) finds it"),
        **dict.fromkeys(("segmentation", "seg", "semantic", "ids", "instances_map"), _RESULTS["segmentation"]),
        **dict.fromkeys(("point_cloud", "points", "xyz"), 'frame["position"] is (height, width, 3) in the world'),
        **dict.fromkeys(("alpha", "shape"), 'image() has no alpha: np.isfinite(frame["depth"]) is where surfaces are'),
        **dict.fromkeys(
            ("to_srgb8", "to_uint8", "to_pil", "show", "rgb", "pixels"),
            "image() is the picture in 8 bits, save(path) writes it",
        ),
        **dict.fromkeys(("numpy", "array", "to_numpy", "data", "radiance"), _ARRAY),
        **dict.fromkeys(("depth", "normal", "normals", "albedo"), 'frame["depth"] is one of its results: see keys()'),
    },
    "RenderedFrame.save": {
        **dict.fromkeys(("transparent", "alpha"), 'none is written: np.isfinite(frame["depth"]) is where surfaces are'),
        **dict.fromkeys(("quality", "compression"), "a .jpg has 95; save frame.image() by Pillow for another"),
    },
    "--aov": {word: said for word, said in _RESULTS.items() if said != _PICTURE},
    "render": _OPTIONS,
    "dataset": {**_OPTIONS, **_COCO},
    "hits": {
        **dict.fromkeys(("distance", "distances", "depth"), "it is called t here, in lengths of the direction"),
        **dict.fromkeys(("point", "points", "location", "hit_position"), "it is called position here"),
        **dict.fromkeys(("hit", "valid", "mask"), "np.isfinite(hits.t) is where rays hit"),
        **dict.fromkeys(("triangle", "face", "primitive_id"), "it is called primitive here"),
    },
    "PathTracer": {
        **_RESULTS,
        **dict.fromkeys(("spp", "samples", "num_samples", "max_samples"), _SAMPLES),
        **dict.fromkeys(("width", "height", "resolution"), _SIZE),
        **dict.fromkeys(("denoise", "denoiser"), "tracer.render(samples=64, denoise=True) denoises by OIDN"),
        **dict.fromkeys(("save", "write", "screenshot"), "tracer.render(samples=256).save(path) writes a picture"),
        **dict.fromkeys(("max_depth", "bounces"), "max_bounces is how often light is reflected"),
        **dict.fromkeys(("irradiance", "illuminance"), "solari_vk.illuminance(device, scene, points) measures lux"),
    },
    "PathTracer.render": {
        **dict.fromkeys(("spp", "num_samples", "sample_count"), "it is called samples here"),
        **dict.fromkeys(("denoiser", "denoised"), "denoise=True denoises by OIDN"),
        **dict.fromkeys(("filepath", "path", "output", "write_still"), "save(path) of the result writes it"),
    },
    "Renderer.render": {
        **dict.fromkeys(("samples", "spp", "frames"), "call render() for each frame: light gathers over frames"),
        "denoise": "frames are denoised already: see renderer.settings.denoise",
    },
    "Renderer": {
        **dict.fromkeys(("save", "screenshot"), "renderer.render().save(path) writes a frame"),
        **dict.fromkeys(("delete", "destroy", "dispose", "release"), "close() frees it"),
        **_RESULTS,
        **dict.fromkeys(("samples", "spp"), "call render() for each frame: light gathers over frames"),
        **dict.fromkeys(("width", "height", "resolution", "setsize"), f"{_SIZE}; resize(size) changes it"),
    },
}


def advice_for(what: str, name: str) -> str:
    """What a name of other programs is called here; "" if there is nothing to say.

    what: the start of a message, such as "Material has no field".
    """
    return OTHER_WORDS.get(what.partition(" ")[0].rstrip(":"), {}).get(name, "")
