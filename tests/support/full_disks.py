"""A disk that is full, as far as a program can tell."""

import resource
from contextlib import contextmanager


@contextmanager
def room_for(size):
    """Files can't get larger than `size` bytes: writing more fails, as it does on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
