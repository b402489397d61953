"""Functions that the tests run in other processes, which import this module."""

import os
import pathlib
import signal

import ssplat
from pictures import waves

PICTURE = waves(40, 50)
SMALL = {"effort": 1, "gaussians": 20}


def work(seed):
    """Returns a file, and the sum of its decoded samples."""
    data = ssplat.encode(PICTURE, **SMALL, research={"seed": seed})
    return data, int(ssplat.decode(data, threads=2).sum())


class DiesOnce:
    """Encodes, but kills its own worker once, when the file of a certain picture is half written."""

    def __init__(self, name, marker):
        self.name, self.marker = name, marker

    def __call__(self, path, *arguments):
        if path == self.name and not os.path.exists(self.marker):
            pathlib.Path(self.marker).touch()
            os.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
        import ray_encode

        return ray_encode.encode_one(path, *arguments)


class TileDiesOnce:
    """Processes tiles, but kills its own worker the first time."""

    def __init__(self, marker):
        self.marker = marker

    def __call__(self, task):
        if not os.path.exists(self.marker):
            pathlib.Path(self.marker).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return ssplat.work_on_tile(task, threads=1)
