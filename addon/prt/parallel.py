"""Threads over pieces of arrays: numpy and Embree let go of Python's lock while they work."""

import os
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor, wait
from typing import Any, ParamSpec, TypeVar

Value = TypeVar("Value")
Given = ParamSpec("Given")

TICK = 0.25  # seconds between two signs of life


def available_cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Here(Executor):
    """A pool without threads: what is put into it is done at once."""

    def submit(
        self, work: Callable[Given, Value], /, *args: Given.args, **kwargs: Given.kwargs
    ) -> Future[Value]:
        """See Executor; raises what ``work`` raises."""
        future: Future[Value] = Future()
        future.set_result(work(*args, **kwargs))
        return future

    def map(  # type: ignore[override]
        self, work: Callable[..., Value], *iterables: Iterable[Any]
    ) -> Iterator[Value]:
        """See Executor; each piece of work is done when its result is asked for."""
        return map(work, *iterables)


def workers(threads: int, is_little: bool = False) -> Executor:
    """A pool of ``threads``, 0 for every core; none where the work ``is_little``, and handing it
    over would take longer.  What is put into it must not depend on how many they are: pieces of one
    size, whose results are taken in their order."""
    return Here() if is_little else ThreadPoolExecutor(threads or available_cores())


def in_thread(work: Callable[[], Value]) -> Generator[None, None, Value]:
    """What ``work`` returns; yields every TICK until it does."""
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(work)
        while not wait([future], TICK).done:
            yield
        return future.result()
