"""Frames, lists and sequences for a flight build, and its answers after each stage as lines of text.

Everything is made of integers, so that the same pixels and stars are made on every machine.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from simulator.study.flight.library import NO_PRIOR, Known
from startracker.flight.apparent import epoch_of
from startracker.flight.following import RADIUS_BITS, TIME_BAD
from startracker.flight.stars import StarList
from startracker.flight.unit_scenes import (
    SEED,
    VELOCITY,
    YEARS,
    UnitScene,
    scene_numbers,
    scene_rows,
    unit_field,
    unit_lists,
    unit_scenes,
)

STEPS = 24
"""Images of which a trail is made."""
TRAILS = {"short trails": (9, 5), "flat trails": (26, 1), "steep trails": (-3, 25), "long trails": (18, 18)}
"""Length along x and y, px."""
SECOND = 1_000_000


class Solver(Protocol):
    """What `simulator.study.flight.library.FlightLibrary` does."""

    def read(self, image: NDArray[np.uint16], known: Known) -> None: ...
    def finish(self) -> tuple[Any, StarList]: ...
    def solve_stars(self, stars: StarList, known: Known) -> tuple[Any, StarList]: ...
    def answer(self) -> tuple[Any, StarList]: ...
    def forget(self) -> None: ...
    def predict(self, time_us: int, gyro: Sequence[int] | None = None) -> tuple[int, tuple[int, ...]]: ...
    def take(self) -> int: ...
    def filter(self) -> Any: ...


class Event(NamedTuple):
    """A frame of a sequence: its time, the rate of a gyro, and its stars; None: it has none."""

    time_us: int
    gyro: tuple[int, int, int] | None
    stars: StarList | None


def answers_of(design: Any, solver: Solver) -> Iterator[tuple[str, list[str]]]:
    """Lines by stage: of frames the measured stars, identification and attitude; of lists the last two; the filter."""
    epoch = epoch_of(design.guide.epoch_jyear) + YEARS
    lines = []
    for name, image in frames_of(design):
        solver.read(image, Known(VELOCITY, epoch))
        lines += _lines(name, *solver.finish())
    yield "frames", lines
    solver.forget()
    yield "sequence", [line for k, event in enumerate(events_of(design)) for line in _followed(str(k), solver, event)]
    lines = []
    for name, stars, known in lists_of(design, epoch):
        lines += _lines(name, *solver.solve_stars(stars, known))
    yield "lists", lines


def frames_of(design: Any) -> Iterator[tuple[str, NDArray[np.uint16]]]:
    """Fields, an empty one, trails, and everything that the front end treats in a way of its own."""
    scenes = unit_scenes(design)
    for number, scene in enumerate(scenes):
        yield f"scene {number}", _image(design, scene, number)
    field = scenes[0]
    for name, (x, y) in TRAILS.items():
        yield name, _image(design, _trailed(field, x, y), 10)
    yield "bright trails", _image(design, _trailed(field._replace(flux=30 * field.flux), 12, -6), 11)
    frame = _image(design, _with(field, _beside(field, 2, 3)), 12).astype(np.int64)
    height, width = frame.shape
    y, x = np.mgrid[:height, :width]
    white = scene_numbers(design).white
    yield "pairs on a slope", np.minimum(frame + x // 8 + y // 16, white).astype(np.uint16)
    yield "pairs apart", _image(design, _with(field, _beside(field, 6, 1)), 16)
    touching = _with(field, _beside(field, 4, 2))
    yield "saturated pairs", _image(design, touching._replace(flux=300 * touching.flux), 17)
    rng = np.random.Generator(np.random.PCG64([SEED, 20]))
    hot = _image(design, field, 13).reshape(-1)
    hot[rng.integers(0, hot.size, hot.size // 400)] = white
    yield "hot pixels", hot.reshape(frame.shape)
    bright = _image(design, field._replace(flux=np.where(np.arange(len(field.flux)) % 3, 1, 400) * field.flux), 14)
    yield "saturated", bright
    disc = (x - width // 2) ** 2 + (y - height // 3) ** 2 < (min(width, height) // 8) ** 2
    yield "a bright disc", np.where(disc, white, _image(design, field, 15)).astype(np.uint16)
    steps = 40 * ((x // 50 + y // 41) % 2)
    yield "steps", np.minimum(_image(design, field, 18) + steps, white).astype(np.uint16)
    tails = rng.integers(-400, 401, frame.shape) // rng.integers(1, 60, frame.shape)
    yield "heavy tails", np.clip(_image(design, field, 19) + tails, 0, white).astype(np.uint16)
    yield "white", np.where(disc, 0, white).astype(np.uint16)
    yield "noise", rng.integers(0, 200, frame.shape).astype(np.uint16)


def _image(design: Any, scene: UnitScene, number: int) -> NDArray[np.uint16]:
    return scene_rows(design, scene, SEED + number).astype(np.uint16)


def _trailed(scene: UnitScene, x: int, y: int) -> UnitScene:
    """Stars moved by x and y pixels, as equal images along the way with three times their flux together."""
    step = np.arange(STEPS)
    moved = [
        (at[:, None] + 8 * by * (2 * step - STEPS + 1) // (2 * STEPS)).ravel()
        for at, by in ((scene[0], x), (scene[1], y))
    ]
    return UnitScene(*moved, np.repeat(3 * scene.flux // STEPS * max(abs(x), abs(y)) // 6, STEPS), None)


def _beside(scene: UnitScene, least: int, fainter: int) -> UnitScene:
    """Fainter stars beside those of a scene, from `least` pixels on."""
    number = np.arange(len(scene.x8))
    x8, y8 = scene.x8 + 8 * (least + number % 4), scene.y8 - 8 * (number % 3)
    return UnitScene(x8, y8, scene.flux // fainter, None)


def _with(one: UnitScene, other: UnitScene) -> UnitScene:
    """Both scenes together."""
    return UnitScene(*(np.concatenate(columns) for columns in zip(one[:3], other[:3], strict=True)), None)


def lists_of(design: Any, epoch: int) -> Iterator[tuple[str, StarList, Known]]:
    """Lists of the unit tests, with and without priors, and with stars moved, missing, repeated and outside."""
    lists = [one.stars for one in unit_lists(design)]
    attitude = [unit_field(design, number).attitude for number in range(2)]
    rows = [np.rint(matrix * (1 << 30)).astype(np.int64) for matrix in attitude]
    for number, stars in enumerate(lists):
        yield f"list {number}", stars, Known(VELOCITY, epoch)
        yield f"list {number} at rest", stars, Known()
        matrix, wrong = rows[number % 2], rows[number % 2][[1, 2, 0]]
        for name, one, radius_deg in (("right", matrix, 0.5), ("wide", matrix, 4.0), ("wrong", wrong, 0.5)):
            prior = (*one.ravel().tolist(), round(np.radians(radius_deg) * (1 << RADIUS_BITS)))
            yield f"list {number} with a {name} prior", stars, Known(VELOCITY, epoch, 0, prior)
    rng = np.random.Generator(np.random.PCG64([SEED, 21]))
    for number in range(12):
        stars = lists[number % 2]
        stars = stars.take(np.flatnonzero(rng.random(len(stars.x)) < (1.0, 0.7, 0.4)[number % 3]))
        x, y = (column + rng.integers(-40_000, 40_001, len(column)) * (number % 2) for column in stars[:2])
        moved = stars._replace(x=x, y=y, variance=stars.variance * (number % 5 > 0) * (1 + 3 * (number % 2)))
        yield f"moved {number}", moved, Known(VELOCITY, epoch)
    one = lists[0]
    yield "three stars", one.take(np.arange(3)), Known(VELOCITY, epoch, 0, (*rows[0].ravel().tolist(), 1 << 21))
    yield "outside", one._replace(x=one.x + (design.camera.width << 17)), Known()
    yield "one place", one._replace(x=one.x * 0, y=one.y * 0), Known()
    yield "no flux", one._replace(flux=one.flux * 0, variance=one.variance * 0 + (1 << 32) - 1), Known()
    yield "sixty and more", one.take(np.arange(90) % len(one.x)), Known(VELOCITY, epoch)
    errors = one.variance * (1 + 40 * (np.arange(len(one.x)) % 3))
    yield "errors of all sizes", one._replace(variance=errors), Known(VELOCITY, epoch)
    yield "larger errors than stated", one._replace(variance=one.variance // 60), Known(VELOCITY, epoch)
    beyond = (1 << 20, -(1 << 20), 1 << 20)
    for name, velocity, at in (
        ("fastest", beyond, epoch),
        ("too fast", (beyond[0] + 1, 0, 0), epoch),
        ("backwards too fast", (0, 0, beyond[1] - 1), epoch),
        ("a century later", VELOCITY, epoch + (96 << 16)),
        ("too late", VELOCITY, epoch + (200 << 16)),
        ("too early", VELOCITY, epoch - (300 << 16)),
    ):
        yield name, one, Known(velocity, at)
    for name, radius in (("narrow", 2000), ("all around", 843_314_857), ("largest", (1 << 32) - 1)):
        yield f"a {name} prior", one, Known(VELOCITY, epoch, 0, (*rows[0].ravel().tolist(), radius))
    for name, stars in unexplained_lists(design):
        yield name, stars, Known(VELOCITY, epoch)
    yield "no rotation", one, Known(VELOCITY, epoch, 0, (*([(1 << 31) - 1] * 9), 1 << 21))


def unexplained_lists(design: Any) -> Iterator[tuple[str, StarList]]:
    """Lists of two fields, halves swapped, a part whose stars are elsewhere or beside their guide stars, few stars of
    which one is off."""
    one, other = (made.stars for made in unit_lists(design)[:2])
    width = design.camera.width << 16
    for number in range(2, 22):
        border = width * (number // 2) // 11
        first, second = (one, other) if number % 2 else (other, one)
        left, right = first.take(first.x < border), second.take(second.x >= border)
        joined = StarList(*(np.concatenate(columns) for columns in zip(left, right, strict=True)))
        yield f"two fields {number}", joined.take(np.argsort(-joined.flux, kind="stable"))
    for name, stars in (("one", one), ("other", other)):
        yield f"{name} swapped", stars._replace(x=(stars.x + width // 2) % width)
        for number, limit in enumerate((width // 4, width // 3, width // 2)):
            aside = stars.x < limit
            mirrored = np.where(aside, limit - stars.x, stars.x)
            yield f"{name} mirrored {number}", stars._replace(x=mirrored)
            yield f"{name} beside {number}", stars._replace(x=stars.x + 2 * 65536 * ~aside, y=stars.y - 65536 * ~aside)
        for few in (4, 5):
            off = stars.take(np.arange(few))
            for error in (30_000, 60_000):
                x = off.x + error * (np.arange(few) == few - 1)
                yield f"{name} {few} stars, one off {error}", off._replace(x=x)


def events_of(design: Any) -> Iterator[Event]:
    """An attitude kept, lost, contradicted, replaced; times that do not advance; rates of a gyro."""
    first, second = (one.stars for one in unit_lists(design)[:2])
    order = [first] * 6 + [None, first, second, first, second, second, second, None, None, second]
    for number, stars in enumerate(order):
        yield Event(number * SECOND // 5, None, stars)
    for step, gyro in enumerate(((1000, -500, 20), (0, 0, 0), (900, -400, 30), (1 << 29, 0, 0))):
        yield Event((len(order) + step) * SECOND // 5, gyro, second)
    for time_us in (19 * SECOND // 5, 4 * SECOND, 3 * SECOND, 3 * SECOND + 100_000, 10**12, 10**12 + 1):
        yield Event(time_us, None, first)
    for number in range(40):
        yield Event(10**12 + (2 + number) * SECOND // 4, None, _shifted(first, number))


def _shifted(stars: StarList, number: int) -> StarList:
    """Stars moved by a tenth of a pixel and less, as a filter with a window of 32 frames sees noise."""
    rng = np.random.Generator(np.random.PCG64([SEED, 22, number]))
    x, y = rng.integers(-6000, 6001, 2)
    return stars._replace(x=stars.x + x, y=stars.y + y)


def _followed(name: str, solver: Solver, event: Event) -> list[str]:
    time, prior = solver.predict(event.time_us, event.gyro)
    lines = [f"{name} predicted {time} {_digest(np.array(prior, np.int64))}"]
    if time == TIME_BAD:
        return lines
    known = Known((0, 0, 0), 0, event.time_us, prior if prior[-1] else NO_PRIOR)
    if event.stars is not None:
        lines += _lines(name, *solver.solve_stars(event.stars, known))
        lines.append(f"{name} taken {solver.take()}")
        lines += _lines(f"{name} filtered", *solver.answer())[-1:]
    state = solver.filter()
    lines.append(f"{name} filter {'none' if state is None else _digest(np.concatenate([*map(np.ravel, state)]))}")
    return lines


def _lines(name: str, answer: Any, stars: StarList) -> list[str]:
    """Lines of an answer: stars, identification, attitude."""
    counts = " ".join(f"{key}={value}" for key, value in answer.counts.items())
    numbers = _digest(np.array(answer.numbers, np.int64))
    attitude = " ".join(map(str, answer.quaternion + answer.covariance))
    return [
        f"{name} stars {len(stars.x)} {_digest(np.concatenate(stars).astype(np.int64))}",
        f"{name} found {answer.status} {answer.reason} {counts} {numbers}",
        f"{name} attitude {attitude}".rstrip(),
    ]


def _digest(values: NDArray[Any]) -> str:
    return hashlib.sha256(values.tobytes()).hexdigest()[:16]
