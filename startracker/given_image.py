"""What callers give as an image: an array, or an object that has one, such as a frame of the simulator."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from startracker.arguments import real_number, switch
from startracker.errors import InputError
from startracker.observer import Observer, observer_of

STATED_PRIOR_DEG = 1.0
"""Maximum error of a prior that is given without one."""


class GivenImage(NamedTuple):
    """An image and what is known of it; None where nothing is.

    Parameters
    ----------
    image : array_like, shape (H, W)
        Pixels as given, not yet checked.
    observer : Observer, optional
        Epoch, position and velocity at mid-exposure.
    saturation_dn, gain_e_per_dn : float, optional
        Of the detector.
    exposure_s : float, optional
        Exposure time.
    """

    image: Any
    observer: Observer | None = None
    saturation_dn: float | None = None
    gain_e_per_dn: float | None = None
    exposure_s: float | None = None


def given_image(
    image: Any,
    observer: Observer | None = None,
    time: Any = None,
    saturation_dn: float | None = None,
    gain_e_per_dn: float | None = None,
) -> GivenImage:
    """Image with what its own attributes say of it; arguments take precedence over these.

    Parameters
    ----------
    image : array_like, or an object with the attribute `image`
        Of an object, the attributes `observer`, `saturation_dn`, `gain_e_per_dn` and `exposure_s` are read if it has
        them: those of a frame of the simulator, or of `startracker.LoadedImage`.
    observer, time, saturation_dn, gain_e_per_dn
        As in `StarTracker.solve`.

    Raises
    ------
    InputError
        For an observer of another type, both an observer and a time, or a saturation or gain that is not a number.
    """
    observer = observer_of(observer, time)
    exposure_s = None
    if hasattr(image, "image") and not isinstance(image, np.ndarray):
        observer = getattr(image, "observer", None) if observer is None else observer
        saturation_dn = getattr(image, "saturation_dn", None) if saturation_dn is None else saturation_dn
        gain_e_per_dn = getattr(image, "gain_e_per_dn", None) if gain_e_per_dn is None else gain_e_per_dn
        image, exposure_s = image.image, getattr(image, "exposure_s", None)
    if saturation_dn is not None:
        saturation_dn = real_number("saturation_dn", saturation_dn, finite=False)
    if gain_e_per_dn is not None:
        gain_e_per_dn = real_number("gain_e_per_dn", gain_e_per_dn, finite=False)
    return GivenImage(image, observer, saturation_dn, gain_e_per_dn, exposure_s)


def prior_of(image: Any, prior: Any, prior_deg: Any, lost_in_space: bool = False) -> tuple[Any, Any]:
    """Prior attitude and its maximum error, degrees: those given, else those of the image's attributes.

    Raises
    ------
    InputError
        For a prior that is given although the image shall be solved lost in space.
    """
    if switch("lost_in_space", lost_in_space):
        if prior is not None:
            raise InputError("prior and lost_in_space=True exclude each other; omit one of them")
        return None, STATED_PRIOR_DEG
    if prior is None and not isinstance(image, np.ndarray):
        prior = getattr(image, "prior", None)
        prior_deg = getattr(image, "prior_deg", None) if prior_deg is None else prior_deg
    return prior, STATED_PRIOR_DEG if prior_deg is None else prior_deg
