"""The light of a job: its coefficients, and what residuals are residuals of."""

from concurrent.futures import Future
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from math import pi
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..cache import Cache, Entry
from ..job import Job, LightSource, Peak, light_digest
from ..parallel import workers
from ..surface.points import Points
from ..tracing.rays import Occlusion
from ..tracing.transfer import trace_all
from . import projection
from .projection import Projected, world_sh

if TYPE_CHECKING:
    from ..verify import Light
    from .gather import LightGather
    from .peaks import CutOut

Array = npt.NDArray[np.float32]
Float = npt.NDArray[np.float64]

REFERENCE_RAYS = 2048  # of each kind, at a place


@dataclass(frozen=True)
class ExactWorld:
    """What is gathered beside n² coefficients of transfer.

    ``gather`` finds the exact exit radiance of white surfaces under the world in each of its turns
    about Z, and the shadowed cosines of the peaks; ``radiance_sh`` (turns, 25, 3) are the
    coefficients that the transfer is dotted with in each turn, and ``lights`` (peaks, 3) the exit
    radiance of a white surface that faces a peak.
    """

    gather: "LightGather"
    radiance_sh: Float
    lights: Float

    def add_light(self, values: Array, transfer: Array, sign: float = 1.0) -> None:
        """Add what ``transfer`` (P, n²) shows, by a ``sign``, to the exit radiances or residuals of
        ``values`` (P, n² + 3 turns + peaks, and more)."""
        coefficients = transfer.shape[1]
        for k, radiance in enumerate(self.radiance_sh):
            place = slice(coefficients + 3 * k, coefficients + 3 * k + 3)
            values[:, place] += sign * (transfer @ radiance[:coefficients].astype(np.float32))

    def leave_residuals(self, values: Array, coefficients: int, sign: float = 1.0) -> None:
        """Turn the gathered exit radiances of ``values`` (P, n² + 3 turns + peaks, and more) into
        what the transfer misses of them; in the first turn, the peaks too.  Back with a ``sign`` of
        -1."""
        self.add_light(values, values[:, :coefficients], -sign)
        end = coefficients + 3 * len(self.radiance_sh)
        if len(self.radiance_sh) and len(self.lights):
            first = slice(coefficients, coefficients + 3)
            peaks = values[:, end : end + len(self.lights)]
            values[:, first] -= sign * (peaks @ self.lights.astype(np.float32))


class World:
    """The light of ``job``, with residuals for ``turns`` turns.  What ``cache`` knows of it is not
    found out again."""

    def __init__(self, job: Job, cache: Cache) -> None:
        self._source: LightSource | None = job.light
        self._settings, self._cache = job.settings, cache
        light_of = job.light
        self._has_picture = light_of is not None and bool(
            light_of.image or light_of.pixels is not None
        )
        baked = job.kind == "bake" and self._has_picture
        self.turns = job.settings.turns if baked and job.settings.residual else 0
        cut = baked or (job.kind == "light" and self._has_picture and job.settings.reflections)
        self._peaks = job.settings.peaks if cut else 0
        self._exact: Future[ExactWorld | None] | None = None
        self._name = light_digest(light_of).hex() if light_of and job.settings.cache else ""

    @property
    def is_exact(self) -> bool:
        """Whether anything depends on the light: never for a colour, which coefficients hold."""
        return self.turns > 0 or self._peaks > 0

    @cached_property
    def image_sh(self) -> Float | None:
        """Coefficients (25, 3) of the picture alone; None without a light."""
        return None if self._source is None else np.array(self._kept.arrays["image_sh"])

    @property
    def report(self) -> dict[str, Any]:
        """What the report says of the picture."""
        return self._kept.report

    @cached_property
    def _kept(self) -> Entry:
        key = f"light-{self._name}" if self._name else ""
        known = self._cache.get(key) if key else None
        if known is not None:
            return known
        found = self._projected
        report = {
            "projection": "cubemap" if found.is_cubemap else "lat-long",
            "width": found.width,
            "height": found.height,
            "repaired": found.repairs,
        }
        arrays = {"image_sh": found.image_sh}
        if key:
            self._cache.put(key, arrays, report)
        return Entry(arrays, report)

    @cached_property
    def _projected(self) -> Projected:
        assert self._source is not None
        return projection.project(self._source)

    @cached_property
    def _pixels(self) -> Array:
        pixels = self._projected.pixels
        assert pixels is not None
        return pixels

    @cached_property
    def _cut_out(self) -> "CutOut":
        from .peaks import find

        assert self._source is not None
        rotation, strength = self._source.rotation, self._source.strength
        return find(self._pixels, rotation, strength, self._peaks, self._settings.order)

    @cached_property
    def peaks(self) -> tuple[Peak, ...]:
        """The peaks that are worth cutting out."""
        if not self._peaks:
            return ()
        key = f"peaks-{self._peaks}-{self._settings.order}-{self._name}" if self._name else ""
        known = self._cache.get(key) if key else None
        if known is not None:
            return tuple(map(Peak.of, known.report["peaks"]))
        if key:
            self._cache.put(key, {}, {"peaks": [asdict(p) for p in self._cut_out.peaks]})
        return self._cut_out.peaks

    @property
    def rest(self) -> Array | None:
        """The picture (H, W, 3) without the light of its peaks; None for a colour."""
        if not self._has_picture:
            return None
        return self._cut_out.rest(self._pixels) if self.peaks else self._pixels

    @property
    def key(self) -> str:
        """Names the light and its peaks, for the cache; "" where nothing is kept."""
        cut = f"-{self._peaks}-{self._settings.order}" if self._peaks else ""
        return f"{self._name}{cut}" if self._name else ""

    @property
    def seen_sh(self) -> Float:
        """Coefficients (turns or 1, 25, 3) that transfer is dotted with: of the world as it stands,
        without its peaks, and in every other turn that there is a residual for."""
        from .residual import peaks_sh, turned

        assert self._source is not None
        assert self.image_sh is not None
        radiance = world_sh(self.image_sh, self._source.strength, self._source.rotation)
        seen = np.array([turned(radiance, angle) for angle in self._angles])
        seen[0] -= peaks_sh(self.peaks)
        return seen

    @property
    def _angles(self) -> Float:
        count = max(1, self.turns)
        return 2 * pi * np.arange(count) / count

    @property
    def exact(self) -> ExactWorld | None:
        """What is gathered; None where nothing is."""
        return self.begin().result()

    def begin(self) -> Future[ExactWorld | None]:
        """Start to find ``exact`` beside other work."""
        if self._exact is None:
            pool = workers(1)
            self._exact = pool.submit(self._find_exact)
            pool.shutdown(wait=False)
        return self._exact

    def _find_exact(self) -> ExactWorld | None:
        if not self.is_exact or self._source is None:
            return None
        from .exact import ExactLight
        from .gather import LightGather

        settings, rotation = self._settings, np.asarray(self._source.rotation, np.float64)
        lights: list[ExactLight] = []
        if self.turns:
            first = ExactLight(
                self._pixels, rotation, self._source.strength, settings.map_rays, settings.seed
            )
            lights = [first.turned(rotation @ _about_z(-angle)) for angle in self._angles[1:]]
            lights.insert(0, first)
        irradiance = np.array([peak.irradiance for peak in self.peaks]).reshape(-1, 3)
        rays = self._cut_out.rays(seed=settings.seed) if self._peaks else None
        return ExactWorld(
            LightGather(lights, rays, settings.seed),
            self.seen_sh[: self.turns],
            irradiance / pi,
        )

    def reference(self, occlusion: Occlusion) -> "Light | None":
        """What a bake under this light is measured by: many rays of another seed.  None where
        coefficients hold all of it, or where peaks are stored apart."""
        if not self._has_picture or self._peaks or self._source is None:
            return None
        from ..verify import Light
        from .exact import ExactLight
        from .gather import LightGather

        source, settings = self._source, self._settings
        assert self.image_sh is not None
        radiance = world_sh(self.image_sh, source.strength, source.rotation)
        seed = settings.seed + 1
        exact = ExactLight(self._pixels, source.rotation, source.strength, REFERENCE_RAYS, seed)
        many = replace(settings, rays=REFERENCE_RAYS, seed=seed)

        def at(origins: Float, normals: Float) -> Float:
            places = Points(
                origins.astype(np.float32), normals.astype(np.float32), np.empty(0, np.int32)
            )
            values = np.empty((len(origins), settings.order**2 + 3), np.float32)
            gather = LightGather([exact], None, seed)
            for _ in trace_all(places, occlusion, many, values, gather=gather):
                pass
            return values[:, settings.order**2 :].astype(np.float64)

        return Light(radiance[: settings.order**2], at)


def _about_z(angle: float) -> Float:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
