"""A vector environment of Gymnasium that sees lit pictures: push a ball to the middle. `python gymnasium_worlds.py`."""

import gymnasium as gym
import mujoco
import numpy as np
from gymnasium.vector.utils import batch_space
from mujoco_scene import MODEL  # the program beside this one
from PIL import Image

import solari_vk as sv

STEPS = 20  # of an episode


class Push(gym.vector.VectorEnv):
    """Observations: pictures (N, height, width, 3), uint8. Actions: forces on the ball along x and y (N, 2)."""

    metadata = {"autoreset_mode": gym.vector.AutoresetMode.NEXT_STEP}

    def __init__(self, device, model, worlds=16, size=(64, 64)):
        self.num_envs, self.model = worlds, model
        self.data = [mujoco.MjData(model) for _ in range(worlds)]
        self.single_observation_space = gym.spaces.Box(0, 255, (*size[::-1], 3), np.uint8)
        self.single_action_space = gym.spaces.Box(-1, 1, (2,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, worlds)
        self.action_space = batch_space(self.single_action_space, worlds)
        self.batch = sv.mujoco.Batch(model, worlds, *size[::-1], device=device)
        self.age = np.zeros(worlds, int)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.age[:] = 0
        return self._observe(np.ones(self.num_envs, bool)), {}

    def step(self, actions):
        new = self.age >= STEPS  # their episodes ended with the step before
        for one, force in zip(self.data, actions, strict=True):
            one.xfrc_applied[-1, :2] = 400 * np.clip(force, -1, 1)
            mujoco.mj_step(self.model, one, nstep=10)
        pictures, self.age = self._observe(new), np.where(new, 0, self.age + 1)
        distances = np.array([np.hypot(*one.xpos[-1, :2]) for one in self.data])
        return pictures, np.where(new, 0.0, -distances), np.zeros_like(new), self.age >= STEPS, {}

    def _observe(self, new):
        for one in (self.data[index] for index in np.flatnonzero(new)):
            mujoco.mj_resetData(self.model, one)
            one.qpos[-7:-5] = self.np_random.uniform(-1, 1, 2)
            mujoco.mj_forward(self.model, one)
        return self.batch.render(self.data, reset=new)["display"][:, 0, ..., :3]

    def close_extras(self, **kwargs):
        self.batch.close()


if __name__ == "__main__":
    with sv.Device() as device:
        envs = Push(device, mujoco.MjModel.from_xml_path(MODEL))
        pictures, _ = envs.reset(seed=1)
        for _ in range(8):
            pictures, rewards, *_ = envs.step(envs.action_space.sample())
        envs.close()
    Image.fromarray(np.hstack([np.vstack(column) for column in np.split(pictures, 4)])).save("gymnasium_worlds.png")
