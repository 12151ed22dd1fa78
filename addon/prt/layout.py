"""How a bake lies in attributes of four floats each.

``slots`` names every float: float ``4 k + c`` of the attributes is ``slots[4 k + c]``, "" where
unused.  One channel: T0, T1, ...; three channels: T0r, T0g, T0b, T1r, ...; then the residuals
R0r, R0g, R0b, R1r, ..., one for each turn of the world; then S0 .. S3, the visibilities of lights
cut out of the map; then V0, V1, ..., coefficients of what a point sees.
"""

from collections.abc import Iterable, Mapping
from dataclasses import astuple, dataclass, field, replace
from math import isqrt
from typing import Any

import numpy as np
import numpy.typing as npt

from .errors import BakeError
from .results import ReceiverResult
from .tracing.visibility import EVERYTHING

MAX_ATTRIBUTES = 14  # EEVEE reads no more in one material
PREFIX = "_PRT_"
DIRECT = "_PRT_DIRECT_"  # of attributes without the light that bounced
CHANNELS = ("r", "g", "b")

Floats = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Layout:
    """What a bake stores at every vertex or corner: ``turns`` residuals, 0 for none, the
    visibilities of ``lights``, and what is seen in ``visibility_order`` bands, 0 for none."""

    order: int
    channels: int = 1
    turns: int = 0
    lights: int = 0
    visibility_order: int = 0

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> "Layout":
        """The layout whose fields are ``values``, as files keep them; 1.0.0 kept no turns."""
        fields = {"turns": int(values.get("residual", 0)), **values}
        fields.pop("residual", None)
        return cls(**fields)

    @property
    def transfer_slots(self) -> int:
        """How many leading floats are transfer."""
        return self.order * self.order * self.channels

    @property
    def slots(self) -> tuple[str, ...]:
        """The name of every float, padded with "" to a multiple of four."""
        suffixes = ("",) if self.channels == 1 else CHANNELS
        names = [f"T{i}{s}" for i in range(self.order**2) for s in suffixes]
        names += [f"R{k}{s}" for k in range(self.turns) for s in CHANNELS]
        names += [f"S{j}" for j in range(self.lights)]
        names += [f"V{i}" for i in range(self.visibility_order**2)]
        return tuple(names + [""] * (-len(names) % 4))

    @property
    def attributes(self) -> tuple[str, ...]:
        """The attributes' names, _PRT_0 first."""
        return self.called(PREFIX)

    def called(self, prefix: str) -> tuple[str, ...]:
        """The names of as many attributes that begin with ``prefix``."""
        return tuple(f"{prefix}{k}" for k in range(len(self.slots) // 4))

    @property
    def direct(self) -> "Layout":
        """Of what is kept without the light that bounced, which alone has colours; what is seen
        does not depend on that."""
        return replace(self, channels=1, visibility_order=0)

    def __str__(self) -> str:
        """What is stored, in an artist's words."""
        parts = [f"{self.channels} channels"] if self.channels > 1 else []
        parts += [f"{self.turns} turns"] if self.turns > 1 else []
        parts += [f"{self.lights} peak{'s' * (self.lights > 1)}"] if self.lights else []
        parts += ["occlusion of reflections"] if self.visibility_order else []
        parts += ["no residual"] if not self.turns else []
        return f"order {self.order}{' with ' * bool(parts)}{' and '.join(parts)}"

    def between(self, least: "Layout", most: "Layout") -> bool:
        """Whether it stores no less than ``least`` and no more than ``most``."""
        fields = zip(astuple(least), astuple(self), astuple(most), strict=True)
        return all(low <= here <= high for low, here, high in fields)


@dataclass(frozen=True)
class Values:
    """What a bake holds at E elements, float32: ``transfer`` (E, channels, n²), ``residual``
    (E, turns, 3), ``visibility`` (E, lights) and ``visibility_sh`` (E, v²), by default none of it,
    as in ``ReceiverResult``."""

    transfer: Floats
    residual: Floats
    visibility: Floats
    visibility_sh: Floats = field(default_factory=lambda: np.empty((0, 0), np.float32))

    def __post_init__(self) -> None:
        """Without visibility: an array of the right length."""
        if not self.visibility_sh.size:
            shape = (len(self.transfer), self.visibility_sh.shape[1])
            object.__setattr__(self, "visibility_sh", np.empty(shape, np.float32))


def at_elements(result: ReceiverResult) -> Values:
    """``result`` at every vertex or corner."""
    return Values(*map(result.at_elements, vars(at_points(result)).values()))


def at_points(result: ReceiverResult) -> Values:
    """``result`` at its points."""
    return Values(result.transfer, result.residual, result.visibility, result.visibility_sh)


def covering(results: Iterable[ReceiverResult]) -> Layout:
    """The smallest layout that holds all of ``results``."""
    found = list(results)
    return Layout(
        order=max(isqrt(r.transfer.shape[2]) for r in found),
        channels=max(r.transfer.shape[1] for r in found),
        turns=max(r.residual.shape[1] for r in found),
        lights=max(r.visibility.shape[1] for r in found),
        visibility_order=max(isqrt(r.visibility_sh.shape[1]) for r in found),
    )


def check(layout: Layout, others: int = 0, material: str = "") -> None:
    """Refuse, with BakeError, what EEVEE's 14 attributes cannot hold beside ``others``."""
    used = len(layout.attributes)
    if used + others <= MAX_ATTRIBUTES:
        return
    beside = f" beside the {others} that material {material!r} reads" if others else ""
    raise BakeError(
        f"A bake of {layout} takes {used} vertex attributes{beside}, and EEVEE reads at most "
        f"{MAX_ATTRIBUTES}: {_advice(layout)}"
    )


def pack(layout: Layout, values: Values) -> Floats:
    """Attribute values (E, 4 k); what ``values`` don't have is 0, but all is seen where they don't
    say, and one channel stands for three."""
    count = len(values.transfer)
    transfer = np.zeros((count, layout.order**2, layout.channels), np.float32)
    transfer[:, : values.transfer.shape[2]] = values.transfer.transpose(0, 2, 1)
    packed = np.zeros((count, len(layout.slots)), np.float32)
    start = layout.transfer_slots
    packed[:, :start] = transfer.reshape(count, start)
    widths = (3 * layout.turns, layout.lights, layout.visibility_order**2)
    residual = values.residual.reshape(count, 3 * values.residual.shape[1])
    seen = values.visibility_sh
    if widths[2] and not seen.shape[1]:
        seen = np.full((count, 1), EVERYTHING, np.float32)
    for array, width in zip((residual, values.visibility, seen), widths, strict=True):
        packed[:, start : start + array.shape[1]] = array
        start += width
    return packed


def unpack(layout: Layout, packed: Floats) -> Values:
    """What attribute values (E, 4 k) hold."""
    count, start = len(packed), layout.transfer_slots
    transfer = packed[:, :start].reshape(count, layout.order**2, layout.channels)
    end = start + 3 * layout.turns
    seen = end + layout.lights
    return Values(
        np.ascontiguousarray(transfer.transpose(0, 2, 1)),
        packed[:, start:end].reshape(count, layout.turns, 3),
        packed[:, end:seen],
        packed[:, seen : seen + layout.visibility_order**2],
    )


def _advice(layout: Layout) -> str:
    """What would take fewer attributes."""
    savings = {
        "choose a lower order": replace(layout, order=2),
        "no bounces": replace(layout, channels=1),
        "fewer turns": replace(layout, turns=min(1, layout.turns)),
        "fewer peaks": replace(layout, lights=0),
        "no occlusion of reflections": replace(layout, visibility_order=0),
        "no residual (Exact at This World)": replace(layout, turns=0),
    }
    helping = [
        words
        for words, less in savings.items()
        if len(less.attributes) < len(layout.attributes)
        and not (words.startswith("no residual") and layout.turns > 1)
    ]
    if not helping:
        return "let the material read fewer"
    sentence = " or ".join(helping)
    return sentence if sentence.startswith("choose") else f"choose {sentence}"
