"""The flight build's solver: the same answers from a sanitized program and an optimised library, gcc and Clang; and the
truth."""

import math
import shutil

import numpy as np
import pytest

from benchmarks.flight_lists import FIELDS, field_list, null_list
from benchmarks.flight_tracker import lists_text
from benchmarks.pattern_lists import PATTERNS
from simulator.randomness import stream
from simulator.study.exported_c.build import compile_export
from simulator.study.exported_c.targets import CLANG, HOST
from simulator.study.flight.program import parse_answer
from startracker import Camera, StarTracker
from startracker.flight.design import IDENTIFIERS, DetectorNumbers, FlightDesign
from startracker.flight.export import assemble, flight_export, flight_parts, flight_tables
from startracker.flight.stars import StarList
from startracker.geometry.distortion import Distortion
from startracker.settings import TriadSettings
from tests.helpers.flight_stages import ONE, CompiledFlight

pytestmark = [pytest.mark.system, pytest.mark.skipif(HOST.missing() is not None, reason="no gcc on this machine")]

SANITIZED = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-Wshadow", "-O1")
"""-O1: with sanitizers -O2 takes twice as long to compile as to run."""
BUILDS = {"gcc": HOST, "clang": CLANG}


@pytest.fixture(scope="module")
def star_tracker():
    camera = Camera(4545.5, 4545.5, 511.5, 511.5, 1024, 1024, Distortion(k1=-0.05))
    return StarTracker(camera, magnitude_limit=5.8)


@pytest.fixture(scope="module", params=IDENTIFIERS)
def design(request, star_tracker):
    numbers = DetectorNumbers(3.3, 13.0, 4083)
    return FlightDesign(star_tracker.camera, star_tracker.guide, numbers, 0.9, identifier=request.param)


@pytest.fixture(scope="module")
def flight(design, tmp_path_factory):
    return CompiledFlight(design, tmp_path_factory.mktemp("library"))


@pytest.fixture(scope="module", params=["gcc", pytest.param("clang", marks=pytest.mark.slow)])
def build(request, design, tmp_path_factory):
    target = BUILDS[request.param]
    if shutil.which(target.compiler) is None:
        pytest.skip(f"no {target.compiler} on this machine")
    return compile_export(flight_export(design), tmp_path_factory.mktemp(request.param), target, SANITIZED)


def compare(build, flight, lists, before=None):
    """Answers of lists that both builds give."""
    before = before or [("", {})] * len(lists)
    text = "".join(more + lists_text([one]) for one, (more, _) in zip(lists, before, strict=True))
    got = [parse_answer(line) for line in build.run(text.encode(), "stars").decode().splitlines()]
    answers = [flight.solve_list(one, **known) for one, (_, known) in zip(lists, before, strict=True)]
    assert got == answers
    return answers


def right(answers, fields):
    """Number of solved lists, of which none is wrong by more than a tenth of a degree."""
    solved = [(answer, one) for answer, one in zip(answers, fields, strict=True) if answer.attitude]
    for answer, one in solved:
        turn = answer.attitude.as_matrix() @ one.matrix.T
        assert math.degrees(2.0 * math.asin(min(np.linalg.norm(turn - np.eye(3)) / math.sqrt(8.0), 1.0))) < 0.1
    return len(solved)


def test_fields_bit_for_bit(build, flight, star_tracker):
    rng = stream(1, "flight solver fields")
    fields = [field_list(star_tracker, kind, rng) for kind in FIELDS.values() for _ in range(5)]
    assert right(compare(build, flight, [one.stars for one in fields]), fields) > 20


def test_priors_and_velocities_bit_for_bit(build, flight, star_tracker):
    rng = stream(2, "flight solver priors")
    lists, before = [], []
    for k in range(10):
        one = field_list(star_tracker, FIELDS["missing stars" if k % 2 else "few stars"], rng)
        turn = rng.normal(size=3) * 10.0 ** rng.uniform(-5.0, -1.0)
        cross = np.array([[0.0, -turn[2], turn[1]], [turn[2], 0.0, -turn[0]], [-turn[1], turn[0], 0.0]])
        u, _, v = np.linalg.svd((np.eye(3) + cross) @ one.matrix)
        matrix = np.rint(u @ v * ONE).astype(np.int64)
        if k == 9:
            matrix = matrix[[1, 2, 0]]
        if k == 8:
            matrix = np.full((3, 3), (1 << 31) - 1)  # no rotation: ignored
        radius = round(min(1.5 * float(np.linalg.norm(turn)), math.pi) * (1 << 28)) + 1
        velocity = np.rint(rng.normal(size=3) * 6e4).astype(np.int64)
        prior = " ".join(map(str, [*matrix.ravel(), radius]))
        epoch = flight.tables.search.epoch + ((k - 5) << 16)
        known = {"velocity": velocity, "epoch": epoch, "prior": (matrix, radius)}
        lists.append(one.stars)
        before.append((f"velocity {' '.join(map(str, velocity))}\nepoch {epoch}\nprior {prior}\n", known))
    answers = compare(build, flight, lists, before)
    assert sum(answer.status == "solved" for answer in answers) > 4


def test_triads_beyond_their_room_bit_for_bit(star_tracker, tmp_path):
    """Triads, groups and names that there is no room for; a fixed tolerance; no test of inner angles."""
    numbers = DetectorNumbers(3.3, 13.0, 4083)
    settings = TriadSettings(separation_tolerance_deg=0.1, enclosed_tolerance_deg=None, vote_number=1, max_stars=9)
    design = FlightDesign(
        star_tracker.camera, star_tracker.guide, numbers, 0.9, identification=settings, identifier="triads"
    )
    tables = flight_tables(design)
    small = tables.search._replace(triads=tables.search.triads._replace(room=200))
    tables = tables._replace(search=small)
    made = compile_export(assemble(design, flight_parts(tables), "tracker", ""), tmp_path, HOST, SANITIZED)
    rng = stream(5, "flight solver room")
    lists = [
        field_list(star_tracker, FIELDS[kind], rng).stars for kind in ("clean", "noise", "few stars") for _ in range(2)
    ]
    lists.append(null_list(star_tracker, "uniform", rng))
    answers = compare(made, CompiledFlight(design, tmp_path / "library", tables), lists)
    assert sum(answer.status == "solved" for answer in answers) >= 3
    assert answers[-1].status == "search_limit"


def test_lists_that_make_no_sense_bit_for_bit(build, flight, star_tracker):
    """Empty, of one place, outside, at the limits of the types, with unknown or impossible errors and fluxes."""
    good = field_list(star_tracker, FIELDS["clean"], stream(3, "flight solver nonsense")).stars
    n = len(good.x)
    most = np.full(n, (1 << 31) - 1)
    lists = [
        good.take(np.arange(0)),
        good.take(np.arange(2)),
        good.take(np.zeros(60, int)),
        good.take(np.arange(90) % n),
        good._replace(x=most, y=-most),
        good._replace(x=good.x + (2000 << 16)),
        good._replace(variance=np.zeros(n, int), flux=np.zeros(n, int)),
        good._replace(variance=np.full(n, (1 << 32) - 1)),
        good._replace(variance=np.full(n, (25 << 26) - 1)),
        good._replace(variance=np.where(np.arange(n) % 2, 1, 20 << 26)),
        good._replace(flux=most, flags=np.full(n, 65535)),
        good._replace(flux=-most),
        StarList(*(np.array(column) for column in ([0, 1, 2], [0, 0, 1], [9, 8, 7], [1, 1, 1], [0, 0, 0]))),
    ]
    statuses = {answer.status for answer in compare(build, flight, lists)}
    assert {"no_stars", "too_few_stars", "no_match", "solved"} <= statuses


def test_no_sky_is_not_solved(build, flight, star_tracker):
    rng = stream(4, "flight solver null")
    answers = compare(build, flight, [null_list(star_tracker, pattern, rng) for pattern in PATTERNS])
    assert not any(answer.status == "solved" for answer in answers)
