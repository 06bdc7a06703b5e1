"""Starts a renderer in a process of its own, and asks it for pictures, each with a time limit."""

from __future__ import annotations

import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

CHILD = Path(__file__).parent / "renderers" / "child.py"
PACKAGES = Path(__file__).parents[3]  # where solari_vk is


Picture = NDArray[np.float64]


class Failure(Exception):
    """A renderer crashed, was too slow, or refused the scene. The message is a line of the page."""


@dataclass(frozen=True)
class Kind:
    """A renderer: its name, the module beside child.py that drives it, and the package that it comes with."""

    title: str
    module: str
    package: str
    denoises: bool = False  # whether it has a denoiser for processors

    def missing(self, python: str) -> str:
        """Why the renderer can't be used with a Python, with the command to install it; "" if it can."""
        look = f"import importlib.util, sys; sys.exit(importlib.util.find_spec({self.package!r}) is None)"
        if shutil.which(python) is None:
            return f"there is no Python at {python}: give another one by --python"
        if subprocess.run([python, "-c", look], capture_output=True, check=False).returncode == 0:
            return ""
        return f"not installed: `{python if python != sys.executable else 'python'} -m pip install {self.package}`"


OURS = "solari_vk"
KINDS = {
    OURS: Kind("solari_vk", "in_solari", "solari_vk", denoises=True),
    "cycles": Kind("Cycles", "in_cycles", "bpy", denoises=True),
    "mitsuba": Kind("Mitsuba 3", "in_mitsuba", "mitsuba"),
    "luxcore": Kind("LuxCore", "in_luxcore", "pyluxcore"),
}


@dataclass(frozen=True)
class Render:
    """A picture (height, width, 3) of radiance, and the seconds that it took: of the clock, and of all processors."""

    picture: Picture
    seconds: float
    processor_seconds: float


class Process:
    """A renderer with a scene, `kind` of KINDS. limit: seconds for loading, and for each picture.

    Raises Failure where it doesn't load the scene. What it prints is in the folder, NAME.log.
    """

    def __init__(
        self,
        name: str,
        folder: Path,
        limit: float,
        python: str = sys.executable,
        kinds: Mapping[str, Kind] = KINDS,
        child: Path = CHILD,
    ) -> None:
        self._name = name
        self._folder = folder
        self._limit = limit
        self._log = folder / f"{name}.log"
        # Another Python has no solari_vk; only ours is given the path to it.
        environment = dict(os.environ)
        if kinds[name].package == OURS:
            environment["PYTHONPATH"] = os.pathsep.join(filter(None, (str(PACKAGES), environment.get("PYTHONPATH"))))
        with open(self._log, "wb") as log:
            self._child = subprocess.Popen(
                [python, "-u", str(child), kinds[name].module, str(folder)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                encoding="utf-8",
                env=environment,
                start_new_session=True,  # Ctrl-C is for the parent, which ends its children
            )
        self._answers: queue.Queue[str] = queue.Queue()
        # A thread, since reading from a pipe has no time limit on all platforms.
        threading.Thread(target=self._listen, daemon=True).start()
        try:
            self.loading: float = self._answer("while it loads the scene")["seconds"]
            """Seconds until the scene is loaded, shaders are compiled, and one sample is rendered."""
        except BaseException:
            self.close()
            raise

    def _listen(self) -> None:
        assert self._child.stdout is not None
        for line in self._child.stdout:
            self._answers.put(line)
        # An empty line is no JSON: whoever waits learns that the process has ended.
        self._answers.put("")

    def render(self, samples: int, seed: int, denoise: bool = False) -> Render:
        """A picture of so many samples a pixel. Raises Failure, after which the process is of no use."""
        output = self._folder / f"{self._name}.npy"
        assert self._child.stdin is not None
        with suppress(OSError):  # it has ended: `_answer` says how
            asked = {"samples": samples, "seed": seed, "denoise": denoise, "output": str(output)}
            self._child.stdin.write(json.dumps(asked) + "\n")
            self._child.stdin.flush()
        found = self._answer("at 1 sample" if samples == 1 else f"at {samples} samples")
        picture = np.load(output).astype(np.float64)
        if not np.isfinite(picture).all():
            raise Failure(f"its picture has values that aren't finite, at {samples} samples")
        return Render(picture, found["seconds"], found["processor_seconds"])

    def _answer(self, when: str) -> dict[str, Any]:
        try:
            line = self._answers.get(timeout=self._limit)
        except queue.Empty:
            self.close()
            raise Failure(f"stopped after {self._limit:g} s, {when}") from None
        try:
            found: dict[str, Any] = json.loads(line)
        except ValueError:
            raise Failure(f"{self._ending()}, {when}{self._last_words()}") from None
        if "error" in found:
            raise Failure(f"{found['error']}, {when}")
        return found

    def _ending(self) -> str:
        code = self._child.wait()
        return f"crashed with {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"

    def _last_words(self) -> str:
        lines = [line.strip() for line in self._log.read_text("utf-8", "replace").splitlines()]
        last = next((line for line in reversed(lines) if line), "")
        return f"; its last words: {last[:200]}" if last else ""

    def close(self) -> None:
        """End the process."""
        self._child.kill()
        self._child.wait()
        for pipe in (self._child.stdin, self._child.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
