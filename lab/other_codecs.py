"""Encodes pictures with other codecs through Pillow, and finds what a codec reaches in a given number of bytes.

Results are cached in a folder, so that an interrupted command can be continued.
"""
import bisect, dataclasses, hashlib, json, math, os, pathlib, shlex, statistics, subprocess, sys, tempfile, time

MEASURES = ["psnr", "ms_ssim", "ssimulacra2", "butteraugli"]


# Runs a command and writes its exit status, CPU seconds and peak memory in KB to a file. The peak memory of a process
# includes that of the process that forks it, so a small interpreter does that.
MEASURE = """
import json, os, sys
child = os.fork()
if not child:
    os.execvp(sys.argv[2], sys.argv[2:])
_, status, used = os.wait4(child, 0)
with open(sys.argv[1], "w") as file:
    json.dump([status, used.ru_utime + used.ru_stime, used.ru_maxrss], file)
"""


def run(command, variables={}):
    """Runs a command and returns its output, CPU seconds and peak memory in MB."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err, tempfile.NamedTemporaryFile() as result:
        words = [sys.executable, "-I", "-S", "-c", MEASURE, result.name, *(str(part) for part in command)]
        subprocess.run(words, stdout=out, stderr=err, env=os.environ | variables, check=True)
        out.seek(0), err.seek(0)
        status, seconds, kilobytes = json.load(result)
        if status:
            sys.exit(f"{' '.join(map(str, command))}: {err.read().decode()}")
        return out.read().decode(), seconds, kilobytes / 1024


def programs(texts):
    """Returns the path, the options, the environment variables and the hash of each program, by name. A text is
    NAME=PROGRAM, with options after the program and variables before it."""
    found = {}
    for text in texts:
        name, _, command = text.partition("=")
        words = shlex.split(command)
        variables = dict(word.split("=", 1) for word in words if "=" in word.split("/")[0])
        path, *options = words[len(variables):]
        program = pathlib.Path(path).resolve()
        found[name] = (program, options, variables, hashlib.sha256(program.read_bytes()).hexdigest()[:16])
    return found


def mean(values):
    """The mean of the values that are not None, or NaN."""
    values = [value for value in values if value is not None]
    return statistics.fmean(values) if values else float("nan")


class Cache:
    def __init__(self, folder):
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def kept(self, name, work):
        """Returns the result of `work`, from the cache if it is there."""
        path = self.folder / (hashlib.sha256(name.encode()).hexdigest()[:24] + ".json")
        if not path.exists():
            made = work()
            part = path.with_suffix(f".{os.getpid()}")
            part.write_text(json.dumps(made))
            part.rename(path)
        return json.loads(path.read_text())


def measured(program, original, made):
    """Returns what `compare` of the program measures; a measure that it does not have for this size is None."""
    found = json.loads(run([program, "--threads", "1", "compare", original, made, "--json"])[0])
    return {key: found[key] for key in MEASURES}


@dataclasses.dataclass(frozen=True)
class Codec:
    """A codec with its settings, of which only the quality varies."""
    format: str
    settings: str
    options: dict
    #: From small files to large ones.
    qualities: tuple

    def key(self, picture, quality):
        return f"{self.format} {picture.name} {self.settings} {quality}"

    def encode(self, image, quality, file):
        """Writes a file and returns the CPU seconds of this process, because libjxl works in a thread of its own."""
        if self.format == "jxl":
            import pillow_jxl  # noqa: F401
        start = time.process_time()
        image.save(file, {"avif": "AVIF", "jxl": "JXL", "webp": "WEBP", "jpeg": "JPEG"}[self.format], quality=quality, **self.options)
        return time.process_time() - start

    def timed(self, picture, quality, file, back):
        """Encodes and decodes in a process of its own, so that other threads of this one are not counted. Returns the CPU
        seconds of both."""
        return json.loads(run([sys.executable, __file__, json.dumps(dataclasses.asdict(self)), str(quality), picture, file, back])[0])


AVIF_QUALITIES = (0, 2, 4, 8, 12, 16, 20, 25, 30, 36, 42, 48, 54, 60, 66, 72, 78, 84, 87, 90, 93, 95, 96, 97, 98, 99)
JXL_QUALITIES = (0, 1, 2, 4, 7, 10, 15, 20, 30, 40, 50, 60, 66, 72, 78, 84, 87, 90, 92, 94, 96, 97, 98, 99)
WEBP_QUALITIES = (0, 2, 5, 10, 15, 25, 35, 45, 55, 65, 72, 78, 84, 88, 92, 94, 96, 98, 99, 100)


def avif(speed, subsamplings=("4:2:0", "4:4:4")):
    """AVIF by aom with tune=iq, once for each subsampling of chroma."""
    more = {"speed": speed, "max_threads": 1, "advanced": {"tune": "iq"}}
    return [Codec("avif", f"{subsampling} {speed}", more | {"subsampling": subsampling}, AVIF_QUALITIES) for subsampling in subsamplings]


JPEG_XL = [Codec("jxl", "effort 7", {"effort": 7, "num_threads": 1}, JXL_QUALITIES)]
WEBP = [Codec("webp", "method 6", {"method": 6}, WEBP_QUALITIES)]


class Files:
    """Files of other codecs, measured by `program`."""

    def __init__(self, cache, program):
        self.cache, self.program = cache, program
        self.opened = None, None

    def image(self, picture):
        if self.opened[0] != picture:
            from PIL import Image
            Image.MAX_IMAGE_PIXELS = None
            self.opened = picture, Image.open(picture).convert("RGB")
            self.opened[1].info.clear()
        return self.opened[1]

    def size(self, picture, codec, quality):
        """Returns the bytes of a file."""
        def work():
            with tempfile.TemporaryDirectory() as folder:
                file = pathlib.Path(folder, f"a.{codec.format}")
                codec.encode(self.image(picture), quality, file)
                return file.stat().st_size
        return self.cache.kept(codec.key(picture, quality) + " size", work)

    def point(self, picture, codec, quality):
        """Returns the bytes and measures of a file."""
        def work():
            from PIL import Image
            with tempfile.TemporaryDirectory() as folder:
                file, back = pathlib.Path(folder, f"a.{codec.format}"), pathlib.Path(folder, "a.ppm")
                codec.encode(self.image(picture), quality, file)
                Image.open(file).convert("RGB").save(back)
                return {"bytes": file.stat().st_size} | measured(self.program, picture, back)
        return self.cache.kept(codec.key(picture, quality), work)

    def seconds(self, picture, codec, quality, repeat):
        """Returns the CPU seconds of the fastest of some encodes."""
        def work():
            with tempfile.TemporaryDirectory() as folder:
                file = pathlib.Path(folder, f"a.{codec.format}")
                return min(codec.encode(self.image(picture), quality, file) for _ in range(repeat))
        return self.cache.kept(f"{codec.key(picture, quality)} seconds {repeat}", work)

    def around(self, picture, codec, sizes):
        """Returns the qualities of the largest file that is at most as large as each of these sizes, and of the smallest
        that is at least as large."""
        found = set()
        for size in sizes:
            above = bisect.bisect_left(codec.qualities, size, key=lambda quality: self.size(picture, codec, quality))
            found |= {codec.qualities[max(above - 1, 0)], codec.qualities[min(above, len(codec.qualities) - 1)]}
        return sorted(found)

    def best(self, picture, codecs, size):
        """Returns the measures of the best of some codecs (by SSIMULACRA2) at a size, and which it is. Returns None if
        none of them has files on both sides of it."""
        found = []
        for codec in codecs:
            points = [self.point(picture, codec, quality) for quality in self.around(picture, codec, [size])]
            reached = {key: at(points, size, key) for key in MEASURES}
            if reached["ssimulacra2"] is not None:
                found.append(reached | {"codec": codec})
        return max(found, key=lambda made: made["ssimulacra2"], default=None)

    def best_below(self, picture, codecs, size):
        """Returns the measures of the best of the largest files of some codecs, of those that are smaller than a size, or
        None."""
        found = [self.point(picture, codec, codec.qualities[-1]) | {"codec": codec} for codec in codecs if self.size(picture, codec, codec.qualities[-1]) < size]
        return max(found, key=lambda made: made["ssimulacra2"], default=None)


def at(points, size, key):
    """Interpolates a measure at a size in bytes between the two nearest files, over the logarithm of the size.

    If the smallest file is larger by less than 1 %, its value is returned, which favours it. Outside the range of sizes,
    the result is None.
    """
    points = sorted(points, key=lambda point: point["bytes"])
    if size < points[0]["bytes"] < 1.01 * size:
        return points[0][key]
    for a, b in zip(points, points[1:]):
        if a["bytes"] <= size <= b["bytes"] and None not in (a[key], b[key]):
            t = math.log(size / a["bytes"]) / math.log(b["bytes"] / a["bytes"]) if b["bytes"] > a["bytes"] else 0
            return a[key] + t * (b[key] - a[key])
    return None


def main():
    """Encodes and decodes one picture for `Codec.timed`."""
    from PIL import Image
    settings, quality, picture, file, back = sys.argv[1:]
    codec, image = Codec(**json.loads(settings)), Image.open(picture).convert("RGB")
    seconds = codec.encode(image, int(quality), file)
    start = time.process_time()
    decoded = Image.open(file).convert("RGB")
    print(json.dumps({"encode_s": seconds, "decode_s": time.process_time() - start}))
    decoded.save(back)


if __name__ == "__main__":
    main()
