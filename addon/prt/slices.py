"""Many rows in pieces whose arrays stay in the processor's cache."""


def slices(count: int, size: int) -> list[slice]:
    """``count`` rows, ``size`` at a time."""
    return [slice(start, min(start + size, count)) for start in range(0, count, size)]
