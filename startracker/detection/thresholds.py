"""Thresholds of detection: which values of a frame are light, and how sources are classified.

Each constant states its unit, in its name or its text, and its reason; `tests/statistical/test_detection_curves.py`
plots detections and false alarms against the principal ones for rendered stars. Kernels are compiled with these values,
and numba's cache does not notice a change here: delete the cache after one.
"""

# ---------------------------------------------------------------------- values of a frame
HIGHEST_SIGMA = 1e5
"""Largest distance of a frame's values from the median in units of the noise: a 16-bit converter with a noise of one
step has 65,535. Beyond it, the least noise that `background.noise_floor` assigns to a frame, 1e-5 of its range, hides
the stars."""
GAP_POWERS = 7
"""Least number of empty powers of two between successive values above which the higher ones are not light: a factor of
128 to 256. From the brightest pixel of a star to the next the factor is at most 42 for σ = 0.25 px."""
STRUCTURE_NOISE_TIMES = 1.5
"""Ratio of the noise of the tiles to the noise of the pixels above which the tiles contain structure, a loss of 0.4
mag. It is 0.8 to 1.15 in photographs of the sky and in frames without structure."""

# ---------------------------------------------------------------------- frames full of hot pixels
CROWDED = 2e-3
"""Objects per pixel above which hot pixels are searched for: 2,100 on 1024². A deep camera sees 500 stars on 512²."""
HOT_TIMES = 4
"""Ratio of hot pixels to stars among the brightest objects above which hot pixels are searched for, too."""
IMPULSE_SIGMA = 5.0
"""Signal, in units of the noise, above which a pixel can be hot: by chance one pixel in 3.5 million exceeds it."""
IMPULSE_SHARE = 0.15
"""Largest signal of a hot pixel's third brightest neighbour, as a share of its own; for a star of σ = 0.5 px on the
centre of a pixel it is 0.23."""
MOSTLY_ALONE, ALONE_OF_RANDOM = 0.45, 0.7
"""Share of the bright local maxima that must have no neighbour above `IMPULSE_SHARE`, at least the first, or the second
times the share (1 − f)⁸ expected if a fraction f of all pixels is hot at random: 0.66 at 5 %, 0.43 at 10 %. Stars as
sharp as σ = 0.25 px satisfy this at 0.3 of all phases, but in a frame that is mostly dark."""

# ---------------------------------------------------------------------- pixels that are bad in many frames
BAD_SHARE, FEWEST_FRAMES = 0.75, 3
"""Share of the frames in which a pixel deviates, and least number of frames: while the sky moves, a star covers a pixel
in one frame, or in two if it moves along its own image."""

# ---------------------------------------------------------------------- objects that are examined
LOOKED_AT, LOOKED_AT_MORE = 6, 36
"""Objects examined for each star wanted, brightest first; an image full of noise has thousands. The second number is
used if these give too few stars or are all as sharp as hot pixels, of which a warm detector also has thousands."""
FLAT_TOP_PIXELS = 5
"""Pixels that must share the highest value of a flat top; a star centred on the corner of a pixel has four of them."""
QUIET_QUANTILE = 0.25
"""Quantile of the noise map that is used as the noise of the sky: branches fill up to three quarters of a frame."""
OVERSIZED_RAISE = 2.0
"""Factor between the thresholds at which an oversized object is searched again."""
OVERSIZED_CONTRAST = 2.0
"""Ratio of a star's peak in an oversized object to the threshold that separates it: structure of an extended object has
1."""
OVERSIZED_LEVELS = 24
"""Largest number of thresholds: 2²⁴ times the first is beyond the range of any converter."""

# ---------------------------------------------------------------------- separation of blends
BLEND_PIXELS = 6
"""Least pixels of an object that can be two stars: two peaks 2 px apart, with their neighbours, have no fewer."""
BLEND_LEAST_PX2 = 4
"""Least squared distance of two peaks, px²: nearer ones are noise on one top."""
VALLEY_SHARE = 0.8
"""Share of the fainter of two peaks below which the signal between them must fall for two stars: it is 0.8 for equal
Gaussians 2.7 σ apart."""
VALLEY_SIGMA = 4.0
"""Drop of the signal between two peaks, in units of the noise of a pixel: by chance one peak in 3e4 has it."""
RING_SHARE = 0.05
"""Share of the brighter peak above which a fainter one is a star: the first ring of an Airy pattern has 0.0175."""
RING_STARS, FEWEST_RINGS, RING_MAJORITY = 15, 3, 0.6
"""Number of the brightest objects that show whether the star image itself has several peaks, how many must have them,
and which share of them: in star clusters, and among double stars whose images touch, fewer have."""
RING_TOLERANCE = 0.25
"""Relative difference in the variance of images of one size: noise and sampling change the variance of a ring of 8 px
by 0.1."""

# ---------------------------------------------------------------------- halo
HALO_PEAK_RATIO = 20.0
"""Least ratio of a star's peak to that of a piece of its halo: 1 / `RING_SHARE`."""
HALO_RADII = 2.5
"""Extent of a halo in radii of the star's area above the threshold: beyond it, even a Moffat profile of β = 2.5, which
falls as r⁻⁵, is below 0.01 of the threshold."""
HALO_MARGIN_PX = 3.0
"""Pixels added to it: the matched filter of σ = 0.8 px reaches 2 px, and a piece has a radius."""
RING_MARGIN = 3.0
"""Factor on the envelope of an Airy pattern's rings: a central obstruction and aberrations make rings brighter."""
SHAPE_PIXELS = 7
"""Least pixels of an object whose second moments are used: the smallest object of Greyling 1995."""
LONG_LEAST_PX2 = 0.5
"""Variance along the major axis, px², including the pixel, below which no object is long: a sharp star that falls on
two pixels has 0.33 px²."""

# ---------------------------------------------------------------------- cosmic rays and hot pixels
WIDTH_SNR = 8.0
"""Signal-to-noise ratio above which a star's variance is used: its relative standard error is then below 0.25."""
COMMON_WIDTH_RATIO = 1.3
"""Factor either way within which variances agree: one standard error at `WIDTH_SNR`."""
SHARP_SHARE = 0.45
"""Variance of the sharpest star as a share of the stars' common variance, which varies more than twofold over the field
of a poor lens."""
SHARPEST_STARS_PX2 = 0.3
"""Variance, px², including the pixel, below which star images (σ < 0.47 px) are as sharp as particle tracks, which have
0.03 to 0.25: sharpness then does not distinguish them."""
WIDEST_TRACK_PX2 = 0.4
"""Largest variance across a particle track, px², including the pixel: 0.25 and some diffusion of its charge."""
SHARP_ERRORS = 2.0
"""Standard errors by which a variance must be below the limit: 2 % of the stars at the limit, which are few, are
lost."""
PEAK_ERRORS = 3.0
"""Noise of a pixel by which a peak must exceed that of the sharpest star: one such star in 740 is lost."""
HOT_PEAK_SHARE, HOT_SHARE = 0.75, 0.8
"""Share of the signal of 3 × 3 px in the brightest pixel above which it is a hot pixel for certain (no star of σ > 0.3
px reaches it off the middle of a pixel), and the share of the sharp objects that must have it for these not to be
stars."""
MANY_SHARP, FEWEST_WIDE = 5, 3
"""Least numbers of sharp objects, and of others, for which the frame's width is taken from the others: fewer are
chance."""
ONE_PIXEL_SHARE = 0.6
"""Share of the signal of 3 × 3 px in the brightest pixel above which a sharp object is reported as a hot pixel, and
below which as a cosmic ray; both are rejected."""

# ---------------------------------------------------------------------- trails
LOOK_LONG_SHARE = 0.6
"""Share of the limit on the axis ratio above which objects are a reason to search for trails, so that the search starts
before stars are rejected."""
FEWEST_LONG = 3
"""Least number of long objects among the thirty brightest for a search: one or two are satellites, galaxies or
blends."""
PARTED_SHARE = 0.25
"""Share of split objects that is a reason to search: faint trails fall apart in their own noise."""
ALIGNED_SIGMA = 5.0
"""Poisson errors by which the pairs in one direction must exceed the mean: by chance in fewer than one frame in 1,000,
which costs a search but no star."""
LONGEST_TIMES = 5
"""Largest size of a trail in units of `max_pixels`."""
TRAIL_PIXELS, TRAIL_AXIS_RATIO = 12, 1.5
"""Least pixels of a trail, above half the threshold, and least ratio of its second moments: that of a star is nearer
1."""
FEWEST_AGREEING = 4
"""Least number of trails that must share a motion, which has three unknowns."""
SHORTEST_MOTION_PX, CLEAR_MOTION_PX = 3.0, 10.0
"""Lengths below the first are left to the limit on the axis ratio; below the second, trails are not clearly longer than
leaves and twigs, which point anywhere, and so more must agree."""
FEWEST_ALIGNED = 8
"""Least number of pairs in that direction: near a mean of zero the Poisson error is meaningless."""
FEWEST_POINTS = 5
"""Round star images from which a frame is not trailed: a trailed one has one or two, from cosmic rays that touch."""
POINT_SHARE = 0.25
"""Number of points, as a share of the number of trails, from which a frame is not trailed: satellites are fewer than
stars."""
WIDTH_RATIO = 2.0
"""Factor in variance between images of one width at `WIDTH_SNR`: 4 standard errors, and the variation of a lens over
its field. A trail of 4 px differs by more from a star of σ = 0.9 px."""
ON_TRAIL_PX = 4.0
"""Half width of a trail, including the error of its line: a nearer point may be a fragment of it."""
MOTION_TOLERANCE_SHARE = 0.12
"""Difference of a trail from the common motion as a share of its length: the projection at 20° from the axis stretches
trails by 0.13, and the noise of the ends adds to it."""
MOTION_TOLERANCE_PX = 1.0
"""Further difference allowed, px: the error of the length of a faint trail from its second moments."""
AGREEING_SHARE = 0.6
"""Share of the brightest trails that must share the motion: satellites, blends and cosmic rays are fewer than stars."""
SHORT_AGREEING_SHARE = 0.7
"""The same for a short motion, when leaves and twigs are as long."""
