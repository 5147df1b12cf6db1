"""A camera from photographs of the sky: identify, match all stars, fit all images jointly, keep significant terms.

1. Each image is identified with the focal length free (`startracker.blind`).
2. Camera and attitudes are fitted to the matched stars of all images (`startracker.geometry.lens_fit`). Principal
point, aspect, radial and tangential terms are selected by the Bayesian information criterion (Schwarz 1978) over all
combinations: a term must reduce χ² by more than ln(number of observations) per coefficient.
3. All catalogue stars are projected and matched again within 3.7 robust standard errors, until convergence.
4. A smooth distortion that the lens model does not describe displaces the parameters. Its size is estimated from the
residuals, and its effect is part of the covariance (`startracker.calibration.residual_field`).
5. Images whose focal length differs from the majority's are excluded (`startracker.calibration.consensus`),
and the others are fitted again. Duplicate images are used once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from startracker.arguments import names_of, of_kind, switch, text
from startracker.calibration.consensus import agreeing, focal_lengths, repeated
from startracker.calibration.field import StarField, pair_up
from startracker.calibration.known import KnownField, identify_all, starting_camera
from startracker.calibration.residual_field import FrameInformation, ResidualField, field_columns
from startracker.calibration.result import CalibratedField, Calibration
from startracker.catalog import as_catalog
from startracker.catalog.stars import StarCatalog
from startracker.core import FloatArray, IntArray
from startracker.errors import InputError
from startracker.estimation.association import REJECT_SIGMAS
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera, as_camera
from startracker.geometry.lens import PARAMETERS, only, plain
from startracker.geometry.lens_fit import (
    JointFit,
    Matches,
    fit_jointly,
    noise_floor,
    rescaled_equations,
    significant,
    stretch,
)

_RAYLEIGH_MEDIAN = math.sqrt(2.0 * math.log(2.0))
_FIRST_GATE_PX, _LEAST_GATE_PX = 4.0, 0.05
_MOST_MAG = 3.0
_FEWEST = 8
_MOST_FIELD_PX = 4.0
"""Largest rms value, px, of a smooth distortion that the lens model does not describe; stars with larger residuals are
not matched."""
_EVIDENT_FIELD = 0.25
"""Ratio of that distortion to the residuals above which a note states it."""
_ROUNDS = 4
_VAGUE = 4.0
"""Largest ratio of a centroid's stated error to the median of the image; centroids above it are blends or not stars."""


def calibrate(
    fields: Sequence[StarField],
    *,
    camera: Camera | None = None,
    fov_deg: float | None = None,
    catalog: str | StarCatalog = "hipparcos",
    projection: str = "auto",
    refraction: bool = False,
    parameters: Sequence[str] | None = None,
) -> Calibration:
    """Calibrate the camera of the given images.

    Parameters
    ----------
    fields : sequence of StarField
        Centroids of one or several images by the same camera at the same focus and zoom.
    camera : Camera, optional
        Approximate camera: focal length to 5 %, projection, parity.
    fov_deg : float, optional
        Field across the width to 5 %, instead of `camera`.
    catalog : str or StarCatalog
    projection : str
        ``pinhole``, ``fisheye``, or ``auto``: as `camera` has, or the better of both for fields beyond 40° without a
        camera.
    refraction : bool
        Whether the images were taken through the atmosphere: a stretch of each field is fitted, which is not part of
        the camera. Without it, the aspect of a camera that is always level includes it.
    parameters : sequence of str, optional
        Parameters to fit, of `startracker.geometry.lens.PARAMETERS`, instead of the selection by significance; the
        focal length is always fitted.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        If there are no images, their sizes differ, none is identified, or there are too few stars for a fit.
    """
    try:
        fields = list(fields)
    except TypeError:
        raise InputError(f"fields must be a list of StarField; got {type(fields).__name__}") from None
    if not fields:
        raise InputError("a calibration needs at least one image")
    for one in fields:
        of_kind("each of the fields", one, StarField)
    camera = None if camera is None else as_camera("camera", camera)
    switch("refraction", refraction)
    text("projection", projection)
    if projection not in ("auto", *PARAMETERS):
        raise InputError(f"projection must be auto, {' or '.join(PARAMETERS)}; got {projection!r}")
    width, height = fields[0].width, fields[0].height
    for one in fields:
        if (one.width, one.height) != (width, height):
            raise InputError(
                f"{one.name}: has {one.width}×{one.height} pixels, {fields[0].name} {width}×{height}: "
                "images of one camera must have the same size"
            )
    if camera is not None and (camera.width, camera.height) != (width, height):
        raise InputError(f"the camera has {camera.width}×{camera.height} pixels, the images {width}×{height}")
    allowed = {name for names in PARAMETERS.values() for name in names}
    if parameters is not None and (unknown := [name for name in names_of(parameters) if name not in allowed]):
        raise InputError(f"unknown parameter {unknown[0]!r}; use {', '.join(sorted(allowed))}")
    table = as_catalog(catalog)
    copies = repeated(fields)
    left_out = {fields[k].name: f"duplicate of {fields[first].name}" for k, first in copies.items()}
    single = [one for k, one in enumerate(fields) if k not in copies]
    known, unsolved = identify_all(single, camera, fov_deg, catalog, table)
    if not known:
        first = next(iter(unsolved.items()))
        raise InputError(f"no image could be identified; {first[0]}: {first[1]}")
    kinds = _projections(projection, camera, known[0].camera)
    best: tuple[_Bench, dict[str, str]] | None = None
    # A wide field may be pinhole or fisheye: both are fitted, and the score decides.
    for kind in kinds:
        bench, outlying = _largest_agreeing(known, kind, refraction, parameters)
        if bench is not None and (best is None or bench.score() < best[0].score()):
            best = bench, outlying
    if best is None:
        count = sum(len(k.pairs) for k in known)
        raise InputError(f"{count} stars in {len(known)} images are too few for a fit; give more images")
    return best[0].answer(unsolved | best[1] | left_out)


def _largest_agreeing(
    known: list[KnownField], kind: str, refraction: bool, wanted: Sequence[str] | None
) -> tuple[_Bench | None, dict[str, str]]:
    """Fit of the images with a common focal length, and reasons why others are excluded.

    Raises
    ------
    InputError
        If less than half of the images agree.
    """
    matches = [k.matches() for k in known]
    matrices = [k.matrix for k in known]
    everyone = np.ones(len(known), dtype=np.bool_)
    lengths = focal_lengths(starting_camera(known, kind), matrices, matches)
    kept = agreeing(lengths, everyone, lens_known=False)
    bench: _Bench | None = None
    # The images that agree determine the camera, with which the images are compared again, until they are the same.
    for _ in range(_ROUNDS):
        if 2 * kept.sum() <= len(known):
            break
        bench = _Bench.begin([k for k, keep in zip(known, kept, strict=True) if keep], kind, refraction, wanted)
        if bench is None:
            return None, {}
        lengths = focal_lengths(bench.fit.camera, matrices, matches)
        before, kept = kept, agreeing(lengths, kept, lens_known=True)
        if np.array_equal(before, kept):
            break
    factor = np.exp(lengths.log_factor - np.median(lengths.log_factor[kept if kept.any() else everyone]))
    if 2 * kept.sum() <= len(known):
        listed = ", ".join(f"{k.field.name} {f:.4f}" for k, f in zip(known, factor, strict=True))
        raise InputError(
            f"the images were not taken at one focal length (relative to their median: {listed}); "
            "use images with the same zoom and focus, at least three if one may differ"
        )
    return bench, {
        k.field.name: f"its focal length is {f:.4f} times that of the others; use images with the same zoom and focus"
        for k, f, keep in zip(known, factor, kept, strict=True)
        if not keep
    }


def _projections(projection: str, camera: Camera | None, fitted: Camera) -> tuple[str, ...]:
    if projection != "auto":
        return (projection,)
    if camera is not None:
        return ("pinhole",) if camera.projection == "pinhole" else ("fisheye",)
    return ("pinhole", "fisheye") if fitted.fov_deg > 40.0 else ("pinhole",)


@dataclass(eq=False)
class _Bench:
    """State between iterations of matching and fitting."""

    known: list[KnownField]
    kind: str
    refraction: bool
    fixed: tuple[str, ...] | None
    pairs: list[IntArray]
    floor_px: float
    rejected: list[int]
    fit: JointFit

    @classmethod
    def begin(cls, known: list[KnownField], kind: str, refraction: bool, wanted: Sequence[str] | None) -> _Bench | None:
        """Match and fit, starting from the identified stars, until the pairs are unchanged; None if no lens model
        fits."""
        pairs = [k.pairs for k in known]
        if sum(map(len, pairs)) < _FEWEST:
            return None
        start = starting_camera(known, kind)
        fixed = None if wanted is None else tuple(n for n in PARAMETERS[kind] if n in {*wanted, "f"})
        bench = cls(known, kind, refraction, fixed, pairs, 0.0, [0] * len(known), _unfitted(start, known))
        # Two parameters only, because the few identified stars may not determine the others.
        first = fit_jointly(start, [k.matrix for k in known], bench.matches(), ("f", "k1"))
        if first is None:
            return None
        bench.fit = first
        for round_ in range(12):
            if not bench.refit():
                return None
            before = [set(map(tuple, p.tolist())) for p in bench.pairs]
            bench.match(wide=round_ == 0)
            if sum(map(len, bench.pairs)) < _FEWEST:
                return None
            if round_ and before == [set(map(tuple, p.tolist())) for p in bench.pairs]:
                break
        return bench if bench.refit() else None

    def sigma(self, image: int) -> FloatArray:
        """Standard error of each centroid on one axis, px, including the floor."""
        return self.known[image].sigma(self.floor_px)

    def matches(self) -> list[Matches]:
        """Stars of each image for the fit."""
        return [k.matches(p, self.floor_px) for k, p in zip(self.known, self.pairs, strict=True)]

    def refit(self) -> bool:
        """Noise floor from the residuals, fit with all parameters, then with the significant ones only."""
        self.floor_px = self._floor()
        full = self._fit(self.fixed or PARAMETERS[self.kind])
        # With so few stars the significance of the other terms cannot be tested.
        if full is None or full.freedom < _FEWEST:
            chosen = self._fit(("f", "k1"))
        elif self.fixed:
            chosen = full
        else:
            chosen = self._fit(significant(full))
        if chosen is None:
            return False
        self.fit = chosen
        return True

    def _fit(self, names: tuple[str, ...]) -> JointFit | None:
        start = only(self.fit.camera, names)
        return fit_jointly(start, self.fit.matrices, self.matches(), names, with_refraction=self.refraction)

    def _floor(self) -> float:
        """Additional noise for which the median normalised residual has its expected value."""
        # `sigma` must not include the previous floor here.
        self.floor_px = 0.0
        variance = np.concatenate([self.sigma(i)[p[:, 0]] ** 2 for i, p in enumerate(self.pairs)])
        return noise_floor(np.concatenate(self._residuals()), variance, len(self.fit.covariance))

    def _predicted(self, image: int) -> FloatArray:
        """Pixels (K, 2) of the catalogue stars in the current fit; NaN outside the field."""
        vectors = stretch(self.known[image].sky.directions @ self.fit.matrices[image].T, self.fit.stretches[image])
        pixels = self.fit.camera.project(vectors)
        # Far outside the field the polynomial of the lens model may lead back into the image.
        pixels[vectors[:, 2] < math.cos(min(1.05 * self.fit.camera.half_diagonal_rad, 3.1))] = np.nan
        return pixels

    def _residuals(self) -> list[FloatArray]:
        """Measured minus predicted of the current pairs."""
        return [
            k.field.xy[p[:, 0]] - self._predicted(i)[p[:, 1]]
            for i, (k, p) in enumerate(zip(self.known, self.pairs, strict=True))
        ]

    def match(self, *, wide: bool) -> None:
        """Match all catalogue stars, as predicted by the current fit, with all centroids."""
        normal = np.concatenate(
            [
                np.hypot(*(r / self.sigma(i)[p[:, 0], None]).T)
                for i, (r, p) in enumerate(zip(self.fit.residuals, self.pairs, strict=True))
            ]
        )
        # Median of a Rayleigh distribution, for residuals in units of their standard errors.
        scale = max(float(np.median(normal)) / _RAYLEIGH_MEDIAN, 1e-9)
        for i, one in enumerate(self.known):
            sky, predicted = one.sky, self._predicted(i)
            gate = np.maximum(REJECT_SIGMAS * scale * self.sigma(i), _LEAST_GATE_PX)
            # The search uses the wide gate in every round, so that pairs outside the narrow one are counted as
            # rejected.
            widest = np.maximum(gate, _FIRST_GATE_PX * scale * np.median(self.sigma(i)) + 1.0)
            sigma = self.sigma(i)
            sure = sigma <= _VAGUE * np.median(sigma)
            tried, other = pair_up(one.field.xy, one.field.flux, predicted, sky.catalog.v_mag, widest, _MOST_MAG)
            if wide:
                gate = widest
            off = np.hypot(*(one.field.xy[tried[:, 0]] - predicted[tried[:, 1]]).T)
            fits = (off <= gate[tried[:, 0]]) & sure[tried[:, 0]]
            self.pairs[i] = tried[fits]
            self.rejected[i] = int(np.sum(~fits)) + other

    def score(self) -> float:
        """Bayesian information criterion per observation, for comparison of projections with nearly the same stars."""
        # For Gaussian residuals of unknown variance, −2 ln L is count · ln(squares / count) plus a constant.
        count = 2 * self.fit.stars
        squares = sum(float(np.sum(r**2)) for r in self.fit.residuals)
        return math.log(squares / count) + len(self.fit.covariance) * math.log(count) / count

    def _covariance(self, matches: list[Matches]) -> tuple[FloatArray, float]:
        """Covariance of all unknowns, and rms value, px, of the distortion on each axis that the lens model does not
        describe.

        The covariance includes the effect of that distortion.
        """
        fields = [field_columns(self.fit.camera, m.xy) for m in matches]
        normal, right = rescaled_equations(self.fit, matches, fields, with_refraction=self.refraction)
        size = len(self.fit.covariance)
        covariance = np.asarray(np.linalg.inv(normal[:size, :size]), dtype=np.float64)
        field = ResidualField(size, _MOST_FIELD_PX)
        field.update(FrameInformation(normal, right), covariance)
        return covariance + field.by_field @ field.moment @ field.by_field.T, field.rms_px

    def answer(self, unsolved: dict[str, str]) -> Calibration:
        """The result as a `Calibration`."""
        fit, matches = self.fit, self.matches()
        covariance, field_px = self._covariance(matches)
        lens = len(fit.names)
        fields = []
        for i, (one, pairs) in enumerate(zip(self.known, self.pairs, strict=True)):
            at = slice(lens + 3 * i, lens + 3 * i + 3)
            fields.append(
                CalibratedField(
                    one.field.name,
                    Attitude.from_matrix(fit.matrices[i]),
                    covariance[at, at],
                    one.field.xy[pairs[:, 0]],
                    one.sky.catalog.id[pairs[:, 1]],
                    one.sky.catalog.v_mag[pairs[:, 1]],
                    fit.residuals[i],
                    matches[i].sigma_px,
                    self.rejected[i],
                    len(one.field.xy),
                    fit.stretches[i],
                )
            )
        # The residuals of a fit of the focal length alone show how much the other terms explain.
        bare = fit_jointly(plain(fit.camera), fit.matrices, matches, ("f",))
        epochs = [k.field.observer.epoch_jyear for k in self.known if k.field.observer is not None]
        result = Calibration(
            fit.camera,
            fit.names,
            covariance[:lens, :lens],
            tuple(fields),
            tuple(fit.residuals if bare is None else bare.residuals),
            self.floor_px,
            fit.chi2,
            fit.freedom,
            float(np.mean(epochs)) if epochs else self.known[0].sky.catalog.epoch_jyear,
            unsolved,
            field_px=field_px,
        )
        return replace(result, notes=_notes(result))


def _unfitted(camera: Camera, known: list[KnownField]) -> JointFit:
    images = len(known)
    return JointFit(camera, [k.matrix for k in known], np.zeros((images, 2)), (), np.empty((0, 0)), math.inf, 0.0, [])


def _notes(result: Calibration) -> tuple[str, ...]:
    notes = []
    if "cx" not in result.names:
        notes.append("principal point held at the image centre: for these stars its shift is equivalent to a rotation")
    else:
        held = [n for n in result.held_by_prior() if n in ("cx", "cy")]
        if held:
            notes.append(f"{' and '.join(held)}: determined mainly by the prior (3 % of the width), not by the stars")
    if result.field_px > _EVIDENT_FIELD * result.weighted_rms_px:
        notes.append(
            f"a smooth distortion of {result.field_px:.2g} px rms on each axis remains that the lens model does not "
            "describe; the stated errors contain its effect"
        )
    stretches = [float(np.hypot(*f.refraction)) for f in result.fields]
    if any(stretches):
        # Inverts the stretch κ tan²z / 2 with κ = 58.3″.
        zenith = [math.degrees(math.atan(math.sqrt(2.0 * s / (58.3 / 206_264.8)))) for s in stretches]
        says = ", ".join(f"{90 - z:.0f}°" for z in zenith)
        notes.append(f"differential refraction fitted and removed; it corresponds to altitudes of about {says}")
    return tuple(notes)
