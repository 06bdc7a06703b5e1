"""How much of the realtime frame is measured, by the kind of device."""

from __future__ import annotations

from dataclasses import dataclass

from solari_vk.gpu.device.device import Device

Size = tuple[int, int]


@dataclass(frozen=True)
class Plan:
    """Picture sizes and counts for one run of `solari-vk bench frame`."""

    sizes: tuple[Size, ...] = ((256, 256), (640, 360))
    frames: int = 6
    warm_up_frames: int = 10
    seconds: float = 1.0
    """The time of each warm-up."""
    cold_start: bool = True
    host_frames: int = 200
    growth_size: Size = (128, 128)
    growth_frames: int = 5
    sides: tuple[int, ...] = (128, 256, 512)
    triangles: tuple[int, ...] = (1_000, 10_000, 100_000, 1_000_000)
    lights: tuple[int, ...] = (8, 100, 1_000, 10_000, 100_000)
    instances: tuple[int, ...] = (100, 1_000, 10_000)


SOFTWARE = Plan()
GPU = Plan(
    sizes=((1920, 1080), (3840, 2160)),
    frames=40,
    growth_size=(1280, 720),
    growth_frames=40,
    sides=(256, 512, 1024, 2048, 4096),
    triangles=(1_000, 10_000, 100_000, 1_000_000, 10_000_000, 30_000_000),
    lights=(8, 1_000, 100_000, 1_000_000),
    instances=(100, 10_000, 100_000, 1_000_000),
)
QUICK = Plan(
    sizes=((16, 16),),
    frames=2,
    warm_up_frames=1,
    seconds=0.0,
    cold_start=False,
    host_frames=10,
    growth_size=(16, 16),
    growth_frames=2,
    sides=(16, 32),
    triangles=(100, 1_000),
    lights=(8, 1_000),
    instances=(10, 100),
)


def plan_for(device: Device, *, quick: bool) -> Plan:
    """The plan for a device: large pictures and scenes for a GPU, small ones for a software device."""
    return QUICK if quick else SOFTWARE if device.properties.kind == "cpu" else GPU
