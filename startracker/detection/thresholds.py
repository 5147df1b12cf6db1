"""Thresholds of detection: what of a frame is light, and what a source is: star, halo, hot pixel, cosmic ray or trail.

Each has its unit in its name or its text, and its reason; `tests/statistical/test_detection_curves.py` draws detection
and false alarms of the principal ones over rendered stars. Kernels are compiled with these values: numba's cache does
not see a change here, so delete it after one.
"""

# ---------------------------------------------------------------------- values of a frame
HIGHEST_SIGMA = 1e5
"""Times the noise to which the values of a frame may extend: a 16-bit converter with a noise of one step has 65,535.
Beyond it the least noise that `background.noise_floor` ascribes to a frame, 1e-5 of its range, hides the stars."""
GAP_POWERS = 7
"""Empty powers of two between successive values above which the higher ones are no light, a factor of 128 to 256. From
a star's brightest pixel to its next it is at most 42 for σ = 0.25 px."""
STRUCTURE_NOISE_TIMES = 1.5
"""Noise of the tiles over the noise of the pixels above which there is structure in the tiles, a loss of 0.4 mag; it is
0.8 to 1.15 in photographs of the sky and in frames without structure."""

# ---------------------------------------------------------------------- frames full of hot pixels
CROWDED = 2e-3
"""Objects a pixel above which hot pixels are looked for: 2,100 on 1024². A deep camera sees 500 stars on 512²."""
HOT_TIMES = 4
"""Or so many times as many hot pixels as stars among the brightest objects."""
IMPULSE_SIGMA = 5.0
"""Noise of a pixel above the background from which it can be one of them: by chance once in 3.5 million pixels."""
IMPULSE_SHARE = 0.15
"""Of a hot pixel, what its third brightest neighbour has at most; a star of σ = 0.5 px on a pixel's centre has 0.23."""
MOSTLY_ALONE, ALONE_OF_RANDOM = 0.45, 0.7
"""Share of the bright pixels higher than their neighbours that must have no neighbour with so much signal, and of the
share (1 − f)⁸ that a fraction f of all pixels has, hot at random: 0.66 at 5 %, 0.43 at 10 %. Stars as sharp as σ = 0.25
px do on 0.3 of all phases, but on a frame that is mostly dark."""

# ---------------------------------------------------------------------- pixels that are bad in many frames
BAD_SHARE, FEWEST_FRAMES = 0.75, 3
"""Share of the frames in which a pixel stands out, and frames at least: while the sky moves, a star is on one pixel in
one frame, or in two if it moves along itself."""

# ---------------------------------------------------------------------- what is looked at
LOOKED_AT, LOOKED_AT_MORE = 6, 36
"""Objects examined for each star asked for: the brightest; an image full of noise has thousands. More where these are
too few stars, or all as sharp as hot pixels, of which a warm detector has thousands too."""
FLAT_TOP_PIXELS = 5
"""Pixels that share the highest value of a flat top; a star centred on a corner has four of them."""
QUIET_QUANTILE = 0.25
"""Quantile of the noise map that stands for the noise of the sky: branches fill up to three quarters of a frame."""
OVERSIZED_RAISE = 2.0
"""Factor between the thresholds at which an oversized object is looked at again."""
OVERSIZED_CONTRAST = 2.0
"""Times the threshold that cuts it free by which a star in an oversized object stands out: 1 is structure of
something extended."""
OVERSIZED_LEVELS = 24
"""Thresholds at most: 2²⁴ times the first is beyond any converter's range."""

# ---------------------------------------------------------------------- parting of blends
BLEND_PIXELS = 6
"""Pixels from which an object can be two stars: two peaks 2 px apart, with their neighbours, have no fewer."""
BLEND_LEAST_PX2 = 4
"""Squared distance of two peaks, px², at least: nearer ones are noise on one top."""
VALLEY_SHARE = 0.8
"""Share of the fainter of two peaks below which the signal between them must fall for two stars: equal Gaussians are
at 0.8 at a distance of 2.7 σ."""
VALLEY_SIGMA = 4.0
"""Noise of a pixel by which it must fall, too: by chance once in 3e4 peaks."""
RING_SHARE = 0.05
"""Share of the brighter peak under which a fainter one is its own: the first ring of an Airy pattern has 0.0175."""
RING_STARS, FEWEST_RINGS, RING_MAJORITY = 15, 3, 0.6
"""Brightest objects that show whether the star image itself has several peaks, how many must have them, and which
share: of stars in clusters and of doubles with images that touch, fewer have."""
RING_TOLERANCE = 0.25
"""Relative difference in the variance of images of one size: noise and pixels change that of a ring of 8 px by 0.1."""

# ---------------------------------------------------------------------- halo
HALO_PEAK_RATIO = 20.0
"""Peak of a star over that of a piece of its halo, at least: 1 / `RING_SHARE`."""
HALO_RADII = 2.5
"""Radii of a star, of its pixels above the threshold, within which it has a halo: beyond, even a Moffat profile of β
= 2.5, which falls as r⁻⁵, is below 0.01 of the threshold."""
HALO_MARGIN_PX = 3.0
"""Pixels more: the matched filter of σ = 0.8 px reaches 2 px, and a piece has a radius."""
RING_MARGIN = 3.0
"""Times the envelope of an Airy pattern's rings: a central obstruction and aberrations make rings brighter."""
SHAPE_PIXELS = 7
"""Pixels from which second moments say anything: the smallest object of Greyling 1995."""
LONG_LEAST_PX2 = 0.5
"""Variance along the major axis, pixel included, below which nothing is long: a sharp star that falls on two pixels
has 0.33 px²."""

# ---------------------------------------------------------------------- cosmic rays and hot pixels
WIDTH_SNR = 8.0
"""Signal-to-noise ratio from which a star's variance counts: its relative standard error is then below 0.25."""
COMMON_WIDTH_RATIO = 1.3
"""Factor either way within which variances agree: one standard error at `WIDTH_SNR`."""
SHARP_SHARE = 0.45
"""Share of the stars' common variance that the sharpest star has: the variance of a poor lens varies more than twice
over its field."""
SHARPEST_STARS_PX2 = 0.3
"""Variance, px², pixel included, under which star images (σ < 0.47 px) are as sharp as a particle's track, which has
0.03 to 0.25: then sharpness does not distinguish them."""
WIDEST_TRACK_PX2 = 0.4
"""Variance across a particle's track, px², pixel included, at most: 0.25 and some diffusion of its charge."""
SHARP_ERRORS = 2.0
"""Standard errors by which a variance must be below the limit: 2 % of stars as sharp as the limit, which few are,
are lost."""
PEAK_ERRORS = 3.0
"""Noise of a pixel by which a peak must exceed that of the sharpest star: one such star in 740 is lost."""
HOT_PEAK_SHARE, HOT_SHARE = 0.75, 0.8
"""Share of the signal of 3 × 3 px in the brightest that makes a hot pixel for certain: no star of σ > 0.3 px has it off
the middle of a pixel; and the share of the sharp objects that must have it, for these to be no stars."""
MANY_SHARP, FEWEST_WIDE = 5, 3
"""Sharp objects, and others, at least, before the frame's width is taken from the others: fewer are chance."""
ONE_PIXEL_SHARE = 0.6
"""Share of the signal of 3 × 3 px in the brightest from which a sharp object is a hot pixel, below a cosmic ray:
named so in reports, both are left out."""

# ---------------------------------------------------------------------- trails
LOOK_LONG_SHARE = 0.6
"""Share of the limit on the axis ratio at which objects make one look for trails, so that no star is left out
before."""
FEWEST_LONG = 3
"""Long objects among the thirty brightest that make one look: one or two are satellites, galaxies, blends."""
PARTED_SHARE = 0.25
"""Share of objects that were parted, which makes one look: soft trails fall apart in the noise of their own light."""
ALIGNED_SIGMA = 5.0
"""Poisson errors above the mean of the pairs in one direction: by chance in fewer than one frame in 1,000, which
costs a search and no star."""
LONGEST_TIMES = 5
"""Times `max_pixels` that a trail may have."""
TRAIL_PIXELS, TRAIL_AXIS_RATIO = 12, 1.5
"""Pixels that a trail has at least, above half the threshold, and ratio of its second moments: a star's is nearer 1."""
FEWEST_AGREEING = 4
"""Trails that must share a motion, which has three unknowns."""
SHORTEST_MOTION_PX, CLEAR_MOTION_PX = 3.0, 10.0
"""Shorter lines are left to the limit on the axis ratio; of those that are not clearly longer than leaves and twigs,
which point anywhere, more must agree."""
FEWEST_ALIGNED = 8
"""Pairs in that direction at least: where the mean is near zero its Poisson error says nothing."""
FEWEST_POINTS = 5
"""Round star images from which a frame is not trailed: a trailed one has one or two, of cosmic rays that touch."""
POINT_SHARE = 0.25
"""Their share of the number of trails from which it is not: satellites are fewer than stars."""
WIDTH_RATIO = 2.0
"""Factor in variance between images of one width at `WIDTH_SNR`: 4 standard errors, and the variation of a lens over
its field. A trail of 4 px differs by more from a star of σ = 0.9 px."""
ON_TRAIL_PX = 4.0
"""Half width of a trail and the error of its line: a point nearer may be a piece of it."""
MOTION_TOLERANCE_SHARE = 0.12
"""Share of its length by which a trail may differ from the common motion: projection at 20° from the axis stretches
by 0.13, noise of the ends adds."""
MOTION_TOLERANCE_PX = 1.0
"""Pixels by which it may differ besides: the error of the length of a faint trail from its second moments."""
AGREEING_SHARE = 0.6
"""Share of the brightest trails that must share the motion: satellites, blends and cosmic rays are fewer than stars."""
SHORT_AGREEING_SHARE = 0.7
"""The same where the motion is short, when leaves and twigs are as long."""
