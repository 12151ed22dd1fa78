"""The bands of the transfer that are worth storing."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from .results import ReceiverResult
from .sh import order_of

Float = npt.NDArray[np.float64]

UNSEEN = 2e-3  # relative RMS error that is never asked to be less


def needed_order(
    results: Sequence[ReceiverResult], tolerance: float, radiance_sh: Float | None
) -> int:
    """The lowest order that leaves out no more than ``tolerance`` of the transfer of ``results``,
    in relative RMS; of the exit radiance under ``radiance_sh`` (n², 3) where that light is final.

    With a residual, which takes in what is left out of it, a final light needs order 1 alone.
    """
    order = max(order_of(result.transfer.shape[2]) for result in results)
    if radiance_sh is not None and all(result.residual.shape[1] == 1 for result in results):
        return 1
    while order > 1 and all(
        _left_out(result, order - 1, radiance_sh) <= max(tolerance, UNSEEN) for result in results
    ):
        order -= 1
    return order


def cut(result: ReceiverResult, order: int, turns_sh: Float) -> ReceiverResult:
    """``result`` with the first ``order`` bands alone; its residuals, for lights ``turns_sh``
    (turns, n², 3), take in what the others gave."""
    kept, whole = order**2, result.transfer.shape[2]
    if kept >= whole:
        return result
    residual = result.residual.copy()
    rest = result.transfer[..., kept:]
    for k, light in enumerate(turns_sh[: residual.shape[1]]):
        residual[:, k] += exit_radiance(rest, light[kept:whole])
    less = replace(
        result, transfer=np.ascontiguousarray(result.transfer[..., :kept]), residual=residual
    )
    direct = result.direct
    return less if direct is None else less.with_direct(cut(direct, order, turns_sh))


def _left_out(result: ReceiverResult, order: int, radiance_sh: Float | None) -> float:
    """What the bands from ``order`` on make of the whole, in relative RMS."""
    transfer = result.transfer.astype(np.float64)
    kept, whole = order**2, transfer.shape[2]
    if radiance_sh is None:
        rest, total = transfer[..., kept:], transfer
    else:
        rest = exit_radiance(transfer[..., kept:], radiance_sh[kept:whole])[:, None]
        total = exit_radiance(transfer, radiance_sh[:whole])[:, None]
    size = float(np.square(total).mean()) if total.size else 0.0
    lost = float(np.square(rest).sum(axis=-1).mean()) if rest.size else 0.0
    size *= total.shape[-1] if total.size else 1
    return (lost / size) ** 0.5 if size > 0 else 0.0


def exit_radiance(transfer: npt.NDArray[Any], radiance_sh: Float) -> npt.NDArray[Any]:
    """Exit radiance (P, 3) of a white surface with ``transfer`` (P, channels, n²) under light
    ``radiance_sh`` (n², 3)."""
    light = radiance_sh.astype(transfer.dtype)
    if transfer.shape[1] == 1:
        return np.asarray(transfer[:, 0] @ light)
    return np.stack([transfer[:, c] @ light[:, c] for c in range(3)], axis=1)
