"""Search for the stars of one image with the focal length unknown: bands of the field of view, parity, distortion."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from startracker.catalog.guide import GuideDatabase
from startracker.catalog.stars import StarCatalog
from startracker.core import FloatArray, IntArray
from startracker.detection.background import Light
from startracker.errors import InputError
from startracker.estimation import Estimator
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.geometry.distortion import Distortion
from startracker.identification.acceptance import accepts, log_chance, log_limit, power_of_ten
from startracker.identification.clustering_null import log_excess_density
from startracker.identification.unknown_scale import free_scale
from startracker.identification.unknown_scale.free_scale import FreeFit
from startracker.identification.unknown_scale.last_fit import STATED_PX, estimated, last_fit
from startracker.identification.unknown_scale.quads import all_stars, brightest_stars, quad_index
from startracker.observer import Observer, corrects_aberration, unknown_aberration
from startracker.settings import IdentificationSettings
from startracker.solution import MatchedStars, Solution, Status
from startracker.unexplained import NO_ROWS, Fitted, reason_to_refuse

_POOR = 20
_BEYOND_DOUBT = 7.0
"""Margin (in ln of the false-alarm probability) beyond the limit at which the search ends at once."""
_PATTERN_WORK, _GROW_WORK, _MOST_ROUNDS = 50_000, 500_000, 10
"""Operations counted for a pattern tried, and for growing a fit in addition to those of the match in each round."""
_SAME_LENS = 0.01
"""Relative error of a fitted focal length within which the stars that it leaves are searched for by themselves."""
_BARREL = -0.06
"""k1 r² at the corner that represents strong barrel distortion, -0.03 to -0.1; beyond -0.148 the image folds."""


@dataclass(eq=False)
class FreeSearch:
    """Search for the stars of one image with the focal length free."""

    xy: FloatArray
    """Centroids, brightest first, (N, 2)."""
    flux: FloatArray | None
    """All positive, (N,)."""
    width: int
    height: int
    """Size of the image."""
    catalog: str | StarCatalog
    settings: IdentificationSettings
    """For the false-alarm rate."""
    observer: Observer | None
    trials: int = 0
    """Number of patterns tried so far."""
    variance_px2: FloatArray | None = None
    """Variance of the centroids on one axis, for the final fit, (N,)."""
    rough: Camera | None = None
    """Initial projection and distortion; the focal length is that of the band."""
    operations: int = 0
    """Operations counted so far (`IdentificationSettings.max_operations_free_scale`)."""
    estimator: Estimator | None = None
    """Method that gives the attitude of the matched stars, with the fitted lens; None: the fit of lens and attitude."""
    light: Light | None = None
    """The image, if the centroids are those of one."""
    identify: Callable[[IntArray, Camera], IntArray] | None = None
    """Catalogue numbers of the stars with which a star tracker identifies some centroids, by their rows, once the
    camera is known; None: a photograph, whose centroids need not be in the order of V."""
    faintest_v: float = math.inf
    """Magnitude limit of the star tracker's guide stars, which an accepted attitude explains."""

    def __post_init__(self) -> None:
        most = self.settings.max_centroids
        if len(self.xy) > most:
            self.xy, self.flux = self.xy[:most], None if self.flux is None else self.flux[:most]
            self.variance_px2 = None if self.variance_px2 is None else self.variance_px2[:most]
        area = float(self.width) * self.height
        self._excess = log_excess_density(np.ascontiguousarray(self.xy), area)

    @classmethod
    def about(
        cls,
        camera: Camera,
        xy: FloatArray,
        flux: FloatArray | None,
        variance_px2: FloatArray | None,
        catalog: str | StarCatalog,
        settings: IdentificationSettings,
        observer: Observer | None,
    ) -> FreeSearch:
        """Search about a known camera."""
        size = camera.width, camera.height
        return cls(xy, flux, *size, catalog, settings, observer, variance_px2=variance_px2, rough=camera)

    def run_about(self, error: float) -> tuple[Solution, tuple[float, float, float]]:
        """Search within a relative error of the known camera's focal length; and the band that is searched."""
        assert self.rough is not None
        band = _about(self.rough, error)
        return self.run((band,), (self.rough.parity,)), band

    def run(self, bands: tuple[tuple[float, float, float], ...], sides: tuple[int, ...]) -> Solution:
        """Search each band and parity until a fit is accepted beyond doubt or the limit of operations is reached."""
        return replace(self._run(bands, sides), operations=self.operations)

    def _run(self, bands: tuple[tuple[float, float, float], ...], sides: tuple[int, ...]) -> Solution:
        xy, needed = self.xy, free_scale.FEWEST_MATCHED
        if len(xy) < needed:
            status = Status.TOO_FEW_STARS if len(xy) else Status.NO_STARS
            reason = f"{len(xy)} stars detected; {needed} are needed if the focal length is unknown"
            return Solution(status, reason, centroids=xy)
        sky = all_stars(self.catalog).apparent_to(self.observer)
        best, cut_short = self._best(bands, sides, sky)
        return self._cut_short(best, sky) if cut_short else self._verdict(best, sky)

    def _best(
        self, bands: tuple[tuple[float, float, float], ...], sides: tuple[int, ...], sky: GuideDatabase
    ) -> tuple[FreeFit | None, bool]:
        """The fit with the most evidence, and whether the limit of operations ended the search."""
        limit = log_limit(self.settings)
        best: FreeFit | None = None
        for corner_k1, widen in self._passes():
            for low, middle, high in bands:
                guide = self._guide(sky, free_scale.depth(len(self.xy), self.width, self.height, low))
                for side in sides:
                    assumed = self._assumed(middle, side, corner_k1)
                    index = quad_index(self.catalog)
                    found = free_scale.candidates(self.xy, assumed, index, low / middle, high / middle, widen)
                    for camera, pattern, centre, extent in found:
                        if self.operations >= self.settings.max_operations_free_scale:
                            return best, True
                        self.trials += 1
                        self.operations += _PATTERN_WORK
                        fit = self._try(camera, pattern, centre, extent, sky.directions, guide)
                        if fit is None or (best is not None and fit.log_evidence <= best.log_evidence):
                            continue
                        best = fit
                        if self._log_chance(best) < limit - _BEYOND_DOUBT:
                            return best, False
            if best is not None and accepts(self._log_chance(best), self.settings):
                break
        return best, False

    def _verdict(self, best: FreeFit | None, sky: GuideDatabase) -> Solution:
        """Result of the completed search, accepted or not."""
        xy, needed = self.xy, free_scale.FEWEST_MATCHED
        if best is None:
            reason = f"{len(xy)} stars detected; none of {self.trials} similar patterns matches {needed} of them"
            return Solution(Status.NO_MATCH, reason, centroids=xy)
        chance = self._log_chance(best)
        if accepts(chance, self.settings):
            return self._answer(best, sky)
        best_text = f"the best of {self.trials} patterns matches {len(best.pairs)} of {len(xy)} stars"
        if chance < 0.0:
            reason = f"{best_text}: false-alarm probability {math.exp(chance):.0e}, above the limit"
            return Solution(Status.AMBIGUOUS, reason, centroids=xy, log_false_alarm=chance)
        return Solution(Status.NO_MATCH, f"{best_text}: no better than chance", centroids=xy)

    def _cut_short(self, best: FreeFit | None, sky: GuideDatabase) -> Solution:
        """Result if the limit of operations is reached."""
        found = self._verdict(best, sky)
        if found.solved:
            return found
        limit = self.settings.max_operations_free_scale
        reason = f"limit of operations reached (max_operations_free_scale {limit:.3g}); until then: {found.reason}"
        return replace(found, status=Status.SEARCH_LIMIT, reason=reason)

    def _passes(self) -> tuple[tuple[float, float], ...]:
        """Radial distortion at the corner (k1 r²) and tolerance factor of each successive pass.

        Distortion changes the shape of a pattern by 2 k1 r² between the radial and tangential directions, so strong
        distortion has to be assumed. A field with few stars has few patterns and gets a wider tolerance.
        """
        if self.rough is not None:
            return ((0.0, 1.0), (0.0, 2.0))
        wide = ((-0.04, 2.0),) if len(self.xy) <= _POOR else ()
        return ((0.0, 1.0), (_BARREL, 1.0), *wide)

    def _assumed(self, fov_deg: float, side: int, corner_k1: float) -> Camera:
        if self.rough is not None:
            rough = self.rough
            return replace(free_scale.without_rational(rough), parity=side)
        camera = replace(Camera.from_fov(fov_deg, self.width, self.height), parity=side)
        if corner_k1 == 0.0:
            return camera
        corner2 = (camera.cx / camera.fx) ** 2 + (camera.cy / camera.fy) ** 2
        return replace(camera, distortion=Distortion(k1=corner_k1 / corner2))

    def _guide(self, sky: GuideDatabase, depth: int) -> GuideDatabase:
        """The brightest stars; cached if the sky is the same for all frames."""
        if self.observer is not None:
            return sky.brightest(depth)
        return brightest_stars(self.catalog, 1 << math.ceil(math.log2(depth)) if depth > 1 else 1)

    def _log_chance(self, fit: FreeFit) -> float:
        return log_chance(fit.log_evidence, log_gain=-math.log(max(self.trials, 1)))

    def _magnitudes(self) -> FloatArray | None:
        return None if self.flux is None else -2.5 * np.log10(self.flux)

    def _try(
        self,
        camera: Camera,
        pattern: IntArray,
        centre: FloatArray,
        extent: float,
        directions: FloatArray,
        guide: GuideDatabase,
    ) -> FreeFit | None:
        xy, (stars, chosen) = self.xy, pattern
        if not np.isfinite(camera.unproject(xy[stars])).all():  # beyond the fold of the assumed lens
            return None
        matrix = free_scale.attitude_of(camera, xy[stars], directions[chosen])
        off = camera.project(directions[chosen] @ matrix.T) - xy[stars]
        if not np.hypot(off[:, 0], off[:, 1]).max() < 2.0 + 0.03 * extent:  # NaN too
            return None
        away = np.hypot(*(xy - centre).T)
        self.operations += _GROW_WORK + _MOST_ROUNDS * len(xy) * (2 * len(xy) + 10)
        grown = free_scale.grow(camera, matrix, xy, guide, centre, 2.0 + 0.012 * np.maximum(away, extent))
        if grown is None:
            return None
        camera, matrix, covariance, rms, _ = grown
        value, pairs = free_scale.weigh(camera, matrix, xy, self._magnitudes(), guide, 4, self._excess)
        return FreeFit(camera, matrix, pairs, covariance, rms, value) if len(pairs) else None

    def _answer(self, fit: FreeFit, sky: GuideDatabase) -> Solution:
        """Solution of an accepted fit, fitted again with all catalogue stars that bright."""
        xy, chance = self.xy, self._log_chance(fit)
        guide = self._guide(sky, free_scale.depth(len(xy), self.width, self.height, free_scale.field_deg(fit.camera)))
        fit = last_fit(fit, xy, self.variance_px2, guide)
        if self.estimator is not None:
            try:
                fit = estimated(fit, xy, self.variance_px2, guide, self.estimator)
            except InputError as error:  # as plate constants of a mirrored field
                reason = f"{len(fit.pairs)} of {len(xy)} stars fit; but the estimator failed: {error}"
                return Solution(Status.NO_MATCH, reason, centroids=xy)
        used, chosen = fit.pairs[:, 0], fit.pairs[:, 1]
        residual = xy[used] - fit.camera.project(sky.directions[chosen] @ fit.matrix.T)
        stars = MatchedStars.of(sky, chosen, xy[used], residual, flux=None if self.flux is None else self.flux[used])
        reason = f"{len(used)} of {len(xy)} stars fit, {self.trials} patterns tried; chance {power_of_ten(chance)}"
        refusal = self._refusal(Fitted(fit.pairs, residual, fit.matrix, fit.camera), guide, sky)
        if refusal:
            return Solution(Status.NO_MATCH, f"{reason}; but {refusal}", centroids=xy, log_false_alarm=chance)
        covariance = fit.covariance
        if not corrects_aberration(self.observer):
            covariance = covariance + unknown_aberration(fit.matrix)
        return Solution(
            Status.SOLVED,
            reason,
            Attitude.from_matrix(fit.matrix),
            covariance,
            stars,
            xy,
            free_scale.field_deg(fit.camera),
            fit.camera.parity,
            camera=fit.camera,
            log_false_alarm=chance,
            observer=self.observer,
        )

    def _refusal(self, fit: Fitted, guide: GuideDatabase, sky: GuideDatabase) -> str:
        """Why an accepted fit is refused after all (`reason_to_refuse`); empty if it is not."""

        def identify(rows: IntArray) -> IntArray:
            if self.identify is None:
                return self._others(rows, fit.camera, sky)
            return np.flatnonzero(np.isin(guide.catalog.id, self.identify(rows, fit.camera)))

        guide = guide.brightest(int(np.searchsorted(guide.v_mag, self.faintest_v, side="right")))
        sigma_px = np.full(len(self.xy), STATED_PX) if self.variance_px2 is None else np.sqrt(self.variance_px2)
        return reason_to_refuse(
            self.xy, sigma_px, fit, guide, NO_ROWS, identify, self.light, follows_v=self.identify is not None
        )

    def _others(self, rows: IntArray, camera: Camera, sky: GuideDatabase) -> IntArray:
        """Guide stars that the same search finds for some centroids, seen through the lens that was fitted."""
        flux, variance = (None if column is None else column[rows] for column in (self.flux, self.variance_px2))
        search = replace(self, xy=self.xy[rows], flux=flux, variance_px2=variance, rough=camera, trials=0)
        best, _ = search._best((_about(camera, _SAME_LENS),), (camera.parity,), sky)
        self.operations = search.operations
        return best.pairs[:, 1] if best is not None and accepts(search._log_chance(best), self.settings) else NO_ROWS


def _about(camera: Camera, error: float) -> tuple[float, float, float]:
    """Band of the field of view about a camera with this relative error of its focal length."""
    fov = camera.undistorted_fov_deg
    return fov * (1.0 - error), fov, fov * (1.0 + error)
