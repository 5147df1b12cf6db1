"""Draw `docs/images/sequence.png`: a picture of the slew's animation. Run ``python docs/make_images/sequence.py``."""

from pathlib import Path

from simulator import Scenario
from simulator.study.sequence.animation import pictures, view_of
from simulator.study.sequence.frames import SequenceRunner
from simulator.study.sequence.run import run_sequence

OUT = Path(__file__).parents[1] / "images" / "sequence.png"
SHOWN = 76

if __name__ == "__main__":
    scenario = Scenario.load("slew")
    columns = run_sequence(scenario).columns
    frames = SequenceRunner(scenario).frames()
    view = view_of([next(frames) for _ in range(SHOWN + 1)][SHOWN])
    next(pictures([view], columns, scenario.name)).save(OUT, optimize=True)
