"""Many devices and machines: workers of a dask.distributed cluster render parts of a picture, views or frames.

    import solari_vk as sv

    if __name__ == "__main__":  # workers import this file
        scene = sv.builtin("cornell_box")
        with sv.cluster.Crew(workers=2) as crew:  # or Crew(address="tcp://host:8786")
            picture = sv.cluster.render_reference(crew, scene, (640, 360), samples=256)
        sv.save_image("cornell_box.exr", picture.radiance)

The pictures are bit by bit the same for any number of workers. `OneDevice` does the same work in this process, without
dask. docs/guides/clusters.md says how to run workers on Slurm and Kubernetes.
"""

from solari_vk.cluster.bench import OneDevice
from solari_vk.cluster.crew import Crew
from solari_vk.cluster.identity import Identity
from solari_vk.cluster.ledger import render_shots
from solari_vk.cluster.reference import ReferencePicture, render_reference
from solari_vk.cluster.shots import Meter, Shot, Style, View, blocks

__all__ = [
    "Crew", "Identity", "Meter", "OneDevice", "ReferencePicture", "Shot", "Style", "View", "blocks", "render_reference",
    "render_shots",
]  # fmt: skip
