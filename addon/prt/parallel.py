"""Threads over pieces of arrays: numpy and Embree let go of Python's lock while they work."""

import os
from concurrent.futures import ThreadPoolExecutor


def available_cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def workers(threads: int) -> ThreadPoolExecutor:
    """A pool of ``threads``, 0 for every core.  What is put into it must not depend on how many
    they are: pieces of one size, whose results are taken in their order."""
    return ThreadPoolExecutor(threads or available_cores())
