"""Calls that fail on purpose."""

from __future__ import annotations

from solari_vk.base.errors import SolariError


def failing(patch, owner, name, calls):
    """Make a call of one of an owner's functions fail: that after `calls` calls which work."""
    function, left = getattr(owner, name), [calls]

    def call(*arguments, **options):
        left[0] -= 1
        if left[0] == -1:
            raise SolariError("out of memory")
        return function(*arguments, **options)

    patch.setattr(owner, name, call)
