# ruff: noqa
# OpenCV camera
import solari_vk as sv, numpy as np, cv2

K = np.array([[500, 0, 330], [0, 480, 170], [0, 0, 1.0]])
R, _ = cv2.Rodrigues(np.array([0.2, 0.3, 0.1]))
X = np.array([0.3, 0.2, -0.4])
s = sv.Scene()
s.add(sv.shapes.sphere(0.05), sv.Material(), X, name="p")
s.environment = sv.Sky()
t = np.array([0, 0, 4.0]) - R @ X + np.array([0.5, 0.2, 0])
cam = sv.Camera.from_opencv(K, R, t, (640, 360))
with sv.Device() as d, sv.Renderer(d, s, (640, 360)) as r:
    f = r.render(cam)
    ys, xs = np.nonzero(f.mask("p"))
    uv = K @ (R @ X + t)
    uv = uv[:2] / uv[2]
    print("expected", uv, "got", xs.mean(), ys.mean())
    print(cam.project(X, (640, 360)))
