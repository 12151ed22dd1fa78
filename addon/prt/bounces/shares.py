"""How much each ray that was looked at stands for, of all rays of its place that meet something.

Of a place's rays some are looked at, and of the others it is known only which of them meet
something.  With equal shares what is looked at would lie a little more to one side than all that is
met.  So the shares are such that its mean direction is that of all: light that changes evenly from
one side to the other is then found without error (calibration, Deville and Särndal 1992).
"""

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

FEWEST = 8  # of so few rays all have the same share
STIFF = 0.01  # added to the spread of the directions: few or narrow ones are not pulled far


def shares(met: Mask, local: Array, others: Array) -> Array:
    """The shares (P, W) of rays along ``local`` (W, 3) of places where those ``met`` (P, W)
    meet something, at least one of each: they add up to 1 over these.  Of the ``others`` (P, 4)
    that do so the number and the sum of their directions are known."""
    ones = np.ones((len(local), 1), np.float32)
    squares = (local[:, :, None] * local[:, None]).reshape(-1, 9)
    products = met[:, None].astype(np.float32) @ np.concatenate([ones, local, squares], axis=1)
    count, sums, spread = np.split(products[:, 0], [1, 4], axis=1)
    if not others.any():
        return np.repeat(1 / count, len(local), axis=1)
    mean, wanted = sums / count, (sums + others[:, 1:]) / (count + others[:, :1])
    spread = spread.reshape(-1, 3, 3) / count[:, :, None] - mean[:, :, None] * mean[:, None]
    spread += STIFF * np.eye(3, dtype=np.float32)
    pull = np.linalg.solve(spread, (wanted - mean)[:, :, None])[:, :, 0]
    pull[count[:, 0] <= FEWEST] = 0
    level = 1 - np.einsum("pc,pc->p", mean, pull)[:, None]
    linear = np.concatenate([level, pull], axis=1) / count
    found = (linear[:, None] @ np.concatenate([ones, local], axis=1).T)[:, 0]
    negative = found.min(axis=1, initial=0) < 0
    found[negative] = 1 / count[negative]
    return np.asarray(found, np.float32)
