"""How transfer vectors lie in attributes of four floats each.

``slots`` names every float: float ``4 k + c`` of the attributes is ``slots[4 k + c]``, "" where
unused.  One channel: T0, T1, ...; three channels: T0r, T0g, T0b, T1r, ...; then the residual
R0r, R0g, R0b; then S0 .. S3, the visibilities of lights cut out of the map.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .errors import BakeError

MAX_ATTRIBUTES = 14  # EEVEE reads no more in one material
PREFIX = "_PRT_"
RESIDUAL = ("R0r", "R0g", "R0b")


@dataclass(frozen=True)
class Layout:
    """What a bake stores at every vertex or corner."""

    order: int
    channels: int = 1
    residual: bool = False
    lights: int = 0

    @property
    def transfer_slots(self) -> int:
        """How many leading floats are transfer."""
        return self.order * self.order * self.channels

    @property
    def slots(self) -> tuple[str, ...]:
        """The name of every float, padded with "" to a multiple of four."""
        suffixes = ("",) if self.channels == 1 else ("r", "g", "b")
        names = [f"T{i}{s}" for i in range(self.order**2) for s in suffixes]
        names += RESIDUAL if self.residual else ()
        names += [f"S{i}" for i in range(self.lights)]
        return tuple(names + [""] * (-len(names) % 4))

    @property
    def attributes(self) -> tuple[str, ...]:
        """The attributes' names, _PRT_0 first."""
        return tuple(f"{PREFIX}{k}" for k in range(len(self.slots) // 4))


def check(layout: Layout, others: int = 0, material: str = "") -> None:
    """Refuse, with BakeError, what EEVEE's 14 attributes cannot hold beside ``others``."""
    needed = len(layout.attributes) + others
    if needed <= MAX_ATTRIBUTES:
        return
    beside = f" beside the {others} that material {material!r} reads" if others else ""
    raise BakeError(
        f"Order {layout.order} with {layout.channels} channel{'s' * (layout.channels > 1)} takes "
        f"{len(layout.attributes)} vertex attributes{beside}, and EEVEE reads at most "
        f"{MAX_ATTRIBUTES}: choose a lower order"
    )


def pack(layout: Layout, transfer: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Transfer (E, channels, n²) as attribute values (E, 4 k), unused floats 0."""
    values = np.zeros((len(transfer), len(layout.slots)), np.float32)
    flat = transfer.transpose(0, 2, 1).reshape(len(transfer), layout.transfer_slots)
    values[:, : layout.transfer_slots] = flat
    return values


def unpack(layout: Layout, values: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Attribute values (E, 4 k) as transfer (E, channels, n²)."""
    transfer = values[:, : layout.transfer_slots].reshape(
        len(values), layout.order**2, layout.channels
    )
    return np.ascontiguousarray(transfer.transpose(0, 2, 1))
