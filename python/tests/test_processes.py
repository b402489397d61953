"""Signals, threads, forked and spawned processes."""

import multiprocessing
import os
import pathlib
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import ssplat
from jobs import PICTURE, SMALL, work
from pictures import waves

FILE = ssplat.encode(PICTURE, **SMALL)
#: Takes many minutes.
LONG = waves(1500, 2000)
#: More than any step of the long encode takes on a slow machine.
PATIENCE = 120


def threads_of_this_process():
    return {task.name for task in pathlib.Path("/proc/self/task").iterdir()}


def wait_until(condition):
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.fixture
def interrupts():
    # Where the tests run in the background of a shell, SIGINT is ignored and Python sets no handler by itself.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.skipif(not pathlib.Path("/proc/self/task").exists(), reason="threads are counted in /proc")
@pytest.mark.parametrize("progress", [None, lambda stage, done: None])
def test_keyboard_interrupt_stops_an_encode_and_its_threads(progress, interrupts):
    before = threads_of_this_process()

    def interrupt():
        # Waits until the encode has started threads. Threads of earlier tests may still end meanwhile.
        wait_until(lambda: len(threads_of_this_process() - before) > 1)
        os.kill(os.getpid(), signal.SIGINT)

    killer = threading.Thread(target=interrupt)
    killer.start()
    with pytest.raises(KeyboardInterrupt):
        ssplat.encode(LONG, effort=9, threads=1, progress=progress)
    killer.join()
    wait_until(lambda: threads_of_this_process() <= before)  # No thread is new.


def test_an_error_in_the_callback_stops_the_encode_and_comes_out():
    seen = []

    def fail(stage, done):
        assert threading.current_thread() is threading.main_thread()
        seen.append(stage)
        raise ZeroDivisionError("of the callback")

    with pytest.raises(ZeroDivisionError, match="of the callback"):
        ssplat.encode(LONG, effort=9, threads=1, progress=fail)
    assert len(seen) == 1


def test_false_stops_the_encode_and_nothing_else_does():
    for answer in (None, True, 0.0, [], "no"):
        assert ssplat.encode(PICTURE, **SMALL, progress=lambda stage, done, answer=answer: answer) == FILE
    with pytest.raises(ssplat.CancelledError):
        ssplat.encode(PICTURE, **SMALL, progress=lambda stage, done: done < 0.3)


def test_many_threads_encode_and_decode_at_once():
    def both(seed):
        data = ssplat.encode(PICTURE, **SMALL, threads=2, research={"seed": seed})
        return data, ssplat.decode(data, threads=2).tobytes()

    with ThreadPoolExecutor(8) as pool:
        together = list(pool.map(both, [0, 1, 2, 3] * 6))
    assert together == [both(seed) for seed in (0, 1, 2, 3)] * 6


def test_the_lock_is_free_meanwhile():
    counted = 0
    done = threading.Event()

    def count():
        nonlocal counted
        while not done.is_set():
            counted += 1
            time.sleep(0.001)

    counter = threading.Thread(target=count)
    counter.start()
    # Without progress the calling thread only waits; it must not hold the GIL.
    ssplat.encode(PICTURE, effort=9, gaussians=200, threads=1, time=0.5)
    done.set()
    counter.join()
    assert counted > 10


@pytest.mark.parametrize("method", ["fork", "spawn"])
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*:DeprecationWarning")
def test_processes_give_what_one_process_gives(method):
    if method not in multiprocessing.get_all_start_methods():
        pytest.skip(f"this system cannot {method}")
    want = [work(seed) for seed in range(4)]
    with multiprocessing.get_context(method).Pool(2) as pool:
        assert pool.map_async(work, range(4)).get(PATIENCE) == want


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*:DeprecationWarning")
def test_a_fork_in_the_middle_of_an_encode_works_on():
    """A child has none of its parent's threads, so a shared pool would wait for them forever."""
    started, stop = threading.Event(), threading.Event()

    def progress(stage, done):
        started.set()
        return not stop.is_set()

    def encode():
        with pytest.raises(ssplat.CancelledError):
            ssplat.encode(LONG, effort=9, threads=2, progress=progress)

    encoder = threading.Thread(target=encode)
    encoder.start()
    assert started.wait(PATIENCE)
    child = multiprocessing.get_context("fork").Process(target=lambda: os._exit(0 if work(0)[0] == FILE else 1))
    child.start()
    child.join(PATIENCE)
    code = child.exitcode
    child.kill()
    stop.set()
    encoder.join()
    assert code == 0


def test_an_encode_left_behind_does_not_hold_up_the_end_of_the_program():
    program = """
import ssplat, numpy, sys
def stop(stage, done): raise ValueError
try:
    ssplat.encode(numpy.random.default_rng(0).integers(0, 256, (1500, 2000, 3), numpy.uint8), effort=9, progress=stop)
except ValueError:
    print("stopped")
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, timeout=PATIENCE, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "stopped\n", "")


def test_arrays_that_came_out_are_the_callers_alone():
    one, other = ssplat.decode(FILE), ssplat.decode(FILE)
    one[:] = 0
    assert other.any()
    assert not np.shares_memory(one, other)
