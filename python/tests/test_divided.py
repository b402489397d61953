"""One picture on several workers: the same file, and errors that name the tile."""

import threading
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from multiprocessing import get_context

import numpy as np
import pytest
import ssplat
from pictures import waves

PICTURE = waves(200, 270)
OPTIONS = {"bytes": 900, "effort": 1, "tiles": 128}
HERE = ssplat.encode(PICTURE, **OPTIONS)


def here(task):
    return partial(ssplat.work_on_tile, task)


@pytest.mark.parametrize("at_once", [1, 5])
def test_threads_make_the_same_file(at_once):
    caller, callers = threading.get_ident(), set()
    with ThreadPoolExecutor(3) as pool:

        def start(task):
            callers.add(threading.get_ident())
            return pool.submit(ssplat.work_on_tile, task, threads=1).result

        assert ssplat.encode(PICTURE, **OPTIONS, research={"start": start, "at_once": at_once}) == HERE
    assert callers == {caller}


def test_processes_make_the_same_file():
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:

        def start(task):
            return pool.submit(ssplat.work_on_tile, task).result

        assert ssplat.encode(PICTURE, **OPTIONS, research={"start": start}) == HERE


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [None, 3, 4])
def test_a_memory_map_is_the_picture_that_it_holds(tmp_path, dtype, channels):
    picture = waves(150, 140, channels, dtype)
    picture.tofile(tmp_path / "samples")
    mapped = np.memmap(tmp_path / "samples", dtype, "r", shape=picture.shape)
    assert ssplat.encode(mapped, **OPTIONS) == ssplat.encode(picture, **OPTIONS)
    turned = mapped[::-1]
    assert ssplat.encode(turned, **OPTIONS) == ssplat.encode(picture[::-1], **OPTIONS)


def test_a_picture_that_is_not_in_tiles_is_encoded_here():
    def start(task):
        raise AssertionError("nothing is to be divided")

    small = waves(100, 120)
    assert ssplat.encode(small, **OPTIONS, research={"start": start}) == ssplat.encode(small, **OPTIONS)


def test_what_a_worker_raises_stops_the_encode():
    def fail():
        raise ConnectionError("gone")

    with pytest.raises(ConnectionError, match="gone"):
        ssplat.encode(PICTURE, **OPTIONS, research={"start": lambda task: fail})
    with pytest.raises(ConnectionError, match="gone"):
        ssplat.encode(PICTURE, **OPTIONS, research={"start": lambda task: fail()})


def test_an_answer_that_is_none_names_the_tile():
    answers = []

    def foreign(task):
        answers.append(ssplat.work_on_tile(task))
        return lambda: answers[0]

    for start, text in [
        (lambda task: bytes, "128 × 128 at 0, 0: the 0 bytes"),
        (foreign, "14 × 128 at 256, 0: the answer belongs to task"),
    ]:
        with pytest.raises(ssplat.ParameterError, match=text) as caught:
            ssplat.encode(PICTURE, **OPTIONS, research={"start": start, "at_once": 1})
        assert caught.value.name == "answer"
    with pytest.raises(ssplat.ParameterError, match="must return bytes, not <class 'int'>"):
        ssplat.encode(PICTURE, **OPTIONS, research={"start": lambda task: int})


def test_bytes_that_are_no_task_are_refused():
    with pytest.raises(ssplat.ParameterError, match="3 bytes") as caught:
        ssplat.work_on_tile(b"abc")
    assert caught.value.name == "task"
    with pytest.raises(ssplat.ParameterError, match="at_once"):
        ssplat.encode(PICTURE, **OPTIONS, research={"start": here, "at_once": 0})


def test_a_worker_can_be_stopped():
    tasks = []

    def start(task):
        tasks.append(task)
        raise InterruptedError

    with pytest.raises(InterruptedError):
        ssplat.encode(PICTURE, **OPTIONS, research={"start": start})
    with pytest.raises(ssplat.CancelledError):
        ssplat.work_on_tile(tasks[0], progress=lambda stage, done: done < 0.5)
