"""Whether a scenario can be run: what ``boresight validate`` finds beyond the keys of the file."""

from __future__ import annotations

import numpy as np

from simulator.mission.sampling import trial_time_s
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.study.star_tracker import build_tracker


def refuse_unrunnable(scenario: Scenario) -> None:
    """Build all that the trials of a scenario need, and the scenes of the first, the earliest and the latest of them.

    Nothing is rendered, and no C is compiled.

    Raises
    ------
    ScenarioError
        With the location of the key, as `simulator.run` would raise it.
    """
    renderer = Renderer(scenario)
    build_tracker(scenario, renderer.camera)
    scenes, trials = renderer.scenes, scenario.study.trials
    with scenario.located("study.sampling"):
        times_s = trial_time_s(
            scenario.study.sampling, scenario.seed, np.arange(trials), scenes.orbit.period_s, scenes.span_s
        )
    for index in {0, int(np.argmin(times_s)), int(np.argmax(times_s))}:
        renderer.scene(index)
