"""How much of a picture each object covers, and the picture with depth and normals as an .exr. `python objects.py`."""

import solari_vk as sv


def coverage(frame):
    """For each instance that is seen: the share of the picture's pixels and the nearest depth in meters."""
    depth, found = frame["depth"], {}
    for instance in frame.instances.values():
        mask = frame.mask(instance)
        if mask.any():
            found[instance.name] = float(mask.mean()), float(depth[mask].min())
    return found


if __name__ == "__main__":
    scene = sv.builtin("cornell_box")
    with sv.Device() as device, sv.Renderer(device, scene, (160, 90)) as renderer:
        for _ in range(16):
            frame = renderer.render()
        for name, (share, nearest) in coverage(frame).items():
            print(f"{name:12} {share:6.1%} of the picture, from {nearest:.2f} m on")
        frame.save("objects.exr", ["depth", "shading_normal", "albedo", "instance_id"])
