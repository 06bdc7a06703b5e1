"""A room's impulse response: rays of sound that scatter from its walls. `python acoustics.py`."""

import numpy as np

import solari_vk as sv

SPEED, RATE, SECONDS = 343.0, 8000, 1.0  # meters a second, samples a second, length of the response


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def impulse_response(tracer, source, listener, absorption=0.2, rays=8192, bounces=120):
    """Sound energy a square meter at the listener, of one unit sent out at time 0, for each sample of time."""
    random, response = np.random.default_rng(1), np.zeros(int(RATE * SECONDS))
    if tracer.trace(source, np.subtract(listener, source), t_max=1, any_hit=True)["instance"] < 0:
        direct = np.linalg.norm(np.subtract(listener, source))
        response[int(direct / SPEED * RATE)] = 1 / (4 * np.pi * direct**2)
    origin, direction, traveled = source, unit(random.normal(size=(rays, 3))), np.zeros(rays)
    for bounce in range(1, bounces + 1):
        hits = tracer.trace(origin, direction)
        traveled += hits["t"]  # infinite once a ray has left through a gap
        normal = np.where(hits["front_face"][:, None], hits["normal"], -hits["normal"])
        origin = hits["position"] + 1e-4 * normal
        distance = np.linalg.norm(listener - origin, axis=1)
        cosine = np.einsum("ij,ij->i", normal, listener - origin) / distance
        sample = np.minimum((traveled + distance) / SPEED * RATE, len(response)).astype(int)
        heard = (cosine > 0) & (sample < len(response))
        heard &= tracer.trace(origin, listener - origin, t_max=1, any_hit=True)["instance"] < 0
        echo = (1 - absorption) ** bounce / rays * cosine / (np.pi * distance**2)  # Lambert's law: matt walls
        np.add.at(response, sample[heard], echo[heard])
        direction = unit(normal + unit(random.normal(size=(rays, 3))))
    return response


if __name__ == "__main__":
    with sv.Device() as device, sv.RayTracer(device, sv.builtin("closed_box", size=4.0)) as tracer:
        np.save("response.npy", impulse_response(tracer, (-1, 0, 1), (1, 0.5, -1)))
