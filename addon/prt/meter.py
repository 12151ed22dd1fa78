"""Rays and seconds of a run."""

import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TypeVar, cast

from .job import Progress

Value = TypeVar("Value")


@dataclass
class Meter:
    """Known, spent, and spent by phase; ``done`` of all ``work`` is what the artist sees."""

    start: float = field(default_factory=time.perf_counter)
    work: float = 1.0
    done: float = 0.0
    rays: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
    _inner: list[float] = field(default_factory=list)  # seconds of phases inside of open ones

    @property
    def elapsed(self) -> float:
        """Seconds since the run began."""
        return time.perf_counter() - self.start

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Count the seconds inside as ``name``'s, but those of a phase within it."""
        since = time.perf_counter()
        self._inner.append(0.0)
        yield
        spent = time.perf_counter() - since
        self.seconds[name] = self.seconds.get(name, 0.0) + spent - self._inner.pop()
        if self._inner:
            self._inner[-1] += spent

    def follow(
        self, phase: str, steps: Generator[int, None, Value], share: float, expected: float
    ) -> Generator[Progress, None, Value]:
        """Progress of ``steps``, which yield the rays that they have cast; their value.

        They are ``share`` of the work and will take about ``expected`` rays; where they have cast
        none lately they may say 0.
        """
        rays, done, most = self.rays, self.done, 0
        while True:
            try:
                cast_so_far = next(steps)
            except StopIteration as stop:
                self.done = done + share
                return cast(Value, stop.value)
            most = max(most, cast_so_far)
            self.rays = rays + most
            self.done = done + share * min(1.0, most / max(1.0, expected))
            yield self.progress(phase)

    def alive(
        self, phase: str, steps: Generator[object, None, Value]
    ) -> Generator[Progress, None, Value]:
        """Progress of ``steps`` that are none of the work; their value."""
        while True:
            try:
                next(steps)
            except StopIteration as stop:
                return cast(Value, stop.value)
            yield self.progress(phase)

    def progress(self, phase: str) -> Progress:
        """Where the run is."""
        return Progress(phase, min(1.0, self.done / self.work), self.rays, self.elapsed)
