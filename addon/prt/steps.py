"""Generators that yield how far they are and have a value in the end."""

from collections.abc import Generator
from typing import Any, TypeVar

Value = TypeVar("Value")


def value_of(steps: Generator[Any, Any, Value]) -> Value:
    """The value of ``steps``, run to their end."""
    while True:
        try:
            next(steps)
        except StopIteration as stop:
            value: Value = stop.value
            return value
