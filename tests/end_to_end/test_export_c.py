"""The exported C: compiled without a warning, and the same answers as the Python build, bit for bit."""

import re
import subprocess

import numpy as np
import pytest
from typer.testing import CliRunner

from simulator.cli import app
from simulator.randomness import stream
from simulator.study.exported_c.build import FLAGS, HOST, M68K, compile_export
from simulator.study.exported_c.centroid_lists import KINDS, centroid_list, list_text
from simulator.theses.yee1999.catalogue import sub_catalog
from simulator.theses.yee1999.picture import vega
from startracker.errors import InputError
from startracker.fixed_point.arithmetic import FixedArithmetic
from startracker.fixed_point.export_c import SOURCES, export_c
from startracker.identification.integer_solution import MAX_STARS, MAX_TRIADS, integer_tables, solve_integers
from startracker.identification.triad_search import TriadLimits

SIZE = (427, 319)
FOV = (9.0130, 6.9049)
SCALE = (FOV[0] / SIZE[0], FOV[1] / SIZE[1])
LIMITS = TriadLimits(three_stars=True)
VEGA = vega().xy_px

needs_gcc = pytest.mark.skipif(HOST.missing() is not None, reason="no gcc on this machine")
needs_m68k = pytest.mark.skipif(
    M68K.missing() is not None, reason=f"{M68K.missing()} is not installed (Debian: gcc-m68k-linux-gnu, qemu-user)"
)


@pytest.fixture(scope="module")
def stars():
    return sub_catalog(5, 6.0, 30.0, 90.0)


@pytest.fixture(scope="module")
def tables(stars):
    return integer_tables(stars.hr, stars.ra_deg, stars.dec_deg, stars.v_mag, 12.0)


@pytest.fixture(scope="module")
def build(tables, tmp_path_factory):
    return compile_export(export_c(tables, SCALE, LIMITS, MAX_STARS, MAX_TRIADS), tmp_path_factory.mktemp("c"))


def lists(stars, count, least, most):
    """Centroid lists of all kinds, half of them plain fields, of `least` to `most` stars in turn."""
    ra, dec = np.radians(stars.sky_deg).T
    directions = np.column_stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    return [
        centroid_list(
            directions,
            stars.v_mag,
            FOV,
            SIZE,
            stream(3, "lists", k),
            KINDS[k % 10 if k % 10 < 5 else 0],
            least + k % (most - least + 1),
        )
        for k in range(count)
    ]


def line(solution):
    """A solution as the program prints it."""
    text = f"{solution.status} numbers={','.join(map(str, solution.numbers))} triads={solution.triads}"
    if solution.attitude:
        a = solution.attitude
        text += f" ra={a.ra} dec={a.dec} roll={a.roll} matrix={','.join(map(str, a.matrix.ravel()))}"
    return text


def compare(build, tables, centroids, limits=LIMITS):
    answers = build.solve("".join(map(list_text, centroids)))
    expected = [line(solve_integers(tables, xy, SCALE, limits)) for xy in centroids]
    assert answers == expected
    return [answer.split()[0] for answer in answers]


@needs_gcc
def test_a_thousand_lists_bit_for_bit(build, tables, stars):
    statuses = compare(build, tables, lists(stars, 1000, 4, 6))
    assert statuses.count("solved") > 400
    for status in ("too_few_stars", "no_match", "overflow"):
        assert statuses.count(status) >= 10


@needs_gcc
def test_twelve_stars(build, tables, stars):
    statuses = compare(build, tables, lists(stars, 20, 14, 14))
    assert statuses.count("solved") > 8


@needs_gcc
def test_vega(build, tables):
    assert compare(build, tables, [VEGA]) == ["solved"]
    assert build.solve(list_text(VEGA))[0].startswith("solved numbers=7001,17139,17056,17051,6872 triads=12 ")


@needs_gcc
def test_other_rules(tables, stars, tmp_path):
    limits = TriadLimits(0.1, 4.0, None, 8.0, 3, 5.0)
    export = export_c(tables, SCALE, limits, MAX_STARS, MAX_TRIADS)
    compare(compile_export(export, tmp_path), tables, lists(stars, 30, 6, 6), limits)


@needs_gcc
def test_no_room_for_the_triads(tables, stars, tmp_path):
    build = compile_export(export_c(tables, SCALE, LIMITS, MAX_STARS, 5), tmp_path)
    assert build.solve(list_text(VEGA)) == ["too_many_triads numbers=0,0,0,0,0 triads=0"]


@needs_gcc
def test_no_floating_point_no_heap_no_undefined_behaviour(build, tables, stars, tmp_path):
    export = export_c(tables, SCALE, LIMITS, MAX_STARS, MAX_TRIADS)
    for name in SOURCES:
        assert not re.search(
            r"\b(float|double|malloc|calloc|realloc|free|math\.h)\b", export.files[name].split("*/", 1)[1]
        )
    assert build.heap_calls == ()
    assert 0 < build.stack_bytes < 4096
    assert build.table_bytes == sum(export.table_bytes.values()) < 400_000
    # gcc refuses this flag where a floating-point register would be needed
    for name in ("integers", "attitude", "triads"):
        source = str(tmp_path / f"{name}.c")
        for file, text in export.files.items():
            (tmp_path / file).write_text(text)
        command = ["gcc", *FLAGS, "-mgeneral-regs-only", "-c", "-o", str(tmp_path / "x.o"), source]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    careful = compile_export(
        export, tmp_path, extra=["-fsanitize=undefined,bounds-strict", "-fno-sanitize-recover=all"]
    )
    centroids = lists(stars, 40, 6, 8)
    noise = [stream(5, "noise", k).uniform(-511.9, 511.9, (12, 2)).round(6) for k in range(10)]
    compare(careful, tables, [*centroids, *noise])


@needs_gcc
def test_what_the_program_reads(build):
    text = "\n1.5, -2\n+3\t4.123456789123\n\n\n600 1\n1 1\n2 2\n"
    assert build.solve(text) == [
        "too_few_stars numbers= triads=0",
        "too_few_stars numbers=0,0 triads=0",
        "too_few_stars numbers= triads=0",
        "overflow numbers=0,0,0 triads=0",
    ]
    with pytest.raises(InputError, match="no star"):
        build.solve("1 x\n")


@needs_gcc
def test_command(tmp_path):
    arguments = ["export-c", str(tmp_path / "c"), "--magnitude-limit", "4.5", "--declination", "-90:90"]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    for word in ("tables", "static buffers", "stack", "heap", "0 bytes", "ms"):
        assert word in done.output
    made = subprocess.run(["make", "-C", str(tmp_path / "c")], capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
    assert (tmp_path / "c" / "solve").exists()


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--max-separation", "40", "6.10"),
        ("--fov", "9", "--fov"),
        ("--size", "9", "--size"),
        ("--declination", "90", "--declination"),
        ("--magnitude-limit", "-3", "three"),
        ("--tolerance", "12", "16-bit"),
    ],
)
def test_mistakes(tmp_path, option, value, said):
    done = CliRunner().invoke(app, ["export-c", str(tmp_path / "c"), option, value])
    assert isinstance(done.exception, InputError)
    assert said in str(done.exception)


def test_only_integers_are_exported(stars):
    with pytest.raises(InputError, match="FixedArithmetic"):
        export_c(stars.tables(12.0), SCALE, LIMITS, 12, 10)
    with pytest.raises(InputError, match="one separation tolerance"):
        export_c(stars.tables(12.0, FixedArithmetic()), SCALE, TriadLimits((0.1, 0.2)), 12, 10)
    with pytest.raises(TypeError):
        solve_integers(stars.tables(12.0, FixedArithmetic()), VEGA, SCALE)


@needs_m68k
@pytest.mark.slow
def test_68k_gives_the_same_bits(tables, stars, tmp_path):
    export = export_c(tables, SCALE, LIMITS, MAX_STARS, MAX_TRIADS)
    build = compile_export(export, tmp_path, M68K)
    statuses = compare(build, tables, lists(stars, 300, 5, 10))
    assert statuses.count("solved") > 150
    assert build.heap_calls == ()
    count = build.instructions(list_text(VEGA))
    # hers took 9.41 s at 25 MHz, 235 million clocks
    assert 1e5 < count < 1e7
    print(f"68k: {count:,} instructions; bytes: code {build.code_bytes}, static {build.static_bytes}")


@needs_gcc
@pytest.mark.slow
def test_a_thousand_long_lists(build, tables, stars):
    compare(build, tables, lists(stars, 1000, 7, 14))
