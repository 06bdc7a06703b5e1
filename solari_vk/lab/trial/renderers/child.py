"""The process of one renderer with one scene: `python child.py MODULE FOLDER`.

MODULE, a file beside this one, has `load(job, folder)`, which returns a function of a number of samples and a seed that
renders a picture (height, width, 3) of radiance; with denoise=True, if the renderer has a denoiser, denoised. FOLDER
holds job.json and the files that it names. Each line of the standard input asks for a picture, each line of the
standard output answers, all as JSON; what renderers print goes to the standard error. `seconds` and `processor_seconds`
are of all threads of this process.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
import time
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np


def main(module: str, folder: Path) -> int:
    """Load the scene, render a first picture of one sample, which also compiles shaders, and then what is asked for."""
    answers = os.fdopen(os.dup(1), "w")
    # What renderers print must not mix with the answers.
    os.dup2(2, 1)

    def answer(work: Callable[[], dict[str, Any]]) -> bool:
        before = time.perf_counter(), time.process_time()
        try:
            found = work()
            spent = {"seconds": time.perf_counter() - before[0], "processor_seconds": time.process_time() - before[1]}
            found = spent | found
        except Exception as error:
            traceback.print_exc()
            found = {"error": f"{type(error).__name__}: {error}".strip()}
        answers.write(json.dumps(found) + "\n")
        answers.flush()
        return "error" not in found

    renders: list[Callable[..., Any]] = []

    def load() -> dict[str, Any]:
        job = json.loads((folder / "job.json").read_text(encoding="utf-8"))
        renders.append(importlib.import_module(module).load(job, folder))
        renders[0](1, 0)
        return {}

    def render(asked: dict[str, Any]) -> dict[str, Any]:
        before = time.perf_counter(), time.process_time()
        options = {"denoise": True} if asked["denoise"] else {}
        picture = np.asarray(renders[0](asked["samples"], asked["seed"], **options), np.float32)
        spent = {"seconds": time.perf_counter() - before[0], "processor_seconds": time.process_time() - before[1]}
        np.save(asked["output"], picture)
        return spent

    if not answer(load):
        return 1
    return 0 if all(answer(partial(render, json.loads(line))) for line in sys.stdin) else 1


if __name__ == "__main__":
    code = main(sys.argv[1], Path(sys.argv[2]))
    sys.stderr.flush()
    os._exit(code)  # some renderers crash when they tidy up
