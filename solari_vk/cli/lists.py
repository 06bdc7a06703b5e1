"""`solari-vk settings` and `solari-vk views`."""

from __future__ import annotations

from itertools import groupby

from solari_vk.passes.debug_views import DEBUG_VIEWS
from solari_vk.settings import DEFAULTS, FIELDS, QUALITIES, allowed


def settings(job: object) -> None:
    """Print all settings by section, and the qualities."""
    for section, names in groupby(FIELDS, key=lambda name: FIELDS[name].section):
        print(f"{section}:")
        for name in names:
            print(f"  {name}={DEFAULTS[name]}  {allowed(name)}\n      {FIELDS[name].meaning}")
    print("qualities and the settings that they change:")
    for name, values in QUALITIES.items():
        print(f"  {name}: {' '.join(f'{key}={value}' for key, value in values.items()) or 'the defaults'}")


def views(job: object) -> None:
    """Print all debug views."""
    for name, meaning in DEBUG_VIEWS.items():
        print(f"{name:{max(map(len, DEBUG_VIEWS))}}  {meaning}")
