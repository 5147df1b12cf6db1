"""Pictures of a stimulator's display for the frames of a live mission."""

from __future__ import annotations

import numpy as np

from simulator.live.answers import Picture, StimulusMessage
from simulator.live.mission import LiveFrame
from simulator.live.motion import turned_on
from simulator.live.stimulator import DisplayPicture, Stimulator, point_sources
from simulator.mission.motion import MotionState

__all__ = ["Stimulus"]

_MOST_PICTURES = 240
"""In one message; a mission with longer steps has its pictures at longer intervals."""


_PIXEL = np.dtype([("at", "<u2", 2), ("rgb", "u1", 3), ("zero", "u1")])


class Stimulus:
    """A display before a real tracker, refreshed at a rate of its own.

    Parameters
    ----------
    stimulator : Stimulator
        The calibrated display.
    refresh_hz : float
        Pictures a second of real time.
    """

    def __init__(self, stimulator: Stimulator, refresh_hz: float) -> None:
        self.stimulator, self.refresh_hz = stimulator, refresh_hz
        self._number = 0

    def message(self, live: LiveFrame, span_s: float, speed: float) -> tuple[StimulusMessage, bytes]:
        """Pictures from a frame on: its true attitude, turned on with its rate.

        Parameters
        ----------
        live : LiveFrame
            The frame.
        span_s : float
            Mission time until the next frame; 0: one picture, of the frame itself.
        speed : float
            Factor on real time.

        Returns
        -------
        The message, and the bytes that follow it.
        """
        renderer, t_s, truth = live.renderer, live.moment.state.t_s, live.tracked.truth
        exposure_s = renderer.exposure_s
        attitude = live.moment.camera(exposure_s) if truth is None else truth.attitude
        rate = live.moment.rate_rad_s(exposure_s)
        scene = renderer.scene(
            0, at_s=t_s, attitude=attitude, rate_camera_rad_s=rate, exposure_s=max(exposure_s, 2.0 * span_s)
        )
        directions, magnitude = point_sources(scene, renderer.focal_plane)
        count = max(1, min(round(span_s / speed * self.refresh_hz), _MOST_PICTURES))
        pictures: list[Picture] = []
        parts: list[bytes] = []
        first: DisplayPicture | None = None
        for k in range(count):
            at_s = t_s + k * span_s / count
            camera = turned_on(MotionState(t_s, attitude, rate), at_s).camera
            shown = self.stimulator.picture(camera, directions, magnitude, self._number)
            self._number += 1
            first = first or shown
            table = np.zeros(len(shown.pixels), _PIXEL)
            table["at"], table["rgb"] = shown.pixels, shown.rgb
            pictures.append(Picture(t_s=at_s, pixels=len(table)))
            parts.append(table.tobytes())
        assert first is not None
        width, height = self.stimulator.geometry.size
        data = b"".join(parts)
        message = StimulusMessage(
            index=live.index,
            t_s=t_s,
            time=renderer.scenes.clock.isot(t_s),
            width=width,
            height=height,
            speed=speed,
            paced=span_s > 0.0,
            pictures=pictures,
            stars=len(first.star),
            clipped=int(first.clipped.sum()),
            faint=int(first.faint.sum()),
            bytes=len(data),
        )
        return message, data
