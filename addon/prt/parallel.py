"""Threads over pieces of arrays: numpy and Embree let go of Python's lock while they work."""

import os
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor, wait
from typing import TypeVar

Value = TypeVar("Value")

TICK = 0.25  # seconds between two signs of life


def available_cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def workers(threads: int) -> ThreadPoolExecutor:
    """A pool of ``threads``, 0 for every core.  What is put into it must not depend on how many
    they are: pieces of one size, whose results are taken in their order."""
    return ThreadPoolExecutor(threads or available_cores())


def in_thread(work: Callable[[], Value]) -> Generator[None, None, Value]:
    """What ``work`` returns; yields every TICK until it does."""
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(work)
        while not wait([future], TICK).done:
            yield
        return future.result()
