"""Many devices and machines: workers of a dask.distributed cluster render parts of a picture, views or frames.

    import solari_vk as sv

    if __name__ == "__main__":  # workers import this file
        scene = sv.builtin("cornell_box")
        with sv.cluster.WorkerPool(workers=2) as pool:  # or WorkerPool(address="tcp://host:8786")
            picture = sv.cluster.render_reference(pool, scene, (640, 360), samples=256)
        sv.save_image("cornell_box.exr", picture.radiance)

The pictures are bit by bit the same for any number of workers. `OneDevice` does the same work in this process, without
dask. docs/guides/clusters.md says how to run workers on Slurm and Kubernetes.
"""

from solari_vk.data.datasets.journal import render_tasks
from solari_vk.data.datasets.tasks import Meter, RenderTask, Style, View, blocks
from solari_vk.renderers.cluster.device_session import OneDevice
from solari_vk.renderers.cluster.identity import Identity
from solari_vk.renderers.cluster.reference import ReferencePicture, render_reference
from solari_vk.renderers.cluster.worker_pool import WorkerPool

__all__ = [
    "Identity",
    "Meter",
    "OneDevice",
    "ReferencePicture",
    "RenderTask",
    "Style",
    "View",
    "WorkerPool",
    "blocks",
    "render_reference",
    "render_tasks",
]
