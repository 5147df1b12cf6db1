"""Angles from the Sun, the Moon and the Earth's limb; and Ctrl-C as a request to stop a study."""

import signal
import subprocess
import sys
import threading
from datetime import UTC, datetime

import numpy as np
import pytest

from simulator.constants import EARTH_RADIUS_KM
from simulator.mission.clock import Clock
from simulator.sky.ephemeris import barycentric_position_au
from simulator.study.body_angles import angle_from_deg
from simulator.study.trials.stopping import no_interrupt_for_children, stop_on_signal
from startracker.core import AU_KM


def test_the_limb_is_the_radius_of_the_earth_from_its_centre():
    """Negative within the disc; within the Earth everything is."""
    r_km = np.array([[7000.0, 0.0, 0.0], [42164.0, 0.0, 0.0], [0.0, 7000.0, 0.0], [6000.0, 0.0, 0.0]])
    away = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    found = angle_from_deg("earth", None, None, r_km, away)
    limb = np.degrees(np.arcsin(EARTH_RADIUS_KM / np.array([7000.0, 42164.0, 7000.0])))
    np.testing.assert_allclose(found, [180.0 - limb[0], -limb[1], 90.0 - limb[2], 90.0])


@pytest.mark.parametrize("body", ["sun", "moon"])
def test_bodies_are_seen_from_the_spacecraft(body):
    """A spacecraft half way to the body, and one beside the line to it."""
    clock, t_s = Clock(datetime(2026, 3, 1, tzinfo=UTC)), np.array([0.0, 3600.0])
    to_body = (barycentric_position_au(body.title(), clock, t_s) - barycentric_position_au("Earth", clock, t_s)) * AU_KM
    distance = np.linalg.norm(to_body, axis=1)
    unit = to_body / distance[:, None]
    across = np.cross(unit, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across, axis=1)[:, None]
    beside = 0.5 * to_body + 0.5 * distance[:, None] * across
    np.testing.assert_allclose(angle_from_deg(body, clock, t_s, 0.5 * to_body, across), 90.0, atol=1e-9)
    np.testing.assert_allclose(angle_from_deg(body, clock, t_s, 0.5 * to_body, unit), 0.0, atol=1e-5)
    np.testing.assert_allclose(angle_from_deg(body, clock, t_s, beside, unit), 45.0, atol=1e-9)
    np.testing.assert_allclose(angle_from_deg(body, clock, t_s, 1.5 * to_body, unit), 180.0, atol=1e-5)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_first_signal_asks_and_the_second_interrupts(number):
    before = signal.getsignal(number)
    with stop_on_signal() as stop:
        assert not stop.is_set()
        signal.raise_signal(number)
        assert stop.wait(5.0)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
    assert signal.getsignal(number) is before


def test_an_interrupt_while_children_start_reaches_this_process_alone():
    """Ctrl-C goes to all processes of the terminal; one pressed while workers start was lost."""
    child = "import time; print('started', flush=True); time.sleep(0.2); print('whole')"
    with stop_on_signal() as stop:
        with no_interrupt_for_children():
            process = subprocess.Popen([sys.executable, "-c", child], stdout=subprocess.PIPE, text=True)
            assert process.stdout.readline() == "started\n"
            process.send_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGINT)
            assert not stop.is_set()
        assert stop.is_set()
        output, _ = process.communicate(timeout=60)
    assert output == "whole\n"
    assert process.returncode == 0


def test_workers_started_meanwhile_have_the_signal_blocked():
    """Started first in a process, multiprocessing's resource tracker unblocks it."""
    program = (
        "import signal, multiprocessing as m\n"
        "from simulator.study.trials.stopping import no_interrupt_for_children\n"
        "if __name__ == '__main__':\n"
        "    with no_interrupt_for_children():\n"
        "        m.get_context('spawn').Process(target=print).start()\n"
        "        assert signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)


def test_in_another_thread_signals_are_left_alone():
    """Only the main thread may set them."""
    before, seen = signal.getsignal(signal.SIGINT), []

    def work():
        with stop_on_signal() as stop, no_interrupt_for_children():
            seen.extend([stop.is_set(), signal.getsignal(signal.SIGINT) is before])

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [False, True]
